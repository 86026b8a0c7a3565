"""The program that answers queries in SPARQL 1.1 with pyoxigraph; and RDF terms as plain values.

pyoxigraph cannot be interrupted, so this runs as a process of its own, which is killed at the time-out. It imports
nothing of ours: `python queries.py PARENT`, with the pid of the program that asks. It reads the world as N-Triples up
to an empty line, and then a query in each line, as JSON. For each it writes lines of JSON, each a list of rows, and a
last line: null, or `{"error": class, "given": arguments}`.
"""

import json
import os
import re
import resource
import signal
import sys
import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from threading import Thread
from typing import Final

from pyoxigraph import BlankNode, Literal, NamedNode, QueryBoolean, RdfFormat, Store, Triple

ROSA: Final = "http://rosa-taca/rosa#"  # the prefix of all classes and properties
METAMODEL: Final = Path(__file__).with_name("rosa.owl")
XSD: Final = "http://www.w3.org/2001/XMLSchema#"
PREFIXES: Final = {
    "": ROSA,
    "owl": "http://www.w3.org/2002/07/owl#",
    "rdf": "http://www.w3.org/1999/02/22-rdf-syntax-ns#",
    "rdfs": "http://www.w3.org/2000/01/rdf-schema#",
}
_MEMORY: Final = 4 << 30  # the most that the process may use [bytes]
_MOST_ROWS: Final = 1_000_000
_LOOK: Final = 1.0  # how often it is looked whether the asking program is still there [s]
_LOADED: Final = 5000  # triples that are loaded at once
_AT_ONCE: Final = (
    500  # rows in a line; reading a longer one would stop the other threads of the asking program
)
_VERBS: Final = ("SELECT", "ASK", "CONSTRUCT", "DESCRIBE")
_QUOTED: Final = (
    r"""\#[^\n\r]*|<[^<>\s]*>|'''.*?'''|\"{3}.*?\"{3}|'(?:[^'\\\n]|\\.)*'|"(?:[^"\\\n]|\\.)*\""""
)
_BEGIN: Final = re.compile(r"(?is)(?:\s|#[^\n\r]*|(?:PREFIX\s+\S*:|BASE)\s*<[^>]*>)*(\w*)")
_WORD: Final = re.compile(
    rf"(?is){_QUOTED}|(?<![\w?$:])(?P<other>SERVICE)\b|(?<![\w.-])(?:rosa)?:(?P<rosa>\w+)"
)
_OWN_PREFIX: Final = re.compile(r"(?i)PREFIX\s+(rosa)?:")
_PLACE: Final = re.compile(r"error at (\d+):(\d+): ")
_SENTENCE: Final = re.compile(r"(The [A-Z]+ .*?|Prefix not found)(?:,|$)")


class _Refused(Exception):
    """A query that is refused, with the name of the class of the error and its arguments."""


def main(parent: int) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    Thread(target=_end_with, args=(parent,), daemon=True).start()
    lines, world = sys.stdin.buffer, Store()
    world.load(path=METAMODEL, format=RdfFormat.RDF_XML)
    told = iter(lines.readline, b"\n")
    while some := b"".join(islice(told, _LOADED)):  # while the asking program writes more
        world.load(some, format=RdfFormat.N_TRIPLES, lenient=True)
    for query in map(json.loads, lines):
        end = None
        try:
            rows = _rows(world, query)
            while part := list(islice(rows, _AT_ONCE)):
                print(json.dumps(part))
        except _Refused as refused:
            end = {"error": refused.args[0], "given": refused.args[1:]}
        print(json.dumps(end), flush=True)


def _end_with(parent: int) -> None:
    """End this process at once when the asking program is no more, even during a query."""
    while os.getppid() == parent:
        time.sleep(_LOOK)
    signal.raise_signal(signal.SIGKILL)


def _rows(world: Store, query: str) -> Iterator[list[str | bool | int | float | None]]:
    """Yield rows: one for ASK, a triple each for CONSTRUCT and DESCRIBE."""
    _check(world, query)
    try:
        found = world.query(query, prefixes={**PREFIXES, "rosa": ROSA, "xsd": XSD})
        if isinstance(found, QueryBoolean):
            yield [bool(found)]
            return
        for count, row in enumerate(found):
            if count >= _MOST_ROWS:
                much = f"the answer has more than {_MOST_ROWS} rows; ask for less, or add LIMIT"
                raise _Refused("KnowledgeBaseError", much)
            yield list(map(answer_of, row))
    except (SyntaxError, OSError, ValueError) as error:
        raise _Refused("InvalidValue", _complaint(query, str(error))) from None


def _check(world: Store, query: str) -> None:
    """Refuse queries that change something or ask another server, and words that ROSA does not have."""
    begin = _BEGIN.match(query)
    if begin is None or begin[1].upper() not in _VERBS:
        word = f"not with {begin[1]}" if begin and begin[1] else "after its prefixes; there is none"
        what = f"a query begins with SELECT, or {', '.join(_VERBS[1:])}, {word}; it changes nothing"
        raise _Refused("InvalidValue", what)
    for found in _WORD.finditer(query):
        if found["other"]:
            raise _Refused(
                "InvalidValue",
                "SERVICE is not supported; leave it out, nothing is asked of other places",
            )
        rosa = NamedNode(f"{ROSA}{found['rosa']}")
        if (
            found["rosa"]
            and not _OWN_PREFIX.search(query)
            and not any(world.quads_for_pattern(rosa, None, None))
        ):
            named = (one.subject.value for one in world if isinstance(one.subject, NamedNode))
            known = sorted({name.removeprefix(ROSA) for name in named if name.startswith(ROSA)})
            raise _Refused("UnknownName", "word of ROSA", found["rosa"], known)


def _complaint(query: str, message: str) -> str:
    """Return what is wrong with a query and where, without the list of all that the grammar allows there."""
    place, said = _PLACE.match(message), _SENTENCE.search(" ".join(message.split()))
    if place is None:
        return f"the query cannot be answered: {message}"
    line, column = int(place[1]), int(place[2])
    at = len(query) - len("\n".join(query.split("\n")[line - 1 :])) + column - 1
    read, rest = query[:at].strip()[-20:], query[at : at + 20]
    what = (
        f"from {rest!r} on this is not understood"
        if rest
        else "the query ends too early, or this cannot stand here"
    )
    return f"line {line}, column {column} of the query, after {read!r}: {said[1] if said else what}"


def answer_of(
    term: NamedNode | BlankNode | Literal | Triple | None,
) -> str | bool | int | float | None:
    """Return a term as a plain value; an individual becomes its IRI."""
    if isinstance(term, NamedNode):
        return term.value
    return value_of(term) if isinstance(term, Literal) else None if term is None else str(term)


def value_of(literal: Literal) -> str | bool | int | float:
    sort, text = literal.datatype.value.removeprefix(XSD), literal.value
    try:
        if sort in ("double", "float", "decimal"):
            return float(text)
        if sort == "boolean":
            return text in ("true", "1")
        return int(text) if sort in ("integer", "int", "long") else text
    except ValueError:
        return text


if __name__ == "__main__":
    main(int(sys.argv[1]))
