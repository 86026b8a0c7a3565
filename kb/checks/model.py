"""Checks of a model as a whole: its names, what is used, and the facts that it states from the start."""

from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace
from math import inf

from kb.checks.choices import doubtful_choices
from kb.checks.contradictions import contradictions
from kb.checks.findings import Finding, Severity, found, listing
from kb.elements import KINDS, Constraint, Element, listed, text
from kb.exceptions import UnknownName
from kb.explanation.requirements import Interval
from kb.facts import Contents, RequiredActionFact
from kb.measurements import turning_point
from kb.network import Network
from kb.status import Status


def check_model(model: Contents, names: Iterable[str] | None = None) -> tuple[Finding, ...]:
    """Check a model; see `Model.check`. Errors come first, and each rule goes through a model in order."""
    network = Network(model)
    findings = [
        *(() if names is None else _mismatches(model.actions, listed("names", names))),
        *contradictions(network),
        *_incomplete(network),
        *_unused(model, network),
        *_out_of_range(model),
        *doubtful_choices(model, network),
        *(found("file-note", f"model {model.name}", note) for note in model.notes),
    ]
    places = {_described(one): place for one, place in model.places.items()}
    placed = (replace(one, place=places.get(one.element, "")) for one in findings)
    return tuple(sorted(placed, key=lambda one: one.severity is not Severity.ERROR))


def _described(one: Element | Constraint) -> str:
    return f"{KINDS[type(one)]} {one.name if isinstance(one, Element) else one}"


def _mismatches(actions: Collection[str], names: Iterable[str]) -> Iterator[Finding]:
    mentioned = dict.fromkeys(text("an action's name", name) for name in names)
    for name in mentioned:
        if name not in actions:
            yield found("unknown-action", name, str(UnknownName("action", name, actions)))
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
    for name, action in (
        (one.name, rate.while_) for one in network.attributes.values() for rate in one.attribute.rates
    ):
        if action and action not in network.actions:
            yield found("unknown-action", name, f"a rate of {name}: {UnknownName('action', action, network.actions)}")


def _unused(model: Contents, network: Network) -> Iterator[Finding]:
    requests = (fact for fact in model.facts if isinstance(fact, RequiredActionFact))
    used = {one.attribute for one in model.estimations}.union(*(fact.preference or () for fact in requests))
    attributes = [node for node in network.attributes.values() if not node.constraints and node.name not in used]
    functions = [node for node in network.functions.values() if not node.wholes]
    components = [node for node in network.components.values() if not node.wholes]
    whats = ("nothing depends on", attributes), ("no action requires", functions), ("no design uses", components)
    for what, nodes in whats:
        for node in nodes:
            yield found(f"unused-{node.kind}", f"{node.kind} {node.name}", f"{what} {node.kind} {node.name}")


def _out_of_range(model: Contents) -> Iterator[Finding]:
    """Yield the constraints that the range of their attribute decides, whatever is measured."""
    for one in model.constraints:
        attribute = model.attributes[one.attribute]
        if attribute.low == -inf and attribute.high == inf:
            continue
        possible, wanted = Interval(attribute.low, attribute.high), Interval.of(one)
        is_never = wanted.meet(possible).is_empty
        is_final = not is_never and Interval.of(one, turning_point(one, Status.VIOLATED)).meet(possible).is_empty
        if is_never or is_final or wanted.covers(possible):
            how = "is never satisfied" if is_never else "stays violated once it is" if is_final else "is never violated"
            message = f"{_described(one)} {how}: {one.attribute} is {attribute.range}"
            yield found(
                "out-of-range", _described(one), f"{message} (on {listing(each.name for each in one.constrained)})"
            )
