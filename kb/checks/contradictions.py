"""What no measurement makes possible: constraints that contradict one another, on one element or on what it needs.

An attribute that is not measured violates nothing, so what is found here is unfeasible once its attributes are
measured. Only the root is reported, with the actions that it makes impossible, and not each element between the two.
"""

from collections.abc import Iterable, Iterator
from itertools import combinations
from typing import Final, NamedTuple

from kb.checks.findings import Finding, found, listing
from kb.elements import Constraint
from kb.explanation.requirements import Alternatives, Box, Interval, Requirements
from kb.inference.settling import Network, Node

__all__ = ["bounds", "contradictions"]

QUICK: Final = 4
"""How many alternatives suffice to see that most elements are possible; all are looked at only for the others."""
MOST_ACTIONS: Final = 4


def bounds(node: Node) -> dict[str, Interval]:
    """Return the values that an element's own constraints leave, by name of the attribute; some may be empty."""
    intervals: dict[str, Interval] = {}
    for constraint in _own(node):
        interval = Interval.of(constraint)
        known = intervals.get(constraint.attribute)
        intervals[constraint.attribute] = interval if known is None else known.meet(interval)
    return intervals


def contradictions(network: Network) -> Iterator[Finding]:
    """Yield what can never be feasible and is no mere consequence of something else that is found."""
    needs = _Needs()
    impossible = {
        node.index
        for table in (
            network.configurations,
            network.components,
            network.designs,
            network.functions,
            network.actions,
        )
        for node in table.values()
        if needs.are_impossible(node)
    }
    for node in network.nodes:
        if node.index in impossible:
            for code, message in _roots(node, impossible, needs):
                yield found(code, f"{node.kind} {node.name}", message + _consequence(node, impossible))


def _roots(node: Node, impossible: set[int], needs: "_Needs") -> Iterator[tuple[str, str]]:
    """Yield code and message of each reason for which an element is impossible that is no reason of another one."""
    what = f"{node.kind} {node.name}"
    if node.kind == "function":
        if not node.parts:
            yield "function-without-designs", f"{what} has no design"
        return
    empty = [name for name, interval in bounds(node).items() if interval.is_empty]
    for attribute in empty:
        yield "contradictory-constraints", f"{what} is constrained by {_contradiction(node, attribute)}"
    broken = [part.index in impossible for part in node.parts]
    is_consequence = any(broken) and (all(broken) or node.kind != "component")
    if not empty and not is_consequence:
        yield "never-feasible", f"{what} can never be feasible: {_conflict(node, needs)}"


def _contradiction(node: Node, attribute: str) -> str:
    """Name two constraints that exclude one another; one suffices if no number satisfies it."""
    own = [constraint for constraint in _own(node) if constraint.attribute == attribute]
    for one in own:
        if Interval.of(one).is_empty:
            return f"{one}, which no number satisfies"
    for one, other in combinations(own, 2):
        if Interval.of(one).meet(Interval.of(other)).is_empty:
            return f"{one} and {other}, which no value satisfies both"
    raise AssertionError(f"{attribute} is not contradictory")  # two bounds make an interval empty, never three


def _consequence(node: Node, impossible: set[int]) -> str:
    """Say which actions an impossible element makes impossible."""
    actions: list[str] = []
    seen = {node.index}
    waiting = [node]
    for one in waiting:
        for whole in one.wholes:
            if whole.index in impossible and whole.index not in seen:
                seen.add(whole.index)
                waiting.append(whole)
                actions += [whole.name] if whole.kind == "action" else []
        if len(actions) > MOST_ACTIONS:
            return f", so {len(actions)} actions or more can never be feasible, e.g. {actions[0]}"
    return f", so action {listing(actions)} can never be feasible" if actions else ""


class _Need(NamedTuple):
    """One of the things that an element needs all of.

    Attributes:
        name: how it is called.
        nodes: the constraints it comes from are on these, or on what they are made of; none if the name says it all.
        boxes: the ways to have it.
    """

    name: str
    nodes: tuple[Node, ...]
    boxes: tuple[Box, ...]

    def hull(self, attribute: str) -> Interval | None:
        """Return the narrowest interval for an attribute that holds the values of every way, None for all values."""
        intervals = [box.intervals.get(attribute) for box in self.boxes]
        known = [interval for interval in intervals if interval is not None]
        if len(known) < len(intervals):
            return None
        low, low_open = min((one.low, one.low_open) for one in known)
        high, high_closed = max((one.high, not one.high_open) for one in known)
        return Interval(low, high, low_open, not high_closed)


class _Needs:
    """What elements need, looked at quickly first and thoroughly where that does not decide."""

    def __init__(self) -> None:
        self._quick = Requirements(limit=QUICK)
        self._thorough = Requirements()

    def are_impossible(self, node: Node) -> bool:
        """Tell whether an element is certainly impossible."""
        ways = self._ways(node)
        return not ways.boxes and ways.complete

    def of(self, node: Node) -> list[_Need]:
        """Return what an element needs all of."""
        needs = [_Need(f"its own constraint {one}", (), _box(one)) for one in _own(node)]
        if node.kind == "component":
            boxes = tuple(box for part in node.parts for box in self._thorough.of(part).boxes)
            return [*needs, _Need("each of its configurations", tuple(node.parts), boxes)]
        parts = [_Need(f"{part.kind} {part.name}", (part,), self._thorough.of(part).boxes) for part in node.parts]
        return needs + parts

    def _ways(self, node: Node) -> Alternatives:
        ways = self._quick.of(node)
        return ways if ways.boxes or ways.complete else self._thorough.of(node)


def _conflict(node: Node, needs: _Needs) -> str:
    """Name two needs that exclude one another, with the chain from each down to the constraint, as far as can be."""
    listed = needs.of(node)
    for one, other in combinations(listed, 2):
        if any(mine.meet(theirs) is not None for mine in one.boxes for theirs in other.boxes):
            continue
        for attribute in one.boxes[0].intervals:
            mine, theirs = one.hull(attribute), other.hull(attribute)
            if mine is not None and theirs is not None and mine.meet(theirs).is_empty:
                return f"{_chain(one, attribute, mine)}, but {_chain(other, attribute, theirs)}"
        return f"{one.name} and {other.name} exclude one another, whatever is measured"
    return f"{listing((need.name for need in listed), 8)} cannot be met together, whatever is measured"


def _chain(need: _Need, attribute: str, interval: Interval) -> str:
    """Say which values a need asks for, and where the constraint is that says so."""
    if not need.nodes:
        return need.name
    path = [step for step in _path(need.nodes, attribute, interval) if step != need.name]
    return f"{need.name} needs {interval.text(attribute)}" + (f" (by {' of '.join(path)})" if path else "")


def _path(nodes: Iterable[Node], attribute: str, interval: Interval) -> list[str]:
    """Return the way down to the first constraint with a bound of the interval, the lowest element first."""
    above: dict[Node, Node | None] = dict.fromkeys(nodes)
    waiting = list(above)
    for node in waiting:
        if any(_is_bound(one, attribute, interval) for one in _own(node)):
            path: list[str] = []
            step: Node | None = node
            while step is not None:
                path.append(f"{step.kind} {step.name}")
                step = above[step]
            return path
        for part in node.parts:
            if part not in above:
                above[part] = node
                waiting.append(part)
    return []


def _is_bound(constraint: Constraint, attribute: str, interval: Interval) -> bool:
    return constraint.attribute == attribute and constraint.value in (interval.low, interval.high)


def _box(constraint: Constraint) -> tuple[Box, ...]:
    return (Box({constraint.attribute: Interval.of(constraint)}),)


def _own(node: Node) -> Iterator[Constraint]:
    for one in node.constraints:
        assert isinstance(one.element, Constraint)
        yield one.element
