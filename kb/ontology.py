"""The ontology of a robot: ROSA's words, the model and what is known now, in owlready2.

`Ontology` is the world of a knowledge base: its model, what is so now and the newest history, to
be asked in SPARQL. `owl_text` and `load_owl` write and read models, `contradiction` asks HermiT.
Nothing in a tick reads an ontology. owlready2 is imported when the first world is made.

Classes and properties are made from the dataclasses of elements, facts and records. An element, a
relation with a name or attributes and whatever holds for a time is an individual; other relations
are object properties.
"""

import json
import math
import re
import shutil
import sqlite3
import time
from ast import literal_eval
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from decimal import Decimal
from functools import partial
from io import BytesIO
from pathlib import Path
from threading import RLock
from types import new_class
from typing import Any, Final, NamedTuple, TypeVar
from urllib.parse import quote
from weakref import finalize
from xml.parsers import expat

from kb import elements, facts, records
from kb.elements import Element
from kb.events import Event
from kb.exceptions import InvalidValue, KnowledgeBaseError, ModelError, UnknownName
from kb.files import ModelFileError, read_text
from kb.records import Attempt
from kb.state import State
from kb.status import Status

ModelT = TypeVar("ModelT", bound=facts.Contents)
Answer = str | bool | int | float | None
World = Any  # of owlready2, which has no types

ROSA: Final = "http://rosa-taca/rosa#"
"""The prefix of all classes and properties."""
BASE: Final = "http://rosa-taca/model/"
"""The prefix of individuals; the id of the model and `#` follow."""
HISTORY: Final = 10_000
"""The most measurements, and the most other individuals of the past, that a world holds."""
_RDF: Final = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
_RDFS: Final = "http://www.w3.org/2000/01/rdf-schema#"
_OWL: Final = "http://www.w3.org/2002/07/owl#"
_XSD: Final = "http://www.w3.org/2001/XMLSchema#"
_FILE: Final = "http://rosa-taca/file#"


class Ref(NamedTuple):
    """The id of an individual, e.g. "Action.explore"."""

    id: str


Value = str | bool | int | float | Ref
Values = Mapping[str, tuple[Value, ...]]


class Individual(NamedTuple):
    """Its class, its id, and the values of its properties; in a file, the id is an IRI."""

    kind: str
    id: str
    values: Values


# ---------------------------------------------------------------- words

CLASSES: Final[Mapping[type, str]] = {
    **{cls: words.title().replace(" ", "") for cls, words in facts.ROSA.items()},
    records.RequiredAction: "RequiredAction",
    records.ReconfigurationPlan: "ReconfigurationPlan",
    records.Process: "ComponentProcess",
    records.Attempt: "Attempt",
    records.VetoAnswer: "VetoAnswer",
}
"""The class of individuals for each dataclass, in an order in which they can be declared."""
SPECIAL: Final[Mapping[tuple[str, str], str]] = {
    ("Attribute", "quality"): "QualityAttribute",
    ("Attribute", "environmental"): "EnvironmentalAttribute",
    ("Component", "process"): "ProcessComponent",
    ("Component", "ros_node"): "RosNodeComponent",
    ("Component", "lifecycle"): "LifecycleComponent",
}
"""The subclass of an attribute or component of a kind."""
_GENERAL: Final = {word: general for (general, _), word in SPECIAL.items()}
_KINDS: Final = {word: kind for (_, kind), word in SPECIAL.items()}
_ABSTRACT: Final = ("Element", "Relation", "Fact", "Period")
_PARENTS: Final[Mapping[str, str]] = {
    **dict.fromkeys(("Element", "Relation", "Fact", "RobotModel"), ""),
    **{word: "Element" if issubclass(cls, Element) else "Period" for cls, word in CLASSES.items()},
    **dict.fromkeys(("Failure", "ParametersInForce"), "Period"),
    **dict.fromkeys(("Constraint", "Estimation", "Parameter", "Preference"), "Relation"),
    **dict.fromkeys(("Measurement", "VetoAnswer", "Amendment", "Period"), "Fact"),
    **_GENERAL,
    "RosNodeComponent": "ProcessComponent",
}
"""The class above each class."""

_RENAMED: Final[Mapping[str, str]] = {
    "Action.functions": "requires",
    "FunctionDesign.function": "realises",
    "FunctionDesign.components": "uses",
    "ComponentConfiguration.component": "configures",
    "Constraint.attribute": "compares",
    "Constraint.constrained": "constrains",
    "Estimation.attribute": "affects",
    "Estimation.causer": "causedBy",
    "Estimation.kind": "effect",
    "Measurement.attribute": "measures",
    "ReconfigurationPlan.parameters": "setsParametersOf",
    "Attempt.configuration": "setsParametersOf",
    **dict.fromkeys(("element", "action", "component"), "about"),
    "parameters": "hasParameter",
    "preference": "hasPreference",
    "activate": "activates",
    "deactivate": "deactivates",
    "plan": "ofPlan",
}
"""The property of a field, with or without its class, where it has another name."""
_RANGES: Final[Mapping[str, str]] = {
    **dict.fromkeys(("restores", "constrains", "causedBy"), "Element"),
    **dict.fromkeys(("compares", "affects", "measures", "prefers"), "Attribute"),
    **dict.fromkeys(("uses", "configures", "activates", "deactivates"), "Component"),
    **dict.fromkeys(("requires", "realises"), "Function"),
    **{"hasParameter": "Parameter", "hasPreference": "Preference", "about": ""},
    **{"setsParametersOf": "ComponentConfiguration", "ofPlan": "ReconfigurationPlan"},
}
"""The object properties, and the class that each leads to."""
_LISTS: Final = frozenset(
    [
        "requires",
        "restores",
        "uses",
        "hasParameter",
        "constrains",
        "hasPreference",
        "activates",
        "deactivates",
        "setsParametersOf",
    ]
)
_FLOATS: Final = frozenset(
    [
        "value",
        "time",
        "start",
        "end",
        "until",
        "historyBegins",
        "maxAge",
        "hysteresis",
        "dwell",
        "low",
        "high",
    ]
)
_TYPES: Final[Mapping[str, type]] = {
    **dict.fromkeys(
        ("alwaysImprove", "stopsToConfigure", "latest", "isVetoed", "isRequired"), bool
    ),
    **dict.fromkeys(("pid", "number"), int),
    **dict.fromkeys(("priority", "weight", *_FLOATS), float),
}
"""The types of the data properties that are not texts."""
_EXTRA: Final = (
    *("name", "status", "isRequired", "about", "hasParameter", "start", "end", "reason", "until"),
    *("time", "change", "historyBegins", "key", "parameterValue", "parameterType"),
    *("prefers", "weight"),
)
"""The properties that individuals without a dataclass have, too."""


def property_of(word: str, field: str) -> str:
    first, *others = field.split("_")
    renamed = _RENAMED.get(f"{word}.{field}") or _RENAMED.get(field)
    return renamed or first + "".join(other.capitalize() for other in others)


def _fields(cls: type, word: str) -> list[str]:
    """Return the fields of a dataclass that are properties of its individuals."""
    omitted = {"model", "cause", "serial", "plain"}
    omitted |= set() if word == "Estimation" else {"kind"}  # a subclass says it
    omitted |= set() if word == "Attempt" else {"number"}
    return [field.name for field in fields(cls) if field.name not in omitted]


_DOMAINS: Final[dict[str, list[str]]] = {name: [] for name in _EXTRA}
"""The classes that have each property; those of `_EXTRA` can be of any class."""
for _cls, _class in CLASSES.items():
    for _field in _fields(_cls, _class):
        _DOMAINS.setdefault(property_of(_class, _field), []).append(_class)
WORDS: Final = frozenset({*_PARENTS, *_DOMAINS, "position", "order"})


def _lineage(word: str) -> list[str]:
    """Return a class and those above it."""
    words = [word]
    while _PARENTS[words[-1]]:
        words.append(_PARENTS[words[-1]])
    return words


def declare_words(ontology: Any) -> None:  # noqa: ANN401  # of owlready2
    """Declare ROSA's classes and properties in an ontology."""
    import owlready2 as owl

    namespace = ontology.get_namespace(ROSA)

    def declare(name: str, *bases: type) -> Any:  # noqa: ANN401  # of owlready2
        python_name = (
            {} if name != "name" else {"python_name": "rosa_name"}
        )  # else it is owlready's
        body = {"namespace": namespace, **python_name}
        declared: Any = new_class(name, bases, {}, lambda content: content.update(body))
        declared.label = [re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower()]
        return declared

    classes: dict[str, Any] = {}
    double = ontology.world._abbreviate(f"{_XSD}double")
    with ontology:
        for word in sorted(_PARENTS, key=lambda word: len(_lineage(word))):
            classes[word] = declare(word, classes.get(_PARENTS[word], owl.Thing))
        for cls, word in CLASSES.items():
            classes[word].comment = [(cls.__doc__ or "").partition("\n")[0]]
        for name, words in _DOMAINS.items():
            sort = owl.ObjectProperty if name in _RANGES else owl.DataProperty
            once = () if name in _LISTS else (owl.FunctionalProperty,)
            declared = declare(name, sort, *once)
            if name not in _EXTRA:
                domain = [classes[word] for word in dict.fromkeys(words)]
                declared.domain = [owl.Or(domain)] if domain[1:] else domain
            if name in _FLOATS:  # for a float, owlready2 would say decimal
                ontology._add_obj_triple_raw_spo(declared.storid, owl.rdf_range, double)
            elif name in _RANGES:
                declared.range = [classes[word] for word in [_RANGES[name]] if word]
            elif _TYPES.get(name) is not float:
                declared.range = [_TYPES.get(name, str)]
        declare("position", owl.AnnotationProperty)
        declare("order", owl.AnnotationProperty)
        for parent in dict.fromkeys(_PARENTS.values()):
            siblings = [classes[word] for word, above in _PARENTS.items() if above == parent]
            if len(siblings) > 1:
                owl.AllDisjoint(siblings)


# ---------------------------------------------------------------- a model as individuals


def individuals(model: facts.Contents) -> Iterator[Individual]:
    """Describe all that is in a model; the facts of the model come last."""
    yield Individual("RobotModel", f"RobotModel.{_escaped(model.name)}", {"name": (model.name,)})
    describer = _Describer(model)
    for table in model.tables.values():
        for position, element in enumerate(table.values()):
            yield from describer.of(element, describer.id(element), position)
    for position, fact in enumerate(model.facts):
        yield from describer.of(fact, f"Fact.{position}", position)


class _Describer:
    """Describes elements, facts and records of a model as individuals."""

    def __init__(self, model: facts.Contents) -> None:
        unnamed = (model.constraints, model.estimations)
        self._positions = {each: place for table in unnamed for place, each in enumerate(table)}

    def id(self, element: elements.Changeable) -> str:
        if isinstance(element, Element):
            return named_id(CLASSES[type(element)], element.name)
        return f"{CLASSES[type(element)]}.{self._positions[element]}"

    def of(self, described: object, own: str, position: int | None = None) -> Iterator[Individual]:
        """Yield the individuals of an object: first those nested in it, then its own."""
        cls = type(described)
        word = CLASSES[cls]
        values = {name: getattr(described, name) for name in _fields(cls, word)}
        kind = SPECIAL.get((word, str(getattr(described, "kind", ""))), word)
        *nested, individual = self.individual(word, own, {**values, "position": position})
        yield from (*nested, individual._replace(kind=kind))

    def individual(self, word: str, own: str, stated: Mapping[str, Any]) -> Iterator[Individual]:
        values: dict[str, tuple[Value, ...]] = {}
        for field, value in stated.items():
            name = property_of(word, field)
            if name in ("hasParameter", "hasPreference"):
                nested = list(_nested(name, own, value or {}))
                yield from nested
                value = tuple(Ref(one.id) for one in nested)
            values[name] = tuple(self._values(field, name, value))
        yield Individual(word, own, {name: each for name, each in values.items() if each})

    def _values(self, field: str, name: str, value: Any) -> Iterator[Value]:  # noqa: ANN401  # of any field
        if isinstance(value, Element | elements.Constraint):
            yield Ref(self.id(value))
        elif isinstance(value, records.ReconfigurationPlan):
            yield Ref(f"ReconfigurationPlan.{value.number}")
        elif isinstance(value, Ref | bool):
            yield value
        elif isinstance(value, tuple) and field in ("agreement", "rates"):
            yield from [json.dumps(value)] if value else []
        elif isinstance(value, tuple):
            for each in value:
                yield from self._values(field, name, each)
        elif isinstance(value, str) and field in elements.REFERENCES:
            yield Ref(named_id(CLASSES[elements.REFERENCES[field]], value))
        elif isinstance(value, str):
            yield from [str(value)] if value else []
        elif isinstance(value, int | float) and abs(value) < math.inf:
            yield float(value) if name in _FLOATS else value


def _nested(name: str, owner: str, values: str | Mapping[str, Any]) -> Iterator[Individual]:
    """Yield the parameters of a configuration, or the preferences of a request."""
    weights = {values: 1.0} if isinstance(values, str) else values
    for key, value in weights.items():
        own = f"{_RANGES[name]}.{owner}.{_escaped(key)}"
        stated: Values = {"prefers": (Ref(named_id("Attribute", key)),), "weight": (value,)}
        if name == "hasParameter":
            sort = elements.parameter_type(value)
            written = json.dumps(value)
            stated = {"key": (key,), "parameterValue": (written,), "parameterType": (sort,)}
        yield Individual(_RANGES[name], own, stated)


def named_id(word: str, name: str) -> str:
    return f"{word}.{_escaped(name)}"


def _escaped(name: str) -> str:
    """Escape a name for an id; different names stay different."""
    return quote(name, safe="", errors="surrogatepass").replace(".", "%2E").replace("~", "%7E")


# ---------------------------------------------------------------- individuals in a world

_UNFIT: Final = re.compile(
    "[^\t\n\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]|\\\\(?=u[0-9a-f]{4})"
)


def _fit(text: str) -> str:
    """Escape the characters that XML and SQLite cannot hold; `_unfit` reads them back."""
    return _UNFIT.sub(lambda match: f"\\u{ord(match[0]):04x}", text)


def _unfit(text: str) -> str:
    return re.sub(r"\\u([0-9a-f]{4})", lambda match: chr(int(match[1], 16)), text)


class _Graph:
    """An ontology of a world, to which individuals are written as triples."""

    def __init__(self, world: World, iri: str, base: str = "") -> None:
        self.ontology = world.get_ontology(iri)
        self.held: dict[str, Individual] = {}
        self._world = world
        self._base = base or iri
        self._numbers: dict[str, int] = {}

    def put(self, individual: Individual) -> None:
        """Write an individual, in place of what is written of it."""
        if self.held.get(individual.id) == individual:
            return
        self.drop(individual.id)
        self.held[individual.id] = individual
        subject = self._number(f"{self._base}{individual.id}")
        if individual.kind:
            kinds = [word for word in _lineage(individual.kind) if word not in _ABSTRACT]
            for iri in (*(f"{ROSA}{kind}" for kind in kinds), f"{_OWL}NamedIndividual"):
                self._link(subject, f"{_RDF}type", iri)
        order: list[str] = []
        for name, values in individual.values.items():
            for value in values:
                if isinstance(value, Ref):
                    self._link(subject, f"{ROSA}{name}", f"{self._base}{value.id}")
                else:
                    self._state(subject, f"{ROSA}{name}", value)
            if len(values) > 1:
                order.append(" ".join([name, *(value.id for value in values)]))  # type: ignore[union-attr]  # only individuals are many
        if order:
            self._state(subject, f"{ROSA}order", "; ".join(order))
        for label in individual.values.get("name", ()):
            self._state(subject, f"{_RDFS}label", label)

    def drop(self, own: str) -> None:
        """Remove what is written of an individual."""
        if self.held.pop(own, None) is None:
            return
        subject = self._number(f"{self._base}{own}")
        self.ontology._del_obj_triple_raw_spo(subject, None, None)
        self.ontology._del_data_triple_raw_spod(subject, None, None, None)
        loaded = self._world._entities.get(subject)
        for name in [name for name in vars(loaded or object) if name in self._world._props]:
            delattr(loaded, name)  # so that it is read anew

    def _number(self, iri: str) -> int:
        if iri not in self._numbers:
            self._numbers[iri] = self._world._abbreviate(iri)
        return self._numbers[iri]

    def _link(self, subject: int, name: str, iri: str) -> None:
        self.ontology._add_obj_triple_raw_spo(subject, self._number(name), self._number(iri))

    def _state(self, subject: int, name: str, value: object) -> None:
        written, sort = self._world._to_rdf(value)
        if isinstance(value, str):
            written, sort = _fit(value), 0
        elif isinstance(value, float):
            sort = self._number(f"{_XSD}double")
        self.ontology._add_data_triple_raw_spod(subject, self._number(name), written, sort)


# ---------------------------------------------------------------- files


def owl_text(model: facts.Contents) -> str:
    """Write a model with ROSA's words as RDF/XML; see `Model.save`."""
    import owlready2

    world = owlready2.World()
    own, *others = individuals(model)
    graph = _Graph(world, f"{BASE}{own.id}#")
    declare_words(graph.ontology)
    graph.ontology.metadata.label = [_fit(model.name)]
    for individual in (own, *others):
        graph.put(individual)
    written = BytesIO()
    graph.ontology.save(written, format="rdfxml")
    world.close()
    return written.getvalue().decode()


def load_owl(cls: "Callable[[str], ModelT]", paths: Sequence[Path], name: str | None) -> "ModelT":
    """Read one model from one or more OWL files in RDF/XML; see `Model.load`."""
    import owlready2

    world = owlready2.World()
    for path in paths:
        _parse(world, path)
    try:
        read = list(_read(world))
        names = [str(*one.values["name"]) for one in read if one.kind == "RobotModel"]
        model = cls(name or next(iter(names), paths[0].stem))
        _Reader(model, read).declare()
    except KnowledgeBaseError as error:
        raise ModelFileError(str(error), ", ".join(map(str, paths))) from None
    finally:
        world.close()
    return model


def _parse(world: World, path: Path) -> None:
    """Read the triples of a file into an ontology of its own."""
    import owlready2

    text = read_text(path)
    if not text.strip():
        raise ModelFileError("the file is empty", str(path))
    if ROSA not in text:
        raise ModelFileError(f"nothing in it is described in the words of {ROSA}", str(path))
    ontology = world.get_ontology(f"{_FILE}{len(world.ontologies)}#")
    try:
        expat.ParserCreate().Parse(text, True)  # says where, and refuses endless entities
        ontology.graph.parse(BytesIO(text.encode()), format="rdfxml", default_base=_FILE)
    except expat.ExpatError as error:
        why = f"this is not RDF/XML: {expat.ErrorString(error.code)}"
        raise ModelFileError(why, str(path), error.lineno, error.offset + 1) from None
    except owlready2.OwlReadyOntologyParsingError as error:
        raise ModelFileError(f"this is not RDF/XML: {error}", str(path)) from None


def _read(world: World) -> Iterator[Individual]:
    """Yield the individuals of ROSA in a world."""
    stated: dict[str, dict[str, dict[Answer, None]]] = {}
    for subject, name, value in answers(world, "SELECT ?s ?p ?o { ?s ?p ?o }"):
        stated.setdefault(str(subject), {}).setdefault(str(name), {})[value] = None
    for iri, said in stated.items():
        types = [str(each) for each in said.get(f"{_RDF}type", ()) if str(each).startswith(ROSA)]
        kinds = [each.removeprefix(ROSA) for each in types]
        for kind in kinds:
            if kind not in _PARENTS:
                raise ModelError(f"{iri}: {UnknownName('class', kind, sorted(_PARENTS))}")
        above = {word for kind in kinds for word in _lineage(kind)[1:]}
        special = [kind for kind in kinds if kind not in above]
        if len(special) > 1:
            raise ModelError(f"{iri} is {' and '.join(special)}; it can be only one of them")
        if special:
            yield Individual(special[0], iri, _ordered(said))


def _ordered(stated: Mapping[str, Iterable[Answer]]) -> Values:
    """Return the values of properties, in the order that is stated for them."""
    ours = {iri.removeprefix(ROSA): list(each) for iri, each in stated.items() if ROSA in iri}
    orders = [line.split() for line in str(*ours.pop("order", [""])).split(";")]
    places = {line[0]: line[1:] for line in orders if line}
    values: dict[str, tuple[Value, ...]] = {}
    for name, each in ours.items():
        order = places.get(name, [])
        each.sort(key=partial(_place, order))
        values[name] = tuple(Ref(str(value)) if name in _RANGES else value for value in each)  # type: ignore[misc]  # none is None
    return values


def _place(order: Sequence[str], value: Answer) -> tuple[int, str]:
    """Return the place of a value in a stated order; those that are not in it come last."""
    own = str(value).rpartition("#")[2]
    return (order.index(own) if own in order else len(order)), str(value)


class _Reader:
    """Declares individuals in a model, each after those that it refers to."""

    def __init__(self, model: facts.Contents, read: Iterable[Individual]) -> None:
        self._model = model
        self._individuals = {one.id: one for one in read}
        self._elements: dict[str, Any] = {}

    def declare(self) -> None:
        classes = {word: cls for cls, word in CLASSES.items() if cls in facts.ROSA}
        ranks = {word: place for place, word in enumerate(classes)}

        def rank(individual: Individual) -> tuple[int, Any, str]:
            """Return a key that sorts elements by class and place, and facts by place only."""
            word = _GENERAL.get(individual.kind, individual.kind)
            place = next(iter(individual.values.get("position", ())), 0)
            if not isinstance(place, int):
                raise ModelError(f"{individual.id}: a position is a whole number, not {place!r}")
            return min(ranks.get(word, 0), ranks["Measurement"]), place, individual.id

        for individual in sorted(self._individuals.values(), key=rank):
            word = _GENERAL.get(individual.kind, individual.kind)
            if word in classes:
                try:
                    declared = self._declared(classes[word], word, individual)
                except KnowledgeBaseError as error:
                    raise ModelError(f"{individual.id}: {error}") from None
                self._elements[individual.id] = declared

    def _declared(self, cls: type, word: str, individual: Individual) -> object:
        values = self._stated(cls, word, individual)
        model = self._model
        if cls is elements.Constraint:
            constrained = values.pop("constrained")
            return model.constrain(constrained, elements.Expression(**values))
        if cls is elements.Estimation:
            return model.add_estimation(**values)
        if issubclass(cls, Element):
            if individual.kind in _KINDS:
                values["kind"] = _KINDS[individual.kind]
            elif cls is elements.Attribute:
                raise ModelError("say which: a QualityAttribute or an EnvironmentalAttribute")
            return model.declare(cls, values.pop("name"), **values)
        if cls is facts.StatusFact:
            values["status"] = elements.choice("status", Status, values["status"])
        fact: Any = cls(**values)
        model.add_fact(fact)
        return None

    def _stated(self, cls: type, word: str, individual: Individual) -> dict[str, Any]:
        """Return the fields of a dataclass as an individual has them."""
        own = {property_of(word, name): name for name in _fields(cls, word)}
        for name in individual.values:
            if name not in own and name != "position":
                raise UnknownName(f"property of {individual.kind}", name, own)
        found: dict[str, Any] = {}
        for field in fields(cls):
            name = property_of(word, field.name)
            values = individual.values.get(name, ())
            if name == "hasParameter" or (name == "hasPreference" and values):
                found[field.name] = dict(self._pair(name, value) for value in values)
            elif name in _LISTS and name != "hasPreference":
                found[field.name] = tuple(self._referred(field.name, value) for value in values)
            elif values:
                value = _single(name, values)
                is_name = name in _RANGES
                found[field.name] = self._referred(field.name, value) if is_name else value
            elif field.default is MISSING and field.name in own.values():
                raise ModelError(f"it has no {name}")
        return found

    def _referred(self, field: str, value: Value) -> Any:  # noqa: ANN401  # as the field has it
        """Return the element that a value stands for, or its name if the field holds names."""
        cls: type = elements.REFERENCES.get(field, object)
        element: Any = self._elements.get(value.id) if isinstance(value, Ref) else None
        is_of_class = isinstance(element, cls)
        if element is None or not is_of_class:
            known = [own for own, each in self._elements.items() if isinstance(each, cls)]
            given = value.id if isinstance(value, Ref) else value
            raise UnknownName(CLASSES.get(cls, "individual"), given, known)
        return element.name if field in elements.REFERENCES else element

    def _pair(self, name: str, value: Value) -> tuple[str, Any]:
        """Return a parameter and its value, or an attribute and its weight."""
        individual = self._individuals.get(value.id) if isinstance(value, Ref) else None
        if individual is None:
            raise ModelError(f"{value} is not described")
        stated = {word: _single(word, each) for word, each in individual.values.items()}
        try:
            if name == "hasPreference":
                return self._referred("attribute", stated["prefers"]), stated["weight"]
            return str(stated["key"]), json.loads(str(stated["parameterValue"]))
        except (KeyError, ValueError) as error:
            raise InvalidValue(f"{individual.id} is not complete: {error}") from None


def _single(what: str, values: Sequence[Value]) -> Value:
    if len(values) != 1:
        raise ModelError(f"{what} has one value, not {len(values)}")
    return values[0]


def contradiction(text: str) -> str | None:
    """Have HermiT look for a contradiction in an ontology; returns what it found, or None.

    Raises:
        KnowledgeBaseError: there is no Java to run it with, or it cannot read the ontology.
    """
    import owlready2

    if shutil.which(owlready2.JAVA_EXE) is None:
        what = "HermiT, the reasoner, needs Java, which is not found; install a Java runtime"
        raise KnowledgeBaseError(what)
    world = owlready2.World()
    try:
        ontology = world.get_ontology("http://rosa-taca/checked#")
        ontology.load(only_local=True, fileobj=BytesIO(text.encode()))
        owlready2.sync_reasoner_hermit(world, debug=0, ignore_unsupported_datatypes=True)
        empty = sorted(one.name for one in world.inconsistent_classes())
    except owlready2.OwlReadyInconsistentOntologyError:
        return "HermiT finds the ontology inconsistent: what it says cannot all be true"
    except owlready2.OwlReadyJavaError as error:
        raise KnowledgeBaseError(f"HermiT failed: {error}") from None
    finally:
        world.close()
    return f"HermiT finds that nothing can be a {', '.join(empty)}" if empty else None


# ---------------------------------------------------------------- what is known now

_PERIODS: Final[Mapping[str, tuple[str, tuple[str, ...]]]] = {
    "component_failed": ("Failure", ("reason",)),
    "component_recovered": ("Failure", ()),
    "component_active": ("Activity", ("is_so", "reason")),
    "component_configured": ("ParametersInForce", ("parameters",)),
    "assert_status": ("AssertedStatus", ("status", "reason", "until")),
    "retract_status": ("AssertedStatus", ()),
    "lapse": ("AssertedStatus", ()),
    "assert_required": ("AssertedRequirement", ("is_so",)),
    "assert_selected": ("Selection", ("is_so", "reason")),
}
"""By verb of an event: the period that begins or ends for its first argument, and its fields.

An event without further arguments, or with a false one, only ends the period.
"""
_COLUMNS: Final[Mapping[str, str]] = {
    "Failure": "failed",
    "Activity": "active",
    "Selection": "selected",
    "AssertedStatus": "asserted",
    "AssertedRequirement": "asserted_required",
}
"""The periods, and the column of the state that says which go on now."""
_WORD_OF_KIND: Final = {kind: CLASSES[cls] for cls, kind in elements.KINDS.items()}
_REQUIRABLE: Final = frozenset({"action", "function", "component"})
_MOST_RECORDS: Final = 1000
"""The most records of each kind that a world holds."""


class Period(NamedTuple):
    """Something that goes on now: its class, what it is about, and its fields."""

    word: str
    about: str
    fields: Mapping[str, Any]


@dataclass
class _Copy:
    """What a world needs of a knowledge base, copied while nothing changes."""

    last: int
    begins: float
    events: list[Event]
    model: list[Individual]
    present: list[Period]
    measured: list[tuple[str, float, float]]
    records: list[Individual]
    attempts: Mapping[int, Attempt]


class Ontology:
    """The world of a knowledge base: its model, what is so now, and the newest history.

    It is brought up to date when it is asked and something has happened since. The knowledge base
    is held only while it is copied; the copy is written outside its lock.
    """

    def __init__(self, kb: Any) -> None:  # noqa: ANN401  # a knowledge base, which imports this module
        self._kb = kb
        self._lock = RLock()
        self._world: World = None

    @property
    def world(self) -> World:
        """The world of owlready2, up to date."""
        with self._lock:
            self._refresh()
            return self._world

    def query(self, sparql: str, timeout: float) -> list[tuple[Answer, ...]]:
        """Answer a query; see `KnowledgeBase.query`."""
        end = time.monotonic() + timeout
        with self._lock:
            self._refresh()
            database = self._world.graph.db
            database.set_progress_handler(lambda: time.monotonic() > end, _STEPS)
            try:
                return answers(self._world, sparql, lambda: time.monotonic() > end)
            except (TimeoutError, sqlite3.OperationalError):
                much = "ask for less, or allow it a longer timeout"
                why = f"the query was stopped after {timeout:g} s; {much}"
                raise KnowledgeBaseError(why) from None
            finally:
                database.set_progress_handler(None, 0)

    def _refresh(self) -> None:
        try:
            if self._world is None:
                self._open()
            copied = self._copied()
            if copied is not None:
                self._write(copied)
        except BaseException:
            self._world = None  # it may be half written
            raise

    def _open(self) -> None:
        """Make a new world, which holds ROSA's words only."""
        import owlready2

        self._world = owlready2.World()
        finalize(self, self._world.close)  # owlready2 holds the classes of a world that is open
        base = f"{BASE}RobotModel.{_escaped(self._kb.model.name)}#"
        declare_words(self._world.get_ontology(ROSA))
        self._model = _Graph(self._world, base)
        self._now = _Graph(self._world, f"{BASE}now#", base)
        self._last = -1
        self._begins = -math.inf  # since when all of the past is here [s]
        self._count = 0
        self._open_periods: dict[tuple[str, str], Individual] = {}
        self._ended: deque[str] = deque()
        self._measured: deque[str] = deque()
        self._finished_records: set[str] = set()

    # ---------------------------------------------------------------- copied

    def _copied(self) -> _Copy | None:
        """Return what is new; None if nothing is."""
        kb = self._kb
        with kb.reading() as state:
            last = kb.log.last
            if last == self._last:
                return None
            events = list(kb.log.since(max(self._last, 0)))
            is_first = self._last < 0
            is_amended = is_first or any(event.verb == "amend" for event in events)
            describer = _Describer(kb.model)
            measured = self._measurements(events, is_first)
            begins = [event.time for event in events if event.number >= kb.log.begins]
            return _Copy(
                last,
                next(iter(begins), -math.inf),
                events,
                list(individuals(kb.model)) if is_amended else [],
                list(_present(state, describer)),
                measured,
                [*_inferred(state, describer), *self._records(describer)],
                {attempt.serial: attempt for attempt in kb.history.attempts},
            )

    def _measurements(self, events: list[Event], is_first: bool) -> list[tuple[str, float, float]]:
        """Return the new measurements as attribute, time and value."""
        if not is_first:
            told = [event for event in events if event.verb == "measure"]
            return [(event.subject, event.time, event.arguments[1]) for event in told]
        histories = ((view.name, view.history) for view in self._kb.attributes.values())
        samples = [(time, name, value) for name, each in histories for time, value in each]
        return [(name, time, value) for time, name, value in sorted(samples)[-HISTORY:]]

    def _records(self, describer: _Describer) -> Iterator[Individual]:
        """Yield the records that are new or have not ended."""
        kb = self._kb
        history = kb.history
        for table in (
            kb.plans,
            history.actions,
            history.processes,
            history.attempts,
            history.answers,
        ):
            for position, record in enumerate(table[-_MOST_RECORDS:]):
                word = CLASSES[type(record)]
                number = getattr(record, "serial", 0) or getattr(record, "number", position)
                own = f"{word}.{number}"
                if own not in self._finished_records:
                    yield from describer.of(record, own)
                    if getattr(record, "end", 0.0) is not None:
                        self._finished_records.add(own)

    # ---------------------------------------------------------------- written

    def _write(self, copied: _Copy) -> None:
        if copied.model:
            described = [one for one in copied.model if not one.id.startswith("Fact.")]
            for own in set(self._model.held) - {one.id for one in described}:
                self._model.drop(own)
                self._now.drop(own)
            for individual in described:
                self._model.put(individual)
        if self._last < 0 and copied.events:
            self._begins = copied.begins
        for event in copied.events:
            self._hear(event, copied)
        self._settle(copied)
        for individual in copied.records:
            self._now.put(individual)
        for name, moment, value in copied.measured:
            about = (Ref(named_id("Attribute", name)),)
            stated: Values = {"measures": about, "value": (float(value),), "time": (moment,)}
            self._measured.append(self._next("Measurement", stated).id)
        for past in (self._measured, self._ended):
            while len(past) > HISTORY:
                values = self._now.held[past[0]].values
                (then,) = values.get("time") or values["end"]
                self._begins = max(self._begins, float(str(then)))
                self._now.drop(past.popleft())
        own = f"RobotModel.{_escaped(self._kb.model.name)}"
        begins = (self._begins,) if self._begins > -math.inf else ()
        self._now.put(Individual("", own, {"historyBegins": begins}))
        self._last = copied.last

    def _hear(self, event: Event, copied: _Copy) -> None:
        """Write what an event begins or ends."""
        if event.verb == "amend":
            values: Values = {"time": (event.time,), "change": (event.text,)}
            self._ended.append(self._next("Amendment", values).id)
        elif event.verb == "select":
            for kind, name, is_selected in event.effects:
                about = f"{_WORD_OF_KIND[kind]}.{_escaped(name)}"
                reason = {"reason": event.arguments[2]} if is_selected else None
                self._change("Selection", about, event.time, reason)
        elif event.verb == "finish_attempt" and event.arguments[1] == "completed":
            attempt = copied.attempts.get(event.arguments[0])
            if attempt is not None and attempt.operation == "configure":
                about = named_id("Component", attempt.component)
                in_force = {"parameters": attempt.parameters}
                self._change("ParametersInForce", about, event.time, in_force)
        elif event.verb in _PERIODS:
            word, names = _PERIODS[event.verb]
            about, *given = event.arguments
            values = dict(zip(names, given, strict=False))
            is_so = bool(values.pop("is_so", names))
            self._change(word, _about(about), event.time, values if is_so else None)

    def _change(
        self, word: str, about: str, moment: float, values: Mapping[str, Any] | None
    ) -> None:
        """End what goes on of this kind, and begin it anew with these values unless there are none."""
        before = self._open_periods.pop((word, about), None)
        if before is not None:
            self._now.put(before._replace(values={**before.values, "end": (moment,)}))
            self._ended.append(before.id)
        if values is not None:
            self._begin(word, about, {"start": moment, **values})

    def _begin(self, word: str, about: str, values: Mapping[str, Any]) -> None:
        self._count += 1
        own = f"Fact.{self._count}"
        given = {"about": Ref(about), **values}
        *nested, period = _Describer(self._kb.model).individual(word, own, given)
        for individual in (*nested, period):
            self._now.put(individual)
        self._open_periods[word, about] = period

    def _settle(self, copied: _Copy) -> None:
        """Begin and end what no event in memory has said."""
        present = {(word, about): stated for word, about, stated in copied.present}
        moment = copied.events[-1].time if copied.events else 0.0
        for word, about in [key for key in self._open_periods if key not in present]:
            self._change(word, about, moment, None)
        for (word, about), stated in present.items():
            if (word, about) not in self._open_periods:
                self._begin(word, about, stated)

    def _next(self, word: str, values: Values) -> Individual:
        """Write an individual of the past."""
        self._count += 1
        individual = Individual(word, f"Fact.{self._count}", values)
        self._now.put(individual)
        return individual


def _about(reference: Any) -> str:  # noqa: ANN401  # as events write it
    """Return the id of what an event is about: a component by name, or anything by kind and name."""
    kind, name, *position = ("component", reference) if isinstance(reference, str) else reference
    own = f"{_WORD_OF_KIND[kind]}.{_escaped(name)}"
    return f"Constraint.{own}.{position[0]}" if position else own


def _inferred(state: State, describer: _Describer) -> Iterator[Individual]:
    for node in state.network.present():
        if node.kind != "attribute":
            values: dict[str, tuple[Value, ...]] = {"status": (str(state.status[node]),)}
            if node.kind in _REQUIRABLE:
                values["isRequired"] = (state.is_required(node),)
            yield Individual("", describer.id(node.element), values)


def _present(state: State, describer: _Describer) -> Iterator[Period]:
    """Yield what goes on now."""
    for node in state.network.present():
        for word, column in _COLUMNS.items():
            facts = vars(state)[column]
            value = facts.get(node) if isinstance(facts, dict) else node in facts
            if value:
                said = state.reason(column, node)
                fields: dict[str, Any] = {"reason": said.text}
                if word == "AssertedStatus":
                    fields |= {"status": str(value), "until": said.until}
                yield Period(word, describer.id(node.element), fields)
    for name, parameters in state.parameters.items():
        about = named_id("Component", name)
        yield Period("ParametersInForce", about, {"parameters": parameters})


# ---------------------------------------------------------------- queries

_STEPS: Final = 1000  # of SQLite, after which the time is looked at
_LONGEST: Final = 1_000_000  # query [characters]
_MOST_ROWS: Final = 1_000_000
_PREFIXES: Final = {"": ROSA, "rdf": _RDF, "rdfs": _RDFS, "owl": _OWL, "xsd": _XSD}
_HEAD: Final = " ".join(f"PREFIX {name}: <{iri}>" for name, iri in _PREFIXES.items())
_VERBS: Final = ("SELECT", "ASK", "CONSTRUCT", "DESCRIBE")
_LITERAL: Final = r"""'''.*?'''|\"{3}.*?\"{3}|'(?:[^'\\\n]|\\.)*'|"(?:[^"\\\n]|\\.)*\""""
_TOKEN: Final = re.compile(
    rf"(?is)(?P<comment>\#[^\n\r]*)|<[^<>\s]*>|(?P<literal>{_LITERAL})"
    r"|(?<![\w?$:])(?P<word>SERVICE|MINUS|ASK|CONSTRUCT|DESCRIBE|INSERT|DELETE)\b"
    r"|(?<![\w.-])(?:rosa)?:(?P<rosa>\w+)"
)
_BEGIN: Final = re.compile(r"(?is)\s*(?:(?:PREFIX\s+\S*:|BASE)\s*<[^>]*>\s*)*(\w*)")
_OWN_PREFIX: Final = re.compile(r"(?i)PREFIX\s+(rosa)?:")
_CONDITION: Final = re.compile(r"(?i)FILTER\s*(\((?:[^(){}]|\([^(){}]*\))*\))")
_INSTEAD: Final = {
    "MINUS": "write FILTER NOT EXISTS { ... } instead",
    "ASK": "SELECT instead, and look whether there is a row",
    "CONSTRUCT": "SELECT the subjects, properties and values instead",
    "DESCRIBE": "SELECT ?property ?value { <individual> ?property ?value } instead",
}


def answers(
    world: World, sparql: str, is_over: Callable[[], bool] = lambda: False
) -> list[tuple[Answer, ...]]:
    """Answer a query over a world; `is_over` tells whether its time is over.

    owlready2 translates it to SQL. What that lacks is answered by rdflib, if it is installed.

    Raises:
        TimeoutError, sqlite3.OperationalError: its time is over; SQLite says "interrupted".
    """
    text, words = _checked(sparql)
    failure: object = words[0] if words else ""
    if not words:
        try:
            in_sql, literals = _in_sql(text)
            query = world.prepare_sparql(f"{_HEAD} {in_sql}", False)
            rows = query.execute_raw(literals)
            return _bounded((_row(world, query.column_types, row) for row in rows), is_over)
        except (KnowledgeBaseError, TimeoutError):
            raise
        except Exception as error:  # of any class: of the parser, the translator and SQLite
            if "interrupted" in str(error):
                raise
            failure = error
    try:
        import rdflib  # noqa: F401  # owlready2 imports it otherwise, perhaps for another world

        graph = world.as_rdflib_graph()
    except ImportError:
        if words:
            why = f"{failure} needs rdflib, which is not installed; {_INSTEAD[words[0]]}"
            raise InvalidValue(why) from None
        raise InvalidValue(f"the query cannot be answered: {failure}") from None
    try:
        found = graph.query(f"{_HEAD} {text}")
        rows = [(found.askAnswer,)] if found.type == "ASK" else found
        listed = _bounded((tuple(map(_term, row)) for row in rows), is_over)
        return listed if found.type in ("ASK", "SELECT") else sorted(listed, key=str)
    except (KnowledgeBaseError, TimeoutError):
        raise
    except Exception as error:  # rdflib raises plain ones, too
        if "interrupted" in str(error):
            raise
        raise InvalidValue(f"the query cannot be answered: {error}") from None


def _checked(sparql: str) -> tuple[str, list[str]]:
    """Return a query without comments, and its words that owlready2 does not know.

    Raises:
        InvalidValue: it would change something or ask another server.
        UnknownName: a word is none of ROSA's.
    """
    if not isinstance(sparql, str) or len(sparql) > _LONGEST:
        what = f"{len(sparql)} characters" if isinstance(sparql, str) else repr(sparql)
        most = f"it has at most {_LONGEST} characters"
        raise InvalidValue(f"a query is a text in SPARQL, not {what}; {most}")
    words: list[str] = []
    has_own_prefix = _OWN_PREFIX.search(sparql) is not None

    def replaced(match: re.Match[str]) -> str:
        if match["word"]:
            words.append(match["word"].upper())
        if match["rosa"] and not has_own_prefix:
            if match["rosa"] not in WORDS:
                raise UnknownName("word of ROSA", match["rosa"], sorted(WORDS))
            return f":{match['rosa']}"
        return " " if match["comment"] else match[0]

    text = _TOKEN.sub(replaced, sparql)
    begin = _BEGIN.match(text)
    verb = begin[1] if begin else ""
    if verb.upper() not in _VERBS:
        given = f"not with {verb}" if verb else "after its prefixes; there is none"
        what = f"a query begins with SELECT, or {', '.join(_VERBS[1:])}, {given}"
        raise InvalidValue(f"{what}; it changes nothing")
    bare = re.sub(f"(?s){_LITERAL}", "''", text)
    elsewhere = _CONDITION.sub(" ", bare)
    for condition in _CONDITION.findall(bare):
        for variable in re.findall(r"[?$]\w+", condition):
            if not re.search(rf"[?$]{variable[1:]}\b", elsewhere):
                raise InvalidValue(f"{variable} is in FILTER only, so nothing gives it a value")
    for word in words:
        if word not in _INSTEAD:
            why = "nothing is asked of other places" if word == "SERVICE" else "nothing is changed"
            raise InvalidValue(f"{word} is not supported; leave it out, {why}")
    return text, words


def _in_sql(text: str) -> tuple[str, list[str]]:
    """Return a query with parameters for its odd literals, which owlready2 reads wrongly, and these."""
    literals: list[str] = []

    def replaced(match: re.Match[str]) -> str:
        if re.fullmatch(r"[\w .,:;_-]*", match[0][1:-1]):
            return match[0]
        literals.append(_fit(literal_eval(match[0])))  # Python writes literals as SPARQL does
        return f"??{len(literals)}"

    return re.sub(f"(?s){_LITERAL}", replaced, text), literals


def _bounded(
    rows: Iterable[tuple[Answer, ...]], is_over: Callable[[], bool]
) -> list[tuple[Answer, ...]]:
    listed: list[tuple[Answer, ...]] = []
    for row in rows:
        listed.append(row)
        if len(listed) > _MOST_ROWS:
            much = f"the answer has more than {_MOST_ROWS} rows; ask for less, or add LIMIT"
            raise KnowledgeBaseError(much)
        if is_over():
            raise TimeoutError
    return listed


def _row(world: World, types: Sequence[str], row: Sequence[Any]) -> tuple[Answer, ...]:
    """Return a row of owlready2 as plain values; an individual becomes its IRI."""
    values: list[Answer] = []
    column = 0
    while column < len(row):
        value = row[column]
        is_object = types[column] == "objs"
        sort = None if is_object else row[column + 1]
        if value is not None and (is_object or sort == "o"):
            value = f"_:{-value}" if value < 0 else world._unabbreviate(value)
        elif isinstance(value, str):
            is_flag = sort == world._abbreviate(f"{_XSD}boolean")
            value = value == "true" if is_flag else _unfit(value)
        values.append(value)
        column += 1 if is_object else 2
    return tuple(values)


def _term(term: Any) -> Answer:  # noqa: ANN401  # of rdflib
    """Return a term of rdflib as a plain value."""
    value = term.toPython() if hasattr(term, "datatype") else term
    if isinstance(value, Decimal):
        return float(value)
    if value is None or isinstance(value, bool | int | float):
        return value
    return _unfit(str(value))
