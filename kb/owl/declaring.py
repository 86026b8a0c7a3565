"""From individuals to a model again: the way back from `individuals`."""

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, fields
from typing import Any, Final

from kb.elements import (
    REFERENCES,
    Attribute,
    Changeable,
    Component,
    Configuration,
    Constraint,
    Element,
    Estimation,
    Expression,
    choice,
    finite_number,
)
from kb.exceptions import InvalidValue, KnowledgeBaseError, ModelError, UnknownName
from kb.facts import Contents, StatusFact
from kb.owl.individuals import CLASSES, GENERAL, SPECIAL, Individual, Ref, Value, parameter_values, property_of
from kb.status import Status

_CLASSES: Final[Mapping[str, Any]] = {kind: cls for cls, kind in CLASSES.items()}
_RANKS: Final = {kind: rank for rank, kind in enumerate(CLASSES.values())}
_LISTS: Final = frozenset({"functions", "components", "constrained", "activate", "deactivate", "parameters"})
_UNSAID: Final = frozenset({"position", "prefersNothing"})


class Declarer:
    """Declares individuals in a model, of which they may refer to the elements that are known, by id."""

    def __init__(self, model: Contents, known: Mapping[str, Changeable] | None = None) -> None:
        self.model = model
        self.known: dict[str, Changeable] = dict(known or {})
        self.nested: dict[str, Individual] = {}

    def declare(self, given: Iterable[Individual]) -> None:
        """Declare individuals, each after those that it can refer to, and those of a kind in order.

        Raises:
            ModelError: the model refuses one; the message says which.
        """
        listed = list(given)
        self.nested = {one.id: one for one in listed}
        for one in sorted((one for one in listed if GENERAL.get(one.kind, one.kind) in _CLASSES), key=_order):
            with _blamed(one.id):
                if (made := self._make(one)) is not None:
                    self.known[one.id] = made

    def values(self, cls: type, one: Individual) -> dict[str, Any]:
        """Return the fields that an individual gives to an element or fact."""
        own = {property_of(cls, field.name): field for field in fields(cls)}
        for name in one.values:
            if name not in own and name not in _UNSAID:
                raise UnknownName(f"property of {one.kind}", name, [each for each in own if each != "model"])
        found: dict[str, Any] = {}
        for name, field in own.items():
            if name in one.values:
                found[field.name] = self._value(cls, field.name, one.values[name])
            elif field.name in _LISTS:
                found[field.name] = {} if cls is Configuration else ()
            elif field.default is MISSING and field.name != "model":
                raise ModelError(f"it has no {name}")
        if "prefersNothing" in one.values:
            found["preference"] = {}
        return found

    def _value(self, cls: type, field: str, given: tuple[Value, ...]) -> object:
        if cls is Configuration and field == "parameters":
            with _well_written():
                return parameter_values(self._inner(one) for one in given)
        if field == "preference":
            return dict(self._weight(self._inner(one)) for one in given)
        if field in REFERENCES:
            names = tuple(self._element(one, REFERENCES[field]).name for one in given)
            return names if field in _LISTS else _single(field, names)
        if field in ("constrained", "causer", "element"):
            elements = tuple(self._element(one, object) for one in given)
            return elements if field in _LISTS else _single(field, elements)
        value = _single(field, given)
        if isinstance(value, Ref):
            raise ModelError(f"{field} is a value, not {value.id}")
        if field == "agreement":
            with _well_written():
                return tuple(json.loads(str(value)))
        return value

    def _inner(self, value: Value) -> Individual:
        if not isinstance(value, Ref) or value.id not in self.nested:
            raise ModelError(f"{_shown(value)} is no individual that is described")
        return self.nested[value.id]

    def _weight(self, one: Individual) -> tuple[str, Any]:
        attribute = _single("prefers", one.values.get("prefers", ()))
        return self._element(attribute, Attribute).name, _single("weight", one.values.get("weight", ()))

    def _element(self, value: Value, cls: type) -> Any:  # noqa: ANN401  # an element of the class
        found = self.known.get(value.id) if isinstance(value, Ref) else None
        if found is None or not isinstance(found, cls):
            known = [one for one, element in self.known.items() if isinstance(element, cls)]
            raise UnknownName(CLASSES.get(cls, "individual"), _shown(value), known)
        return found

    def _make(self, one: Individual) -> Changeable | None:
        cls = _CLASSES[GENERAL.get(one.kind, one.kind)]
        values = self.values(cls, one)
        if cls is Estimation:
            return self.model.add_estimation(**values)
        if cls is Constraint:
            constrained, value = values.pop("constrained"), finite_number(values.pop("value"))
            return self.model.constrain(constrained, Expression(**values, value=value))
        if issubclass(cls, Element):
            return self._declared(cls, one.kind, **values)
        if cls is StatusFact:
            values["status"] = choice("status", Status, values["status"])
        self.model.add_fact(cls(**values))
        return None

    def _declared(self, cls: type[Element], kind: str, name: str, **values: object) -> Element:
        if cls in (Attribute, Component):
            special = {other: one for (of, one), other in SPECIAL.items() if of is cls}
            if cls is Attribute and kind not in special:
                raise ModelError(f"an attribute is a {' or an '.join(special)}; say which")
            values |= {"kind": special[kind]} if kind in special else {}
        return self.model.declare(cls, name, **values)


@contextmanager
def _blamed(individual: str) -> Iterator[None]:
    try:
        yield
    except KnowledgeBaseError as error:
        raise ModelError(f"{individual}: {error}") from None


@contextmanager
def _well_written() -> Iterator[None]:
    try:
        yield
    except (ValueError, TypeError, LookupError) as error:
        raise InvalidValue(f"it is not written as it should be: {error}") from None


def _single(what: str, values: Iterable[Any]) -> Any:  # noqa: ANN401  # one of what is given
    listed = list(values)
    if len(listed) != 1:
        raise ModelError(f"{what} has one value, not {len(listed)}")
    return listed[0]


def _shown(value: Value) -> str:
    return value.id if isinstance(value, Ref) else repr(value)


def _order(one: Individual) -> tuple[int, int, str]:
    rank = _RANKS[GENERAL.get(one.kind, one.kind)]
    (position, *_) = (*one.values.get("position", ()), 0)
    return min(rank, _RANKS["Estimation"] + 1), (position if isinstance(position, int) else 0), one.id
