"""The things that TypeQL files insert: entities and relations, their attributes, and who plays which role.

`insert` adds to them, and `match` finds some among those that were inserted before.
"""

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from itertools import islice
from typing import Final, NamedTuple, TypeVar

from kb.exceptions import UnknownName
from kb.files import DuplicateInFile, ModelFileError, Place
from kb.typeql.syntax import Has, Insert, Literal, Player, Statement, Word, place_of
from kb.typeql.vocabulary import ATTRIBUTES, VALUES, Field, Role, Type, Vocabulary, field_of

_REPEATABLE: Final = frozenset({"status", "required", "selected", "active"})
"""The attributes that may be stated again: they are facts, and the last statement counts."""


class Own(NamedTuple):
    """An attribute of a thing; the name is empty if ROSA does not have it, the order is that of its statement."""

    name: str
    label: str
    value: Literal
    place: Place
    order: int


class Part(NamedTuple):
    """A role that a thing plays in a relation; the role is None in a relation that ROSA does not know."""

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
    def kind(self) -> str:
        return self.type.kind

    @property
    def name(self) -> str:
        own = self.own("name")
        if own is None and self.kind:
            raise self.place.error(f"this {self.type.label} has no name; write `has {self.kind}-name '...'`")
        return str(own.value) if own else ""

    def own(self, name: str) -> Own | None:
        """Return the attribute of a name that was stated last."""
        return next((own for own in reversed(self.owns) if own.name == name), None)

    def value(self, name: str) -> Literal | None:
        own = self.own(name)
        return own.value if own else None

    def players(self, role: str) -> "list[Thing]":
        return [part.thing for part in self.parts if part.role and part.role.name == role]


T = TypeVar("T")

MOST: Final = 100_000
"""The most answers of a `match`, also in between; more are a mistake, and could fill the memory."""

Bindings = Mapping[str, Thing]
"""The thing that each variable stands for."""


class Store:
    """All things so far, by kind in order and by name; and notes of what was ignored.

    Attributes:
        file: the file of the query that is being read.
    """

    def __init__(self, vocabulary: Vocabulary) -> None:
        self.vocabulary = vocabulary
        self.things: dict[str, list[Thing]] = defaultdict(list)
        self.named: dict[str, dict[str, Thing]] = defaultdict(dict)
        self.notes: list[str] = []
        self.order, self.file = 0, ""

    def note(self, place: Place, text: str) -> None:
        self.notes.append(f"{place}: {text}")

    def give(self, thing: Thing, label: str, value: Literal, place: Place) -> None:
        found = field_of(thing.kind, label)
        if found is None:
            if thing.kind and label not in self.vocabulary.attributes:
                known = [one.words[0] for one in ATTRIBUTES.get(thing.kind, ())]
                self.note(place, f"{UnknownName(f'attribute of {thing.type.label}', label, known)}; ignored")
            thing.owns.append(Own("", label, value, place, self.order))
            return
        own = Own(found.name, label, _checked(found, value, label, place), place, self.order)
        before = thing.own(found.name)
        if before is not None and found.name not in _REPEATABLE:
            if before.value != own.value:
                if before.label == label:
                    raise place.error(f"{label} is {own.value!r} here, and {before.value!r} at {before.place}")
                self.note(place, f"{label} is ignored: {before.label} at {before.place} has said it")
            return
        thing.owns.append(own)
        if found.name == "name":
            first = self.named[thing.kind].setdefault(str(own.value), thing)
            if first is not thing:
                message = f"{thing.kind} {own.value!r} is declared already at {first.place}; a name is unique"
                raise DuplicateInFile(message, *place)

    def read(self, query: Insert, file: str) -> None:
        """Insert what a query says, once for each answer of its `match` among the things so far."""
        self.file = file
        for bindings in self._answers(query.patterns):
            self._insert(query.statements, bindings)

    def _insert(self, statements: Sequence[Statement], bindings: Bindings) -> None:
        """Find what each variable stands for, then read the statements, which may use it before its declaration."""
        things = dict(bindings)
        subjects = [self._declared(things, statement) for statement in statements]
        for statement, declared in zip(statements, subjects, strict=True):
            self.order += 1
            thing = declared or self._thing(things, statement.word)
            thing.order = thing.order or self.order
            for has in statement.has:
                self.give(thing, str(has.label), has.value, self._place(has.label))
            for role, variable in statement.players:
                self._play(thing, role, self._thing(things, variable), self._place(role or variable))

    def _declared(self, things: dict[str, Thing], statement: Statement) -> Thing | None:
        """Return the thing that a statement declares; None if it declares none."""
        if statement.isa is None:
            return None
        name = statement.variable
        if name in things:
            why = f"{name} already has the type {things[name].type.label}, at {things[name].place}; a thing has one"
            raise self._place(statement.word).error(why)
        place = self._place(statement.isa)
        thing = Thing(self.vocabulary.type(statement.isa, place), place)
        if not thing.kind:
            self.note(place, f"{thing.type.label} is no kind of thing in ROSA; it is ignored")
        self.things[thing.kind].append(thing)
        if name:
            things[name] = thing
        return thing

    def _play(self, thing: Thing, word: Word | None, player: Thing, place: Place) -> None:
        role = self.vocabulary.role(thing.type, word, player.type, place) if thing.kind else None
        if role is not None and role.most and len(thing.players(role.name)) >= role.most:
            raise place.error(f"a second {role.name}; a {thing.type.label} has one")
        thing.parts.append(Part(role, player))

    def _thing(self, things: dict[str, Thing], word: Word) -> Thing:
        if str(word) not in things:
            what = UnknownName("variable", str(word), things) if things else f"unknown variable '{word}'"
            raise self._place(word).error(f"{what}; a type is given by `{word} isa ...`")
        return things[str(word)]

    def _place(self, word: Word) -> Place:
        return place_of(self.file, word)

    def _answers(self, patterns: Sequence[Statement]) -> list[Bindings]:
        """Return the answers of a `match`, at least one.

        Statements with a name are looked up first, then relations, because they leave the fewest answers.

        Raises:
            ModelFileError: nothing matches; the message says what was looked for and what there is.
        """
        found: list[Bindings] = [{}]
        for one in sorted(patterns, key=lambda one: 0 if self._name(one) else 1 if one.players else 2):
            place = self._place(one.word)
            found = _bounded((more for known in found for more in self._extended(known, one)), place)
            if not found:
                raise self._nothing(one, place)
        return list({tuple(each.items()): each for each in found}.values())

    def _extended(self, known: Bindings, one: Statement) -> Iterator[Bindings]:
        wanted = self._type(one)
        for thing in self._candidates(known, one):
            if (wanted is None or wanted.label in thing.type.lineage) and all(_has(thing, has) for has in one.has):
                yield from self._relating({**known, one.variable: thing} if one.variable else known, thing, one.players)

    def _candidates(self, known: Bindings, one: Statement) -> Iterable[Thing]:
        if one.variable is not None and one.variable in known:
            return [known[one.variable]]
        if (wanted := self._type(one)) is None:
            return [thing for things in self.things.values() for thing in things]
        if (name := self._name(one)) is None:
            return self.things[wanted.kind]
        return [thing for thing in [self.named[wanted.kind].get(name)] if thing]

    def _relating(self, known: Bindings, thing: Thing, players: Sequence[Player]) -> list[Bindings]:
        """Return the answers in which each player of a pattern is a different part of a relation."""
        states: list[tuple[Bindings, frozenset[int]]] = [(known, frozenset())]
        for role, variable in players:
            name, place = str(variable), self._place(role or variable)
            wanted = self.vocabulary.roles(thing.type, role, place) if role and thing.kind else None
            every = (
                ({**bindings, name: part.thing}, used | {number})
                for bindings, used in states
                for number, part in enumerate(thing.parts)
                if number not in used
                and bindings.get(name, part.thing) is part.thing
                and (wanted is None or part.role in wanted)
            )
            states = _bounded(every, place)
        return [bindings for bindings, _ in states]

    def _type(self, one: Statement) -> Type | None:
        return None if one.isa is None else self.vocabulary.type(one.isa, self._place(one.isa))

    def _name(self, one: Statement) -> str | None:
        """Return the name in a statement that also has the type, or None."""
        wanted = self._type(one)
        fields = ((field_of(wanted.kind, has.label), has.value) for has in one.has) if wanted else ()
        return next((str(value) for field, value in fields if field and field.name == "name"), None)

    def _nothing(self, one: Statement, place: Place) -> ModelFileError:
        name, wanted, what = self._name(one), self._type(one), "no thing known so far is like this"
        if wanted is not None and name is not None and name not in self.named[wanted.kind]:
            what = str(UnknownName(wanted.kind, name, self.named[wanted.kind]))
        return place.error(f"`match` finds nothing: {what}")


def shown(value: Literal) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"the date {value.isoformat()}" if isinstance(value, datetime) else f"{value!r:.60}"


def _checked(field: Field, value: Literal, label: str, place: Place) -> Literal:
    words, allowed = VALUES[field.value]
    if isinstance(value, float) and allowed == (int,) and value.is_integer():
        return int(value)
    if not isinstance(value, allowed) or (isinstance(value, bool) and bool not in allowed):
        raise place.error(f"{label} is {words}, not {shown(value)}")
    if isinstance(value, float) and not math.isfinite(value):
        raise place.error(f"{label} is a finite number, not {value!r}")
    return value


def _has(thing: Thing, wanted: Has) -> bool:
    meant = field_of(thing.kind, str(wanted.label))
    said = (own.value for own in thing.owns if wanted.label == own.label or (meant and own.name == meant.name))
    return any(one == wanted.value and isinstance(one, bool) is isinstance(wanted.value, bool) for one in said)


def _bounded(every: Iterator[T], place: Place) -> list[T]:
    found = list(islice(every, MOST + 1))
    if len(found) > MOST:
        raise place.error(f"`match` finds more than {MOST} answers; say which things are meant, by their names")
    return found
