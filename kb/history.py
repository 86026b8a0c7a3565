"""What was so before: earlier measurements, and the processes that components ran as."""

from array import array
from bisect import bisect_right
from dataclasses import dataclass

__all__ = ["History", "Process"]


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
