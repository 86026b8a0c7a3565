"""What no measurement makes possible: constraints that contradict one another, on one element or on what it needs.

An attribute that is not measured violates nothing, so what is found here is unfeasible once its attributes are
measured. Only the root is reported, with the actions that it makes impossible, and not each element between the two.
"""

from collections.abc import Iterable, Iterator
from itertools import combinations
from typing import Final, NamedTuple

from kb.checks.findings import Finding, found, listing
from kb.explanation.requirements import Box, Interval, Requirements, bounds
from kb.network import Network, Node

QUICK: Final = 4
"""How many alternatives suffice to see that most elements are possible; all are looked at only for the others."""
MOST_ACTIONS: Final = 4


def contradictions(network: Network) -> Iterator[Finding]:
    """Yield what can never be feasible, but for mere consequences of something else that is found."""
    quick, thorough = Requirements(limit=QUICK), Requirements()
    impossible = set()
    for node in network.nodes:
        if node.kind not in ("attribute", "constraint"):
            ways = quick.of(node)
            if not ways.boxes and not ways.complete:
                ways = thorough.of(node)
            if not ways.boxes and ways.complete:
                impossible.add(node)
    for node in network.nodes:
        for code, message in _roots(node, impossible, thorough) if node in impossible else ():
            yield found(code, f"{node.kind} {node.name}", message + _consequence(node, impossible))


def _roots(node: Node, impossible: set[Node], requirements: Requirements) -> Iterator[tuple[str, str]]:
    """Yield code and message of each reason for which an element is impossible that is no reason of another one."""
    what = f"{node.kind} {node.name}"
    if node.kind == "function":
        if not node.parts:
            yield "function-without-designs", f"{what} has no design"
        return
    empty = [name for name, interval in bounds(node).items() if interval.is_empty]
    for attribute in empty:
        yield "contradictory-constraints", f"{what} is constrained by {_contradiction(node, attribute)}"
    broken = [part in impossible for part in node.parts]
    is_consequence = any(broken) and (all(broken) or node.kind != "component")
    if not empty and not is_consequence:
        yield "never-feasible", f"{what} can never be feasible: {_conflict(node, requirements)}"


def _contradiction(node: Node, attribute: str) -> str:
    """Name two constraints that exclude one another; one suffices if no number satisfies it."""
    own = [one.constraint for one in node.constraints if one.constraint.attribute == attribute]
    for one in own:
        if Interval.of(one).is_empty:
            return f"{one}, which no number satisfies"
    one, other = next(two for two in combinations(own, 2) if Interval.of(two[0]).meet(Interval.of(two[1])).is_empty)
    return f"{one} and {other}, which no value satisfies both"  # two bounds make an interval empty, never three


def _consequence(node: Node, impossible: set[Node]) -> str:
    waiting = {node: None}
    actions: list[str] = []
    while waiting and len(actions) <= MOST_ACTIONS:
        wholes = dict.fromkeys(whole for one in waiting for whole in one.wholes if whole in impossible)
        actions += [whole.name for whole in wholes if whole.kind == "action" and whole.name not in actions]
        waiting = wholes
    if len(actions) > MOST_ACTIONS:
        return f", so {len(actions)} actions or more can never be feasible, e.g. {actions[0]}"
    return f", so action {listing(actions)} can never be feasible" if actions else ""


class _Need(NamedTuple):
    """One of the things that an element needs all of, by name, and the ways in which it can be so.

    The constraints it comes from are on the nodes, or on what they are made of; none if the name says it all.
    """

    name: str
    nodes: tuple[Node, ...]
    boxes: tuple[Box, ...]

    def hull(self, attribute: str) -> Interval | None:
        """Return the narrowest interval for an attribute that holds the values of every way, None for all values."""
        hull: Interval | None = None
        for box in self.boxes:
            if attribute not in box.intervals:
                return None
            hull = hull.hull(box.intervals[attribute]) if hull else box.intervals[attribute]
        return hull


def _needs(node: Node, requirements: Requirements) -> list[_Need]:
    own = [
        _Need(f"its own constraint {one.name}", (), (Box({one.constraint.attribute: Interval.of(one.constraint)}),))
        for one in node.constraints
    ]
    if node.kind == "component":
        boxes = tuple(box for part in node.parts for box in requirements.of(part).boxes)
        return [*own, _Need("each of its configurations", tuple(node.parts), boxes)]
    return own + [_Need(f"{part.kind} {part.name}", (part,), requirements.of(part).boxes) for part in node.parts]


def _conflict(node: Node, requirements: Requirements) -> str:
    """Name two needs that exclude one another, with the chain from each down to the constraint, as far as can be."""
    needs = _needs(node, requirements)
    for one, other in combinations(needs, 2):
        if any(mine.meet(theirs) is not None for mine in one.boxes for theirs in other.boxes):
            continue
        for attribute in one.boxes[0].intervals:
            mine, theirs = one.hull(attribute), other.hull(attribute)
            if mine is not None and theirs is not None and mine.meet(theirs).is_empty:
                return f"{_chain(one, attribute, mine)}, but {_chain(other, attribute, theirs)}"
        return f"{one.name} and {other.name} exclude one another, whatever is measured"
    return f"{listing((need.name for need in needs), 8)} cannot be met together, whatever is measured"


def _chain(need: _Need, attribute: str, interval: Interval) -> str:
    if not need.nodes:
        return need.name
    path = [step for step in _path(need.nodes, attribute, interval) if step != need.name]
    return f"{need.name} needs {interval.text(attribute)}" + (f" (by {' of '.join(path)})" if path else "")


def _path(nodes: Iterable[Node], attribute: str, interval: Interval) -> list[str]:
    """Return the way down to the first constraint with a bound of the interval, the lowest element first."""
    paths = {node: [f"{node.kind} {node.name}"] for node in nodes}
    waiting = list(paths)
    for node in waiting:
        own = (one.constraint.value for one in node.constraints if one.constraint.attribute == attribute)
        if any(value in (interval.low, interval.high) for value in own):
            return paths[node]
        for part in node.parts:
            if part not in paths:
                paths[part] = [f"{part.kind} {part.name}", *paths[node]]
                waiting.append(part)
    return []
