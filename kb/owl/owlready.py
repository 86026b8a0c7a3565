"""OWL through owlready2, the only module that imports it; imported late."""

import re
import shutil
import sqlite3
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from io import BytesIO
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

import owlready2
from owlready2 import rdfxml_2_ntriples
from owlready2.sparql.main import Translator

from kb.exceptions import KnowledgeBaseError, ModelError, UnknownName
from kb.facts import Contents
from kb.files import ModelFileError, read_text
from kb.owl.individuals import CLASSES, GENERAL, MODEL, PARAMETER, PREFERENCE, STATED, Declarer, Individual, Ref, Value
from kb.owl.queries import FUNCTIONS, Answer, Question, complaint, read_question, stopped
from kb.owl.rdfxml import ROSA, order, plain_text, stray_text
from kb.owl.worker import answer

_TYPE: Final = "http://www.w3.org/1999/02/22-rdf-syntax-ns#type"
_KINDS: Final = frozenset({*CLASSES.values(), *GENERAL, MODEL, PARAMETER, PREFERENCE})
_ABSTRACT: Final = frozenset({"Element", "Relation", "Fact", "Period"})
_FIRST: Final = 1 << 40  # what stands for fact 0 in the tables; what stands for anything else is less
_MOST_ROWS: Final = 1_000_000
_AT_ONCE: Final = 200
_WHERE: Final = re.compile(r"line (\d+), column (\d+)")


ModelT = TypeVar("ModelT", bound=Contents)


class _Triple(NamedTuple):
    subject: str
    predicate: str
    value: Value


def load_owl(cls: Callable[[str], ModelT], paths: Sequence[Path], name: str | None) -> ModelT:
    """Read a model from OWL files in RDF/XML, as they are taken together; see `Model.load`."""
    told: dict[str, dict[str, list[Value]]] = {}
    for path in paths:
        read = list(_triples(path))
        if not any(one.predicate == _TYPE and _local(one.value) for one in read):
            raise ModelFileError(f"nothing in it is described in the words of {ROSA}", str(path))
        for triple in read:
            told.setdefault(triple.subject, {}).setdefault(triple.predicate, []).append(triple.value)
    try:
        found = [_individual(subject, values) for subject, values in told.items()]
        given = [one for one in found if one is not None]
        for one in given:
            if one.kind not in _KINDS:
                raise ModelError(f"{one.id}: {UnknownName('class', one.kind, sorted(_KINDS))}")
        model = cls(name or _model_name(given) or paths[0].stem)
        Declarer(model).declare(given)
    except KnowledgeBaseError as error:
        raise ModelFileError(str(error), ", ".join(map(str, paths))) from None
    return model


def inconsistency(text: str) -> str | None:
    """Have HermiT look for a contradiction in an ontology; returns what it found, or None.

    Raises:
        KnowledgeBaseError: there is no Java to run it with, or it cannot read the ontology.
    """
    if shutil.which(owlready2.JAVA_EXE) is None:
        raise KnowledgeBaseError("HermiT, the reasoner, needs Java, which is not found; install a Java runtime")
    world = owlready2.World()
    try:
        world.get_ontology("http://rosa-taca/checked#").load(only_local=True, fileobj=BytesIO(text.encode()))
        owlready2.sync_reasoner_hermit(world, debug=0, ignore_unsupported_datatypes=True)
        empty = sorted(one.name for one in world.inconsistent_classes())
    except owlready2.OwlReadyInconsistentOntologyError:
        return "HermiT finds the ontology inconsistent: what it says cannot all be so"
    except owlready2.OwlReadyJavaError as error:
        raise KnowledgeBaseError(f"HermiT failed: {error}") from None
    finally:
        world.close()
    return f"HermiT finds that nothing can be a {', '.join(empty)}" if empty else None


def _triples(path: Path) -> Iterator[_Triple]:
    content = read_text(path)
    if not content.strip():
        raise ModelFileError("the file is empty", str(path))
    read: list[_Triple] = []

    def about(subject: str, predicate: str, value: str) -> None:
        read.append(_Triple(subject, predicate, Ref(value)))

    def valued(subject: str, predicate: str, value: str | int | float, datatype: str) -> None:
        read.append(_Triple(subject, predicate, _literal(value, datatype)))

    try:
        rdfxml_2_ntriples.parse(BytesIO(content.encode()), about, valued, lambda *_: None, None, "")
    except owlready2.OwlReadyOntologyParsingError as error:
        line, column = (int(number) for number in _WHERE.search(str(error)).groups())  # type: ignore[union-attr]  # it always says where
        cause = str(error.__cause__).removesuffix(f": line {line}, column {column}")
        raise ModelFileError(f"this is no RDF/XML: {cause}", str(path), line, column + 1) from None
    if stray := stray_text(content):
        text, line, column = stray
        raise ModelFileError(
            f"the text {text!r} belongs to nothing; a text stands in a property", str(path), line, column
        )
    yield from read


def _literal(value: str | float, datatype: str) -> Value:
    if datatype.endswith("#boolean"):
        return value in ("true", "1")
    return plain_text(value) if isinstance(value, str) else value


def _individual(subject: str, told: Mapping[str, Sequence[Value]]) -> Individual | None:
    types = [_local(one) for one in told.get(_TYPE, ())]
    ours = [one for one in types if one and one not in _ABSTRACT]
    if not ours:
        return None
    kinds = [one for one in dict.fromkeys(ours) if one not in {GENERAL.get(other) for other in ours}]
    if len(kinds) > 1:
        raise ModelError(f"{subject} is {' and '.join(kinds)}; it can be one of them")
    values = {_local(Ref(name)): tuple(each) for name, each in told.items() if name != _TYPE}
    places = _places(str(*values.pop("order", ("",))))
    ordered = {name: tuple(_ordered(each, places.get(name, []))) for name, each in values.items() if name}
    return Individual(kinds[0], subject, ordered)


def _places(text: str) -> dict[str, list[str]]:
    listed = [part.split() for part in text.split(";") if part.strip()]
    return {name: players for name, *players in listed}


def _ordered(values: Sequence[Value], places: Sequence[str]) -> Iterable[Value]:
    """Return values in the order that is stated, with repetitions; what is not in it comes last."""
    by_place: dict[str, Value] = {one.id.rpartition("#")[2]: one for one in values if isinstance(one, Ref)}
    known = [by_place[place] for place in places if place in by_place]
    rest = sorted((one for one in values if one not in known), key=str)
    return (*known, *rest)


def _local(value: Value) -> str:
    return value.id.removeprefix(ROSA) if isinstance(value, Ref) and value.id.startswith(ROSA) else ""


def _model_name(given: Iterable[Individual]) -> str | None:
    names: list[Any] = [name for one in given if one.kind == MODEL for name in one.values.get("name", ())]
    return names[0] if names else None


class _World(owlready2.World):  # type: ignore[misc]  # owlready2 has no types
    """A world whose values can be written and read without individuals."""

    def python_of(self, cell: object, datatype: object) -> Answer:
        value: Answer = self._to_python(cell, datatype)
        return value

    def iri_of(self, number: int) -> str:
        return str(self._unabbreviate(number))

    def number_of(self, iri: str) -> int:
        return int(self._abbreviate(iri))

    def rdf_of(self, value: object) -> tuple[object, object]:
        cell, datatype = self._to_rdf(value)
        return cell, datatype


def serve(descriptor: int) -> None:
    """Be the process of a worker."""
    answer(Connection(descriptor), Book)


class Book:
    """A world of individuals: the words of ROSA, a model, what was told, and what is inferred."""

    def __init__(self, base: str) -> None:
        self.base = base
        connection = sqlite3.connect(":memory:", isolation_level="EXCLUSIVE", check_same_thread=False)
        self.world = _World(filename=":memory:", connection=connection)
        self._db = self.world.graph.db
        self._contexts = {
            name: self.world.get_ontology(f"{base}/{name}#").graph.c for name in ("model", "told", "inferred")
        }
        self._words: dict[str, int] = {}

    def describe(self, words: str) -> None:
        self.world.get_ontology(ROSA).load(only_local=True, fileobj=BytesIO(words.encode()))

    def ask(self, query: str, timeout: float, deadline: float) -> Iterator[tuple[Answer, ...]]:
        """Answer a SPARQL query, for which a time [s] was allowed, before a deadline of the monotonic clock [s]."""
        self._db.commit()
        question = read_question(query)
        prepared = self._prepared(question)
        self._db.set_progress_handler(lambda: time.monotonic() > deadline, 10_000)
        self._db.execute("PRAGMA query_only=1")
        try:
            cursor = prepared.execute_raw([_storable(text) for text in question.texts])
            for count, row in enumerate(cursor):
                yield tuple(self._answers(row, prepared.column_types))
                if count >= _MOST_ROWS:
                    raise KnowledgeBaseError(f"the answer has more than {_MOST_ROWS} rows; ask for less, or add LIMIT")
        except KnowledgeBaseError:
            raise
        except Exception as error:  # what a query says is nobody's here
            raise complaint(error, question, ()) if time.monotonic() <= deadline else stopped(timeout) from None
        finally:
            self._db.set_progress_handler(None, 0)
            self._db.execute("PRAGMA query_only=0")

    def _prepared(self, question: Question) -> Any:  # noqa: ANN401  # of owlready2
        try:
            prepared = Translator(self.world).parse(question.text)
        except Exception as error:
            raise complaint(error, question, self._vocabulary()) from None
        for name, function in FUNCTIONS.items():
            self._db.create_function(name, -1, function, deterministic=True)
        return prepared

    def _vocabulary(self) -> list[str]:
        found = self._db.execute("SELECT iri FROM resources WHERE iri LIKE ? ORDER BY iri", (f"{ROSA}_%",)).fetchall()
        return [iri.removeprefix(ROSA) for (iri,) in found]

    def _answers(self, row: Sequence[Any], types: Sequence[str]) -> Iterator[Answer]:
        cells = iter(zip(row, types, strict=True))
        for cell, sort in cells:
            datatype = "o" if sort == "objs" else next(cells)[0]
            if cell is None:
                yield None
            elif datatype != "o":
                yield self.world.python_of(cell, datatype)
            else:
                yield f"_:{-cell}" if cell < 0 else self.world.iri_of(cell)

    def clear(self, context: str) -> None:
        for table in ("objs", "datas"):
            self._db.execute(f"DELETE FROM {table} WHERE c=?", (self._contexts[context],))

    def write(self, context: str, given: Iterable[Individual]) -> None:
        """Add individuals to the "model", to what was "told", or to what is "inferred".

        One that has no kind is there already and has more values now.
        """
        c = self._contexts[context]
        names, relations, values = [], [], []
        for one in given:
            subject = self._node(one.id)
            if subject >= _FIRST:
                names.append((subject, f"{self.base}#{one.id}"))
            for kind in dict.fromkeys((GENERAL.get(one.kind, one.kind), one.kind)) if one.kind else ():
                relations.append((c, subject, self._word(_TYPE), self._word(f"{ROSA}{kind}")))
            for name, value in _said(one):
                word = self._word(f"{ROSA}{name}")
                if isinstance(value, Ref):
                    relations.append((c, subject, word, self._node(value.id)))
                else:
                    values.append((c, subject, word, *self.world.rdf_of(_storable(value))))
        self._insert("resources", names)
        self._insert("objs", relations)
        self._insert("datas", values)

    def _insert(self, table: str, rows: Sequence[tuple[object, ...]]) -> None:
        """Insert many rows in few steps, for each step may have to wait until a busy thread takes a rest."""
        for first in range(0, len(rows), _AT_ONCE):
            some = rows[first : first + _AT_ONCE]
            marks = ",".join(["(" + ",".join("?" * len(some[0])) + ")"] * len(some))
            self._db.execute(f"INSERT OR IGNORE INTO {table} VALUES {marks}", [one for row in some for one in row])

    def _node(self, own: str) -> int:
        stated, _, number = own.partition(".")
        return _FIRST + int(number) if stated == STATED else self._word(f"{self.base}#{own}")

    def _word(self, iri: str) -> int:
        found = self._words.get(iri)
        if found is None:
            found = self._words[iri] = self.world.number_of(iri)
        return found


def _said(one: Individual) -> Iterator[tuple[str, Value]]:
    for name, values in one.values.items():
        for value in values:
            yield name, value
    if ordered := order(one):
        yield "order", ordered


def _storable(value: Value) -> object:
    """Return a value that the tables can hold: no number of more than 64 bits, and no half of a character."""
    if isinstance(value, str):
        return value.encode("utf-8", "backslashreplace").decode()
    return str(value) if type(value) is int and abs(value) >= 1 << 63 else value
