"""A model as OWL in RDF/XML: the words of `rosa.owl`, and the individuals of the model in them.

The file holds both, so that any reader of OWL understands it without a second file.
"""

import re
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Final

from kb.facts import Contents
from kb.owl.individuals import GENERAL, Individual, Ref, Value, individuals

ROSA: Final = "http://rosa-taca/rosa#"  # what the names of classes and properties begin with
BASE: Final = "http://rosa-taca/model/"  # what the names of individuals begin with; the id of the model and `#` follow
PREFIXES: Final = {
    "": ROSA,
    "owl": "http://www.w3.org/2002/07/owl#",
    "rdf": "http://www.w3.org/1999/02/22-rdf-syntax-ns#",
    "rdfs": "http://www.w3.org/2000/01/rdf-schema#",
}
TYPE: Final = f"{PREFIXES['rdf']}type"
_ONTOLOGY: Final = re.compile(r"  <owl:Ontology.*?</owl:Ontology>\n", re.DOTALL)
_UNFIT: Final = re.compile("[^\t\n\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]|\\\\(?=u[0-9a-f]{4})")
_FITTED: Final = re.compile(r"\\u([0-9a-f]{4})")


def metamodel() -> str:
    return Path(__file__).with_name("rosa.owl").read_text(encoding="utf-8")


def owl_text(model: Contents) -> str:
    """Write a model as an ontology; see `Model.save`."""
    from pyoxigraph import Literal, NamedNode, RdfFormat, Triple, serialize  # it takes a while

    own, *others = individuals(model)
    base, told = f"{BASE}{own.id}", []
    for one in (own, *others):
        names = [(f"{PREFIXES['rdfs']}label", name) for name in one.values.get("name", ())]
        for name, value in ((TYPE, Ref(f"{PREFIXES['owl']}NamedIndividual")), *statements(one, base), *names):
            text = NamedNode(value.id) if isinstance(value, Ref) else Literal(_fit(value))
            told.append(Triple(NamedNode(f"{base}#{one.id}"), NamedNode(name), text))
    written = (serialize(told, format=RdfFormat.RDF_XML, prefixes=PREFIXES) or b"").decode()
    described = written[written.index("\t<owl:NamedIndividual") :]
    label = escape(str(_fit(model.name)), quote=False)
    head = (
        f'  <owl:Ontology rdf:about="{base}">\n    <rdfs:label>{label}</rdfs:label>\n'
        "    <rdfs:comment>The model of a robot, with the words of ROSA that it is written in.</rdfs:comment>\n"
        "  </owl:Ontology>\n"
    )
    words = _ONTOLOGY.sub(lambda _: head, metamodel(), count=1)
    return words.replace("</rdf:RDF>", f"  <!-- the model -->\n\n{described.rstrip()}")


def statements(one: Individual, base: str) -> Iterator[tuple[str, Value]]:
    """Yield what an individual is and has: the IRI of each property and its value, of which a `Ref` is an IRI too."""
    for kind in dict.fromkeys((GENERAL.get(one.kind, one.kind), one.kind)) if one.kind else ():
        yield TYPE, Ref(f"{ROSA}{kind}")
    several = {name: values for name, values in one.values.items() if len(values) > 1}
    order = "; ".join(
        " ".join((name, *(one.id for one in each if isinstance(one, Ref)))) for name, each in several.items()
    )
    for name, values in {**one.values, **({"order": (order,)} if order else {})}.items():
        for value in dict.fromkeys(values):
            yield f"{ROSA}{name}", Ref(f"{base}#{value.id}") if isinstance(value, Ref) else value


def _fit(value: str | bool | int | float) -> str | bool | int | float:
    """Write what XML has no characters for so that `plain_text` reads it."""
    return _UNFIT.sub(lambda found: f"\\u{ord(found[0]):04x}", value) if isinstance(value, str) else value


def plain_text(text: str) -> str:
    return _FITTED.sub(lambda found: chr(int(found[1], 16)), text)
