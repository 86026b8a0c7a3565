"""Describes a model as individuals, which are plain values, and makes the same model of them again.

An individual has a kind, an id and the values of its properties. Kinds and properties are those of `rosa.owl`. The
tables below give the kind of each class of element or fact, and the property of each field; nested values, such as the
parameters of a configuration, are individuals too.
"""

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import MISSING, fields
from functools import cache, lru_cache
from itertools import chain
from typing import Any, Final, NamedTuple, Self
from urllib.parse import quote

from kb import elements, facts
from kb.exceptions import InvalidValue, KnowledgeBaseError, ModelError, UnknownName
from kb.status import Status


class Ref(NamedTuple):
    """The id of another individual."""

    id: str


Value = str | bool | int | float | Ref
Values = dict[str, tuple[Value, ...]]


class Individual(NamedTuple):
    """One thing in a model: its kind, its id and the values of its properties by name."""

    kind: str
    id: str
    values: Mapping[str, tuple[Value, ...]]


BASE: Final = (
    "http://rosa-taca/model/"  # the prefix of all individuals; the id of the model and `#` follow
)
PARAMETER, PREFERENCE, MODEL, STATED = "Parameter", "Preference", "RobotModel", "Fact"

CLASSES: Final[Mapping[type, str]] = {
    cls: word.title().replace(" ", "") for cls, word in facts.ROSA.items()
}
"""The kind of each class of element and fact, in the order in which they can be declared."""

SPECIAL: Final[Mapping[tuple[type, str], str]] = {
    (elements.Attribute, "quality"): "QualityAttribute",
    (elements.Attribute, "environmental"): "EnvironmentalAttribute",
    (elements.Component, "process"): "ProcessComponent",
    (elements.Component, "ros_node"): "RosNodeComponent",
    (elements.Component, "lifecycle"): "LifecycleComponent",
}
"""The special kind of an element, by its class and its field `kind`."""

GENERAL: Final[Mapping[str, str]] = {special: CLASSES[cls] for (cls, _), special in SPECIAL.items()}
"""The general kind of each special kind."""

_PROPERTIES: Final[Mapping[tuple[type | None, str], str]] = {
    (elements.Action, "functions"): "requires",
    (elements.FunctionDesign, "function"): "realises",
    (elements.FunctionDesign, "components"): "uses",
    (elements.Configuration, "component"): "configures",
    (elements.Configuration, "parameters"): "hasParameter",
    (elements.Constraint, "attribute"): "compares",
    (elements.Constraint, "constrained"): "constrains",
    (elements.Estimation, "attribute"): "affects",
    (elements.Estimation, "causer"): "causedBy",
    (elements.Estimation, "kind"): "effect",
    (facts.MeasurementFact, "attribute"): "measures",
    (None, "element"): "about",
    (None, "action"): "about",
    (None, "component"): "about",
    (None, "preference"): "hasPreference",
    (None, "activate"): "activates",
    (None, "deactivate"): "deactivates",
    (None, "parameters"): "setsParametersOf",
    (None, "configuration"): "setsParametersOf",
}
"""The property of a field of a class (None: of any class), where it does not have the name of the field."""

_NUMBERS: Final = frozenset(
    {"value", "time", "start", "end", "max_age", "hysteresis", "dwell", "low", "high"}
)
_UNSAFE: Final = re.compile(r"[^A-Za-z0-9_-]")


@cache
def property_of(cls: type, field: str) -> str:
    first, *others = field.split("_")
    known = _PROPERTIES.get((cls, field)) or _PROPERTIES.get((None, field))
    return known or first + "".join(other.capitalize() for other in others)


class Serials(dict[elements.Changeable, int]):
    """Numbers for elements without a name; a number stays the same when other elements are removed."""

    @classmethod
    def of(cls, model: facts.Contents) -> Self:
        return cls((one, number) for number, one in enumerate(unnamed(model)))

    def __missing__(self, one: elements.Changeable) -> int:
        self[one] = number = max(self.values(), default=-1) + 1
        return number


def unnamed(model: facts.Contents) -> tuple[elements.Constraint | elements.Estimation, ...]:
    return (*model.constraints, *model.estimations)


def element_id(element: elements.Changeable, serials: Serials) -> str:
    name = element.name if isinstance(element, elements.Element) else str(serials[element])
    return named_id(type(element), name)


def individuals(model: facts.Contents, serials: Serials | None = None) -> Iterator[Individual]:
    """Describe all that is in a model now; later changes of the model do not matter.

    Elements come in an order in which they can be declared; the facts of the model come last.
    """
    own = Individual(MODEL, f"{MODEL}.{_escaped(model.name)}", {"name": (model.name,)})
    tables = [tuple(table.values()) for table in model.tables.values()]
    stated = [(fact, f"{STATED}.{position}", position) for position, fact in enumerate(model.facts)]
    given = Serials.of(model) if serials is None else serials
    placed = (
        (one, element_id(one, given), place)
        for listed in tables
        for place, one in enumerate(listed)
    )
    return chain(
        [own], chain.from_iterable(_described(*one, given) for one in chain(placed, stated))
    )


def individual(element: elements.Changeable, serials: Serials) -> tuple[Individual, ...]:
    """Return the individuals of one element: first those nested in it, then its own."""
    return tuple(_described(element, element_id(element, serials), 0, serials))


def nested(kind: str, owner: str, values: Mapping[str, Any]) -> Iterator[Individual]:
    for key, value in values.items():
        inner = f"{kind}.{owner}.{_escaped(key)}"
        if kind == PREFERENCE:
            yield Individual(
                kind,
                inner,
                {"prefers": (Ref(named_id(elements.Attribute, key)),), "weight": (value,)},
            )
        else:
            written, sort = json.dumps(value), elements.parameter_type(value)
            yield Individual(
                kind, inner, {"key": (key,), "parameterValue": (written,), "parameterType": (sort,)}
            )


def plain_json(given: Iterable[Individual]) -> list[Any]:
    def plain(values: Iterable[Value]) -> list[object]:
        return [{"ref": value.id} if isinstance(value, Ref) else value for value in values]

    return [
        [one.kind, one.id, {name: plain(values) for name, values in one.values.items()}]
        for one in given
    ]


def from_json(given: Iterable[Any]) -> list[Individual]:
    """Return the individuals that `plain_json` was given."""

    def read(values: Iterable[Any]) -> tuple[Value, ...]:
        return tuple(Ref(value["ref"]) if isinstance(value, dict) else value for value in values)

    return [
        Individual(kind, own, {name: read(each) for name, each in values.items()})
        for kind, own, values in given
    ]


def described(
    kind: str, own: str, said: Mapping[str, object], serials: Serials, cls: type = object
) -> Iterator[Individual]:
    """Yield the nested individuals of an object of a class, and then its own, from the values of its fields."""
    values: Values = {}
    for field, value in said.items():
        given = {value: 1.0} if field == "preference" and isinstance(value, str) else value
        if field in ("preference", "parameters") and isinstance(given, Mapping):
            sort = PREFERENCE if field == "preference" else PARAMETER
            inner = list(nested(sort, own, given))
            yield from inner
            plain, name = tuple[Value, ...](Ref(each.id) for each in inner), f"has{sort}"
        else:
            plain, name = _plain(field, given, serials), property_of(cls, field)
        if plain:
            values[name] = plain
    yield Individual(kind, own, values)


def _described(
    one: elements.Changeable | facts.Fact, own: str, position: int, serials: Serials
) -> Iterator[Individual]:
    kind = SPECIAL.get((type(one), str(getattr(one, "kind", ""))), CLASSES[type(one)])
    unsaid = (
        {"model"} if isinstance(one, elements.Estimation) else {"model", "kind"}
    )  # the kind of the individual says it
    said = {
        field.name: getattr(one, field.name) for field in fields(one) if field.name not in unsaid
    }
    return described(kind, own, {"position": position, **said}, serials, type(one))


def _plain(field: str, value: object, serials: Serials) -> tuple[Value, ...]:
    if value is None or value == "" or value in (math.inf, -math.inf):
        return ()
    if isinstance(value, str):
        return (
            Ref(named_id(elements.REFERENCES[field], value))
            if field in elements.REFERENCES
            else str(value),
        )
    if isinstance(value, Ref):
        return (value,)
    if isinstance(value, elements.Constraint | elements.Element):
        return (Ref(element_id(value, serials)),)
    if field in ("agreement", "rates"):
        return (json.dumps(value),) if value else ()
    if isinstance(value, tuple):
        return tuple(plain for one in value for plain in _plain(field, one, serials))
    return (float(value) if field in _NUMBERS else value,) if isinstance(value, int | float) else ()


def named_id(cls: type, name: str) -> str:
    return f"{CLASSES[cls]}.{_escaped(name)}"


@lru_cache(4096)
def _escaped(name: str) -> str:
    """Escape a name for an IRI and an id; different names stay different."""
    return _UNSAFE.sub(
        lambda found: quote(found[0], safe="", errors="surrogatepass").replace(".", "%2E"), name
    )


# -------------------------------------------------------------------- and back

_BY_KIND: Final[Mapping[str, Any]] = {kind: cls for cls, kind in CLASSES.items()}
_RANKS: Final = {kind: rank for rank, kind in enumerate(CLASSES.values())}
_LISTS: Final = frozenset(
    {"functions", "components", "constrained", "restores", "activate", "deactivate", "parameters"}
)
_UNSAID: Final = frozenset(
    {"position", "prefersNothing"}
)  # the latter is in files of earlier versions


class Declarer:
    """Declares individuals in a model; they may refer to each other and to known elements, by id."""

    def __init__(
        self, model: facts.Contents, known: Mapping[str, elements.Changeable] | None = None
    ) -> None:
        self.model = model
        self.known: dict[str, elements.Changeable] = dict(known or {})
        self.nested: dict[str, Individual] = {}

    def declare(self, given: Iterable[Individual]) -> None:
        """Declare individuals, each after those that it refers to, and those of one kind by position.

        Raises:
            ModelError: the model refuses one; the message begins with its id.
        """
        listed = list(given)
        self.nested = {one.id: one for one in listed}
        for one in sorted(
            (one for one in listed if GENERAL.get(one.kind, one.kind) in _BY_KIND), key=_rank
        ):
            try:
                made = self._make(one)
            except KnowledgeBaseError as error:
                raise ModelError(f"{one.id}: {error}") from None
            if made is not None:
                self.known[one.id] = made

    def values(self, cls: type, one: Individual) -> dict[str, Any]:
        """Return the fields of an element or fact, by name, as an individual has them."""
        own = {property_of(cls, field.name): field for field in fields(cls)}
        for name in one.values:
            if name not in own and name not in _UNSAID:
                raise UnknownName(
                    f"property of {one.kind}", name, [each for each in own if each != "model"]
                )
        found: dict[str, Any] = {}
        for name, field in own.items():
            if name in one.values:
                found[field.name] = self._value(cls, field.name, one.values[name])
            elif field.name in _LISTS:
                found[field.name] = {} if cls is elements.Configuration else ()
            elif field.default is MISSING and field.name != "model":
                raise ModelError(f"it has no {name}")
        return found

    def _value(self, cls: type, field: str, given: tuple[Value, ...]) -> object:
        if field == "preference" or (cls is elements.Configuration and field == "parameters"):
            return dict(self._pair(field, one) for one in given)
        named = ("constrained", "causer", "element", "restores")
        if (of := elements.REFERENCES.get(field)) or field in named:
            players = [self._element(one, of or object) for one in given]
            found = tuple(one.name for one in players) if of else tuple(players)
            return found if field in _LISTS else _single(field, found)
        value = _single(field, given)
        if isinstance(value, Ref):
            raise ModelError(f"{field} is a value, not {value.id}")
        return value

    def _pair(self, field: str, value: Value) -> tuple[str, Any]:
        """Return a preferred attribute and its weight, or a parameter and its value."""
        if not isinstance(value, Ref) or value.id not in self.nested:
            raise ModelError(f"{shown(value)} is not described")
        said = self.nested[value.id].values
        if field == "preference":
            attribute = self._element(
                _single("prefers", said.get("prefers", ())), elements.Attribute
            )
            return attribute.name, _single("weight", said.get("weight", ()))
        try:
            return str(said["key"][0]), json.loads(str(said["parameterValue"][0]))
        except (ValueError, TypeError, LookupError) as error:
            raise InvalidValue(f"it is not valid: {error}") from None

    def _element(self, value: Value, cls: type) -> Any:  # noqa: ANN401  # an element of the class
        found = self.known.get(value.id) if isinstance(value, Ref) else None
        if found is None or not isinstance(found, cls):
            known = [one for one, element in self.known.items() if isinstance(element, cls)]
            raise UnknownName(CLASSES.get(cls, "individual"), shown(value), known)
        return found

    def _make(self, one: Individual) -> elements.Changeable | None:
        cls = _BY_KIND[GENERAL.get(one.kind, one.kind)]
        values = self.values(cls, one)
        if cls is elements.Estimation:
            return self.model.add_estimation(**values)
        if cls is elements.Constraint:
            constrained, value = (
                values.pop("constrained"),
                elements.finite_number(values.pop("value")),
            )
            return self.model.constrain(constrained, elements.Expression(**values, value=value))
        if issubclass(cls, elements.Element):
            special = {other: one for (of, one), other in SPECIAL.items() if of is cls}
            if cls is elements.Attribute and one.kind not in special:
                raise ModelError(f"an attribute is a {' or an '.join(special)}; say which")
            values |= {"kind": special[one.kind]} if one.kind in special else {}
            element: elements.Element = self.model.declare(cls, values.pop("name"), **values)
            return element
        if cls is facts.StatusFact:
            values["status"] = elements.choice("status", Status, values["status"])
        self.model.add_fact(cls(**values))
        return None


def _single(what: str, values: Iterable[Any]) -> Any:  # noqa: ANN401  # one of what is given
    listed = list(values)
    if len(listed) != 1:
        raise ModelError(f"{what} has one value, not {len(listed)}")
    return listed[0]


def shown(value: Value) -> str:
    return value.id if isinstance(value, Ref) else repr(value)


def _rank(one: Individual) -> tuple[int, int, str]:
    rank = _RANKS[GENERAL.get(one.kind, one.kind)]
    (position, *_) = (*one.values.get("position", ()), 0)
    return (
        min(rank, _RANKS["Estimation"] + 1),
        (position if isinstance(position, int) else 0),
        one.id,
    )
