"""Reads models from TypeQL 2 files, in the words of ROSA; imported late, for it needs lark.

A file becomes statements, by the grammar in `typeql.lark`; these become things, which are entities
and relations with attributes and players; and things become a model: first the elements, in order,
then the facts from the start. `typeql.toml` has ROSA's types, roles and attributes in all their
spellings. `match ... insert` finds things of earlier files by type and name.
"""

import math
import re
import tomllib
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from itertools import chain, count
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

from lark import Lark, Token, Tree, UnexpectedInput, UnexpectedToken

from kb import elements
from kb.elements import Configuration, Constraint, Element, Fact, finite_number
from kb.exceptions import UnknownName
from kb.files import DuplicateInFile, ModelFileError, Place, read_text
from kb.status import STATUSES, Status

ModelT = TypeVar("ModelT", bound=elements.Owner)
Literal = bool | int | float | str | datetime

WORDS: Final[Mapping[str, Any]] = tomllib.loads(
    Path(__file__).with_name("typeql.toml").read_text(encoding="utf-8")
)

# ---------------------------------------------------------------- statements

_CHANGING: Final = ("delete", "update", "undefine")
_READING: Final = ("get", "fetch", "aggregate", "group", "sort", "limit", "offset", *_CHANGING)
_ESCAPED: Final = {"n": "\n", "t": "\t", "r": "\r", "0": "\0", "\\": "\\", '"': '"', "'": "'"}


Statement = Tree[Token]


def _clauses(statement: Statement, name: str) -> list[Any]:
    """Return the contents of the clauses of a statement: "isa", "has" or "players"."""
    clauses = [clause for clause in statement.children if isinstance(clause, Tree)]
    return [clause.children for clause in clauses if clause.data == name]


def _subject(statement: Statement) -> str:
    """Return the variable of a statement, or a text of its own for a relation without one."""
    first = statement.children[0]
    return str(first) if isinstance(first, Token) else f"({id(statement)})"


def _literal(word: Token, place: Place) -> Literal:
    """Return the value of a literal; a date without a zone is in UTC."""
    text = str(word)
    if word.type == "TEXT":
        return re.sub(r"\\(u[0-9a-fA-F]{4}|[\s\S])", _unescaped, text[1:-1])
    if word.type == "BOOLEAN":
        return text == "true"
    try:
        if word.type == "DATE":
            moment = datetime.fromisoformat(text)
            return moment if moment.tzinfo else moment.replace(tzinfo=UTC)
        return int(text) if re.fullmatch(r"[+-]?\d+", text) else float(text)
    except ValueError as error:
        raise place.error(f"`{text:.40}` is not a value: {error!s:.60}") from None


def _unescaped(match: re.Match[str]) -> str:
    what = match[1]
    return chr(int(what[1:], 16)) if len(what) > 1 else _ESCAPED.get(what, f"\\{what}")


@cache
def _parser() -> Lark:
    return Lark.open("typeql.lark", rel_to=__file__, parser="lalr", lexer="contextual")


def parse(text: str, file: str) -> list[Tree[Token]]:
    """Read the queries of a file: `insert` or `match ... insert`.

    Raises:
        ModelFileError: the text is no TypeQL, or changes or reads a database.
    """
    try:
        queries = _parser().parse(text).children
        return [query for query in queries if isinstance(query, Tree) and query.data != "define"]
    except UnexpectedInput as error:
        raise _unexpected(text, file, error) from None


def _unexpected(text: str, file: str, error: Any) -> ModelFileError:  # noqa: ANN401  # of two classes
    """Return the error for what the parser did not expect."""
    is_token = isinstance(error, UnexpectedToken)
    allowed = (error.accepts or error.expected) if is_token else error.allowed
    names = sorted({name.strip("_").lower() for name in allowed} - {"$end"})
    expected = f"expected {', '.join(names)}"
    word = str(error.token) if is_token else text[error.pos_in_stream]
    if not word:
        end = Place(file, text.count("\n") + 1, len(text) - text.rfind("\n"))
        return end.error(f"the file ends here; {expected}")
    message = f"unexpected `{word:.40}`; {expected}"
    if word in _READING:
        does = "changes" if word in _CHANGING else "reads"
        message = f"`{word}` {does} a database; a model file only states: use `insert`"
    return ModelFileError(message, file, error.line, error.column)


def _place(file: str, where: Token | Statement) -> Place:
    """Return the place of a token, or of the first one in a statement."""
    word = where
    if not isinstance(word, Token):
        word = next(word.scan_values(lambda value: isinstance(value, Token)))
    return Place(file, word.line or 1, word.column or 1)


# ---------------------------------------------------------------- words


def _plain(label: str) -> str:
    return label.replace("-", "").replace("_", "").lower()


class Type(NamedTuple):
    """A type of thing, and the kind of things that it is."""

    label: str
    kind: str


_LABELS: Final = {**{kind: kind for kind in WORDS["roles"]}, **WORDS["types"]}
TYPES: Final = {
    _plain(label): Type(label, kind) for kind, labels in _LABELS.items() for label in labels.split()
}
"""ROSA's types by their labels without capitals, `-` and `_`."""


def _type_of(label: Token, place: Place) -> Type:
    if _plain(label) not in TYPES:
        labels = [each.label for each in TYPES.values()]
        raise place.error(str(UnknownName("type", str(label), labels)))
    return TYPES[_plain(label)]


@cache
def meanings(label: str, table: str, kind: str) -> list[str]:
    """Return the roles or attributes of a kind of thing that a label means by its ending."""
    ending = f"-{label.replace('_', '-').lower()}"
    fitting = [
        (len(word), name)
        for name, row in WORDS[table].get(kind, {}).items()
        for word in row["words"].split()
        if ending.endswith((f"-{word}", f"-{word}s"))
    ]
    longest, _ = max(fitting, default=(0, ""))
    return list(dict.fromkeys(name for length, name in fitting if length == longest))


# ---------------------------------------------------------------- things

_REPEATABLE: Final = ("status", "required", "selected", "active")
"""The attributes that may be stated again: they are facts, and the last statement counts."""
_VALUES: Final[Mapping[str, tuple[str, tuple[type, ...]]]] = {
    "text": ("a text in quotes", (str,)),
    "flag": ("true or false", (bool,)),
    "whole": ("a whole number", (int,)),
    "number": ("a number", (int, float)),
    "time": ("a date and time such as 2024-05-01T12:30:00", (datetime,)),
    "any": ("a text, a number or true or false", (str, bool, int, float)),
}
"""The sorts of values: their words in messages, and their Python types."""


class Own(NamedTuple):
    """The value of an attribute, and where it is stated."""

    label: str
    value: Any
    place: Place


@dataclass(slots=True, eq=False)
class Thing:
    """An entity or relation that a file inserts; its attributes and players by ROSA's names."""

    type: Type
    place: Place
    owns: dict[str, Own] = field(default_factory=dict)
    players: dict[str, list["Thing"]] = field(default_factory=lambda: defaultdict(list))

    @property
    def kind(self) -> str:
        return self.type.kind

    @property
    def name(self) -> str:
        return str(self.required("name"))

    def value(self, name: str, default: Any = None) -> Any:  # noqa: ANN401  # of any attribute
        return self.owns[name].value if name in self.owns else default

    def required(self, name: str) -> Any:  # noqa: ANN401  # of any attribute
        """Return the value of an attribute that must be there."""
        if name not in self.owns:
            what = f"this {self.type.label} has no {name}"
            raise self.place.error(f"{what}; write `has {self.kind}-{name} ...`")
        return self.owns[name].value

    def names(self, role: str) -> list[str]:
        return [player.name for player in self.players[role]]


class Things:
    """All things so far, by kind in order and by name; and notes of what is ignored."""

    def __init__(self) -> None:
        self.by_kind: dict[str, list[Thing]] = defaultdict(list)
        self.named: dict[str, dict[str, Thing]] = defaultdict(dict)
        self.notes: list[str] = []

    def note(self, place: Place, text: str) -> None:
        self.notes.append(f"{place}: {text}")

    def insert(self, query: Any, file: str) -> None:  # noqa: ANN401  # a tree of trees
        """Insert what a query says; its statements may use a variable before its declaration."""
        *patterns, inserted = query.children if query.data == "match" else [query]
        things = {_subject(pattern): self._matched(pattern, file) for pattern in patterns}
        for statement in inserted.children:
            for (label,) in _clauses(statement, "isa"):
                place = _place(file, label)
                subject = _subject(statement)
                if subject in things:
                    raise place.error(f"`{subject}` has a type already; a thing has one")
                things[subject] = Thing(_type_of(label, place), place)
                self.by_kind[things[subject].kind].append(things[subject])

        def resolve(word: str, place: Place) -> Thing:
            if word not in things:
                unknown = UnknownName("variable", word, things)
                raise place.error(f"{unknown}; a type is given by `{word} isa ...`")
            return things[word]

        for statement in inserted.children:
            thing = resolve(_subject(statement), _place(file, statement))
            for label, word in _clauses(statement, "has"):
                value = _literal(word, _place(file, word))
                self.give(thing, str(label), value, _place(file, label))
            for player in chain.from_iterable(_clauses(statement, "players")):
                *roles, variable = player.children
                role = next((word for word in roles[-1:] if word.type == "NAME"), None)
                place = _place(file, role or variable)
                self._play(thing, role, resolve(str(variable), _place(file, variable)), place)

    def _matched(self, pattern: Statement, file: str) -> Thing:
        """Return the thing of a pattern `$x isa TYPE, has NAME 'name'`."""
        place = _place(file, pattern)
        types = _clauses(pattern, "isa")
        names = _clauses(pattern, "has")
        if len(types) != 1 or len(names) != 1 or _clauses(pattern, "players"):
            what = "`match` finds things by type and name"
            raise place.error(f"{what}; write `$x isa Action, has action-name 'explore';`")
        kind = _type_of(types[0][0], place).kind
        name = str(_literal(names[0][1], place))
        if name not in self.named[kind]:
            raise place.error(f"`match` finds nothing: {UnknownName(kind, name, self.named[kind])}")
        return self.named[kind][name]

    def give(self, thing: Thing, label: str, value: Literal, place: Place) -> None:
        """Give a thing an attribute."""
        rows = WORDS["attributes"].get(thing.kind, {})
        meant = meanings(label, "attributes", thing.kind)
        if not meant:
            error = UnknownName(f"attribute of {thing.type.label}", label, rows)
            self.note(place, f"{error}; ignored")
            return
        name = rows[meant[0]]["field"]
        words, allowed = _VALUES[rows[meant[0]]["sort"]]
        is_flag = isinstance(value, bool) and bool not in allowed
        if is_flag or not isinstance(value, allowed):
            raise place.error(f"{label} is {words}, not {value!r:.60}")
        if isinstance(value, float) and not math.isfinite(value):
            raise place.error(f"{label} is a finite number, not {value!r}")
        if isinstance(value, datetime):
            value = value.timestamp()
        before = thing.owns.get(name)
        if before and name not in _REPEATABLE and before.value != value:
            earlier = f"{before.label} is {before.value!r} at {before.place}"
            if before.label == label:
                raise place.error(f"{label} is {value!r} here, and {earlier}")
            self.note(place, f"{label} is ignored: {earlier}")
            return
        thing.owns[name] = Own(label, value, place)
        if name == "name":
            first = self.named[thing.kind].setdefault(str(value), thing)
            if first is not thing:
                what = f"{thing.kind} {value!r} is declared already at {first.place}"
                raise DuplicateInFile(f"{what}; a name is unique", *place)

    def _play(self, thing: Thing, word: Token | None, player: Thing, place: Place) -> None:
        """Let a player take part in a relation, in the role of a word or that of its type."""
        rows = WORDS["roles"].get(thing.kind, {})
        names = list(rows) if word is None else meanings(word, "roles", thing.kind)
        fitting = [name for name in names if player.kind in rows[name]["by"]]
        if not fitting or (word is None and len(fitting) > 1):
            roles = [f"{name} ({' or '.join(row['by'])})" for name, row in rows.items()]
            what = f"{thing.type.label} has no clear role for type {player.type.label}"
            if word is not None and not names:
                what = str(UnknownName(f"role of {thing.type.label}", str(word), rows))
            raise place.error(f"{what}; roles: {', '.join(roles) or 'none'}")
        (role, *_) = fitting
        if thing.players[role] and rows[role].get("most") == 1:
            raise place.error(f"a second {role}; a {thing.type.label} has one")
        thing.players[role].append(player)

    def complete(self) -> None:
        """Refuse relations that lack a part, and name those that need a name."""
        for thing in self.by_kind["constraint"]:
            if "status" in thing.owns and not thing.players["attribute"]:
                attribute = Thing(TYPES["attribute"], thing.place)
                self.by_kind["attribute"].append(attribute)
                self._name(attribute, "unnamed attribute")
                thing.players["attribute"].append(attribute)
        for kind, roles in WORDS["roles"].items():
            for thing in self.by_kind[kind]:
                for role, row in roles.items():
                    if row.get("least", 1) > len(thing.players[role]):
                        write = f"write ({role}: $x, ...)"
                        raise thing.place.error(f"this {thing.type.label} has no {role}; {write}")
        for kind, owner in (
            ("function-design", "function"),
            ("component-configuration", "component"),
        ):
            for thing in self.by_kind[kind]:
                if "name" not in thing.owns:
                    self._name(thing, f"{thing.names(owner)[0]} {kind.split('-')[1]}")

    def _name(self, thing: Thing, stem: str) -> None:
        """Give a thing a name that no other of its kind has."""
        names = (f"{stem} {number}" for number in count(1))
        name = next(name for name in names if name not in self.named[thing.kind])
        self.give(thing, "name", name, thing.place)
        self.note(thing.place, f"this {thing.kind} has no name; it is called {name!r}")


# ---------------------------------------------------------------- a model

_CLASSES: Final = {cls: words.replace(" ", "-") for cls, words in list(elements.ROSA.items())[:8]}
"""The kind of things for each class of elements; each comes after those that it refers to."""
_ELEMENTS: Final = ("constrained", "causer")
"""The fields that hold elements; others hold names."""
_STATED: Final = ("name", "status", "required", "selected", "active", "pid")
_MEASURED: Final = ("value", "time", "latest")
_STEPS: Final = {
    "activate": ("component-activation", "component"),
    "deactivate": ("component-deactivation", "component"),
    "parameters": ("parameter-adaptation", "component-configuration"),
}
"""The kind of the steps for each field of a plan, and the role in each step."""


def load_typeql(
    cls: "Callable[[str], ModelT]", files: Sequence[Path], name: str | None
) -> "ModelT":
    """Read one model from files; each may add to those before it. See `Model.load`."""
    things = _Builder()
    for file in files:
        for query in parse(read_text(file), str(file)):
            things.insert(query, str(file))
    things.complete()
    names = [thing.name for thing in things.by_kind["robot-model"]]
    model = cls(name or [*names, files[0].stem][0])
    things.build(model)
    model.notes.extend(things.notes)
    return model


class _Builder(Things):
    """Builds a model from things."""

    def __init__(self) -> None:
        super().__init__()
        self._elements: dict[Thing, Any] = {}

    def build(self, model: elements.Owner) -> None:
        for cls, kind in _CLASSES.items():
            for thing in self.by_kind[kind]:
                with thing.place.blamed():
                    for values in self._fields(cls, thing):
                        element: Any = model.state(cls, values)
                        self._elements[thing] = element
                        model.places[element] = str(thing.place)
        for fact, place in self._facts():
            with place.blamed():
                model.add_fact(fact)

    def _fields(self, cls: type, thing: Thing) -> Iterator[dict[str, Any]]:
        """Yield the fields of the elements that a thing describes: one, or more estimations."""
        stated = _STATED + (_MEASURED if cls is elements.Attribute else ())
        values = {name: own.value for name, own in thing.owns.items() if name not in stated}
        for role, row in WORDS["roles"].get(thing.kind, {}).items():
            if "field" in row:
                players = thing.players[role]
                filled: list[Any] = [
                    self._elements[player] if row["field"] in _ELEMENTS else player.name
                    for player in players
                ]
                values[row["field"]] = filled[0] if filled and row.get("most") == 1 else filled
        if thing.type.label in WORDS["kinds"]:
            values["kind"] = WORDS["kinds"][thing.type.label]
        if cls is Configuration:
            values["parameters"] = _parameters(thing)
        elif cls is elements.Action:
            requirements = self.by_kind["functional-requirement"]
            required = [each for each in requirements if thing in each.players["action"]]
            values["functions"] = [
                name for each in required for name in each.names("required-function")
            ]
        elif cls is Constraint:
            values["operator"] = str(values.get("operator", ">=")).strip()
            values["value"] = (
                thing.value("value", 0.0) if "status" in thing.owns else thing.required("value")
            )
        elif cls is elements.Estimation:
            thing.required("value")
            kind = str(values.get("kind", "positive")).strip().lower()
            for attribute in values["attribute"]:
                for causer in values["causer"]:
                    yield {**values, "attribute": attribute, "causer": causer, "kind": kind}
            return
        if issubclass(cls, Element):
            values["name"] = thing.name
        yield values

    # ---------------------------------------------------------------- facts

    def _facts(self) -> Iterator[tuple[Fact, Place]]:
        """Yield the facts and their places."""
        for thing, element in self._elements.items():
            for name, own in thing.owns.items():
                for fact in self._stated(thing, element, name, own):
                    yield fact, own.place
        yield from self._measurements()
        for thing in self.by_kind["required-action"]:
            preferred: list[str] = []
            for player in thing.players["preferred-attribute"]:
                is_estimation = player.kind == "estimation"
                preferred += player.names("affected") if is_estimation else [player.name]
            for action in thing.names("action"):
                weights = dict.fromkeys(preferred, 1.0) or None
                request = elements.RequiredActionFact(action, weights, **self._period(thing))
                yield request, thing.place
        for thing in self.by_kind["component-process"]:
            if "pid" in thing.owns:
                for component in thing.names("component"):
                    period = (thing.value("start"), thing.value("end"))
                    process = elements.ProcessFact(component, thing.value("pid"), *period)
                    yield process, thing.place
        for thing in self.by_kind["reconfiguration-plan"]:
            steps: dict[str, Any] = {name: tuple(self._steps(thing, name)) for name in _STEPS}
            yield elements.PlanFact(**steps, **self._period(thing)), thing.place

    def _stated(self, thing: Thing, element: Any, name: str, own: Own) -> Iterator[Fact]:  # noqa: ANN401  # of any class
        if name == "pid":
            yield elements.ProcessFact(element.name, own.value)
        elif name == "active" and own.value:
            yield elements.ActiveFact(element.name)
        elif name == "required" and own.value:
            yield elements.RequiredFact(element)
        elif name == "selected" and own.value:
            yield elements.SelectedFact(element)
        elif name == "status":
            word = " ".join(re.split(r"[\s_-]+", own.value.strip().lower()))
            statuses = STATUSES[elements.KINDS[type(element)]]
            if word in statuses:
                yield elements.StatusFact(element, Status(word))
            else:
                unknown = UnknownName(
                    f"status of a {thing.type.label}", own.value, map(str, statuses)
                )
                self.note(own.place, f"{unknown}; not asserted")

    def _measurements(self) -> Iterator[tuple[Fact, Place]]:
        """Yield all measurements; the latest of an attribute is as stated, else the newest one."""
        measured: dict[str, list[Thing]] = defaultdict(list)
        for thing in self.by_kind["measurement"]:
            thing.required("value")
            for name in thing.names("measured-attribute"):
                measured[name].append(thing)
        for thing in self.by_kind["attribute"]:
            if "value" in thing.owns:
                measured[thing.name].append(thing)
        for name, things in measured.items():
            times = {thing: thing.value("time", 0.0) for thing in reversed(things)}
            newest = [thing for thing in times if "latest" not in thing.owns]
            latest = [thing for thing in things if thing.value("latest")]
            if newest and not latest:
                latest = [max(newest, key=times.__getitem__)]
            for thing in things:
                own = thing.owns["value"]
                time = thing.value("time")
                yield elements.MeasurementFact(name, own.value, time, thing in latest), own.place

    def _steps(self, whole: Thing, field: str) -> Iterator[str]:
        """Yield what a plan activates, deactivates or configures, by name."""
        kind, role = _STEPS[field]
        for name, players in whole.players.items():
            for player in players:
                if player.kind == "structural-adaptation":
                    yield from self._steps(player, field)
                elif player.kind == kind:
                    yield from player.names(role)
                elif name == kind:
                    yield player.name

    def _period(self, thing: Thing) -> dict[str, Any]:
        """Return the start, the end and the result of a request or a plan."""
        word = str(thing.value("result", "")).strip().lower()
        result = WORDS["results"].get(word)
        if word and not result:
            result = "abandoned"
            options = "there are completed, failed, abandoned"
            self.note(thing.place, f"{word!r} is not a result, and is read as {result}; {options}")
        return {"start": thing.value("start"), "end": thing.value("end"), "result": result}


def _parameters(configuration: Thing) -> dict[str, elements.Parameter]:
    values: dict[str, elements.Parameter] = {}
    for thing in configuration.players["parameter"]:
        key = thing.required("key")
        value = _parameter(thing)
        if values.setdefault(key, value) != value:
            raise thing.place.error(f"parameter {key!r} has two values in one configuration")
    return values


def _parameter(thing: Thing) -> elements.Parameter:
    """Return the value of a parameter as its type says."""
    value = thing.required("value")
    label = thing.value("type")
    if label is None:
        return value  # type: ignore[no-any-return]  # a literal
    word = _plain(label).removeprefix("parameter")
    fitting = [read for sort, read in _READERS.items() if word.startswith(sort)]
    if not fitting:
        sorts = elements.PARAMETER_TYPES.values()
        raise thing.place.error(str(UnknownName("parameter type", label, sorts)))
    (read,) = fitting
    try:
        if word.endswith(("array", "[]")):
            return [read(item) for item in _items(value)]  # type: ignore[return-value]  # all of one type
        return read(value)
    except (KeyError, TypeError, ValueError):
        raise thing.place.error(f"{value!r:.60} cannot be read as {label}") from None


_READERS: Final[Mapping[str, Callable[[Any], bool | int | float | str]]] = {
    "bool": lambda value: {"true": True, "false": False}[str(value).strip().lower()],
    "long": lambda value: int(str(value).removesuffix(".0")),
    "int": lambda value: int(str(value).removesuffix(".0")),
    "double": lambda value: finite_number(float(str(value))),
    "float": lambda value: finite_number(float(str(value))),
    "str": str,
}
"""How the values of parameters are read, by the beginnings of the names of types."""


def _items(value: object) -> list[str]:
    """Return the items of a list in brackets; texts need no quotes, unless they have a comma."""
    inner = re.fullmatch(r"\s*\[([\s\S]*)\]\s*", str(value))
    if inner is None:
        raise ValueError
    items = re.findall(r"""'([^']*)'|"([^"]*)"|([^\s,][^,]*)""", inner[1])
    return [single or double or bare.strip() for single, double, bare in items]
