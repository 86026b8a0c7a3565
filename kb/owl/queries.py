"""Queries in SPARQL, as they are written: what is wrong with one is said before, or after, owlready2 has tried it.

It is owlready2 that answers. What it does not know is refused here, with what to write instead; and texts with quotes
or backslashes, which it would not take at their word, are handed over beside the query.
"""

import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise, takewhile
from typing import Final, NamedTuple

from kb.exceptions import InvalidValue, KnowledgeBaseError, UnknownName
from kb.owl.rdfxml import ROSA

_TOKEN: Final = re.compile(
    r"""(?P<space>\s+)
    | (?P<comment>\#[^\n\r]*)
    | (?P<iri><[^<>\s]+>)
    | (?P<text>'''(?:[^'\\]|\\.|'(?!''))*'''|\"""(?:[^"\\]|\\.|"(?!""))*\""")
    | (?P<line>'(?:[^'\\\n\r]|\\.)*'|"(?:[^"\\\n\r]|\\.)*")
    | (?P<variable>[?$]\w+)
    | (?P<name>[\w.-]*:[\w.:%\\-]*)
    | (?P<word>\w+)
    | (?P<mark>.)""",
    re.VERBOSE | re.DOTALL,
)
_ESCAPE: Final = re.compile(r"\\(u[0-9A-Fa-f]{4}|U[0-9A-Fa-f]{8}|.)", re.DOTALL)
_ESCAPED: Final[Mapping[str, str]] = dict(zip("tbnrf\"'\\", "\t\b\n\r\f\"'\\", strict=True))
_UNFIT: Final = re.compile(r"""["'\\\n\r\x00\ud800-\udfff]""")

_INSTEAD: Final[Mapping[str, str]] = {
    "ASK": "SELECT ... LIMIT 1 has a row if the answer is yes",
    "CONSTRUCT": "SELECT what each triple is made of",
    "DESCRIBE": "SELECT ?p ?o { <the IRI> ?p ?o }",
    "MINUS": "write FILTER NOT EXISTS { ... }",
    "FROM": "leave it out, there is one data set",
    "SERVICE": "leave it out, nothing is asked of other places",
}
"""What is SPARQL but not supported, and what to do."""

_ADVICE: Final[Mapping[str, str]] = {
    "aggregate": "an aggregate stands in SELECT or HAVING of a query with GROUP BY, and in no other aggregate",
    "RecursionError": "a variable is defined by itself; give what follows AS another name",
    "Property path": "a path in brackets is not repeated; repeat single properties, e.g. ?x :requires+ ?y",
    "JOIN clause": "OPTIONAL comes after a pattern that is not",
    "both objs and datas": "UNDEF is not supported in VALUES; write a UNION",
    "number of arguments|IndexError": "a function has too few or too many arguments, or VALUES nothing to choose from",
    "no such column: inf|invalid literal|Cannot read literal": "a number or another literal in it cannot be read",
}
"""What to do, by what the error says."""

_LATEST: Final = "the latest of several is the one with FILTER NOT EXISTS { a later one }"

_QUOTED: Final[Mapping[str, int]] = {"text": 3, "line": 1}  # how many marks are before and after a text
_AGGREGATES: Final = frozenset({"AVG", "COUNT", "GROUP_CONCAT", "MAX", "MIN", "SAMPLE", "SUM"})

_AFTER_GROUPS: Final = frozenset({"HAVING", "ORDER", "LIMIT", "OFFSET"})

_VERBS: Final = frozenset({"SELECT", "ASK", "CONSTRUCT", "DESCRIBE"})


Answer = str | bool | int | float | None


class Question(NamedTuple):
    """A query that can be tried.

    Attributes:
        given: as it was written.
        text: as owlready2 takes it.
        texts: what its parameters stand for, in order.
        places: where each part is in `text`, and where it was.
    """

    given: str
    text: str
    texts: tuple[str, ...]
    places: Sequence[tuple[int, int]]

    def origin(self, offset: int) -> int:
        new, old = self.places[bisect_right(self.places, (offset, len(self.given))) - 1]
        return min(old + offset - new, len(self.given))


class _Token(NamedTuple):
    kind: str
    text: str
    offset: int


def read_question(given: str) -> Question:
    """Read a query, as far as to know that it only asks and that all of it is supported."""
    if not isinstance(given, str):
        raise InvalidValue(f"a query is a text in SPARQL, not {given!r}")
    tokens = [_Token(found.lastgroup or "", found[0], found.start()) for found in _TOKEN.finditer(given)]
    told = [one for one in tokens if one.kind not in ("space", "comment")]
    _only_asks(given, told)
    _is_supported(given, told)
    _filters_what_is_there(given, told)
    _selects_what_is_there(given, told)
    head = f"PREFIX : <{ROSA}>\nPREFIX rosa: <{ROSA}>\n"
    texts: list[str] = []
    parts, places, length = [head], [(0, 0)], len(head)
    for token in tokens:
        if token.kind == "comment":  # owlready2 knows none, and the line ends all the same
            continue
        places.append((length, token.offset))
        parts.append(_handed_over(given, token, texts) if token.kind in _QUOTED else token.text)
        length += len(parts[-1])
    return Question(given, "".join(parts), tuple(texts), (*places, (length, len(given))))


def complaint(error: Exception, question: Question, vocabulary: Iterable[str]) -> KnowledgeBaseError:
    told = str(error.args[0]) if error.args else ""
    quoted = re.search(r"'(?:VAR:')?([^']*)'", told)
    named = quoted[1] if quoted else ""
    if told.startswith("No existing entity"):
        if named.startswith(ROSA):
            return UnknownName("word of ROSA", named.removeprefix(ROSA), vocabulary)
        return InvalidValue(f"nothing is called <{named}>")
    if told.startswith("Undefined prefix"):
        return InvalidValue(f"the prefix {named} is not declared; begin with PREFIX {named} <...>, or use : for ROSA")
    if told.startswith("Cannot select"):
        return InvalidValue(
            f"nothing in the braces says what {named} is; where it is an end of a path with +, * or ?, say first "
            "what one of them is, e.g. ?x a :Action ."
        )
    if "user-defined function" in told:
        return InvalidValue("a function in the query fails; see whether the pattern of its REGEX or REPLACE is right")
    if "no such column" in told and re.search(r"\bEXISTS\b", question.given, re.IGNORECASE):
        return InvalidValue("the query cannot be answered; write FILTER NOT EXISTS after the patterns that it filters")
    offset = error.args[1] if len(error.args) > 1 else None
    if isinstance(offset, int):
        origin = question.origin(offset)
        return _wrong(question.given, origin, f"this is not understood, from {question.given[origin:][:20]!r} on")
    if "$end" in told:
        return _wrong(question.given, len(question.given), "the query ends too early")
    words = f"{type(error).__name__} {told}"
    for sign, advice in _ADVICE.items():
        if re.search(sign, words):
            return InvalidValue(f"the query cannot be answered: {advice}")
    said = words.splitlines()[0]
    return InvalidValue(f"the query cannot be answered, as something in it is no SPARQL or not supported ({said})")


def stopped(timeout: float) -> KnowledgeBaseError:
    return KnowledgeBaseError(f"the query was stopped after {timeout:g} s; ask for less, or allow it a longer timeout")


def _only_asks(given: str, told: Iterable[_Token]) -> None:
    words = iter(told)
    for token in words:
        if token.text.upper() in _VERBS:
            return
        if token.text.upper() not in ("PREFIX", "BASE"):
            message = f"a query begins with SELECT, not with {token.text}; queries change nothing"
            raise _wrong(given, token.offset, message)
        next((inner for inner in words if inner.kind == "iri"), None)
    raise InvalidValue("a query begins with SELECT, after its prefixes; there is none")


def _is_supported(given: str, told: Sequence[_Token]) -> None:
    depth = 0
    for number, token in enumerate(told):
        word = token.text.upper() if token.kind == "word" else ""
        if word in _INSTEAD:
            raise _wrong(given, token.offset, f"{word} is not supported; {_INSTEAD[word]}")
        if word == "VALUES" and not depth:
            raise _wrong(given, token.offset, "VALUES after the pattern is not supported; write it inside the braces")
        if word == "SELECT" and depth:
            raise _wrong(given, token.offset, f"a SELECT within another is not supported; {_LATEST}")
        if word == "EXISTS":
            before = [one.text.upper() for one in told[max(0, number - 2) : number]]
            if before[-1:] != ["FILTER"] and before != ["FILTER", "NOT"]:
                raise _wrong(given, token.offset, "EXISTS in an expression is not supported; give it its own FILTER")
        if given.startswith("??", token.offset):
            raise _wrong(given, token.offset, "a variable is ? and a name")
        depth += (token.text == "{") - (token.text == "}")


def _filters_what_is_there(given: str, told: Sequence[_Token]) -> None:
    """Refuse a filter over what is nowhere else: it would let through anything."""
    inside: list[_Token] = []
    outside: set[str] = set()
    depth = 0
    for before, token in zip((_Token("", "", 0), *told), told, strict=False):
        if token.text == "(" and (depth or before.text.upper() == "FILTER"):
            depth += 1
        elif token.text == ")" and depth:
            depth -= 1
        elif token.kind == "variable" and depth:
            inside.append(token)
        elif token.kind == "variable":
            outside.add(token.text[1:])
    for token in inside:
        if token.text[1:] not in outside:
            raise _wrong(given, token.offset, f"{token.text} is nowhere but in this FILTER")


def _selects_what_is_there(given: str, told: Sequence[_Token]) -> None:
    """Refuse what owlready2 would answer with any value: variables from nowhere, and those beside an aggregate."""
    opens = next((number for number, one in enumerate(told) if one.text == "{"), len(told))
    closes = max((number for number, one in enumerate(told) if one.text == "}"), default=len(told))
    if opens == len(told):
        return
    head, tail = told[:opens], told[closes + 1 :]
    outside = [one for one in (*head, *tail) if one.kind == "variable"]
    named = {one.text[1:] for before, one in pairwise((*head, *tail)) if before.text.upper() == "AS"}
    known = named | {one.text[1:] for one in told[opens:closes] if one.kind == "variable"}
    for token in outside:
        if token.text[1:] not in known:
            raise _wrong(given, token.offset, f"nothing in the braces says what {token.text} is")
    groups = _grouped(tail)
    if groups is None and not any(one.kind == "word" and one.text.upper() in _AGGREGATES for one in head):
        return
    depth = 0
    for token in head:
        depth += (token.text == "(") - (token.text == ")")
        if token.kind == "variable" and not depth and token.text[1:] not in (groups or ()):
            add = f"add GROUP BY {token.text}" if groups is None else f"add {token.text} to GROUP BY"
            raise _wrong(given, token.offset, f"{token.text} may have many values beside an aggregate; {add}")


def _grouped(tail: Sequence[_Token]) -> set[str] | None:
    """Return the variables of GROUP BY; None where it is not written."""
    begin = next((number for number, one in enumerate(tail) if one.text.upper() == "GROUP"), None)
    if begin is None:
        return None
    ours = takewhile(lambda one: one.text.upper() not in _AFTER_GROUPS, tail[begin:])
    return {one.text[1:] for one in ours if one.kind == "variable"}


def _handed_over(given: str, token: _Token, texts: list[str]) -> str:
    size = _QUOTED[token.kind]

    def plain(found: re.Match[str]) -> str:
        sign = found[1]
        if sign[0] in "uU" and len(sign) > 1:
            return chr(int(sign[1:], 16))
        if sign not in _ESCAPED:
            raise _wrong(given, token.offset, f"\\{sign} means nothing in a text; a backslash is written \\\\")
        return _ESCAPED[sign]

    text = _ESCAPE.sub(plain, token.text[size:-size])
    if not _UNFIT.search(text):
        return f'"{text}"'
    texts.append(text)
    return f"??{len(texts)}"


def _matches(text: object, pattern: str, flags: str = "") -> bool | None:
    return bool(_pattern(pattern, flags).search(text)) if isinstance(text, str) else None


def _replaced(text: object, pattern: str, replacement: str, flags: str = "") -> str | None:
    groups = re.sub(r"\$(\d)", r"\\g<\1>", replacement.replace("\\", r"\\"))
    return _pattern(pattern, flags).sub(groups, text) if isinstance(text, str) else None


def _pattern(pattern: str, flags: str) -> re.Pattern[str]:
    return re.compile(f"(?{flags})(?:{pattern})" if flags else pattern)


FUNCTIONS: Final[Mapping[str, Callable[..., str | bool | None]]] = {"regex": _matches, "sparql_replace": _replaced}
"""Those of owlready2 want flags that SPARQL lets one leave out."""


def _wrong(given: str, offset: int, message: str) -> InvalidValue:
    before = given[:offset]
    line, column = before.count("\n") + 1, offset - before.rfind("\n")
    return InvalidValue(f"line {line}, column {column} of the query: {message}")
