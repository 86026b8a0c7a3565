"""The log: every event that a knowledge base has known, in order; and those who hear of them."""

import logging
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from heapq import merge
from operator import attrgetter
from threading import Lock
from typing import Final

from kb.events import Event
from kb.exceptions import InvalidValue

__all__ = ["Log", "Publisher"]

_MOST: Final = 100_000
"""How many measurements, and how many other events, are held in memory; the newest."""

_NUMBER: Final = attrgetter("number")

_log = logging.getLogger(__name__)


class Log:
    """The events of a knowledge base by number, as far as they are held in memory.

    Measurements are far more than anything else and are held apart, so that they push nothing else out.

    Attributes:
        last: number of the last event; 0 before the first.
        heard: called with nothing when there is a new event.
    """

    def __init__(self) -> None:
        self.last = 0
        self.heard: Callable[[], None] | None = None
        self._measured: deque[Event] = deque(maxlen=_MOST)
        self._others: deque[Event] = deque(maxlen=_MOST)

    def append(self, event: Event) -> None:
        """Add the next event; it may be done again."""
        events = self._measured if event.verb == "measure" else self._others
        if not events or events[-1].number < event.number:
            events.append(event)
        self.last = event.number
        if self.heard is not None:
            self.heard()

    def since(self, number: int, *, measurements: bool = True) -> Iterator[Event]:
        """Yield the events after one, in order, with the measurements among them or without."""
        others = _later(self._others, number)
        return merge(_later(self._measured, number), others, key=_NUMBER) if measurements else iter(others)

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


class Publisher:
    """Calls every subscriber with every event of a log, one event at a time, in order.

    No lock is held while a subscriber is called. An event that it causes comes after the one that it is called with;
    so does one of another thread, which need not wait for that.

    Args:
        log: the events.
        lock: held while events are added to the log.

    Attributes:
        is_heard: there are subscribers.
    """

    def __init__(self, log: Log, lock: AbstractContextManager[object]) -> None:
        self._log, self._lock = log, lock
        self._subscribers: list[Callable[[Event], None]] = []
        self.is_heard = False
        self._heard = 0
        self._turn = Lock()

    def subscribe(self, callback: Callable[[Event], None]) -> Callable[[], None]:
        """Have a function called with every event from now on; returns how to stop that."""
        if not callable(callback):
            raise InvalidValue(f"a subscriber is called with each event; {callback!r} cannot be called")
        with self._lock:
            if not self._subscribers:
                self._heard = self._log.last
            self._subscribers.append(callback)
            self.is_heard = True

        def unsubscribe() -> None:
            if callback in self._subscribers:
                self._subscribers.remove(callback)
            self.is_heard = bool(self._subscribers)

        return unsubscribe

    def deliver(self) -> None:
        """Call the subscribers with what is new, unless a thread is at it already, which then does this too."""
        while self._subscribers and self._heard < self._log.last and self._turn.acquire(blocking=False):
            try:
                with self._lock:
                    events = list(self._log.since(self._heard))
                for event in events:
                    self._heard = event.number
                    self._call(event)
            finally:
                self._turn.release()

    def _call(self, event: Event) -> None:
        for subscriber in tuple(self._subscribers):
            try:
                subscriber(event)
            except Exception:
                _log.exception("a subscriber failed on %r", event.text)
