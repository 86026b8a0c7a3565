"""What stands in a TypeQL file, as written: queries, statements and their clauses; no meaning yet.

A `Word` is a piece of the text that knows its `line` and `column`, and as its `type` its terminal in the grammar.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

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
    "Query",
    "Statement",
    "TypeClause",
    "TypeDefinition",
    "Unsupported",
    "Word",
]


if TYPE_CHECKING:
    from lark import Token as Word
else:
    Word = str  # what a token is too; lark is not imported for the sake of annotations


@dataclass(frozen=True, slots=True)
class Isa:
    """`isa LABEL`, or `isa! LABEL` for that very type."""

    label: Word
    exact: bool


@dataclass(frozen=True, slots=True)
class Has:
    """`has LABEL value`, `has LABEL $variable` or `has $variable`."""

    label: Word | None
    operator: Word | None
    value: Word


@dataclass(frozen=True, slots=True)
class Comparison:
    """`$variable "value"` or `$variable > value`."""

    operator: Word | None
    value: Word


@dataclass(frozen=True, slots=True)
class Player:
    """`role: $variable`, or a variable whose role is left to be found."""

    role: Word | None
    variable: Word


@dataclass(frozen=True, slots=True)
class Players:
    """`(role: $variable, ...)`; the word is the bracket that opens it."""

    word: Word
    players: tuple[Player, ...]


@dataclass(frozen=True, slots=True)
class Unsupported:
    """A pattern that is TypeQL but that no model of a robot needs."""

    word: Word


Clause = Isa | Has | Comparison | Players | Unsupported


@dataclass(frozen=True, slots=True)
class Statement:
    """What is said of one variable, or of a relation without one.

    Attributes:
        word: where it begins.
        variable: its name with the `$`, None for a relation without one.
        clauses: in order.
    """

    word: Word
    variable: str | None
    clauses: tuple[Clause, ...]


@dataclass(frozen=True, slots=True)
class TypeClause:
    """`sub LABEL`, `owns LABEL` or `relates LABEL`, perhaps `as LABEL`."""

    keyword: str
    label: Word
    alias: Word | None


@dataclass(frozen=True, slots=True)
class TypeDefinition:
    """What a file declares of a type."""

    label: Word
    clauses: tuple[TypeClause, ...]


@dataclass(frozen=True, slots=True)
class Define:
    """`define ...`."""

    definitions: tuple[TypeDefinition, ...]


@dataclass(frozen=True, slots=True)
class Insert:
    """`insert ...`."""

    statements: tuple[Statement, ...]


@dataclass(frozen=True, slots=True)
class Match:
    """`match ... insert ...`."""

    patterns: tuple[Statement | Unsupported, ...]
    statements: tuple[Statement, ...]


Query = Define | Insert | Match
