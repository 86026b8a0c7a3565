"""Designs of one function and configurations of one component: which one is chosen, and what never is."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby, pairwise
from typing import Final

from kb.checks.findings import Finding, found, listing
from kb.explanation.requirements import Interval, bounds
from kb.facts import Contents, RequiredActionFact
from kb.network import Network, Node

PREFERRED: Final = 32
"""How many of the alternatives that are preferred to one are compared with it."""

Bounds = Mapping[str, Interval]
_Names = dict[Node, dict[str, None]]


def doubtful_choices(model: Contents, network: Network) -> Iterator[Finding]:
    directly, estimated = _estimated(model, network)
    for whole in (*network.functions.values(), *network.components.values()):
        if whole.kind == "component":
            yield from _excluded(whole)
        if len(whole.parts) < 2:
            continue
        yield from _ties(whole)
        by_part = {part: estimated.get(part, {}) for part in whole.parts}
        if not any(by_part.values()):  # a preference may choose what priority never would
            yield from _dominated(whole)
        yield from _unevenly_estimated(whole, by_part, directly.get(whole, {}))
    requests = [fact for fact in model.facts if isinstance(fact, RequiredActionFact)]
    for action, attribute in dict.fromkeys((one.action, name) for one in requests for name in one.preference or ()):
        if attribute not in estimated.get(network.actions[action], ()):
            message = f"action {action} is to favour {attribute}, which is estimated for nothing that it can use"
            yield found("missing-estimation", f"action {action}", message)


def _priority(node: Node) -> float:
    priority: float | None = node.element.priority
    return math.inf if priority is None else priority


def _bounds_in_use(part: Node) -> dict[str, Interval]:
    """Return the values that a design or configuration leaves together with its components."""
    components = part.wholes if part.kind == "configuration" else part.parts
    return bounds(part, *components)


def _ties(whole: Node) -> Iterator[Finding]:
    for priority, group in groupby(sorted(whole.parts, key=_priority), key=_priority):
        tied = list(group)
        if len(tied) < 2 or _exclude_one_another([_bounds_in_use(one) for one in tied]):
            continue
        which = "no priority" if priority == math.inf else f"the same priority, {priority}"
        names = sorted(one.name for one in tied)
        message = f"{tied[0].kind}s {listing(names)} of {whole.kind} {whole.name} have {which}; {names[0]} comes first"
        yield found("tied-priorities", f"{whole.kind} {whole.name}", message)


def _exclude_one_another(alternatives: Sequence[Bounds]) -> bool:
    """Tell whether there is an attribute that allows one of them at a time, so that a tie does not matter."""
    for attribute in alternatives[0]:
        known = sorted(
            (one[attribute] for one in alternatives if attribute in one), key=lambda one: (one.low, one.low_open)
        )
        if len(known) == len(alternatives) and all(one.meet(after).is_empty for one, after in pairwise(known)):
            return True
    return False


def _excluded(component: Node) -> Iterator[Finding]:
    own = bounds(component)
    parts = {part: mine for part in component.parts if not _is_contradictory(mine := bounds(part))}
    clashes = {
        part: next((name for name in mine if name in own and mine[name].meet(own[name]).is_empty), None)
        for part, mine in parts.items()
    }
    if _is_contradictory(own) or all(clashes.values()):
        return
    for part, name in clashes.items():
        if name:
            needs, allows = parts[part][name].text(name), own[name].text(name)
            message = f"configuration {part.name} needs {needs}, but its component {component.name} {allows}"
            yield found("never-selected", f"configuration {part.name}", message)


def _is_contradictory(values: Bounds) -> bool:
    return any(interval.is_empty for interval in values.values())


def _dominated(whole: Node) -> Iterator[Finding]:
    """Yield the parts for which one that is preferred is feasible whenever they are."""
    ranked = sorted(whole.parts, key=_priority)
    offered = [(part, bounds(part)) for part in ranked[:PREFERRED]]
    for part in ranked:
        needed = _bounds_in_use(part)
        if _is_contradictory(needed):
            continue
        for one, own in offered:  # no failure tells them apart if all that one is made of is in the other too
            is_within = part.kind == "configuration" or set(one.parts) <= set(part.parts)
            easier = all(name in needed and interval.covers(needed[name]) for name, interval in own.items())
            if _priority(one) < _priority(part) and is_within and easier:
                what = f"{part.kind} {part.name}"
                message = (
                    f"{what} of {whole.kind} {whole.name} is never chosen: whenever it is feasible, so is {one.name}"
                )
                yield found("never-selected", what, f"{message}, which is preferred")
                break


def _estimated(model: Contents, network: Network) -> tuple[_Names, _Names]:
    """Return which attributes are estimated for which elements, and for which with all that they are made of."""
    directly: _Names = {}
    for one in model.estimations:
        directly.setdefault(network.find(one.causer), {})[one.attribute] = None
    estimated: _Names = {}
    for node in sorted(network.present(), key=lambda node: node.level) if directly else ():
        estimated[node] = dict(directly.get(node, {}))
        for part in node.parts:
            estimated[node] |= estimated.get(part, {})
    return directly, estimated


def _unevenly_estimated(whole: Node, by_part: _Names, directly: Mapping[str, None]) -> Iterator[Finding]:
    for attribute in dict.fromkeys(name for names in by_part.values() for name in names):
        without = [part.name for part, names in by_part.items() if attribute not in names]
        if without and attribute not in directly:
            what, kind = f"{whole.kind} {whole.name}", whole.parts[0].kind
            message = f"{attribute} is estimated for some {kind}s of {what} but not for {listing(without)}"
            yield found("missing-estimation", what, message)
