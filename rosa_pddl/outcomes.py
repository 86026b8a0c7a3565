"""How a planning can end, and what is reported of it."""

from dataclasses import dataclass
from enum import Enum

from rosa_pddl.domain import Step, TimedStep


class Outcome(Enum):
    """How a planning ended; of what was tried in vain, the first of these that was met is the outcome of all."""

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
        """Whether the problem is why there is no plan."""
        return self in (Outcome.UNSOLVABLE_PROVEN, Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN)

    @property
    def is_trouble(self) -> bool:
        """Whether the engine, not the problem, is why there is no plan."""
        return not self.is_solved and not self.is_unsolvable

    @property
    def is_passing(self) -> bool:
        """Whether it may go well when the same is asked again: it is trouble, and none that stays."""
        return self in (Outcome.OUT_OF_TIME, Outcome.OUT_OF_MEMORY, Outcome.ENGINE_CRASHED)

    def __str__(self) -> str:
        return self.value


class Trouble(Exception):
    """Why there is no answer: an outcome on its way to the planner, which reports it."""

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
        engine: the engine that answered, or the one that was to answer.
        message: what was tried and what to do about it; of a plan, by how much at most another may cost less, if costs
            that are too far apart had to be rounded, else empty.
        cost: of the plan: the sum of its action costs if the problem has a metric, else the number of its steps.
        schedule: when each step starts and how long it takes, if steps may overlap; empty if they follow one another.
        attempts: what was tried, in order.
        safe_step: what to do while there is no plan; None if there is a plan, or no such step was named or can start.
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
        """Whether something ran out of wall-clock time, so that a quicker machine might have answered otherwise."""
        outcomes = {self.outcome, *(attempt.outcome for attempt in self.attempts)}
        return Outcome.OUT_OF_TIME in outcomes
