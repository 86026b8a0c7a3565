"""From the text of a TypeQL file to what stands there, by the grammar in `grammar.lark`, and on to a model."""

import re
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, NoReturn

from lark import Lark, Token, Transformer, v_args
from lark.exceptions import UnexpectedCharacters, UnexpectedToken
from lark.lark import PostLex

from kb.files import ModelFileError, Place, read_text
from kb.typeql.building import ModelT, build
from kb.typeql.schema import Schema
from kb.typeql.store import Store
from kb.typeql.syntax import (
    Clause,
    Comparison,
    Define,
    Has,
    Insert,
    Isa,
    Match,
    Player,
    Players,
    Query,
    Statement,
    TypeClause,
    TypeDefinition,
    Unsupported,
)
from kb.typeql.words import SLIPS

__all__ = ["load_typeql", "parse"]

MAX_DEPTH: Final = 100
"""How deep brackets may nest; what is deeper is no model, and would only fill the memory."""

_QUOTED: Final = re.compile(r"""#[^\r\n]*|"(?:[^"\\]|\\[\s\S])*"|'(?:[^'\\]|\\[\s\S])*'""")
"""A comment or a text."""

_CHANGING: Final = frozenset({"delete", "update", "undefine"})
_EXPECTED: Final = {
    "VARIABLE": "a variable such as `$x`",
    "LABEL": "a name",
    "STRING": "a value",
    "NUMBER": "a value",
    "DATETIME": "a value",
    "BOOLEAN": "a value",
    "SUB": "`sub`",
    "OWNS": "`owns`",
    "RELATES": "`relates`",
    "PLAYS": "`plays`",
    "ABSTRACT": "`abstract`",
    "VALUE": "`value`",
    "REGEX": "`regex`",
    "ANNOTATION": "`@key`",
    "AS": "`as`",
    "ISA": "`isa`",
    "HAS": "`has`",
    "WHEN": "`when`",
    "THEN": "`then`",
    "RULE": "`rule`",
    "DEFINE": "`define`",
    "INSERT": "`insert`",
    "MATCH": "`match`",
    "COMMA": "`,`",
    "SEMICOLON": "`;`",
    "COLON": "`:`",
    "OPEN": "`(`",
    "RPAR": "`)`",
    "BRACE": "`{`",
    "RBRACE": "`}`",
    "$END": "the end of the file",
}
"""What each terminal is called in messages; one that is missing here is not suggested."""


def load_typeql(cls: Callable[[str], ModelT], files: Sequence[Path], name: str | None) -> ModelT:
    """Read a model from files, each of which may add to those before it."""
    parsed = [(str(file), parse(read_text(file), str(file))) for file in files]
    schema = Schema()
    for file, queries in parsed:
        for query in queries:
            if isinstance(query, Define):
                schema.define(query, file)
    schema.link()
    store = Store(schema)
    for file, queries in parsed:
        for query in queries:
            if isinstance(query, Insert | Match):
                store.tell(query, file)
    return build(cls, store, name, files[0].stem)


def parse(text: str, file: str) -> list[Query]:
    """Read the queries of a file.

    Raises:
        ModelFileError: the text is no TypeQL, or changes or reads a database instead of telling of a robot.
    """
    try:
        return _parser().parse(text)  # type: ignore[return-value]  # what the shapes below make of it
    except _Refused as refused:
        word = refused.word
        raise Place(file, word.line or 1, word.column or 1).error(refused.message) from None
    except UnexpectedToken as error:
        if error.token.type == "$END":
            raise _ended(text, file, _wanted(error)) from None
        raise _slip(text, file, error) or _unexpected(file, error, f"`{_short(str(error.token))}`") from None
    except UnexpectedCharacters as error:
        if likely := _slip(text, file, error):
            raise likely from None
        character = text[error.pos_in_stream or 0]
        given = "a text without a closing quote" if character in "'\"" else f"{_short(character)!r}"
        raise _unexpected(file, error, given) from None


class _Refused(Exception):
    """Something that is understood, and is not for files of models."""

    def __init__(self, word: Token, message: str) -> None:
        self.word, self.message = word, message
        super().__init__(message)


class _Refusal(PostLex):
    """Stops at the first word that is not for files of models, before anything after it is looked at."""

    always_accept = ()

    def process(self, stream: Iterator[Token]) -> Iterator[Token]:
        depth = 0
        for word in stream:
            if word.type == "REFUSED":
                _refuse(word)
            elif word.type in ("BRACE", "OPEN"):
                depth += 1
                if depth > MAX_DEPTH:
                    raise _Refused(word, f"brackets are nested deeper than {MAX_DEPTH}; no model needs that")
            elif word.type in ("RBRACE", "RPAR"):
                depth -= 1
            yield word


def _refuse(word: Token) -> NoReturn:
    if word in _CHANGING:
        what = f"`{word}` changes what a database holds; a model file only tells: change the `insert` that says it"
    else:
        what = f"`{word}` reads; a model file only tells: ask `KnowledgeBase.query` instead, in SPARQL"
    raise _Refused(word, f"{what}. Expected `define`, `insert` or `match ... insert`")


@v_args(inline=True)
class _Shapes(Transformer[Token, Any]):
    """Makes what `typeql_syntax` names, rule by rule of the grammar."""

    def start(self, *queries: Query) -> list[Query]:
        return list(queries)

    def define(self, *parts: object) -> Define:
        return Define(tuple(part for part in parts if isinstance(part, TypeDefinition)))

    def type_definition(self, label: Token, *clauses: TypeClause | None) -> TypeDefinition:
        return TypeDefinition(label, tuple(clause for clause in clauses if clause))

    def sub(self, _: Token, label: Token) -> TypeClause:
        return TypeClause("sub", label, None)

    def owns(self, _: Token, label: Token, *rest: object) -> TypeClause:
        return TypeClause("owns", label, None)

    def relates(self, _: Token, label: Token, alias: Token | None = None) -> TypeClause:
        return TypeClause("relates", label, alias)

    def plain(self, *_: object) -> None:
        return None

    def alias(self, label: Token) -> Token:
        return label

    def rule(self, *_: object) -> None:
        return None

    def insert(self, *statements: Statement) -> Insert:
        return Insert(statements)

    def patterns(self, *patterns: Statement | Unsupported) -> tuple[Statement | Unsupported, ...]:
        return patterns

    def match(self, patterns: tuple[Statement | Unsupported, ...], insert: Insert) -> Match:
        return Match(patterns, insert.statements)

    def statement(self, first: Token | Players, *clauses: Clause) -> Statement:
        if isinstance(first, Token):
            return Statement(first, str(first), clauses)
        return Statement(first.word, None, (first, *clauses))

    def unsupported(self, word: Token, *_: object) -> Unsupported:
        return Unsupported(word)

    def isa(self, keyword: Token, label: Token) -> Isa:
        return Isa(label, keyword == "isa!")

    def has(self, _: Token, *words: Token) -> Has:
        if len(words) == 1:
            return Has(None, None, words[0])
        return Has(words[0], words[1] if len(words) == 3 else None, words[-1])

    def comparison(self, *words: Token) -> Comparison | Unsupported:
        if len(words) > 2:
            return Unsupported(words[2])
        return Comparison(words[0] if len(words) == 2 else None, words[-1])

    def other(self, word: Token, *_: object) -> Unsupported:
        return Unsupported(word)

    def players(self, word: Token, *players: Player) -> Players:
        return Players(word, players)

    def player(self, *words: Token) -> Player:
        role = words[-2] if len(words) > 1 and words[-2].type == "LABEL" else None
        return Player(role, words[-1])


@lru_cache(maxsize=1)
def _parser() -> Lark:
    return Lark.open(
        "grammar.lark", rel_to=__file__, parser="lalr", lexer="contextual", postlex=_Refusal(), transformer=_Shapes()
    )


def _unexpected(file: str, error: UnexpectedToken | UnexpectedCharacters, given: str) -> ModelFileError:
    wanted = _wanted(error)
    return ModelFileError(f"{given} stands here; expected {wanted}", file, error.line, error.column)


def _slip(text: str, file: str, error: UnexpectedToken | UnexpectedCharacters) -> ModelFileError | None:
    """Return what is likely meant: the mistake is found only after it."""
    at = error.pos_in_stream or 0
    sign = text[at - 1 : at + 1]
    if sign in SLIPS:
        return ModelFileError(
            f"`{sign}` stands here; did you mean `{SLIPS[sign]}`?", file, error.line, error.column - 1
        )
    for quoted in _QUOTED.finditer(text, 0, at):
        if "\n" in quoted[0] and quoted[0][0] in "'\"" and not text[quoted.end() : at].strip():
            line = text.count("\n", 0, quoted.start()) + 1
            column = quoted.start() - text.rfind("\n", 0, quoted.start())
            return ModelFileError(
                f"a text begins here and ends only in line {error.line}; is a quote missing?", file, line, column
            )
    return None


def _ended(text: str, file: str, wanted: str) -> ModelFileError:
    if not text.strip():
        return ModelFileError(f"the file is empty; expected {wanted}", file, 1, 1)
    line = text.count("\n") + 1
    column = len(text) - text.rfind("\n")
    return ModelFileError(f"the file ends here; expected {wanted}", file, line, column)


def _wanted(error: UnexpectedToken | UnexpectedCharacters) -> str:
    accepted = error.accepts or error.expected if isinstance(error, UnexpectedToken) else error.allowed
    names = {name.lstrip("_") for name in accepted or ()}
    words = list(dict.fromkeys(word for name, word in _EXPECTED.items() if name in names))
    return " or ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _short(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:37]}..."
