"""A model as OWL in RDF/XML: the words of `rosa.owl`, and the individuals of the model in them.

The file holds both, so that any reader of OWL understands it without a second file.
"""

import json
import re
from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from typing import Final

from kb.facts import Contents
from kb.owl.individuals import GENERAL, Individual, Ref, Value, individuals

ROSA: Final = "http://rosa-taca/rosa#"  # what the names of classes and properties begin with
BASE: Final = "http://rosa-taca/model/"  # what the names of individuals begin with; the id of the model and `#` follow
_TYPES: Final[Mapping[type, str]] = {bool: "boolean", int: "integer", float: "double", str: "string"}
_ONTOLOGY: Final = re.compile(r"  <owl:Ontology.*?</owl:Ontology>\n", re.DOTALL)
_UNFIT: Final = re.compile("[^\t\n\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]|\\\\(?=u[0-9a-f]{4})")
_FITTED: Final = re.compile(r"\\u([0-9a-f]{4})")


def metamodel() -> str:
    return Path(__file__).with_name("rosa.owl").read_text(encoding="utf-8")


def owl_text(model: Contents) -> str:
    """Write a model as an ontology; see `Model.save`."""
    own, *others = individuals(model)
    base = f"{BASE}{own.id}"
    head = (
        f'  <owl:Ontology rdf:about="{base}">\n    <rdfs:label>{xml_text(model.name)}</rdfs:label>\n'
        "    <rdfs:comment>The model of a robot, with the words of ROSA that it is written in.</rdfs:comment>\n"
        "  </owl:Ontology>\n"
    )
    words = _ONTOLOGY.sub(lambda _: head, metamodel(), count=1)
    told = [line for one in (own, *others) for line in _lines(one, base)]
    return words.replace("</rdf:RDF>", "\n".join(["  <!-- the model -->", "", *told, "", "</rdf:RDF>"]))


def order(one: Individual) -> str:
    """Return the players of each property that has several, in order; nothing if none has."""
    several = {name: values for name, values in one.values.items() if len(values) > 1}
    return "; ".join(
        " ".join((name, *(value.id for value in values if isinstance(value, Ref)))) for name, values in several.items()
    )


def xml_text(text: str) -> str:
    return escape(_UNFIT.sub(lambda found: f"\\u{ord(found[0]):04x}", text), quote=False)


def plain_text(text: str) -> str:
    return _FITTED.sub(lambda found: chr(int(found[1], 16)), text)


def _lines(one: Individual, base: str) -> Iterator[str]:
    yield f'  <owl:NamedIndividual rdf:about="{base}#{one.id}">'
    for kind in dict.fromkeys((GENERAL.get(one.kind, one.kind), one.kind)):
        yield f'    <rdf:type rdf:resource="{ROSA}{kind}"/>'
    for label in one.values.get("name", ()):
        yield f"    <rdfs:label>{xml_text(str(label))}</rdfs:label>"
    for name, values in one.values.items():
        for value in dict.fromkeys(values):
            yield f"    {_property(name, value, base)}"
    if ordered := order(one):
        yield f"    {_property('order', ordered, base)}"
    yield "  </owl:NamedIndividual>"


def _property(name: str, value: Value, base: str) -> str:
    if isinstance(value, Ref):
        return f'<{name} rdf:resource="{base}#{value.id}"/>'
    text = value if isinstance(value, str) else json.dumps(value)
    datatype = f"http://www.w3.org/2001/XMLSchema#{_TYPES[type(value)]}"
    return f'<{name} rdf:datatype="{datatype}">{xml_text(text)}</{name}>'
