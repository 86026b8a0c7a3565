"""The facts that a model states from the start, judged: do they go together, and do they hide anything?"""

from collections.abc import Iterator, Mapping
from typing import TypeGuard

from kb.checks.findings import Finding, found, listing
from kb.contents import Contents
from kb.elements import KINDS, Action, Component, Constraint, Element, Function, FunctionDesign
from kb.facts import ActiveFact, MeasurementFact, RequiredActionFact, RequiredFact, SelectedFact, StatusFact
from kb.status import Status

__all__ = ["doubtful_facts"]


def doubtful_facts(model: Contents) -> Iterator[Finding]:
    """Yield what is doubtful about the facts of a model."""
    yield from _hidden(model)
    yield from _measured_twice(model)
    yield from _selections(model)
    yield from _obsolete(model)


def _hidden(model: Contents) -> Iterator[Finding]:
    for fact in model.facts:
        if isinstance(fact, StatusFact) and fact.status is not Status.FAILURE:  # a failure is not inferred but told
            what = _called(fact.element)
            yield found("hidden-status", what, f"{what} is stated to be {fact.status}")


def _called(element: Element | Constraint) -> str:
    if isinstance(element, Element):
        return f"{KINDS[type(element)]} {element.name}"
    return f"constraint {element} of {listing(one.name for one in element.constrained)}"


def _measured_twice(model: Contents) -> Iterator[Finding]:
    latest: dict[str, int] = {}
    for fact in model.facts:
        if isinstance(fact, MeasurementFact) and fact.latest:
            latest[fact.attribute] = latest.get(fact.attribute, 0) + 1
    for name, count in latest.items():
        if count > 1:
            message = f"{count} measurements of attribute {name} are each stated to be the latest"
            yield found("contradictory-facts", f"attribute {name}", message)


def _selections(model: Contents) -> Iterator[Finding]:
    designs: dict[str, list[str]] = {}
    configurations: dict[str, list[str]] = {}
    wanted = {fact.element.name for fact in model.facts if _is_required(fact, Component)}
    for fact in model.facts:
        if not isinstance(fact, SelectedFact):
            continue
        element = fact.element
        if isinstance(element, FunctionDesign):
            wanted.update(element.components)
            _add(designs, element.function, element.name)
        else:
            _add(configurations, element.component, element.name)
    yield from _several("function", designs, "designs")
    yield from _several("component", configurations, "configurations")
    for component, chosen in configurations.items():
        if component not in wanted:
            message = f"configuration {chosen[0]} is selected, but component {component} is in no selected design"
            yield found("contradictory-facts", f"configuration {chosen[0]}", message)


def _add(table: dict[str, list[str]], whole: str, part: str) -> None:
    chosen = table.setdefault(whole, [])
    if part not in chosen:
        chosen.append(part)


def _several(kind: str, selected: Mapping[str, list[str]], parts: str) -> Iterator[Finding]:
    for name, chosen in selected.items():
        if len(chosen) > 1:
            message = f"{parts} {listing(chosen)} of {kind} {name} are selected at the same time"
            yield found("contradictory-facts", f"{kind} {name}", message)


def _is_required(fact: object, kind: type[Element]) -> TypeGuard[RequiredFact]:
    return isinstance(fact, RequiredFact) and isinstance(fact.element, kind)


def _obsolete(model: Contents) -> Iterator[Finding]:
    """Yield what is active although other things are required; a robot of which nothing is required may just idle."""
    functions = {fact.element.name for fact in model.facts if _is_required(fact, Function)}
    actions = {fact.element.name for fact in model.facts if _is_required(fact, Action)}
    for fact in model.facts:
        if isinstance(fact, RequiredActionFact) and fact.end is None and fact.result is None:
            actions.add(fact.action)
    for action in actions:
        functions.update(model.actions[action].functions)
    if not functions:
        return
    used = {name for one in model.designs.values() if one.function in functions for name in one.components}
    for fact in model.facts:
        if isinstance(fact, ActiveFact) and fact.component not in used:
            what = f"component {fact.component}"
            yield found("contradictory-facts", what, f"{what} is active, but nothing that is required can use it")
