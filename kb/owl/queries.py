"""Queries in SPARQL 1.1 over a world of individuals; through pyoxigraph, in a worker's process."""

import re
import resource
import signal
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Final

from pyoxigraph import NamedNode, Quad, QueryBoolean, RdfFormat, Store, parse

from kb.exceptions import InvalidValue, KnowledgeBaseError, UnknownName
from kb.owl.files import PREFIXES, XSD, answer_of, described
from kb.owl.individuals import ROSA, Individual
from kb.owl.worker import ENDED, MEMORY, Answer, parts, stopped

_MOST_ROWS: Final = 1_000_000
_PREFIXES: Final = {**PREFIXES, "rosa": ROSA, "xsd": XSD}
_VERBS: Final = ("SELECT", "ASK", "CONSTRUCT", "DESCRIBE")
_QUOTED: Final = r"""\#[^\n\r]*|<[^<>\s]*>|'''.*?'''|\"{3}.*?\"{3}|'(?:[^'\\\n]|\\.)*'|"(?:[^"\\\n]|\\.)*\""""
_BEGIN: Final = re.compile(r"(?is)(?:\s|#[^\n\r]*|(?:PREFIX\s+\S*:|BASE)\s*<[^>]*>)*(\w*)")
_WORD: Final = re.compile(rf"(?is){_QUOTED}|(?<![\w?$:])(?P<other>SERVICE)\b|(?<![\w.-])(?:rosa)?:(?P<rosa>\w+)")
_OWN_PREFIX: Final = re.compile(r"(?i)PREFIX\s+(rosa)?:")
_PLACE: Final = re.compile(r"error at (\d+):(\d+): ")
_SENTENCE: Final = re.compile(r"(The [A-Z]+ .*?|Prefix not found)(?:,|$)")


def serve(descriptor: int) -> None:
    """Be the process of a worker: do what comes in on its line, until nothing can come any more."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    line, book = Connection(descriptor), Book("")
    line.send("ready")
    with suppress(EOFError, OSError):
        while True:
            method, arguments = line.recv()
            if method == "open":
                book = Book(*arguments)
            elif method != "ask":
                getattr(book, method)(*arguments)
            else:
                _answer(line, book, *arguments)


def _answer(line: Connection, book: "Book", query: str, timeout: float, left: float) -> None:
    signal.setitimer(signal.ITIMER_REAL, 2.0 * left + 5.0)  # should nobody be there to kill it
    try:
        for some in parts(book.ask(query, timeout, time.monotonic() + left)):
            line.send(("", some))
        line.send(("", None))
    except (KnowledgeBaseError, MemoryError) as error:
        line.send((type(error).__name__, str(error) or ENDED))
    signal.setitimer(signal.ITIMER_REAL, 0.0)


class Book:
    """A world of individuals: the words of ROSA, a model, what was told, and what is inferred."""

    def __init__(self, base: str) -> None:
        self._base = base
        self._store = Store()
        self._words: list[str] = []

    def describe(self, words: str) -> None:
        quads = [*parse(words.encode(), format=RdfFormat.RDF_XML)]
        self._store.extend(quads)
        named = (one.subject.value for one in quads if isinstance(one.subject, NamedNode))
        self._words = sorted({one.removeprefix(ROSA) for one in named if one.startswith(ROSA)})

    def clear(self, context: str) -> None:
        self._store.clear_graph(self._iri(context))

    def write(self, context: str, given: Iterable[Individual]) -> None:
        """Add individuals to the "model", to what was "told", or to what is "inferred".

        One that has no kind is there already and has more values now.
        """
        self._store.extend([one for each in given for one in self._quads(each, self._iri(context))])

    def ask(self, query: str, timeout: float, deadline: float) -> Iterator[tuple[Answer, ...]]:
        """Answer a query, for which a time [s] was allowed, before a deadline of the monotonic clock [s].

        The answer to ASK is one row, those to CONSTRUCT and DESCRIBE are triples.
        """
        self._check(query)
        try:
            found = self._store.query(query, prefixes=_PREFIXES, use_default_graph_as_union=True)
            if isinstance(found, QueryBoolean):
                yield (bool(found),)
                return
            for count, row in enumerate(found):
                yield tuple(map(answer_of, row))
                if count >= _MOST_ROWS:
                    raise KnowledgeBaseError(f"the answer has more than {_MOST_ROWS} rows; ask for less, or add LIMIT")
                if time.monotonic() > deadline:
                    raise stopped(timeout)
        except (SyntaxError, OSError, ValueError) as error:
            raise _complaint(query, str(error)) from None

    def _check(self, query: str) -> None:
        """Refuse what only asks elsewhere or changes something, and words that ROSA does not have."""
        begin = _BEGIN.match(query)
        if begin is None or begin[1].upper() not in _VERBS:
            word = f"not with {begin[1]}" if begin and begin[1] else "after its prefixes; there is none"
            raise InvalidValue(f"a query begins with SELECT, or {', '.join(_VERBS[1:])}, {word}; it changes nothing")
        for found in _WORD.finditer(query):
            if found["other"]:
                raise InvalidValue("SERVICE is not supported; leave it out, nothing is asked of other places")
            if found["rosa"] and found["rosa"] not in self._words and not _OWN_PREFIX.search(query):
                raise UnknownName("word of ROSA", found["rosa"], self._words)

    def _quads(self, one: Individual, graph: NamedNode) -> Iterator[Quad]:
        for terms in described(one, self._base, _whole):
            yield Quad(self._iri(one.id), *terms, graph)

    def _iri(self, own: str) -> NamedNode:
        return NamedNode(f"{self._base}#{own}")


def _whole(text: str) -> str:
    """Write a text without halves of characters."""
    return text.encode("utf-8", "backslashreplace").decode()


def _complaint(query: str, message: str) -> InvalidValue:
    """Return what is wrong with a query, and where, without all that could have stood there."""
    place, said = _PLACE.match(message), _SENTENCE.search(" ".join(message.split()))
    if place is None:
        return InvalidValue(f"the query cannot be answered: {message}")
    line, column = int(place[1]), int(place[2])
    at = len(query) - len("\n".join(query.split("\n")[line - 1 :])) + column - 1
    read, rest = query[:at].strip()[-20:], query[at : at + 20]
    what = f"from {rest!r} on this is not understood" if rest else "the query ends too early, or this cannot stand here"
    return InvalidValue(f"line {line}, column {column} of the query, after {read!r}: {said[1] if said else what}")
