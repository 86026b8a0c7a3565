"""Why there is no plan: which of several goals are out of reach, and whether by what is unfeasible or by limits."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from rosa_pddl.domain import Domain, State, UpThing
from rosa_pddl.execution.goals import Goal
from rosa_pddl.planning import PlanningResult
from rosa_pddl.problem import Problem, unlimited

__all__ = ["Diagnosis"]


@dataclass(frozen=True)
class Diagnosis:
    """Further questions to the planner after it found no plan, and what their answers say.

    Args:
        domain: what `load_domain` returned.
        state: from which there is no plan.
        goals: that cannot all be reached.
        why: the answer of the planner, in words.
        costs: the values of numeric facts, as they were asked with.
        answers: to the questions so far, in order.
        is_open: whether there is anything to ask: not if it was the planner that failed.
    """

    domain: Domain
    state: State
    goals: tuple[Goal, ...]
    why: str
    costs: Mapping[str, float] = field(default_factory=dict)
    answers: tuple[PlanningResult, ...] = ()
    is_open: bool = True

    @property
    def next_question(self) -> Problem | None:
        """What to ask next; None if enough is known.

        First each goal alone, if there are several; then all of them, were every action feasible, or nothing limited.
        """
        questions = self._questions if self.is_open else []
        return questions[len(self.answers)]() if len(self.answers) < len(questions) else None

    def answered(self, result: PlanningResult) -> "Diagnosis":
        """Return the diagnosis with one more answer."""
        return replace(self, answers=(*self.answers, result))

    def __str__(self) -> str:
        return "; ".join(filter(None, [self.why, self._which(), self._if_all_were_feasible(), self._if_unlimited()]))

    @property
    def _questions(self) -> list[Callable[[], Problem]]:
        asked: list[Callable[[], Problem]] = [partial(self._problem, [goal]) for goal in self.goals[: self._singles]]
        if self._unfeasible:
            asked.append(partial(self._problem, self.goals, is_all_feasible=True))
        if self.domain.limited:
            asked.append(partial(self._problem, self.goals, is_limited=False))
        return asked

    @property
    def _singles(self) -> int:
        return len(self.goals) if len(self.goals) > 1 else 0

    @property
    def _unfeasible(self) -> tuple[str, ...]:
        if not self.domain.tracks_feasibility:
            return ()
        actions = self.domain.rosa_actions
        return tuple(action for action in actions if self.domain.feasible_atom(action) not in self.state)

    def _problem(self, goals: Sequence[Goal], *, is_all_feasible: bool = False, is_limited: bool = True) -> Problem:
        domain, state = self.domain, self.state
        if is_all_feasible:
            state |= {domain.feasible_atom(action) for action in domain.rosa_actions}
        if not is_limited:
            domain = unlimited(domain)
        expressions: tuple[UpThing, ...] = tuple(goal.expression for goal in goals)
        return Problem(domain, state, expressions, self.costs)

    def _which(self) -> str:
        if not self._singles or not self.is_open:
            return ""
        told = list(zip(self.goals, self.answers[: self._singles], strict=True))
        out = [goal.text for goal, answer in told if not answer.outcome.is_solved and not answer.outcome.is_trouble]
        unknown = [goal.text for goal, answer in told if answer.outcome.is_trouble]
        well = [goal.text for goal, answer in told if answer.outcome.is_solved]
        if not out and not unknown:
            return "each goal can be reached alone, but not all together"
        parts = [
            f"out of reach: {', '.join(out)}" if out else "",
            f"in reach alone: {', '.join(well)}" if well else "",
            f"not known: {', '.join(unknown)}" if unknown else "",
        ]
        return "; ".join(filter(None, parts))

    def _if_all_were_feasible(self) -> str:
        if not self._unfeasible or len(self.answers) <= self._singles:
            return ""
        last = self.answers[self._singles]
        if last.outcome.is_trouble:
            return ""
        names = ", ".join(self._unfeasible)
        if last.outcome.is_solved:
            return f"unfeasible now: {names}; there would be a plan if they were feasible"
        return "there would be no plan even if every action were feasible"

    def _if_unlimited(self) -> str:
        if not self.domain.limited or len(self.answers) < len(self._questions):
            return ""
        last = self.answers[-1]
        if last.outcome.is_trouble:
            return ""
        names = ", ".join(resource.name for resource in self.domain.limited)
        are = "would" if last.outcome.is_solved else "would not"
        return f"there {are} be a plan without the limits of {names}"
