"""What files say, statement by statement: things with their attributes, and which play which role in which relation.

That is what `insert` adds, and what `match` finds among the things inserted so far.
"""

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from itertools import islice
from typing import Final, NamedTuple, TypeVar

from kb.exceptions import UnknownName
from kb.files import DuplicateInFile, ModelFileError, Place
from kb.typeql.syntax import Clause, Equal, Has, Isa, Literal, Player, Players, Statement, Word, place_of
from kb.typeql.vocabulary import ATTRIBUTES, Field, Kind, Role, Type, Value, Vocabulary, field_of

ANONYMOUS: Final = "$_"
"""A variable that stands for something else each time."""

_REPEATABLE: Final = frozenset({"status", "required", "selected", "active"})
"""What may be said again later: facts, of which the last one stands."""
_TYPES: Final[Mapping[Value, tuple[type, ...]]] = {
    Value.TEXT: (str,),
    Value.FLAG: (bool,),
    Value.WHOLE: (int,),
    Value.NUMBER: (int, float),
    Value.TIME: (datetime,),
    Value.ANY: (str, bool, int, float),
}


class Own(NamedTuple):
    """A thing has an attribute; the field is None if ROSA has none such, the order is that of the statement."""

    field: Field | None
    label: str
    value: Literal
    place: Place
    order: int


class Part(NamedTuple):
    """A thing plays a role in a relation; the role is None in a relation that ROSA does not know."""

    role: Role | None
    thing: "Thing"


@dataclass(slots=True, eq=False)
class Thing:
    """An entity or relation that a file inserts."""

    type: Type
    place: Place
    order: int = 0
    owns: list[Own] = field(default_factory=list)
    parts: list[Part] = field(default_factory=list)

    @property
    def kind(self) -> Kind | None:
        return self.type.kind

    @property
    def name(self) -> str:
        own = self.own("name")
        if own is None and self.kind:
            raise self.place.error(f"this {self.type.label} has no name; write `has {self.kind.label}-name '...'`")
        return str(own.value) if own else ""

    def own(self, name: str) -> Own | None:
        """Return the attribute of that name, the last one said."""
        return next((own for own in reversed(self.owns) if own.field and own.field.name == name), None)

    def value(self, name: str) -> Literal | None:
        own = self.own(name)
        return own.value if own else None

    def players(self, role: str) -> "list[Thing]":
        return [part.thing for part in self.parts if part.role and part.role.name == role]


Bindings = Mapping[str, Thing | Literal]
"""What variables stand for: things, and values of attributes."""


class Store:
    """All that was said so far: things by kind, in order and by name; and notes of what was passed over."""

    def __init__(self, vocabulary: Vocabulary) -> None:
        self.vocabulary = vocabulary
        self.things: dict[Kind | None, list[Thing]] = {}
        self.named: dict[Kind, dict[str, Thing]] = {kind: {} for kind in Kind}
        self.notes: list[str] = []
        self.order = 0

    def of(self, kind: Kind) -> list[Thing]:
        return self.things.get(kind, [])

    def note(self, place: Place, text: str) -> None:
        self.notes.append(f"{place}: {text}")

    def add(self, label: Word, place: Place) -> Thing:
        thing = Thing(self.vocabulary.type(label, place), place)
        if thing.kind is None:
            self.note(place, f"{thing.type.label} is no sort of anything in ROSA; it is passed over")
        self.things.setdefault(thing.kind, []).append(thing)
        return thing

    def give(self, thing: Thing, label: str, value: Literal, place: Place) -> None:
        found = field_of(thing.kind, label) if thing.kind else None
        if found is None or thing.kind is None:
            if thing.kind and label not in self.vocabulary.attributes:
                known = [one.words[0] for one in ATTRIBUTES[thing.kind]]
                self.note(place, f"{UnknownName(f'attribute of {thing.type.label}', label, known)}; passed over")
            thing.owns.append(Own(None, label, value, place, self.order))
            return
        own = Own(found, label, _checked(found, value, label, place), place, self.order)
        before = thing.own(found.name)
        if before is not None and found.name not in _REPEATABLE:
            if before.value != own.value:
                if before.label == label:
                    raise place.error(f"{label} is {own.value!r} here, and {before.value!r} at {before.place}")
                self.note(place, f"{label} is passed over: {before.label} at {before.place} says it already")
            return
        thing.owns.append(own)
        if found.name == "name":
            first = self.named[thing.kind].setdefault(str(own.value), thing)
            if first is not thing:
                message = f"{thing.kind} {own.value!r} is declared already at {first.place}; a name is unique"
                raise DuplicateInFile(message, *place)


class Insertion:
    """One `insert`, for one answer to what stands before it."""

    def __init__(self, store: Store, file: str, bindings: Bindings) -> None:
        self.store, self.file = store, file
        self.things = {name: one for name, one in bindings.items() if isinstance(one, Thing)}
        self.values: dict[str, Literal] = {name: one for name, one in bindings.items() if not isinstance(one, Thing)}

    def run(self, statements: Sequence[Statement]) -> None:
        """Find what each variable is, then take in what is said of it, for it may be said before."""
        subjects = [self._subject(statement) for statement in statements]
        for statement, thing in zip(statements, subjects, strict=True):
            self.store.order += 1
            order = self.store.order
            if thing is None and statement.variable not in self.values:
                thing = self._thing(statement.word)
            if thing is not None:
                thing.order = thing.order or order
                for clause in statement.clauses:
                    if isinstance(clause, Has):
                        self._has(thing, clause)
                    for player in clause.players if isinstance(clause, Players) else ():
                        self._player(thing, player)

    def _subject(self, statement: Statement) -> Thing | None:
        """Return the thing that a statement declares; None if it is declared elsewhere, or a value."""
        name = None if statement.variable == ANONYMOUS else statement.variable
        isa = [clause for clause in statement.clauses if isinstance(clause, Isa)]
        equal = [clause for clause in statement.clauses if isinstance(clause, Equal)]
        if equal and name:
            self.values[name] = equal[-1].value
            return None
        for other in isa[1:]:
            raise place_of(self.file, other.label).error(f"a second type, `{other.label}`; a thing has one")
        if not isa:
            return None
        before = self.things.get(name) if name else None
        if before is not None:
            place = place_of(self.file, statement.word)
            raise place.error(f"{name} is given a type already at {before.place}, {before.type.label}; a thing has one")
        thing = self.store.add(isa[0].label, place_of(self.file, isa[0].label))
        if name:
            self.things[name] = thing
        return thing

    def _has(self, thing: Thing, clause: Has) -> None:
        value = clause.value
        if isinstance(value, Word):
            if str(value) not in self.values:
                raise self._unknown(value, self.values, f'a value is given by `{value} "..."`')
            value = self.values[value]
        self.store.give(thing, str(clause.label), value, place_of(self.file, clause.label))

    def _player(self, thing: Thing, player: Player) -> None:
        one = self._thing(player.variable)
        place = place_of(self.file, player.role or player.variable)
        role = self.store.vocabulary.role(thing.type, thing.kind, player.role, one.type, place) if thing.kind else None
        if role is not None and role.most and len(thing.players(role.name)) >= role.most:
            raise place.error(f"a second {role.name}; a {thing.type.label} has one")
        thing.parts.append(Part(role, one))

    def _thing(self, word: Word) -> Thing:
        if str(word) not in self.things:
            raise self._unknown(word, self.things, f"a type is given by `{word} isa ...`")
        return self.things[str(word)]

    def _unknown(self, word: Word, known: Collection[str], advice: str) -> Exception:
        what = UnknownName("variable", str(word), known) if known else f"unknown variable '{word}'"
        return place_of(self.file, word).error(f"{what}; {advice}")


def shown(value: Literal) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"the date {value.isoformat()}" if isinstance(value, datetime) else f"{value!r:.60}"


def _checked(field: Field, value: Literal, label: str, place: Place) -> Literal:
    if isinstance(value, float) and field.value is Value.WHOLE and value.is_integer():
        return int(value)
    allowed = _TYPES[field.value]
    if not isinstance(value, allowed) or (isinstance(value, bool) and bool not in allowed):
        raise place.error(f"{label} is {field.value}, not {shown(value)}")
    if isinstance(value, float) and not math.isfinite(value):
        raise place.error(f"{label} is a finite number, not {value!r}")
    return value


# -------------------------------------------------------------------- match

T = TypeVar("T")
Found = dict[str, Thing | Literal]

MOST: Final = 100_000
"""How many answers a `match` may have on the way; more are a slip, and would multiply without limit."""


class Question:
    """What one `match` asks."""

    def __init__(self, store: Store, file: str) -> None:
        self.store, self.file = store, file

    def answers(self, patterns: Sequence[Statement]) -> list[Bindings]:
        """Return what the variables can stand for; at least one answer.

        The most telling statements come first: those with a name, then relations.

        Raises:
            ModelFileError: nothing matches; the message says what was looked for and what there is.
        """
        equal = [(one.variable, each) for one in patterns for each in one.clauses if isinstance(each, Equal)]
        found: list[Found] = [{str(name): each.value for name, each in equal}]
        statements = (one for one in patterns if not any(isinstance(each, Equal) for each in one.clauses))
        for one in sorted(statements, key=self._effort):
            place = place_of(self.file, one.word)
            found = _bounded((more for known in found for more in self._extended(known, one)), place)
            if not found:
                raise self._nothing(one, place)
        return list({tuple((name, type(one), one) for name, one in each.items()): each for each in found}.values())

    def _effort(self, one: Statement) -> int:
        if self._name(one) is not None:
            return 0
        return 1 if any(isinstance(clause, Players) for clause in one.clauses) else 2

    def _extended(self, known: Found, one: Statement) -> Iterator[Found]:
        name = None if one.variable == ANONYMOUS else one.variable
        for thing in self._candidates(known, one, name):
            found = [{**known, name: thing} if name else known]
            for clause in one.clauses:
                found = [more for each in found for more in self._holding(each, thing, clause)]
            yield from found

    def _candidates(self, known: Found, one: Statement, name: str | None) -> Iterable[Thing]:
        if name in known:
            thing = known[name or ""]
            return [thing] if isinstance(thing, Thing) else []
        kind = self._kind(one)
        if kind is not None and (called := self._name(one)) is not None:
            named = self.store.named[kind].get(called)
            return [named] if named else []
        if any(isinstance(clause, Isa) for clause in one.clauses):
            return self.store.things.get(kind, ())
        return [thing for things in self.store.things.values() for thing in things]

    def _holding(self, known: Found, thing: Thing, clause: Clause) -> Iterable[Found]:
        if isinstance(clause, Isa):
            wanted = self.store.vocabulary.type(clause.label, place_of(self.file, clause.label))
            is_one = thing.type is wanted or (not clause.exact and wanted in thing.type.lineage())
            return [known] if is_one else []
        if isinstance(clause, Has):
            return self._having(known, thing, clause)
        return self._relating(known, thing, clause.players) if isinstance(clause, Players) else []

    def _having(self, known: Found, thing: Thing, wanted: Has) -> Iterator[Found]:
        meant = field_of(thing.kind, str(wanted.label)) if thing.kind else None
        value = known.get(str(wanted.value)) if isinstance(wanted.value, Word) else wanted.value
        for own in thing.owns:
            if wanted.label == own.label or (meant is not None and own.field is meant):
                if value is None:
                    yield {**known, str(wanted.value): own.value}
                elif value == own.value and isinstance(value, bool) is isinstance(own.value, bool):
                    yield known

    def _relating(self, known: Found, thing: Thing, players: Sequence[Player]) -> list[Found]:
        """Let each player that is asked for stand for another part of the relation."""
        states: list[tuple[Found, frozenset[int]]] = [(known, frozenset())]
        for role, variable in players:
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

    def _kind(self, one: Statement) -> Kind | None:
        return next((each.kind for each in self._types(one) if each.kind), None)

    def _types(self, one: Statement) -> list[Type]:
        labels = (clause.label for clause in one.clauses if isinstance(clause, Isa))
        return [self.store.vocabulary.type(label, place_of(self.file, label)) for label in labels]

    def _name(self, one: Statement) -> str | None:
        """Return the name that is written in a statement that says the type."""
        if (kind := self._kind(one)) is None:
            return None
        given = (clause for clause in one.clauses if isinstance(clause, Has) and type(clause.value) is str)
        fields = ((field_of(kind, str(clause.label)), str(clause.value)) for clause in given)
        return next((value for field, value in fields if field and field.name == "name"), None)

    def _nothing(self, one: Statement, place: Place) -> ModelFileError:
        name, kind, what = self._name(one), self._kind(one), "no thing known so far is like this"
        if name is not None and kind is not None and name not in self.store.named[kind]:
            what = str(UnknownName(kind, name, self.store.named[kind]))
        elif types := self._types(one):
            number = sum(types[0] in thing.type.lineage() for thing in self.store.things.get(kind, ()))
            what = f"no {types[0].label} of the {number} known so far is like this"
        return place.error(f"`match` finds nothing: {what}")


def _bounded(every: Iterator[T], place: Place) -> list[T]:
    found = list(islice(every, MOST + 1))
    if len(found) > MOST:
        raise place.error(f"`match` finds more than {MOST} answers; say which things are meant, by their names")
    return found
