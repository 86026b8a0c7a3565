"""The adaptation loop: monitor, analyse, plan, execute, by the knowledge base.

The knowledge base does the analysis by itself, by inference. The other stages are small protocols:
a manager that is given another monitor, planner or executor works with it in the same way.
"""

from collections.abc import Callable, Iterable
from typing import Any, Protocol

from kb.exceptions import UnknownName, Unselectable
from kb.execution import StagedExecutor
from kb.knowledge_base import KnowledgeBase
from kb.managed_system import (
    ActivityMonitor,
    ManagedSystem,
    check_methods,
    words_of,
    wrong_answer,
)
from kb.planning import PriorityPlanner
from kb.records import ReconfigurationPlan


class Monitor(Protocol):
    """Looks at the robot or its surroundings and tells the knowledge base."""

    def observe(self, kb: KnowledgeBase) -> None:
        """Tell the knowledge base what is observed now; does not wait."""


class Planner(Protocol):
    """Decides which designs and configurations to select.

    For dry runs a planner may have a method `choose(kb)`: it returns the `Choice` that `plan`
    would select, or None, and changes neither the knowledge base nor the planner. A planner whose
    choice depends on the time has an attribute `is_waiting`: while it is true, `plan` is called at
    every update.
    """

    def plan(self, kb: KnowledgeBase) -> ReconfigurationPlan | None:
        """Choose, and return the result of `kb.select`, or None; does not wait."""


class Executor(Protocol):
    """Carries out the pending plan."""

    def execute(self, kb: KnowledgeBase) -> None:
        """Do what can be done of `kb.pending_plan` without waiting; `kb.finish_plan` ends it."""


Veto = Callable[[ReconfigurationPlan], bool | str | None]
"""Called with a plan; returns None or True to allow it, False or a reason to forbid it."""


class ConfigurationManager:
    """Adapts the configuration of a managed system to what the mission requires.

    Args:
        kb: the knowledge base that all stages talk through.
        managed: the system whose components are switched and configured; if it has `is_active`,
            the manager monitors with it which components run; if it has `observe`, it is a monitor
            too.
        planner: decides what to select; a `PriorityPlanner` by default.
        executor: carries out plans; by default a `StagedExecutor` on `managed`.
        monitors: called first at each update.
        veto: called with each plan, whoever made it, before it is executed. It returns None or
            True to allow the plan, False or a reason in words to forbid it; an exception forbids
            it too.

    Raises:
        ProtocolError: one of them lacks a method, or has a method with other arguments than the
            protocol's.
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
        self._planner = PriorityPlanner() if planner is None else planner
        check_methods("a planner", self._planner, Planner)
        check_methods("a managed system", managed, ManagedSystem)
        self._executor = StagedExecutor(managed) if executor is None else executor
        check_methods("an executor", self._executor, Executor)
        self._monitors = list(monitors)
        as_monitor: Any = managed
        if hasattr(managed, "observe") and as_monitor not in self._monitors:
            self._monitors.append(as_monitor)
        if callable(getattr(managed, "is_active", None)):
            self._monitors.append(ActivityMonitor(managed))
        for monitor in self._monitors:
            check_methods("a monitor", monitor, Monitor)
        self._veto = veto
        self._planned_at = -1

    def dry_run(self) -> ReconfigurationPlan | None:
        """Return the plan that the planner would make now, or None; nothing changes.

        The planner must have a method `choose`.
        """
        planner: Any = self._planner
        choice = planner.choose(self._kb)
        return None if choice is None else self._kb.select(*choice, dry_run=True)

    def update(self) -> ReconfigurationPlan | None:
        """Take one turn of the loop, without waiting.

        A new plan is made only after a change, and only when the last plan has ended, because a
        plan starts from the state of the components, which is certain only then. After a failed or
        vetoed plan, the next change leads to a new one.

        Returns:
            The plan that was made in this turn, or None; a vetoed plan has already ended.

        Raises:
            ProtocolError: the planner or the managed system returned a value that its protocol
                does not allow.
            InvalidValue, UnknownName: the planner selects what is unfeasible or unknown; nothing is
                selected.
        """
        kb = self._kb
        for monitor in self._monitors:
            monitor.observe(kb)
        while self._is_vetoed():  # somebody else may have made a plan
            pass
        plan = None
        revision = kb.revision
        if revision != self._planned_at and kb.pending_plan is None:
            plan = self._planned(revision)
            self._planned_at = kb.revision if self._is_vetoed() else revision
            if getattr(self._planner, "is_waiting", False):
                self._planned_at = -1
        self._executor.execute(kb)
        return plan

    def _is_vetoed(self) -> bool:
        """Ask the veto about the pending plan, if it is new; take it back if it is forbidden."""
        kb = self._kb
        plan = kb.pending_plan if self._veto else None
        if self._veto is None or plan is None:
            return False
        if any(answer.plan is plan for answer in reversed(kb.history.answers)):
            return False
        objection = self._objection(self._veto, plan)
        kb.record_answer(plan, is_vetoed=bool(objection), reason=objection)
        if not objection:
            return False
        reason = f"vetoed: {objection}"
        for event in kb.log.since(plan.cause or 0):
            for kind, name, is_selected in event.effects if event.plan is plan else ():
                why_not = reason if is_selected else ""
                kb.assert_selected((kind, name), not is_selected, why_not)
        kb.finish_plan(plan, "abandoned")
        return True

    def _objection(self, veto: Veto, plan: ReconfigurationPlan) -> str:
        try:
            answer = veto(plan)
        except Exception as error:
            return words_of(error)
        if answer is None or answer is True:
            return ""
        return answer or "no reason was given"

    def _planned(self, revision: int) -> ReconfigurationPlan | None:
        """Call the planner; a choice that a change made impossible meanwhile is no plan."""
        try:
            plan = self._planner.plan(self._kb)
        except (Unselectable, UnknownName):
            if self._kb.revision == revision:
                raise
            return None
        if plan is None or isinstance(plan, ReconfigurationPlan):
            return plan
        raise wrong_answer("plan(kb)", self._planner, plan, "what kb.select returned, or None")
