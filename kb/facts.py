"""What a model consists of, for code that reads or fills one; and the facts that it states from the start.

A file of a robot's model may say what was known when it was written; a knowledge base made of the model begins with
that. Without such facts no component is active, nothing is selected or required, and nothing is measured.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, Protocol

from kb import elements
from kb.status import Status


@dataclass(frozen=True, slots=True)
class MeasurementFact:
    """An attribute had a value, in its unit; a value that is not the latest one goes to the history only.

    The time of measurement is in s since 1970-01-01 UTC; None stands for the time when the knowledge base is made.
    """

    attribute: str
    value: float
    time: float | None = None
    latest: bool = True


@dataclass(frozen=True, slots=True)
class StatusFact:
    """A status is asserted, in place of the inferred one."""

    element: elements.Element | elements.Constraint
    status: Status


@dataclass(frozen=True, slots=True)
class RequiredFact:
    """An element is asserted to be required."""

    element: elements.Action | elements.Function | elements.Component


@dataclass(frozen=True, slots=True)
class SelectedFact:
    """A design or configuration is the one chosen."""

    element: elements.FunctionDesign | elements.Configuration


@dataclass(frozen=True, slots=True)
class ActiveFact:
    """A component is running."""

    component: str


@dataclass(frozen=True, slots=True)
class RequiredActionFact:
    """An action was requested, with the weight of each attribute to favour; without an end it is still required.

    Start and end are times [s since 1970-01-01 UTC]; a start of None is the time when the knowledge base is made.
    """

    action: str
    preference: Mapping[str, float] | None = None
    start: float | None = None
    end: float | None = None
    result: str | None = None


@dataclass(frozen=True, slots=True)
class ProcessFact:
    """A component ran, or runs, as a process of the operating system; times as in `RequiredActionFact`."""

    component: str
    pid: int
    start: float | None = None
    end: float | None = None


@dataclass(frozen=True, slots=True)
class PlanFact:
    """A reconfiguration plan was made; names as in `ReconfigurationPlan`, times as in `RequiredActionFact`."""

    activate: tuple[str, ...] = ()
    deactivate: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    start: float | None = None
    end: float | None = None
    result: str | None = None


ROSA: Final[Mapping[type, str]] = {
    **elements.KINDS,
    elements.Configuration: "component configuration",
    MeasurementFact: "measurement",
    StatusFact: "asserted status",
    RequiredFact: "asserted requirement",
    SelectedFact: "selection",
    ActiveFact: "activity",
    RequiredActionFact: "required action",
    ProcessFact: "component process",
    PlanFact: "reconfiguration plan",
}
"""What each class of element and fact is called in ROSA's files, each after those that it refers to."""

Fact = (
    MeasurementFact
    | StatusFact
    | RequiredFact
    | SelectedFact
    | ActiveFact
    | RequiredActionFact
    | ProcessFact
    | PlanFact
)


class Amended(NamedTuple):
    """One change of a model.

    Attributes:
        how: "declared", "changed" or "removed".
        elements: what was.
        put: makes the change, once or again.
        written: what `Model.amend` takes to make it in an equal model, as values for JSON.
    """

    how: str
    elements: tuple[elements.Changeable, ...]
    put: Callable[[], None]
    written: Any


class Contents(elements.Owner, Protocol):
    """A model, for those who read it or declare what a file says; see `Model`."""

    attributes: Mapping[str, elements.Attribute]
    tables: Mapping[type, Mapping[Any, Any]]
    notes: list[str]
    places: dict[elements.Element | elements.Constraint, str]

    @property
    def constraints(self) -> tuple[elements.Constraint, ...]: ...
    @property
    def estimations(self) -> tuple[elements.Estimation, ...]: ...
    @property
    def facts(self) -> tuple[Fact, ...]: ...
    def constrain(
        self, elements: Iterable[elements.Constrainable], expression: elements.Expression
    ) -> elements.Constraint: ...
    def add_fact(self, fact: Fact) -> None: ...
    def state(self, cls: type, values: Mapping[str, Any]) -> elements.Changeable | None: ...
