"""The ontology of a robot: ROSA's words, the model and what is known now, in owlready2.

`Ontology` is the world of a knowledge base, to be asked in SPARQL. `owl_text` and `load_owl` write
and read models, `contradiction` asks HermiT. Nothing in a tick reads an ontology. owlready2 is
imported when the first world is made.

Classes and properties are made from the dataclasses of elements, facts and records. An element, a
relation with a name or attributes and whatever holds for a time is an individual; other relations
are object properties.
"""

import json
import math
import re
import shutil
import time
from ast import literal_eval
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import fields
from functools import cache, partial
from io import BytesIO
from itertools import chain
from pathlib import Path
from threading import RLock
from types import new_class
from typing import Any, Final, NamedTuple, TypeVar
from urllib.parse import quote
from weakref import finalize
from xml.parsers import expat

from kb import elements, records
from kb.elements import ByName
from kb.events import Event
from kb.exceptions import InvalidValue, KnowledgeBaseError, ModelError, UnknownName
from kb.files import ModelFileError, read_text
from kb.state import State

ModelT = TypeVar("ModelT", bound=elements.Owner)
Answer = str | bool | int | float | None
World = Any  # of owlready2, which has no types

ROSA: Final = "http://rosa-taca/rosa#"
"""The prefix of all classes and properties."""
BASE: Final = "http://rosa-taca/model/"
"""The prefix of individuals; the id of the model and `#` follow."""
HISTORY: Final = 10_000
"""The most measurements, and the most periods that have ended, that a world holds."""
RECORDS: Final = 1000
"""The most records of each kind that a world holds."""
_OWL: Final = "http://www.w3.org/2002/07/owl#"
_RDFS: Final = "http://www.w3.org/2000/01/rdf-schema#"
_XSD: Final = "http://www.w3.org/2001/XMLSchema#"


_LOCK: Final = RLock()  # owlready2 serves one thread at a time, whatever the world


class Individual(NamedTuple):
    """An individual: its class, its id, and its fields as its dataclass has them."""

    word: str
    id: str
    fields: Mapping[str, Any]


# ---------------------------------------------------------------- words

CLASSES: Final[Mapping[type, str]] = {
    **{cls: words.title().replace(" ", "") for cls, words in elements.ROSA.items()},
    records.RequiredAction: "RequiredAction",
    records.ReconfigurationPlan: "ReconfigurationPlan",
    records.Process: "ComponentProcess",
    records.Attempt: "Attempt",
    records.VetoAnswer: "VetoAnswer",
}
"""The class of individuals for each dataclass, in an order in which they can be declared."""
_SUBCLASSES: Final = {
    "": "Element Relation Fact RobotModel",
    "Element": "Action Function FunctionDesign Component ComponentConfiguration Attribute",
    "Attribute": "QualityAttribute EnvironmentalAttribute",
    "Component": "ProcessComponent LifecycleComponent",
    "ProcessComponent": "RosNodeComponent",
    "Relation": "Constraint Estimation Parameter Preference",
    "Fact": "Measurement VetoAnswer Amendment Period",
    "Period": """RequiredAction ReconfigurationPlan ComponentProcess Attempt Failure Activity
        Selection AssertedStatus AssertedRequirement ParametersInForce""",
}
_PARENTS: Final = {word: parent for parent, words in _SUBCLASSES.items() for word in words.split()}

_TABLE: Final = """
    requires          Function*               Action.functions
    restores          Element*
    realises          Function                FunctionDesign.function
    uses              Component*              FunctionDesign.components
    configures        Component               ComponentConfiguration.component
    compares          Attribute               Constraint.attribute
    constrains        Element*                Constraint.constrained
    affects           Attribute               Estimation.attribute
    causedBy          Element                 Estimation.causer
    effect            text                    Estimation.kind
    measures          Attribute               Measurement.attribute
    prefers           Attribute
    hasParameter      Parameter*              parameters
    hasPreference     Preference*             preference
    about             Thing                   element action component
    activates         Component*              activate
    deactivates       Component*              deactivate
    setsParametersOf  ComponentConfiguration* ReconfigurationPlan.parameters Attempt.configuration
    ofPlan            ReconfigurationPlan     plan
    number            whole                   Attempt.number
    pid               whole
    alwaysImprove     flag
    stopsToConfigure  flag
    latest            flag
    isVetoed          flag
    isRequired        flag
    priority          number
    weight            number
    value             double
    time              double
    start             double
    end               double
    until             double
    maxAge            double
    hysteresis        double
    dwell             double
    low               double
    high              double
    status            text
    key               text
    parameterValue    text
    parameterType     text
    change            text
"""
"""Properties, what they lead to (`*`: to several), and the fields whose names differ from theirs.

All other fields are properties that lead to a text.
"""
_ROWS: Final = [line.split() for line in _TABLE.strip().splitlines()]
_RANGES: Final = {name: target.rstrip("*") for name, target, *_ in _ROWS}
_LISTS: Final = frozenset(name for name, target, *_ in _ROWS if target.endswith("*"))
_RENAMED: Final = {field: name for name, _, *names in _ROWS for field in names}
_OMITTED: Final = ("model", "cause", "serial", "plain", "kind", "number")
_NOTHING: Final = (None, "", math.inf, -math.inf)


def property_of(word: str, field: str) -> str:
    """Return the property for a field of the individuals of a class; empty if there is none."""
    first, *others = field.split("_")
    same = "" if field in _OMITTED else first + "".join(map(str.capitalize, others))
    return _RENAMED.get(f"{word}.{field}") or _RENAMED.get(field) or same


PROPERTIES: Final = {
    cls: {field.name: property_of(word, field.name) for field in fields(cls)}
    for cls, word in CLASSES.items()
}
"""The property of each field, by dataclass."""
_FIELDS: Final = chain.from_iterable(own.values() for own in PROPERTIES.values())
WORDS: Final = {*_PARENTS, *_RANGES, *_FIELDS, "position", "order"} - {""}


def _lineage(word: str) -> list[str]:
    """Return a class and those above it."""
    return [word, *_lineage(_PARENTS[word])] if word else []


_SPECIAL: Final = {
    "quality": "QualityAttribute",
    "environmental": "EnvironmentalAttribute",
    "process": "ProcessComponent",
    "ros_node": "RosNodeComponent",
    "lifecycle": "LifecycleComponent",
}
"""The class of individuals for a kind of attribute or component."""


def declare_words(ontology: Any) -> None:  # noqa: ANN401  # of owlready2
    """Declare ROSA's classes and properties in an ontology."""
    import owlready2 as owl

    namespace = ontology.get_namespace(ROSA)

    def declare(name: str, *bases: type) -> Any:  # noqa: ANN401  # of owlready2
        return new_class(name, bases, {}, lambda body: body.update(namespace=namespace))

    ranges: dict[str, Any] = {"": owl.Thing, "text": str, "flag": bool, "whole": int}
    with ontology:
        for parent, words in _SUBCLASSES.items():
            siblings = [declare(word, ranges[parent]) for word in words.split()]
            ranges.update(zip(words.split(), siblings, strict=True))
            if len(siblings) > 1:
                owl.AllDisjoint(siblings)
        for name in sorted(WORDS - _PARENTS.keys() - {"position", "order"}):
            target = _RANGES.get(name, "text")
            kind = owl.ObjectProperty if target[0].isupper() else owl.DataProperty
            declared = declare(name, kind, *(() if name in _LISTS else (owl.FunctionalProperty,)))
            declared.range = [ranges[target]] if target in ranges else []
        declare("position", owl.AnnotationProperty)
        declare("order", owl.AnnotationProperty)
        namespace["name"].python_name = "rosa_name"  # owlready2 has another


# ---------------------------------------------------------------- individuals


def _id(word: str, name: object) -> str:
    """Return the id of an individual; different names have different ids."""
    escaped = quote(str(name), safe="", errors="surrogatepass")
    return f"{word}.{escaped.replace('.', '%2E').replace('~', '%7E')}"


def described(element: Any, own: str, **more: object) -> Individual:  # noqa: ANN401  # a dataclass
    """Describe an element, fact or record as an individual."""
    cls = type(element)
    stated = {field: getattr(element, field) for field in PROPERTIES[cls]}
    word = _SPECIAL.get(str(stated.get("kind")), CLASSES[cls])
    return Individual(word, own, {**stated, **more})


class _Double(float):
    """A number that owlready2 writes as a double, and not as a decimal."""


_UNFIT: Final = re.compile(
    "[^\t\n\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]|\\\\(?=u[0-9a-f]{4})"
)


def _fit(text: str) -> str:
    """Escape the characters that XML and SQLite cannot hold; `_unfit` reads them back."""
    return _UNFIT.sub(lambda match: f"\\u{ord(match[0]):04x}", text)


def _unfit(text: str) -> str:
    return re.sub(r"\\u([0-9a-f]{4})", lambda match: chr(int(match[1], 16)), text)


class _Graph:
    """A world of owlready2 with ROSA's words, to which individuals are written.

    Attributes:
        word: returns a class or property by its name.
        ids: of elements, constraints and estimations.
        written: the fields of the individuals in it, by class and id.
    """

    def __init__(self, model: str) -> None:
        import owlready2

        owlready2.declare_datatype(_Double, f"{_XSD}double", float, float)
        self.world = owlready2.World()
        self.ontology = self.world.get_ontology(f"{BASE}{_id('RobotModel', model)}#")
        self.rosa = self.ontology.get_namespace(ROSA)
        self.word = cache(self.rosa.__getitem__)
        self.ids: dict[object, str] = {}
        self._things: dict[str, Any] = {}
        self.written: dict[tuple[str, str], Mapping[str, Any]] = {}
        declare_words(self.ontology)
        self.close = self.world.close

    def describe(self, model: elements.Owner) -> Iterator[Individual]:
        """Describe all elements of a model, which thereby get their ids."""
        yield Individual("RobotModel", _id("RobotModel", model.name), {"name": model.name})
        for cls, table in model.tables.items():
            for position, element in enumerate(table.values()):
                own = _id(CLASSES[cls], getattr(element, "name", position))
                self.ids[element] = own
                yield described(element, own, position=position)

    def put(self, individual: Individual) -> None:
        """Write an individual, in place of what is written of it."""
        word, own, stated = individual
        before = self.written.get((word, own))
        if before == stated:
            return
        thing = self.thing(own)
        if before is None and word:
            for kind in _lineage(word):
                thing.is_a.append(self.word(kind))
            thing.label = [_fit(stated[field]) for field in ("name",) if field in stated]
        for field, value in stated.items():
            name = property_of(word, field)
            if name and (before is None or before.get(field) != value):
                values = list(self._values(own, name, field, value))
                self.word(name)[thing] = values[:1]
                for another in values[1:]:  # one by one, else owlready2 lets a set decide the order
                    self.word(name)[thing].append(another)
                if len(values) > 1:
                    line = " ".join([name, *(part.name for part in values)])
                    self.rosa.order[thing].append(line)
        self.written[word, own] = stated

    def thing(self, own: str) -> Any:  # noqa: ANN401  # of owlready2
        """Return the individual of an id; one that is not described yet is made."""
        import owlready2

        if own not in self._things:
            self._things[own] = owlready2.Thing(own, namespace=self.ontology)
        return self._things[own]

    def drop(self, word: str, own: str) -> None:
        """Remove an individual."""
        import owlready2

        del self.written[word, own]
        if own in self._things:
            owlready2.destroy_entity(self._things.pop(own))

    def _values(self, own: str, name: str, field: str, value: Any) -> Iterator[Any]:  # noqa: ANN401  # of any class
        """Yield the values of a property for a field, as owlready2 takes them."""
        if field in ("agreement", "rates"):
            value = json.dumps(value) if value else ""
        if name == "hasPreference" and isinstance(value, str):
            value = {value: 1.0}
        if isinstance(value, Mapping):
            for key, content in value.items():
                nested = {"prefers": self.thing(_id("Attribute", key)), "weight": content}
                if name == "hasParameter":
                    nested = {"key": key, "parameter_value": json.dumps(content)}
                    nested["parameter_type"] = elements.parameter_type(content)
                part = Individual(_RANGES[name], _id(f"{_RANGES[name]}.{own}", key), nested)
                self.put(part)
                yield self.thing(part.id)
            return
        for item in value if isinstance(value, list | tuple) else (value,):
            if isinstance(item, records.ReconfigurationPlan):
                yield self.thing(_id("ReconfigurationPlan", item.number))
            elif item in self.ids:
                yield self.thing(self.ids[item])
            elif item in _NOTHING:
                continue
            elif field in elements.REFERENCES:
                yield self.thing(_id(CLASSES[elements.REFERENCES[field]], item))
            elif isinstance(item, str):
                yield _fit(str(item))
            else:
                yield _Double(item) if _RANGES.get(name) == "double" else item


# ---------------------------------------------------------------- files


def owl_text(model: elements.Owner) -> str:
    """Write a model with ROSA's words as RDF/XML; see `Model.save`."""
    with _LOCK, closing(_Graph(model.name)) as graph:
        for individual in graph.describe(model):
            graph.put(individual)
        for position, fact in enumerate(model.facts):
            graph.put(described(fact, f"Fact.{position}", position=position))
        written = BytesIO()
        graph.ontology.save(written, format="rdfxml")
        return written.getvalue().decode()


def load_owl(cls: "Callable[[str], ModelT]", paths: Sequence[Path], name: str | None) -> "ModelT":
    """Read one model from one or more OWL files in RDF/XML; see `Model.load`."""
    with _LOCK, closing(_Graph("")) as graph:
        for path in paths:
            _parse(graph.world, path)
        try:
            reader = _Reader(graph)
            model = cls(name or next(reader.names(), paths[0].stem))
            reader.declare(model)
        except KnowledgeBaseError as error:
            raise ModelFileError(str(error), ", ".join(map(str, paths))) from None
        return model


def _parse(world: World, path: Path) -> None:
    """Read the triples of a file into an ontology of its own."""
    import owlready2

    text = read_text(path)
    if ROSA not in text:
        raise ModelFileError(f"nothing in it is described in the words of {ROSA}", str(path))
    ontology = world.get_ontology(f"{BASE}file{len(world.ontologies)}#")
    try:
        expat.ParserCreate().Parse(text, True)  # says where, and refuses endless entities
        ontology.graph.parse(BytesIO(text.encode()), format="rdfxml", default_base=BASE)
    except expat.ExpatError as error:
        why = f"this is not RDF/XML: {expat.ErrorString(error.code)}"
        raise ModelFileError(why, str(path), error.lineno, error.offset + 1) from None
    except owlready2.OwlReadyOntologyParsingError as error:
        raise ModelFileError(f"this is not RDF/XML: {error}", str(path)) from None


class _Reader:
    """Declares the individuals of a world in a model, each after those that it refers to."""

    def __init__(self, graph: _Graph) -> None:
        self._rosa = graph.rosa
        self._elements: ByName[Any] = ByName("individual")
        words = "SELECT DISTINCT ?w { { ?x a ?w } UNION { ?x ?w ?y } }"
        for (iri,) in answers(graph.world, words):
            word = str(iri).removeprefix(ROSA)
            if word != iri and word not in WORDS:
                raise UnknownName("word of ROSA", word, WORDS)

    def names(self) -> Iterator[str]:
        """Yield the names of the models that are described."""
        for thing in self._rosa.RobotModel.instances():
            yield from map(_unfit, self._rosa["name"][thing])

    def declare(self, model: elements.Owner) -> None:
        """Declare elements by class and position, then facts by position."""
        classes: dict[str, tuple[type, dict[str, str]]] = {
            CLASSES[cls]: (cls, {}) for cls in elements.ROSA
        }
        for kind, word in _SPECIAL.items():
            general = elements.Attribute if "Attribute" in word else elements.Component
            classes[word] = (general, {"kind": kind})
        kinds = {
            thing: each for word, each in classes.items() for thing in self._rosa[word].instances()
        }
        ranks = {cls: rank for rank, cls in enumerate(elements.KINDS)}
        ordered: list[tuple[int, Any, str, Any]] = []
        for thing, (cls, _) in kinds.items():
            position = self._rosa.position[thing] or [0]
            ordered.append((ranks.get(cls, len(ranks)), position, thing.iri, thing))
        for *_, iri, thing in sorted(ordered):
            cls, stated = kinds[thing]
            try:
                self._elements[thing] = model.state(cls, self._fields(thing, cls) | stated)
            except (LookupError, TypeError, ValueError) as error:
                raise ModelError(f"{iri}: {error}") from None

    def _fields(self, thing: Any, cls: type) -> dict[str, Any]:  # noqa: ANN401  # of owlready2
        """Return the fields of a dataclass as an individual has them."""
        orders = [line.split() for line in self._rosa.order[thing]]
        stated: dict[str, Any] = {}
        for field, name in PROPERTIES[cls].items():
            if not name:
                continue
            order = [own for word, *ids in orders if word == name for own in ids]
            values = sorted(self._rosa[name][thing], key=partial(_place, order))
            read = [self._read(cls, field, name, value) for value in values]
            if name in ("hasParameter", "hasPreference"):
                stated[field] = dict(read)
            elif name in _LISTS:
                stated[field] = read
            elif len(read) > 1:
                raise ModelError(f"{name} has one value, not {len(read)}")
            elif read:
                stated[field] = read[0]
        return stated

    def _read(self, cls: type, field: str, name: str, value: Any) -> Any:  # noqa: ANN401  # of any class
        if not _RANGES.get(name, "text")[0].isupper():
            return _unfit(value) if isinstance(value, str) else value
        if name == "hasParameter":
            return _unfit(value.key or ""), json.loads(_unfit(value.parameterValue))
        if name == "hasPreference":
            return self._elements[value.prefers].name, value.weight
        element = self._elements[value]
        is_by_name = cls is elements.Constraint or cls not in elements.KINDS
        return element.name if is_by_name and field in elements.REFERENCES else element


def _place(order: Sequence[str], value: Any) -> tuple[float, str]:  # noqa: ANN401  # of owlready2
    """Return the place of an individual in the order that is stated; the others come last."""
    name = getattr(value, "name", "")
    return order.index(name) if name in order else math.inf, name


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
        empty = sorted(cls.name for cls in world.inconsistent_classes())
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
    "assert_status": ("AssertedStatus", ("status", "reason", "until")),
    "retract_status": ("AssertedStatus", ()),
    "lapse": ("AssertedStatus", ()),
    "assert_required": ("AssertedRequirement", ("is_so",)),
    "assert_selected": ("Selection", ("is_so", "reason")),
}
"""By verb of an event: the period that begins or ends for its first argument, and its fields.

An event without further arguments, or with a false one, only ends the period.
"""
_WORD_OF_KIND: Final = {kind: CLASSES[cls] for cls, kind in elements.KINDS.items()}

Period = tuple[str, str]
"""Its class, and the id of what it is about."""


class _Live(_Graph):
    """The world of a knowledge base: its model, what is so now, and the newest history."""

    def __init__(self, kb: Any) -> None:  # noqa: ANN401  # a knowledge base, which imports this module
        super().__init__(kb.model.name)
        self._last = -1  # number of the newest event in it
        self._count = 0
        self._open: dict[Period, Individual] = {}
        self._ended: deque[tuple[str, str]] = deque()
        self._measured: deque[tuple[str, str]] = deque()
        with kb.reading() as state:
            self._network = state.network
            described = list(self.describe(kb.model))
        for individual in described:
            self.put(individual)

    def update(self, kb: Any) -> bool:  # noqa: ANN401  # a knowledge base, which imports this module
        """Write what is new; return whether the model is still the one that is described.

        The knowledge base is held only while it is copied.
        """
        with kb.reading() as state:
            if kb.log.last == self._last:
                return True
            if state.network is not self._network:
                return False
            events = list(kb.log.since(max(self._last, 0)))
            measured = [
                (event.time, *event.arguments) for event in events if event.verb == "measure"
            ]
            if self._last < 0:
                past = [
                    (time, view.name, value)
                    for view in kb.attributes.values()
                    for time, value in view.history
                ]
                measured = sorted(past)[-HISTORY:]
            now = [*self._inferred(state), *self._new_records(kb)]
            present = dict(self._present(state))
            self._last = kb.log.last
        for individual in now:
            self.put(individual)
        for event in events:
            self._follow(event)
        for period in sorted(self._open.keys() ^ present.keys()):  # of which no event says when
            self._change(period, kb.log.time, present.get(period))
        for moment, name, value in measured:
            stated = {"attribute": name, "time": moment, "value": value}
            self._remember(self._measured, self._numbered("Measurement", stated))
        return True

    # ---------------------------------------------------------------- copied

    def _inferred(self, state: State) -> Iterator[Individual]:
        """Yield the statuses of the elements, and the parameters in force."""
        for node in state.network.present():
            if node.kind != "attribute":
                stated: dict[str, Any] = {"status": state.status[node]}
                if node.kind in ("action", "function", "component"):
                    stated["is_required"] = state.is_required(node)
                yield Individual("", self.ids[node.element], stated)
        for node, parameters in state.parameters.items():
            stated = {"component": node.name, "parameters": parameters}
            yield Individual("ParametersInForce", _id("ParametersInForce", node.name), stated)

    def _present(self, state: State) -> Iterator[tuple[Period, dict[str, Any]]]:
        """Yield what goes on now, with its fields."""
        columns = {
            "failed": ("Failure", state.failed),
            "active": ("Activity", state.active),
            "selected": ("Selection", state.selected),
            "asserted": ("AssertedStatus", state.asserted),
            "asserted_required": ("AssertedRequirement", state.asserted_required),
        }
        for column, (word, nodes) in columns.items():
            for node in nodes:
                reason = state.reason(column, node)
                stated = {"reason": reason.text, "until": reason.until}
                if word == "AssertedStatus":
                    stated["status"] = str(state.asserted[node])
                yield (word, self.ids[node.element]), stated

    def _new_records(self, kb: Any) -> Iterator[Individual]:  # noqa: ANN401  # of any class
        """Yield the records that are new or had not ended."""
        history = kb.history
        for table in (
            kb.plans,
            history.actions,
            history.processes,
            history.attempts,
            history.answers,
        ):
            for record in table[-RECORDS:]:
                number = getattr(record, "serial", getattr(record, "number", None)) or record.time
                word = CLASSES[type(record)]
                own = _id(word, number)
                if self.written.get((word, own), {}).get("end") is None:
                    yield described(record, own)

    # ---------------------------------------------------------------- written

    def _follow(self, event: Event) -> None:
        """Write what an event begins and ends."""
        if event.verb == "amend":
            stated = {"time": event.time, "change": event.text}
            self._remember(self._ended, self._numbered("Amendment", stated))
        for kind, name, is_selected in event.effects:
            stated = {"start": event.time, "reason": event.arguments[2]}
            period = "Selection", _id(_WORD_OF_KIND[kind], name)
            self._change(period, event.time, stated if is_selected else None)
        if event.verb in _PERIODS:
            word, names = _PERIODS[event.verb]
            about, *arguments = event.arguments
            kind, name, *place = ("component", about) if isinstance(about, str) else about
            stated = {"start": event.time, **dict(zip(names, arguments, strict=False))}
            is_so = bool(names) and stated.pop("is_so", True)
            if not place:  # else it is a constraint, which has no name
                period = word, _id(_WORD_OF_KIND[kind], name)
                self._change(period, event.time, stated if is_so else None)

    def _change(self, period: Period, moment: float, stated: Mapping[str, Any] | None) -> None:
        """End what goes on, and begin it anew with these fields unless there are none."""
        word, about = period
        before = self._open.pop(period, None)
        if before is not None:
            self._remember(self._ended, before._replace(fields={**before.fields, "end": moment}))
        if stated is not None:
            self._open[period] = self._numbered(word, {"about": self.thing(about), **stated})
            self.put(self._open[period])

    def _numbered(self, word: str, stated: Mapping[str, Any]) -> Individual:
        self._count += 1
        return Individual(word, f"Fact.{self._count}", stated)

    def _remember(self, past: deque[tuple[str, str]], individual: Individual) -> None:
        """Write an individual of the past, in place of the oldest if there are too many."""
        self.put(individual)
        past.append(individual[:2])
        if len(past) > HISTORY:
            self.drop(*past.popleft())


class Ontology:
    """The world of a knowledge base, brought up to date when it is asked."""

    def __init__(self, kb: Any) -> None:  # noqa: ANN401  # a knowledge base, which imports this module
        self._kb = kb
        self._live: _Live | None = None

    @property
    def world(self) -> World:
        """The world of owlready2, up to date."""
        with _LOCK:
            live = self._live
            self._live = None  # an interrupt may leave it half written
            while live is None or not live.update(self._kb):
                if live is not None:
                    live.close()
                live = _Live(self._kb)
                finalize(self, live.close)  # owlready2 holds the classes of an open world
            self._live = live
            return live.world

    def query(self, sparql: str, timeout: float) -> list[tuple[Answer, ...]]:
        """Answer a query; see `KnowledgeBase.query`."""
        end = time.monotonic() + timeout
        with _LOCK:
            world = self.world
            database = world.graph.db
            database.set_progress_handler(lambda: time.monotonic() > end, 1000)
            try:
                return answers(world, sparql)
            except TimeoutError:
                advice = "ask for less, or allow it a longer timeout"
                why = f"the query was stopped after {timeout:g} s; {advice}"
                raise KnowledgeBaseError(why) from None
            finally:
                database.set_progress_handler(None, 0)


# ---------------------------------------------------------------- queries

_HEAD: Final = (
    f"PREFIX : <{ROSA}> PREFIX rosa: <{ROSA}> PREFIX rdfs: <{_RDFS}> PREFIX owl: <{_OWL}> "
)
_REFUSED: Final = {
    "MINUS": "write FILTER NOT EXISTS { ... } instead",
    "ASK": "SELECT instead, and look whether there is a row",
    "CONSTRUCT": "SELECT the subjects, properties and values instead",
    "DESCRIBE": "SELECT ?property ?value { <individual> ?property ?value } instead",
    "SERVICE": "leave it out, nothing is asked of other places",
    "INSERT": "leave it out, nothing is changed",
    "DELETE": "leave it out, nothing is changed",
}
_TOKEN: Final = re.compile(
    r"(?is)(?P<comment>\#[^\n]*)|<[^<>\s]*>"
    r"""|(?P<literal>'{3}.*?'{3}|"{3}.*?"{3}|'(?:[^'\\\n]|\\.)*'|"(?:[^"\\\n]|\\.)*")"""
    rf"|(?<![\w?$:])(?P<refused>{'|'.join(_REFUSED)})\b|(?<![\w.-])(?:rosa)?:(?P<word>\w+)"
)


def answers(world: World, sparql: str) -> list[tuple[Answer, ...]]:
    """Answer a query over a world: owlready2 translates it to SQL.

    Raises:
        InvalidValue: it cannot be answered, would change something or ask another server.
        UnknownName: a word is none of ROSA's.
        TimeoutError: its time is over.
    """
    literals: list[str] = []
    has_prefixes = re.search(r"(?i)\bprefix\b", sparql)

    def replaced(match: re.Match[str]) -> str:
        refused = (match["refused"] or "").upper()
        if refused:
            raise InvalidValue(f"{refused} is not supported; {_REFUSED[refused]}")
        if match["word"] and match["word"] not in WORDS and not has_prefixes:
            raise UnknownName("word of ROSA", match["word"], sorted(WORDS))
        if match["comment"]:
            return " "
        if not match["literal"] or re.fullmatch(r"[\w .,:;_-]*", match["literal"][1:-1]):
            return match[0]
        literals.append(_fit(literal_eval(match[0])))  # Python writes literals as SPARQL does
        return f"??{len(literals)}"  # owlready2 reads odd ones wrongly

    text = _TOKEN.sub(replaced, sparql)
    try:
        query = world.prepare_sparql(f"{_HEAD} {text}", False)
        return [_row(world, query.column_types, row) for row in query.execute_raw(literals)]
    except Exception as error:  # of any class: of the parser, the translator and SQLite
        if "interrupted" in str(error):
            raise TimeoutError from None
        advice = (
            "; REGEX and REPLACE need flags, if only ''" if "user-defined" in str(error) else ""
        )
        raise InvalidValue(f"the query cannot be answered: {error}{advice}") from None


def _row(world: World, types: Sequence[str], row: Sequence[Any]) -> tuple[Answer, ...]:
    """Return a row of owlready2 as plain values; an individual becomes its IRI."""
    values: list[Answer] = []
    columns = iter(zip(types, row, strict=True))
    for kind, value in columns:
        datatype = "o" if kind == "objs" else next(columns)[1]  # the datatype follows
        if datatype == "o" and value is not None:
            value = f"_:{-value}" if value < 0 else world._unabbreviate(value)
        elif isinstance(value, str):
            value = world._to_python(value, datatype)
        values.append(_unfit(value) if isinstance(value, str) else value)
    return tuple(values)
