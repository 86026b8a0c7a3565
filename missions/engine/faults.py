"""Faults that are injected into a run: a component fails or recovers, a measurement is replaced.

The robot receives them as any other news; a recording contains that message, and a replay decides
on it again.

    run.faults.add(read_fault("fail boom@60"), read_fault("measure battery_level=0.1@30"))
"""

from collections.abc import Mapping, Sequence
from math import inf, isfinite
from operator import attrgetter
from threading import Lock
from typing import Any, Final, NamedTuple

from kb import Model
from missions.engine.percepts import Message, failed, measured, recovered
from missions.engine.settings import MissionError

FORMS: Final = {
    "fail": "COMPONENT@SECONDS",
    "recover": "COMPONENT@SECONDS",
    "measure": "ATTRIBUTE=VALUE@SECONDS",
    "release": "ATTRIBUTE@SECONDS",
}
"""How a fault is written after its verb, such as `fail boom@60`."""

_WORDS: Final = {
    "fail": "{name} fails",
    "recover": "{name} recovers",
    "measure": "{words} is measured as {value:g} from now on",
    "release": "{words} is measured as it is again",
}


class Fault(NamedTuple):
    """One injected fault.

    Attributes:
        verb: "fail" or "recover" a component; "measure" an attribute as `value`, until "release".
        name: of the component or attribute.
        time: when it happens [s].
        value: of the attribute, in its unit.
    """

    verb: str
    name: str
    time: float = 0.0
    value: float = 0.0

    def __str__(self) -> str:
        value = f"={self.value:g}" if self.verb == "measure" else ""
        return f"{self.verb} {self.name}{value}@{self.time:g}"

    @property
    def words(self) -> str:
        """The fault as an event that is listed among the disturbances."""
        words = self.name.replace("_", " ")
        text = _WORDS[self.verb].format(name=self.name, words=words, value=self.value)
        return f"{text} (injected)"


def read_fault(text: str) -> Fault:
    """Read a fault such as "fail boom@60" or "measure battery_level=0.1@30".

    Raises:
        MissionError: the text has another form; the message shows the right one.
    """
    verb, _, rest = text.strip().partition(" ")
    if verb not in FORMS:
        raise MissionError(f"unknown fault {text!r}; a fault begins with {', '.join(FORMS)}")
    subject, at, time = rest.strip().rpartition("@")
    name, equals, value = subject.partition("=")
    try:
        fault = Fault(verb, name.strip(), float(time), float(value or 0.0))
    except ValueError:
        fault = Fault(verb, "")
    is_complete = bool(at and fault.name) and bool(equals) is (verb == "measure")
    if not (is_complete and 0.0 <= fault.time < inf and isfinite(fault.value)):
        raise MissionError(f"--{verb} takes {FORMS[verb]}, not {rest!r}")
    return fault


class FaultInjector:
    """Replaces what a robot receives by what the faults say, from the time of each fault on.

    Attributes:
        waiting: the faults to come, in order of time.
        injected: the faults that have happened, each at the time at which the robot heard of it.
        values: the injected values by attribute.
    """

    def __init__(self, model: Model, duration_s: float) -> None:
        self.waiting: list[Fault] = []
        self.injected: list[Fault] = []
        self.values: dict[str, float] = {}
        self._model = model
        self._duration_s = duration_s
        self._lock = Lock()  # a page adds faults from its own thread

    def add(self, *faults: Fault) -> None:
        """Add faults; one whose time is over happens at once.

        Raises:
            MissionError, kb.UnknownName: an element is unknown, a value is out of its range, or the
                fault comes after the end of the mission; no fault is added.
        """
        checked = []
        for fault in faults:
            is_component = fault.verb in ("fail", "recover")
            elements = self._model.components if is_component else self._model.attributes
            if fault.time >= self._duration_s:
                raise MissionError(
                    f"the fault {str(fault)!r} would never happen: the mission ends at "
                    f"{self._duration_s:g} s; set duration_s or an earlier time"
                )
            element: Any = elements[fault.name]
            if fault.verb == "measure" and not element.low <= fault.value <= element.high:
                raise MissionError(f"the fault {str(fault)!r}: {element.name} is {element.range}")
            checked.append(fault._replace(name=element.name))
        with self._lock:
            self.waiting = sorted([*self.waiting, *checked], key=attrgetter("time"))

    def alter(self, messages: Sequence[Message], now: float) -> Sequence[Message]:
        """Return what the robot receives instead of the messages published by a time [s]."""
        news: list[Message] = []
        with self._lock:
            while self.waiting and self.waiting[0].time <= now:
                fault = self.waiting.pop(0)
                self.injected.append(fault._replace(time=now))
                news += self._messages_of(fault, now)
        if self.values:
            messages = [_with_values(message, self.values) for message in messages]
        return [*messages, *news]

    def _messages_of(self, fault: Fault, now: float) -> Sequence[Message]:
        if fault.verb in ("fail", "recover"):
            tell = failed if fault.verb == "fail" else recovered
            return [tell(now, fault.name)]
        if fault.verb == "release":
            self.values.pop(fault.name, None)
            return []
        self.values[fault.name] = fault.value
        return [measured(now, **{fault.name: fault.value})]


def _with_values(message: Message, values: Mapping[str, float]) -> Message:
    """Return a message with these values of the attributes that it measures."""
    statuses = []
    for status in message["status"]:
        heard = dict(status["values"])
        heard |= {name: repr(values[name]) for name in heard.keys() & values.keys()}
        statuses.append({**status, "values": heard})
    return {**message, "status": statuses}
