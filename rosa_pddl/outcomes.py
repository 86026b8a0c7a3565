"""How planning can end, and what the planner reports."""

from dataclasses import dataclass
from enum import Enum

from rosa_pddl.domain import Step, TimedStep


class Outcome(Enum):
    """How planning ended; if all attempts fail, the first outcome in this list that one of them had is reported."""

    SOLVED = "solved"
    SOLVED_OPTIMALLY = "solved optimally"
    UNSOLVABLE_PROVEN = "unsolvable proven"
    UNSOLVABLE_AS_FAR_AS_KNOWN = "unsolvable as far as known"
    OUT_OF_TIME = "out of time"
    OUT_OF_MEMORY = "out of memory"
    ENGINE_CRASHED = "engine crashed"
    UNSUPPORTED = "unsupported"
    ENGINE_MISSING = "engine missing"

    @property
    def is_solved(self) -> bool:
        """Whether there is a plan."""
        return self in (Outcome.SOLVED, Outcome.SOLVED_OPTIMALLY)

    @property
    def is_unsolvable(self) -> bool:
        """Whether there is no plan because the problem has none."""
        return self in (Outcome.UNSOLVABLE_PROVEN, Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN)

    @property
    def is_trouble(self) -> bool:
        """Whether there is no plan because of the engine, not because of the problem."""
        return not self.is_solved and not self.is_unsolvable

    @property
    def is_passing(self) -> bool:
        """Whether the trouble may be temporary, so that the same request may succeed later."""
        return self in (Outcome.OUT_OF_TIME, Outcome.OUT_OF_MEMORY, Outcome.ENGINE_CRASHED)

    def __str__(self) -> str:
        return self.value


class Trouble(Exception):
    """Raised if there is no answer; it carries the outcome to the planner, which reports it."""

    def __init__(self, outcome: Outcome, message: str) -> None:
        super().__init__(message)
        self.outcome = outcome


@dataclass(frozen=True)
class Attempt:
    """One way of planning that was tried.

    Args:
        way: `warm`, `cold`, `cache`, `certificate`, or the name of an engine of unified-planning.
        outcome: how it ended.
        message: what went wrong and what to do about it; empty when solved.
    """

    way: str
    outcome: Outcome
    message: str = ""

    def __str__(self) -> str:
        return f"{self.way}: {self.outcome}" + (f" ({self.message})" if self.message else "")


@dataclass(frozen=True)
class PlanningResult:
    """The answer of a planner.

    Args:
        outcome: how it ended.
        steps: the plan, in the order of their starts; empty unless solved.
        engine: the engine that answered, or that should have answered.
        message: without a plan, what was tried and what to do about it; with a plan, how much less another may cost at
            most, if costs had to be rounded because they are too far apart, else empty.
        cost: cost of the plan: the sum of its action costs if the problem has a metric, else the number of its steps.
        schedule: when each step starts and how long it takes, if steps may overlap; empty if they follow one another.
        attempts: what was tried, in order.
        safe_step: the step to do while there is no plan; None if there is a plan, or no safe step is set or can start.
    """

    outcome: Outcome
    steps: tuple[Step, ...] = ()
    engine: str = ""
    message: str = ""
    cost: float | None = None
    schedule: tuple[TimedStep, ...] = ()
    attempts: tuple[Attempt, ...] = ()
    safe_step: Step | None = None

    @property
    def hangs_on_the_clock(self) -> bool:
        """Whether an attempt ran out of wall-clock time, so that a faster machine might give another answer."""
        outcomes = {self.outcome, *(attempt.outcome for attempt in self.attempts)}
        return Outcome.OUT_OF_TIME in outcomes
