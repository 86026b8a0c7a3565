"""The planner that chooses jointly for all that is required, by estimations and preferences."""

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
    """Chooses the best joint configuration of all that is required, or says how far it may be from the best.

    It chooses again for all that is required when something is adaptable, or the preferences changed since the last
    choice. Without budgets, and without estimations of a preferred attribute, it chooses as `PriorityPlanner` does.

    Args:
        switching_cost: the cost of activating or deactivating a component or changing its configuration, the same for
            all or by name of the component; for a smaller gain nothing is switched. Activating or deactivating a plain
            component costs nothing, because it is not switched.
        budgets: the most that the estimations of what is chosen or active may sum up to, by name of attribute.
        effort: the most work for one choice, in CP-SAT's deterministic time; 0.3 is about a second of processor time.

    Attributes:
        latest: the latest result; None before the first, and after a choice by priority.
    """

    def __init__(
        self,
        *,
        switching_cost: float | Mapping[str, float] = 0.0,
        budgets: Mapping[str, float] | None = None,
        effort: float = 0.3,
    ) -> None:
        import kb.planners.solver as solver  # slow, so not in a tick; and OR-tools may be missing

        if finite_number(effort) <= 0.0:
            raise InvalidValue(f"an effort is more than 0, not {effort!r}")
        if not isinstance(budgets, Mapping | None):
            raise InvalidValue(
                f"budgets are given as the most by name of attribute, not as {budgets!r}"
            )
        self._solver = solver
        self._given = Criterion({}, switching_cost, dict(budgets or {}))
        self._effort = effort
        self._last = WeakKeyDictionary[KnowledgeBase, tuple[Mapping[str, float], str]]()
        """By knowledge base: the weights of the last choice, and why there was none; empty if there was one."""
        self.latest: Optimum | None = None

    @property
    def budgets(self) -> Mapping[str, float]:
        """The most that the estimations of what is chosen or active may sum up to, by name of attribute."""
        return self._given.budgets

    def criterion(self, kb: KnowledgeBase) -> Criterion:
        """Return the criterion by the preferences of the actions that are required now."""
        weights = summed_weights(required.preference for required in kb.required_actions)
        return Criterion(weights, self._given.switching_cost, self._given.budgets)

    def choose(self, kb: KnowledgeBase) -> Choice | None:
        """Return what `plan` would select now; None if there is nothing to do."""
        return _choice(kb, self.optimum(kb) if self._is_due(kb) else None)

    def plan(self, kb: KnowledgeBase) -> ReconfigurationPlan | None:
        """Select for all that is required if something is adaptable or preferences changed; see `Planner`."""
        if kb not in self._last:  # a wrong name is an error at the first update
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
        self._last[kb] = weights, nothing  # last, so that an interrupted choice is repeated
        return plan

    def optimum(self, kb: KnowledgeBase) -> Optimum | None:
        """Return the best choice for the present state of a knowledge base; None if priority is to decide.

        Priority decides where nothing is estimated or limited, and where no choice was found within the effort.
        """
        criterion = self.criterion(kb)
        with kb.reading() as state:
            problem = self._solver.Problem(state, criterion)
        found = problem.solve(self._effort) if problem.is_weighed else None
        is_lost = (
            found is not None
            and found.choice is None
            and not (found.is_proven or criterion.budgets)
        )
        return None if is_lost else found

    def _is_due(self, kb: KnowledgeBase) -> bool:
        if kb.adaptable_functions() or kb.adaptable_components():
            return True
        return kb in self._last and self._last[kb][0] != self.criterion(kb).weights


def _choice(kb: KnowledgeBase, found: Optimum | None) -> Choice | None:
    """Return what to select; an empty choice, which gives up what is obsolete, if nothing else can be chosen."""
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
            return Choice({}, {})  # `kb.select` says why the plan is needed all the same
        return Choice(choice.designs, choice.configurations, found.reason)
