"""Reads and writes models as OWL files (RDF/XML), and looks for contradictions with HermiT, through owlready2.

A file holds the classes and properties of `rosa.owl` and the individuals of the model, so that any reader of OWL
understands it without a second file. This module is imported late.
"""

import json
import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Final, TypeVar
from xml.parsers import expat

from pyoxigraph import Literal, NamedNode, RdfFormat, parse, serialize

from kb.exceptions import KnowledgeBaseError, ModelError, UnknownName
from kb.facts import Contents
from kb.files import ModelFileError, read_text
from kb.owl import (
    BASE,
    CLASSES,
    GENERAL,
    MODEL,
    PARAMETER,
    PREFERENCE,
    Declarer,
    Individual,
    Ref,
    Value,
    individuals,
)
from kb.owl.queries import METAMODEL, PREFIXES, ROSA, XSD, answer_of, value_of

_TYPE, _LABEL = f"{PREFIXES['rdf']}type", f"{PREFIXES['rdfs']}label"
_NAMED: Final = f"{PREFIXES['owl']}NamedIndividual"
_QUOTED: Final = json.JSONEncoder(ensure_ascii=False)  # texts are escaped in JSON as in N-Triples
_ONTOLOGY: Final = re.compile(r"  <owl:Ontology.*?</owl:Ontology>\n", re.DOTALL)
_UNFIT: Final = re.compile(
    "[^\t\n\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]|\\\\(?=u[0-9a-f]{4})"
)
_FITTED: Final = re.compile(r"\\u([0-9a-f]{4})")
_KINDS: Final = frozenset({*CLASSES.values(), *GENERAL, MODEL, PARAMETER, PREFERENCE})
_ABSTRACT: Final = frozenset({"Element", "Relation", "Fact", "Period"})
_RELATIVE: Final = "http://rosa-taca/file"  # the base of relative names in a file

ModelT = TypeVar("ModelT", bound=Contents)


def owl_text(model: Contents) -> str:
    """Write a model as an ontology; see `Model.save`."""
    own, *others = individuals(model)
    base = f"{BASE}{own.id}"
    lines = []
    for one in (own, *others):
        lines += [f"<{base}#{one.id}> <{_TYPE}> <{_NAMED}> .\n", triples(one, base, _fit)]
        names = (_term(str(name), base, _fit) for name in one.values.get("name", ()))
        lines += [f"<{base}#{one.id}> <{_LABEL}> {name} .\n" for name in names]
    stated = dict.fromkeys(parse("".join(lines), format=RdfFormat.N_TRIPLES))
    written = (serialize(stated, format=RdfFormat.RDF_XML, prefixes=PREFIXES) or b"").decode()
    label = escape(_fit(model.name), quote=False)
    head = (
        f'  <owl:Ontology rdf:about="{base}">\n    <rdfs:label>{label}</rdfs:label>\n'
        "    <rdfs:comment>The model of a robot, with the words of ROSA that it is written in.</rdfs:comment>\n"
        "  </owl:Ontology>\n"
    )
    words = _ONTOLOGY.sub(lambda _: head, METAMODEL.read_text(encoding="utf-8"), count=1)
    individuals_of_it = written[written.index("\t<owl:NamedIndividual") :].rstrip()
    return words.replace("</rdf:RDF>", f"  <!-- the model -->\n\n{individuals_of_it}")


def triples(one: Individual, base: str, fit: Callable[[str], str]) -> str:
    """Write what an individual is as N-Triples; `base` and `#` stand before each id, `fit` escapes texts."""
    subject = f"<{base}#{one.id}>"
    kinds = dict.fromkeys((GENERAL.get(one.kind, one.kind), one.kind)) if one.kind else ()
    lines = [f"{subject} <{_TYPE}> <{ROSA}{kind}> .\n" for kind in kinds]
    order = []
    for name, values in one.values.items():
        lines += [f"{subject} <{ROSA}{name}> {_term(value, base, fit)} .\n" for value in values]
        if len(values) > 1:
            order.append(
                " ".join((name, *(value.id for value in values if isinstance(value, Ref))))
            )
    if order:
        lines.append(f'{subject} <{ROSA}order> "{"; ".join(order)}" .\n')
    return "".join(lines)


def _term(value: Value, base: str, fit: Callable[[str], str]) -> str:
    if isinstance(value, str):
        return _QUOTED.encode(fit(value))
    if isinstance(value, float):
        return f'"{repr(value).removesuffix(".0")}"^^<{XSD}double>'
    if isinstance(value, Ref):
        return f"<{base}#{value.id}>"
    return f'"{str(value).lower()}"^^<{XSD}{"boolean" if isinstance(value, bool) else "integer"}>'


def _fit(text: str) -> str:
    """Escape characters that XML cannot hold; `plain_text` reads them back."""
    return _UNFIT.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def plain_text(text: str) -> str:
    return _FITTED.sub(lambda found: chr(int(found[1], 16)), text)


def load_owl(cls: Callable[[str], ModelT], paths: Sequence[Path], name: str | None) -> ModelT:
    """Read one model from one or more OWL files in RDF/XML; see `Model.load`."""
    said_of: dict[str, dict[str, list[Value]]] = {}
    for path in paths:
        read = list(_triples(path))
        if not any(predicate == _TYPE and _local(value) for _, predicate, value in read):
            raise ModelFileError(f"nothing in it is described in the words of {ROSA}", str(path))
        for subject, predicate, value in read:
            said_of.setdefault(subject, {}).setdefault(predicate, []).append(value)
    try:
        found = [_individual(subject, values) for subject, values in said_of.items()]
        given = [one for one in found if one is not None]
        names = [
            str(said) for one in given if one.kind == MODEL for said in one.values.get("name", ())
        ]
        model = cls(name or next(iter(names), paths[0].stem))
        Declarer(model).declare(given)
    except KnowledgeBaseError as error:
        raise ModelFileError(str(error), ", ".join(map(str, paths))) from None
    return model


def _triples(path: Path) -> Iterator[tuple[str, str, Value]]:
    """Yield subject, predicate and value of each triple of a file."""
    content = read_text(path)
    if not content.strip():
        raise ModelFileError("the file is empty", str(path))
    try:
        expat.ParserCreate().Parse(
            content, True
        )  # says where an error is, and refuses endless entities
        for one in parse(content.encode(), format=RdfFormat.RDF_XML, base_iri=_RELATIVE):
            about = one.subject.value if isinstance(one.subject, NamedNode) else str(one.subject)
            value = (
                value_of(one.object)
                if isinstance(one.object, Literal)
                else Ref(str(answer_of(one.object)))
            )
            yield about, one.predicate.value, plain_text(value) if isinstance(value, str) else value
    except expat.ExpatError as error:
        said = expat.ErrorString(error.code)
        raise ModelFileError(
            f"this is not RDF/XML: {said}", str(path), error.lineno, error.offset + 1
        ) from None
    except SyntaxError as error:
        raise ModelFileError(
            f"this is not RDF/XML: {' '.join(str(error).split())}", str(path)
        ) from None


def _individual(subject: str, said: Mapping[str, Sequence[Value]]) -> Individual | None:
    types = [_local(one) for one in said.get(_TYPE, ())]
    ours = [one for one in types if one and one not in _ABSTRACT]
    if not ours:
        return None
    kinds = [
        one for one in dict.fromkeys(ours) if one not in {GENERAL.get(other) for other in ours}
    ]
    if len(kinds) > 1:
        raise ModelError(f"{subject} is {' and '.join(kinds)}; it can be only one of them")
    if kinds[0] not in _KINDS:
        raise ModelError(f"{subject}: {UnknownName('class', kinds[0], sorted(_KINDS))}")
    values = {_local(Ref(name)): tuple(each) for name, each in said.items() if name != _TYPE}
    listed = [part.split() for part in str(*values.pop("order", ("",))).split(";") if part.strip()]
    places = {name: players for name, *players in listed}
    ordered = {name: _ordered(each, places.get(name, [])) for name, each in values.items() if name}
    return Individual(kinds[0], subject, ordered)


def _ordered(values: Sequence[Value], places: Sequence[str]) -> tuple[Value, ...]:
    """Return values in the stated order, with repetitions; other values come last."""
    by_place: dict[str, Value] = {
        one.id.rpartition("#")[2]: one for one in values if isinstance(one, Ref)
    }
    known = [by_place[place] for place in places if place in by_place]
    return (*known, *sorted((one for one in values if one not in known), key=str))


def _local(value: Value) -> str:
    return (
        value.id.removeprefix(ROSA) if isinstance(value, Ref) and value.id.startswith(ROSA) else ""
    )


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
        raise KnowledgeBaseError(
            "HermiT, the reasoner, needs Java, which is not found; install a Java runtime"
        )
    world = owlready2.World()
    try:
        world.get_ontology("http://rosa-taca/checked#").load(
            only_local=True, fileobj=BytesIO(text.encode())
        )
        owlready2.sync_reasoner_hermit(world, debug=0, ignore_unsupported_datatypes=True)
        empty = sorted(one.name for one in world.inconsistent_classes())
    except owlready2.OwlReadyInconsistentOntologyError:
        return "HermiT finds the ontology inconsistent: what it says cannot all be true"
    except owlready2.OwlReadyJavaError as error:
        raise KnowledgeBaseError(f"HermiT failed: {error}") from None
    finally:
        world.close()
    return f"HermiT finds that nothing can be a {', '.join(empty)}" if empty else None
