"""The types, roles and attributes of TypeQL files: ROSA's, from `vocabulary.toml`, and those that the files define.

The kind of a thing is the ROSA type that its type is or descends from, as `vocabulary.toml` spells it.
"""

import tomllib
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime, timedelta
from functools import cache
from importlib.resources import files
from typing import Any, Final, NamedTuple

from kb import elements, facts
from kb.exceptions import UnknownName
from kb.files import Place
from kb.typeql.syntax import MAX_DEPTH, Define, Word, place_of

_WORDS: Final[dict[str, Any]] = tomllib.loads(files(__package__).joinpath("vocabulary.toml").read_text())
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


def _role(name: str, words: str, by: list[str], field: str = "", least: int = 1, most: int = 0) -> Role:
    for group, members in _WORDS["groups"].items():
        words = words.replace(f"@{group}", members)
    return Role(name, field, tuple(by), tuple(words.split()), least, most)


ROLES: Final[Mapping[str, tuple[Role, ...]]] = {
    kind: tuple(_role(name, **given) for name, given in roles.items()) for kind, roles in _WORDS["roles"].items()
}

ATTRIBUTES: Final[Mapping[str, tuple[Field, ...]]] = {
    kind: tuple(Field(name, value, label, tuple(words.split())) for label, (name, value, words) in own.items())
    for kind, own in _WORDS["attributes"].items()
}

CLASSES: Final[Mapping[type, str]] = {
    cls: kind for cls, word in facts.ROSA.items() if (kind := word.replace(" ", "-")) in {*ROLES, *ATTRIBUTES}
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
                self._parents.update((str(label), (str(one), place_of(file, one))) for one in parents)
        for label in self._parents:
            self._link(label, [])

    def type(self, label: Word | str, place: Place) -> Type:
        found = self._types.get(_plain(label))
        if found is None:
            known = list(dict.fromkeys(one.label for one in self._types.values()))
            raise place.error(f"{UnknownName('type', str(label), known)}; a type of your own is declared by `define`")
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
            raise place.error(f"what this {player.label} is in {of.label} is not clear; write one of the roles {names}")
        needed = ", ".join(dict.fromkeys(one for role in candidates for one in role.kinds))
        what = f"role `{word}`" if word else "a player"
        raise place.error(f"{what} of {of.label} can be: {needed}; not a thing of type {player.label}, as here")

    def roles(self, of: Type, word: Word, place: Place) -> tuple[Role, ...]:
        """Return the roles that a word can mean."""
        name, every = _word(word), ROLES.get(of.kind, ())
        while name:
            if found := tuple(role for role in every if name in role.words or name.removesuffix("s") in role.words):
                return found
            first, _, rest = name.partition("-")
            name = rest if first in _QUALIFIERS else ""
        known = [role.name for role in every]
        raise place.error(f"{UnknownName(f'role of {of.label}', str(word), known)} (roles: {', '.join(known)})")

    def _link(self, label: str, below: list[str]) -> Type | None:
        """Return a type by its label, made with its parents if need be; None for an attribute."""
        known = self._types.get(_plain(label))
        if known is not None or label not in self._parents or label in self.attributes:
            return known
        parent, place = self._parents[label]
        if label in below:
            raise place.error(f"{label} is declared a subtype of itself: {' sub '.join([*below, label])}")
        if len(below) > MAX_DEPTH:
            raise place.error(f"more than {MAX_DEPTH} types are below one another; declare {parent} before {label}")
        above = None if parent in _ROOTS else self._link(parent, [*below, label])
        is_attribute = parent in self.attributes or any(field_of(kind, parent) for kind in ATTRIBUTES)
        if parent == "attribute" or (above is None and parent not in _ROOTS and is_attribute):
            self.attributes.add(label)
            return None
        if above is None and parent not in _ROOTS:
            self.type(parent, place)
        above = above or Type("", "", ())
        return self._types.setdefault(_plain(label), Type(label, above.kind, (label, *above.lineage)))


def seconds(moment: datetime) -> float:
    """Return a time in seconds since 1970-01-01 UTC."""
    return (moment - datetime(1970, 1, 1, tzinfo=UTC)) / timedelta(seconds=1)


@cache
def field_of(kind: str, label: str) -> Field | None:
    """Return the attribute of a kind of thing that a label means, or None if ROSA has none."""
    name = f"-{_word(label)}"
    found = [(len(one), field) for field in ATTRIBUTES.get(kind, ()) for one in field.words if name.endswith(f"-{one}")]
    return max(found, key=lambda one: one[0])[1] if found else None


def _plain(label: Word | str) -> str:
    return str(label).replace("-", "").replace("_", "").lower()


def _word(label: Word | str) -> str:
    return str(label).replace("_", "-").lower()
