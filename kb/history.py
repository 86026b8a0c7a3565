"""What was so before: earlier measurements, processes that components ran as, and what became of plans."""

from array import array
from bisect import bisect_right
from dataclasses import dataclass
from typing import Final

from kb.elements import Parameters
from kb.reconfiguration import ReconfigurationPlan

__all__ = ["Attempt", "History", "KEPT_RECORDS", "Process", "VetoAnswer"]

KEPT_RECORDS: Final = 10_000
"""How many attempts and how many answers are remembered; the newest."""


class History:
    """Every measurement of one attribute, by time; 16 bytes each."""

    __slots__ = ("_times", "_values")

    def __init__(self) -> None:
        self._times = array("d")
        self._values = array("d")

    def add(self, time: float, value: float) -> None:
        """Add a measurement; mostly it is the newest."""
        if not self._times or time >= self._times[-1]:
            self._times.append(time)
            self._values.append(value)
        else:
            place = bisect_right(self._times, time)
            self._times.insert(place, time)
            self._values.insert(place, value)

    def at(self, time: float) -> float | None:
        """Return the value that was the latest at a time [s], or None before the first."""
        place = bisect_right(self._times, time)
        return self._values[place - 1] if place else None

    def samples(self) -> tuple[tuple[float, float], ...]:
        """Return all of it as (time [s], value)."""
        return tuple(zip(self._times, self._values, strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class Process:
    """A process of the operating system as which a component ran, or runs; only the knowledge base can end it.

    Attributes:
        component: name of the component.
        pid: number of the process.
        start: when it was started [s].
        end: when it ended [s], None while it runs.
    """

    component: str
    pid: int
    start: float
    end: float | None = None

    def _finish(self, end: float) -> None:
        object.__setattr__(self, "end", end)


@dataclass(frozen=True, slots=True, eq=False)
class Attempt:
    """One command that was given once; only the knowledge base can end it.

    Attributes:
        plan: what it was part of.
        component: name of what was commanded.
        operation: "activate", "deactivate" or "configure".
        configuration: name of what the component was to be configured with, None for a switch.
        parameters: what was to be set; empty for a switch.
        number: 1 for the first time that the plan gave this command.
        start: when it was given [s].
        end: when it was found to have ended [s], None while it is under way.
        result: "completed", "failed" or "abandoned", None while it is under way.
        reason: why it failed, in words, or what was odd about it.
    """

    plan: ReconfigurationPlan
    component: str
    operation: str
    configuration: str | None
    parameters: Parameters
    number: int
    start: float
    end: float | None = None
    result: str | None = None
    reason: str = ""

    def __str__(self) -> str:
        outcome = f"{self.result or 'under way'}: {self.reason}" if self.reason else self.result or "under way"
        return f"{self.operation} {self.component}, attempt {self.number}: {outcome}"

    def _finish(self, result: str, reason: str, end: float) -> None:
        object.__setattr__(self, "end", end)
        object.__setattr__(self, "result", result)
        object.__setattr__(self, "reason", reason)


@dataclass(frozen=True, slots=True)
class VetoAnswer:
    """What was answered about a plan before it was executed.

    Attributes:
        plan: what was asked about.
        time: when [s].
        is_vetoed: it was not to be executed.
        reason: why not, in words.
    """

    plan: ReconfigurationPlan
    time: float
    is_vetoed: bool
    reason: str = ""
