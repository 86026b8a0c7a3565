"""What no measurement makes possible: constraints that contradict one another, on one element or on what it needs.

An attribute that is not measured violates nothing, so what is found here is unfeasible once its attributes are
measured. Only the root is reported, with the actions that it makes impossible, and not each element between the two.
"""

from collections.abc import Iterator
from itertools import combinations
from typing import Final

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


def _conflict(node: Node, requirements: Requirements) -> str:
    """Name two needs that exclude one another, and what each comes to if that is one thing; else all of them."""
    needs = {f"its own constraint {one.name}": requirements.of(one).boxes for one in node.constraints}
    if node.kind == "component":
        needs["each of its configurations"] = tuple(box for part in node.parts for box in requirements.of(part).boxes)
    else:
        for part in node.parts:
            boxes = requirements.of(part).boxes
            needs[_needing(part, boxes)] = boxes
    for (one, mine), (other, theirs) in combinations(needs.items(), 2):
        if not any(box.meet(their) for box in mine for their in theirs):
            return f"{one} and {other} exclude one another, whatever is measured"
    return f"{listing(needs, 8)} cannot be met together, whatever is measured"


def _needing(part: Node, boxes: tuple[Box, ...]) -> str:
    asked = " and ".join(one.text(name) for name, one in boxes[0].intervals.items()) if len(boxes) == 1 else ""
    return f"{part.kind} {part.name}" + (f" ({asked})" if asked else "")
