"""Soft goals as costs: a domain in which each is either collected, for nothing, or forgone, at the cost of its worth.

The compilation of Keyder and Geffner ("Soft goals can be compiled away", JAIR 36, 2009): when all else is done, a plan
has to settle each soft goal by one of two actions, of which the first needs the goal to hold. The cheapest plan then is
the one with the best net benefit, so that any planner that heeds costs will do.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction

from rosa_pddl.domain import Domain, Schema, Step, UpThing
from rosa_pddl.execution.goals import Goal
from rosa_pddl.planning import PlanningResult
from rosa_pddl.problem import action_costs

__all__ = ["SoftGoals"]


@dataclass(frozen=True, eq=False)
class SoftGoals:
    """Goals that may be given up, as part of a domain.

    Args:
        domain: with actions that settle each goal.
        base: without.
        goal: what must hold for all to be settled, as unified-planning's expression.
        collected_by: the goal that an action collects, by the action's name.
    """

    domain: Domain
    base: Domain
    goal: UpThing
    collected_by: Mapping[str, Goal]

    @classmethod
    def of(cls, base: Domain, goals: tuple[Goal, ...]) -> "SoftGoals":
        """Make the domain for some soft goals, of which there is at least one.

        Raises:
            UnsupportedPddlError: the problem has a metric that is no action cost.
        """
        return _Compilation(base, goals).made()

    def kept(self, result: PlanningResult) -> tuple[PlanningResult, tuple[Goal, ...]]:
        """Return a plan without the steps that settle goals, and the soft goals that it reaches."""
        schedule = tuple(timed for timed in result.schedule if self._is_real(timed.step))
        steps = tuple(step for step in result.steps if self._is_real(step))
        reached = tuple(self.collected_by[step.schema] for step in result.steps if step.schema in self.collected_by)
        return replace(result, steps=steps, schedule=schedule), reached

    def _is_real(self, step: Step) -> bool:
        return step.schema in self.base.schema_of


class _Compilation:
    def __init__(self, base: Domain, goals: tuple[Goal, ...]) -> None:
        self._base, self._goals = base, goals
        self._problem = base.up_problem.clone()
        self._manager = self._problem.environment.expression_manager
        self._schemas = dict(base.schema_of)
        self._inside, self._outside = dict(base.inside), dict(base.outside)
        self._costs: dict[UpThing, UpThing] = {}
        self._collected_by: dict[str, Goal] = {}

    def made(self) -> SoftGoals:
        from unified_planning.model.metrics import MinimizeActionCosts

        self._take_costs()
        settling = self._fluent("settling")
        self._forbid(settling)
        settled = self._manager.TRUE()
        for number, goal in enumerate(self._goals):
            this = self._fluent(f"settled_{number}")
            collect = self._action(f"collect_{number}", (settled, goal.expression), (settling, this))
            self._collected_by[collect] = goal
            self._action(f"forgo_{number}", (settled,), (settling, this), goal.worth)
            settled = this
        self._problem.clear_quality_metrics()
        metric = MinimizeActionCosts(self._costs, self._manager.Int(0), self._problem.environment)
        self._problem.add_quality_metric(metric)
        domain = replace(
            self._base,
            schemas=tuple(self._schemas),
            schema_of=self._schemas,
            up_problem=self._problem,
            inside=self._inside,
            outside=self._outside,
            _atoms={},
        )
        return SoftGoals(domain, self._base, settled, self._collected_by)

    def _take_costs(self) -> None:
        given, zero, one = action_costs(self._base), self._manager.Int(0), self._manager.Int(1)
        for action in self._problem.actions:
            known = self._base.up_problem.action(action.name)
            self._costs[action] = one if given is None else given.get_action_cost(known) or zero

    def _forbid(self, settling: UpThing) -> None:
        """No action but those that settle may follow one that settles."""
        from unified_planning.model import ClosedTimeInterval, EndTiming, StartTiming

        never = self._manager.Not(settling)
        for action in self._problem.actions:
            schema = self._schemas[self._outside[action.name]]
            if hasattr(action, "add_precondition"):
                action.add_precondition(never)
                self._schemas[schema.name] = replace(schema, start=(*schema.start, never))
            else:
                action.add_condition(ClosedTimeInterval(StartTiming(), EndTiming()), never)
                self._schemas[schema.name] = replace(schema, over_all=(*schema.over_all, never))

    def _fluent(self, name: str) -> UpThing:
        unique = self._unique(name)
        self._outside[unique] = unique
        self._inside["predicate", unique] = unique
        return self._problem.add_fluent(unique, default_initial_value=False)()

    def _action(
        self, name: str, needed: tuple[UpThing, ...], made: tuple[UpThing, ...], cost: float | None = None
    ) -> str:
        from unified_planning.model import InstantaneousAction

        unique = self._unique(name)
        action = InstantaneousAction(unique, _env=self._problem.environment)
        for condition in needed:
            action.add_precondition(condition)
        for fluent in made:
            action.add_effect(fluent, True)
        self._problem.add_action(action)
        self._costs[action] = self._number(cost or 0.0)
        self._outside[unique] = unique
        self._inside["action", unique] = unique
        self._schemas[unique] = Schema(unique, (), needed, (), (), (), tuple(action.effects), None)
        return unique

    def _number(self, value: float) -> UpThing:
        if float(value).is_integer():
            return self._manager.Int(int(value))
        return self._manager.Real(Fraction(value).limit_denominator(1000))

    def _unique(self, name: str) -> str:
        while name in self._outside:
            name += "_"
        return name
