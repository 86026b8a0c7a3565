"""What files say, statement by statement: things with their attributes, and which play which role in which relation."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Final, NamedTuple

from kb.exceptions import UnknownName
from kb.files import DuplicateInFile, Place
from kb.typeql.syntax import Equal, Has, Isa, Literal, Player, Players, Statement, Word, place_of
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

    def insert(self, statements: Sequence[Statement], file: str, bindings: Bindings) -> None:
        _Insertion(self, file, bindings).run(statements)

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
            if thing.kind and not self.vocabulary.declares(label):
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


class _Insertion:
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
