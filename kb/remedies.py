"""Computes what an element needs to be feasible, and the smallest sets of facts that have to change for that.

By the status tables a model is an and/or structure: an action needs all its functions, a function one of its designs,
a design all its components, a component one of its configurations, and each of them its own constraints. Each way
through this structure is a conjunction: an interval for every attribute that matters, and the repairs that are needed.
"""

import math
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from kb.debounce import turning_point
from kb.elements import (
    Action,
    Attribute,
    Component,
    Constraint,
    Element,
    Function,
    StalePolicy,
    exact,
)
from kb.network import Node
from kb.state import State
from kb.status import IMPOSSIBLE, OPERATORS, Status

LIMIT: Final = 64
"""The most conjunctions that are kept for one element."""
WORK: Final = 20_000
"""The most pairs of conjunctions to combine for one element; for more, fewer conjunctions are kept in between."""
MOST_REMEDIES: Final = 16
"""The most remedies that are given."""


@dataclass(frozen=True, slots=True, order=True)
class Interval:
    """Values between two bounds: each is a number and 0, or 1 for just above the number, or -1 for just below."""

    low: tuple[float, int] = (-math.inf, 0)
    high: tuple[float, int] = (math.inf, 0)

    @classmethod
    def of(cls, constraint: Constraint, turn: float | None = None) -> "Interval":
        """Return the values that satisfy a constraint, or those beyond `turn` instead of its threshold."""
        bound = (
            constraint.value if turn is None else turn,
            {">": 1, "<": -1}.get(constraint.operator, 0),
        )
        return cls(low=bound) if constraint.operator in (">=", ">") else cls(high=bound)

    def __contains__(self, value: float) -> bool:
        return self.low <= (value, 0) <= self.high

    @property
    def is_empty(self) -> bool:
        """Whether it contains no finite number."""
        least, greatest = (
            math.nextafter(end, side * math.inf) if side else end
            for end, side in (self.low, self.high)
        )
        return max(least, -sys.float_info.max) > min(greatest, sys.float_info.max)

    def covers(self, other: "Interval") -> bool:
        return self.low <= other.low and other.high <= self.high

    def meet(self, other: "Interval") -> "Interval":
        return Interval(max(self.low, other.low), min(self.high, other.high))

    def text(self, attribute: str, unit: str = "") -> str:
        """Write it as comparisons of an attribute, e.g. "light >= 0.2 and light <= 0.8"."""
        signs = ">" if self.low[1] else ">=", "<" if self.high[1] else "<="
        ends = [
            (sign, end)
            for sign, (end, _) in zip(signs, (self.low, self.high), strict=True)
            if abs(end) < math.inf
        ]
        return " and ".join(
            f"{attribute} {sign} {exact(end)} {unit}".rstrip() for sign, end in ends
        )


def bounds(*nodes: Node) -> dict[str, Interval]:
    """Return the interval that satisfies all own constraints of elements, by attribute; it may be empty."""
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
    """A change of a fact that is no measurement.

    Attributes:
        what: "recovered" for a component, "retracted" for an asserted status, "designed" for a function without a
            design in the model.
        element: the element of the model.
    """

    what: str
    element: Element | Constraint

    def __str__(self) -> str:
        name = self.element if isinstance(self.element, Constraint) else self.element.name
        return _REPAIRS[self.what].format(name)


@dataclass(frozen=True, slots=True)
class Conjunction:
    """One way to make an element feasible: an interval for each attribute that matters, and the repairs."""

    intervals: Mapping[str, Interval] = field(default_factory=dict)
    repairs: frozenset[Repair] = frozenset()

    def covers(self, other: "Conjunction") -> bool:
        theirs = other.intervals
        if len(self.intervals) > len(theirs) or not self.repairs <= other.repairs:
            return False
        return all(
            name in theirs and mine.covers(theirs[name]) for name, mine in self.intervals.items()
        )

    def meet(self, other: "Conjunction") -> "Conjunction | None":
        intervals = dict(self.intervals)
        for name, interval in other.intervals.items():
            if name in intervals:
                interval = intervals[name].meet(interval)
                if interval.is_empty:
                    return None
            intervals[name] = interval
        return Conjunction(intervals, self.repairs | other.repairs)


class Alternatives(NamedTuple):
    """The conjunctions of an element, none of which covers another one, and whether these are all."""

    conjunctions: tuple[Conjunction, ...]
    complete: bool


TRUE: Final = Alternatives((Conjunction(),), True)
FALSE: Final = Alternatives((), True)


class Requirements:
    """What the elements of one network need; each result is kept, because other elements need it too.

    Args:
        state: the present facts; an attribute that is not measured or violates nothing puts no restriction, and repairs
            are counted. With None, the question is what is possible at all: every constraint counts, nothing has
            failed, and a function without a design is impossible.
        limit: the most conjunctions that are kept for each element.
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
        asserted = None if self._state is None else self._state.asserted.get(node)
        if asserted is None:
            return self._needs(node)
        if asserted not in IMPOSSIBLE:
            return TRUE
        repair = Repair("recovered" if asserted is Status.FAILURE else "retracted", node.element)
        return self._all_of([_repaired(repair), self._needs(node)])

    def _needs(self, node: Node) -> Alternatives:
        element = node.element
        if isinstance(element, Constraint):
            return self._bound(node, node.requires[0])
        if isinstance(element, Function):
            if node.requires:
                return self._any_of(self.of(part) for part in node.requires)
            return FALSE if self._state is None else _repaired(Repair("designed", element))
        needed = [self.of(constraint) for constraint in node.constraints]
        if not isinstance(element, Component):
            return self._all_of([*needed, *(self.of(part) for part in node.requires)])
        if self._state is not None and node in self._state.failed:
            needed.append(_repaired(Repair("recovered", element)))
        if node.requires:
            needed.append(self._any_of(self.of(part) for part in node.requires))
        return self._all_of(needed)

    def _bound(self, node: Node, attribute: Node) -> Alternatives:
        state = self._state
        if state is not None:
            is_known = state.value.get(attribute) is not None and attribute not in state.stale
            if not is_known and not _is_counted_violated(state, attribute):
                return TRUE
            if attribute.index not in self._holding:
                self._holding[attribute.index] = all(
                    _holds(state, attribute, one) for one in attribute.constraints
                )
            if self._holding[attribute.index]:
                return TRUE
        interval = _wanted(node, None if state is None else state.verdict(node))
        possible = interval
        if state is not None:  # no measurement will ever be outside the range
            of = attribute.attribute
            possible = interval.meet(Interval((of.low, 0), (of.high, 0)))
        if possible.is_empty:
            return FALSE
        return Alternatives((Conjunction({attribute.name: interval}),), True)

    def _any_of(self, choices: Iterable[Alternatives]) -> Alternatives:
        conjunctions: list[Conjunction] = []
        complete = True
        for choice in choices:
            if choice is TRUE:
                return TRUE
            conjunctions += choice.conjunctions
            complete = complete and choice.complete
        return self._kept(conjunctions, complete, self._limit)

    def _all_of(self, needed: Iterable[Alternatives]) -> Alternatives:
        restricting = sorted(
            (one for one in needed if one is not TRUE), key=lambda one: len(one.conjunctions)
        )
        if any(one == FALSE for one in restricting):
            return FALSE
        limit = min(
            self._limit, max(2, WORK // max(1, sum(len(one.conjunctions) for one in restricting)))
        )
        together = restricting[0] if restricting else TRUE
        for one in restricting[1:]:
            together = self._kept(
                _meetings(together.conjunctions, one.conjunctions),
                together.complete and one.complete,
                limit,
            )
        return together

    def _kept(
        self, conjunctions: Iterable[Conjunction], complete: bool, limit: int
    ) -> Alternatives:
        """Keep the conjunctions that no other covers, up to the limit; those with the fewest changes come first."""
        kept: list[Conjunction] = []
        for conjunction in sorted(conjunctions, key=self._changes):
            if any(other.covers(conjunction) for other in kept):
                continue
            kept = [other for other in kept if not conjunction.covers(other)]
            if len(kept) == limit:
                return Alternatives(tuple(kept), False)
            kept.append(conjunction)
        return Alternatives(tuple(kept), complete)

    def _changes(self, conjunction: Conjunction) -> tuple[int, int]:
        state = self._state
        if state is None:
            return 0, len(conjunction.intervals)
        table = state.network.attributes
        changed = sum(
            _is_outside(state, table[name], interval)
            for name, interval in conjunction.intervals.items()
        )
        return changed + len(conjunction.repairs), len(conjunction.intervals)


def _repaired(repair: Repair) -> Alternatives:
    return Alternatives((Conjunction(repairs=frozenset((repair,))),), True)


def _is_counted_violated(state: State, attribute: Node) -> bool:
    return attribute in state.stale and attribute.attribute.when_stale is StalePolicy.VIOLATED


def _is_outside(state: State, attribute: Node, interval: Interval) -> bool:
    """Return whether an attribute needs a new measurement to be within an interval."""
    value = state.value.get(attribute)
    if _is_counted_violated(state, attribute) or (value is not None and value not in interval):
        return True
    return any(
        state.verdict(one) is Status.VIOLATED and _wanted(one, Status.VIOLATED).covers(interval)
        for one in attribute.debounced
    )


def _wanted(node: Node, verdict: Status | None) -> Interval:
    return Interval.of(node.constraint, turning_point(node.constraint, verdict))


def _holds(state: State, attribute: Node, node: Node) -> bool:
    value, constraint = state.value.get(attribute), node.constraint
    if value is None or _is_counted_violated(state, attribute):
        return False
    if state.verdict(node) is not None:
        return state.verdict(node) is not Status.VIOLATED
    return OPERATORS[constraint.operator](value, constraint.value)


def _meetings(
    ones: tuple[Conjunction, ...], others: tuple[Conjunction, ...]
) -> Iterator[Conjunction]:
    for one in ones:
        if any(other.covers(one) for other in others):
            yield one
            continue
        yield from (both for other in others if (both := one.meet(other)) is not None)


@dataclass(frozen=True, slots=True)
class Measured:
    """A measurement that is needed: an attribute with a value in an interval.

    Attributes:
        attribute: the name of the attribute.
        interval: the interval, in the unit of the attribute.
        again: the latest measurement is stale.
        longer: the value is in the interval already, but not for as long or as often as dwell or agreement ask for.
        unit: the unit of the attribute; may be empty.
    """

    attribute: str
    interval: Interval
    again: bool = False
    longer: bool = False
    unit: str = ""

    def __str__(self) -> str:
        bounds = self.interval.text(self.attribute, self.unit)
        return (
            f"{bounds} measured again"
            if self.again
            else f"{bounds} for longer"
            if self.longer
            else bounds
        )


@dataclass(frozen=True, slots=True)
class Remedy:
    """Facts that together would make an element feasible, measurements first."""

    facts: tuple[Measured | Repair, ...]

    def __str__(self) -> str:
        return " and ".join(str(fact) for fact in self.facts)

    def is_restored_by(self, action: Action) -> bool:
        """Tell whether all its facts are about attributes and components that an action restores.

        A measurement that has to be repeated or to last is about its attribute; an asserted status
        or a missing design is nothing that an action can restore.
        """
        attributes = [each.name for each in action.restores if isinstance(each, Attribute)]
        for fact in self.facts:
            if isinstance(fact, Measured):
                if fact.attribute not in attributes:
                    return False
            elif fact.what != "recovered" or fact.element not in action.restores:
                return False
        return True

    def covers(self, other: "Remedy") -> bool:
        """Return whether the other remedy asks for more: further facts, or the same facts in narrower intervals."""
        own, its = (
            {getattr(one, "attribute", one) for one in each.facts} for each in (self, other)
        )  # without values
        if own != its:
            return own < its
        mine, theirs = (
            [one.interval for one in each.facts if isinstance(one, Measured)]
            for each in (self, other)
        )
        return all(one.covers(its) for one, its in zip(mine, theirs, strict=True))


def remedies(state: State, node: Node) -> tuple[tuple[Remedy, ...], bool]:
    """Return what would make an unfeasible or failed element feasible, smallest first, and whether these are all.

    If these are all, no subset of the facts of one of them is enough, whatever their values.
    """
    if node.kind == "constraint" or state.status[node] not in IMPOSSIBLE:
        return (), True
    ways = Requirements(state).of(node)
    found = _smallest(_remedy(state, conjunction) for conjunction in ways.conjunctions)
    return tuple(found[:MOST_REMEDIES]), ways.complete and len(found) <= MOST_REMEDIES


def _remedy(state: State, conjunction: Conjunction) -> Remedy:
    """Return the part of a conjunction that does not hold yet."""
    measured = []
    for name, interval in sorted(conjunction.intervals.items(), key=lambda one: one[0]):
        attribute = state.network.attributes[name]
        if _is_outside(state, attribute, interval):
            value, again = state.value.get(attribute), _is_counted_violated(state, attribute)
            longer = not again and value is not None and value in interval
            measured.append(Measured(name, interval, again, longer, attribute.attribute.unit))
    return Remedy((*measured, *sorted(conjunction.repairs, key=str)))


def _smallest(candidates: Iterable[Remedy]) -> list[Remedy]:
    kept: list[Remedy] = []
    for remedy in sorted(candidates, key=lambda one: (len(one.facts), str(one))):
        if not any(other.covers(remedy) for other in kept):
            kept = [*(other for other in kept if not remedy.covers(other)), remedy]
    return kept
