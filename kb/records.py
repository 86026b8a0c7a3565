"""The records: requested actions, reconfiguration plans, processes, attempts, and vetoes of plans."""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Generic, NamedTuple, TypeVar

from kb.elements import Parameters, is_number, table, whole
from kb.exceptions import InvalidValue
from kb.facts import PlanFact, ProcessFact, RequiredActionFact

if TYPE_CHECKING:
    from kb.events import Event

T = TypeVar("T")

RESULTS: Final = ("completed", "failed", "abandoned")
_MOST_END_REASONS: Final = 4


@dataclass(frozen=True, slots=True)
class Memory:
    """How much of the past a knowledge base holds in memory; facts that hold now are never forgotten.

    The newest are held: at least as many as given here, and at most twice as many.

    Attributes:
        events: number of measurements, and also of other events, in the log.
        measurements: number of measurements in the history of each attribute.
        records: number of plans, of requests, of processes, of attempts and of answers that have ended.
        span: whatever is older than this is forgotten too [s].
    """

    events: int = 100_000
    measurements: int = 100_000
    records: int = 10_000
    span: float = math.inf

    def __post_init__(self) -> None:
        for name in ("events", "measurements", "records"):
            whole(f"{name} of a memory", getattr(self, name))
        if not is_number(self.span) or not self.span > 0:
            raise InvalidValue(
                f"the span of a memory is a time in seconds above 0, not {self.span!r}"
            )


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
    """An action that a mission requested, from when, and how it ended; only the knowledge base can end it.

    Attributes:
        action: name of the action.
        preference: name of the attribute to favour when a configuration is chosen for it, or a mapping from names of
            attributes to weights, or None.
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
    """Which components to switch and configure, and the result; only the knowledge base that made a plan can end it.

    Attributes:
        activate: names of components to activate.
        deactivate: names of components to deactivate.
        parameters: names of configurations whose parameters are to be set.
        reason: why it was made, in words.
        start: when it was made [s].
        end: when it ended [s], None while it is open.
        result: "completed", "failed" or "abandoned", None while it is open.
        plain: the components among these that are not commanded: they are only noted as active or inactive.
        cause: number of the event that made it necessary, None if that is not known.
        number: 1 for the first plan of a knowledge base.
    """

    activate: tuple[str, ...]
    deactivate: tuple[str, ...]
    parameters: tuple[str, ...]
    reason: str
    start: float
    end: float | None = None
    result: str | None = None
    plain: frozenset[str] = frozenset()
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

    def _repr_html_(self) -> str:
        steps = (
            ("stop", self.deactivate),
            ("start", self.activate),
            ("configure", self.parameters),
        )
        rows = [(verb, name) for verb, names in steps for name in names]
        return table(
            f"plan {self.number}, {self.result or 'open'}: {self.reason}", ("step", "what"), rows
        )


@dataclass(frozen=True, slots=True, eq=False)
class Process:
    """A process of the operating system in which a component ran or runs; only the knowledge base can end the record.

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
        serial: 1 for the first attempt of a knowledge base.
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
        outcome = (
            f"{self.result or 'under way'}: {self.reason}"
            if self.reason
            else self.result or "under way"
        )
        return f"{self.operation} {self.component}, attempt {self.number}: {outcome}"


@dataclass(frozen=True, slots=True)
class VetoAnswer:
    """The answer to whether a plan may be executed.

    Attributes:
        plan: the plan that was asked about.
        time: when the answer was given [s].
        is_vetoed: whether the execution was forbidden.
        reason: why it was forbidden, in words.
    """

    plan: ReconfigurationPlan
    time: float
    is_vetoed: bool
    reason: str = ""


class RecordTable(Generic[T]):
    """The records of one kind by number, in order; old ones that have ended are forgotten.

    Attributes:
        begins: no record that ended after this time is forgotten [s].
    """

    def __init__(self, memory: Memory) -> None:
        self._memory = memory
        self._records: dict[int, T] = {}
        self._most = 2 * memory.records
        self.begins = -math.inf

    def __contains__(self, number: object) -> bool:
        return number in self._records

    def get(self, number: int) -> T | None:
        """Return a record by its number; None if there is none."""
        return self._records.get(number)

    def all(self) -> tuple[T, ...]:
        """Return all records, in order."""
        return tuple(self._records.values())

    def items(self) -> tuple[tuple[int, T], ...]:
        """Return all numbers and records, in order."""
        return tuple(self._records.items())

    def newest_first(self) -> Iterator[T]:
        """Yield all records, the newest first."""
        return reversed(self._records.values())

    @property
    def first(self) -> int:
        """The number of the oldest record; 0 without one."""
        return next(iter(self._records), 0)

    @property
    def last(self) -> int:
        """The number of the newest record; 0 without one."""
        return next(reversed(self._records), 0)

    def add(self, number: int, record: T) -> T:
        """Add a record, unless there is one of this number already; return the one that is there."""
        record = self._records.setdefault(number, record)
        if len(self._records) > self._most:
            self._forget()
        return record

    def _forget(self) -> None:
        ended = {
            number: end for number, one in self._records.items() if (end := _end(one)) is not None
        }
        ended.pop(self.last, None)
        horizon = max(ended.values(), default=0.0) - self._memory.span
        numbers = list(ended)
        excess = set(numbers[: max(0, len(numbers) - self._memory.records + 1)])
        excess.update(number for number, end in ended.items() if end < horizon)
        self.begins = max([self.begins, *(ended[number] for number in excess)])
        self._records = {
            number: record for number, record in self._records.items() if number not in excess
        }
        self._most = len(self._records) + self._memory.records


def _end(record: object) -> float | None:
    end: float | None = (
        record.time if isinstance(record, VetoAnswer) else getattr(record, "end", None)
    )
    return end


class Records:
    """All records. `apply` only assigns, so that it can be repeated after an interrupt.

    Attributes:
        requests, required: requested actions by number of the event, and the open ones by name.
        plans, open_plans: reconfiguration plans by their number, and those that have not ended.
        processes: by number of the event of the start.
        attempts: commands by their serial number.
        answers: answers about plans by number of the event.
        last_end: when a request ended last [s], and the number of that event.
        rejected: how many values of diagnostics could not be used.
        progress: saved progress by action and behaviour; empty if it starts anew.
    """

    def __init__(self, memory: Memory) -> None:
        self.requests = RecordTable[RequiredAction](memory)
        self.required: dict[str, RequiredAction] = {}
        self.plans = RecordTable[ReconfigurationPlan](memory)
        self.open_plans: dict[int, ReconfigurationPlan] = {}
        self.processes = RecordTable[Process](memory)
        self.attempts = RecordTable[Attempt](memory)
        self.answers = RecordTable[VetoAnswer](memory)
        self.last_end: tuple[float, int] | None = None
        self.rejected = 0
        self.progress: dict[tuple[str, str], str] = {}
        self._end_reasons: tuple[tuple[int, str], ...] = ()
        self._serials: dict[int, int] = {}  # of the attempt of the newest such event

    @property
    def end_reasons(self) -> tuple[str, ...]:
        """Why the latest requests ended since the last plan, in words."""
        return tuple(words for _, words in self._end_reasons)

    @property
    def begins(self) -> float:
        """All records that ended after this time are here [s]."""
        tables = (self.requests, self.plans, self.processes, self.attempts, self.answers)
        return max(table.begins for table in tables)

    def apply(self, event: "Event") -> None:
        """Enter what an event says."""
        if event.plan is not None:
            self._add_plan(event.plan)
        method = getattr(self, f"_apply_{event.verb}", None)
        if method is not None:
            method(event, *event.arguments)

    def _add_plan(self, plan: ReconfigurationPlan) -> None:
        if plan.number in self.plans:
            return
        if plan.end is None:
            self.open_plans[plan.number] = plan
        self._end_reasons = ()
        self.plans.add(plan.number, plan)

    def _apply_request_action(
        self, event: "Event", name: str, preference: str | Mapping[str, float] | None
    ) -> None:
        if preference is not None and not isinstance(preference, str):
            preference = MappingProxyType(dict(preference))
        record = RequiredAction(
            name, preference, event.time, cause=event.cause, number=event.number
        )
        self.required[name] = self.requests.add(event.number, record)

    def _apply_cancel_action(self, event: "Event", name: str, result: str, reason: str) -> None:
        record = self.required.get(name)
        if record is None:
            return
        if reason and (not self._end_reasons or self._end_reasons[-1][0] < event.number):
            words = f"{name} is {result}: {reason}"
            self._end_reasons = (*self._end_reasons, (event.number, words))[-_MOST_END_REASONS:]
        self.last_end = event.time, event.number
        finish(record, {"result": result, "reason": reason, "end": event.time})
        self.required.pop(name, None)

    def _apply_finish_plan(self, event: "Event", number: int, result: str) -> None:
        plan = self.plans.get(number)
        ended = [plan] if plan is not None else []
        if result == "completed":
            ended += self.open_plans.values()
        for other in ended:
            if other.end is None:
                end = result if other is plan else "abandoned"
                finish(other, {"result": end, "end": event.time})
        self.open_plans = {
            number: other for number, other in self.open_plans.items() if other.end is None
        }

    def _apply_component_started(self, event: "Event", name: str, pid: int) -> None:
        self.processes.add(event.number, Process(name, pid, event.time, number=event.number))

    def _apply_component_ended(self, event: "Event", name: str, pid: int | None) -> None:
        for process in self.running(name, pid):
            finish(process, {"end": event.time})

    def running(self, component: str, pid: int | None = None) -> list[Process]:
        """Return the processes of a component that run: the one of this number, or all."""
        return [
            process
            for process in self.processes.all()
            if process.component == component and process.end is None and pid in (None, process.pid)
        ]

    def _apply_record_attempt(
        self,
        event: "Event",
        plan: int,
        component: str,
        operation: str,
        configuration: str | None,
        parameters: Mapping[str, Any],
        number: int,
    ) -> None:
        if event.number not in self._serials:
            self._serials = {event.number: self.attempts.last + 1}
        serial = self._serials[event.number]
        of = self.plans.get(plan)
        if of is None:
            return  # it was forgotten
        values = MappingProxyType(dict(parameters))
        attempt = Attempt(
            of, component, operation, configuration, values, number, event.time, serial=serial
        )
        self.attempts.add(serial, attempt)

    def _apply_finish_attempt(self, event: "Event", serial: int, result: str, reason: str) -> None:
        attempt = self.attempts.get(serial)
        if attempt is not None:
            finish(attempt, {"result": result, "reason": reason, "end": event.time})

    def _apply_record_answer(self, event: "Event", plan: int, is_vetoed: bool, reason: str) -> None:
        of = self.plans.get(plan)
        if of is not None:
            self.answers.add(event.number, VetoAnswer(of, event.time, is_vetoed, reason))

    def _apply_progress(self, event: "Event", action: str, behaviour: str, saved: str) -> None:
        self.progress[action, behaviour] = saved

    def begin(
        self, fact: RequiredActionFact | PlanFact | ProcessFact, number: int, now: float
    ) -> None:
        """Add a record that a model states; a missing start is the end, or else now [s]."""
        start = fact.start
        if start is None:
            start = now if fact.end is None else fact.end
        if isinstance(fact, ProcessFact):
            process = Process(fact.component, fact.pid, start, fact.end, number)
            self.processes.add(number, process)
            return
        end = start if fact.end is None and fact.result is not None else fact.end
        if isinstance(fact, PlanFact):
            plan = ReconfigurationPlan(
                fact.activate,
                fact.deactivate,
                fact.parameters,
                "stated by the model",
                start,
                end,
                fact.result,
                number=self.plans.last + 1,
            )
            self._add_plan(plan)
            return
        preference: str | Mapping[str, float] | None = None
        if fact.preference:
            preference = MappingProxyType(dict(fact.preference))
            if list(fact.preference.values()) == [1.0]:
                (preference,) = fact.preference
        record = RequiredAction(fact.action, preference, start, end, fact.result, number=number)
        self.requests.add(number, record)
        if end is None:
            self.required.setdefault(fact.action, record)

    def plan_of(self, plan: object) -> ReconfigurationPlan:
        """Return a plan of these records, given by itself or by its number."""
        number = plan.number if isinstance(plan, ReconfigurationPlan) else plan
        own = self.plans.get(number) if type(number) is int else None
        if own is not None and plan in (own, number):
            return own
        numbers = f"{self.plans.first} to {self.plans.last}" if self.plans.last else "none yet"
        raise InvalidValue(
            f"{plan!r} is not a plan of this knowledge base; give one of kb.plans "
            f"(numbers: {numbers})"
        )

    def to_json(self) -> dict[str, Any]:
        """Return all records as values that JSON can hold."""
        held = {id(plan) for plan in self.plans.all()}
        answers = [
            (number, answer) for number, answer in self.answers.items() if id(answer.plan) in held
        ]
        return {
            "requests": [_written(record) for record in self.requests.all()],
            "plans": [_written(record) for record in self.plans.all()],
            "processes": [_written(record) for record in self.processes.all()],
            "attempts": [
                _written(record) for record in self.attempts.all() if id(record.plan) in held
            ],
            "answers": [[number, _written(answer)] for number, answer in answers],
            "end_reasons": self._end_reasons,
            "last_end": self.last_end,
            "rejected": self.rejected,
            "progress": [[*key, saved] for key, saved in self.progress.items()],
        }

    def from_json(self, written: Mapping[str, Any]) -> None:
        """Restore the records that `to_json` returned."""
        for values in written["requests"]:
            request = RequiredAction(**values)
            self.requests.add(request.number, request)
            if request.end is None:
                self.required[request.action] = request
        for values in written["processes"]:
            process = Process(**values)
            self.processes.add(process.number, process)
        for values in written["plans"]:
            for name in ("activate", "deactivate", "parameters"):
                values[name] = tuple(values[name])
            values["plain"] = frozenset(values["plain"])
            self._add_plan(ReconfigurationPlan(**values))
        for values in written["attempts"]:
            attempt = Attempt(**{**values, "plan": self.plans.get(values["plan"])})
            self.attempts.add(attempt.serial, attempt)
        for number, values in written["answers"]:
            answer = VetoAnswer(**{**values, "plan": self.plans.get(values["plan"])})
            self.answers.add(number, answer)
        self._end_reasons = tuple((number, words) for number, words in written["end_reasons"])
        if written["last_end"] is not None:
            time, number = written["last_end"]
            self.last_end = time, number
        self.rejected = written["rejected"]
        for action, behaviour, saved in written["progress"]:
            self.progress[action, behaviour] = saved


class HistoryView:
    """The records that are needed less often; old ones that have ended may be forgotten."""

    __slots__ = ("reading", "records")

    def __init__(
        self, records: Records, reading: Callable[[], AbstractContextManager[object]]
    ) -> None:
        self.records = records
        self.reading = reading

    @property
    def actions(self) -> tuple[RequiredAction, ...]:
        """The actions that are or were required, in the order of the requests."""
        with self.reading():
            return self.records.requests.all()

    @property
    def open_plans(self) -> tuple[ReconfigurationPlan, ...]:
        """The plans that have not ended, in the order in which they were made."""
        with self.reading():
            return tuple(self.records.open_plans.values())

    @property
    def attempts(self) -> tuple[Attempt, ...]:
        """The commands that were given, in order, each with its result."""
        with self.reading():
            return self.records.attempts.all()

    @property
    def answers(self) -> tuple[VetoAnswer, ...]:
        """The answers to whether a plan may be executed, in order."""
        with self.reading():
            return self.records.answers.all()

    @property
    def begins(self) -> float:
        """All records that ended after this time are here [s]; `-math.inf` while none is forgotten."""
        return self.records.begins

    @property
    def rejected(self) -> int:
        """How many values of diagnostics could not be used so far."""
        return self.records.rejected

    @property
    def progress(self) -> Mapping[tuple[str, str], str]:
        """The progress of interrupted actions, by action and behaviour, as the task layer has saved it."""
        with self.reading():
            return {key: saved for key, saved in self.records.progress.items() if saved}


def check_result(result: str) -> None:
    if result not in RESULTS:
        raise InvalidValue(f"{result!r} is no result; a result is one of {', '.join(RESULTS)}")


def finish(
    record: RequiredAction | ReconfigurationPlan | Process | Attempt, end: Mapping[str, Any]
) -> None:
    for name, value in end.items():
        object.__setattr__(record, name, value)


def _written(
    record: RequiredAction | ReconfigurationPlan | Process | Attempt | VetoAnswer,
) -> dict[str, Any]:
    return {field.name: plain(getattr(record, field.name)) for field in fields(record)}


def plain(value: object) -> object:
    """Return a value in a form that JSON can hold; a plan becomes its number."""
    if value is None or isinstance(value, str | int | float):
        return value
    if isinstance(value, tuple | list):
        return [plain(one) for one in value]
    if isinstance(value, frozenset):
        return sorted(value)
    if isinstance(value, Mapping):
        return {key: plain(one) for key, one in value.items()}
    return value.number if isinstance(value, ReconfigurationPlan) else value
