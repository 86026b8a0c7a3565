"""Why there is no plan: which of several goals cannot be reached, and whether it is for want of feasible actions."""

from dataclasses import dataclass, replace

from rosa_pddl.domain import Domain, State, UpThing
from rosa_pddl.goals import Goal
from rosa_pddl.planning import PlanningResult
from rosa_pddl.problem import Problem

__all__ = ["Diagnosis"]


@dataclass(frozen=True)
class Diagnosis:
    """Further questions to the planner after it found no plan, and what their answers say.

    Args:
        domain: what `load_domain` returned.
        state: from which there is no plan.
        goals: that cannot all be reached.
        why: the answer of the planner, in words.
        answers: to the questions so far, in order.
        is_open: whether there is anything to ask: not if it was the planner that failed.
    """

    domain: Domain
    state: State
    goals: tuple[Goal, ...]
    why: str
    answers: tuple[PlanningResult, ...] = ()
    is_open: bool = True

    @property
    def next_question(self) -> Problem | None:
        """What to ask next; None if enough is known.

        First each goal alone, if there are several; then all of them, were every action feasible.
        """
        if not self.is_open:
            return None
        done = len(self.answers)
        if done < self._singles:
            return self._problem([self.goals[done]], self.state)
        if done == self._singles and self._unfeasible:
            feasible = {self.domain.feasible_atom(action) for action in self.domain.rosa_actions}
            return self._problem(self.goals, self.state | feasible)
        return None

    def answered(self, result: PlanningResult) -> "Diagnosis":
        """Return the diagnosis with one more answer."""
        return replace(self, answers=(*self.answers, result))

    def __str__(self) -> str:
        return "; ".join(filter(None, [self.why, self._which(), self._if_all_were_feasible()]))

    @property
    def _singles(self) -> int:
        return len(self.goals) if len(self.goals) > 1 else 0

    @property
    def _unfeasible(self) -> tuple[str, ...]:
        if not self.domain.tracks_feasibility:
            return ()
        actions = self.domain.rosa_actions
        return tuple(action for action in actions if self.domain.feasible_atom(action) not in self.state)

    def _problem(self, goals: "list[Goal] | tuple[Goal, ...]", state: State) -> Problem:
        expressions: tuple[UpThing, ...] = tuple(goal.expression for goal in goals)
        return Problem(self.domain, state, expressions)

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
        if len(self.answers) <= self._singles:
            return ""
        last = self.answers[self._singles]
        if last.outcome.is_trouble:
            return ""
        names = ", ".join(self._unfeasible)
        if last.outcome.is_solved:
            return f"unfeasible now: {names}; there would be a plan if they were feasible"
        return "there would be no plan even if every action were feasible"
