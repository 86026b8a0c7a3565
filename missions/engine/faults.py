"""Faults that are injected into a run: a component fails or recovers, a measurement takes another value.

The robot hears of them as of any other news; the recording holds that message, and a replay decides on it again.

    inject(run, read_fault("fail boom@60"), read_fault("measure battery_level=0.1@30"))
"""

from collections.abc import Iterable, Mapping, Sequence
from math import inf, isfinite
from threading import Lock
from typing import Final, NamedTuple

from kb import Model
from kb.diagnostics import MEASUREMENTS
from missions.engine.mission import Message, MissionError
from missions.engine.recording import failed, measured, recovered
from missions.engine.runner import MissionRun

FORMS: Final = {
    "fail": "COMPONENT@S",
    "recover": "COMPONENT@S",
    "measure": "ATTRIBUTE=VALUE@S",
    "release": "ATTRIBUTE@S",
}
"""How a fault is written after its verb, such as `fail boom@60`."""


class Fault(NamedTuple):
    """One injected fault.

    Attributes:
        verb: "fail" or "recover" a component; "measure" an attribute as `value` from then on, until "release".
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
        words = {
            "fail": f"{self.name} fails",
            "recover": f"{self.name} recovers",
            "measure": f"{self.name.replace('_', ' ')} is measured as {self.value:g} from now on",
            "release": f"{self.name.replace('_', ' ')} is measured as it is again",
        }
        return f"{words[self.verb]} (injected)"


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
    wrong = MissionError(f"--{verb} takes {FORMS[verb]}, not {rest!r}")
    if not at or not name or bool(equals) is not (verb == "measure"):
        raise wrong
    try:
        fault = Fault(verb, name.strip(), float(time), float(value or 0.0))
    except ValueError:
        raise wrong from None
    if not (isfinite(fault.time) and fault.time >= 0.0 and isfinite(fault.value)):
        raise wrong
    return fault


def check_faults(
    faults: Iterable[Fault], model: Model, duration_s: float = inf
) -> tuple[Fault, ...]:
    """Return the faults with the names as the model writes them.

    Raises:
        MissionError, kb.UnknownName: an element is unknown, or the fault comes after the end of the mission.
    """
    checked = []
    for fault in faults:
        is_component = fault.verb in ("fail", "recover")
        elements = model.components if is_component else model.attributes
        if fault.time >= duration_s:
            ends = f"the mission ends at {duration_s:g} s; set duration_s or an earlier time"
            raise MissionError(f"the fault {str(fault)!r} would never happen: {ends}")
        checked.append(fault._replace(name=elements[fault.name].name))
    return tuple(checked)


class FaultInjector:
    """Replaces what a robot hears by what the faults say, from the time of each fault on.

    Attributes:
        planned: all faults that were added, in order of time.
        injected: the faults that have happened, each at the time at which the robot heard of it.
        held: the injected values by attribute.
    """

    def __init__(self) -> None:
        self.planned: tuple[Fault, ...] = ()
        self.injected: list[Fault] = []
        self.held: dict[str, float] = {}
        self._waiting: list[Fault] = []
        self._lock = Lock()

    def add(self, faults: Iterable[Fault]) -> None:
        """Add checked faults; one whose time is over happens at once."""
        with self._lock:
            self.planned = tuple(sorted([*self.planned, *faults], key=_time_of))
            self._waiting = sorted([*self._waiting, *faults], key=_time_of)

    def alter(self, messages: Sequence[Message], now: float) -> Sequence[Message]:
        """Return what the robot hears instead of the messages published by a time [s]."""
        with self._lock:
            due = [fault for fault in self._waiting if fault.time <= now]
            self._waiting = self._waiting[len(due) :]
        news = []
        for fault in due:
            self.injected.append(fault._replace(time=now))
            if fault.verb == "fail":
                news.append(failed(now, fault.name))
            elif fault.verb == "recover":
                news.append(recovered(now, fault.name))
            elif fault.verb == "measure":
                self.held[fault.name] = fault.value
                news.append(measured(now, **{fault.name: fault.value}))
            else:
                self.held.pop(fault.name, None)
        if self.held:
            messages = [_with_values(message, self.held) for message in messages]
        return [*messages, *news]


def inject(run: MissionRun, *faults: Fault) -> None:
    """Have faults happen in a run, at their times or at once. See `check_faults` for what is raised."""
    if not faults:
        return
    checked = check_faults(faults, run.model, run.settings.duration_s)
    if run.faults is None:
        run.faults = FaultInjector()
    run.faults.add(checked)


def _time_of(fault: Fault) -> float:
    return fault.time


def _with_values(message: Message, values: Mapping[str, float]) -> Message:
    statuses = []
    for status in message["status"]:
        if str(status["message"]).strip().casefold() in MEASUREMENTS:
            heard = dict(status["values"])
            for name in heard.keys() & values.keys():
                heard[name] = repr(values[name])
            status = {**status, "values": heard}
        statuses.append(status)
    return {**message, "status": statuses}
