"""What `match` finds among the things told so far: every way in which all of its patterns hold together."""

import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Final, TypeVar

from kb.exceptions import UnknownName
from kb.files import ModelFileError, Place
from kb.typeql.schema import Type, place_of
from kb.typeql.store import ANONYMOUS, Bindings, Part, Store, Thing
from kb.typeql.syntax import Comparison, Has, Isa, Players, Statement, Unsupported, Word
from kb.typeql.values import Literal, literal
from kb.typeql.words import Kind

__all__ = ["answers"]

T = TypeVar("T")

MOST: Final = 100_000
"""How many answers a `match` may have on the way; more are a slip, and would multiply without limit."""

_COMPARE: Final[Mapping[str, Callable[[Literal, Literal], bool]]] = {
    "=": operator.eq,
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
_EQUAL: Final = ("=", "==")


@dataclass(frozen=True, slots=True)
class _Wanted:
    """An attribute that a thing must have: a value, or a variable that stands for one."""

    label: str | None
    operator: str
    value: Literal | None
    variable: str | None


@dataclass(slots=True)
class _Node:
    """All that is asked of one thing.

    Attributes:
        variable: what it is bound to; None for one without a name.
        place: where it is first asked for.
        types: each with whether it must be that very type.
        attributes: what it must have.
        players: role, if it is given, and variable of what it must relate.
    """

    variable: str | None
    place: Place
    types: list[tuple[Type, bool]] = field(default_factory=list)
    attributes: list[_Wanted] = field(default_factory=list)
    players: list[tuple[Word | None, str, Place]] = field(default_factory=list)

    @property
    def kind(self) -> Kind | None:
        """What it must be to us, if that is said."""
        return next((one.kind for one, _ in self.types if one.kind), None)


def answers(store: Store, patterns: Sequence[Statement | Unsupported], file: str) -> list[Bindings]:
    """Return what the variables can stand for; at least one answer.

    Raises:
        ModelFileError: nothing matches; the message says what was looked for and what there is.
    """
    question = _Question(store, file)
    for pattern in patterns:
        question.ask(pattern)
    return question.answers()


class _Question:
    """The patterns of one `match`, by what they ask of each thing."""

    def __init__(self, store: Store, file: str) -> None:
        self.store, self.file = store, file
        self.nodes: list[_Node] = []
        self.named: dict[str, _Node] = {}
        self.known: dict[str, Thing | Literal] = {}
        self.comparisons: list[tuple[str, Comparison]] = []

    def ask(self, pattern: Statement | Unsupported) -> None:
        """Add a pattern."""
        if isinstance(pattern, Unsupported):
            raise self._unsupported(pattern.word)
        compared = [clause for clause in pattern.clauses if isinstance(clause, Comparison)]
        if compared and pattern.variable:
            for comparison in compared:
                self._compare(pattern.variable, comparison)
            return
        node = self._node(pattern)
        for clause in pattern.clauses:
            if isinstance(clause, Isa):
                place = place_of(self.file, clause.label)
                node.types.append((self.store.schema.type(clause.label, place), clause.exact))
            elif isinstance(clause, Has):
                node.attributes.append(self._wanted(clause))
            elif isinstance(clause, Players):
                for player in clause.players:
                    place = place_of(self.file, player.role or player.variable)
                    node.players.append((player.role, str(player.variable), place))
            elif isinstance(clause, Unsupported):
                raise self._unsupported(clause.word)

    def answers(self) -> list[Bindings]:
        """Return what the variables can stand for, the most telling patterns first."""
        found: list[dict[str, Thing | Literal]] = [dict(self.known)]
        rest = list(self.nodes)
        while rest:
            node = min(rest, key=lambda one: self._effort(one, found[0]))
            rest.remove(node)
            every = (more for bindings in found for more in self._extended(bindings, node))
            found = self._bounded(every, node.place)
            if not found:
                raise self._nothing(node)
        kept = [bindings for bindings in found if self._holds(bindings)]
        if not kept:
            raise place_of(self.file, self.comparisons[0][1].value).error("nothing told so far compares like this")
        return list(
            {tuple((name, _identity(one)) for name, one in bindings.items()): bindings for bindings in kept}.values()
        )

    def _node(self, pattern: Statement) -> _Node:
        name = pattern.variable if pattern.variable != ANONYMOUS else None
        if name not in self.named:
            self.nodes.append(_Node(name, place_of(self.file, pattern.word)))
            if name is None:
                return self.nodes[-1]
            self.named[name] = self.nodes[-1]
        return self.named[name or ""]

    def _compare(self, name: str, clause: Comparison) -> None:
        sign = str(clause.operator or "==")
        if sign not in _COMPARE:
            raise self._unsupported(clause.operator or clause.value)
        if sign in _EQUAL and clause.value.type != "VARIABLE":
            self.known[name] = literal(clause.value, place_of(self.file, clause.value))
        else:
            self.comparisons.append((name, clause))

    def _wanted(self, clause: Has) -> _Wanted:
        sign = str(clause.operator or "==")
        if sign not in _COMPARE:
            raise self._unsupported(clause.operator or clause.value)
        label = str(clause.label) if clause.label else None
        if clause.value.type == "VARIABLE":
            return _Wanted(label, sign, None, str(clause.value))
        return _Wanted(label, sign, literal(clause.value, place_of(self.file, clause.value)), None)

    def _effort(self, node: _Node, bindings: Bindings) -> int:
        if node.variable in bindings or self._name(node, bindings) is not None:
            return 0
        size = len(self.store.things.get(node.kind, ()))
        return size if any(name in bindings for _, name, _ in node.players) else 1 + 2 * size

    def _name(self, node: _Node, bindings: Bindings) -> str | None:
        """Return the name that the thing must have, if that is known."""
        if node.kind is None:
            return None
        for wanted in node.attributes:
            found = self.store.schema.field(node.kind, wanted.label) if wanted.label else None
            if found and found.name == "name" and wanted.operator in _EQUAL:
                value = bindings.get(wanted.variable) if wanted.variable else wanted.value
                if isinstance(value, str):
                    return value
        return None

    def _candidates(self, node: _Node, bindings: Bindings) -> Sequence[Thing]:
        if node.variable in bindings:
            one = bindings[node.variable or ""]
            return [one] if isinstance(one, Thing) else []
        name = self._name(node, bindings)
        if name is not None and node.kind is not None:
            named = self.store.named[node.kind].get(name)
            return [named] if named else []
        if node.types:
            return self.store.things.get(node.kind, ())
        return [thing for things in self.store.things.values() for thing in things]

    def _extended(self, bindings: dict[str, Thing | Literal], node: _Node) -> Iterator[dict[str, Thing | Literal]]:
        for thing in self._candidates(node, bindings):
            if all(
                thing.type is wanted or (not exact and wanted in thing.type.lineage()) for wanted, exact in node.types
            ):
                found = [{**bindings, node.variable: thing} if node.variable else bindings]
                for wanted in node.attributes:
                    found = [more for one in found for more in self._having(one, thing, wanted, node)]
                yield from self._relating(found, thing, node) if node.players else found

    def _having(
        self, bindings: dict[str, Thing | Literal], thing: Thing, wanted: _Wanted, node: _Node
    ) -> Iterator[dict[str, Thing | Literal]]:
        meant = self.store.schema.field(node.kind, wanted.label) if node.kind and wanted.label else None
        value = bindings.get(wanted.variable) if wanted.variable else wanted.value
        for own in thing.owns:
            if wanted.label not in (None, own.label) and (meant is None or own.field is not meant):
                continue
            if value is None and wanted.variable and wanted.operator in _EQUAL:
                yield {**bindings, wanted.variable: own.value}
            elif value is not None and not isinstance(value, Thing) and _compared(own.value, wanted.operator, value):
                yield bindings

    def _relating(
        self, found: Sequence[dict[str, Thing | Literal]], thing: Thing, node: _Node
    ) -> list[dict[str, Thing | Literal]]:
        """Let each pattern of a player stand for another part of the relation."""
        states: list[tuple[dict[str, Thing | Literal], frozenset[int]]] = [(one, frozenset()) for one in found]
        for role, name, place in node.players:
            every = (
                ({**bindings, name: part.thing} if name != ANONYMOUS else bindings, used | {number})
                for bindings, used in states
                for number, part in enumerate(thing.parts)
                if number not in used
                and bindings.get(name, part.thing) is part.thing
                and self._plays(thing, role, part, place)
            )
            states = self._bounded(every, place)
        return [bindings for bindings, _ in states]

    def _bounded(self, every: Iterator[T], place: Place) -> list[T]:
        found = list(islice(every, MOST + 1))
        if len(found) > MOST:
            raise place.error(f"`match` finds more than {MOST} answers; say which things are meant, by their names")
        return found

    def _plays(self, relation: Thing, role: Word | None, part: Part, place: Place) -> bool:
        if role is None or relation.kind is None:
            return True
        return part.role in self.store.schema.roles(relation.type, relation.kind, role, place)

    def _holds(self, bindings: Bindings) -> bool:
        for name, clause in self.comparisons:
            other = self._operand(bindings, clause.value)
            this = bindings.get(name)
            if this is None or isinstance(this, Thing):
                raise place_of(self.file, clause.value).error(f"{name} is compared, and no `has NAME {name}` gives it")
            if not _compared(this, str(clause.operator), other):
                return False
        return True

    def _operand(self, bindings: Bindings, word: Word) -> Literal:
        place = place_of(self.file, word)
        if word.type != "VARIABLE":
            return literal(word, place)
        value = bindings.get(str(word))
        if value is None or isinstance(value, Thing):
            raise place.error(f"{word} is compared, and no `has NAME {word}` gives it")
        return value

    def _nothing(self, node: _Node) -> ModelFileError:
        name, kind = self._name(node, self.known), node.kind
        if name is not None and kind is not None and name not in self.store.named[kind]:
            return node.place.error(f"`match` finds nothing: {UnknownName(kind, name, self.store.named[kind])}")
        if not node.types:
            return node.place.error("`match` finds nothing: no thing told so far is like this")
        wanted = node.types[0][0]
        number = sum(wanted in thing.type.lineage() for thing in self.store.things.get(kind, ()))
        return node.place.error(f"`match` finds nothing: no {wanted.label} of the {number} told so far is like this")

    def _unsupported(self, word: Word) -> ModelFileError:
        return place_of(self.file, word).error(
            f"`{word}` is not understood in a `match` that inserts; expected `isa`, `has`, the players of a relation "
            "or a comparison with = != < <= > >="
        )


def _compared(this: Literal, sign: str, other: Literal) -> bool:
    if isinstance(this, bool) is not isinstance(other, bool):
        return sign == "!="
    try:
        return _COMPARE[sign](this, other)
    except TypeError:
        return False


def _identity(one: Thing | Literal) -> object:
    return id(one) if isinstance(one, Thing) else (type(one), one)
