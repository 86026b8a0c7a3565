"""The planner that chooses for all that is required at once, by what is estimated and preferred."""

import logging
from collections.abc import Mapping
from weakref import WeakKeyDictionary

from kb.elements import finite_number
from kb.exceptions import InvalidValue
from kb.knowledge_base import KnowledgeBase
from kb.planners import Choice, Criterion, Optimum, choice_by_priority, summed_weights
from kb.records import ReconfigurationPlan

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

    Attributes:
        latest: what was found last; None before, and when the choice was by priority.
    """

    def __init__(
        self,
        *,
        switching_cost: float | Mapping[str, float] = 0.0,
        budgets: Mapping[str, float] | None = None,
        effort: float = 0.3,
    ) -> None:
        import kb.planners.solver as solver  # it takes a while: not in a tick, nor for those without it

        if finite_number(effort) <= 0.0:
            raise InvalidValue(f"an effort is more than 0, not {effort!r}")
        if not isinstance(budgets, Mapping | None):
            raise InvalidValue(f"budgets are given as the most by name of attribute, not as {budgets!r}")
        self._solver = solver
        self._given = Criterion({}, switching_cost, dict(budgets or {}))
        self._effort = effort
        self._last = WeakKeyDictionary[KnowledgeBase, tuple[Mapping[str, float], str]]()
        """By what weights was chosen for each, and why nothing could be; empty if something could."""
        self.latest: Optimum | None = None

    @property
    def budgets(self) -> Mapping[str, float]:
        """The most that all that is chosen or active may sum up to, by name of attribute."""
        return self._given.budgets

    def criterion(self, kb: KnowledgeBase) -> Criterion:
        """Return what makes one choice better than another, given what is preferred now."""
        weights = summed_weights(required.preference for required in kb.required_actions)
        return Criterion(weights, self._given.switching_cost, self._given.budgets)

    def choose(self, kb: KnowledgeBase) -> Choice | None:
        """Return what `plan` would select if it had the answer now; None if there is nothing to be done."""
        return _choice(kb, self.optimum(kb) if self._is_due(kb) else None)

    def plan(self, kb: KnowledgeBase) -> ReconfigurationPlan | None:
        """Choose for all that is required if something is adaptable or preferred anew; see `Planner`."""
        if kb not in self._last:  # a name that is wrong is found at the first update
            with kb.reading() as state:
                self._given.check(state.network)
        found, weights = None, self.criterion(kb).weights
        if self._is_due(kb):
            found = self.latest = self.optimum(kb)
        nothing = found.reason if found is not None and found.choice is None else ""
        if nothing != self._last.get(kb, ({}, ""))[1]:
            kb.note_no_choice(nothing)
            if nothing:
                _log.warning("nothing can be selected: %s", nothing)
        choice = _choice(kb, found)
        plan = None if choice is None else kb.select(*choice)
        self._last[kb] = weights, nothing  # now: what was interrupted is chosen again
        return plan

    def optimum(self, kb: KnowledgeBase) -> Optimum | None:
        """Return the best choice for a knowledge base as it is; None if it is to be chosen by priority.

        That is so where nothing is estimated or limited, and where no choice at all was found with the effort allowed.
        """
        criterion = self.criterion(kb)
        with kb.reading() as state:
            problem = self._solver.Problem(state, criterion)
        found = problem.solve(self._effort) if problem.is_weighed else None
        is_lost = found is not None and found.choice is None and not (found.is_proven or criterion.budgets)
        return None if is_lost else found

    def _is_due(self, kb: KnowledgeBase) -> bool:
        if kb.adaptable_functions() or kb.adaptable_components():
            return True
        return kb in self._last and self._last[kb][0] != self.criterion(kb).weights


def _choice(kb: KnowledgeBase, found: Optimum | None) -> Choice | None:
    """Return what is to be selected; what nothing needs any more is given up even if nothing can be chosen."""
    with kb.reading() as state:
        if found is None:
            return choice_by_priority(state)
        choice = found.choice
        if choice is None or not (choice.designs or choice.configurations):
            return Choice({}, {}) if state.obsolete else None
        network = state.network
        chosen = [network.designs[name] for name in choice.designs.values()]
        chosen += [network.configurations[name] for name in choice.configurations.values()]
        if all(state.selected[node.index] for node in chosen):
            return Choice({}, {})  # why something has to be done all the same, the knowledge base knows
        return Choice(choice.designs, choice.configurations, found.reason)
