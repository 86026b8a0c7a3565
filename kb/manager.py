"""The adaptation loop: monitor, analyse, plan, execute; its stages talk only through the knowledge base.

Analysing is inference, which the knowledge base does by itself. The other stages are small protocols: give the manager
your own monitor, planner or executor and the rest stays as it is.
"""

import logging
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Protocol

from kb.exceptions import InvalidValue, ProtocolError, UnknownName, Unselectable
from kb.execution import StagedExecutor
from kb.knowledge_base import KnowledgeBase
from kb.managed_system import ActivityMonitor, ManagedSystem, check_methods, words_of, wrong_answer
from kb.planners import Choice, choice_by_priority
from kb.records import ReconfigurationPlan

_log = logging.getLogger(__name__)


class Monitor(Protocol):
    """Looks at the robot or its surroundings and tells the knowledge base."""

    def observe(self, kb: KnowledgeBase) -> None:
        """Tell what there is to tell now, without waiting."""


class Planner(Protocol):
    """Decides which designs and configurations to select.

    One that can be tried in a dry run has a method `choose(kb)` too: it returns the `Choice` that `plan` would select,
    or None, and changes nothing, neither in the knowledge base nor in itself. One that may choose anew because time
    has passed has an attribute `is_waiting`: while it is true, `plan` is called at every update.
    """

    def plan(self, kb: KnowledgeBase) -> ReconfigurationPlan | None:
        """Ask what is adaptable, choose, and return what `kb.select` answers, without waiting."""


class Executor(Protocol):
    """Carries out the pending plan."""

    def execute(self, kb: KnowledgeBase) -> None:
        """Do what can be done of `kb.pending_plan` without waiting; end it with `kb.finish_plan`."""


class PriorityPlanner:
    """Chooses what is selectable with the lowest priority number; no priority comes last, ties go by name."""

    def choose(self, kb: KnowledgeBase) -> Choice | None:
        """Choose for every adaptable function, then for every component that is adaptable given those choices."""
        with kb.reading() as state:
            return choice_by_priority(state)

    def plan(self, kb: KnowledgeBase) -> ReconfigurationPlan | None:
        """Select what is preferred by priority; None if there is nothing to choose."""
        choice = self.choose(kb)
        return None if choice is None else kb.select(*choice)


Veto = Callable[[ReconfigurationPlan], bool | str | None]
"""Is shown a plan, with its reason; answers None or True to let it pass, False or the reason to forbid it."""


class VetoGate:
    """Asks about every plan before it is executed, and takes back what a forbidden one had selected."""

    def __init__(self, kb: KnowledgeBase, veto: Veto) -> None:
        if not callable(veto):
            raise InvalidValue(f"a veto is a function that is called with each plan; {veto!r} cannot be called")
        self._kb = kb
        self._veto = veto

    def check(self) -> bool:
        """Ask about the plans that were not asked about yet, and tell whether one was forbidden: it is abandoned."""
        kb, is_vetoed = self._kb, False
        while (plan := kb.pending_plan) is not None and all(one.plan is not plan for one in kb.history.answers):
            objection = self._objection(plan)
            kb.record_answer(plan, is_vetoed=bool(objection), reason=objection)
            if not objection:
                break
            _log.info("vetoed: %s, because %s", plan, objection)
            self._take_back(plan, f"vetoed: {objection}")
            kb.finish_plan(plan, "abandoned")
            is_vetoed = True
        return is_vetoed

    def _objection(self, plan: ReconfigurationPlan) -> str:
        try:
            answer: object = self._veto(plan)
        except Exception as error:
            return words_of(error)
        if answer is None or answer is True:
            return ""
        if answer is False or answer == "":
            return "no reason was given"
        if isinstance(answer, str):
            return answer
        return f"the veto function answered {answer!r}; it is to answer None or True to let a plan pass, else a reason"

    def _take_back(self, plan: ReconfigurationPlan, reason: str) -> None:
        """Undo what the plan's event has selected, and nothing else: what is not executed is not in force."""
        made = (event.effects for event in self._kb.log.since(plan.cause or 0) if event.plan is plan)
        for kind, name, is_selected in next(made, ()):
            with suppress(UnknownName):  # it has left the model
                self._kb.assert_selected((kind, name), not is_selected, reason if is_selected else "")


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

    Raises:
        ProtocolError: one of them lacks a method, or has one that cannot be called as it is going to be.
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
        if not isinstance(kb, KnowledgeBase):
            raise ProtocolError(f"a manager works on a kb.KnowledgeBase, not on {kb!r:.80}")
        self._kb = kb
        self._planner = PriorityPlanner() if planner is None else planner
        check_methods("a planner", self._planner, Planner, ("choose(kb)",))
        check_methods("a managed system", managed, ManagedSystem, ("is_active(component)",))
        budgets = getattr(self._planner, "budgets", None)
        self._executor = StagedExecutor(managed, budgets=budgets) if executor is None else executor
        check_methods("an executor", self._executor, Executor)
        can_tell = callable(getattr(managed, "is_active", None))
        self._monitors = (*monitors, *([ActivityMonitor(managed)] if can_tell else []))
        for monitor in self._monitors:
            check_methods("a monitor", monitor, Monitor)
        self._gate = None if veto is None else VetoGate(kb, veto)
        self._planned_at = -1

    def dry_run(self) -> ReconfigurationPlan | None:
        """Return the plan that the planner would make now, None for none; nothing is selected, told or executed.

        Raises:
            InvalidValue: the planner has no method `choose`.
        """
        choose = getattr(self._planner, "choose", None)
        if choose is None:
            what = type(self._planner).__name__
            raise InvalidValue(f"{what} cannot be tried: a dry run asks its method choose(kb), which it does not have")
        choice = choose(self._kb)
        return None if choice is None else self._kb.select(*choice, dry_run=True)

    def update(self) -> ReconfigurationPlan | None:
        """Take one turn of the loop, without waiting.

        A new plan is made only when something changed since the last one, and not before that one has ended: a plan
        leads from the state the components are in, which is known for sure only then. One that fails or is vetoed is
        made again when there is news.

        Returns:
            The plan that was made in this turn, if any; a vetoed one has ended already.

        Raises:
            ProtocolError: the planner or the managed system returned what means nothing.
            InvalidValue, UnknownName: the planner selects what is unfeasible, or is not there; nothing is selected.
        """
        kb, gate = self._kb, self._gate
        for monitor in self._monitors:
            monitor.observe(kb)
        if gate is not None:  # somebody else may have made a plan
            gate.check()
        plan = None
        revision = kb.revision
        if revision != self._planned_at and kb.pending_plan is None:
            plan = self._planned(revision)
            is_vetoed = gate is not None and gate.check()
            self._planned_at = kb.revision if is_vetoed else revision
            if getattr(self._planner, "is_waiting", False):
                self._planned_at = -1
        self._executor.execute(kb)
        return plan

    def _planned(self, revision: int) -> ReconfigurationPlan | None:
        """Have the planner plan; what it chose may be unfeasible or removed by now, which is no slip of its own."""
        try:
            plan = self._planner.plan(self._kb)
        except (Unselectable, UnknownName):
            if self._kb.revision == revision:
                raise
            return None
        if plan is None or isinstance(plan, ReconfigurationPlan):
            return plan
        raise wrong_answer("plan(kb)", self._planner, plan, "what kb.select returned, or None")
