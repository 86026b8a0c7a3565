"""The planner that chooses for all that is required at once, by what is estimated and preferred."""

import logging
from collections.abc import Mapping
from typing import NamedTuple
from weakref import WeakKeyDictionary

from kb.elements import Element, finite_number
from kb.exceptions import InvalidValue
from kb.execution.rehearsal import Rehearsal
from kb.explanation.choice import ChoiceExplanation, explain_choice, note_nothing
from kb.knowledge_base import KnowledgeBase
from kb.manager import PriorityPlanner
from kb.optimum.beside import Beside
from kb.optimum.posing import check_names, pose
from kb.optimum.problem import Problem
from kb.reconfiguration import ReconfigurationPlan
from kb.selection import Criterion, Optimum, summed_weights
from kb.status import Status
from kb.views import ElementView

__all__ = ["OptimalPlanner"]

_log = logging.getLogger(__name__)


class OptimalPlanner:
    """Chooses the best joint configuration of all that is required, or says how far from the best it may be.

    When something is adaptable, or something else is preferred than at the last choice, everything required is chosen
    for again. Without a preference that an estimation bears on, and without budgets, it chooses as `PriorityPlanner`
    does.

    Args:
        switching_cost: what it costs to activate or deactivate a component or to change its configuration, the same
            for all or by name of the component; a gain smaller than that does not switch. To activate or deactivate a
            plain component costs nothing, for nobody switches it.
        budgets: the most that all estimations of what is chosen or active may sum up to, by name of attribute.
        effort: how much work may be done at most for one choice, in CP-SAT's deterministic time; 0.3 is about a
            second of a processor.
        delay: how long after the question its answer is taken, in the time of the knowledge base's clock [s];
            meanwhile it is looked for beside, in a thread, and an update only poses it. None to look for it within the
            update. See `catch_up`.

    Attributes:
        latest: what was found last; None before, and when the choice was by priority.
    """

    def __init__(
        self,
        *,
        switching_cost: float | Mapping[str, float] = 0.0,
        budgets: Mapping[str, float] | None = None,
        effort: float = 0.3,
        delay: float | None = None,
    ) -> None:
        import kb.optimum.solver as solver  # it takes a while: not in a tick, nor for those without it

        if finite_number(effort) <= 0.0:
            raise InvalidValue(f"an effort is more than 0, not {effort!r}")
        if not isinstance(budgets, Mapping | None):
            raise InvalidValue(f"budgets are given as the most by name of attribute, not as {budgets!r}")
        if delay is not None and finite_number(delay) < 0.0:
            raise InvalidValue(f"a delay is 0 s or more, or None to choose within the update, not {delay!r}")
        self._solver = solver
        self._by_priority = PriorityPlanner()
        self._given = Criterion({}, switching_cost, dict(budgets or {}))
        self._effort = effort
        self._beside = None if delay is None else Beside(lambda problem: solver.solve(problem, effort), delay)
        self._last: WeakKeyDictionary[KnowledgeBase, _Last] = WeakKeyDictionary()
        self.latest: Optimum | None = None

    @property
    def budgets(self) -> Mapping[str, float]:
        """The most that all that is chosen or active may sum up to, by name of attribute."""
        return self._given.budgets

    def criterion(self, kb: KnowledgeBase) -> Criterion:
        """Return what makes one choice better than another, given what is preferred now."""
        weights = summed_weights(required.preference for required in kb.required_actions)
        weights = {name: weight for name, weight in weights.items() if weight}
        return Criterion(weights, self._given.switching_cost, self._given.budgets)

    def plan(self, kb: KnowledgeBase) -> ReconfigurationPlan | None:
        """Choose for all that is required if something is adaptable or preferred anew; see `Planner`."""
        if isinstance(kb, Rehearsal):  # it is answered at once, and not remembered
            found = self.optimum(kb) if self._is_due(kb, kb._kb) else None
            return self._by_priority.plan(kb) if found is None else _select(kb, found)
        if kb not in self._last:  # a name that is wrong is found at the first update
            check_names(kb._network, self._given)
        found = None
        if self._is_due(kb, kb):
            problem = self._posed(kb)
            if self._beside is None or _is_by_priority(problem):
                found = self._solve(problem)
            else:
                found = self._beside.answer(problem, kb.now)
                if found is None:
                    kb.note_news()  # the answer will be news, so the planner is to be asked again
                    return None
            self.latest = found
        self._remember(kb, found)
        return self._by_priority.plan(kb) if found is None else _select(kb, found)

    def catch_up(self, kb: KnowledgeBase) -> None:
        """Wait for an answer that is due by now.

        With a delay, call it when a simulated clock has moved on and before the update: then the update never waits,
        and yet takes each answer at the same time in every run, however long it really took to find.
        """
        if self._beside is not None:
            self._beside.catch_up(kb.now)

    def optimum(self, kb: KnowledgeBase) -> Optimum | None:
        """Return the best choice for a knowledge base as it is; None if it is to be chosen by priority."""
        return self._solve(self._posed(kb))

    def explain_choice(self, kb: KnowledgeBase, element: ElementView | Element | str) -> ChoiceExplanation:
        """Say why a function or component has what it has, by this planner's criterion; see `kb.explain_choice`.

        It finds the best choice again, and the best one with each alternative: not a question for a tick.
        """
        node, optimum, criterion = kb._node(element, ("function", "component")), self.optimum(kb), self.criterion(kb)
        preferred, said, designs, nothing = None, {}, None, ""
        if optimum is not None and optimum.choice is None:
            nothing = optimum.reason
        if optimum is not None and optimum.choice is not None:
            designs = [kb.designs.node(name) for name in optimum.choice.designs.values()]
            preferred = optimum.choice[node.kind == "component"].get(node.name)
        if optimum is not None and preferred is not None:
            with kb._lock:  # to pose them is quick; others need not wait for the answers
                possible = [part for part in node.parts if kb._state.status[part.index] is not Status.UNFEASIBLE]
                rivals = {part.name: pose(kb._state, criterion, forced=part) for part in possible}
            rivals.pop(preferred, None)
            said = self._solver.verdicts(optimum, preferred, rivals, self._effort)
        with kb._lock:
            return explain_choice(kb._state, node, kb.now, preferred, said, designs, nothing)

    def _is_due(self, kb: KnowledgeBase, base: KnowledgeBase) -> bool:
        """Tell whether there is something to choose for, or to choose anew because of what is preferred."""
        if kb.adaptable_functions() or kb.adaptable_components():
            return True
        weights = self.criterion(kb).weights
        return base in self._last and self._last[base].weights != weights

    def _posed(self, kb: KnowledgeBase) -> Problem:
        criterion = self.criterion(kb)
        with kb._lock:
            return pose(kb._state, criterion)

    def _solve(self, problem: Problem) -> Optimum | None:
        return None if _is_by_priority(problem) else self._solver.solve(problem, self._effort)

    def _remember(self, kb: KnowledgeBase, found: Optimum | None) -> None:
        """Remember what was decided, and let the knowledge base explain it if nothing can be chosen."""
        if self._beside is not None:
            self._beside.forget()
        nothing = found.reason if found is not None and found.choice is None else ""
        before = self._last[kb].nothing if kb in self._last else ""
        self._last[kb] = _Last(self.criterion(kb).weights, nothing)
        if nothing != before:
            with kb._lock:
                note_nothing(kb._known, nothing)
            if nothing:
                _log.warning("nothing can be selected: %s", nothing)


class _Last(NamedTuple):
    """What was decided last.

    Attributes:
        weights: what was preferred.
        nothing: why nothing could be chosen; empty if something could.
    """

    weights: Mapping[str, float]
    nothing: str


def _select(kb: KnowledgeBase, found: Optimum) -> ReconfigurationPlan | None:
    """Select what was found; if that is nothing, what nothing needs any more is given up all the same."""
    if found.choice is None or not any(found.choice):
        return kb.select() if kb.obsolete() else None
    designs, configurations = found.choice
    chosen = [
        *map(kb.designs.__getitem__, designs.values()),
        *map(kb.configurations.__getitem__, configurations.values()),
    ]
    if all(one.is_selected for one in chosen):
        return kb.select()  # why something has to be done all the same, the knowledge base knows
    return kb.select(designs, configurations, found.reason)


def _is_by_priority(problem: Problem) -> bool:
    return not problem.is_touched and not problem.budgets
