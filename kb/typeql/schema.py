"""Which types, roles and attributes there are: ROSA's, and those that the files define themselves."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from kb.exceptions import UnknownName
from kb.files import Place
from kb.typeql.syntax import Define, Word
from kb.typeql.words import ALIASES, ENTITIES, FIELDS, QUALIFIERS, RELATIONS, ROLES, Field, Kind, Role

__all__ = ["Schema", "Type", "place_of"]

_ROOTS: Final = frozenset({"entity", "relation", "attribute", "thing"})


@dataclass(slots=True, eq=False)
class Type:
    """A type of thing.

    Attributes:
        label: as it is written.
        kind: what we make of it; None for what ROSA does not know.
        parent: the type it is a sort of.
        roles: those that the files declare of it, and which role of its parent each stands for, if they say.
    """

    label: str
    kind: Kind | None
    parent: "Type | None" = None
    roles: dict[str, str | None] = field(default_factory=dict)

    def lineage(self) -> Iterator["Type"]:
        """Go from this type up through those it is a sort of."""
        seen: list[Type] = []
        one: Type | None = self
        while one is not None and one not in seen:
            seen.append(one)
            yield one
            one = one.parent


class Schema:
    """The types that files may use: first all files `define`, then `link` is called, then the rest is asked."""

    def __init__(self) -> None:
        self._types: dict[str, Type] = {}
        for label, (parent, kind) in ENTITIES.items():
            self._types[_plain(label)] = Type(label, kind, self._types[_plain(parent)] if parent else None)
        for label, kind in RELATIONS.items():
            self._types[_plain(label)] = Type(label, kind)
        for alias, label in ALIASES.items():
            self._types[_plain(alias)] = self._types[_plain(label)]
        self._parents: dict[str, tuple[Word, Place]] = {}
        self._roles: list[tuple[Word, Place, Word, Word | None]] = []
        self._attributes: dict[str, str] = {}
        self._owned: set[str] = set()
        self._fields: dict[tuple[Kind, str], Field | None] = {}

    def define(self, query: Define, file: str) -> None:
        """Take note of what a file declares."""
        for definition in query.definitions:
            label = definition.label
            for clause in definition.clauses:
                place = place_of(file, clause.label)
                if clause.keyword == "sub":
                    self._parents[str(label)] = (clause.label, place)
                elif clause.keyword == "relates":
                    self._roles.append((label, place_of(file, label), clause.label, clause.alias))
                else:
                    self._owned.add(str(clause.label))

    def link(self) -> None:
        """Work out what the declared types are sorts of."""
        for label in self._parents:
            self._linked(label)
        for label, place, role, alias in self._roles:
            self.type(label, place).roles[_word(role)] = _word(alias) if alias else None

    def type(self, label: Word | str, place: Place) -> Type:
        """Return the type that is called so."""
        found = self._types.get(_plain(label))
        if found is None:
            known = list(dict.fromkeys(one.label for one in self._types.values()))
            raise place.error(f"{UnknownName('type', str(label), known)}; a type of your own is declared by `define`")
        return found

    def field(self, kind: Kind, label: str) -> Field | None:
        """Return the attribute of a kind of thing that is called so, or None if ROSA has none."""
        if (kind, label) not in self._fields:
            lineage = (_field(kind, name) for name in self._spellings(label))
            self._fields[kind, label] = next((found for found in lineage if found), None)
        return self._fields[kind, label]

    def declares(self, label: str) -> bool:
        """Tell whether an attribute is one that the files themselves declare."""
        return label in self._owned or label in self._attributes

    def role(self, of: Type, kind: Kind, word: Word | None, player: Type, place: Place) -> Role:
        """Return the role of a relation that a player has.

        Args:
            of: the type of the relation.
            kind: what we make of it.
            word: what the role is called, or None if that is left out.
            player: the type of what plays it.
            place: where the player is written.
        """
        if kind not in ROLES:
            raise place.error(f"{of.label} is no relation; nothing plays a role in it")
        candidates = ROLES[kind] if word is None else self.roles(of, kind, word, place)
        fitting = [role for role in candidates if player.kind in role.kinds]
        if len(fitting) == 1 or (fitting and word is not None):
            return fitting[0]
        if fitting:
            names = ", ".join(role.name for role in fitting)
            raise place.error(f"what this {player.label} is in {of.label} is not clear; write one of the roles {names}")
        needed = ", ".join(dict.fromkeys(one.value for role in candidates for one in role.kinds))
        what = f"role `{word}`" if word else "a player"
        raise place.error(f"{what} of {of.label} can be: {needed}; not a thing of type {player.label}, as here")

    def roles(self, of: Type, kind: Kind, word: Word, place: Place) -> tuple[Role, ...]:
        """Return the roles that a word can mean; where the files declare one in words of their own, any of them."""
        name, declared = _word(word), False
        for one in of.lineage():
            if name in one.roles:
                declared = True
                name = one.roles[name] or name
        while True:
            found = tuple(role for role in ROLES[kind] if name in role.words or name.removesuffix("s") in role.words)
            first, _, rest = name.partition("-")
            if found or first not in QUALIFIERS or not rest:
                break
            name = rest
        if found or declared:
            return found or ROLES[kind]
        own = [role for one in of.lineage() for role in one.roles]
        known = list(dict.fromkeys([*own, *(role.name for role in ROLES[kind])]))
        raise place.error(f"{UnknownName(f'role of {of.label}', str(word), known)} (roles: {', '.join(known)})")

    def _spellings(self, label: str) -> Iterator[str]:
        seen: set[str] = set()
        while label not in seen:
            seen.add(label)
            yield label
            label = self._attributes.get(label, label)

    def _is_attribute(self, label: str) -> bool:
        return _plain(label) not in self._types and any(_field(kind, label) for kind in Kind)

    def _linked(self, label: str) -> None:
        chain = [label]
        while (top := str(self._parents[chain[-1]][0])) in self._parents and top not in _ROOTS:
            if top in chain:
                raise self._parents[label][1].error(f"{label} is declared a sort of itself: {' sub '.join(chain)}")
            chain.append(top)
        parent, place = self._parents[chain[-1]]
        if top == "attribute" or top in self._attributes or self._is_attribute(top):
            self._attributes.update((one, str(self._parents[one][0])) for one in chain)
            return
        above = None if top in _ROOTS else self.type(parent, place)
        for one in reversed(chain):
            own = self._types.setdefault(_plain(one), Type(one, above.kind if above else None))
            if above is not own:
                own.parent = above
            above = own


def place_of(file: str, word: Word) -> Place:
    """Return where a word stands."""
    return Place(file, word.line or 1, word.column or 1)


def _field(kind: Kind, label: str) -> Field | None:
    name = f"-{_word(label)}"
    found = [(len(ending), field) for field in FIELDS[kind] for ending in field.words if name.endswith(f"-{ending}")]
    return max(found, key=lambda one: one[0])[1] if found else None


def _plain(label: Word | str) -> str:
    return str(label).replace("-", "").replace("_", "").lower()


def _word(label: Word | str) -> str:
    return str(label).replace("_", "-").lower()
