"""The records: requested actions, reconfiguration plans, processes, attempts, and vetoes of plans."""

import math
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Any, Final, Generic, NamedTuple, TypeVar

from kb.elements import Parameters, is_number, table, whole
from kb.exceptions import InvalidValue
from kb.facts import PlanFact, ProcessFact, RequiredActionFact

T = TypeVar("T")

RESULTS: Final = ("completed", "failed", "abandoned")


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


class Records:
    """All records, by number, in order. To put the same record here twice is the same as once."""

    def __init__(self, memory: Memory) -> None:
        self._memory = memory
        self.requests: dict[int, RequiredAction] = {}  # by number of the event of the request
        self.required: dict[str, RequiredAction] = {}  # those that are open, by action
        self.plans: dict[int, ReconfigurationPlan] = {}
        self.open_plans: dict[int, ReconfigurationPlan] = {}
        self.processes: dict[int, Process] = {}  # by number of the event of the start
        self.attempts: dict[int, Attempt] = {}
        self.answers: dict[int, VetoAnswer] = {}  # by number of the event
        self.ended: tuple[
            str, ...
        ] = ()  # why the latest requests ended since the last plan, in words
        self.last_end: tuple[float, int] | None = (
            None  # when a request ended last [s], and the number of that event
        )
        self.begins = -math.inf  # no record that ended after this time is forgotten [s]
        self.rejected = 0  # how many readings of diagnostics could not be used
        self.progress: dict[
            tuple[str, str], str
        ] = {}  # saved progress of actions; empty when they start anew
        self._full = dict.fromkeys(
            ("requests", "plans", "processes", "attempts", "answers"), 2 * memory.records
        )

    def put(self, name: str, number: int, record: Any) -> None:  # noqa: ANN401  # of the table of that name
        """Add a record; if there are too many, the oldest records that have ended are forgotten."""
        table: dict[int, Any] = getattr(self, name)
        table[number] = record
        if isinstance(record, RequiredAction) and record.end is None:
            self.required.setdefault(record.action, record)
        if isinstance(record, ReconfigurationPlan):
            self.ended = ()
            if record.end is None:
                self.open_plans[number] = record
        if len(table) > self._full[name]:
            self._forget(name, table)

    def _forget(self, name: str, table: dict[int, Any]) -> None:
        ends = {
            number: one.time if isinstance(one, VetoAnswer) else one.end
            for number, one in table.items()
        }
        ended = [(number, end) for number, end in ends.items() if end is not None]
        horizon = max((end for _, end in ended), default=0.0) - self._memory.span
        old = [one for one in ended[: -self._memory.records] if one[0] != next(reversed(table))]
        gone = dict(old + [one for one in ended[:-1] if one[1] < horizon])
        self.begins = max(self.begins, *gone.values(), -math.inf)
        setattr(self, name, {number: one for number, one in table.items() if number not in gone})
        self._full[name] = len(table) - len(gone) + self._memory.records

    def end_request(
        self, record: RequiredAction, ended: tuple[str, ...], event: int, end: Mapping[str, Any]
    ) -> None:
        finish(record, end)
        self.required.pop(record.action, None)
        self.ended = ended
        self.last_end = end["end"], event

    def end_plan(self, record: ReconfigurationPlan, result: str, end: float) -> None:
        for other in [record, *(self.open_plans.values() if result == "completed" else ())]:
            if other.end is None:
                finish(other, {"result": result if other is record else "abandoned", "end": end})
        self.open_plans = {
            number: one for number, one in self.open_plans.items() if one.end is None
        }

    def begin(
        self, fact: RequiredActionFact | PlanFact | ProcessFact, number: int, now: float
    ) -> None:
        """Add a record that a model states; a missing start is the end, or now [s] if that is missing too."""
        start = fact.start if fact.start is not None else fact.end if fact.end is not None else now
        if isinstance(fact, ProcessFact):
            self.put(
                "processes", number, Process(fact.component, fact.pid, start, fact.end, number)
            )
            return
        end = start if fact.end is None and fact.result is not None else fact.end
        if isinstance(fact, PlanFact):
            steps, reason = (fact.activate, fact.deactivate, fact.parameters), "stated by the model"
            number = next(reversed(self.plans), 0) + 1
            self.put(
                "plans",
                number,
                ReconfigurationPlan(*steps, reason, start, end, fact.result, number=number),
            )
            return
        weights = fact.preference
        preference: str | Mapping[str, float] | None = (
            MappingProxyType(dict(weights)) if weights else None
        )
        if weights and list(weights.values()) == [1.0]:
            (preference,) = weights
        self.put(
            "requests",
            number,
            RequiredAction(fact.action, preference, start, end, fact.result, number=number),
        )

    def plan_of(self, plan: object) -> ReconfigurationPlan:
        """Return a plan of these records, given by itself or by its number."""
        number = plan.number if isinstance(plan, ReconfigurationPlan) else plan
        found = self.plans.get(number) if type(number) is int else None
        if found is not None and plan in (found, number):
            return found
        numbers = (
            f"{next(iter(self.plans))} to {next(reversed(self.plans))}"
            if self.plans
            else "none yet"
        )
        raise InvalidValue(
            f"{plan!r} is not a plan of this knowledge base; give one of kb.plans (numbers: {numbers})"
        )

    def to_json(self) -> dict[str, Any]:
        """Return all records as values that JSON can hold, without attempts and answers about forgotten plans."""
        known = {id(plan) for plan in self.plans.values()}
        return {
            **{
                name: list(map(_written, getattr(self, name).values()))
                for name in ("requests", "plans", "processes")
            },
            "attempts": [_written(one) for one in self.attempts.values() if id(one.plan) in known],
            "answers": [
                [number, _written(one)]
                for number, one in self.answers.items()
                if id(one.plan) in known
            ],
            "ended": self.ended,
            "last_end": self.last_end,
            "progress": [[*key, saved] for key, saved in self.progress.items()],
        }

    def from_json(self, written: Mapping[str, Any]) -> None:
        """Restore the records that `to_json` returned."""
        for name, cls in (("requests", RequiredAction), ("processes", Process)):
            for values in written[name]:
                self.put(name, values["number"], cls(**values))
        for values in written["plans"]:
            tuples = {
                name: tuple(values[name]) for name in ("activate", "deactivate", "parameters")
            }
            made = ReconfigurationPlan(**{**values, **tuples, "plain": frozenset(values["plain"])})
            self.put("plans", made.number, made)
        for values in written["attempts"]:
            self.put(
                "attempts",
                values["serial"],
                Attempt(**{**values, "plan": self.plans[values["plan"]]}),
            )
        for number, values in written["answers"]:
            self.put(
                "answers", number, VetoAnswer(**{**values, "plan": self.plans[values["plan"]]})
            )
        self.progress = {
            (action, behaviour): saved for action, behaviour, saved in written.get("progress", ())
        }
        self.ended = tuple(written["ended"])
        last_end = written["last_end"]
        self.last_end = None if last_end is None else (last_end[0], last_end[1])


class _Kept(Generic[T]):
    """A property that gives the records of one table, in order."""

    def __init__(self, table: str) -> None:
        self._table = table

    def __get__(self, view: "HistoryView", _: type) -> tuple[T, ...]:
        with view.reading():
            return tuple(getattr(view.records, self._table).values())


class HistoryView:
    """The records that are needed less often; old ones that have ended may be forgotten, see `Memory`.

    Attributes:
        actions: the actions that are or were required, in the order of the requests.
        open_plans: the plans that have not ended, in the order in which they were made.
        attempts: the commands that were given, in order, each with its result.
        answers: the answers to whether a plan may be executed, in order.
    """

    __slots__ = ("reading", "records")

    actions = _Kept[RequiredAction]("requests")
    open_plans = _Kept[ReconfigurationPlan]("open_plans")
    attempts = _Kept[Attempt]("attempts")
    answers = _Kept[VetoAnswer]("answers")

    def __init__(
        self, records: Records, reading: Callable[[], AbstractContextManager[object]]
    ) -> None:
        self.records, self.reading = records, reading

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
