"""How a model is amended while it is in use: what may change of an element, and what goes when one is removed."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import fields, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Protocol, TypeVar, runtime_checkable

from kb.declarations import age, agreement, choice, flag, listed, pid, priority, span
from kb.declarations import parameters as checked_parameters
from kb.elements import (
    Action,
    Attribute,
    Component,
    Configuration,
    Constraint,
    Element,
    Estimation,
    EstimationKind,
    Function,
    FunctionDesign,
    StalePolicy,
    finite_number,
)
from kb.exceptions import AmbiguousName, InvalidValue, ModelError, UnknownName
from kb.facts import (
    ActiveFact,
    Fact,
    MeasurementFact,
    PlanFact,
    ProcessFact,
    RequiredActionFact,
    RequiredFact,
    SelectedFact,
    StatusFact,
)
from kb.requests import check_result
from kb.status import STATUSES, Status

if TYPE_CHECKING:
    from kb.model import Model

__all__ = [
    "Changeable",
    "Elements",
    "KINDS",
    "Observer",
    "checked_changes",
    "checked_fact",
    "concerns",
    "description",
    "named",
    "removal",
    "tables_of",
]

Changeable = Element | Constraint | Estimation
ElementT = TypeVar("ElementT", bound=Element)


class Elements(Mapping[str, ElementT]):
    """The elements of one kind by name, in order of declaration; an unknown name says which are near it.

    Args:
        kind: what one of them is called.
        table: in which they are.
    """

    __slots__ = ("_kind", "_table")

    def __init__(self, kind: str, table: Mapping[str, ElementT]) -> None:
        self._kind = kind
        self._table = table

    def __getitem__(self, name: str) -> ElementT:
        found = self._table.get(name) if isinstance(name, str) else None
        if found is None:
            raise UnknownName(self._kind, name, self._table)
        return found

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name in self._table

    def __iter__(self) -> Iterator[str]:
        return iter(self._table)

    def __len__(self) -> int:
        return len(self._table)

    def __repr__(self) -> str:
        return f"<{self._kind}s {', '.join(map(repr, self._table))}>" if self._table else f"<no {self._kind}s>"


@runtime_checkable
class Observer(Protocol):
    """What is told of every change of a model, after it."""

    def model_grew(self, added: Iterable[Changeable]) -> None:
        """Elements, with the constraints on them, were declared; all at once or not at all."""

    def model_changed(self, element: Changeable) -> None:
        """An element is not what it was."""

    def model_shrank(self, removed: Iterable[Changeable]) -> None:
        """Elements, with the constraints on them, were removed."""


KINDS: Final[Mapping[type, str]] = {
    Action: "action",
    Attribute: "attribute",
    Component: "component",
    Configuration: "configuration",
    Constraint: "constraint",
    Estimation: "estimation",
    Function: "function",
    FunctionDesign: "function design",
}
"""What each class of element is called."""

Check = Callable[[str, object], object]

_PRIORITY: Final[Mapping[str, Check]] = {"priority": priority}
_IMPROVE: Final[Mapping[str, Check]] = {
    "always_improve": lambda name, value: flag(f"always_improve of {name!r}", value)
}
_CHECKS: Final[Mapping[type, Mapping[str, Check]]] = {
    Action: {},
    Attribute: {
        "agreement": agreement,
        "max_age": age,
        "when_stale": lambda _, value: choice("policy for stale measurements", StalePolicy, value),
    },
    Component: {
        **_IMPROVE,
        "stops_to_configure": lambda name, value: flag(f"stops_to_configure of {name!r}", value),
    },
    Configuration: {**_PRIORITY, "parameters": checked_parameters},
    Constraint: {"value": lambda _, value: finite_number(value), "hysteresis": span, "dwell": span},
    Estimation: {
        "value": lambda _, value: finite_number(value),
        "kind": lambda _, value: choice("estimation kind", EstimationKind, value),
    },
    Function: _IMPROVE,
    FunctionDesign: _PRIORITY,
}


def named(model: "Model", name: str) -> Element:
    """Return the one element that has a name.

    Raises:
        AmbiguousName: elements of several kinds have it.
    """
    tables: dict[str, Mapping[str, Element]] = {
        "actions": model.actions,
        "functions": model.functions,
        "components": model.components,
        "designs": model.designs,
        "configurations": model.configurations,
        "attributes": model.attributes,
    }
    found = {word: table[name] for word, table in tables.items() if name in table}
    if not found:
        raise UnknownName("element", name, dict.fromkeys(one for table in tables.values() for one in table))
    if len(found) > 1:
        kinds = ", ".join(f"{'an' if kind[0] == 'a' else 'a'} {kind}" for kind in map(_kind, found.values()))
        raise AmbiguousName(f"{name!r} names several things: {kinds}; give the one meant, e.g. {_first(found, name)}")
    (element,) = found.values()
    return element


def _kind(element: Element) -> str:
    return KINDS[type(element)]


def _first(words: Iterable[str], name: str) -> str:
    return f"model.{next(iter(words))}[{name!r}]"


def checked_changes(element: Changeable, changes: Mapping[str, object]) -> dict[str, object]:
    """Return new values of an element's fields, all of which are allowed.

    Raises:
        ModelError: one of the fields cannot change; declare another element for that.
    """
    checks, kind = _CHECKS[type(element)], KINDS[type(element)]
    name = element.name if isinstance(element, Element) else element.attribute
    for field in changes:
        if field not in checks:
            allowed = ", ".join(checks) or "nothing"
            raise ModelError(f"{field!r} of {kind} {name!r} cannot change; what can: {allowed}")
    return {field: checks[field](name, value) for field, value in changes.items()}


def removal(model: "Model", element: Changeable) -> list[Changeable]:
    """Return an element and what goes with it; a constraint on other elements too is only loosened from this one.

    Raises:
        ModelError: something else in the model is made of it.
    """
    if isinstance(element, Element):
        users = _users(model, element)
        if users:
            raise ModelError(f"{element.name!r} is needed by {', '.join(users)}; remove that first")
    removed: list[Changeable] = [element]
    for constraint in model.constraints:
        if element in constraint.constrained:
            rest = tuple(one for one in constraint.constrained if one is not element)
            if rest:
                object.__setattr__(constraint, "constrained", rest)
            else:
                removed.append(constraint)
    removed += [one for one in model.estimations if one.causer is element]
    return removed


def _users(model: "Model", element: Element) -> list[str]:
    name = element.name
    if isinstance(element, Component):
        designs = [f"function design {one.name!r}" for one in model.designs.values() if name in one.components]
        return designs + [
            f"configuration {one.name!r}" for one in model.configurations.values() if one.component == name
        ]
    if isinstance(element, Function):
        actions = [f"action {one.name!r}" for one in model.actions.values() if name in one.functions]
        return actions + [f"function design {one.name!r}" for one in model.designs.values() if one.function == name]
    if isinstance(element, Attribute):
        constraints = [f"constraint {one}" for one in model.constraints if one.attribute == name]
        return constraints + [
            f"an estimation of {one.attribute!r}" for one in model.estimations if one.attribute == name
        ]
    return []


def checked_fact(model: "Model", fact: object) -> Fact:
    """Return a fact that speaks of elements of the model only, and says what such elements can be."""
    if not isinstance(fact, Fact):
        raise ModelError(f"a fact is one of those in kb.facts, not {fact!r}")
    if isinstance(fact, StatusFact):
        return replace(fact, status=_status(KINDS[type(fact.element)], fact.status))
    if isinstance(fact, RequiredFact | SelectedFact):
        kinds = _REQUIRABLE if isinstance(fact, RequiredFact) else _SELECTABLE
        if not isinstance(fact.element, kinds):
            what = "required" if isinstance(fact, RequiredFact) else "selected"
            raise ModelError(f"{KINDS[type(fact.element)]} cannot be stated to be {what}: {fact.element!r}")
        return fact
    tables = {
        "attribute": model.attributes,
        "action": model.actions,
        "component": model.components,
        "configuration": model.configurations,
    }
    for kind, name in _names(fact):
        if not isinstance(name, str) or name not in tables[kind]:
            raise UnknownName(kind, name, tables[kind])
    if isinstance(fact, MeasurementFact):
        flag(f"latest of the measurement of {fact.attribute!r}", fact.latest)
        return replace(fact, value=finite_number(fact.value), time=_time(fact.time))
    if isinstance(fact, ActiveFact):
        return fact
    if isinstance(fact, ProcessFact):
        return replace(fact, pid=pid(fact.pid), start=_time(fact.start), end=_time(fact.end))
    if fact.result is not None:
        check_result(fact.result)
    if isinstance(fact, RequiredActionFact) and fact.preference is not None:
        weights = {name: finite_number(weight) for name, weight in fact.preference.items()}
        fact = replace(fact, preference=MappingProxyType(weights) if weights else None)
    return replace(fact, start=_time(fact.start), end=_time(fact.end))


_REQUIRABLE: Final = (Action, Function, Component)
_SELECTABLE: Final = (FunctionDesign, Configuration)


def _status(kind: str, given: object) -> Status:
    known = STATUSES.get(kind, ())
    found = next((status for status in known if status == given), None)
    if found is None:
        raise InvalidValue(f"a {kind} is never {given!s}; it can be {', '.join(known)}")
    return found


def _time(time: float | None) -> float | None:
    return None if time is None else finite_number(time)


def _names(fact: Fact) -> list[tuple[str, str]]:
    """List the kind and name of each element that a fact gives by name."""
    if isinstance(fact, MeasurementFact):
        return [("attribute", fact.attribute)]
    if isinstance(fact, ActiveFact | ProcessFact):
        return [("component", fact.component)]
    if isinstance(fact, RequiredActionFact):
        if not isinstance(fact.preference, Mapping | None):
            raise ModelError(f"a preference is given as weights by name of attribute, not as {fact.preference!r}")
        return [("action", fact.action), *(("attribute", name) for name in fact.preference or {})]
    if isinstance(fact, PlanFact):
        switched = [*listed("activate", fact.activate), *listed("deactivate", fact.deactivate)]
        configured = listed("parameters", fact.parameters)
        return [("component", name) for name in switched] + [("configuration", name) for name in configured]
    return []


def concerns(fact: Fact, removed: Collection[Changeable]) -> bool:
    """Tell whether a fact is about something that is removed."""
    if isinstance(fact, StatusFact | RequiredFact | SelectedFact):
        return fact.element in removed
    gone = {(KINDS[type(one)], one.name) for one in removed if isinstance(one, Element)}
    return any(named in gone for named in _names(fact))


def tables_of(model: "Model") -> tuple[Mapping[str, Element], ...]:
    """Return all elements that have names, kind by kind, so that what refers to others comes after these."""
    return (
        model.attributes,
        model.components,
        model.configurations,
        model.functions,
        model.designs,
        model.actions,
    )


def description(model: "Model") -> object:
    """Return all that a model says, as plain values that can be compared."""
    number = {constraint: position for position, constraint in enumerate(model.constraints)}

    def plain(value: object) -> object:
        if isinstance(value, Constraint):
            return ("constraint", number[value])
        if isinstance(value, Element):
            return (KINDS[type(value)], value.name)
        if isinstance(value, Mapping):
            return {key: (type(one), one) for key, one in value.items()}
        return tuple(plain(one) for one in value) if isinstance(value, tuple) else value

    def contents(one: object) -> list[object]:
        return [plain(getattr(one, field.name)) for field in fields(one) if field.name != "model"]  # type: ignore[arg-type]  # all are dataclasses

    return (
        model.name,
        [[contents(one) for one in table.values()] for table in tables_of(model)],
        [contents(one) for one in model.constraints],
        [contents(one) for one in model.estimations],
        [(type(one), contents(one)) for one in model.facts],
    )
