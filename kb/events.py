"""Events: everything that becomes known, as data that can be told again; the log of them, and who hears of them."""

import logging
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from enum import StrEnum
from heapq import merge
from operator import attrgetter
from threading import Lock
from typing import Any, Final, NamedTuple, Self

from kb.exceptions import InvalidValue
from kb.records import ReconfigurationPlan
from kb.status import Status


class EventKind(StrEnum):
    """What kind of knowledge arrived: the original's three kinds, and what is only put on record."""

    MONITORING_DATA = "monitoring data"
    ACTION_UPDATE = "action update"
    RECONFIGURATION_PLAN = "reconfiguration plan"
    RECORD = "record"


RECORDS: Final = frozenset(
    {
        "component_configured",
        "component_started",
        "component_ended",
        "finish_plan",
        "record_attempt",
        "finish_attempt",
        "record_answer",
        "store",
    }
)
"""The verbs of what is only put on record, and changes no fact of the state."""


class StatusChange(NamedTuple):
    """A status that is not what it was."""

    kind: str
    name: str
    old: Status
    new: Status


class Event(NamedTuple):
    """Something that became known: somebody told it, or time or the model made it so.

    Attributes:
        number: 1 for the first.
        time: when [s].
        verb: name of the method of `KnowledgeBase` that tells it again, e.g. "measure"; "stale", "dwell" and "lapse"
            are what time does, "begin" is what the model states, "amend" a change of the model, "store" how the store
            is.
        arguments: of the method, all of them, as plain values: names, numbers, texts. An element is (kind, name), a
            constraint (kind, name, position) by what it constrains, a plan or attempt its number.
        changes: the statuses that changed by it.
        cause: number of the event that caused it; None if that is not known, or it is news from outside.
        effects: what was selected, or is no longer, by a selection: (kind, name, whether it is selected).
        plan: the plan that a selection made.
        words: the event in words, if whoever made it knows them better than the arguments say.
    """

    number: int
    time: float
    verb: str
    arguments: tuple[Any, ...]
    changes: tuple[StatusChange, ...] = ()
    cause: int | None = None
    effects: tuple[tuple[str, str, bool], ...] = ()
    plan: ReconfigurationPlan | None = None
    words: str = ""

    @property
    def kind(self) -> EventKind:
        """What kind of knowledge it is."""
        if self.plan is not None:
            return EventKind.RECONFIGURATION_PLAN
        if self.verb in ("request_action", "cancel_action"):
            return EventKind.ACTION_UPDATE
        return EventKind.RECORD if self.verb in RECORDS else EventKind.MONITORING_DATA

    @property
    def subject(self) -> str:
        """Name of the attribute, component, action or other element that it is about; empty where it is about none."""
        first = self.arguments[0] if self.arguments else ""
        if isinstance(first, tuple):
            return str(first[1])
        return first if isinstance(first, str) and self.verb not in ("store", "amend") else ""

    @property
    def text(self) -> str:
        """What, in words, e.g. "light is 0.3" or "gripper has failed"."""
        if self.words:
            return self.words
        if self.plan is not None:
            return str(self.plan)
        if self.effects:
            return ", ".join(f"{name} is {'' if is_so else 'not '}selected" for _, name, is_so in self.effects)
        found = _WORDS.get(self.verb)
        given = map(str, self.arguments)
        return f"{self.verb.replace('_', ' ')}: {', '.join(given)}" if found is None else found(self)

    def to_json(self) -> dict[str, Any]:
        """Return it as values that JSON can hold; `from_json` is the way back, but for the plan."""
        written: dict[str, Any] = {
            "number": self.number,
            "time": self.time,
            "verb": self.verb,
            "arguments": [_plain(one) for one in self.arguments],
        }
        if self.changes:
            written["changes"] = [list(map(str, one)) for one in self.changes]
        if self.cause is not None:
            written["cause"] = self.cause
        if self.effects:
            written["effects"] = [list(one) for one in self.effects]
        if self.words:
            written["words"] = self.words
        return written

    @classmethod
    def from_json(cls, written: Mapping[str, Any]) -> Self:
        """Return the event that was written.

        Raises:
            LookupError, TypeError, ValueError: that was no event.
        """
        changes = tuple(
            StatusChange(kind, name, Status(old), Status(new)) for kind, name, old, new in written.get("changes", ())
        )
        return cls(
            int(written["number"]),
            float(written["time"]),
            str(written["verb"]),
            tuple(tuple(one) if isinstance(one, list) else one for one in written["arguments"]),
            changes,
            written.get("cause"),
            tuple((kind, name, bool(selected)) for kind, name, selected in written.get("effects", ())),
            None,
            str(written.get("words", "")),
        )


def _plain(value: object) -> object:
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(one) for one in value]
    return value


def _of(event: Event, place: int) -> str:
    return f" ({event.arguments[place]})" if event.arguments[place] else ""


_WORDS: Final[Mapping[str, Callable[[Event], str]]] = {
    "measure": lambda one: f"{one.subject} is {one.arguments[1]:g}",
    "component_failed": lambda one: f"{one.subject} has failed{_of(one, 1)}",
    "component_recovered": lambda one: f"{one.subject} is recovered",
    "component_active": lambda one: f"{one.subject} is {'active' if one.arguments[1] else f'inactive{_of(one, 2)}'}",
    "component_started": lambda one: f"{one.subject} runs as process {one.arguments[1]}",
    "component_ended": lambda one: f"{one.subject} no longer runs as process {one.arguments[1] or ''}".rstrip(),
    "request_action": lambda one: f"{one.subject} is requested",
    "cancel_action": lambda one: f"{one.subject} is {': '.join(filter(None, one.arguments[1:]))}",
    "retract_status": lambda one: f"{one.subject} is no longer asserted",
    "lapse": lambda one: f"{one.subject} is no longer asserted {one.arguments[1]}: its time is over",
    "assert_required": lambda one: f"{one.subject} is {'' if one.arguments[1] else 'no longer '}asserted required",
    "assert_selected": lambda one: f"{one.subject} is {'' if one.arguments[1] else 'not '}selected{_of(one, 2)}",
    "note_no_choice": lambda one: (
        f"nothing can be selected because {one.subject}" if one.subject else "something can be selected again"
    ),
    "finish_plan": lambda one: "plan {} is {}".format(*one.arguments),
    "finish_attempt": lambda one: f"attempt {one.arguments[0]} is {one.arguments[1]}{_of(one, 2)}",
    "record_answer": lambda one: (
        f"plan {one.arguments[0]} {'is vetoed' if one.arguments[1] else 'may be executed'}{_of(one, 2)}"
    ),
    "store": lambda one: str(one.arguments[0]),
    "begin": lambda _: "begins with what the model states",
}
"""An event in words, by its verb."""


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
        witnesses: called with each event when it is in by the thread that tells it, which holds the base; they may ask.
    """

    def __init__(self) -> None:
        self.last = 0
        self.heard: Callable[[], None] | None = None
        self.witnesses: tuple[Callable[[Event], None], ...] = ()
        self._measured: deque[Event] = deque(maxlen=_MOST)
        self._others: deque[Event] = deque(maxlen=_MOST)

    def append(self, event: Event) -> None:
        """Add an event; one that is there already, by its number, is added no second time."""
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
