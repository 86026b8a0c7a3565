"""A judge of models: what can never work, contradicts itself or is likely a slip."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import replace

from kb.checks.choices import doubtful_choices
from kb.checks.contradictions import contradictions
from kb.checks.facts import doubtful_facts
from kb.checks.findings import Finding, Severity, found
from kb.contents import Contents
from kb.declarations import listed, text
from kb.elements import KINDS, Constraint, Element
from kb.exceptions import UnknownName
from kb.facts import RequiredActionFact
from kb.inference.settling import Network, Node

__all__ = ["check_model"]


def check_model(model: Contents, names: Iterable[str] | None = None) -> tuple[Finding, ...]:
    """Judge a model; see `Model.check`. Errors come first, and each rule goes through a model in order."""
    network = Network(model)
    findings = [
        *(() if names is None else _mismatches(model.actions, listed("names", names))),
        *contradictions(network),
        *_incomplete(network),
        *_unused(model, network),
        *doubtful_choices(model, network),
        *doubtful_facts(model),
        *_similar_names(network),
        *(found("file-note", f"model {model.name}", note) for note in model.notes),
    ]
    places = {f"{KINDS[type(element)]} {_name(element)}": place for element, place in model.places.items()}
    placed = (replace(one, place=places.get(one.element, "")) for one in findings)
    return tuple(sorted(placed, key=lambda one: one.severity is not Severity.ERROR))


def _name(element: Element | Constraint) -> str:
    return element.name if isinstance(element, Element) else str(element)


def _mismatches(actions: Collection[str], names: Iterable[str]) -> Iterator[Finding]:
    mentioned = dict.fromkeys(text("an action's name", name) for name in names)
    for name in mentioned:
        if name not in actions:
            yield found("unknown-action", name, UnknownName("action", name, actions).message)
    for name in actions:
        if name not in mentioned:
            yield found("unmentioned-action", f"action {name}", f"action {name} is mentioned nowhere")


def _incomplete(network: Network) -> Iterator[Finding]:
    for node in network.actions.values():
        if not node.parts:
            yield found("action-without-functions", f"action {node.name}", f"action {node.name} requires no function")
    for node in network.designs.values():
        if not node.parts:
            what = f"function design {node.name}"
            yield found("design-without-components", what, f"{what} of function {node.wholes[0].name} has no component")


def _unused(model: Contents, network: Network) -> Iterator[Finding]:
    used = {one.attribute for one in model.estimations}
    for fact in model.facts:
        if isinstance(fact, RequiredActionFact):
            used.update(fact.preference or ())
    for node in network.attributes.values():
        if not node.constraints and node.name not in used:
            yield found("unused-attribute", f"attribute {node.name}", f"nothing depends on attribute {node.name}")
    for node in network.functions.values():
        if not node.wholes:
            yield found("unused-function", f"function {node.name}", f"no action requires function {node.name}")
    for node in network.components.values():
        if not node.wholes:
            yield found("unused-component", f"component {node.name}", f"no design uses component {node.name}")


def _similar_names(network: Network) -> Iterator[Finding]:
    for table in (
        network.attributes,
        network.components,
        network.configurations,
        network.functions,
        network.designs,
        network.actions,
    ):
        yield from _similar(table)


def _similar(table: Mapping[str, Node]) -> Iterator[Finding]:
    first: dict[str, str] = {}
    for name, node in table.items():
        other = first.setdefault("".join(name.replace("_", " ").split()).casefold(), name)
        if other != name:
            what = f"{node.kind} {name}"
            yield found("similar-names", what, f"{what} is called almost like {node.kind} {other}")
