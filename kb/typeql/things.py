"""The things that TypeQL files insert, and their types: entities and relations, their attributes, who plays which role.

Types, roles and attributes are ROSA's, from `vocabulary.toml`, and those that the files define. The kind of a thing is
the ROSA type that its type is or descends from, as `vocabulary.toml` spells it. `insert` adds to the things, and
`match` finds some among those that were inserted before.
"""

import math
import tomllib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import cache
from importlib.resources import files
from itertools import islice
from typing import Any, Final, NamedTuple, TypeVar

from kb import elements, facts
from kb.exceptions import UnknownName
from kb.files import DuplicateInFile, ModelFileError, Place
from kb.typeql.syntax import (
    MAX_DEPTH,
    Define,
    Has,
    Insert,
    Literal,
    Player,
    Statement,
    Word,
    place_of,
)

_WORDS: Final[dict[str, Any]] = tomllib.loads(
    files(__package__).joinpath("vocabulary.toml").read_text()
)
EXTENSIONS: Final[Mapping[str, list[str]]] = _WORDS["extensions"]
"""Attributes that ROSA's schema does not have: the sort of their value, and the types that own them."""
_QUALIFIERS: Final = frozenset(_WORDS["qualifiers"].split())
_ROOTS: Final = frozenset({"entity", "relation", "attribute", "thing"})

SPECIAL: Final[Mapping[str, str]] = {
    elements.AttributeKind.QUALITY: "QualityAttribute",
    elements.AttributeKind.ENVIRONMENTAL: "EnvironmentalAttribute",
    elements.ComponentKind.PLAIN: "Component",
    elements.ComponentKind.PROCESS: "ROSNode",
    elements.ComponentKind.LIFECYCLE: "LifeCycleNode",
}
"""The type of things for each kind of attribute or component."""

VALUES: Final[Mapping[str, tuple[str, tuple[type, ...]]]] = {
    "text": ("a text in quotes", (str,)),
    "flag": ("true or false", (bool,)),
    "whole": ("a whole number", (int,)),
    "number": ("a number", (int, float)),
    "time": ("a date and time such as 2024-05-01T12:30:00", (datetime,)),
    "any": ("a text, a number or true or false", (str, bool, int, float)),
}
"""The sorts of values of attributes: their words in messages, and their Python types."""


class Field(NamedTuple):
    """An attribute of a kind of thing: the field of an element or fact, the sort of its value, and its spellings."""

    name: str
    value: str
    label: str
    words: tuple[str, ...]


class Role(NamedTuple):
    """A role in a relation: the field of an element or fact that it fills, and the kinds of things that play it.

    The words are its spellings, without qualifiers and in the singular; a `most` of 0 means any number of players.
    """

    name: str
    field: str
    kinds: tuple[str, ...]
    words: tuple[str, ...]
    least: int
    most: int


def _role(
    name: str, words: str, by: list[str], field: str = "", least: int = 1, most: int = 0
) -> Role:
    for group, members in _WORDS["groups"].items():
        words = words.replace(f"@{group}", members)
    return Role(name, field, tuple(by), tuple(words.split()), least, most)


ROLES: Final[Mapping[str, tuple[Role, ...]]] = {
    kind: tuple(_role(name, **given) for name, given in roles.items())
    for kind, roles in _WORDS["roles"].items()
}

ATTRIBUTES: Final[Mapping[str, tuple[Field, ...]]] = {
    kind: tuple(
        Field(name, value, label, tuple(words.split()))
        for label, (name, value, words) in own.items()
    )
    for kind, own in _WORDS["attributes"].items()
}

CLASSES: Final[Mapping[type, str]] = {
    cls: kind
    for cls, word in facts.ROSA.items()
    if (kind := word.replace(" ", "-")) in {*ROLES, *ATTRIBUTES}
}
"""The kind of each class of elements and facts; each comes after those that it refers to."""


class Type(NamedTuple):
    """A type of thing, with its label and those above it; the kind is empty if ROSA does not know it."""

    label: str
    kind: str
    lineage: tuple[str, ...]


class Vocabulary:
    """The types that files may use: ROSA's, and those that the files define; ROSA's own types cannot be changed.

    Args:
        defined: files and their `define` queries.

    Attributes:
        attributes: the labels of the attributes that the files define.
    """

    def __init__(self, defined: Iterable[tuple[str, Define]] = ()) -> None:
        self._types: dict[str, Type] = {_plain(kind): Type(kind, kind, (kind,)) for kind in ROLES}
        for label, above in _WORDS["entities"].items():
            parent = self._types[_plain(above)] if above[0].isupper() else Type("", above, ())
            self._types[_plain(label)] = Type(label, parent.kind, (label, *parent.lineage))
        for alias, label in _WORDS["aliases"].items():
            self._types[_plain(alias)] = self._types[_plain(label)]
        self._parents: dict[str, tuple[str, Place]] = {}
        self.attributes: set[str] = set()
        for file, query in defined:
            for label, parents in query.definitions:
                self._parents.update(
                    (str(label), (str(one), place_of(file, one))) for one in parents
                )
        for label in self._parents:
            self._link(label, [])

    def type(self, label: Word | str, place: Place) -> Type:
        found = self._types.get(_plain(label))
        if found is None:
            known = list(dict.fromkeys(one.label for one in self._types.values()))
            raise place.error(
                f"{UnknownName('type', str(label), known)}; a type of your own is declared by `define`"
            )
        return found

    def role(self, of: Type, word: Word | None, player: Type, place: Place) -> Role:
        """Return the role of a player of a type in a relation, by the word for the role; without one, by the type."""
        every = ROLES.get(of.kind, ())
        if not every:
            raise place.error(f"{of.label} is no relation; nothing plays a role in it")
        candidates = every if word is None else self.roles(of, word, place)
        fitting = [role for role in candidates if player.kind in role.kinds]
        if len(fitting) == 1 or (fitting and word is not None):
            return fitting[0]
        if fitting:
            names = ", ".join(role.name for role in fitting)
            raise place.error(
                f"what this {player.label} is in {of.label} is not clear; write one of the roles {names}"
            )
        needed = ", ".join(dict.fromkeys(one for role in candidates for one in role.kinds))
        what = f"role `{word}`" if word else "a player"
        raise place.error(
            f"{what} of {of.label} can be: {needed}; not a thing of type {player.label}, as here"
        )

    def roles(self, of: Type, word: Word, place: Place) -> tuple[Role, ...]:
        """Return the roles that a word can mean."""
        name, every = _word(word), ROLES.get(of.kind, ())
        while name:
            if found := tuple(
                role for role in every if name in role.words or name.removesuffix("s") in role.words
            ):
                return found
            first, _, rest = name.partition("-")
            name = rest if first in _QUALIFIERS else ""
        known = [role.name for role in every]
        raise place.error(
            f"{UnknownName(f'role of {of.label}', str(word), known)} (roles: {', '.join(known)})"
        )

    def _link(self, label: str, below: list[str]) -> Type | None:
        """Return a type by its label, made with its parents if need be; None for an attribute."""
        known = self._types.get(_plain(label))
        if known is not None or label not in self._parents or label in self.attributes:
            return known
        parent, place = self._parents[label]
        if label in below:
            raise place.error(
                f"{label} is declared a subtype of itself: {' sub '.join([*below, label])}"
            )
        if len(below) > MAX_DEPTH:
            raise place.error(
                f"more than {MAX_DEPTH} types are below one another; declare {parent} before {label}"
            )
        above = None if parent in _ROOTS else self._link(parent, [*below, label])
        is_attribute = parent in self.attributes or any(
            field_of(kind, parent) for kind in ATTRIBUTES
        )
        if parent == "attribute" or (above is None and parent not in _ROOTS and is_attribute):
            self.attributes.add(label)
            return None
        if above is None and parent not in _ROOTS:
            self.type(parent, place)
        above = above or Type("", "", ())
        return self._types.setdefault(
            _plain(label), Type(label, above.kind, (label, *above.lineage))
        )


def seconds(moment: datetime) -> float:
    """Return a time in seconds since 1970-01-01 UTC."""
    return (moment - datetime(1970, 1, 1, tzinfo=UTC)) / timedelta(seconds=1)


@cache
def field_of(kind: str, label: str) -> Field | None:
    """Return the attribute of a kind of thing that a label means, or None if ROSA has none."""
    name = f"-{_word(label)}"
    found = [
        (len(one), field)
        for field in ATTRIBUTES.get(kind, ())
        for one in field.words
        if name.endswith(f"-{one}")
    ]
    return max(found, key=lambda one: one[0])[1] if found else None


def _plain(label: Word | str) -> str:
    return str(label).replace("-", "").replace("_", "").lower()


def _word(label: Word | str) -> str:
    return str(label).replace("_", "-").lower()


# -------------------------------------------------------------------- things

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
            raise self.place.error(
                f"this {self.type.label} has no name; write `has {self.kind}-name '...'`"
            )
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

    def __init__(self, defined: Iterable[tuple[str, Define]]) -> None:
        self.vocabulary = Vocabulary(defined)
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
                self.note(
                    place,
                    f"{UnknownName(f'attribute of {thing.type.label}', label, known)}; ignored",
                )
            thing.owns.append(Own("", label, value, place, self.order))
            return
        own = Own(found.name, label, _checked(found, value, label, place), place, self.order)
        before = thing.own(found.name)
        if before is not None and found.name not in _REPEATABLE:
            if before.value != own.value:
                if before.label == label:
                    raise place.error(
                        f"{label} is {own.value!r} here, and {before.value!r} at {before.place}"
                    )
                self.note(
                    place, f"{label} is ignored: {before.label} at {before.place} has said it"
                )
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
                self._play(
                    thing, role, self._thing(things, variable), self._place(role or variable)
                )

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
            what = (
                UnknownName("variable", str(word), things)
                if things
                else f"unknown variable '{word}'"
            )
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
        for one in sorted(
            patterns, key=lambda one: 0 if self._name(one) else 1 if one.players else 2
        ):
            place = self._place(one.word)
            found = _bounded(
                (more for known in found for more in self._extended(known, one)), place
            )
            if not found:
                raise self._nothing(one, place)
        return list({tuple(each.items()): each for each in found}.values())

    def _extended(self, known: Bindings, one: Statement) -> Iterator[Bindings]:
        wanted = self._type(one)
        for thing in self._candidates(known, one):
            if (wanted is None or wanted.label in thing.type.lineage) and all(
                _has(thing, has) for has in one.has
            ):
                yield from self._relating(
                    {**known, one.variable: thing} if one.variable else known, thing, one.players
                )

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
        fields = (
            ((field_of(wanted.kind, has.label), has.value) for has in one.has) if wanted else ()
        )
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
    said = (
        own.value
        for own in thing.owns
        if wanted.label == own.label or (meant and own.name == meant.name)
    )
    return any(
        one == wanted.value and isinstance(one, bool) is isinstance(wanted.value, bool)
        for one in said
    )


def _bounded(every: Iterator[T], place: Place) -> list[T]:
    found = list(islice(every, MOST + 1))
    if len(found) > MOST:
        raise place.error(
            f"`match` finds more than {MOST} answers; say which things are meant, by their names"
        )
    return found
