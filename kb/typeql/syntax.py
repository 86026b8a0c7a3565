"""What stands in a TypeQL file, as written: queries, statements and their clauses, by the grammar in `grammar.lark`.

A `Word` is a piece of the text that knows its `line` and `column`, and as its `type` its terminal in the grammar.
"""

import re
from collections.abc import Iterator
from functools import lru_cache
from typing import Any, Final, NamedTuple

from lark import Lark, Transformer, v_args
from lark import Token as Word
from lark.exceptions import UnexpectedCharacters, UnexpectedToken
from lark.lark import PostLex

from kb.files import ModelFileError, Place

__all__ = [
    "Clause",
    "Comparison",
    "Define",
    "Has",
    "Insert",
    "Isa",
    "Match",
    "Player",
    "Players",
    "SLIPS",
    "Statement",
    "TypeClause",
    "Unsupported",
    "Word",
    "parse",
    "place_of",
]

MAX_DEPTH: Final = 100
"""How deep brackets may nest; what is deeper is no model, and would only fill the memory."""

SLIPS: Final = {"=<": "<=", "=>": ">=", "≤": "<=", "≥": ">="}
"""What is written for a comparison by mistake, and what is meant."""

_QUOTED: Final = re.compile(r"""#[^\r\n]*|"(?:[^"\\]|\\[\s\S])*"|'(?:[^'\\]|\\[\s\S])*'""")
"""A comment or a text."""

_EXPECTED: Final = {
    "VARIABLE": "a variable such as `$x`",
    "LABEL": "a name",
    **dict.fromkeys(("STRING", "NUMBER", "DATETIME", "BOOLEAN"), "a value"),
    **{
        word.upper(): f"`{word}`"
        for word in ("sub", "owns", "relates", "plays", "abstract", "value", "regex", "as", "isa", "has", "when")
    },
    **{word.upper(): f"`{word}`" for word in ("then", "rule", "define", "insert", "match")},
    **{"ANNOTATION": "`@key`", "COMMA": "`,`", "SEMICOLON": "`;`", "COLON": "`:`"},
    **{"OPEN": "`(`", "RPAR": "`)`", "BRACE": "`{`", "RBRACE": "`}`", "$END": "the end of the file"},
}
"""What each terminal is called in messages, in the order in which they are listed; others are not suggested."""


class Isa(NamedTuple):
    """`isa LABEL`, or `isa! LABEL` for that very type."""

    label: Word
    exact: bool


class Has(NamedTuple):
    """`has LABEL value`, `has LABEL $variable` or `has $variable`."""

    label: Word | None
    operator: Word | None
    value: Word


class Comparison(NamedTuple):
    """`$variable "value"` or `$variable > value`."""

    operator: Word | None
    value: Word


class Player(NamedTuple):
    """`role: $variable`, or a variable whose role is left to be found."""

    role: Word | None
    variable: Word


class Players(NamedTuple):
    """`(role: $variable, ...)`; the word is the bracket that opens it."""

    word: Word
    players: tuple[Player, ...]


class Unsupported(NamedTuple):
    """A pattern that is TypeQL but that no model of a robot needs."""

    word: Word


Clause = Isa | Has | Comparison | Players | Unsupported


class Statement(NamedTuple):
    """What is said of one variable, with its `$`, or of a relation without one; the word is where it begins."""

    word: Word
    variable: str | None
    clauses: tuple[Clause, ...]


class TypeClause(NamedTuple):
    """Of a type: `sub LABEL`, `owns LABEL` or `relates LABEL`, perhaps `as LABEL`."""

    keyword: str
    label: Word
    alias: Word | None


class Define(NamedTuple):
    """`define ...`: what is declared of each type."""

    definitions: tuple[tuple[Word, tuple[TypeClause, ...]], ...]


class Insert(NamedTuple):
    """`insert ...`."""

    statements: tuple[Statement, ...]


class Match(NamedTuple):
    """`match ... insert ...`."""

    patterns: tuple[Statement | Unsupported, ...]
    statements: tuple[Statement, ...]


def place_of(file: str, word: Word) -> Place:
    """Return where a word stands."""
    return Place(file, word.line or 1, word.column or 1)


def parse(text: str, file: str) -> list[Define | Insert | Match]:
    """Read the queries of a file.

    Raises:
        ModelFileError: the text is no TypeQL, or changes or reads a database instead of telling of a robot.
    """
    try:
        return _parser().parse(text)  # type: ignore[return-value]  # what the shapes below make of it
    except _Refused as refused:
        raise place_of(file, refused.word).error(str(refused)) from None
    except (UnexpectedToken, UnexpectedCharacters) as error:
        raise _error(text, file, error) from None


class _Refused(Exception):
    """Something that is understood, and is not for files of models."""

    def __init__(self, word: Word, message: str) -> None:
        self.word = word
        super().__init__(message)


class _Refusal(PostLex):
    """Stops at the first word that is not for files of models, before anything after it is looked at."""

    always_accept = ()

    def process(self, stream: Iterator[Word]) -> Iterator[Word]:
        depth = 0
        for word in stream:
            if word.type == "REFUSED":
                does = "reads; a model file only tells: ask `KnowledgeBase.query` instead, in SPARQL"
                if word in ("delete", "update", "undefine"):
                    does = "changes what a database holds; a model file only tells: change the `insert` that says it"
                raise _Refused(word, f"`{word}` {does}. Expected `define`, `insert` or `match ... insert`")
            depth += {"BRACE": 1, "OPEN": 1, "RBRACE": -1, "RPAR": -1}.get(word.type, 0)
            if depth > MAX_DEPTH:
                raise _Refused(word, f"brackets are nested deeper than {MAX_DEPTH}; no model needs that")
            yield word


@v_args(inline=True)
class _Shapes(Transformer[Word, Any]):
    """Makes the shapes above, rule by rule of the grammar."""

    def start(self, *queries: object) -> list[object]:
        return list(queries)

    def define(self, *parts: object) -> Define:
        return Define(tuple(part for part in parts if isinstance(part, tuple)))

    def type_definition(self, label: Word, *clauses: TypeClause | None) -> tuple[Word, tuple[TypeClause, ...]]:
        return label, tuple(clause for clause in clauses if clause)

    def sub(self, _: Word, label: Word) -> TypeClause:
        return TypeClause("sub", label, None)

    def owns(self, _: Word, label: Word, *rest: object) -> TypeClause:
        return TypeClause("owns", label, None)

    def relates(self, _: Word, label: Word, alias: Word | None = None) -> TypeClause:
        return TypeClause("relates", label, alias)

    def plain(self, *_: object) -> None:
        return None

    rule = plain

    def alias(self, label: Word) -> Word:
        return label

    def insert(self, *statements: Statement) -> Insert:
        return Insert(statements)

    def patterns(self, *patterns: Statement | Unsupported) -> tuple[Statement | Unsupported, ...]:
        return patterns

    def match(self, patterns: tuple[Statement | Unsupported, ...], insert: Insert) -> Match:
        return Match(patterns, insert.statements)

    def statement(self, first: Word | Players, *clauses: Clause) -> Statement:
        if isinstance(first, Players):
            return Statement(first.word, None, (first, *clauses))
        return Statement(first, str(first), clauses)

    def unsupported(self, word: Word, *_: object) -> Unsupported:
        return Unsupported(word)

    other = unsupported

    def isa(self, keyword: Word, label: Word) -> Isa:
        return Isa(label, keyword == "isa!")

    def has(self, _: Word, *words: Word) -> Has:
        if len(words) == 1:
            return Has(None, None, words[0])
        return Has(words[0], words[1] if len(words) == 3 else None, words[-1])

    def comparison(self, *words: Word) -> Comparison | Unsupported:
        if len(words) > 2:
            return Unsupported(words[2])
        return Comparison(words[0] if len(words) == 2 else None, words[-1])

    def players(self, word: Word, *players: Player) -> Players:
        return Players(word, players)

    def player(self, *words: Word) -> Player:
        role = words[-2] if len(words) > 1 and words[-2].type == "LABEL" else None
        return Player(role, words[-1])


@lru_cache(maxsize=1)
def _parser() -> Lark:
    return Lark.open(
        "grammar.lark", rel_to=__file__, parser="lalr", lexer="contextual", postlex=_Refusal(), transformer=_Shapes()
    )


def _error(text: str, file: str, error: UnexpectedToken | UnexpectedCharacters) -> ModelFileError:
    wanted = _wanted(error)
    if isinstance(error, UnexpectedToken) and error.token.type == "$END":
        if not text.strip():
            return ModelFileError(f"the file is empty; expected {wanted}", file, 1, 1)
        place = Place(file, text.count("\n") + 1, len(text) - text.rfind("\n"))
        return place.error(f"the file ends here; expected {wanted}")
    if slip := _slip(text, file, error):
        return slip
    if isinstance(error, UnexpectedToken):
        given = f"`{_short(str(error.token))}`"
    else:
        character = text[error.pos_in_stream or 0]
        given = "a text without a closing quote" if character in "'\"" else f"{character!r}"
    return ModelFileError(f"{given} stands here; expected {wanted}", file, error.line, error.column)


def _slip(text: str, file: str, error: UnexpectedToken | UnexpectedCharacters) -> ModelFileError | None:
    """Return what is likely meant: the mistake is found only after it."""
    at = error.pos_in_stream or 0
    sign = text[at - 1 : at + 1]
    if sign in SLIPS:
        message = f"`{sign}` stands here; did you mean `{SLIPS[sign]}`?"
        return ModelFileError(message, file, error.line, error.column - 1)
    for quoted in _QUOTED.finditer(text, 0, at):
        if "\n" in quoted[0] and quoted[0][0] in "'\"" and not text[quoted.end() : at].strip():
            start = quoted.start()
            place = Place(file, text.count("\n", 0, start) + 1, start - text.rfind("\n", 0, start))
            return place.error(f"a text begins here and ends only in line {error.line}; is a quote missing?")
    return None


def _wanted(error: UnexpectedToken | UnexpectedCharacters) -> str:
    accepted = error.accepts or error.expected if isinstance(error, UnexpectedToken) else error.allowed
    names = {name.lstrip("_") for name in accepted or ()}
    words = list(dict.fromkeys(word for name, word in _EXPECTED.items() if name in names))
    return " or ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _short(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:37]}..."
