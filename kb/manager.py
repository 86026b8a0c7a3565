"""The adaptation loop: monitor, analyse, plan, execute; its stages talk only through the knowledge base.

Analysing is inference, which the knowledge base does by itself. The other stages are small protocols: give the manager
your own monitor, planner or executor and the rest stays as it is.
"""

from collections.abc import Iterable
from typing import Protocol, cast

from kb.execution.activity import Activity
from kb.execution.executor import StagedExecutor
from kb.execution.gate import Gate, Veto
from kb.execution.rehearsal import Rehearsal
from kb.knowledge_base import KnowledgeBase
from kb.managed import ManagedSystem
from kb.reconfiguration import ReconfigurationPlan
from kb.selection import first_by_priority

__all__ = ["ConfigurationManager", "Executor", "Monitor", "Planner", "PriorityPlanner"]


class Monitor(Protocol):
    """Looks at the robot or its surroundings and tells the knowledge base."""

    def observe(self, kb: KnowledgeBase) -> None:
        """Tell what there is to tell now, without waiting."""


class Planner(Protocol):
    """Decides which designs and configurations to select."""

    def plan(self, kb: KnowledgeBase) -> ReconfigurationPlan | None:
        """Ask what is adaptable, choose, and return what `kb.select` answers, without waiting."""


class Executor(Protocol):
    """Carries out the pending plan."""

    def execute(self, kb: KnowledgeBase) -> None:
        """Do what can be done of `kb.pending_plan` without waiting; end it with `kb.finish_plan`."""


class PriorityPlanner:
    """Chooses what is selectable with the lowest priority number; no priority comes last, ties go by name."""

    def plan(self, kb: KnowledgeBase) -> ReconfigurationPlan | None:
        """Choose for every adaptable function, then for every component that is adaptable given those choices."""
        designs = {}
        for function in kb.adaptable_functions():
            choice = first_by_priority(kb.designs[name] for name in kb.selectable_designs(function))
            if choice is not None:
                designs[function] = choice
        configurations = {}
        for component in kb.adaptable_components(designs.values()):
            choice = first_by_priority(kb.configurations[name] for name in kb.selectable_configurations(component))
            if choice is not None:
                configurations[component] = choice
        if not designs and not configurations and not kb.obsolete():
            return None
        return kb.select(designs, configurations)


class ConfigurationManager:
    """Keeps a managed system configured for what the mission is doing.

    Args:
        kb: the knowledge base that all stages talk through.
        managed: the system whose components are switched and configured; if it can tell what runs, it is asked.
        planner: decides what to select; by priority when none is given.
        executor: carries out plans; in three stages on `managed`, within the budgets of the planner if it has some,
            when none is given.
        monitors: asked first at each turn.
        veto: is shown each plan, with its reason, before it is executed, whoever made it. It answers None or True to
            let it pass; False, or the reason in words, to forbid it. What it raises forbids too.
    """

    def __init__(
        self,
        kb: KnowledgeBase,
        managed: ManagedSystem,
        *,
        planner: Planner | None = None,
        executor: Executor | None = None,
        monitors: Iterable[Monitor] = (),
        veto: Veto | None = None,
    ) -> None:
        self._kb = kb
        self._planner = planner or PriorityPlanner()
        self._executor = executor or StagedExecutor(managed, budgets=getattr(self._planner, "budgets", None))
        self._monitors = (*monitors, Activity(managed))
        self._gate = None if veto is None else Gate(kb, veto)
        self._planned_at = -1

    def dry_run(self) -> ReconfigurationPlan | None:
        """Return the plan that the planner would make now, None for none; nothing is selected, told or executed.

        A planner that remembers what it was asked remembers this, too.
        """
        return self._planner.plan(cast("KnowledgeBase", Rehearsal(self._kb)))

    def update(self) -> ReconfigurationPlan | None:
        """Take one turn of the loop, without waiting.

        A new plan is made only when something changed since the last one, and not before that one has ended: a plan
        leads from the state the components are in, which is known for sure only then. One that fails or is vetoed is
        made again when there is news.

        Returns:
            The plan that was made in this turn, if any; a vetoed one has ended already.
        """
        kb, gate = self._kb, self._gate
        for monitor in self._monitors:
            monitor.observe(kb)
        if gate is not None:  # somebody else may have made a plan
            gate.check()
            gate.remember()
        plan = None
        revision = kb.revision
        if revision != self._planned_at and kb.pending_plan is None:
            plan = self._planner.plan(kb)
            is_vetoed = gate is not None and gate.check()
            self._planned_at = kb.revision if is_vetoed else revision
        self._executor.execute(kb)
        if gate is not None:
            gate.remember()
        return plan
