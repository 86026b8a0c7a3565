"""What `match` finds among the things inserted so far: every way in which all of its patterns hold together."""

import operator
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Final, TypeVar

from kb.exceptions import UnknownName
from kb.files import ModelFileError, Place
from kb.typeql.store import ANONYMOUS, Bindings, Store, Thing, literal
from kb.typeql.syntax import Comparison, Has, Isa, Player, Players, Statement, Unsupported, Word, place_of
from kb.typeql.vocabulary import Field, Kind, Literal, Type

T = TypeVar("T")
Found = dict[str, Thing | Literal]

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
_EQUAL: Final = ("None", "=", "==")


@dataclass(slots=True)
class _Pattern:
    """What is asked of one thing, which may have no name; each type with whether it must be that very type."""

    variable: str | None
    place: Place
    types: list[tuple[Type, bool]] = field(default_factory=list)
    attributes: list[Has] = field(default_factory=list)
    players: list[Player] = field(default_factory=list)

    @property
    def kind(self) -> Kind | None:
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
        self.patterns: dict[str, _Pattern] = {}
        self.known: Found = {}
        self.comparisons: list[tuple[str, Comparison]] = []

    def ask(self, asked: Statement | Unsupported) -> None:
        """Add what is asked; all that is asked of one variable is one pattern."""
        clauses = (asked,) if isinstance(asked, Unsupported) else asked.clauses
        for clause in clauses:
            word = clause.word if isinstance(clause, Unsupported) else getattr(clause, "operator", None)
            if word is not None and (str(word) not in _COMPARE or isinstance(clause, Unsupported)):
                raise place_of(self.file, word).error(
                    f"`{word}` is not understood in a `match` that inserts; expected `isa`, `has`, the players of a "
                    "relation or a comparison with = != < <= > >="
                )
        assert isinstance(asked, Statement)  # anything else was refused
        name = asked.variable if asked.variable != ANONYMOUS else None
        compared = [clause for clause in clauses if isinstance(clause, Comparison)]
        if compared and name:
            for one in compared:
                if str(one.operator) in _EQUAL and one.value.type != "VARIABLE":
                    self.known[name] = literal(one.value, place_of(self.file, one.value))
                else:
                    self.comparisons.append((name, one))
            return
        key = name or f"{len(self.patterns)}"
        pattern = self.patterns.setdefault(key, _Pattern(name, place_of(self.file, asked.word)))
        for clause in clauses:
            if isinstance(clause, Isa):
                wanted = self.store.vocabulary.type(clause.label, place_of(self.file, clause.label))
                pattern.types.append((wanted, clause.exact))
            elif isinstance(clause, Has):
                pattern.attributes.append(clause)
            elif isinstance(clause, Players):
                pattern.players += clause.players

    def answers(self) -> list[Bindings]:
        """The most telling patterns come first."""
        found = [dict(self.known)]
        rest = list(self.patterns.values())
        while rest:
            pattern = min(rest, key=lambda one: self._effort(one, found[0]))
            rest.remove(pattern)
            found = _bounded((more for bindings in found for more in self._extended(bindings, pattern)), pattern.place)
            if not found:
                raise self._nothing(pattern)
        kept = [bindings for bindings in found if self._holds(bindings)]
        if not kept:
            raise place_of(self.file, self.comparisons[0][1].value).error("nothing known so far compares like this")
        return list({tuple((name, type(one), one) for name, one in each.items()): each for each in kept}.values())

    def _effort(self, pattern: _Pattern, bindings: Bindings) -> int:
        if pattern.variable in bindings or self._name(pattern, bindings) is not None:
            return 0
        size = len(self.store.things.get(pattern.kind, ()))
        return size if any(str(player.variable) in bindings for player in pattern.players) else 1 + 2 * size

    def _name(self, pattern: _Pattern, bindings: Bindings) -> str | None:
        for wanted in pattern.attributes:
            meant = self._meant(pattern.kind, wanted)
            if meant and meant.name == "name" and str(wanted.operator) in _EQUAL:
                value = self._value(wanted.value, bindings)
                if isinstance(value, str):
                    return value
        return None

    def _meant(self, kind: Kind | None, wanted: Has) -> Field | None:
        return self.store.vocabulary.field(kind, str(wanted.label)) if kind and wanted.label else None

    def _value(self, word: Word, bindings: Bindings) -> Thing | Literal | None:
        return bindings.get(str(word)) if word.type == "VARIABLE" else literal(word, place_of(self.file, word))

    def _candidates(self, pattern: _Pattern, bindings: Bindings) -> Iterable[Thing]:
        if pattern.variable in bindings:
            one = bindings[pattern.variable or ""]
            return [one] if isinstance(one, Thing) else []
        name = self._name(pattern, bindings)
        if name is not None and pattern.kind is not None:
            named = self.store.named[pattern.kind].get(name)
            return [named] if named else []
        if pattern.types:
            return self.store.things.get(pattern.kind, ())
        return [thing for things in self.store.things.values() for thing in things]

    def _extended(self, bindings: Found, pattern: _Pattern) -> Iterator[Found]:
        for thing in self._candidates(pattern, bindings):
            if all(thing.type is one or (not exact and one in thing.type.lineage()) for one, exact in pattern.types):
                found = [{**bindings, pattern.variable: thing} if pattern.variable else bindings]
                for wanted in pattern.attributes:
                    found = [more for one in found for more in self._having(one, thing, wanted, pattern.kind)]
                yield from self._relating(found, thing, pattern)

    def _having(self, bindings: Found, thing: Thing, wanted: Has, kind: Kind | None) -> Iterator[Found]:
        meant, sign = self._meant(kind, wanted), str(wanted.operator or "==")
        value = self._value(wanted.value, bindings)
        for own in thing.owns:
            if wanted.label not in (None, own.label) and (meant is None or own.field is not meant):
                continue
            if value is None and sign in _EQUAL:
                yield {**bindings, str(wanted.value): own.value}
            elif value is not None and not isinstance(value, Thing) and _compared(own.value, value, sign):
                yield bindings

    def _relating(self, found: Sequence[Found], thing: Thing, pattern: _Pattern) -> list[Found]:
        """Let each player that is asked for stand for another part of the relation."""
        states: list[tuple[Found, frozenset[int]]] = [(one, frozenset()) for one in found]
        for role, variable in pattern.players:
            name, place = str(variable), place_of(self.file, role or variable)
            wanted = None
            if role is not None and thing.kind is not None:
                wanted = self.store.vocabulary.roles(thing.type, thing.kind, role, place)
            every = (
                ({**bindings, name: part.thing} if name != ANONYMOUS else bindings, used | {number})
                for bindings, used in states
                for number, part in enumerate(thing.parts)
                if number not in used
                and bindings.get(name, part.thing) is part.thing
                and (wanted is None or part.role in wanted)
            )
            states = _bounded(every, place)
        return [bindings for bindings, _ in states]

    def _holds(self, bindings: Bindings) -> bool:
        for name, clause in self.comparisons:
            values = [bindings.get(name), self._value(clause.value, bindings)]
            for word, value in zip((name, clause.value), values, strict=True):
                if value is None or isinstance(value, Thing):
                    place = place_of(self.file, clause.value)
                    raise place.error(f"{word} is compared, and no `has NAME {word}` gives it")
            this, other = values
            if not _compared(this, other, str(clause.operator)):  # type: ignore[arg-type]  # seen to above
                return False
        return True

    def _nothing(self, pattern: _Pattern) -> ModelFileError:
        name, kind, what = self._name(pattern, self.known), pattern.kind, "no thing known so far is like this"
        if name is not None and kind is not None and name not in self.store.named[kind]:
            what = str(UnknownName(kind, name, self.store.named[kind]))
        elif pattern.types:
            wanted = pattern.types[0][0]
            number = sum(wanted in thing.type.lineage() for thing in self.store.things.get(kind, ()))
            what = f"no {wanted.label} of the {number} known so far is like this"
        return pattern.place.error(f"`match` finds nothing: {what}")


def _bounded(every: Iterator[T], place: Place) -> list[T]:
    found = list(islice(every, MOST + 1))
    if len(found) > MOST:
        raise place.error(f"`match` finds more than {MOST} answers; say which things are meant, by their names")
    return found


def _compared(this: Literal, other: Literal, sign: str) -> bool:
    if isinstance(this, bool) is not isinstance(other, bool):
        return sign == "!="
    try:
        return _COMPARE[sign](this, other)
    except TypeError:
        return False
