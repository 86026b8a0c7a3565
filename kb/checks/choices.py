"""Designs of one function and configurations of one component, judged as rivals of which one is chosen."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby, pairwise
from typing import Final

from kb.checks.contradictions import bounds
from kb.checks.findings import Finding, found, listing
from kb.contents import Contents
from kb.elements import Attribute, Configuration, Element, FunctionDesign, StalePolicy
from kb.explanation.requirements import Interval
from kb.facts import RequiredActionFact
from kb.inference.settling import Network, Node

__all__ = ["doubtful_choices"]

PREFERRED: Final = 32
"""How many of the rivals that are preferred to one are compared with it."""

Bounds = Mapping[str, Interval]


def doubtful_choices(model: Contents, network: Network) -> Iterator[Finding]:
    """Yield what is doubtful about the choices that a model leaves."""
    estimated = _Estimated(model)
    for whole in (*network.functions.values(), *network.components.values()):
        if whole.kind == "component":
            yield from _excluded(whole)
        if len(whole.parts) < 2:
            continue
        yield from _ties(whole)
        if not any(estimated.by(rival) for rival in whole.parts):  # a preference may choose what priority never would
            yield from _dominated(whole)
        yield from _unevenly_estimated(whole, estimated)
        if whole.kind == "component":
            yield from _missing_parameters(whole)
    yield from _preferences(model, network, estimated)


def _priority(node: Node) -> float:
    assert isinstance(node.element, Configuration | FunctionDesign)
    return math.inf if node.element.priority is None else node.element.priority


def _bounds_in_use(rival: Node) -> dict[str, Interval]:
    """Return the values that a rival and what it is of or made of leave, where that is no matter of a choice."""
    together = bounds(rival)
    for component in rival.wholes if rival.kind == "configuration" else rival.parts:
        for attribute, interval in bounds(component).items():
            known = together.get(attribute)
            together[attribute] = interval if known is None else known.meet(interval)
    return together


def _ties(whole: Node) -> Iterator[Finding]:
    for priority, rivals in groupby(sorted(whole.parts, key=_priority), key=_priority):
        tied = list(rivals)
        if len(tied) < 2 or _exclude_one_another([_bounds_in_use(one) for one in tied]):
            continue
        which = "no priority" if priority == math.inf else f"the same priority, {priority:g}"
        names = sorted(one.name for one in tied)
        message = f"{tied[0].kind}s {listing(names)} of {whole.kind} {whole.name} have {which}; {names[0]} comes first"
        yield found("tied-priorities", f"{whole.kind} {whole.name}", message)


def _exclude_one_another(rivals: Sequence[Bounds]) -> bool:
    """Tell whether there is an attribute that allows one rival at a time, so that a tie does not matter."""
    for attribute in rivals[0]:
        intervals = [rival.get(attribute) for rival in rivals]
        known = sorted((one for one in intervals if one is not None), key=lambda one: (one.low, one.low_open))
        if len(known) == len(rivals) and all(one.meet(after).is_empty for one, after in pairwise(known)):
            return True
    return False


def _excluded(component: Node) -> Iterator[Finding]:
    """Yield the configurations that are feasible only where their component is not, unless that is so of all."""
    own = bounds(component)
    rivals = {rival: bounds(rival) for rival in component.parts}
    clashes = {rival: _clash(mine, own) for rival, mine in rivals.items() if not _is_contradictory(mine)}
    if _is_contradictory(own) or all(clashes.values()):
        return
    for rival, name in clashes.items():
        if name:
            what, needs, allows = f"configuration {rival.name}", rivals[rival][name].text(name), own[name].text(name)
            message = f"{what} needs {needs}, but its component {component.name} {allows}"
            yield found("never-selected", what, message)


def _clash(mine: Bounds, own: Bounds) -> str:
    """Name an attribute of which no value lies within the bounds of both, "" if there is none."""
    return next((name for name in mine if name in own and mine[name].meet(own[name]).is_empty), "")


def _is_contradictory(values: Bounds) -> bool:
    return any(interval.is_empty for interval in values.values())


def _dominated(whole: Node) -> Iterator[Finding]:
    """Yield the rivals that are unfeasible whenever none of those preferred to them is feasible."""
    ranked = sorted(whole.parts, key=_priority)
    offered = [(rival, _priority(rival), bounds(rival)) for rival in ranked[:PREFERRED]]
    for rival in ranked:
        needed = _bounds_in_use(rival)
        if _is_contradictory(needed):
            continue
        rank = _priority(rival)
        easier = [(one, own) for one, priority, own in offered if priority < rank and _is_part_of(one, rival)]
        names = _covering(easier, needed)
        if names:
            what = f"{rival.kind} {rival.name}"
            message = f"{what} of {whole.kind} {whole.name} is never chosen: whenever it is feasible, so is {names}"
            yield found("never-selected", what, f"{message}, which is preferred")


def _is_part_of(one: Node, rival: Node) -> bool:
    """Tell whether all that one rival is made of is in another too, so that no failure tells them apart."""
    return one.kind == "configuration" or set(one.parts) <= set(rival.parts)


def _covering(preferred: Sequence[tuple[Node, Bounds]], needed: Bounds) -> str:
    """Name the preferred rivals of which at least one is feasible whenever the bounds hold; "" if there are none."""
    by_attribute: dict[Node, list[tuple[Interval, str]]] = {}
    for one, own in preferred:
        if all(name in needed and interval.covers(needed[name]) for name, interval in own.items()):
            return one.name
        if len(own) == 1:
            (interval,) = own.values()
            by_attribute.setdefault(one.constraints[0].parts[0], []).append((interval, one.name))
    for attribute, offers in by_attribute.items():
        wanted = needed.get(attribute.name)
        if wanted is None and _can_be_violated_by_age(attribute):
            continue
        if _leave_no_gap([interval for interval, _ in offers], wanted or Interval()):
            return " or ".join(name for _, name in offers)
    return ""


def _can_be_violated_by_age(attribute: Node) -> bool:
    element = attribute.element
    return isinstance(element, Attribute) and element.when_stale is StalePolicy.VIOLATED and element.max_age < math.inf


def _leave_no_gap(intervals: Iterable[Interval], wanted: Interval) -> bool:
    """Tell whether every value that is wanted lies in one of the intervals."""
    reached: Interval | None = None
    for one in sorted(intervals, key=lambda interval: (interval.low, interval.low_open)):
        if (
            reached is None
            or one.low > reached.high
            or (one.low == reached.high and one.low_open and reached.high_open)
        ):
            reached = one
        else:
            high, high_closed = max((reached.high, not reached.high_open), (one.high, not one.high_open))
            reached = Interval(reached.low, high, reached.low_open, not high_closed)
        if reached.covers(wanted):
            return True
    return False


class _Estimated:
    """Which attributes are estimated for which elements."""

    def __init__(self, model: Contents) -> None:
        self._direct: dict[Element, dict[str, None]] = {}
        for one in model.estimations:
            self._direct.setdefault(one.causer, {})[one.attribute] = None
        self._known: dict[Node, Mapping[str, None]] = {}

    def by(self, node: Node) -> Mapping[str, None]:
        """Return the attributes that are estimated for an element or for what it is made of, in order."""
        if not self._direct:
            return {}
        if node not in self._known:
            names = dict(self.directly(node))
            for part in node.parts:
                names |= self.by(part)
            self._known[node] = names
        return self._known[node]

    def directly(self, node: Node) -> Mapping[str, None]:
        """Return the attributes that are estimated for an element itself."""
        assert isinstance(node.element, Element)
        return self._direct.get(node.element, {})


def _unevenly_estimated(whole: Node, estimated: _Estimated) -> Iterator[Finding]:
    by_rival = {rival: estimated.by(rival) for rival in whole.parts}
    for attribute in dict.fromkeys(name for names in by_rival.values() for name in names):
        without = [rival.name for rival, names in by_rival.items() if attribute not in names]
        if without and attribute not in estimated.directly(whole):
            what = f"{whole.kind} {whole.name}"
            kind = whole.parts[0].kind
            message = f"{attribute} is estimated for some {kind}s of {what} but not for {listing(without)}"
            yield found("missing-estimation", what, message)


def _preferences(model: Contents, network: Network, estimated: _Estimated) -> Iterator[Finding]:
    wanted = {
        (fact.action, attribute): None
        for fact in model.facts
        if isinstance(fact, RequiredActionFact)
        for attribute in fact.preference or ()
    }
    for action, attribute in wanted:
        if attribute not in estimated.by(network.actions[action]):
            message = f"action {action} is to favour {attribute}, which is estimated for nothing that it can use"
            yield found("missing-estimation", f"action {action}", message)


def _missing_parameters(component: Node) -> Iterator[Finding]:
    settings = {
        part.name: part.element.parameters for part in component.parts if isinstance(part.element, Configuration)
    }
    setters: dict[str, int] = {}
    for parameters in settings.values():
        for key in parameters:
            setters[key] = setters.get(key, 0) + 1
    usual = [key for key, count in setters.items() if count == len(settings) - 1]
    for name, parameters in settings.items():
        left_out = [key for key in usual if key not in parameters]
        if left_out:
            others = f"all other configurations of component {component.name} do"
            message = f"configuration {name} does not set {listing(left_out)}; {others}"
            yield found("missing-parameter", f"configuration {name}", message)
