"""Why there is no plan: which part of the goal is out of reach, and what would have to be feasible."""

from collections.abc import Callable, Iterable, Sequence

from missions.planning.question import Question
from rosa_pddl import PlanningResult, Problem
from rosa_pddl.formulas import Condition

__all__ = ["why_unsolvable"]

Plan = Callable[[Problem], PlanningResult]


def why_unsolvable(question: Question, plan: Plan) -> list[str]:
    """Say in sentences why a question has no plan, by planning for less, with more being feasible, and without limits.

    Args:
        question: of which the planner said that it is unsolvable.
        plan: asks the planner. What it cannot answer in its time is not told.
    """
    out = question.unfeasible
    own = question.why_not()
    said = [own] if own else []
    if not out:
        return [_unreachable(question, out, plan, "whatever is done"), *said]
    if _unsolvable(plan(question.supposing(()))):
        return [_unreachable(question, (), plan, "even if every action were feasible"), *said]
    told = [_unreachable(question, out, plan, "as it is"), *said]
    needed = _needed(question, plan)
    return [*told, f"there would be a plan if {needed} were feasible"] if needed else told


def _unreachable(question: Question, unfeasible: Sequence[str], plan: Plan, how: str) -> str:
    """Say what cannot be reached while these actions are unfeasible, and whether that is for the limits."""
    limited = _listed([resource.name for resource in question.domain.limited], "and")
    if not limited:
        return _told(question, _lost(question, unfeasible, plan), how)
    free = question.unlimited
    result = plan(free.supposing(unfeasible))
    if _unsolvable(result):
        return _told(question, _lost(free, unfeasible, plan), f"{how}, with or without the limits of {limited}")
    within = f"{how} within the limits of {limited}" if result.outcome.is_solved else how
    return _told(question, _lost(question, unfeasible, plan), within)


def _unsolvable(result: PlanningResult) -> bool:
    return not result.outcome.is_solved and not result.outcome.is_trouble


def _lost(question: Question, unfeasible: Iterable[str], plan: Plan) -> list[Condition]:
    """Return the parts of the goal that cannot be reached even by themselves."""
    return [one for one in question.goals if _unsolvable(plan(question.supposing(unfeasible, [one])))]


def _needed(question: Question, plan: Plan) -> str:
    """Return the unfeasible actions of which one is enough; or else several, none of which can be spared."""

    def enough(feasible: Sequence[str]) -> bool:
        out = [action for action in question.unfeasible if action not in feasible]
        return plan(question.supposing(out)).outcome.is_solved

    single = [action for action in question.unfeasible if enough([action])]
    if single:
        return _listed(single, "or")
    needed = list(question.unfeasible)
    if not enough(needed):
        return ""
    for action in question.unfeasible:
        fewer = [one for one in needed if one != action]
        needed = fewer if enough(fewer) else needed
    return _listed(needed, "and")


def _told(question: Question, lost: Sequence[Condition], how: str) -> str:
    if lost:
        return f"{_listed([str(one) for one in lost], 'and')} cannot be reached, {how}"
    if len(question.goals) > 1:
        return f"each part of the goal may be reached by itself, but not all of them together, {how}"
    return f"the goal cannot be reached, {how}"


def _listed(names: Sequence[str], word: str) -> str:
    return "".join(names) if len(names) < 2 else f"{', '.join(names[:-1])} {word} {names[-1]}"
