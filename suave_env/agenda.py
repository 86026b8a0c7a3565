"""What is to happen at which simulated time: events and free-running timers."""

import heapq
from collections.abc import Callable


class Agenda:
    """Events in order of time [s]; those of the same time in the order in which they were entered."""

    def __init__(self) -> None:
        self._events: list[tuple[float, int, Callable[[float], None]]] = []
        self._entered = 0

    @property
    def next_time(self) -> float:
        """Time of the next event [s]; infinite if there is none."""
        return self._events[0][0] if self._events else float("inf")

    def at(self, time: float, event: Callable[[float], None]) -> None:
        """Enter an event, which is called with its time [s]."""
        heapq.heappush(self._events, (time, self._entered, event))
        self._entered += 1

    def every(self, period: float, phase: float, event: Callable[[float], None]) -> None:
        """Enter a timer that runs freely from now on, called at `phase + k * period` [s] without accumulating error."""
        count = 0

        def tick(time: float) -> None:
            nonlocal count
            count += 1
            self.at(phase + count * period, tick)
            event(time)

        self.at(phase, tick)

    def happen(self) -> None:
        """Let the next event happen."""
        time, _, event = heapq.heappop(self._events)
        event(time)
