"""The records: requested actions, reconfiguration plans, processes, attempts, and vetoes of plans."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Final, NamedTuple, TypeVar

from kb.elements import Parameters, is_number, table, whole
from kb.exceptions import InvalidValue

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


def check_result(result: str) -> None:
    if result not in RESULTS:
        raise InvalidValue(f"{result!r} is no result; a result is one of {', '.join(RESULTS)}")


def finish(
    record: RequiredAction | ReconfigurationPlan | Process | Attempt, end: Mapping[str, Any]
) -> None:
    for name, value in end.items():
        object.__setattr__(record, name, value)


def written(
    record: RequiredAction | ReconfigurationPlan | Process | Attempt | VetoAnswer,
) -> dict[str, Any]:
    """Return a record as values that JSON can hold."""
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
