"""The engine `label-setting`: plans of least cost within limits, as resource-constrained shortest paths.

After Desrochers and Soumis, "A generalized permanent labelling algorithm for the shortest path problem with time
windows", INFOR 26, 1988.
"""

import sys
from collections.abc import Sequence
from fractions import Fraction

from rosa_pddl import search
from rosa_pddl.exceptions import UnsupportedPddlError
from rosa_pddl.planning.downward import SEARCHES, Answer, Trouble, install_advice
from rosa_pddl.planning.grounded import Fitted, Grounded, Ready
from rosa_pddl.planning.outcomes import Outcome
from rosa_pddl.planning.processes import Ended, Leash
from rosa_pddl.planning.sums import Sum
from rosa_pddl.planning.uses import Uses, whole
from rosa_pddl.problem import Exact, Problem
from rosa_pddl.search import Operation, Rule, Task, written

__all__ = ["LABEL_SETTING", "TRANSLATED", "label_search", "task_of"]

LABEL_SETTING = "label-setting"
"""The name of the engine."""
TRANSLATED = (*SEARCHES, LABEL_SETTING)
"""The engines that search what Fast Downward's translator wrote."""


def label_search(
    grounded: Grounded, problem: Problem, uses: Uses, leash: Leash, *, limit_s: float, memory_bytes: int | None
) -> Answer:
    """Search a plan of least cost that keeps to the limits of the domain's resources.

    Args:
        grounded: the translated task.
        problem: what is put into it.
        uses: what steps use up.
        leash: runs the program.
        limit_s: wall-clock time that it may take [s].
        memory_bytes: how much data it may hold [B].

    Raises:
        NotRepresentableError: the task does not fit.
        UnreachableGoalError: a fact of the goal cannot become true.
        UnsupportedPddlError: an amount has no value, or one below 0.
        Trouble: there is no answer.
        Cut: the leash was cut.
    """
    task, scales = task_of(grounded.fitted(problem), problem, uses)
    command = [sys.executable, "-I", "-S", search.__file__]
    try:
        ended = leash.run(command, given=written(task), limit_s=limit_s, memory_bytes=memory_bytes)
    except OSError as error:
        message = f"no process for it can be started ({error}); {install_advice()}"
        raise Trouble(Outcome.ENGINE_MISSING, message) from error
    kind, numbers = _read(ended, limit_s)
    if kind == "plan":
        return Answer(Outcome.SOLVED_OPTIMALLY, tuple(map(int, numbers)))
    if not scales or "inf" in numbers:
        return Answer(Outcome.UNSOLVABLE_PROVEN)
    least = [Fraction(int(amount), scale) for amount, scale in zip(numbers, scales, strict=True)]
    return Answer(Outcome.UNSOLVABLE_PROVEN, why=_why_not(problem, least, uses))


def _why_not(problem: Problem, least: Sequence[Exact], uses: Uses) -> str:
    """Say which limits keep from the goal."""
    limited = zip(problem.domain.limited, least, uses.left(uses.numbers(problem)), strict=True)
    broken = [
        f"{resource.name} takes {float(amount):.12g} at least, {float(left.amount):.12g} are left"
        for resource, amount, left in limited
        if left.is_exceeded_by(amount)
    ]
    return "; ".join(broken) or f"no plan keeps the limits of {', '.join(one.name for one in problem.domain.limited)}"


def task_of(fitted: Fitted, problem: Problem, uses: Uses) -> tuple[Task, tuple[int, ...]]:
    """Return what is searched, in whole numbers, and by what the amounts of each resource were multiplied.

    Raises:
        UnsupportedPddlError: an amount has no value, or one below 0.
    """
    domain, numbers = problem.domain, uses.numbers(problem)

    def column(sums: Sequence[Sum], what: str) -> tuple[list[int], int]:
        amounts = [uses.value(one, numbers) if one.terms else one.constant for one in sums]
        least = min(amounts, default=0)
        if least < 0:
            told = " + ".join(text for _, text in sums[amounts.index(least)].terms)
            raise UnsupportedPddlError(f"{told} comes to {float(least):g}; {what} are 0 or more", domain.problem_file)
        return whole(amounts)

    columns, limits, scales = [column([one.cost for one in fitted.ready], "costs")[0]], [], []
    for index, left in enumerate(uses.left(numbers)):
        amounts, scale = column([one.uses[index] for one in fitted.ready], f"uses of {domain.limited[index].name}")
        columns.append(amounts)
        limits.append(left.whole(scale))
        scales.append(scale)
    spent = zip(*columns, strict=True)
    operations = [_operation(one, cost, used) for one, (cost, *used) in zip(fitted.ready, spent, strict=True)]
    rules = tuple([Rule(fitted.layers[one.variable], one.needs, one.variable, one.value) for one in fitted.axioms])
    task = Task(fitted.sizes, fitted.state, fitted.goal, tuple(operations), tuple(limits), rules)
    return task, tuple(scales)


def _operation(ready: Ready, cost: int, uses: Sequence[int]) -> Operation:
    before = [(variable, value) for _, variable, value, _ in ready.effects if value >= 0]
    effects = tuple([(given, variable, after) for given, variable, _, after in ready.effects])
    return Operation(ready.number, tuple(sorted({*ready.prevail, *before})), effects, cost, tuple(uses))


def _read(ended: Ended, limit_s: float) -> tuple[str, list[str]]:
    """Return what kind of answer it is, and its numbers."""
    if ended.is_late:
        raise Trouble(Outcome.OUT_OF_TIME, f"no answer after {limit_s:.3g} s; allow more time or ask for less")
    kind, *numbers = ended.output.decode(errors="replace").split() or [""]
    if MemoryError.__name__ in ended.last_words:
        raise Trouble(Outcome.OUT_OF_MEMORY, "the search ran out of memory; allow more or ask for less")
    if kind not in ("plan", "least"):
        message = f"the search ended with exit code {ended.code} and no answer. It said: {ended.last_words}"
        raise Trouble(Outcome.ENGINE_CRASHED, message)
    return kind, numbers
