"""Answers in lock-step simulation: waited for, and never dependent on how quick the machine is."""

from concurrent.futures import Future, wait

from rosa_pddl.exceptions import PlanningBudgetError
from rosa_pddl.planning.outcomes import PlanningResult

__all__ = ["awaited"]


def awaited(future: "Future[PlanningResult]", budget_s: float) -> PlanningResult:
    """Wait for an answer that is due; for the time between ticks, as a tick never waits.

    Args:
        future: what `Planner.start` returned.
        budget_s: wall-clock time to wait at most [s]; then the planning is cancelled.

    Raises:
        PlanningBudgetError: the answer was not there in time, or part of what was tried for it ran out of wall-clock
            time, so that a quicker machine might have decided otherwise.
    """
    finished, _ = wait([future], timeout=budget_s)
    if not finished:
        future.cancel()
        raise PlanningBudgetError(
            f"no plan after {budget_s:g} s of waiting, and going on without would make the run depend on the machine; "
            "allow more time or ask for less"
        )
    result = future.result()
    if result.hangs_on_the_clock:
        tried = "; ".join(str(attempt) for attempt in result.attempts) or result.message
        raise PlanningBudgetError(
            f"planning ran out of wall-clock time, and going on would make the run depend on the machine: {tried}"
        )
    return result
