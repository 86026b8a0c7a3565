"""Parses TypeQL files into queries, statements and clauses, by the grammar in `typeql.lark`.

A `Word` is a piece of the text with its `line` and `column`; its `type` is its terminal in the grammar.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from functools import cache
from types import SimpleNamespace
from typing import Final, NamedTuple

from lark import Lark, Token
from lark.exceptions import UnexpectedCharacters, UnexpectedToken
from lark.lark import PostLex

from kb.files import ModelFileError, Place

Word = Token
Literal = bool | int | float | str | datetime

MAX_DEPTH: Final = 100
"""How deep brackets may nest; no model needs more."""

_ESCAPE: Final = re.compile(r"\\(u[0-9a-fA-F]{4}|[\s\S])")
_ESCAPED: Final = {"n": "\n", "t": "\t", "r": "\r", "0": "\0", "\\": "\\", '"': '"', "'": "'"}

_KEYWORDS: Final = "isa has define insert match"
_EXPECTED: Final = {
    "VARIABLE": "a variable such as `$x`",
    "LABEL": "a name",
    **dict.fromkeys(("STRING", "NUMBER", "DATETIME", "BOOLEAN"), "a value"),
    **{word.upper(): f"`{word}`" for word in _KEYWORDS.split()},
    **{"ANNOTATION": "`@key`", "COMMA": "`,`", "SEMICOLON": "`;`", "COLON": "`:`"},
    **{
        "OPEN": "`(`",
        "RPAR": "`)`",
        "BRACE": "`{`",
        "RBRACE": "`}`",
        "$END": "the end of the file",
    },
}
"""The words for terminals in messages, in the order in which these list them; other terminals are not listed."""


class Has(NamedTuple):
    """`has LABEL value`."""

    label: Word
    value: Literal


class Player(NamedTuple):
    """`role: $variable`, or a variable alone, whose role follows from its type."""

    role: Word | None
    variable: Word


class Statement(NamedTuple):
    """A statement about one variable, with its `$`, or about a relation without one; the word is its first variable."""

    word: Word
    variable: str | None
    isa: Word | None
    has: tuple[Has, ...]
    players: tuple[Player, ...]


class Insert(NamedTuple):
    """`insert ...` or `match ... insert ...`."""

    statements: tuple[Statement, ...]
    patterns: tuple[Statement, ...] = ()


def place_of(file: str, word: Word) -> Place:
    return Place(file, word.line or 1, word.column or 1)


def parse(text: str, file: str) -> list[Insert]:
    """Read the queries of a file.

    Raises:
        ModelFileError: the text is no TypeQL, or changes or reads a database instead of describing a robot.
    """
    try:
        return _parser().parse(text)  # type: ignore[return-value]  # made by the functions in _SHAPES
    except _Refused as refused:
        raise place_of(file, refused.word).error(str(refused)) from None
    except (UnexpectedToken, UnexpectedCharacters) as error:
        raise _error(text, file, error) from None


class _Refused(Exception):
    """A valid word of TypeQL that files of models may not use."""

    def __init__(self, word: Word, message: str) -> None:
        self.word = word
        super().__init__(message)


class _Refusal(PostLex):
    """Raises at the first word that files of models may not use, before the parser reads what follows."""

    always_accept = ()

    def process(self, stream: Iterator[Word]) -> Iterator[Word]:
        depth = 0
        for word in stream:
            if word.type == "REFUSED":
                does = (
                    "reads; a model file only states: ask `KnowledgeBase.query` instead, in SPARQL"
                )
                if word in ("delete", "update", "undefine"):
                    does = "changes what a database holds; a model file only states: change the `insert` that says it"
                raise _Refused(
                    word, f"`{word}` {does}. Expected `define`, `insert` or `match ... insert`"
                )
            depth += {"BRACE": 1, "OPEN": 1, "RBRACE": -1, "RPAR": -1}.get(word.type, 0)
            if depth > MAX_DEPTH:
                raise _Refused(
                    word, f"brackets are nested deeper than {MAX_DEPTH}; no model needs that"
                )
            yield word


def _statement(
    first: Word | tuple[Player, ...], *clauses: Word | Has | tuple[Player, ...]
) -> Statement:
    every = (first, *clauses)
    isa, *more = (*(one for one in every if isinstance(one, Word) and one.type == "LABEL"), None)
    if more and more[0] is not None:
        raise _Refused(more[0], f"a second type, `{more[0]}`; a thing has one")
    has = tuple(one for one in every if isinstance(one, Has))
    players = tuple(one for each in every if not isinstance(each, Word | Has) for one in each)
    word, variable = (first, str(first)) if isinstance(first, Word) else (first[0].variable, None)
    return Statement(word, variable, isa, has, players)


def _stated(statements: tuple[Statement, ...]) -> tuple[Statement, ...]:
    for value in (has.value for one in statements for has in one.has):
        if isinstance(
            value, Word
        ):  # only reading queries have such variables, and they are refused elsewhere
            raise _Refused(value, f"unexpected `{value}`; expected a value")
    return statements


def _value(word: Word) -> Literal:
    """Return the value of a literal; a date without a zone is in UTC."""
    text = str(word)
    if word.type == "ASKED":
        return word
    if word.type == "STRING":
        return _ESCAPE.sub(_unescaped, text[1:-1])
    if word.type == "BOOLEAN":
        return text == "true"
    try:
        if word.type == "DATETIME":
            moment = datetime.fromisoformat(text)
            return moment if moment.tzinfo else moment.replace(tzinfo=UTC)
        return int(text) if re.fullmatch(r"[+-]?\d+", text) else float(text)
    except ValueError as error:
        raise _Refused(word, f"`{text:.40}` is not a value: {error!s:.60}") from None


def _unescaped(found: re.Match[str]) -> str:
    what = found.group(1)
    return chr(int(what[1:], 16)) if len(what) > 1 else _ESCAPED.get(what, f"\\{what}")


_SHAPES: Final[Mapping[str, Callable[..., object]]] = {
    "start": lambda *queries: [query for query in queries if query is not None],
    "define": lambda *_: None,
    "insert": lambda *statements: Insert(_stated(statements)),
    "patterns": lambda *patterns: patterns,
    "match": lambda patterns, insert: Insert(insert.statements, _stated(patterns)),
    "statement": _statement,
    "isa": lambda label: label,
    "has": lambda label, value: Has(label, _value(value)),
    "players": lambda _, *players: players,
    "player": lambda *words: Player(
        words[-2] if len(words) > 1 and words[-2].type == "LABEL" else None, words[-1]
    ),
}
"""The function that makes the result of each rule of the grammar."""


@cache
def _parser() -> Lark:
    shapes = SimpleNamespace(
        **{rule: lambda parts, make=make: make(*parts) for rule, make in _SHAPES.items()}
    )
    how = {"parser": "lalr", "lexer": "contextual", "postlex": _Refusal(), "transformer": shapes}
    return Lark.open("typeql.lark", rel_to=__file__, **how)


def _error(text: str, file: str, error: UnexpectedToken | UnexpectedCharacters) -> ModelFileError:
    wanted = _wanted(error)
    if isinstance(error, UnexpectedToken) and error.token.type == "$END":
        if not text.strip():
            return ModelFileError(f"the file is empty; expected {wanted}", file, 1, 1)
        place = Place(file, text.count("\n") + 1, len(text) - text.rfind("\n"))
        return place.error(f"the file ends here; expected {wanted}")
    if isinstance(error, UnexpectedToken):
        given = f"`{error.token if len(error.token) <= 40 else f'{error.token[:37]}...'}`"
    else:
        character = text[error.pos_in_stream or 0]
        given = "text without a closing quote" if character in "'\"" else f"{character!r}"
    return ModelFileError(f"unexpected {given}; expected {wanted}", file, error.line, error.column)


def _wanted(error: UnexpectedToken | UnexpectedCharacters) -> str:
    accepted = (
        error.accepts or error.expected if isinstance(error, UnexpectedToken) else error.allowed
    )
    names = {name.lstrip("_") for name in accepted or ()}
    words = list(dict.fromkeys(word for name, word in _EXPECTED.items() if name in names))
    return " or ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
