"""From goals to what the planner is asked, and back: what a plan promises, what it costs, whether another is better."""

from collections.abc import Callable, Iterable, Mapping

from rosa_pddl.domain import Domain, State
from rosa_pddl.execution.bounds import Bounds
from rosa_pddl.execution.course import Course
from rosa_pddl.execution.goals import Goal, Goals
from rosa_pddl.execution.hopes import Disappointment, Hopes
from rosa_pddl.execution.settled import Unsettled
from rosa_pddl.execution.soft_goals import SoftGoals
from rosa_pddl.planning import PlanningResult
from rosa_pddl.planning.costs import Costs
from rosa_pddl.planning.grounding import lock_of
from rosa_pddl.problem import Problem
from rosa_pddl.validate import goal_holds

__all__ = ["Quest"]

# Costs are sums of decimal numbers: less than this is no difference.
_SAME_COST = 1e-9


class Quest:
    """What shall be reached in a domain.

    Args:
        hopes: the domain, as far as it is relied upon.
        numbers: returns the values, now, of numeric facts that costs are made of; the others are those of the problem
            file.

    Raises:
        UnsupportedPddlError: the metric cannot be kept.
    """

    def __init__(self, hopes: Hopes, numbers: Callable[[], Mapping[str, float]]) -> None:
        self._hopes, self._numbers = hopes, numbers
        self._unsettled = Unsettled(hopes.domain)
        self._soft: tuple[Domain, tuple[Goal, ...], SoftGoals] | None = None
        self._bounds = Bounds(self.domain)
        with lock_of(self.domain):
            self._costs = Costs(self.domain, Problem(self.domain, frozenset()).build())

    @property
    def domain(self) -> Domain:
        """What is planned with: the domain without the hopes that are in doubt."""
        return self._hopes.domain

    @property
    def doubts(self) -> tuple[Disappointment, ...]:
        """The hopes that are in doubt."""
        return self._hopes.doubts

    def is_no_easier(self, then: Mapping[str, float]) -> bool:
        """Whether what could not be reached with some numbers cannot be reached now, by its limits."""
        return self._bounds.leave_no_more(self._numbers(), then)

    def overspent(self, course: Course) -> str | None:
        """Return which limit the steps break that have not started, in words; None if they keep them all.

        What runs is passed over: part of what it uses may be in what is sensed already.
        """
        over = self._bounds.overspent((course.steps[number] for number in course.remaining), self._numbers())
        return None if over is None else f"the rest of the plan is too much: {over}"

    def problem(self, state: State, goals: Goals) -> Problem:
        """Return what to ask the planner."""
        hard = self._unsettled.of((goal.expression for goal in goals.hard), state)
        if not goals.soft:
            return Problem(self.domain, state, hard, self._numbers())
        soft = self._softened(goals.soft)
        return Problem(soft.domain, state, (*hard, soft.goal), self._numbers())

    def read(self, result: PlanningResult, goals: Goals) -> tuple[PlanningResult, tuple[Goal, ...]]:
        """Return an answer in the words of the domain, and the goals that its plan reaches."""
        if not goals.soft:
            return result, goals.hard
        kept, reached = self._softened(goals.soft).kept(result)
        return kept, goals.hard + reached

    def aimed(self, course: Course, state: State, goals: Goals) -> Course:
        """Return a course that has to reach the goals as they are now; of the soft ones those that it reaches."""
        soft = _holding(self.domain, goals.soft, course.replay(state).facts)
        return course.with_goals(goals.hard + soft)

    def is_over(self, state: State, goals: Goals, course: Course | None) -> bool:
        """Whether nothing is left to do: the goals hold, or those that do not are not worth it, as the plan found."""
        if len(_holding(self.domain, goals.hard, state)) < len(goals.hard):
            return False
        if course is not None and course.is_finished:
            return True
        return len(_holding(self.domain, goals.soft, state)) == len(goals.soft)

    def is_better(self, new: Course, after: State, old: Course, now: State, goals: Goals) -> bool:
        """Whether a course, begun in a state, works and costs less than the rest of another one, now."""
        if new.replay(after).flaw is not None or self.overspent(new) is not None:
            return False
        return self._price(new, after, goals) < self._price(old, now, goals) - _SAME_COST

    def _price(self, course: Course, state: State, goals: Goals) -> float:
        """Return the cost of what has not ended, and the worth of the goals that are forgone."""
        facts = course.replay(state).facts
        forgone = sum(goal.worth or 0.0 for goal in goals.soft if not goal_holds(self.domain, facts, [goal.expression]))
        numbers = self._costs.numbers(Problem(self.domain, frozenset(), costs=self._numbers()))
        return forgone + self._costs.total(course.unfinished_steps, numbers)

    def _softened(self, goals: tuple[Goal, ...]) -> SoftGoals:
        domain = self.domain
        if self._soft is None or self._soft[:2] != (domain, goals):
            with lock_of(domain):
                self._soft = domain, goals, SoftGoals.of(domain, goals)
        return self._soft[2]


def _holding(domain: Domain, goals: Iterable[Goal], facts: State) -> tuple[Goal, ...]:
    return tuple(goal for goal in goals if goal_holds(domain, facts, [goal.expression]))
