"""Reads models from TypeQL 2 files, in the words of ROSA; imported late, for it needs lark.

A file is read in steps: `kb.typeql_syntax` (text to statements), here statements to things, which
are entities and relations with attributes and players, and things to a model: first the elements,
in order, then the facts from the start. Types, roles and attributes are ROSA's, in all spellings
of `typeql.toml`. `match ... insert` finds things of earlier files by type and name.
"""

import ast
import math
import re
import tomllib
from collections import defaultdict
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import cache
from importlib.resources import files
from itertools import count
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

from kb import elements, facts
from kb.elements import Attribute, Component, Configuration, Constraint, Element, finite_number
from kb.exceptions import UnknownName
from kb.facts import Fact
from kb.files import DuplicateInFile, Place, read_text
from kb.status import STATUSES, Status
from kb.typeql_syntax import Insert, Literal, Statement, Word, parse, place_of

ModelT = TypeVar("ModelT", bound=facts.Contents)

# ---------------------------------------------------------------- words

_WORDS: Final[dict[str, Any]] = tomllib.loads(
    files("kb").joinpath("typeql.toml").read_text(encoding="utf-8")
)
_QUALIFIERS: Final = frozenset(_WORDS["qualifiers"].split())
_KINDS: Final[Mapping[str, str]] = {
    "QualityAttribute": elements.AttributeKind.QUALITY,
    "EnvironmentalAttribute": elements.AttributeKind.ENVIRONMENTAL,
    "Component": elements.ComponentKind.PLAIN,
    "ROSNode": elements.ComponentKind.PROCESS,
    "LifeCycleNode": elements.ComponentKind.LIFECYCLE,
}
"""The kind of attribute or component for each type of things."""
_VALUES: Final[Mapping[str, tuple[str, tuple[type, ...]]]] = {
    "text": ("a text in quotes", (str,)),
    "flag": ("true or false", (bool,)),
    "whole": ("a whole number", (int,)),
    "number": ("a number", (int, float)),
    "time": ("a date and time such as 2024-05-01T12:30:00", (datetime,)),
    "any": ("a text, a number or true or false", (str, bool, int, float)),
}
"""The sorts of values of attributes: their words in messages, and their Python types."""


class Field(NamedTuple):
    """An attribute of a kind of thing: the field of an element, the sort of value, its spellings."""

    name: str
    value: str
    words: tuple[str, ...]


class Role(NamedTuple):
    """A role in a relation: the field that it fills, the kinds of its players, its spellings.

    A `most` of 0 means any number of players.
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
    kind: tuple(Field(name, value, tuple(words.split())) for name, value, words in own.values())
    for kind, own in _WORDS["attributes"].items()
}
_CLASSES: Final[Mapping[type, str]] = {
    cls: kind
    for cls, words in facts.ROSA.items()
    if (kind := words.replace(" ", "-")) in {*ROLES, *ATTRIBUTES}
}
"""The kind of each class of elements and facts; each comes after those that it refers to."""


class Type(NamedTuple):
    """A type of thing, and the kind of things that it is."""

    label: str
    kind: str


@cache
def _types() -> dict[str, Type]:
    """Return ROSA's types by their labels without capitals, `-` and `_`."""
    types = {_plain(kind): Type(kind, kind) for kind in ROLES}
    for label, above in _WORDS["entities"].items():
        is_type = above[0].isupper()
        types[_plain(label)] = Type(label, types[_plain(above)].kind if is_type else above)
    for alias, label in _WORDS["aliases"].items():
        types[_plain(alias)] = types[_plain(label)]
    return types


def type_of(label: Word | str, place: Place) -> Type:
    types = _types()
    found = types.get(_plain(label))
    if found is None:
        known = dict.fromkeys(each.label for each in types.values())
        raise place.error(str(UnknownName("type", str(label), known)))
    return found


def roles_of(of: Type, word: Word, place: Place) -> tuple[Role, ...]:
    """Return the roles that a word can mean."""
    every = ROLES.get(of.kind, ())
    name = _dashed(word)
    while name:
        names = {name, name.removesuffix("s")}
        roles = tuple(role for role in every if names & {*role.words})
        if roles:
            return roles
        first, _, rest = name.partition("-")
        name = rest if first in _QUALIFIERS else ""
    known = [role.name for role in every]
    error = UnknownName(f"role of {of.label}", str(word), known)
    raise place.error(f"{error} (roles: {', '.join(known)})")


def _role_of(of: Type, word: Word | None, player: Type, place: Place) -> Role:
    """Return the role of a player in a relation, by the word for the role, or else by its type."""
    every = ROLES.get(of.kind, ())
    if not every:
        raise place.error(f"{of.label} is no relation; nothing plays a role in it")
    candidates = every if word is None else roles_of(of, word, place)
    fitting = [role for role in candidates if player.kind in role.kinds]
    if len(fitting) == 1 or (fitting and word is not None):
        return fitting[0]
    if fitting:
        names = ", ".join(role.name for role in fitting)
        unclear = f"what this {player.label} is in {of.label} is not clear"
        raise place.error(f"{unclear}; write one of the roles {names}")
    needed = ", ".join(dict.fromkeys(kind for role in candidates for kind in role.kinds))
    what = f"role `{word}`" if word else "a player"
    other = f"not a thing of type {player.label}, as here"
    raise place.error(f"{what} of {of.label} can be: {needed}; {other}")


@cache
def field_of(kind: str, label: str) -> Field | None:
    """Return the attribute of a kind of thing that a label means, by its ending; None for none."""
    name = f"-{_dashed(label)}"
    best: tuple[int, Field | None] = (0, None)
    for each in ATTRIBUTES.get(kind, ()):
        for word in each.words:
            if name.endswith(f"-{word}") and len(word) > best[0]:
                best = (len(word), each)
    return best[1]


def _plain(label: Word | str) -> str:
    return str(label).replace("-", "").replace("_", "").lower()


def _dashed(label: Word | str) -> str:
    return str(label).replace("_", "-").lower()


# ---------------------------------------------------------------- things

_REPEATABLE: Final = frozenset({"status", "required", "selected", "active"})
"""The attributes that may be stated again: they are facts, and the last statement counts."""


class Own(NamedTuple):
    """An attribute of a thing, in the order of its statement; nameless if ROSA does not have it."""

    name: str
    label: str
    value: Literal
    place: Place
    order: int


class Part(NamedTuple):
    """A role that a thing plays in a relation; None in a relation that ROSA does not know."""

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
        if own is None:
            write = f"write `has {self.kind}-name '...'`"
            raise self.place.error(f"this {self.type.label} has no name; {write}")
        return str(own.value)

    def own(self, name: str) -> Own | None:
        """Return the attribute of a name that was stated last."""
        return next((own for own in reversed(self.owns) if own.name == name), None)

    def value(self, name: str) -> Literal | None:
        own = self.own(name)
        return own.value if own else None

    def players(self, role: str) -> "list[Thing]":
        return [part.thing for part in self.parts if part.role and part.role.name == role]


class Store:
    """All things so far, by kind in order and by name; and notes of what was ignored."""

    def __init__(self) -> None:
        self.things: dict[str, list[Thing]] = defaultdict(list)
        self.named: dict[str, dict[str, Thing]] = defaultdict(dict)
        self.notes: list[str] = []
        self._order = 0
        self._file = ""

    def note(self, place: Place, text: str) -> None:
        self.notes.append(f"{place}: {text}")

    def read(self, query: Insert, file: str) -> None:
        """Insert what a query says; its statements may use a variable before its declaration."""
        self._file = file
        things = {str(one.variable): self._matched(one) for one in query.patterns}
        subjects = [self._declared(things, statement) for statement in query.statements]
        for statement, declared in zip(query.statements, subjects, strict=True):
            self._order += 1
            thing = declared or self._thing(things, statement.word)
            thing.order = thing.order or self._order
            for has in statement.has:
                self.give(thing, str(has.label), has.value, self._place(has.label))
            for role, variable in statement.players:
                player = self._thing(things, variable)
                self._play(thing, role, player, self._place(role or variable))

    def give(self, thing: Thing, label: str, value: Literal, place: Place) -> None:
        meant = field_of(thing.kind, label)
        if meant is None:
            known = [each.words[0] for each in ATTRIBUTES.get(thing.kind, ())]
            error = UnknownName(f"attribute of {thing.type.label}", label, known)
            self.note(place, f"{error}; ignored")
            return
        own = Own(meant.name, label, _checked(meant, value, label, place), place, self._order)
        before = thing.own(meant.name)
        if before is not None and meant.name not in _REPEATABLE:
            if before.value != own.value and before.label == label:
                was = f"{before.value!r} at {before.place}"
                raise place.error(f"{label} is {own.value!r} here, and {was}")
            if before.value != own.value:
                said = f"{before.label} at {before.place} has said it"
                self.note(place, f"{label} is ignored: {said}")
            return
        thing.owns.append(own)
        if meant.name == "name":
            first = self.named[thing.kind].setdefault(str(own.value), thing)
            if first is not thing:
                what = f"{thing.kind} {own.value!r} is declared already at {first.place}"
                raise DuplicateInFile(f"{what}; a name is unique", *place)

    def _matched(self, pattern: Statement) -> Thing:
        """Return the thing of a pattern `$x isa TYPE, has NAME 'name'`."""
        place = self._place(pattern.word)
        wanted = None if pattern.isa is None else type_of(pattern.isa, self._place(pattern.isa))
        names = [
            has.value
            for has in pattern.has
            if wanted and (meant := field_of(wanted.kind, str(has.label))) and meant.name == "name"
        ]
        is_plain = pattern.variable is not None and len(names) == len(pattern.has) == 1
        if wanted is None or not is_plain:
            what = "`match` finds things by type and name"
            raise place.error(f"{what}; write `$x isa Action, has action-name 'explore';`")
        known = self.named[wanted.kind]
        if str(names[0]) not in known:
            error = UnknownName(wanted.kind, names[0], known)
            raise place.error(f"`match` finds nothing: {error}")
        return known[str(names[0])]

    def _declared(self, things: dict[str, Thing], statement: Statement) -> Thing | None:
        """Return the thing that a statement declares; None if it declares none."""
        if statement.isa is None:
            return None
        name = statement.variable
        if name in things:
            before = f"{name} already has the type {things[name].type.label}"
            why = f"{before}, at {things[name].place}; a thing has one"
            raise self._place(statement.word).error(why)
        place = self._place(statement.isa)
        thing = Thing(type_of(statement.isa, place), place)
        self.things[thing.kind].append(thing)
        if name:
            things[name] = thing
        return thing

    def _play(self, thing: Thing, word: Word | None, player: Thing, place: Place) -> None:
        role = _role_of(thing.type, word, player.type, place)
        if role.most and len(thing.players(role.name)) >= role.most:
            raise place.error(f"a second {role.name}; a {thing.type.label} has one")
        thing.parts.append(Part(role, player))

    def _thing(self, things: dict[str, Thing], word: Word) -> Thing:
        if str(word) not in things:
            unknown = f"unknown variable '{word}'"
            what = str(UnknownName("variable", str(word), things)) if things else unknown
            raise self._place(word).error(f"{what}; a type is given by `{word} isa ...`")
        return things[str(word)]

    def _place(self, word: Word) -> Place:
        return place_of(self._file, word)


def shown(value: Literal) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"the date {value.isoformat()}" if isinstance(value, datetime) else f"{value!r:.60}"


def _checked(meant: Field, value: Literal, label: str, place: Place) -> Literal:
    words, allowed = _VALUES[meant.value]
    if isinstance(value, float) and allowed == (int,) and value.is_integer():
        return int(value)
    if not isinstance(value, allowed) or (isinstance(value, bool) and bool not in allowed):
        raise place.error(f"{label} is {words}, not {shown(value)}")
    if isinstance(value, float) and not math.isfinite(value):
        raise place.error(f"{label} is a finite number, not {value!r}")
    return value


# ---------------------------------------------------------------- a model

_STATED: Final = frozenset(
    {"", "name", "status", "required", "selected", "active", "pid", "value", "time", "latest"}
)
"""The attributes that are no fields of an element: facts, its name, and what ROSA does not have."""
_FLAGS: Final[Mapping[str, Callable[[Any], Fact]]] = {
    "required": facts.RequiredFact,
    "selected": facts.SelectedFact,
    "active": lambda component: facts.ActiveFact(component.name),
}
"""The fact that each flag of an element states."""
_STEPS: Final = {
    "component-activation": ("component", "activate", Component),
    "component-deactivation": ("component", "deactivate", Component),
    "parameter-adaptation": ("component-configuration", "parameters", Configuration),
}
"""The kinds of steps of a plan: the role in each, the field of the plan, and the class of the players."""
_RESULTS: Final[Mapping[str, str]] = {
    **dict.fromkeys(
        ("completed", "complete", "success", "succeeded", "successful", "done"), "completed"
    ),
    **dict.fromkeys(("failed", "failure", "error", "aborted"), "failed"),
    **dict.fromkeys(("abandoned", "cancelled", "canceled", "interrupted"), "abandoned"),
}


def load_typeql(
    cls: "Callable[[str], ModelT]", files: Sequence[Path], name: str | None
) -> "ModelT":
    """Read one model from files; each may add to those before it. See `Model.load`."""
    store = Store()
    for file in files:
        for query in parse(read_text(file), str(file)):
            store.read(query, str(file))
    _complete(store)
    said = (one.name for one in store.things["robot-model"])
    model = cls(name if name is not None else next(said, files[0].stem))
    _Reading(model, store).run()
    model.notes.extend(store.notes)
    return model


def _complete(store: Store) -> None:
    """Refuse relations that lack a part, and name the designs and configurations without a name."""
    for kind, roles in ROLES.items():
        for thing in store.things[kind]:
            for role in roles:
                if len(thing.players(role.name)) < role.least and not _only_states(thing):
                    raise thing.place.error(
                        f"this {thing.type.label} has no {role.name}; write ({role.name}: $x, ...)"
                    )
    for kind in ("function-design", "component-configuration"):
        whole, _, what = kind.partition("-")
        for thing in store.things[kind]:
            if thing.own("name") is None:
                name = _unused(f"{thing.players(whole)[0].name} {what}", store.named[kind])
                store.give(thing, "name", name, thing.place)
                store.note(
                    thing.place, f"this {thing.type.label} has no name; it is called {name!r}"
                )


def _only_states(thing: Thing) -> bool:
    """Return whether a constraint only has a status and something constrained, so it need not compare anything."""
    return (
        thing.kind == "constraint"
        and thing.own("status") is not None
        and bool(thing.players("constrained"))
    )


Stated = tuple[int, Fact, Place]
"""The number of a statement, its fact, and its place."""


class _Reading:
    """Builds a model from the things of a store."""

    def __init__(self, model: facts.Contents, store: Store) -> None:
        self.model, self.store = model, store
        self.elements: dict[Thing, Element | Constraint] = {}

    def run(self) -> None:
        required = self._required_functions()
        for cls, kind in _CLASSES.items():
            for thing in self.store.things[kind] if issubclass(cls, Element) else ():
                with thing.place.blamed():
                    is_action = cls is elements.Action
                    given = (
                        {"functions": required.get(thing, [])}
                        if is_action
                        else self._fields(cls, thing)
                    )
                    self._keep(thing, self.model.declare(cls, thing.name, **given))
        for thing in self.store.things["constraint"]:
            with thing.place.blamed():
                self._keep(thing, self._constraint(thing))
        for thing in self.store.things["estimation"]:
            with thing.place.blamed():
                self._estimate(thing)
        for _, fact, place in sorted(self._facts(), key=lambda one: one[0]):
            with place.blamed():
                self.model.add_fact(fact)

    def _keep(self, thing: Thing, element: Element | Constraint) -> None:
        self.elements[thing] = element
        self.model.places[element] = str(thing.place)

    def _required_functions(self) -> dict[Thing, list[str]]:
        """Return the functions that each action requires, which several relations may name."""
        required: dict[Thing, list[str]] = {}
        for relation in self.store.things["functional-requirement"]:
            for action in relation.players("action"):
                required.setdefault(action, []).extend(_names(relation, "required-function"))
        return required

    def _fields(self, cls: type[Element], thing: Thing) -> dict[str, Any]:
        given: dict[str, Any] = {
            own.name: own.value for own in thing.owns if own.name not in _STATED
        }
        for role in ROLES.get(_CLASSES[cls], ()):
            if role.field:
                names = _names(thing, role.name)
                given[role.field] = names[0] if role.most == 1 else names
        if cls in (Attribute, Component):
            given |= {"kind": _KINDS[thing.type.label]} if thing.type.label in _KINDS else {}
        if cls is Configuration:
            given["parameters"] = _parameters(thing)
        return given

    def _constraint(self, thing: Thing) -> Constraint:
        sign = str(thing.value("operator") or ">=").strip()
        attributes = _names(thing, "attribute") or [self._stand_in(thing)]
        value = _number(thing, "value", 0.0 if _only_states(thing) else None)
        constrained = [self.elements[one] for one in thing.players("constrained")]
        with (thing.own("operator") or thing).place.blamed():
            expression = elements.Expression(attributes[0], sign, value, self.model).steady(
                hysteresis=_number(thing, "hysteresis", 0.0), dwell=_number(thing, "dwell", 0.0)
            )
        return self.model.constrain(constrained, expression)  # type: ignore[arg-type]  # the role lets no other in

    def _stand_in(self, thing: Thing) -> str:
        name = _unused("unnamed attribute", self.store.named["attribute"])
        self.store.note(
            thing.place, f"this constraint has a status and no attribute; it is given {name!r}"
        )
        self.store.named["attribute"][name] = thing
        return self.model.declare(Attribute, name).name

    def _estimate(self, thing: Thing) -> None:
        value, kind = _number(thing, "value"), thing.own("kind")
        for attribute in _names(thing, "affected"):
            for causer in thing.players("causer"):
                with (kind or thing).place.blamed():
                    sense = str(kind.value).strip().lower() if kind else "positive"
                    self.model.add_estimation(self.elements[causer], attribute, value, sense)  # type: ignore[arg-type]  # the role lets no other in

    def _facts(self) -> Iterator[Stated]:
        for thing, element in self.elements.items():
            for own in thing.owns:
                fact = self._stated(thing, element, own)
                if fact is not None:
                    yield own.order, fact, own.place
        yield from self._measurements()
        for thing in self.store.things["required-action"]:
            preference = _preference(thing)
            for name in _names(thing, "action"):
                requested = facts.RequiredActionFact(
                    name, preference, **_period(thing), result=self._result(thing)
                )
                yield thing.order, requested, thing.place
        for thing in self.store.things["component-process"]:
            pid = thing.value("pid")
            if isinstance(pid, int):
                (name,) = _names(thing, "component")
                yield thing.order, facts.ProcessFact(name, pid, **_period(thing)), thing.place
            else:
                self.store.note(thing.place, f"this {thing.type.label} has no pid; it is ignored")
        for thing in self.store.things["reconfiguration-plan"]:
            yield thing.order, self._plan(thing), thing.place

    def _stated(self, thing: Thing, element: Any, own: Own) -> Fact | None:  # noqa: ANN401  # what has such a field
        if own.name == "pid":
            return facts.ProcessFact(element.name, own.value)  # type: ignore[arg-type]  # a whole number: checked
        if own.name in _FLAGS:
            return _FLAGS[own.name](element) if own.value is True else None
        if own.name != "status":
            return None
        word = " ".join(str(own.value).replace("_", " ").replace("-", " ").lower().split())
        known = STATUSES[elements.KINDS[type(element)]]
        if word in known:
            return facts.StatusFact(element, Status(word))
        unknown = UnknownName(f"status of a {thing.type.label}", own.value, map(str, known))
        self.store.note(
            own.place, f"{unknown}; not asserted"
        )  # no error: other programs read such files too
        return None

    def _measurements(self) -> Iterator[Stated]:
        """Yield all measurements; the latest of an attribute is as stated, else the newest, stated last."""
        measured: dict[str, list[Thing]] = {}
        for thing in self.store.things["measurement"]:
            for name in _names(thing, "measured-attribute"):
                measured.setdefault(name, []).append(thing)
        for thing in self.store.things["attribute"]:
            if thing.own("value"):
                measured.setdefault(thing.name, []).append(thing)
        for name, things in measured.items():
            unsaid = [thing for thing in things if thing.own("latest") is None]
            if any(thing.value("latest") is True for thing in things):
                unsaid = []
            newest = max(
                unsaid, key=lambda thing: (_time(thing, "time") or 0.0, _order(thing)), default=None
            )
            for thing in things:
                own = thing.own("value")
                if own is None:
                    raise thing.place.error(
                        f"this {thing.type.label} has no value; write `has measurement-value 0.5`"
                    )
                latest = thing is newest or thing.value("latest") is True
                fact = facts.MeasurementFact(name, own.value, _time(thing, "time"), latest)  # type: ignore[arg-type]  # a number: checked
                yield _order(thing), fact, own.place

    def _plan(self, thing: Thing) -> facts.PlanFact:
        steps: dict[str, Any] = {
            field: self._steps(thing, kind, role) for kind, (role, field, _) in _STEPS.items()
        }
        return facts.PlanFact(**steps, **_period(thing), result=self._result(thing))

    def _steps(self, whole: Thing, kind: str, role: str) -> tuple[str, ...]:
        """Return what a plan activates, deactivates or configures, by name: in steps of a kind, or in a role."""
        names: list[str] = []
        for one in whole.parts:
            if one.thing.kind == "structural-adaptation":
                names += self._steps(one.thing, kind, role)
            elif one.thing.kind == kind:
                names += (chosen := _names(one.thing, role))
                if not chosen:
                    self.store.note(
                        one.thing.place,
                        f"this {one.thing.type.label} names no {role}; it is ignored",
                    )
            elif (
                one.thing.kind in ("component", "component-configuration")
                and one.role
                and one.role.name == kind
            ):
                names.append(one.thing.name)
        return tuple(names)

    def _result(self, thing: Thing) -> str | None:
        own = thing.own("result")
        word = str(own.value).strip().lower() if own else ""
        if own is None or not word:
            return None
        if word not in _RESULTS:
            message = f"{own.value!r} is not a result, and is read as abandoned; there are completed, failed, abandoned"
            self.store.note(own.place, message)
        return _RESULTS.get(word, "abandoned")


def _names(thing: Thing, role: str) -> list[str]:
    return [one.name for one in thing.players(role)]


def _number(thing: Thing, name: str, default: float | None = None) -> float:
    value = thing.value(name)
    if isinstance(value, int | float):
        return value
    if default is None and thing.kind:
        raise thing.place.error(
            f"this {thing.type.label} has no {name}; write `has {thing.kind}-{name} 0.5`"
        )
    return default or 0.0


def _order(measured: Thing) -> int:
    own = measured.own("value")
    return own.order if own and measured.kind == "attribute" else measured.order


def _time(thing: Thing, name: str) -> float | None:
    """Return a time in seconds since 1970-01-01 UTC."""
    value = thing.value(name)
    if not isinstance(value, datetime):
        return None
    return (value - datetime(1970, 1, 1, tzinfo=UTC)) / timedelta(seconds=1)


def _period(thing: Thing) -> dict[str, Any]:
    return {"start": _time(thing, "start"), "end": _time(thing, "end")}


def _preference(thing: Thing) -> dict[str, float] | None:
    """Return the weight of each preferred attribute, 1; an estimation means its attribute."""
    names: list[str] = []
    for player in thing.players("preferred-attribute"):
        names += _names(player, "affected") if player.kind == "estimation" else [player.name]
    return dict.fromkeys(names, 1.0) or None


def _parameters(configuration: Thing) -> dict[str, elements.Parameter]:
    values: dict[str, elements.Parameter] = {}
    for one in configuration.players("parameter"):
        key, value, sort = one.own("key"), one.own("value"), one.value("type")
        if key is None or value is None:
            missing = "key" if key is None else "value"
            raise one.place.error(
                f"this {one.type.label} has no {missing}; write `has parameter-{missing} '...'`"
            )
        read = _parameter(value.value, None if sort is None else str(sort), value.place)
        if values.setdefault(str(key.value), read) != read:
            raise one.place.error(f"parameter {key.value!r} has two values in one configuration")
    return values


def _parameter(value: Literal, type_name: str | None, place: Place) -> elements.Parameter:
    if type_name is None:
        return value  # type: ignore[return-value]  # no date: it was checked
    word = (
        re.sub(r"[-\s]", "_", type_name.strip().lower())
        .removeprefix("parameter_")
        .replace("[]", "_array")
    )
    read = _READERS.get(word.removesuffix("_array"))
    if read is None:
        known = [
            *elements.PARAMETER_TYPES.values(),
            *(f"{one}_array" for one in elements.PARAMETER_TYPES.values()),
        ]
        raise place.error(str(UnknownName("parameter type", type_name, known)))
    try:
        if word.endswith("_array"):
            return [read(item) for item in _items(value, word)]  # type: ignore[return-value]  # all of one type
        return read(value)
    except (ValueError, KeyError, TypeError):
        raise place.error(f"{shown(value)} cannot be read as {type_name}") from None


def _whole(value: object) -> int:
    number = value if isinstance(value, float) else int(str(value))
    if number != int(number):
        raise ValueError
    return int(number)


_READERS: Final[Mapping[str, Callable[[object], bool | int | float | str]]] = {
    **dict.fromkeys(
        ("boolean", "bool"),
        lambda value: {"true": True, "false": False}[str(value).strip().lower()],
    ),
    **dict.fromkeys(("long", "integer", "int"), _whole),
    **dict.fromkeys(("double", "float"), lambda value: finite_number(float(str(value)))),
    **dict.fromkeys(
        ("string", "str"),
        lambda value: str(value).lower() if isinstance(value, bool) else str(value),
    ),
}


def _items(value: Literal, word: str) -> list[object]:
    """Return the items of a list in the form of Python or JSON; texts may be without quotes, and stay as written."""
    if not isinstance(value, str):
        return [value]
    with suppress(ValueError, SyntaxError, RecursionError, MemoryError):
        items = ast.literal_eval(value.strip())
        if isinstance(items, list) and (
            not word.startswith("str") or all(isinstance(item, str) for item in items)
        ):
            return items
    inner = re.fullmatch(r"\s*\[\s*([\s\S]*?)\s*\]\s*", value)
    if inner is None:
        raise ValueError
    return [item.strip().strip("'\"") for item in inner[1].split(",")] if inner[1] else []


def _unused(stem: str, taken: Container[str]) -> str:
    return next(name for number in count(1) if (name := f"{stem} {number}") not in taken)
