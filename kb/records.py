"""The log, and the records: requested actions, plans, processes, attempts and vetoes."""

import copyreg
import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from itertools import islice
from types import MappingProxyType
from typing import Any, Final, Generic, NamedTuple, TypeVar

from kb.elements import Parameters, RequiredActionFact
from kb.exceptions import InvalidValue

T = TypeVar("T")

RESULTS: Final = ("completed", "failed", "abandoned")
_MOST: Final = 10_000
"""How many records of each kind are held: the newest, and whatever has not ended."""
_MOST_EVENTS: Final = 100_000


class Reply(NamedTuple):
    """The answer to a request of an action; true if the request was accepted.

    Attributes:
        accepted: whether the action is required now.
        reason: why the request was refused; if it was accepted, a sentence that says so.
    """

    accepted: bool
    reason: str

    def __bool__(self) -> bool:
        return self.accepted


@dataclass(frozen=True, slots=True, eq=False)
class RequiredAction:
    """An action that a mission requested, from when, and how it ended.

    Only the knowledge base can end it.

    Attributes:
        action: name of the action.
        preference: name of the attribute to favour when a configuration is chosen for it, or a
            mapping from names of attributes to weights, or None.
        start: when it was requested [s].
        end: when it ended [s], None while it is open.
        result: "completed", "failed" or "abandoned", None while it is open.
        reason: why it ended in this way, in words; empty if no reason was told.
        cause: number of the event that led to the request, None if that is not known.
        number: number of the event of the request.
    """

    action: str
    preference: str | Mapping[str, float] | None
    start: float
    end: float | None = None
    result: str | None = None
    reason: str = ""
    cause: int | None = None
    number: int = 0

    def __repr__(self) -> str:
        return f"<RequiredAction {self.action!r} ({self.result or 'open'})>"


@dataclass(frozen=True, slots=True, eq=False)
class ReconfigurationPlan:
    """Which components to switch and configure, and the result.

    Only the knowledge base that made a plan can end it.

    Attributes:
        activate: names of components to activate.
        deactivate: names of components to deactivate.
        parameters: names of configurations whose parameters are to be set.
        reason: why it was made, in words.
        start: when it was made [s].
        end: when it ended [s], None while it is open.
        result: "completed", "failed" or "abandoned", None while it is open.
        plain: the components among these that are not commanded: they are only noted as active or
            inactive.
        cause: number of the event that made it necessary, None if that is not known.
        number: 1 for the first plan of a knowledge base.
    """

    activate: tuple[str, ...]
    deactivate: tuple[str, ...]
    parameters: tuple[str, ...]
    reason: str = ""
    start: float = 0.0
    end: float | None = None
    result: str | None = None
    plain: tuple[str, ...] = ()
    cause: int | None = None
    number: int = 0

    def __str__(self) -> str:
        steps = (
            ("deactivate", [name for name in self.deactivate if name not in self.plain]),
            ("activate", [name for name in self.activate if name not in self.plain]),
            ("configure", self.parameters),
            ("note as inactive:", [name for name in self.deactivate if name in self.plain]),
            ("note as active:", [name for name in self.activate if name in self.plain]),
        )
        return "; ".join(f"{verb} {', '.join(names)}" for verb, names in steps if names)

    def __repr__(self) -> str:
        return f"<ReconfigurationPlan {self} ({self.result or 'open'})>"


@dataclass(frozen=True, slots=True, eq=False)
class Process:
    """A process of the operating system in which a component ran or runs.

    Attributes:
        component: name of the component.
        pid: number of the process.
        start: when it was started [s].
        end: when it ended [s], None while it runs.
        number: number of the event of its start.
    """

    component: str
    pid: int
    start: float
    end: float | None = None
    number: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Attempt:
    """One command, given once, and its result; only the knowledge base can end it.

    Attributes:
        plan: the plan that it was part of.
        component: name of the component that was commanded.
        operation: "activate", "deactivate" or "configure".
        configuration: name of the configuration to set, None if the component was only switched.
        parameters: the parameters to set; empty if the component was only switched.
        number: 1 for the first time that the plan gave this command.
        start: when it was given [s].
        end: when it was found to have ended [s], None while it is under way.
        result: "completed", "failed" or "abandoned", None while it is under way.
        reason: why it failed, or what was unusual about it, in words.
        serial: number of the event of the command.
    """

    plan: ReconfigurationPlan
    component: str
    operation: str
    configuration: str | None
    parameters: Parameters
    number: int
    start: float
    end: float | None = None
    result: str | None = None
    reason: str = ""
    serial: int = 0

    def __str__(self) -> str:
        result = self.result or "under way"
        reason = f": {self.reason}" if self.reason else ""
        return f"{self.operation} {self.component}, attempt {self.number}: {result}{reason}"


@dataclass(frozen=True, slots=True)
class VetoAnswer:
    """The answer to whether a plan may be executed.

    Attributes:
        plan: the plan that was asked about.
        time: when the answer was given [s].
        is_vetoed: whether the execution was forbidden.
        reason: why it was forbidden, in words.
        number: number of the event of the answer.
    """

    plan: ReconfigurationPlan
    time: float
    is_vetoed: bool
    reason: str = ""
    number: int = 0


RecordT = TypeVar("RecordT", RequiredAction, ReconfigurationPlan, Process, Attempt, VetoAnswer)


class Log:
    """The newest events of a knowledge base by number, as far as they are held in memory.

    Attributes:
        last: number of the last event; 0 before the first.
        time: of the last event [s].
        witnesses: functions that are called with each event by the thread that records it, while
            the base is held.
    """

    def __init__(self, reading: Callable[[], AbstractContextManager[object]]) -> None:
        self.reading = reading  # completes what was interrupted, and holds the base
        self._events: deque[Any] = deque(maxlen=_MOST_EVENTS)
        self.last = 0
        self.time = -math.inf
        self.witnesses: tuple[Callable[[Any], None], ...] = ()

    def append(self, event: Any) -> None:  # noqa: ANN401  # an `Event`, which has a plan
        """Add an event, unless one of its number is there already."""
        if not self._events or self._events[-1].number < event.number:
            self._events.append(event)
        self.last = event.number
        self.time = event.time

    def resume(self, number: int) -> None:
        """Go on after an event that is not held here."""
        if number != self.last:
            self._events.clear()
            self.last = number

    def since(self, number: int) -> Iterator[Any]:
        """Yield the events after one, in order."""
        with self.reading():
            newest = list(islice(reversed(self._events), max(0, self.last - number)))
        newest.reverse()
        return iter(newest)

    def __iter__(self) -> Iterator[Any]:
        return self.since(0)

    def __len__(self) -> int:
        return len(self._events)


class Records:
    """All records by number, in order.

    `apply` only assigns, so that it can be repeated after an interrupt.

    Attributes:
        requests: requested actions by number of the event.
        required: the open ones of these by name of the action.
        plans: reconfiguration plans by their number.
        open_plans: those of these that have not ended.
        processes: by number of the event of the start.
        attempts: commands by their serial number.
        answers: answers about plans by number of the event.
        last_end: when a request ended last [s], and the number of that event.
        rejected: how many values of diagnostics could not be used.
    """

    def __init__(self) -> None:
        self.requests: dict[int, RequiredAction] = {}
        self.required: dict[str, RequiredAction] = {}
        self.plans: dict[int, ReconfigurationPlan] = {}
        self.open_plans: dict[int, ReconfigurationPlan] = {}
        self.processes: dict[int, Process] = {}
        self.attempts: dict[int, Attempt] = {}
        self.answers: dict[int, VetoAnswer] = {}
        self.last_end: tuple[float, int] | None = None
        self.rejected = 0

    def apply(self, event: Any) -> None:  # noqa: ANN401  # an `Event`, which has a plan
        """Enter what an event says."""
        now = event.time
        if event.plan is not None:
            self._add(self.plans, event.plan)
        match event.verb, event.arguments:
            case "request_action", (name, preference):
                if isinstance(preference, Mapping):
                    preference = MappingProxyType(dict(preference))
                request = RequiredAction(
                    name, preference, now, cause=event.cause, number=event.number
                )
                self._add(self.requests, request)
            case "cancel_action", (name, result, reason) if name in self.required:
                self.last_end = now, event.number
                _finish(self.required[name], result=result, reason=reason, end=now)
                del self.required[name]
            case "finish_plan", (number, result):
                if result == "completed":
                    for other in [key for key in self.open_plans if key != number]:
                        _finish(self.plans[other], result="abandoned", end=now)
                        del self.open_plans[other]
                _finish(self.plans[number], result=result, end=now)
                self.open_plans.pop(number, None)
            case "component_started", (name, pid):
                self._add(self.processes, Process(name, pid, now, number=event.number))
            case "component_ended", (name, pid):
                for process in self.processes.values():
                    if process.end is None and (process.component, process.pid) == (name, pid):
                        _finish(process, end=now)
            case "record_attempt", (number, component, operation, name, parameters, count):
                values = MappingProxyType(dict(parameters))
                command = self.plans[number], component, operation, name, values, count, now
                self._add(self.attempts, Attempt(*command, serial=event.number))
            case "finish_attempt", (serial, result, reason):
                if serial in self.attempts:
                    _finish(self.attempts[serial], result=result, reason=reason, end=now)
            case "record_answer", (number, is_vetoed, reason):
                answer = VetoAnswer(self.plans[number], now, is_vetoed, reason, event.number)
                self._add(self.answers, answer)

    def _add(self, table: dict[int, RecordT], record: RecordT) -> None:
        """Add a record, unless there is one of this number already."""
        number = record.serial if isinstance(record, Attempt) else record.number
        own = table.setdefault(number, record)
        if isinstance(own, RequiredAction) and own.end is None:
            self.required.setdefault(own.action, own)
        elif isinstance(own, ReconfigurationPlan) and own.end is None:
            self.open_plans[number] = own
        if len(table) > 2 * _MOST:
            ended = [key for key, old in table.items() if getattr(old, "end", 0.0) is not None]
            for key in ended[:-_MOST]:
                del table[key]

    def begin(self, fact: RequiredActionFact, number: int, now: float) -> None:
        """Add a request that a model states; a missing start is the end, or else now [s]."""
        start = fact.start
        if start is None:
            start = now if fact.end is None else fact.end
        end = start if fact.end is None and fact.result else fact.end
        request = RequiredAction(
            fact.action, fact.preference, start, end, fact.result, number=number
        )
        self._add(self.requests, request)


class _Table(Generic[T]):
    """A property of the history: the records of a kind, in order."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, view: "HistoryView", _: type) -> tuple[T, ...]:
        with view.reading():
            return tuple(vars(view.records)[self._name].values())


class HistoryView:
    """The records that are needed less often; old ones that have ended may be forgotten.

    Attributes:
        actions: the actions that are or were required, in the order of the requests.
        open_plans: the plans that have not ended, in the order in which they were made.
        processes: the processes in which components ran or run, in order.
        attempts: the commands that were given, in order, each with its result.
        answers: the answers to whether a plan may be executed, in order.
        rejected: how many values of diagnostics could not be used so far.
    """

    def __init__(
        self, records: Records, reading: Callable[[], AbstractContextManager[object]]
    ) -> None:
        self.records = records
        self.reading = reading

    actions = _Table[RequiredAction]("requests")
    open_plans = _Table[ReconfigurationPlan]("open_plans")
    processes = _Table[Process]("processes")
    attempts = _Table[Attempt]("attempts")
    answers = _Table[VetoAnswer]("answers")

    @property
    def rejected(self) -> int:
        return self.records.rejected


def check_result(result: str) -> None:
    if result not in RESULTS:
        raise InvalidValue(f"{result!r} is no result; a result is one of {', '.join(RESULTS)}")


def read_only(values: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(values)


copyreg.pickle(MappingProxyType, lambda mapping: (read_only, (dict(mapping),)))


def _finish(record: object, **values: object) -> None:
    """End a record, which is frozen for everybody else."""
    for name, value in values.items():
        object.__setattr__(record, name, value)
