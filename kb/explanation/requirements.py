"""What an element needs to be possible, and the smallest sets of facts that would have to be others for that.

The status tables make an and/or structure of a model: an action needs all its functions, a function one of its
designs, a design all its components, a component one of its configurations, and each of them its own constraints.
Each way through it is a box: an interval for every attribute that matters, and what has to be repaired besides.
"""

import math
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from kb.elements import Component, Constraint, Element, Function, StalePolicy, exact
from kb.measurements import turning_point
from kb.network import Node
from kb.state import State
from kb.status import IMPOSSIBLE, OPERATORS, Status

LIMIT: Final = 64
"""How many boxes are kept for one element."""
WORK: Final = 20_000
"""How many pairs of boxes are looked at for one element before fewer are kept on the way."""
MOST_REMEDIES: Final = 16
"""How many remedies are given at most."""


@dataclass(frozen=True, slots=True, order=True)
class Interval:
    """Values between two bounds: each is a number and 0, or 1 for what is just above it, or -1 for just below."""

    low: tuple[float, int] = (-math.inf, 0)
    high: tuple[float, int] = (math.inf, 0)

    @classmethod
    def of(cls, constraint: Constraint, turn: float | None = None) -> "Interval":
        """Return the values that satisfy a constraint; it may turn elsewhere than at its threshold."""
        bound = constraint.value if turn is None else turn, {">": 1, "<": -1}.get(constraint.operator, 0)
        return cls(low=bound) if constraint.operator in (">=", ">") else cls(high=bound)

    def __contains__(self, value: float) -> bool:
        return self.low <= (value, 0) <= self.high

    @property
    def is_empty(self) -> bool:
        """Whether no finite number lies in it."""
        least, greatest = (math.nextafter(end, side * math.inf) if side else end for end, side in (self.low, self.high))
        return max(least, -sys.float_info.max) > min(greatest, sys.float_info.max)

    def covers(self, other: "Interval") -> bool:
        return self.low <= other.low and other.high <= self.high

    def meet(self, other: "Interval") -> "Interval":
        return Interval(max(self.low, other.low), min(self.high, other.high))

    def text(self, attribute: str, unit: str = "") -> str:
        """Write it as comparisons of an attribute, e.g. "light >= 0.2 and light <= 0.8"."""
        signs = ">" if self.low[1] else ">=", "<" if self.high[1] else "<="
        ends = [(sign, end) for sign, (end, _) in zip(signs, (self.low, self.high), strict=True) if abs(end) < math.inf]
        return " and ".join(f"{attribute} {sign} {exact(end)} {unit}".rstrip() for sign, end in ends)


def bounds(*nodes: Node) -> dict[str, Interval]:
    """Return the values that elements' own constraints leave together, by attribute; some may be empty."""
    intervals: dict[str, Interval] = {}
    for constraint in (one.constraint for node in nodes for one in node.constraints):
        interval, known = Interval.of(constraint), intervals.get(constraint.attribute)
        intervals[constraint.attribute] = known.meet(interval) if known else interval
    return intervals


_REPAIRS: Final = {
    "recovered": "{} recovered",
    "retracted": "asserted status of {} retracted",
    "designed": "a design for {}",
}


class Repair(NamedTuple):
    """A fact that has to change and is no measurement.

    Attributes:
        what: a component is "recovered", an asserted status "retracted", or a function that the model has no design for
            "designed".
        element: of the model, which this is about.
    """

    what: str
    element: Element | Constraint

    def __str__(self) -> str:
        name = self.element if isinstance(self.element, Constraint) else self.element.name
        return _REPAIRS[self.what].format(name)


@dataclass(frozen=True, slots=True)
class Box:
    """One way in which an element is possible: the values of each attribute that matters, and what is repaired."""

    intervals: Mapping[str, Interval] = field(default_factory=dict)
    repairs: frozenset[Repair] = frozenset()

    def covers(self, other: "Box") -> bool:
        theirs = other.intervals
        if len(self.intervals) > len(theirs) or not self.repairs <= other.repairs:
            return False
        return all(name in theirs and mine.covers(theirs[name]) for name, mine in self.intervals.items())

    def meet(self, other: "Box") -> "Box | None":
        intervals = dict(self.intervals)
        for name, interval in other.intervals.items():
            if name in intervals:
                interval = intervals[name].meet(interval)
                if interval.is_empty:
                    return None
            intervals[name] = interval
        return Box(intervals, self.repairs | other.repairs)


class Alternatives(NamedTuple):
    """The ways in which an element is possible, none that another one covers, and whether these are all."""

    boxes: tuple[Box, ...]
    complete: bool


FREE: Final = Alternatives((Box(),), True)
NOTHING: Final = Alternatives((), True)


class Requirements:
    """What the elements of one network need; what is found out about one is kept for the others.

    Args:
        state: the facts to start from; an attribute that they do not know or that violates nothing restricts nothing,
            and repairs are asked for. None asks what is possible at all: every constraint counts, nothing has failed
            and a function without a design is impossible.
        limit: how many boxes are kept for each element.
    """

    def __init__(self, state: State | None = None, limit: int = LIMIT) -> None:
        self._state, self._limit = state, limit
        self._known: dict[int, Alternatives] = {}
        self._holding: dict[int, bool] = {}

    def of(self, node: Node) -> Alternatives:
        if node.index not in self._known:
            self._known[node.index] = self._with_assertion(node)
        return self._known[node.index]

    def _with_assertion(self, node: Node) -> Alternatives:
        asserted = None if self._state is None else self._state.asserted[node.index]
        if asserted is None:
            return self._needs(node)
        if asserted not in IMPOSSIBLE:
            return FREE
        repair = Repair("recovered" if asserted is Status.FAILURE else "retracted", node.element)
        return self._all_of([_repaired(repair), self._needs(node)])

    def _needs(self, node: Node) -> Alternatives:
        element = node.element
        if isinstance(element, Constraint):
            return self._bound(node, node.parts[0])
        if isinstance(element, Function):
            if node.parts:
                return self._any_of(self.of(part) for part in node.parts)
            return NOTHING if self._state is None else _repaired(Repair("designed", element))
        needed = [self.of(constraint) for constraint in node.constraints]
        if not isinstance(element, Component):
            return self._all_of([*needed, *(self.of(part) for part in node.parts)])
        if self._state is not None and self._state.failed[node.index]:
            needed.append(_repaired(Repair("recovered", element)))
        if node.parts:
            needed.append(self._any_of(self.of(part) for part in node.parts))
        return self._all_of(needed)

    def _bound(self, node: Node, attribute: Node) -> Alternatives:
        state = self._state
        if state is not None:
            is_known = state.value[attribute.index] is not None and not state.stale[attribute.index]
            if not is_known and not _is_counted_violated(state, attribute):
                return FREE
            if attribute.index not in self._holding:
                self._holding[attribute.index] = all(_holds(state, attribute, one) for one in attribute.constraints)
            if self._holding[attribute.index]:
                return FREE
        interval = _wanted(node, None if state is None else state.verdict[node.index])
        return NOTHING if interval.is_empty else Alternatives((Box({attribute.name: interval}),), True)

    def _any_of(self, choices: Iterable[Alternatives]) -> Alternatives:
        boxes: list[Box] = []
        complete = True
        for choice in choices:
            if choice is FREE:
                return FREE
            boxes += choice.boxes
            complete = complete and choice.complete
        return self._kept(boxes, complete, self._limit)

    def _all_of(self, needed: Iterable[Alternatives]) -> Alternatives:
        restricting = sorted((one for one in needed if one is not FREE), key=lambda one: len(one.boxes))
        if any(one == NOTHING for one in restricting):
            return NOTHING
        limit = min(self._limit, max(2, WORK // max(1, sum(len(one.boxes) for one in restricting))))
        together = restricting[0] if restricting else FREE
        for one in restricting[1:]:
            together = self._kept(_meetings(together.boxes, one.boxes), together.complete and one.complete, limit)
        return together

    def _kept(self, boxes: Iterable[Box], complete: bool, limit: int) -> Alternatives:
        """Keep the boxes that no other covers, those that change the least first, and as many as the limit allows."""
        kept: list[Box] = []
        for box in sorted(boxes, key=self._changes):
            if any(other.covers(box) for other in kept):
                continue
            kept = [other for other in kept if not box.covers(other)]
            if len(kept) == limit:
                return Alternatives(tuple(kept), False)
            kept.append(box)
        return Alternatives(tuple(kept), complete)

    def _changes(self, box: Box) -> tuple[int, int]:
        state = self._state
        if state is None:
            return 0, len(box.intervals)
        table = state.network.attributes
        changed = sum(_is_outside(state, table[name], interval) for name, interval in box.intervals.items())
        return changed + len(box.repairs), len(box.intervals)


def _repaired(repair: Repair) -> Alternatives:
    return Alternatives((Box(repairs=frozenset((repair,))),), True)


def _is_counted_violated(state: State, attribute: Node) -> bool:
    return state.stale[attribute.index] and attribute.attribute.when_stale is StalePolicy.VIOLATED


def _is_outside(state: State, attribute: Node, interval: Interval) -> bool:
    """Tell whether an attribute has to be measured anew to be within an interval."""
    value = state.value[attribute.index]
    if _is_counted_violated(state, attribute) or (value is not None and value not in interval):
        return True
    return any(
        state.verdict[one.index] is Status.VIOLATED and _wanted(one, Status.VIOLATED).covers(interval)
        for one in state.network.thresholds(attribute).steady
    )


def _wanted(node: Node, verdict: Status | None) -> Interval:
    return Interval.of(node.constraint, turning_point(node.constraint, verdict))


def _holds(state: State, attribute: Node, node: Node) -> bool:
    value, constraint = state.value[attribute.index], node.constraint
    if value is None or _is_counted_violated(state, attribute):
        return False
    if state.verdict[node.index] is not None:
        return state.verdict[node.index] is not Status.VIOLATED
    return OPERATORS[constraint.operator](value, constraint.value)


def _meetings(ones: tuple[Box, ...], others: tuple[Box, ...]) -> Iterator[Box]:
    for one in ones:
        if any(other.covers(one) for other in others):
            yield one
            continue
        yield from (both for other in others if (both := one.meet(other)) is not None)


@dataclass(frozen=True, slots=True)
class Measured:
    """An attribute is measured with a value in an interval.

    Attributes:
        attribute: its name.
        interval: in its unit.
        again: what is known of it is too old.
        longer: it was measured so already, but not for as long or as often as a steady constraint asks for.
        unit: of the attribute; may be empty.
    """

    attribute: str
    interval: Interval
    again: bool = False
    longer: bool = False
    unit: str = ""

    def __str__(self) -> str:
        bounds = self.interval.text(self.attribute, self.unit)
        return f"{bounds} measured anew" if self.again else f"{bounds} for longer" if self.longer else bounds


@dataclass(frozen=True, slots=True)
class Remedy:
    """Facts that together would make an element feasible, measurements first."""

    facts: tuple[Measured | Repair, ...]

    def __str__(self) -> str:
        return " and ".join(str(fact) for fact in self.facts)

    @property
    def subjects(self) -> frozenset[str | Repair]:
        """What has to change, whatever to."""
        return frozenset(fact.attribute if isinstance(fact, Measured) else fact for fact in self.facts)

    def covers(self, other: "Remedy") -> bool:
        """Tell whether the other one asks for more: other facts too, or the same in narrower intervals."""
        if self.subjects != other.subjects:
            return self.subjects < other.subjects
        mine, theirs = ([one.interval for one in each.facts if isinstance(one, Measured)] for each in (self, other))
        return all(one.covers(its) for one, its in zip(mine, theirs, strict=True))


def remedies(state: State, node: Node) -> tuple[tuple[Remedy, ...], bool]:
    """Return what would make an element feasible that is not, the smallest first, and whether these are all.

    If they are all, no fewer facts than those of one would do, whatever their values.
    """
    if node.kind == "constraint" or state.status[node.index] not in IMPOSSIBLE:
        return (), True
    ways = Requirements(state).of(node)
    found = _smallest(_remedy(state, box) for box in ways.boxes)
    return tuple(found[:MOST_REMEDIES]), ways.complete and len(found) <= MOST_REMEDIES


def _remedy(state: State, box: Box) -> Remedy:
    """Return what of a box is not so already."""
    measured = []
    for name, interval in sorted(box.intervals.items(), key=lambda one: one[0]):
        attribute = state.network.attributes[name]
        if _is_outside(state, attribute, interval):
            value, again = state.value[attribute.index], _is_counted_violated(state, attribute)
            longer = not again and value is not None and value in interval
            measured.append(Measured(name, interval, again, longer, attribute.attribute.unit))
    return Remedy((*measured, *sorted(box.repairs, key=str)))


def _smallest(candidates: Iterable[Remedy]) -> list[Remedy]:
    kept: list[Remedy] = []
    for remedy in sorted(candidates, key=lambda one: (len(one.facts), str(one))):
        if not any(other.covers(remedy) for other in kept):
            kept = [*(other for other in kept if not remedy.covers(other)), remedy]
    return kept
