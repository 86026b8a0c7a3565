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
import time
from ast import literal_eval
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import fields
from functools import cache, partial
from io import BytesIO
from pathlib import Path
from threading import RLock
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
"""After so many events, a world begins anew with the newest ones."""
RECORDS: Final = 1000
"""The most events, measurements and records of each kind with which a world begins."""
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
"""The class of individuals for each dataclass."""
_SUBCLASSES: Final = {
    "": "Element Relation Fact RobotModel",
    "Element": "Action Function FunctionDesign Component ComponentConfiguration Attribute",
    "Attribute": "QualityAttribute EnvironmentalAttribute",
    "Component": "ProcessComponent LifecycleComponent",
    "ProcessComponent": "RosNodeComponent",
    "Relation": "Constraint Estimation Parameter Preference",
    "Fact": "Measurement VetoAnswer Amendment Event Period",
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
    change            text
    verb              text
    subject           text
    text              text
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
_JSON: Final = ("agreement", "rates")


@cache
def property_of(word: str, field: str) -> str:
    """Return the property for a field of the individuals of a class; empty if there is none."""
    first, *others = field.split("_")
    same = "" if field in _OMITTED else first + "".join(map(str.capitalize, others))
    return _RENAMED.get(f"{word}.{field}") or _RENAMED.get(field) or same


def _properties(cls: type) -> dict[str, str]:
    """Return the property of each field of a dataclass that has one."""
    names = {field.name: property_of(CLASSES[cls], field.name) for field in fields(cls)}
    return {field: name for field, name in names.items() if name}


WORDS: Final = {*_PARENTS, *_RANGES, "position", "order"}
WORDS.update(*(_properties(cls).values() for cls in CLASSES))


def _lineage(word: str) -> list[str]:
    """Return a class and those above it."""
    return [word, *_lineage(_PARENTS.get(word, ""))] if word else []


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
        return type(name, bases, {"namespace": namespace})

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
    return f"{word}.{quote(str(name), safe='').replace('.', '%2E')}"


def described(element: Any, own: str, **more: object) -> Individual:  # noqa: ANN401  # a dataclass
    """Describe an element, fact or record as an individual."""
    cls = type(element)
    stated = {field: getattr(element, field) for field in _properties(cls)}
    word = _SPECIAL.get(str(getattr(element, "kind", "")), CLASSES[cls])
    return Individual(word, own, {**stated, **more})


class _Double(float):
    """A number that owlready2 writes as a double, and not as a decimal."""


@cache
def _declare_double() -> None:
    """Declare the datatype once: owlready2 writes it to every world, which may be closing."""
    import owlready2

    owlready2.declare_datatype(_Double, f"{_XSD}double", float, float)


class _Graph:
    """A world of owlready2 with ROSA's words, to which individuals are written.

    Attributes:
        word: returns a class or property by its name.
        ids: of elements, constraints and estimations.
        written: the fields of the individuals in it, by class and id.
    """

    def __init__(self, model: str) -> None:
        import owlready2

        _declare_double()
        self.world = owlready2.World()
        self.ontology = self.world.get_ontology(f"{BASE}{_id('RobotModel', model)}#")
        self.rosa = self.ontology.get_namespace(ROSA)
        self.word = cache(self.rosa.__getitem__)
        self.ids: dict[object, str] = {}
        self._things: dict[str, Any] = {}
        self.written: dict[tuple[str, str], Mapping[str, Any]] = {}
        declare_words(self.ontology)
        self.close: Callable[[], object] = self.world.close

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
            thing.label = stated.get("name", [])
        orders: list[str] = []
        for field, value in stated.items():
            name = property_of(word, field)
            if name:
                values = list(self._values(own, name, field, value))
                self.word(name)[thing] = values[:1]
                for another in values[1:]:  # one by one, else owlready2 lets a set decide the order
                    self.word(name)[thing].append(another)
                if len(values) > 1:
                    orders.append(" ".join([name, *(part.name for part in values)]))
        if orders:
            self.rosa.order[thing] = orders
        self.written[word, own] = stated

    def thing(self, own: str) -> Any:  # noqa: ANN401  # of owlready2
        """Return the individual of an id; one that is not described yet is made."""
        import owlready2

        if own not in self._things:
            self._things[own] = owlready2.Thing(own, namespace=self.ontology)
        return self._things[own]

    def _values(self, own: str, name: str, field: str, value: Any) -> Iterator[Any]:  # noqa: ANN401  # of any class
        """Yield the values of a property for a field, as owlready2 takes them."""
        if field in _JSON and value:
            value = json.dumps(value)
        if name == "hasPreference" and isinstance(value, str):
            value = {value: 1.0}
        if isinstance(value, Mapping):
            for key, content in value.items():
                nested = {"prefers": self.thing(_id("Attribute", key)), "weight": content}
                if name == "hasParameter":
                    nested = {"key": key, "parameter_value": json.dumps(content)}
                part = Individual(_RANGES[name], _id(f"{_RANGES[name]}.{own}", key), nested)
                self.put(part)
                yield self.thing(part.id)
            return
        for item in value if isinstance(value, list | tuple) else (value,):
            if item in self.ids:
                yield self.thing(self.ids[item])
            elif item in _NOTHING:
                continue
            elif isinstance(item, records.ReconfigurationPlan):
                yield self.thing(_id("ReconfigurationPlan", item.number))
            elif field in elements.REFERENCES:
                yield self.thing(_id(CLASSES[elements.REFERENCES[field]], item))
            elif isinstance(item, str):
                yield str(item)
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


def load_owl(cls: "Callable[[str], ModelT]", paths: Sequence[Path]) -> "ModelT":
    """Read one model from one or more OWL files in RDF/XML; see `Model.load`."""
    with _LOCK, closing(_Reader("")) as reader:
        for path in paths:
            reader.parse(path)
        try:
            reader.check_words()
            names = [each.rosa_name for each in reader.rosa.RobotModel.instances()]
            model = cls([*names, paths[0].stem][0])
            reader.declare(model)
        except (KnowledgeBaseError, ValueError) as error:
            raise ModelFileError(str(error), ", ".join(map(str, paths))) from None
        return model


class _Reader(_Graph):
    """Declares the individuals of a world in a model, each after those that it refers to."""

    def __init__(self, model: str) -> None:
        super().__init__(model)
        self._elements: ByName[Any] = ByName("individual")

    def parse(self, path: Path) -> None:
        """Read the triples of a file into an ontology of its own."""
        import owlready2

        text = read_text(path)
        if ROSA not in text:
            raise ModelFileError(f"nothing in it is described in the words of {ROSA}", str(path))
        ontology = self.world.get_ontology(f"{BASE}file{len(self.world.ontologies)}#")
        try:
            expat.ParserCreate(namespace_separator=" ").Parse(text, True)  # says what is wrong
            ontology.graph.parse(BytesIO(text.encode()), format="rdfxml", default_base=BASE)
        except (expat.ExpatError, owlready2.OwlReadyOntologyParsingError) as error:
            raise ModelFileError(f"this is not RDF/XML: {error}", str(path)) from None

    def check_words(self) -> None:
        """Refuse words that ROSA does not have; owlready2 would ignore them."""
        for (iri,) in answers(self.world, "SELECT DISTINCT ?w { { ?x a ?w } UNION { ?x ?w ?y } }"):
            word = str(iri).removeprefix(ROSA)
            if word != iri and word not in WORDS:
                raise UnknownName("word of ROSA", word, WORDS)

    def declare(self, model: elements.Owner) -> None:
        """Declare elements by class and position, then facts by position."""
        facts = len(elements.KINDS)  # they are in one order, after all elements
        found: list[tuple[int, list[int], str, Any, type]] = []
        for rank, cls in enumerate(elements.ROSA):
            for thing in self.rosa[CLASSES[cls]].instances():
                place = self.rosa.position[thing]
                found.append((min(rank, facts), place, thing.iri, thing, cls))
        for *_, iri, thing, cls in sorted(found, key=lambda each: each[:3]):
            words = [own.name for own in thing.is_a]
            stated = {"kind": kind for kind, word in _SPECIAL.items() if word in words}  # noqa: B035  # the last is the most special
            try:
                stated |= self._fields(thing, cls)
                self._elements[thing] = model.state(cls, stated)
            except (LookupError, TypeError, ValueError) as error:
                raise ModelError(f"{iri}: {error}") from None

    def _fields(self, thing: Any, cls: type) -> dict[str, Any]:  # noqa: ANN401  # of owlready2
        """Return the fields of a dataclass as an individual has them."""
        orders = dict(line.split(" ", 1) for line in self.rosa.order[thing])
        stated: dict[str, Any] = {}
        for field, name in _properties(cls).items():
            values = list(self.rosa[name][thing])
            if name not in _LISTS:
                if values:
                    (value,) = values
                    stated[field] = self._read(field, name, value)
                continue
            order = orders.get(name, "").split()
            values.sort(key=partial(_place, order))
            read = [self._read(field, name, value) for value in values]
            stated[field] = dict(read) if name.startswith("has") else read
        return stated

    def _read(self, field: str, name: str, value: Any) -> Any:  # noqa: ANN401  # of any class
        if name == "hasParameter":
            return value.key or "", json.loads(value.parameterValue)
        if name == "hasPreference":
            return self._elements[value.prefers].name, value.weight
        if _RANGES.get(name, "text")[0].isupper():
            return self._elements[value]
        if field in _JSON:
            return json.loads(value)
        return str(value) if isinstance(value, str) else value  # without its language


def _place(order: Sequence[str], value: Any) -> tuple[int, str]:  # noqa: ANN401  # of owlready2
    """Return the place of an individual in the order that is stated; the others come last."""
    name = getattr(value, "name", "")
    return [*order, name].index(name), name


def contradiction(text: str) -> str | None:
    """Have HermiT look for a contradiction in an ontology; returns what it found, or None.

    Raises:
        KnowledgeBaseError: there is no Java to run it with, or it cannot read the ontology.
    """
    import owlready2

    world = owlready2.World()
    try:
        ontology = world.get_ontology("http://rosa-taca/checked#")
        ontology.load(only_local=True, fileobj=BytesIO(text.encode()))
        owlready2.sync_reasoner_hermit(world, debug=0, ignore_unsupported_datatypes=True)
        empty = sorted(cls.name for cls in world.inconsistent_classes())
    except owlready2.OwlReadyInconsistentOntologyError:
        return "HermiT finds the ontology inconsistent: what it says cannot all be true"
    except (FileNotFoundError, owlready2.OwlReadyJavaError) as error:
        what = "HermiT, the reasoner, needs a Java runtime and an ontology that it can read"
        raise KnowledgeBaseError(f"{what}: {error}") from None
    finally:
        world.close()
    return f"HermiT finds that nothing can be a {', '.join(empty)}" if empty else None


# ---------------------------------------------------------------- what is known now

Period = tuple[str, str, str]
"""Its class, and the name and the id of what it is about."""


class _Live(_Graph):
    """The world of a knowledge base: its model, what is so now, and the newest history."""

    def __init__(self, kb: Any) -> None:  # noqa: ANN401  # a knowledge base, which imports this module
        super().__init__(kb.model.name)
        self._last = -math.inf  # number of the newest event in it
        self._first = kb.log.last
        self._open: dict[Period, Individual] = {}
        with kb.reading() as state:
            self._network = state.network
            model = list(self.describe(kb.model))
        for individual in model:
            self.put(individual)

    def update(self, kb: Any) -> bool:  # noqa: ANN401  # a knowledge base, which imports this module
        """Write what is new, or return that the world has to begin anew.

        The knowledge base is held only while it is copied.
        """
        with kb.reading() as state:
            if kb.log.last == self._last:
                return True
            if state.network is not self._network or kb.log.last > self._first + HISTORY:
                return False
            events = list(kb.log.since(max(self._last, 0)))
            measured = sorted(self._measured(state))
            now = [*self._inferred(state), *self._new_records(kb)]
            periods = dict(self._periods(state))
            self._last = kb.log.last
        for individual in now:
            self.put(individual)
        times: dict[str, float] = {}
        for event in events:
            times.update(dict.fromkeys((name for _, name, _ in event.effects), event.time))
            times[event.subject] = event.time
        for period in sorted(self._open.keys() | periods.keys()):
            self._follow(period, periods.get(period), times.get(period[1], kb.log.time))
        for number, moment, name, value in measured[-RECORDS:]:
            stated = {"attribute": name, "time": moment, "value": value}
            self.put(Individual("Measurement", _id("Measurement", number), stated))
        for event in events[-RECORDS:]:
            if event.verb != "measure":
                self.put(_happening(event))
        return True

    # ---------------------------------------------------------------- copied

    def _measured(self, state: State) -> Iterator[tuple[int, float, str, float]]:
        """Yield the number, time, attribute and value of each new measurement."""
        for node, history in state.histories.items():
            for moment, value, number in reversed(history):
                if number <= self._last:
                    break
                yield number, moment, node.name, value

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

    def _periods(self, state: State) -> Iterator[tuple[Period, dict[str, Any]]]:
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
                yield (word, node.name, self.ids[node.element]), stated

    def _new_records(self, kb: Any) -> Iterator[Individual]:  # noqa: ANN401  # a knowledge base
        """Yield the records that are new or had not ended."""
        history = kb.history
        tables = (history.actions, history.processes, history.attempts, history.answers)
        for table in (kb.plans, *tables):
            for record in table[-RECORDS:]:
                number = getattr(record, "serial", None) or record.number
                word = CLASSES[type(record)]
                own = _id(word, number)
                if self.written.get((word, own), {}).get("end") is None:
                    yield described(record, own)

    # ---------------------------------------------------------------- written

    def _follow(self, period: Period, stated: Mapping[str, Any] | None, moment: float) -> None:
        """End what went on, and begin it with these fields, unless they are the same or none."""
        word, _, about = period
        before = self._open.get(period)
        if before and stated and stated.items() <= before.fields.items():
            return
        if before:
            del self._open[period]
            self.put(before._replace(fields={**before.fields, "end": moment}))
        if stated is not None:
            begun = {"about": self.thing(about), "start": moment, **stated}
            self._open[period] = Individual(word, _id(word, len(self.written)), begun)
            self.put(self._open[period])


def _happening(event: Event) -> Individual:
    """Describe an event."""
    word, words = ("Amendment", "change") if event.verb == "amend" else ("Event", "text")
    stated = {"time": event.time, "verb": event.verb, "subject": event.subject, words: event.text}
    return Individual(word, _id(word, event.number), stated)


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
                live.close = finalize(self, live.close)  # owlready2 holds an open world's classes
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

    def replaced(match: re.Match[str]) -> str:
        refused = (match["refused"] or "").upper()
        if refused:
            raise InvalidValue(f"{refused} is not supported; {_REFUSED[refused]}")
        if match["word"] and match["word"] not in WORDS:
            raise UnknownName("word of ROSA", match["word"], sorted(WORDS))
        if match["comment"]:
            return " "
        if not match["literal"] or re.fullmatch(r"[\w .,:;_-]*", match["literal"][1:-1]):
            return match[0]
        literals.append(literal_eval(match[0]))  # Python writes literals as SPARQL does
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
        values.append(value)
    return tuple(values)
