"""Events: everything that becomes known, as data that can be replayed.

Their log, and its subscribers.
"""

import logging
from collections.abc import Callable, Mapping
from enum import StrEnum
from threading import Condition, Lock
from typing import Any, Final, NamedTuple, Self

from kb.exceptions import InvalidValue
from kb.records import Log, ReconfigurationPlan
from kb.status import Status


class EventKind(StrEnum):
    """What kind of knowledge arrived: the three kinds of ROSA, and what is only put on record."""

    MONITORING_DATA = "monitoring data"
    ACTION_UPDATE = "action update"
    RECONFIGURATION_PLAN = "reconfiguration plan"
    RECORD = "record"


RECORDS: Final = frozenset(
    {
        "component_started",
        "component_ended",
        "finish_plan",
        "record_attempt",
        "finish_attempt",
        "record_answer",
        "store",
    }
)
"""The verbs of events that are only put on record; no status follows from them."""

_WORDS: Final[Mapping[str, str | tuple[str, str]]] = {
    "measure": "{0} is {1:g}",
    "component_failed": "{0} has failed{reason}",
    "component_recovered": "{0} is recovered",
    "component_active": ("{0} is inactive{reason}", "{0} is active"),
    "component_started": "{0} runs as process {1}",
    "component_ended": "{0} no longer runs as process {1}",
    "request_action": "{0} is requested",
    "cancel_action": "{0} is {1}{because}",
    "assert_required": ("{0} is no longer asserted required", "{0} is asserted required"),
    "assert_selected": ("{0} is not selected{reason}", "{0} is selected{reason}"),
    "finish_plan": "plan {0} is {1}",
    "finish_attempt": "attempt {0} is {1}{reason}",
    "record_answer": ("plan {0} may be executed{reason}", "plan {0} is vetoed{reason}"),
    "store": "{0}",
    "begin": "begins with what the model states",
}
"""An event in words by its verb, of two for something that is not so, or is so."""


class StatusChange(NamedTuple):
    """A status that changed."""

    kind: str
    name: str
    old: Status
    new: Status


class Event(NamedTuple):
    """Something that became known: somebody recorded it, or time or the model made it so.

    Attributes:
        number: 1 for the first.
        time: when [s].
        verb: name of the method of `KnowledgeBase` that records it again, e.g. "measure"; "stale",
            "dwell" and "lapse" are what time does, "begin" is what the model states, "amend" a
            change of the model, "store" how the store is,
        arguments: of the method, all of them, as plain values: names, numbers, texts. An element is
            (kind, name), a constraint (kind, name, position) by what it constrains, a plan or
            attempt its number.
        changes: the statuses that changed by it.
        cause: number of the event that caused it; None if that is not known, or it is news from
            outside.
        effects: what was selected, or is no longer, by a selection: (kind, name, whether it is
            selected).
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
        """Name of the attribute, component, action or other element that it is about.

        Empty where it is about none.
        """
        first = self.arguments[0] if self.arguments else ""
        if isinstance(first, tuple):
            return str(first[1])
        return first if isinstance(first, str) and self.verb not in ("store", "amend") else ""

    @property
    def text(self) -> str:
        """What, in words, e.g. "light is 0.3" or "gripper has failed"."""
        arguments = self.arguments
        if self.words:
            return self.words
        if self.plan is not None:
            return str(self.plan)
        if self.effects:
            flips = [f"{name} is {'' if on else 'not '}selected" for _, name, on in self.effects]
            return ", ".join(flips)
        words = _WORDS.get(self.verb)
        if words is None:
            return f"{self.verb.replace('_', ' ')}: {', '.join(map(str, arguments))}"
        if isinstance(words, tuple):
            words = words[bool(arguments[1])]
        last = arguments[-1] if arguments else ""
        return words.format(
            self.subject or (arguments and arguments[0]),
            *arguments[1:],
            reason=f" ({last})" if last else "",
            because=f": {last}" if last else "",
        )

    def to_json(self) -> dict[str, Any]:
        """Return it as values that JSON can hold; `from_json` is the way back, but for the plan."""
        values = self._asdict()
        del values["plan"]
        values["arguments"] = [
            dict(value) if isinstance(value, Mapping) else value for value in self.arguments
        ]
        return {name: value for name, value in values.items() if value not in ((), None, "")}

    @classmethod
    def from_json(cls, written: Mapping[str, Any], plan: ReconfigurationPlan | None = None) -> Self:
        """Return the event that was written, with its plan.

        Raises:
            LookupError, TypeError, ValueError: that was no event.
        """
        arguments = [
            tuple(value) if isinstance(value, list) else value for value in written["arguments"]
        ]
        changes = [
            StatusChange(kind, name, Status(old), Status(new))
            for kind, name, old, new in written.get("changes", ())
        ]
        values = {
            **written,
            "arguments": tuple(arguments),
            "changes": tuple(changes),
            "effects": tuple(map(tuple, written.get("effects", ()))),
            "plan": plan,
        }
        return cls(**values)


class _Subscriber:
    """A callback, and the number of the last event that it was called with."""

    def __init__(self, call: Callable[[Event], None], last: int) -> None:
        self.call = call
        self.last = last


class Publisher:
    """Calls every subscriber with every event of a log, once, one event at a time, in order.

    No lock is held while a subscriber is called. If it records an event, or another thread does,
    that is delivered after the present one, and nobody waits for it. An interrupt in a subscriber
    reaches the caller who recorded the event; the others get the event at the next call.
    """

    def __init__(self, log: Log, lock: Any) -> None:  # noqa: ANN401  # an RLock has no type
        self._log = log
        self._owned = Condition(lock)
        self._turn = Lock()
        self.subscribers: list[_Subscriber] = []

    def subscribe(self, callback: Callable[[Event], None]) -> Callable[[], None]:
        """Call a function with every event from now on; returns how to stop that."""
        if not callable(callback):
            raise InvalidValue(f"a subscriber is called with each event; {callback!r} cannot be")
        subscriber = _Subscriber(callback, self._log.last)
        self.subscribers.append(subscriber)

        def stop() -> None:
            if subscriber in self.subscribers:
                self.subscribers.remove(subscriber)

        return stop

    def deliver(self) -> None:
        """Call the subscribers with new events, unless a thread does so already.

        Then it goes on with these.
        """
        while (
            any(subscriber.last < self._log.last for subscriber in self.subscribers)
            and not self.is_held()
        ):
            turn: list[bool] = []
            try:
                turn.extend(map(self._turn.acquire, (False,)))  # taken and noted in one step
                if not turn[0]:
                    return
                self._call_all(self._log.last)
            finally:
                if turn and turn[0]:
                    self._turn.release()

    def _call_all(self, last: int) -> None:
        first = min((subscriber.last for subscriber in self.subscribers), default=last)
        for event in self._log.since(first):
            for subscriber in tuple(self.subscribers):
                if subscriber.last < event.number:
                    subscriber.last = event.number
                    _call(subscriber, event)
        for subscriber in self.subscribers:
            subscriber.last = max(subscriber.last, last)  # the log may have forgotten some

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
        logging.getLogger(__name__).exception(
            "the subscriber %r failed on %r", subscriber.call, event.text
        )
