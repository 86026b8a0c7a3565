"""Events: everything that becomes known, as data that can be told again; their log, and its subscribers."""

import logging
import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from itertools import takewhile
from operator import attrgetter
from threading import Condition, Lock, get_ident
from typing import Any, Final, NamedTuple, Self

from kb.exceptions import InvalidValue
from kb.records import Memory, ReconfigurationPlan, plain
from kb.status import Status


class EventKind(StrEnum):
    """What kind of knowledge arrived: the three kinds of ROSA, and what is only put on record."""

    MONITORING_DATA = "monitoring data"
    ACTION_UPDATE = "action update"
    RECONFIGURATION_PLAN = "reconfiguration plan"
    RECORD = "record"


_MADE: Final = frozenset(
    {"component_configured", "component_started", "component_ended", "finish_plan", "store"}
)
RECORDS: Final = _MADE | {"record_attempt", "finish_attempt", "record_answer", "progress"}
"""The verbs of events that are only put on record and change no fact of the state."""


class StatusChange(NamedTuple):
    """A status that changed."""

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
            is, "progress" where an action of a task layer is.
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
            return ", ".join(
                f"{name} is {'' if is_so else 'not '}selected" for _, name, is_so in self.effects
            )
        found = _WORDS.get(self.verb)
        given = map(str, self.arguments)
        return (
            f"{self.verb.replace('_', ' ')}: {', '.join(given)}" if found is None else found(self)
        )

    def to_json(self) -> dict[str, Any]:
        """Return it as values that JSON can hold; `from_json` is the way back, but for the plan."""
        arguments, effects = plain(self.arguments), [list(one) for one in self.effects]
        changes = [list(map(str, one)) for one in self.changes]  # there can be many
        written = {
            "number": self.number,
            "time": self.time,
            "verb": self.verb,
            "arguments": arguments,
        }
        said = {"changes": changes, "cause": self.cause, "effects": effects, "words": self.words}
        return written | {
            name: value for name, value in said.items() if value not in ([], None, "")
        }

    @classmethod
    def from_json(cls, written: Mapping[str, Any]) -> Self:
        """Return the event that was written.

        Raises:
            LookupError, TypeError, ValueError: that was no event.
        """
        changes = tuple(
            StatusChange(kind, name, Status(old), Status(new))
            for kind, name, old, new in written.get("changes", ())
        )
        return cls(
            int(written["number"]),
            float(written["time"]),
            str(written["verb"]),
            tuple(tuple(one) if isinstance(one, list) else one for one in written["arguments"]),
            changes,
            written.get("cause"),
            tuple(
                (kind, name, bool(selected)) for kind, name, selected in written.get("effects", ())
            ),
            None,
            str(written.get("words", "")),
        )


def _of(event: Event, place: int) -> str:
    return f" ({event.arguments[place]})" if event.arguments[place] else ""


_WORDS: Final[Mapping[str, Callable[[Event], str]]] = {
    "measure": lambda one: f"{one.subject} is {one.arguments[1]:g}",
    "component_failed": lambda one: f"{one.subject} has failed{_of(one, 1)}",
    "component_recovered": lambda one: f"{one.subject} is recovered",
    "component_active": lambda one: (
        f"{one.subject} is {'active' if one.arguments[1] else f'inactive{_of(one, 2)}'}"
    ),
    "component_started": lambda one: f"{one.subject} runs as process {one.arguments[1]}",
    "component_ended": lambda one: (
        f"{one.subject} no longer runs as process {one.arguments[1] or ''}".rstrip()
    ),
    "request_action": lambda one: f"{one.subject} is requested",
    "cancel_action": lambda one: f"{one.subject} is {': '.join(filter(None, one.arguments[1:]))}",
    "assert_required": lambda one: (
        f"{one.subject} is {'' if one.arguments[1] else 'no longer '}asserted required"
    ),
    "assert_selected": lambda one: (
        f"{one.subject} is {'' if one.arguments[1] else 'not '}selected{_of(one, 2)}"
    ),
    "note_no_choice": lambda one: (
        f"nothing can be selected because {one.subject}"
        if one.subject
        else "something can be selected again"
    ),
    "finish_plan": lambda one: "plan {} is {}".format(*one.arguments),
    "finish_attempt": lambda one: f"attempt {one.arguments[0]} is {one.arguments[1]}{_of(one, 2)}",
    "record_answer": lambda one: (
        f"plan {one.arguments[0]} {'is vetoed' if one.arguments[1] else 'may be executed'}{_of(one, 2)}"
    ),
    "progress": lambda one: (
        f"{one.arguments[1]} {'is kept to be gone on with' if one.arguments[2] else 'begins anew'}"
    ),
    "store": lambda one: str(one.arguments[0]),
    "begin": lambda _: "begins with what the model states",
}
"""An event in words, by its verb."""


_NUMBER: Final = attrgetter("number")

_MOST_ANSWERS: Final = 1000
"""How long a chain of events may be in which each is told in answer to the one before."""

_log = logging.getLogger(__name__)


class Log:
    """The newest events of a knowledge base by number, as far as they are held in memory.

    Measurements are far more than anything else and are held apart, so that they push nothing else out.

    Attributes:
        last: number of the last event; 0 before the first.
        begins: number of the event from which on every one is held; 1 while none is forgotten.
        time: of the last event [s].
    """

    def __init__(
        self, memory: Memory, lock: AbstractContextManager[object], settle: Callable[[], None]
    ) -> None:
        self._lock = (
            lock  # of the base that tells them: what is told meanwhile is told before or after
        )
        self.settle = settle  # called before all are looked at: what was interrupted ends
        self.last, self.begins, self.time = 0, 1, -math.inf
        self.heard: Callable[[], None] | None = None  # called when there is a new event
        self.witnesses: tuple[
            Callable[[Event], None], ...
        ] = ()  # hear of each by the thread that holds the base
        self.capacity = memory.events
        self._span = memory.span
        self._measured: deque[Event] = deque()
        self._others: deque[Event] = deque()

    def append(self, event: Event) -> None:
        """Add an event, unless one of its number is there already."""
        number, time = event.number, event.time
        events = self._measured if event.verb == "measure" else self._others
        if (
            not events or events[-1].number < number
        ):  # no signal is handled between this and what follows
            events.append(event)
        while len(events) > self.capacity or events[0].time < time - self._span:
            self.begins = max(self.begins, events[0].number + 1)
            events.popleft()
        self.last, self.time = number, time
        if self.heard is not None:
            self.heard()

    def resume(self, number: int) -> None:
        """Go on after an event that is not held here."""
        if number != self.last:
            self.last, self.begins = number, number + 1

    def since(self, number: int, *, measurements: bool = True) -> Iterator[Event]:
        """Yield the events after one, in order, with the measurements among them or without."""
        with self._lock:
            held = (self._measured, self._others) if measurements else (self._others,)
            later = [one for events in held for one in _newest(events, number)]
        return iter(sorted(later, key=_NUMBER))

    def __iter__(self) -> Iterator[Event]:
        self.settle()
        return self.since(0)

    def __len__(self) -> int:
        return len(self._measured) + len(self._others)


def _newest(events: deque[Event], number: int) -> list[Event]:
    """Return the events after one, the newest first."""
    try:
        return list(takewhile(lambda one: one.number > number, reversed(events)))
    except RuntimeError:  # a signal handler told an event meanwhile
        return _newest(events, number)


@dataclass(slots=True, eq=False)
class _Subscriber:
    """A callback, the number of the last event that it was called with, and whether it failed on one."""

    call: Callable[[Event], None]
    heard: int
    has_failed: bool = False


class Publisher:
    """Calls every subscriber with every event of a log, once, one event at a time, in order.

    No lock is held while a subscriber is called. If it tells an event, or another thread does, that is delivered after
    the present one, and nobody waits for it. An interrupt in a subscriber reaches the caller who told the event; the
    other subscribers get the event at the next call. A subscriber that answers its own events without end is dropped.
    """

    def __init__(self, log: Log, lock: Any) -> None:  # noqa: ANN401  # an RLock has no type
        self._log, self._lock = log, lock
        self._owned = Condition(lock)
        self._subscribers: list[_Subscriber] = []
        self.is_heard = False
        self._turn = Lock()
        self._called: tuple[int, _Subscriber, int] | None = None
        self._answers: dict[int, int] = {}

    def subscribe(self, callback: Callable[[Event], None]) -> Callable[[], None]:
        """Call a function with every event from now on; returns how to stop that."""
        if not callable(callback):
            raise InvalidValue(
                f"a subscriber is called with each event; {callback!r} cannot be called"
            )
        with self._lock:
            subscriber = _Subscriber(callback, self._log.last)
            self.is_heard = True
            self._subscribers.append(subscriber)
        return partial(self._stop, subscriber)

    def deliver(self, told: int = 0) -> None:
        """Call the subscribers with new events, unless a thread does so already: then that thread delivers these too.

        The number given is that of the event that this thread has just told.
        """
        while any(one.heard < self._log.last for one in self._subscribers) and not self.is_held():
            turn: list[bool] = []
            try:
                turn.extend(
                    map(self._turn.acquire, (False,))
                )  # taken and noted in one step, whatever interrupts
                if not turn[0]:
                    self._answered(told)
                    return
                with self._lock:
                    last = self._log.last
                    events = list(
                        self._log.since(min((one.heard for one in self._subscribers), default=last))
                    )
                for event in events:
                    depth = self._answers.pop(event.number, 0)
                    for subscriber in tuple(self._subscribers):
                        if subscriber.heard < event.number:
                            self._called = get_ident(), subscriber, depth
                            _call(subscriber, event)
                for subscriber in self._subscribers:
                    subscriber.heard = max(
                        subscriber.heard, last
                    )  # even if the log has forgotten some by now
            finally:
                if turn and turn[0]:
                    self._turn.release()

    def _answered(self, told: int) -> None:
        """Note that the subscriber called on this thread has told an event in answer to the one it was called with."""
        if not told or self._called is None or self._called[0] != get_ident():
            return
        _, subscriber, depth = self._called
        self._answers[told] = depth + 1
        if depth >= _MOST_ANSWERS and subscriber in self._subscribers:
            self._stop(subscriber)
            why = "answers its own answers without end, and is called no more"
            _log.error("the subscriber %r %s: make it tell only what is new", subscriber.call, why)

    def _stop(self, subscriber: _Subscriber) -> None:
        if subscriber in self._subscribers:
            self._subscribers.remove(subscriber)
        self.is_heard = bool(self._subscribers)

    def is_held(self) -> bool:
        """Return whether this thread holds the base, as within `with kb.reading()`."""
        try:
            self._owned.notify(0)  # it is refused to whoever does not hold the lock
        except RuntimeError:
            return False
        return True


def _call(subscriber: _Subscriber, event: Event) -> None:
    try:
        subscriber.call(event)
    except Exception:
        _log.error(
            "the subscriber %r failed on %r",
            subscriber.call,
            event.text,
            exc_info=not subscriber.has_failed,
        )
        subscriber.has_failed = True  # where is logged once: it may fail on all that comes
    finally:
        subscriber.heard = event.number
