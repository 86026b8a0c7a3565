"""What `match` finds among the things inserted so far: every way in which all of its statements hold together."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from typing import Final, TypeVar

from kb.exceptions import UnknownName
from kb.files import ModelFileError, Place
from kb.typeql.store import ANONYMOUS, Bindings, Store, Thing
from kb.typeql.syntax import Clause, Equal, Has, Isa, Literal, Player, Players, Statement, Word, place_of
from kb.typeql.vocabulary import Kind, Type, field_of

T = TypeVar("T")
Found = dict[str, Thing | Literal]

MOST: Final = 100_000
"""How many answers a `match` may have on the way; more are a slip, and would multiply without limit."""


def answers(store: Store, patterns: Sequence[Statement], file: str) -> list[Bindings]:
    """Return what the variables can stand for; at least one answer.

    Raises:
        ModelFileError: nothing matches; the message says what was looked for and what there is.
    """
    return _Question(store, file).answers(patterns)


class _Question:
    """What one `match` asks."""

    def __init__(self, store: Store, file: str) -> None:
        self.store, self.file = store, file

    def answers(self, patterns: Sequence[Statement]) -> list[Bindings]:
        """The most telling statements come first: those with a name, then relations."""
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
        kind = self._kind(one)
        for clause in one.clauses if kind else ():
            if (
                isinstance(clause, Has)
                and isinstance(clause.value, str)
                and not isinstance(clause.value, Word)
                and kind
            ):
                field = field_of(kind, str(clause.label))
                if field and field.name == "name":
                    return clause.value
        return None

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
