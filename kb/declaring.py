"""From individuals to a model again: the way back from `individuals`."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Any, Final

from kb.amendments import Changeable
from kb.declarations import choice
from kb.elements import (
    Action,
    Attribute,
    Component,
    ComponentKind,
    Configuration,
    Constraint,
    Estimation,
    Expression,
    Function,
    FunctionDesign,
    finite_number,
)
from kb.exceptions import InvalidValue, KnowledgeBaseError, ModelError, UnknownName
from kb.facts import StatusFact
from kb.individuals import CLASSES, GENERAL, NAMED, Individual, Ref, Value, parameter_values, property_of
from kb.status import Status

if TYPE_CHECKING:
    from kb.model import Model

__all__ = ["Declarer", "class_of"]

_KINDS: Final[Mapping[str, type]] = {kind: cls for cls, kind in CLASSES.items()}
_RANKS: Final = {kind: rank for rank, kind in enumerate(CLASSES.values())}
_LISTS: Final = frozenset({"functions", "components", "constrained", "activate", "deactivate", "parameters"})
_UNSAID: Final = frozenset({"position", "prefersNothing"})
_COMPONENTS: Final = {"ProcessComponent": ComponentKind.PROCESS, "LifecycleComponent": ComponentKind.LIFECYCLE}


def class_of(kind: str) -> type | None:
    """Return the class of the elements or facts of a kind; None if that is nested, or the model."""
    return _KINDS.get(GENERAL.get(kind, kind))


class Declarer:
    """Declares individuals in a model.

    Args:
        model: to declare them in.
        known: its elements by id, as far as individuals may refer to them.
    """

    def __init__(self, model: "Model", known: Mapping[str, Changeable] | None = None) -> None:
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
        own = [one for one in listed if class_of(one.kind)]
        elements = [one for one in own if self._rank(one) <= _RANKS["Estimation"]]
        facts = [one for one in own if self._rank(one) > _RANKS["Estimation"]]
        for one in (
            *sorted(elements, key=lambda each: (self._rank(each), _position(each))),
            *sorted(facts, key=_position),
        ):
            with _blamed(one.id):
                made = self._make(one)
                if made is not None:
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

    def _rank(self, one: Individual) -> int:
        return _RANKS[GENERAL.get(one.kind, one.kind)]

    def _value(self, cls: type, field: str, given: tuple[Value, ...]) -> Any:  # noqa: ANN401  # what the field holds
        if cls is Configuration and field == "parameters":
            return _read(lambda: parameter_values(self._inner(one) for one in given))
        if field == "preference":
            return dict(self._weight(self._inner(one)) for one in given)
        if field in NAMED:
            names = tuple(self._element(one, NAMED[field]).name for one in given)
            return names if field in _LISTS else _single(field, names)
        if field in ("constrained", "causer", "element"):
            elements = tuple(self._element(one, object) for one in given)
            return elements if field in _LISTS else _single(field, elements)
        value = _single(field, given)
        if isinstance(value, Ref):
            raise ModelError(f"{field} is a value, not {value.id}")
        if field == "agreement":
            return _read(lambda: tuple(json.loads(str(value))))
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
            kind = CLASSES.get(cls, "individual")
            known = [one for one, element in self.known.items() if isinstance(element, cls)]
            raise UnknownName(kind, _shown(value), known)
        return found

    def _make(self, one: Individual) -> Changeable | None:
        cls = _KINDS[GENERAL.get(one.kind, one.kind)]
        values = self.values(cls, one)
        maker = _MAKERS.get(cls)
        if maker is None:
            if cls is StatusFact:
                values["status"] = choice("status", Status, values["status"])
            self.model.add_fact(cls(**values))
            return None
        made: Changeable = maker(self.model, one.kind, values)
        return made


def _attribute(model: "Model", kind: str, values: dict[str, Any]) -> Attribute:
    makers = {"QualityAttribute": model.quality_attribute, "EnvironmentalAttribute": model.environmental_attribute}
    if kind not in makers:
        raise ModelError(f"an attribute is a {' or an '.join(makers)}; say which")
    return makers[kind](**values)


def _component(model: "Model", kind: str, values: dict[str, Any]) -> Component:
    return model.component(kind=_COMPONENTS.get(kind, ComponentKind.PLAIN), **values)


def _constraint(model: "Model", _: str, values: dict[str, Any]) -> Constraint:
    return model.constrain(values.pop("constrained"), Expression(**{**values, "value": finite_number(values["value"])}))


_MAKERS: Final[Mapping[type, Callable[["Model", str, dict[str, Any]], Any]]] = {
    Attribute: _attribute,
    Component: _component,
    Configuration: lambda model, _, values: model.add_configuration(**values),
    Function: lambda model, _, values: model.function(**values),
    FunctionDesign: lambda model, _, values: model.add_design(**values),
    Action: lambda model, _, values: model.action(values["name"], requires=values["functions"]),
    Constraint: _constraint,
    Estimation: lambda model, _, values: model.add_estimation(**values),
}


@contextmanager
def _blamed(individual: str) -> Iterator[None]:
    try:
        yield
    except KnowledgeBaseError as error:
        raise ModelError(f"{individual}: {error}") from None


def _read(reader: Callable[[], Any]) -> Any:  # noqa: ANN401  # what is read is checked by the model
    try:
        return reader()
    except (ValueError, TypeError, LookupError) as error:
        raise InvalidValue(f"it is not written as it should be: {error}") from None


def _single(what: str, values: Iterable[Any]) -> Any:  # noqa: ANN401  # one of what is given
    listed = list(values)
    if len(listed) != 1:
        raise ModelError(f"{what} has one value, not {len(listed)}")
    return listed[0]


def _shown(value: Value) -> str:
    return value.id if isinstance(value, Ref) else repr(value)


def _position(one: Individual) -> tuple[int, str]:
    (position, *_) = (*one.values.get("position", ()), 0)
    return (position if isinstance(position, int) else 0), one.id
