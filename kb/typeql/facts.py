"""What files tell is so from the start, in the order in which it is told: statuses, measurements, requests."""

import json
from collections.abc import Iterator, Mapping
from datetime import datetime
from difflib import get_close_matches
from typing import Final

from kb.elements import Action, Component, Configuration, Constraint, Element, Function, FunctionDesign, finite_number
from kb.exceptions import InvalidValue
from kb.facts import (
    ActiveFact,
    Fact,
    MeasurementFact,
    PlanFact,
    ProcessFact,
    RequiredActionFact,
    RequiredFact,
    SelectedFact,
    StatusFact,
)
from kb.files import Place
from kb.status import STATUSES, Status
from kb.typeql.store import Own, Store, Thing
from kb.typeql.values import seconds
from kb.typeql.words import Kind

__all__ = ["Elements", "facts"]

Elements = dict[Thing, Element | Constraint]
"""What was made of each thing."""

Told = tuple[int, Fact, Place]
"""A fact, with the number of the statement that tells it, and where."""

_RESULTS: Final[Mapping[str, str]] = {
    **dict.fromkeys(("completed", "complete", "success", "succeeded", "successful", "done"), "completed"),
    **dict.fromkeys(("failed", "failure", "error", "aborted"), "failed"),
    **dict.fromkeys(("abandoned", "cancelled", "canceled", "interrupted"), "abandoned"),
}


def facts(store: Store, elements: Elements) -> list[tuple[Fact, Place]]:
    """Return the facts that were told, and where."""
    told = [one for thing, element in elements.items() for one in _of_element(store, thing, element)]
    told += _measurements(store)
    told += [one for thing in store.things.get(Kind.REQUIRED_ACTION, ()) for one in _required_actions(store, thing)]
    told += [one for thing in store.things.get(Kind.PROCESS, ()) for one in _process(store, thing)]
    told += [_plan(store, thing) for thing in store.things.get(Kind.PLAN, ())]
    told.sort(key=lambda one: one[0])
    return [(fact, place) for _, fact, place in told]


def _of_element(store: Store, thing: Thing, element: Element | Constraint) -> Iterator[Told]:
    for own in thing.owns:
        name = own.field.name if own.field else ""
        fact: Fact | None = None
        if name == "status":
            status = _status(store, thing, own)
            fact = StatusFact(element, status) if status else None
        elif own.value is True and name == "required" and isinstance(element, Action | Function | Component):
            fact = RequiredFact(element)
        elif own.value is True and name == "selected" and isinstance(element, FunctionDesign | Configuration):
            fact = SelectedFact(element)
        elif own.value is True and name == "active" and isinstance(element, Component):
            fact = ActiveFact(element.name)
        elif name == "pid" and isinstance(element, Component) and isinstance(own.value, int):
            fact = ProcessFact(element.name, own.value)
        if fact is not None:
            yield own.order, fact, own.place


def _status(store: Store, thing: Thing, own: Own) -> Status | None:
    """Return the status that is meant; a word that is none is noted, for others load such files as well."""
    word = " ".join(str(own.value).replace("_", " ").replace("-", " ").lower().split())
    known = STATUSES["configuration" if thing.kind is Kind.CONFIGURATION else str(thing.kind)]
    if word in known:
        return Status(word)
    near = get_close_matches(word, known, n=1)
    hint = f"did you mean {str(near[0])!r}?" if near else f"there are {', '.join(known)}"
    store.note(own.place, f"{own.value!r} is no status of a {thing.type.label}, and not asserted; {hint}")
    return None


def _measurements(store: Store) -> list[Told]:
    """Return all measurements; where the files do not say which one is the latest, the newest one told last is."""
    told: list[tuple[Thing, str]] = [
        (thing, one.name)
        for thing in store.things.get(Kind.MEASUREMENT, ())
        for one in thing.players("measured-attribute")
    ]
    told += [(thing, thing.name) for thing in store.things.get(Kind.ATTRIBUTE, ()) if thing.own("value")]
    latest: dict[str, tuple[tuple[float, int], Thing]] = {}
    for thing, name in told:
        age = (_time(thing, "time") or 0.0, _order(thing))
        if thing.own("latest") is None and (name not in latest or age >= latest[name][0]):
            latest[name] = (age, thing)
    stated = {name for thing, name in told if thing.value("latest") is True}
    made: list[Told] = []
    for thing, name in told:
        own = thing.own("value")
        if own is None:
            raise thing.place.error(f"this {thing.type.label} has no value; write `has measurement-value 0.5`")
        said = thing.value("latest")
        newest = name not in stated and latest.get(name, (None, None))[1] is thing if said is None else said is True
        fact = MeasurementFact(name, own.value, _time(thing, "time"), newest)  # type: ignore[arg-type]  # a number: `checked`
        made.append((_order(thing), fact, own.place))
    return made


def _order(thing: Thing) -> int:
    own = thing.own("value")
    return own.order if own and thing.kind is Kind.ATTRIBUTE else thing.order


def _required_actions(store: Store, thing: Thing) -> Iterator[Told]:
    preference = _preference(thing)
    for action in thing.players("action"):
        yield (
            thing.order,
            RequiredActionFact(
                action.name, preference, _time(thing, "start"), _time(thing, "end"), _result(store, thing)
            ),
            thing.place,
        )


def _preference(thing: Thing) -> dict[str, float] | None:
    """Return the weight of each attribute that is preferred, 1 by default; an estimation stands for its attribute."""
    names: list[str] = []
    for one in thing.players("preferred-attribute"):
        names += [part.name for part in one.players("affected")] if one.kind is Kind.ESTIMATION else [one.name]
    own = thing.own("weights")
    if own is None:
        return dict.fromkeys(names, 1.0) or None
    try:
        weights = json.loads(str(own.value))
        if len(weights) != len(names):
            raise InvalidValue("one weight per attribute is needed")
        for weight in weights:
            finite_number(weight)
    except (ValueError, TypeError) as error:
        raise own.place.error(f"{own.value!r} is no list of weights for {len(names)} attributes: {error}") from None
    return dict(zip(names, weights, strict=True))


def _process(store: Store, thing: Thing) -> Iterator[Told]:
    (component,) = thing.players("component")
    pid = thing.value("pid")
    if isinstance(pid, int):
        yield thing.order, ProcessFact(component.name, pid, _time(thing, "start"), _time(thing, "end")), thing.place
    else:
        store.note(thing.place, f"this {thing.type.label} has no pid; it is passed over")


def _plan(store: Store, thing: Thing) -> Told:
    names: dict[str, list[str]] = {"component-activation": [], "component-deactivation": [], "parameter-adaptation": []}
    for part in thing.parts:
        if part.role is not None:
            _add_step(store, names, part.role.name, part.thing)
    activate, deactivate, parameters = map(tuple, names.values())
    start, end = _time(thing, "start"), _time(thing, "end")
    return thing.order, PlanFact(activate, deactivate, parameters, start, end, _result(store, thing)), thing.place


def _add_step(store: Store, names: dict[str, list[str]], role: str, step: Thing) -> None:
    if step.kind in (Kind.COMPONENT, Kind.CONFIGURATION):
        names[role].append(step.name)
    elif step.kind is Kind.STRUCTURAL:
        for part in step.parts:
            if part.role is not None:
                _add_step(store, names, part.role.name, part.thing)
    elif step.kind is Kind.ACTIVATION:
        names["component-activation"] += [one.name for one in step.players("component")]
    elif step.kind is Kind.DEACTIVATION:
        names["component-deactivation"] += [one.name for one in step.players("component")]
    else:
        chosen = [one.name for one in step.players("component-configuration")]
        names["parameter-adaptation"] += chosen
        if not chosen:
            store.note(step.place, f"this {step.type.label} names no component-configuration; it is passed over")


def _result(store: Store, thing: Thing) -> str | None:
    own = thing.own("result")
    if own is None or not str(own.value).strip():
        return None
    word = str(own.value).strip().lower()
    if word not in _RESULTS:
        store.note(
            own.place, f"{own.value!r} is no result and is taken as abandoned; there are completed, failed, abandoned"
        )
    return _RESULTS.get(word, "abandoned")


def _time(thing: Thing, name: str) -> float | None:
    value = thing.value(name)
    if isinstance(value, datetime):
        return seconds(value)
    return value if isinstance(value, int | float) else None
