"""The planner that chooses for all that is required at once, by what is estimated and preferred."""

from collections.abc import Mapping

from kb.choice import ChoiceExplanation, explain_choice
from kb.elements import Element, finite_number
from kb.exceptions import InvalidValue
from kb.knowledge_base import KnowledgeBase
from kb.manager import PriorityPlanner
from kb.optimum.posing import pose
from kb.reconfiguration import ReconfigurationPlan
from kb.selection import Criterion, Optimum, summed_weights
from kb.status import Status
from kb.views import ElementView

__all__ = ["OptimalPlanner"]


class OptimalPlanner:
    """Chooses the best joint configuration of all that is required, or says how far from the best it may be.

    When something is adaptable, everything required is chosen for again. Without a preference that an estimation bears
    on, and without budgets, it chooses as `PriorityPlanner` does.

    Args:
        switching_cost: what it costs to activate or deactivate a component or to change its configuration, the same
            for all or by name of the component; a gain smaller than that does not switch.
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
        import kb.optimum.solver as solver  # it takes a while: not in a tick, nor for those without it

        if finite_number(effort) <= 0.0:
            raise InvalidValue(f"an effort is more than 0, not {effort!r}")
        self._solver = solver
        self._by_priority = PriorityPlanner()
        self._given = Criterion({}, switching_cost, dict(budgets or {}))
        self._effort = effort
        self.latest: Optimum | None = None

    def criterion(self, kb: KnowledgeBase) -> Criterion:
        """Return what makes one choice better than another, given what is preferred now."""
        weights = summed_weights(required.preference for required in kb.required_actions)
        return Criterion(weights, self._given.switching_cost, self._given.budgets)

    def plan(self, kb: KnowledgeBase) -> ReconfigurationPlan | None:
        """Choose for all that is required if something is adaptable; see `Planner`."""
        if not kb.adaptable_functions() and not kb.adaptable_components():
            return self._by_priority.plan(kb)
        self.latest = self.optimum(kb)
        if self.latest is None:
            return self._by_priority.plan(kb)
        return kb.select(*self.latest.choice) if self.latest.choice else None

    def optimum(self, kb: KnowledgeBase) -> Optimum | None:
        """Return the best choice for a knowledge base as it is; None if it is to be chosen by priority."""
        criterion = self.criterion(kb)
        with kb._lock:
            problem = pose(kb._state, criterion)
        if not problem.is_touched and not criterion.budgets:
            return None
        return self._solver.solve(problem, self._effort)

    def explain_choice(self, kb: KnowledgeBase, element: ElementView | Element | str) -> ChoiceExplanation:
        """Say why a function or component has what it has, by this planner's criterion; see `kb.explain_choice`."""
        node, optimum, criterion = kb._node(element, ("function", "component")), self.optimum(kb), self.criterion(kb)
        preferred, said, designs = None, {}, None
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
            return explain_choice(kb._state, node, kb._clock(), preferred, said, designs)
