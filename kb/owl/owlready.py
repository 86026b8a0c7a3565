"""Models in OWL files, and HermiT through owlready2, which looks for contradictions in them; imported late."""

import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Final, TypeVar
from xml.parsers import expat

from pyoxigraph import Literal, NamedNode, RdfFormat, parse

from kb.exceptions import KnowledgeBaseError, ModelError, UnknownName
from kb.facts import Contents
from kb.files import ModelFileError, read_text
from kb.owl.individuals import CLASSES, GENERAL, MODEL, PARAMETER, PREFERENCE, Declarer, Individual, Ref, Value
from kb.owl.queries import answer_of, value_of
from kb.owl.rdfxml import ROSA, TYPE, plain_text

_KINDS: Final = frozenset({*CLASSES.values(), *GENERAL, MODEL, PARAMETER, PREFERENCE})
_ABSTRACT: Final = frozenset({"Element", "Relation", "Fact", "Period"})
_BASE: Final = "http://rosa-taca/file"  # of names that a file leaves relative
_STRAY: Final = re.compile(r"Unexpected text event: '(.*)'", re.DOTALL)


ModelT = TypeVar("ModelT", bound=Contents)


def load_owl(cls: Callable[[str], ModelT], paths: Sequence[Path], name: str | None) -> ModelT:
    """Read a model from OWL files in RDF/XML, as they are taken together; see `Model.load`."""
    told: dict[str, dict[str, list[Value]]] = {}
    for path in paths:
        read = list(_triples(path))
        if not any(predicate == TYPE and _local(value) for _, predicate, value in read):
            raise ModelFileError(f"nothing in it is described in the words of {ROSA}", str(path))
        for subject, predicate, value in read:
            told.setdefault(subject, {}).setdefault(predicate, []).append(value)
    try:
        found = [_individual(subject, values) for subject, values in told.items()]
        given = [one for one in found if one is not None]
        for one in given:
            if one.kind not in _KINDS:
                raise ModelError(f"{one.id}: {UnknownName('class', one.kind, sorted(_KINDS))}")
        names = [str(said) for one in given if one.kind == MODEL for said in one.values.get("name", ())]
        model = cls(name or next(iter(names), paths[0].stem))
        Declarer(model).declare(given)
    except KnowledgeBaseError as error:
        raise ModelFileError(str(error), ", ".join(map(str, paths))) from None
    return model


def inconsistency(text: str) -> str | None:
    """Have HermiT look for a contradiction in an ontology; returns what it found, or None.

    Raises:
        KnowledgeBaseError: there is no Java to run it with, or it cannot read the ontology.
    """
    try:
        import owlready2
    except ImportError as error:
        missing = "HermiT, the reasoner, comes with owlready2, which is not installed"
        raise KnowledgeBaseError(f"{missing}; pip install 'rosa-taca[reason]' brings it") from error
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


def _triples(path: Path) -> Iterator[tuple[str, str, Value]]:
    """Yield subject, predicate and value of all that a file says."""
    content = read_text(path)
    if not content.strip():
        raise ModelFileError("the file is empty", str(path))
    try:
        expat.ParserCreate().Parse(content, True)  # says where it is no XML, and expands no entity without end
        for one in parse(content.encode(), format=RdfFormat.RDF_XML, base_iri=_BASE):
            about = one.subject.value if isinstance(one.subject, NamedNode) else str(one.subject)
            value = value_of(one.object) if isinstance(one.object, Literal) else Ref(str(answer_of(one.object)))
            yield about, one.predicate.value, plain_text(value) if isinstance(value, str) else value
    except expat.ExpatError as error:
        said = expat.ErrorString(error.code)
        raise ModelFileError(f"this is no RDF/XML: {said}", str(path), error.lineno, error.offset + 1) from None
    except SyntaxError as error:
        raise _wrong(content, str(path), str(error)) from None


def _wrong(content: str, path: str, told: str) -> ModelFileError:
    """Return what is wrong with a file that is well-formed; where a text belongs to nothing, the place of that."""
    found = _STRAY.fullmatch(told)
    text = found[1].strip() if found else ""
    place = content.find(text) if text else -1
    if place < 0:
        return ModelFileError(f"this is no RDF/XML: {told}", path)
    line, column = content.count("\n", 0, place) + 1, place - content.rfind("\n", 0, place)
    return ModelFileError(f"the text {text[:40]!r} belongs to nothing; a text stands in a property", path, line, column)


def _individual(subject: str, told: Mapping[str, Sequence[Value]]) -> Individual | None:
    types = [_local(one) for one in told.get(TYPE, ())]
    ours = [one for one in types if one and one not in _ABSTRACT]
    if not ours:
        return None
    kinds = [one for one in dict.fromkeys(ours) if one not in {GENERAL.get(other) for other in ours}]
    if len(kinds) > 1:
        raise ModelError(f"{subject} is {' and '.join(kinds)}; it can be one of them")
    values = {_local(Ref(name)): tuple(each) for name, each in told.items() if name != TYPE}
    listed = [part.split() for part in str(*values.pop("order", ("",))).split(";") if part.strip()]
    places = {name: players for name, *players in listed}
    ordered = {name: _ordered(each, places.get(name, [])) for name, each in values.items() if name}
    return Individual(kinds[0], subject, ordered)


def _ordered(values: Sequence[Value], places: Sequence[str]) -> tuple[Value, ...]:
    """Return values in the order that is stated, with repetitions; what is not in it comes last."""
    by_place: dict[str, Value] = {one.id.rpartition("#")[2]: one for one in values if isinstance(one, Ref)}
    known = [by_place[place] for place in places if place in by_place]
    return (*known, *sorted((one for one in values if one not in known), key=str))


def _local(value: Value) -> str:
    return value.id.removeprefix(ROSA) if isinstance(value, Ref) and value.id.startswith(ROSA) else ""
