"""What is put on record: actions that were requested, plans, processes, attempts, and answers about plans."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from kb.elements import Parameters
from kb.exceptions import InvalidValue
from kb.facts import PlanFact, ProcessFact, RequiredActionFact
from kb.notebook import table

KEPT_RECORDS: Final = 10_000
"""How many attempts and how many answers are remembered; the newest."""

RESULTS: Final = ("completed", "failed", "abandoned")


class Reply(NamedTuple):
    """The answer to a request; true if it was accepted.

    Attributes:
        accepted: whether the action is required now.
        reason: why it was refused; what was accepted otherwise.
    """

    accepted: bool
    reason: str

    def __bool__(self) -> bool:
        return self.accepted


@dataclass(frozen=True, slots=True, eq=False)
class RequiredAction:
    """An action that a mission asked for, from when, and how it ended; only the knowledge base can end it.

    Attributes:
        action: its name.
        preference: name of the attribute preferred when a configuration is chosen for it, or the weight of each of
            several by name, or None.
        start: when it was requested [s].
        end: when it ended [s], None while it is open.
        result: "completed", "failed" or "abandoned", None while it is open.
        reason: why it ended so, in words, where that was told.
        cause: number of the event that led to the request, as far as that is known.
        number: of the event that it began with.
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
    """What to switch, and what became of it; only the knowledge base that made it can end it.

    Attributes:
        activate: names of components to activate.
        deactivate: names of components to deactivate.
        parameters: names of configurations whose parameters are to be set.
        reason: why, in words.
        start: when it was made [s].
        end: when it ended [s], None while it is open.
        result: "completed", "failed" or "abandoned", None while it is open.
        plain: those to activate or deactivate that nobody commands: it is only noted that they are active or not.
        cause: number of the event that made it needed, as far as that is known.
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
        steps = (("stop", self.deactivate), ("start", self.activate), ("configure", self.parameters))
        rows = [(verb, name) for verb, names in steps for name in names]
        return table(f"plan {self.number}, {self.result or 'open'}: {self.reason}", ("step", "what"), rows)


@dataclass(frozen=True, slots=True, eq=False)
class Process:
    """A process of the operating system as which a component ran, or runs; only the knowledge base can end it.

    Attributes:
        component: name of the component.
        pid: number of the process.
        start: when it was started [s].
        end: when it ended [s], None while it runs.
        number: of the event that it began with.
    """

    component: str
    pid: int
    start: float
    end: float | None = None
    number: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Attempt:
    """One command that was given once; only the knowledge base can end it.

    Attributes:
        plan: what it was part of.
        component: name of what was commanded.
        operation: "activate", "deactivate" or "configure".
        configuration: name of what the component was to be configured with, None for a switch.
        parameters: what was to be set; empty for a switch.
        number: 1 for the first time that the plan gave this command.
        start: when it was given [s].
        end: when it was found to have ended [s], None while it is under way.
        result: "completed", "failed" or "abandoned", None while it is under way.
        reason: why it failed, in words, or what was odd about it.
        serial: 1 for the first attempt of all.
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
        outcome = f"{self.result or 'under way'}: {self.reason}" if self.reason else self.result or "under way"
        return f"{self.operation} {self.component}, attempt {self.number}: {outcome}"


@dataclass(frozen=True, slots=True)
class VetoAnswer:
    """What was answered about a plan before it was executed.

    Attributes:
        plan: what was asked about.
        time: when [s].
        is_vetoed: it was not to be executed.
        reason: why not, in words.
    """

    plan: ReconfigurationPlan
    time: float
    is_vetoed: bool
    reason: str = ""


class Records:
    """All that is on record, by number, in order. What is put here may be put again.

    Attributes:
        requests: by number of the event that they began with.
        required: the open requests, by action.
        plans: by their own number.
        open_plans: those that have not ended.
        processes: by number of the event that they began with.
        attempts: by their serial number; the newest.
        answers: by number of the event; the newest.
        ended: why requests have ended since the last plan, in words; the newest.
        last_end: when a request ended last [s], and the number of that event.
        rejected: how many readings of diagnostics could not be used.
    """

    def __init__(self) -> None:
        self.requests: dict[int, RequiredAction] = {}
        self.required: dict[str, RequiredAction] = {}
        self.plans: dict[int, ReconfigurationPlan] = {}
        self.open_plans: dict[int, ReconfigurationPlan] = {}
        self.processes: dict[int, Process] = {}
        self.attempts: dict[int, Attempt] = {}
        self.answers: dict[int, VetoAnswer] = {}
        self.ended: tuple[str, ...] = ()
        self.last_end: tuple[float, int] | None = None
        self.rejected = 0

    def request(self, record: RequiredAction) -> None:
        self.requests[record.number] = record
        if record.end is None:
            self.required[record.action] = record

    def end_request(self, record: RequiredAction, ended: tuple[str, ...], event: int, **end: Any) -> None:  # noqa: ANN401  # what a field holds
        finish(record, **end)
        self.required.pop(record.action, None)
        self.ended = ended
        self.last_end = end["end"], event

    def plan(self, record: ReconfigurationPlan) -> None:
        self.plans[record.number] = record
        self.ended = ()
        if record.end is None:
            self.open_plans[record.number] = record

    def end_plan(self, record: ReconfigurationPlan, result: str, end: float) -> None:
        for other in [record, *(self.open_plans.values() if result == "completed" else ())]:
            if other.end is None:
                finish(other, result=result if other is record else "abandoned", end=end)
        self.open_plans = {number: one for number, one in self.open_plans.items() if one.end is None}

    def attempt(self, record: Attempt) -> None:
        self.attempts[record.serial] = record
        self.attempts.pop(record.serial - KEPT_RECORDS, None)

    def answer(self, number: int, record: VetoAnswer) -> None:
        self.answers[number] = record
        if len(self.answers) > KEPT_RECORDS:
            del self.answers[next(iter(self.answers))]

    def begin_request(self, fact: RequiredActionFact, number: int, now: float) -> None:
        """Put a request on record that a model states; one that is open began now if nothing else is stated."""
        weights = fact.preference
        preference: str | Mapping[str, float] | None = MappingProxyType(dict(weights)) if weights else None
        if weights and list(weights.values()) == [1.0]:
            (preference,) = weights
        start, end = _start(fact, now), _end(fact, now)
        record = RequiredAction(fact.action, preference, start, end, fact.result, number=number)
        if end is None and fact.action in self.required:
            self.requests[number] = record
        else:
            self.request(record)

    def begin(self, fact: PlanFact | ProcessFact, number: int, now: float) -> None:
        start = _start(fact, now)
        if isinstance(fact, ProcessFact):
            self.processes[number] = Process(fact.component, fact.pid, start, fact.end, number)
            return
        steps, reason = (fact.activate, fact.deactivate, fact.parameters), "stated by the model"
        self.plan(ReconfigurationPlan(*steps, reason, start, _end(fact, now), fact.result, number=len(self.plans) + 1))

    def plan_of(self, plan: object) -> ReconfigurationPlan:
        found = self.plans.get(plan) if isinstance(plan, int) else plan
        if isinstance(found, ReconfigurationPlan):
            return found
        raise InvalidValue(f"{plan!r} is no plan; give one of kb.plans")

    def to_json(self) -> dict[str, Any]:
        """Return all of it as values that JSON can hold, except what has to do with the plans of other bases."""
        known = {id(plan) for plan in self.plans.values()}
        return {
            "requests": [_written(one) for one in self.requests.values()],
            "plans": [_written(one) for one in self.plans.values()],
            "processes": [_written(one) for one in self.processes.values()],
            "attempts": [_written(one) for one in self.attempts.values() if id(one.plan) in known],
            "answers": [[number, _written(one)] for number, one in self.answers.items() if id(one.plan) in known],
            "ended": self.ended,
            "last_end": self.last_end,
        }

    def from_json(self, written: Mapping[str, Any]) -> None:
        """Put on record what `to_json` returned."""
        for values in written["requests"]:
            self.request(RequiredAction(**values))
        for values in written["plans"]:
            tuples = {name: tuple(values[name]) for name in ("activate", "deactivate", "parameters")}
            self.plan(ReconfigurationPlan(**{**values, **tuples, "plain": frozenset(values["plain"])}))
        for values in written["processes"]:
            self.processes[values["number"]] = Process(**values)
        for values in written["attempts"]:
            self.attempt(Attempt(**{**values, "plan": self.plans[values["plan"]]}))
        for number, values in written["answers"]:
            self.answer(number, VetoAnswer(**{**values, "plan": self.plans[values["plan"]]}))
        self.ended = tuple(written["ended"])
        last_end = written["last_end"]
        self.last_end = None if last_end is None else (last_end[0], last_end[1])


class HistoryView:
    """What is not asked every day, of all that is on record."""

    def __init__(self, records: Records) -> None:
        self._records = records

    @property
    def actions(self) -> tuple[RequiredAction, ...]:
        """Every action that was ever required, in the order of the requests."""
        return tuple(self._records.requests.values())

    @property
    def rejected(self) -> int:
        """How many readings of diagnostics could not be used so far."""
        return self._records.rejected

    @property
    def attempts(self) -> tuple[Attempt, ...]:
        """The commands that were given, in order, with what came of each; the newest 10,000."""
        return tuple(self._records.attempts.values())

    @property
    def answers(self) -> tuple[VetoAnswer, ...]:
        """What was answered about plans before they were executed, in order; the newest 10,000."""
        return tuple(self._records.answers.values())


def check_result(result: str) -> None:
    if result not in RESULTS:
        raise InvalidValue(f"{result!r} is no result; a result is one of {', '.join(RESULTS)}")


def finish(record: RequiredAction | ReconfigurationPlan | Process | Attempt, **end: Any) -> None:  # noqa: ANN401  # what a field holds
    for name, value in end.items():
        object.__setattr__(record, name, value)


def _start(fact: RequiredActionFact | PlanFact | ProcessFact, now: float) -> float:
    return fact.start if fact.start is not None else fact.end if fact.end is not None else now


def _end(fact: RequiredActionFact | PlanFact, now: float) -> float | None:
    if fact.end is None and fact.result is not None:
        return fact.start if fact.start is not None else now
    return fact.end


def _written(record: RequiredAction | ReconfigurationPlan | Process | Attempt | VetoAnswer) -> dict[str, Any]:
    return {field.name: _plain(getattr(record, field.name)) for field in fields(record)}


def _plain(value: object) -> object:
    if isinstance(value, ReconfigurationPlan):
        return value.number
    if isinstance(value, frozenset):
        return sorted(value)
    return dict(value) if isinstance(value, Mapping) else value
