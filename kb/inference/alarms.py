"""When to look again: things that follow from time alone."""

import heapq
import math

__all__ = ["Alarms"]


class Alarms:
    """At most one alarm for each index, at a time of the clock.

    Attributes:
        next: no alarm is due before [s].
    """

    __slots__ = ("_queue", "_times", "next")

    def __init__(self) -> None:
        self._queue: list[tuple[float, int]] = []
        self._times: dict[int, float] = {}
        self.next = math.inf

    def set(self, index: int, time: float) -> None:
        """Set the alarm of an index, in place of the one that it has."""
        before = self._times.get(index)
        self._times[index] = time
        if before is None or time < before:  # one that is put off is found when it would have been due
            heapq.heappush(self._queue, (time, index))
            self.next = self._queue[0][0]

    def clear(self, index: int) -> None:
        """Take back the alarm of an index, if it has one."""
        self._times.pop(index, None)

    def due(self, now: float) -> list[int]:
        """Return the indices whose alarms are due, in order of time, and take these alarms back."""
        indices = []
        while self._queue and self._queue[0][0] <= now:
            _, index = heapq.heappop(self._queue)
            time = self._times.get(index)
            if time is not None and time <= now:
                del self._times[index]
                indices.append(index)
            elif time is not None:
                heapq.heappush(self._queue, (time, index))
        self.next = self._queue[0][0] if self._queue else math.inf
        return indices
