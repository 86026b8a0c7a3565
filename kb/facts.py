"""What a model consists of, for those who read or fill one; and the facts that it states from the start.

A file of a robot's model may say what was known when it was written; a knowledge base made of the model begins with
that. What is not stated is not so: no component is active, nothing is selected or required, nothing is measured.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol

from kb.elements import (
    KINDS,
    Action,
    Attribute,
    Changeable,
    Component,
    Configuration,
    Constrainable,
    Constraint,
    Element,
    Estimation,
    Expression,
    Function,
    FunctionDesign,
    Owner,
)
from kb.status import Status


@dataclass(frozen=True, slots=True)
class MeasurementFact:
    """An attribute had a value.

    Attributes:
        attribute: its name.
        value: in the attribute's unit.
        time: when [s since 1970-01-01 UTC]; None for the time when the knowledge base is made.
        latest: nothing newer was known; otherwise it belongs to the history only.
    """

    attribute: str
    value: float
    time: float | None = None
    latest: bool = True


@dataclass(frozen=True, slots=True)
class StatusFact:
    """A status is asserted, in place of the inferred one."""

    element: Element | Constraint
    status: Status


@dataclass(frozen=True, slots=True)
class RequiredFact:
    """An element is asserted to be required."""

    element: Action | Function | Component


@dataclass(frozen=True, slots=True)
class SelectedFact:
    """A design or configuration is the one chosen."""

    element: FunctionDesign | Configuration


@dataclass(frozen=True, slots=True)
class ActiveFact:
    """A component is running."""

    component: str


@dataclass(frozen=True, slots=True)
class RequiredActionFact:
    """An action was asked for; it still is while there is no end.

    Attributes:
        action: its name.
        preference: weight by name of each attribute to favour.
        start, end: [s since 1970-01-01 UTC]; a start of None is the time when the knowledge base is made.
        result: "completed", "failed" or "abandoned", None while it is open.
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
    """One change of a model: how ("declared", "changed" or "removed"), of what; `put` makes it, once or again."""

    how: str
    elements: tuple[Changeable, ...]
    put: Callable[[], None]


TABLES: Final[Mapping[str, type[Element]]] = {
    "actions": Action,
    "functions": Function,
    "components": Component,
    "designs": FunctionDesign,
    "configurations": Configuration,
    "attributes": Attribute,
}
"""The mapping of a model that holds the elements of each class."""


class Contents(Owner, Protocol):
    """A model, for those who read it or declare what a file says; see `Model`."""

    attributes: Mapping[str, Attribute]
    components: Mapping[str, Component]
    configurations: Mapping[str, Configuration]
    functions: Mapping[str, Function]
    designs: Mapping[str, FunctionDesign]
    actions: Mapping[str, Action]
    notes: list[str]
    places: dict[Element | Constraint, str]

    @property
    def constraints(self) -> tuple[Constraint, ...]: ...
    @property
    def estimations(self) -> tuple[Estimation, ...]: ...
    @property
    def facts(self) -> tuple[Fact, ...]: ...
    def constrain(self, elements: Iterable[Constrainable], expression: Expression) -> Constraint: ...
    def add_fact(self, fact: Fact) -> None: ...


def tables_of(model: Contents) -> Mapping[type[Element], Mapping[str, Element]]:
    """Return all elements that have names by their class, so that what refers to others comes after these."""
    tables = {cls: getattr(model, word) for word, cls in TABLES.items()}
    return {cls: tables[cls] for cls in KINDS if cls in tables}
