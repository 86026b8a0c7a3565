"""The log: every event that a knowledge base has known, in order."""

from collections import deque
from collections.abc import Iterator
from heapq import merge
from operator import attrgetter
from typing import Final

from kb.events import Event

__all__ = ["Log"]

_MOST: Final = 100_000
"""How many measurements, and how many other events, are held in memory; the newest."""

_NUMBER: Final = attrgetter("number")


class Log:
    """The events of a knowledge base by number, as far as they are held in memory.

    Measurements are far more than anything else and are held apart, so that they push nothing else out.

    Attributes:
        last: number of the last event; 0 before the first.
    """

    def __init__(self) -> None:
        self.last = 0
        self._measured: deque[Event] = deque(maxlen=_MOST)
        self._others: deque[Event] = deque(maxlen=_MOST)

    def append(self, event: Event) -> None:
        """Add the next event."""
        (self._measured if event.verb == "measure" else self._others).append(event)
        self.last = event.number

    def since(self, number: int) -> Iterator[Event]:
        """Yield the events after one, in order."""
        return merge(*(_later(events, number) for events in (self._measured, self._others)), key=_NUMBER)

    def __iter__(self) -> Iterator[Event]:
        return self.since(0)

    def __len__(self) -> int:
        return len(self._measured) + len(self._others)


def _later(events: deque[Event], number: int) -> list[Event]:
    """Return the events after one; there are mostly few, at the end."""
    later: list[Event] = []
    for event in reversed(events):
        if event.number <= number:
            break
        later.append(event)
    later.reverse()
    return later
