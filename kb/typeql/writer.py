"""Writes a model as TypeQL: one `insert`, after a `define` of the attributes that ROSA's schema does not have."""

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from datetime import UTC, datetime, timedelta
from typing import Final

from kb.elements import (
    Action,
    Changeable,
    Component,
    Configuration,
    Element,
    Estimation,
    Function,
    called,
    parameter_type,
)
from kb.exceptions import ModelError
from kb.facts import ROSA, ActiveFact, Contents, Fact, PlanFact, RequiredFact, SelectedFact, StatusFact
from kb.typeql.vocabulary import ATTRIBUTES, CLASSES, EXTENSIONS, ROLES, SPECIAL, Field, seconds

_STEPS: Final = {
    "component-activation": ("component", "activate", Component),
    "component-deactivation": ("component", "deactivate", Component),
    "parameter-adaptation": ("component-configuration", "parameters", Configuration),
}
"""The kinds of steps of a plan: the role in each, the field of the plan, and the class of the players."""
_ELEMENTS: Final = {kind: cls for cls, kind in CLASSES.items()}
_FLAGS: Final[Mapping[type, str]] = {RequiredFact: "is-required true", SelectedFact: "is-selected true"}
_DEFAULTS: Final = {cls: {field.name: field.default for field in fields(cls)} for cls in CLASSES}
_FIELDS: Final = {
    cls: [field for field in ATTRIBUTES[kind] if field.name in ("weights", *_DEFAULTS[cls])]
    for cls, kind in CLASSES.items()
}
_UNSAFE: Final = re.compile(r'[\\"\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]')
_ESCAPES: Final = {"\n": "\\n", "\t": "\\t", "\r": "\\r", "\\": "\\\\", '"': '\\"'}


def typeql_text(model: Contents) -> str:
    """Write a model so that reading gives the same model; see `Model.save`."""
    statements = "\n".join(_Writer(model).lines())
    own = []
    for label, (value, *owners) in EXTENSIONS.items():
        if f"has {label} " in statements:
            own += [f"{label} sub attribute, value {value};", *(f"{owner};" for owner in owners)]
    return "\n".join(["define", "# beyond ROSA's schema", *own, "", "insert", statements, ""])


class _Writer:
    """Writes the statements of a model; each element has a variable that later statements use."""

    def __init__(self, model: Contents) -> None:
        self.model = model
        self.variables: dict[object, str] = {}
        self.taken: dict[str, int] = {}

    def lines(self) -> Iterator[str]:
        """Yield all statements; each uses only variables of earlier ones."""
        yield f"$model isa RobotModel, has model-name {quoted(self.model.name)};"
        for cls, table in self.model.tables.items():
            statements = [line for one in table.values() for line in self._element(one)]
            yield from ["", f"# {ROSA[cls]}s", *statements] if statements else []
        statements = [line for fact in self.model.facts for line in self._fact(fact)]
        yield from ["", "# what is so from the start", *statements] if statements else []

    def _element(self, one: Changeable) -> Iterator[str]:
        players = []
        for key, value in one.parameters.items() if isinstance(one, Configuration) else ():
            text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
            sort = parameter_type(value)
            variable = self._fresh("parameter", key)
            players.append(("parameter", variable))
            given = {"parameter-key": quoted(key), "parameter-value": quoted(text), "parameter-type": quoted(sort)}
            yield _statement(variable, (), "ComponentParameter", given)
        variable = self.variables[one] = self._fresh(ROSA[type(one)].split()[-1], called(one))
        yield self._described(one, "" if isinstance(one, Estimation) else variable, players)
        if isinstance(one, Action) and one.functions:
            needs = [("required-function", self._of(Function, name)) for name in one.functions]
            yield _statement("", [("action", variable), *needs], "functional-requirement", {})

    def _fact(self, fact: Fact) -> Iterator[str]:
        if isinstance(fact, ActiveFact):
            yield f"{self._of(Component, fact.component)} has is-active true;"
        elif isinstance(fact, StatusFact | RequiredFact | SelectedFact):
            said = f"status {quoted(fact.status)}" if isinstance(fact, StatusFact) else _FLAGS[type(fact)]
            yield f"{self.variables[fact.element]} has {said};"
        elif isinstance(fact, PlanFact):
            players = []
            for relation, (role, field, cls) in _STEPS.items():
                parts = [(role, self._of(cls, name)) for name in getattr(fact, field)]
                if parts:
                    players.append((relation, self._fresh("step", relation)))
                    yield _statement(players[-1][1], parts, relation, {})
            yield self._described(fact, self._fresh("plan", ""), players)
        else:
            yield self._described(fact, "", [])

    def _described(self, one: Changeable | Fact, variable: str, players: Iterable[tuple[str, str]]) -> str:
        kind = CLASSES[type(one)]
        named = []
        for role in ROLES.get(kind, ()):
            for player in _players(one, role.field):
                known = self.variables.get(player)
                named.append((role.name, known or self._of(_ELEMENTS[role.kinds[0]], player)))
        label = kind if kind in ROLES else SPECIAL.get(str(getattr(one, "kind", "")), kind.title())
        given = {field.label: _written(field, one) for field in _FIELDS[type(one)]}
        return _statement(variable, [*named, *players], label, given)

    def _of(self, cls: type[Element], name: str) -> str:
        return self.variables[self.model.tables[cls][name]]

    def _fresh(self, prefix: str, name: str) -> str:
        """Return a new variable that resembles the name."""
        stem = re.sub(r"[^A-Za-z0-9]+", "_", f"{prefix}_{name}").strip("_")[:60]
        number = self.taken[stem] = self.taken.get(stem, 0) + 1
        return f"${stem}" if number == 1 else f"${stem}-{number}"


def quoted(text: str) -> str:
    """Write a text in quotes so that reading gives the same text."""
    return f'"{_UNSAFE.sub(_escaped, text)}"'


def _escaped(found: re.Match[str]) -> str:
    return _ESCAPES.get(found[0]) or f"\\u{ord(found[0]):04x}"


def written_time(time: float) -> str | None:
    """Write a time [s since 1970-01-01 UTC] as a date; None if a date is not exact enough or does not reach so far."""
    try:
        moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(milliseconds=round(time * 1000))
    except (OverflowError, ValueError):
        return None
    text = moment.replace(tzinfo=None).isoformat(timespec="milliseconds")
    return text if seconds(datetime.fromisoformat(text).replace(tzinfo=UTC)) == time else None


def _statement(variable: str, players: Iterable[tuple[str, str]], label: str, given: Mapping[str, str | None]) -> str:
    relation = ", ".join(f"{role}: {player}" for role, player in players)
    head = [variable, f"({relation})" if relation else "", f"isa {label}"]
    owns = [f"has {label} {value}" for label, value in given.items() if value is not None]
    return ", ".join([" ".join(part for part in head if part), *owns]) + ";"


def _players(one: object, field: str) -> tuple[str, ...]:
    value = getattr(one, field) if field else None
    return tuple(value) if isinstance(value, Mapping | tuple) else () if value is None else (value,)


def _written(field: Field, one: object) -> str | None:
    """Write an attribute of an element or fact; None if it has no value or the default."""
    if field.name == "weights":
        preference = getattr(one, "preference", None)
        return None if preference is None else quoted(json.dumps(list(preference.values())))
    value = getattr(one, field.name)
    if value is None or (value == _DEFAULTS[type(one)][field.name] and field.name != "latest"):
        return None
    if field.name == "agreement":
        return quoted("{} of {}".format(*value))
    if field.name == "rates":
        return quoted(json.dumps(value))
    if field.value == "time":
        return written_time(value)
    if field.name in ("time", "start", "end") and written_time(value):
        return None
    if field.value == "text":
        return quoted(value)
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    if text.lstrip("-") in ("inf", "nan"):
        raise ModelError(f"{text} cannot be written to a file; a finite number is needed")
    return text
