"""OWL through owlready2, the only module that imports it; imported late."""

import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

import owlready2
from owlready2 import rdfxml_2_ntriples

from kb.exceptions import KnowledgeBaseError, ModelError, UnknownName
from kb.facts import Contents
from kb.files import ModelFileError, read_text
from kb.owl.individuals import CLASSES, GENERAL, MODEL, PARAMETER, PREFERENCE, Declarer, Individual, Ref, Value
from kb.owl.rdfxml import ROSA, plain_text, stray_text

_TYPE: Final = "http://www.w3.org/1999/02/22-rdf-syntax-ns#type"
_KINDS: Final = frozenset({*CLASSES.values(), *GENERAL, MODEL, PARAMETER, PREFERENCE})
_ABSTRACT: Final = frozenset({"Element", "Relation", "Fact", "Period"})
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
