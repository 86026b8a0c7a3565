"""What a knowledge base tells those who listen: the original's three kinds of events, in order."""

import logging
from collections import deque
from collections.abc import Callable
from enum import StrEnum
from threading import get_ident
from typing import Any, NamedTuple

from kb.exceptions import InvalidValue
from kb.reconfiguration import ReconfigurationPlan
from kb.status import Status

__all__ = ["Event", "EventKind", "Publisher", "StatusChange", "Told"]

_log = logging.getLogger(__name__)


class EventKind(StrEnum):
    """What kind of knowledge arrived."""

    MONITORING_DATA = "monitoring data"
    ACTION_UPDATE = "action update"
    RECONFIGURATION_PLAN = "reconfiguration plan"


class StatusChange(NamedTuple):
    """A status that is not what it was."""

    kind: str
    name: str
    old: Status
    new: Status


class Told(NamedTuple):
    """What was told, as data: `getattr(kb, verb)(*arguments)` tells it again.

    Attributes:
        verb: name of the method of the knowledge base, e.g. "measure".
        arguments: all of them, in its order, those that were left out too: names as in the model, numbers, reasons
            and times exactly, and what `assert_status` and its like are about as the element of the model.
    """

    verb: str
    arguments: tuple[Any, ...]


class Event(NamedTuple):
    """Something was told to the knowledge base, or has become so with time.

    Attributes:
        kind: one of the three kinds.
        time: when [s].
        subject: name of the attribute, component, action or other element that it is about; empty for a plan.
        text: what, in words, e.g. "light is 0.3" or "gripper has failed".
        changes: the statuses that changed because of it.
        plan: the plan, for a reconfiguration plan.
        told: the same as `text`, as data; None if nobody told it: time did it, the model was amended, or the store
            says how it is.
    """

    kind: EventKind
    time: float
    subject: str
    text: str
    changes: tuple[StatusChange, ...] = ()
    plan: ReconfigurationPlan | None = None
    told: Told | None = None


class Publisher:
    """Tells every event to every subscriber, one event at a time, in order."""

    def __init__(self) -> None:
        self._subscribers: list[Callable[[Event], None]] = []
        self._events: deque[Event] = deque()
        self._thread: int | None = None

    @property
    def is_telling_here(self) -> bool:
        """Whether the thread that asks is a subscriber's, which hears an event."""
        return self._thread == get_ident()

    def __bool__(self) -> bool:
        return bool(self._subscribers)

    def subscribe(self, callback: Callable[[Event], None]) -> Callable[[], None]:
        """Have a function called with every event; returns how to stop that."""
        if not callable(callback):
            raise InvalidValue(f"a subscriber is called with each event; {callback!r} cannot be called")
        self._subscribers.append(callback)

        def unsubscribe() -> None:
            if callback in self._subscribers:
                self._subscribers.remove(callback)

        return unsubscribe

    def publish(self, event: Event) -> None:
        """Tell an event; one that a subscriber causes is told after the event that it is hearing."""
        self._events.append(event)
        if len(self._events) > 1:
            return
        self._thread = get_ident()
        try:
            while self._events:
                try:
                    self._tell(self._events[0])
                finally:  # a subscriber may be interrupted; the next event is told all the same
                    self._events.popleft()
        finally:
            self._thread = None

    def _tell(self, event: Event) -> None:
        for subscriber in tuple(self._subscribers):
            try:
                subscriber(event)
            except Exception:
                _log.exception("a subscriber failed on %r", event.text)
