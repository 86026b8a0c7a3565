"""Reads and writes models as TypeQL 2 files, in the words of ROSA; imported late, for it needs lark.

A file is read in steps: `syntax` (text to statements, by `grammar.lark`), `things` (statements to things of types that
play roles), and here things to a model: first the elements, in order, then the facts from the start. A model is written
as one `insert`, after a `define` of the attributes that ROSA's schema does not have.
"""

import ast
import json
import re
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields
from datetime import UTC, datetime, timedelta
from itertools import count
from pathlib import Path
from typing import Any, Final, TypeVar

from kb import elements, facts
from kb.elements import Attribute, Component, Configuration, Constraint, Element, finite_number
from kb.exceptions import ModelError, UnknownName
from kb.facts import Contents, Fact
from kb.files import Place, read_text
from kb.status import STATUSES, Status
from kb.typeql.syntax import Define, Literal, parse
from kb.typeql.things import (
    ATTRIBUTES,
    CLASSES,
    EXTENSIONS,
    ROLES,
    SPECIAL,
    Field,
    Own,
    Store,
    Thing,
    seconds,
    shown,
)

ModelT = TypeVar("ModelT", bound=Contents)
Stated = tuple[int, Fact, Place]
"""The number of a statement, its fact, and its place."""

_KINDS: Final = {label: kind for kind, label in SPECIAL.items()}
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


def load_typeql(cls: Callable[[str], ModelT], files: Sequence[Path], name: str | None) -> ModelT:
    """Read one model from files; each may add to those before it. See `Model.load`."""
    parsed = [(str(file), query) for file in files for query in parse(read_text(file), str(file))]
    store = Store((file, query) for file, query in parsed if isinstance(query, Define))
    for file, query in parsed:
        if not isinstance(query, Define):
            store.read(query, file)
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


class _Reading:
    """Builds a model from the things of a store."""

    def __init__(self, model: Contents, store: Store) -> None:
        self.model, self.store = model, store
        self.elements: dict[Thing, Element | Constraint] = {}

    def run(self) -> None:
        required = self._required_functions()
        for cls, kind in CLASSES.items():
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
        for role in ROLES.get(CLASSES[cls], ()):
            if role.field:
                names = _names(thing, role.name)
                given[role.field] = names[0] if role.most == 1 else names
        if cls in (Attribute, Component):
            kinds = [_KINDS[label] for label in thing.type.lineage if label in _KINDS]
            given |= {"kind": kinds[0]} if kinds else {}
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
    value = thing.value(name)
    if isinstance(value, datetime):
        return seconds(value)
    return value if isinstance(value, int | float) else None


def _period(thing: Thing) -> dict[str, Any]:
    return {"start": _time(thing, "start"), "end": _time(thing, "end")}


def _preference(thing: Thing) -> dict[str, float] | None:
    """Return the weight of each preferred attribute, 1 by default; an estimation means its attribute."""
    names: list[str] = []
    for one in thing.players("preferred-attribute"):
        names += _names(one, "affected") if one.kind == "estimation" else [one.name]
    own = thing.own("weights")
    if own is None:
        return dict.fromkeys(names, 1.0) or None
    try:
        weights = map(finite_number, json.loads(str(own.value)))
        return dict(zip(names, weights, strict=True))
    except (ValueError, TypeError, RecursionError) as error:
        raise own.place.error(
            f"{own.value!r:.60} is no list of weights for {len(names)} attributes: {error}"
        ) from None


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


# -------------------------------------------------------------------- and back

_ELEMENTS: Final = {kind: cls for cls, kind in CLASSES.items()}
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
            yield from ["", f"# {facts.ROSA[cls]}s", *statements] if statements else []
        statements = [line for fact in self.model.facts for line in self._fact(fact)]
        yield from ["", "# what is so from the start", *statements] if statements else []

    def _element(self, one: elements.Changeable) -> Iterator[str]:
        players = []
        for key, value in one.parameters.items() if isinstance(one, Configuration) else ():
            text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
            sort = elements.parameter_type(value)
            variable = self._fresh("parameter", key)
            players.append(("parameter", variable))
            given = {
                "parameter-key": quoted(key),
                "parameter-value": quoted(text),
                "parameter-type": quoted(sort),
            }
            yield _statement(variable, (), "ComponentParameter", given)
        variable = self.variables[one] = self._fresh(
            facts.ROSA[type(one)].split()[-1], elements.called(one)
        )
        yield self._described(
            one, "" if isinstance(one, elements.Estimation) else variable, players
        )
        if isinstance(one, elements.Action) and one.functions:
            needs = [
                ("required-function", self._of(elements.Function, name)) for name in one.functions
            ]
            yield _statement("", [("action", variable), *needs], "functional-requirement", {})

    def _fact(self, fact: Fact) -> Iterator[str]:
        if isinstance(fact, facts.ActiveFact):
            yield f"{self._of(Component, fact.component)} has is-active true;"
        elif isinstance(fact, facts.RequiredFact | facts.SelectedFact):
            flag = "is-required" if isinstance(fact, facts.RequiredFact) else "is-selected"
            yield f"{self.variables[fact.element]} has {flag} true;"
        elif isinstance(fact, facts.StatusFact):
            yield f"{self.variables[fact.element]} has status {quoted(fact.status)};"
        elif isinstance(fact, facts.PlanFact):
            players = []
            for relation, (role, field, cls) in _STEPS.items():
                parts = [(role, self._of(cls, name)) for name in getattr(fact, field)]
                if parts:
                    players.append((relation, self._fresh("step", relation)))
                    yield _statement(players[-1][1], parts, relation, {})
            yield self._described(fact, self._fresh("plan", ""), players)
        else:
            yield self._described(fact, "", [])

    def _described(
        self, one: elements.Changeable | Fact, variable: str, players: Iterable[tuple[str, str]]
    ) -> str:
        kind = CLASSES[type(one)]
        named = []
        for role in ROLES.get(kind, ()):
            value = getattr(one, role.field, None) or ()
            for player in value if isinstance(value, Mapping | tuple) else (value,):
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


def _statement(
    variable: str, players: Iterable[tuple[str, str]], label: str, given: Mapping[str, str | None]
) -> str:
    relation = ", ".join(f"{role}: {player}" for role, player in players)
    head = [variable, f"({relation})" if relation else "", f"isa {label}"]
    owns = [f"has {label} {value}" for label, value in given.items() if value is not None]
    return ", ".join([" ".join(part for part in head if part), *owns]) + ";"


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
