"""What a model consists of, for those who read or fill one: what refers to what, and the facts that it states."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import fields, replace
from types import MappingProxyType
from typing import Final, Protocol, TypeVar

from kb import elements, facts
from kb.declarations import flag, listed, pid
from kb.elements import KINDS, REFERENCES, Changeable, Constraint, Element, finite_number
from kb.exceptions import AmbiguousName, InvalidValue, ModelError, UnknownName
from kb.facts import Fact
from kb.records import check_result
from kb.status import STATUSES, Status

ElementT = TypeVar("ElementT", bound=Element)

_TABLES: Final[Mapping[str, type[Element]]] = {
    "actions": elements.Action,
    "functions": elements.Function,
    "components": elements.Component,
    "designs": elements.FunctionDesign,
    "configurations": elements.Configuration,
    "attributes": elements.Attribute,
}
_REQUIRABLE: Final = (elements.Action, elements.Function, elements.Component)
_SELECTABLE: Final = (elements.FunctionDesign, elements.Configuration)


class Contents(elements.Owner, Protocol):
    """A model, for those who read it or declare what a file says; see `Model`."""

    attributes: Mapping[str, elements.Attribute]
    components: Mapping[str, elements.Component]
    configurations: Mapping[str, elements.Configuration]
    functions: Mapping[str, elements.Function]
    designs: Mapping[str, elements.FunctionDesign]
    actions: Mapping[str, elements.Action]
    notes: list[str]
    places: dict[Element | Constraint, str]

    @property
    def constraints(self) -> tuple[Constraint, ...]: ...
    @property
    def estimations(self) -> tuple[elements.Estimation, ...]: ...
    @property
    def facts(self) -> tuple[Fact, ...]: ...
    def constrain(self, elements: Iterable[elements.Constrainable], expression: elements.Expression) -> Constraint: ...
    def add_fact(self, fact: Fact) -> None: ...


class Observer(Protocol):
    """What is informed of every change of a model, after it."""

    def model_grew(self, added: Iterable[Changeable]) -> None:
        """Elements, with the constraints on them, were declared; all at once or not at all."""

    def model_changed(self, element: Changeable) -> None:
        """An element is not what it was."""

    def model_shrank(self, removed: Iterable[Changeable]) -> None:
        """Elements, with the constraints on them, were removed."""


class Elements(Mapping[str, ElementT]):
    """The elements of one kind by name, in order of declaration; an unknown name says which are near it."""

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


def tables_of(model: Contents) -> Mapping[type[Element], Mapping[str, Element]]:
    """Return all elements that have names by their class, so that what refers to others comes after these."""
    tables = {cls: getattr(model, word) for word, cls in _TABLES.items()}
    return {cls: tables[cls] for cls in KINDS if cls in tables}


def named(model: Contents, name: str) -> Element:
    """Return the one element that has a name.

    Raises:
        AmbiguousName: elements of several kinds have it.
    """
    tables = tables_of(model)
    found = {word: tables[cls][name] for word, cls in _TABLES.items() if name in tables[cls]}
    if not found:
        raise UnknownName("element", name, dict.fromkeys(one for table in tables.values() for one in table))
    if len(found) > 1:
        called = [KINDS[type(one)] for one in found.values()]
        kinds = ", ".join(f"{'an' if kind[0] == 'a' else 'a'} {kind}" for kind in called)
        first = f"model.{next(iter(found))}[{name!r}]"
        raise AmbiguousName(f"{name!r} names several things: {kinds}; give the one meant, e.g. {first}")
    (element,) = found.values()
    return element


def users_of(model: Contents, element: Element) -> list[str]:
    """Describe what in a model is made of an element."""
    fields = [field for field, cls in REFERENCES.items() if isinstance(element, cls)]
    owners = (*model.actions.values(), *model.designs.values(), *model.configurations.values())
    users: dict[Changeable, str] = {one: f"{KINDS[type(one)]} {one.name!r}" for one in owners}
    users |= {one: f"constraint {one}" for one in model.constraints}
    users |= {one: f"an estimation of {one.attribute!r}" for one in model.estimations}
    return [text for one, text in users.items() if any(_names(getattr(one, field, ()), element) for field in fields)]


def _names(value: str | Collection[str], element: Element) -> bool:
    return value == element.name if isinstance(value, str) else element.name in value


def checked_fact(model: Contents, fact: object) -> Fact:
    """Return a fact that speaks of elements of the model only, and says what such elements can be."""
    if not isinstance(fact, Fact):
        raise ModelError(f"a fact is one of those in kb.facts, not {fact!r}")
    if isinstance(fact, facts.StatusFact):
        return replace(fact, status=_status(KINDS[type(fact.element)], fact.status))
    if isinstance(fact, facts.RequiredFact | facts.SelectedFact):
        kinds, what = (_REQUIRABLE, "required") if isinstance(fact, facts.RequiredFact) else (_SELECTABLE, "selected")
        if not isinstance(fact.element, kinds):
            raise ModelError(f"{KINDS[type(fact.element)]} cannot be stated to be {what}: {fact.element!r}")
        return fact
    tables = tables_of(model)
    for cls, name in _named_by(fact):
        if not isinstance(name, str) or name not in tables[cls]:
            raise UnknownName(KINDS[cls], name, tables[cls])
    if isinstance(fact, facts.MeasurementFact):
        flag(f"latest of the measurement of {fact.attribute!r}", fact.latest)
        return replace(fact, value=finite_number(fact.value), time=_time(fact.time))
    if isinstance(fact, facts.ActiveFact):
        return fact
    if isinstance(fact, facts.ProcessFact):
        return replace(fact, pid=pid(fact.pid), start=_time(fact.start), end=_time(fact.end))
    if fact.result is not None:
        check_result(fact.result)
    if isinstance(fact, facts.RequiredActionFact) and fact.preference is not None:
        weights = {name: finite_number(weight) for name, weight in fact.preference.items()}
        fact = replace(fact, preference=MappingProxyType(weights) if weights else None)
    return replace(fact, start=_time(fact.start), end=_time(fact.end))


def _status(kind: str, given: object) -> Status:
    known = STATUSES.get(kind, ())
    found = next((status for status in known if status == given), None)
    if found is None:
        raise InvalidValue(f"a {kind} is never {given!s}; it can be {', '.join(known)}")
    return found


def _time(time: float | None) -> float | None:
    return None if time is None else finite_number(time)


def _named_by(fact: Fact) -> Iterator[tuple[type[Element], str]]:
    """Yield the class and name of each element that a fact gives by name."""
    for field in fields(fact):
        value = getattr(fact, field.name)
        if field.name == "preference" and value is not None:
            if not isinstance(value, Mapping):
                raise ModelError(f"a preference is given as weights by name of attribute, not as {value!r}")
            yield from ((elements.Attribute, name) for name in value)
        elif field.name in REFERENCES:
            names = listed(field.name, value) if isinstance(fact, facts.PlanFact) else (value,)
            yield from ((REFERENCES[field.name], name) for name in names)


def concerns(fact: Fact, removed: Collection[Changeable]) -> bool:
    """Tell whether a fact is about something that is removed."""
    if isinstance(fact, facts.StatusFact | facts.RequiredFact | facts.SelectedFact):
        return fact.element in removed
    gone = {(type(one), one.name) for one in removed if isinstance(one, Element)}
    return any(one in gone for one in _named_by(fact))


def description(model: Contents) -> object:
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

    def contents(one: Changeable | Fact) -> list[object]:
        return [type(one), *(plain(getattr(one, field.name)) for field in fields(one) if field.name != "model")]

    everything = [one for table in tables_of(model).values() for one in table.values()]
    return model.name, [contents(one) for one in (*everything, *model.constraints, *model.estimations, *model.facts)]
