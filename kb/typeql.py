"""Reads models from TypeQL 2 files, in the words of ROSA; imported late, for it needs lark.

A file becomes statements, by the grammar in `typeql.lark`; these become things, which are entities
and relations; and things become a model: first the elements, in order, then the facts from the
start. `typeql.toml` has ROSA's types, roles and attributes, and the fields that they fill.
`match ... insert` finds things of earlier files by their attributes.
"""

import dataclasses
import re
import tomllib
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any, Final, TypeVar

from lark import Lark, Token, Tree, UnexpectedInput, UnexpectedToken

from kb import elements
from kb.exceptions import UnknownName
from kb.files import ModelFileError, Place, read_text

ModelT = TypeVar("ModelT", bound=elements.Owner)
Query = Any  # a tree of lark

_ROSA: Final = tomllib.loads(Path(__file__).with_name("typeql.toml").read_text(encoding="utf-8"))
_TYPES: Final[Mapping[str, str]] = _ROSA["types"]
_WORDS: Final[Mapping[str, Mapping[str, str]]] = _ROSA["words"]
_STATED: Final[Mapping[str, type]] = {
    "is-required": elements.RequiredFact,
    "is-selected": elements.SelectedFact,
    "is-active": elements.ActiveFact,
}
"""The facts about an element that are stated with it."""
_READERS: Final[Mapping[str, Callable[[str], bool | int | float | str]]] = {
    "boolean": lambda text: {"true": True, "false": False}[text.lower()],
    "long": int,
    "double": float,
    "string": str,
}
"""How the values of parameters are read, by type."""


@cache
def _parser() -> Lark:
    return Lark.open("typeql.lark", rel_to=__file__, parser="lalr", lexer="contextual")


def parse(text: str, file: str) -> list[Query]:
    """Read the queries of a file: `insert` or `match ... insert`.

    Raises:
        ModelFileError: the text is no TypeQL, or changes or reads a database.
    """
    try:
        queries: list[Query] = _parser().parse(text).children
    except UnexpectedInput as caught:
        error: Any = caught  # of two classes
        is_token = isinstance(error, UnexpectedToken)
        allowed = error.accepts or error.expected if is_token else error.allowed
        names = sorted({name.strip("_").lower() for name in allowed} - {"$end"})
        word = str(error.token) if is_token else text[error.pos_in_stream]
        what = f"unexpected `{word:.40}`" if word else "the file ends here"
        why = f"{what}; expected {', '.join(names)}"
        raise ModelFileError(why, file, error.line, error.column) from None
    return [query for query in queries if query.data == "insert"]


def _literal(word: Token, place: Place) -> bool | int | float | str:
    """Return the value of a literal; a date is in UTC, and becomes seconds since 1970."""
    text = str(word)
    if word.type == "TEXT":
        return re.sub(r"""\\(['"\\])""", r"\1", text[1:-1])
    if word.type == "BOOLEAN":
        return text == "true"
    try:
        if word.type == "DATE":
            return datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()
        return int(text) if text.lstrip("+-").isdigit() else float(text)
    except ValueError as error:
        raise place.error(f"`{text:.40}` is not a value: {error!s:.60}") from None


@dataclasses.dataclass(eq=False)
class Thing:
    """An entity or relation that a file states: its kind, and its attributes and players."""

    kind: str
    place: Place
    fields: dict[str, Any] = dataclasses.field(default_factory=dict)


def load_typeql(cls: "Callable[[str], ModelT]", files: Sequence[Path]) -> "ModelT":
    """Read one model from files; each may add to those before it. See `Model.load`."""
    builder = _Builder()
    for file in files:
        for query in parse(read_text(file), str(file)):
            builder.insert(query, str(file))
    model = cls(files[0].stem)
    builder.build(model)
    return model


class _Builder:
    """Gathers things by kind, and builds a model from them."""

    def __init__(self) -> None:
        self._things: dict[str, list[Thing]] = defaultdict(list)
        self._elements: dict[Thing, Any] = {}
        self._notes: list[str] = []

    def insert(self, query: Query, file: str) -> None:
        """Insert what a query states; its patterns stand for things of earlier files."""
        patterns, statements = query.children
        variables: dict[object, Thing] = {}
        if patterns is not None:
            self._describe(patterns.children, file, variables)
            for variable, pattern in variables.items():
                variables[variable] = self._matched(pattern)
        for thing in self._describe(statements.children, file, variables):
            self._things[thing.kind].append(thing)

    def _describe(
        self, statements: Iterable[Query], file: str, variables: dict[object, Thing]
    ) -> list[Thing]:
        """Return the new things of statements, which may use a variable before its declaration."""
        added: list[Thing] = []
        stated: list[tuple[Any, Query]] = []
        for statement in statements:
            subject, *clauses = statement.children
            if isinstance(subject, Tree):  # a relation without a variable
                clauses.insert(0, subject)
            key = subject if isinstance(subject, Token) else id(statement)
            for clause in clauses:
                if clause.data != "isa":
                    stated.append((key, clause))
                    continue
                thing = _thing(clause.children[0], file)
                if key in variables:
                    raise thing.place.error(f"`{key}` has a type already; a thing has one")
                variables[key] = thing
                added.append(thing)

        def resolve(variable: Token) -> Thing:
            if variable not in variables:
                known = [str(key) for key in variables if isinstance(key, str)]
                unknown = UnknownName("variable", str(variable), known)
                what = f"{unknown}; a type is given by `{variable} isa ...`"
                raise _place(file, variable).error(what)
            return variables[variable]

        for key, clause in stated:
            thing = resolve(key)
            if clause.data == "has":
                label, word = clause.children
                self._fill(thing, label, _literal(word, _place(file, word)), file)
            else:
                for player in clause.children:
                    role, variable = player.children
                    self._fill(thing, role, resolve(variable), file)
        return added

    def _fill(self, thing: Thing, word: Token, value: object, file: str) -> None:
        """Fill the field that an attribute or role means."""
        place = _place(file, word)
        words = _WORDS[thing.kind]
        if word not in words:
            what = "role" if isinstance(value, Thing) else "attribute"
            unknown = UnknownName(f"{what} of {thing.kind}", str(word), words)
            if isinstance(value, Thing):
                raise place.error(str(unknown))
            self._notes.append(f"{place}: {unknown}; ignored")
            return
        name, several, _ = words[word].partition("*")
        if several:
            thing.fields.setdefault(name, []).append(value)
        elif thing.fields.setdefault(name, value) is not value:
            raise place.error(f"a second {word}; a {thing.kind} has one")

    def _matched(self, pattern: Thing) -> Thing:
        """Return the thing that has all attributes of a pattern."""
        things = self._things[pattern.kind]
        for thing in things:
            if pattern.fields and pattern.fields.items() <= thing.fields.items():
                return thing
        name = pattern.fields.get("name")
        names = [str(thing.fields.get("name")) for thing in things]
        unknown = UnknownName(pattern.kind, name, names)
        raise pattern.place.error(f"`match` finds nothing: {unknown}")

    # ---------------------------------------------------------------- a model

    def build(self, model: elements.Owner) -> None:
        for kind in ("reconfiguration-plan", "component-process"):
            for thing in self._things[kind]:
                self._notes.append(f"{thing.place}: a model has no {kind}; ignored")
        model.notes.extend(self._notes)
        for cls, words in elements.ROSA.items():
            for thing in self._things[words.replace(" ", "-")]:
                with thing.place.blamed():
                    self._state(model, cls, thing)

    def _state(self, model: elements.Owner, cls: type, thing: Thing) -> None:
        """Declare what a thing describes, and the facts that are stated with it."""
        values = dict(thing.fields)
        if cls is elements.Configuration:
            values["parameters"] = _parameters(values.get("parameters", ()))
        elif cls is elements.Action:
            requirements = self._things["functional-requirement"]
            mine = [each.fields for each in requirements if each.fields.get("action") is thing]
            values["functions"] = [name for each in mine for name in each.get("functions", ())]
        elif cls is elements.Constraint:
            values.setdefault("operator", ">=")
        elif cls is elements.MeasurementFact:
            stated = [each.fields for each in self._things[thing.kind] if "latest" in each.fields]
            is_latest = values.get("attribute") not in [
                each["attribute"] for each in stated if each["latest"]
            ]
            values.setdefault("latest", is_latest)
        values = {name: self._element(value, thing) for name, value in values.items()}
        if "preference" in values:
            values["preference"] = {each.name: 1.0 for each in values["preference"]}
        status = values.pop("status", None)
        flags = {name: values.pop(name) for name in _STATED if name in values}
        element: Any = model.state(cls, values)
        if cls in elements.KINDS:
            self._elements[thing] = element
            model.places[element] = str(thing.place)
        if status is not None:
            model.state(elements.StatusFact, {"element": element, "status": status})
        for name, value in flags.items():
            if elements.flag(name, value):
                field = "component" if name == "is-active" else "element"
                model.state(_STATED[name], {field: element})

    def _element(self, value: Any, thing: Thing) -> Any:  # noqa: ANN401  # of any field
        """Return the value of a field with elements in place of the things that became these."""
        if isinstance(value, list):
            return [self._element(item, thing) for item in value]
        if not isinstance(value, Thing):
            return value
        if value not in self._elements:
            raise thing.place.error(f"a {thing.kind} has no role for a {value.kind}")
        return self._elements[value]


def _place(file: str, word: Token) -> Place:
    return Place(file, word.line or 1, word.column or 1)


def _thing(label: Token, file: str) -> Thing:
    """Return a new thing of a type."""
    place = _place(file, label)
    if label not in _TYPES:
        raise place.error(str(UnknownName("type", str(label), _TYPES)))
    kind, *sorts = _TYPES[label].split()
    return Thing(kind, place, dict(zip(["kind"], sorts, strict=False)))


def _parameters(things: Iterable[Thing]) -> dict[str, Any]:
    """Return the values of parameters by key."""
    values: dict[str, Any] = {}
    for thing in things:
        key = thing.fields.get("key")
        value = thing.fields.get("value")
        if key is None or value is None:
            raise thing.place.error("a parameter has a parameter-key and a parameter-value")
        if key in values:
            raise thing.place.error(f"parameter {key!r} has two values in one configuration")
        values[key] = _parameter(value, thing)
    return values


def _parameter(value: Any, thing: Thing) -> Any:  # noqa: ANN401  # a literal
    """Return the value of a parameter as its type says."""
    label = thing.fields.get("type")
    if label is None:
        return value
    sort = str(label).removesuffix("_array")
    if sort not in _READERS:
        raise thing.place.error(str(UnknownName("parameter type", label, _READERS)))
    read = _READERS[sort]
    try:
        if sort == label:
            return read(str(value))
        items = [item.strip(" '\"") for item in str(value).strip("[] ").split(",")]
        return [read(item) for item in items if item]
    except (KeyError, ValueError):
        raise thing.place.error(f"{value!r:.60} cannot be read as {label}") from None
