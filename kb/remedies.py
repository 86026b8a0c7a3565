"""Finds what an element needs to be feasible, and the smallest sets of facts that have to change.

By the status tables a model is an and/or structure: an action needs all its functions, a function
one of its designs, a design all its components, a component one of its configurations, and each of
them its own constraints. Each way through this structure is a conjunction of intervals and repairs.
"""

import math
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple

from kb.debounce import turning_point
from kb.elements import Action, Attribute, Constraint, Element, StalePolicy, exact
from kb.network import Node
from kb.state import State
from kb.status import IMPOSSIBLE, Status

LIMIT: Final = 64
"""The most conjunctions of one element."""
MOST_REMEDIES: Final = 16


class Interval(NamedTuple):
    """The numbers from one to another, both included."""

    low: float = -math.inf
    high: float = math.inf

    @classmethod
    def of(cls, constraint: Constraint, turn: float | None = None) -> "Interval":
        """Return the values that satisfy a constraint, or those beyond `turn` instead."""
        bound = constraint.value if turn is None else turn
        if constraint.operator == ">":
            bound = math.nextafter(bound, math.inf)
        elif constraint.operator == "<":
            bound = math.nextafter(bound, -math.inf)
        return cls(low=bound) if constraint.operator in (">=", ">") else cls(high=bound)

    def __contains__(self, value: object) -> bool:
        return isinstance(value, float | int) and self.low <= value <= self.high

    @property
    def is_empty(self) -> bool:
        """Whether it contains no finite number."""
        return max(self.low, -sys.float_info.max) > min(self.high, sys.float_info.max)

    def covers(self, other: "Interval") -> bool:
        return self.low <= other.low and other.high <= self.high

    def meet(self, other: "Interval") -> "Interval":
        return Interval(max(self.low, other.low), min(self.high, other.high))

    def text(self, attribute: object, unit: str = "") -> str:
        """Write it as comparisons of an attribute, e.g. "light >= 0.2 and light < 0.8"."""
        words = []
        for sign, bound, outside in ((">", self.low, -math.inf), ("<", self.high, math.inf)):
            if math.isfinite(bound):
                number = exact(bound)
                next_number = exact(math.nextafter(bound, outside))
                is_next_shorter = len(next_number) < len(number)
                comparison = f"{sign} {next_number}" if is_next_shorter else f"{sign}= {number}"
                words.append(f"{attribute} {comparison} {unit}".rstrip())
        return " and ".join(words)


def bounds(*nodes: Node) -> dict[str, Interval]:
    """Return the intervals that satisfy all own constraints of elements, by attribute."""
    intervals: dict[str, Interval] = {}
    for node in nodes:
        for constraint in node.constraints:
            name = constraint.constraint.attribute
            interval = Interval.of(constraint.constraint)
            intervals[name] = intervals.get(name, interval).meet(interval)
    return intervals


_REPAIRS: Final = {
    "recovered": "{} recovered",
    "retracted": "asserted status of {} retracted",
    "lapsed": "asserted status of {} retracted",
    "designed": "a design for {}",
}


class Repair(NamedTuple):
    """A change of a fact that is no measurement.

    Attributes:
        what: "recovered" for a component, "retracted" for an asserted status, "lapsed" for one
            that ends by itself, "designed" for a function without a design in the model.
        element: the element of the model.
    """

    what: str
    element: Element | Constraint

    def __str__(self) -> str:
        return _REPAIRS[self.what].format(getattr(self.element, "name", self.element))


class Conjunction(dict[str | Repair, Interval]):
    """One way to make an element feasible: the interval of each attribute, and repairs."""

    def covers(self, other: "Conjunction") -> bool:
        if not self.keys() <= other.keys():
            return False
        return all(interval.covers(other[what]) for what, interval in self.items())

    def meet(self, other: "Conjunction") -> "Conjunction | None":
        """Return what both ask for; None if nothing satisfies it."""
        both = Conjunction(self)
        for what, interval in other.items():
            both[what] = both.get(what, interval).meet(interval)
            if both[what].is_empty:
                return None
        return both


class Alternatives(NamedTuple):
    """The conjunctions of an element, none of which covers another, and whether these are all."""

    conjunctions: tuple[Conjunction, ...]
    complete: bool = True


TRUE: Final = Alternatives((Conjunction(),))
FALSE: Final = Alternatives(())


class Requirements:
    """What the elements of one network need.

    Args:
        state: the present facts. An attribute that is not measured or violates nothing is not
            restricted. With None, the question is what is possible at all: each constraint
            counts, nothing has failed, and a function without a design is impossible.
        limit: the most conjunctions of each element.
    """

    def __init__(self, state: State | None = None, limit: int = LIMIT) -> None:
        self._state = state
        self._limit = limit
        self._alternatives: dict[Node, Alternatives] = {}
        self._is_harmless: dict[Node, bool] = {}

    def of(self, node: Node) -> Alternatives:
        if node not in self._alternatives:
            self._alternatives[node] = self._find(node)
        return self._alternatives[node]

    def _find(self, node: Node) -> Alternatives:
        state = self._state
        asserted = None if state is None else state.asserted.get(node)
        if asserted not in (None, *IMPOSSIBLE):
            return TRUE
        needed = [self.of(constraint) for constraint in node.constraints]
        if asserted is Status.FAILURE or (state is not None and node in state.failed):
            needed.append(_repaired("recovered", node))
        if state is not None and asserted in (Status.UNFEASIBLE, Status.VIOLATED):
            is_lasting = state.reason("asserted", node).until is None
            needed.append(_repaired("retracted" if is_lasting else "lapsed", node))
        if node.kind == "constraint":
            needed.append(self._bound(node, node.requires[0]))
        elif node.kind == "function" and state is not None and not node.requires:
            needed.append(_repaired("designed", node))
        elif node.kind == "function" or (node.kind == "component" and node.requires):
            needed.append(self._any_of([self.of(part) for part in node.requires]))
        else:
            needed += [self.of(part) for part in node.requires]
        return self._all_of(needed)

    def _bound(self, node: Node, attribute: Node) -> Alternatives:
        state = self._state
        verdict = None
        possible = Interval()
        if state is not None:
            if attribute not in self._is_harmless:
                statuses = [state.compare(other) for other in attribute.constraints]
                self._is_harmless[attribute] = Status.VIOLATED not in statuses
            if self._is_harmless[attribute]:
                return TRUE
            verdict = state.verdict(node)
            element = attribute.attribute
            possible = Interval(element.low, element.high)
        interval = _required(node, verdict)
        if interval.meet(possible).is_empty:
            return FALSE
        return Alternatives((Conjunction({attribute.name: interval}),))

    def _any_of(self, choices: Iterable[Alternatives]) -> Alternatives:
        conjunctions = [conjunction for choice in choices for conjunction in choice.conjunctions]
        complete = all(choice.complete for choice in choices)
        return self._smallest(conjunctions, complete)

    def _all_of(self, needed: list[Alternatives]) -> Alternatives:
        needed.sort(key=lambda alternatives: len(alternatives.conjunctions))
        together = TRUE
        for conjunctions, complete in needed:
            meetings: list[Conjunction | None] = []
            for mine in together.conjunctions:
                is_covered = any(other.covers(mine) for other in conjunctions)
                meetings += [mine] if is_covered else [mine.meet(other) for other in conjunctions]
            possible = [meeting for meeting in meetings if meeting is not None]
            together = self._smallest(possible, together.complete and complete)
        return together

    def _smallest(self, conjunctions: Iterable[Conjunction], complete: bool) -> Alternatives:
        """Return those that no other covers, the fewest changes first, up to the limit."""
        smallest: list[Conjunction] = []
        for conjunction in sorted(conjunctions, key=self._changes):
            if any(other.covers(conjunction) for other in smallest):
                continue
            smallest = [other for other in smallest if not conjunction.covers(other)]
            if len(smallest) == self._limit:
                return Alternatives(tuple(smallest), False)
            smallest.append(conjunction)
        return Alternatives(tuple(smallest), complete)

    def _changes(self, conjunction: Conjunction) -> tuple[int, int]:
        changes = conjunction if self._state is None else _pending(self._state, conjunction)
        return len(changes), len(conjunction)


def _repaired(what: str, node: Node) -> Alternatives:
    return Alternatives((Conjunction({Repair(what, node.element): Interval()}),))


def _is_counted_violated(state: State, attribute: Node) -> bool:
    return attribute in state.stale and attribute.attribute.when_stale is StalePolicy.VIOLATED


def _required(node: Node, verdict: Status | None) -> Interval:
    return Interval.of(node.constraint, turning_point(node.constraint, verdict))


def _pending(state: State, conjunction: Conjunction) -> Conjunction:
    """Return the part of a conjunction that does not hold yet."""
    pending = Conjunction()
    for what, interval in conjunction.items():
        if isinstance(what, Repair):
            pending[what] = interval
            continue
        attribute = state.network.attributes[what]
        value = state.value.get(attribute)
        is_outside = value is not None and value not in interval
        is_held = any(
            state.verdict(node) is Status.VIOLATED
            and _required(node, Status.VIOLATED).covers(interval)
            for node in attribute.debounced
        )
        if is_outside or is_held or _is_counted_violated(state, attribute):
            pending[what] = interval
    return pending


@dataclass(frozen=True, slots=True)
class Measured:
    """A measurement that is needed: an attribute with a value in an interval.

    Attributes:
        attribute: the name of the attribute.
        interval: the interval, in the unit of the attribute.
        unit: the unit of the attribute; may be empty.
        how: "measured again" after the latest measurement is stale, "for longer" if the value is
            in the interval already, else empty.
    """

    attribute: str
    interval: Interval
    unit: str = ""
    how: str = ""

    def __str__(self) -> str:
        return f"{self.interval.text(self.attribute, self.unit)} {self.how}".rstrip()


@dataclass(frozen=True, slots=True)
class Remedy:
    """Facts that together would make an element feasible, measurements first."""

    facts: tuple[Measured | Repair, ...]

    def __str__(self) -> str:
        return " and ".join(map(str, self.facts))

    def is_restored_by(self, action: Action) -> bool:
        """Return whether all its facts are about attributes and components that an action restores.

        A measurement that has to be repeated or to last is about its attribute; an asserted status
        or a missing design is nothing that an action can restore. One that lapses needs no action.
        """
        attributes = [each.name for each in action.restores if isinstance(each, Attribute)]
        return all(
            fact.attribute in attributes
            if isinstance(fact, Measured)
            else fact.what == "lapsed"
            or (fact.what == "recovered" and fact.element in action.restores)
            for fact in self.facts
        )


def remedies(state: State, node: Node) -> tuple[tuple[Remedy, ...], bool]:
    """Return what would make an unfeasible or failed element feasible, smallest first.

    Also return whether these are all. If so, no subset of the facts of one of them is enough,
    whatever their values.
    """
    if node.kind == "constraint" or state.status[node] not in IMPOSSIBLE:
        return (), True
    alternatives = Requirements(state).of(node)
    pending = [_pending(state, conjunction) for conjunction in alternatives.conjunctions]
    smallest = {
        _remedy(state, mine)
        for mine in pending
        if not any(
            other.keys() < mine.keys()
            or (other.keys() == mine.keys() and other != mine and other.covers(mine))
            for other in pending
        )
    }
    ranked = sorted(smallest, key=lambda remedy: (len(remedy.facts), str(remedy)))
    return tuple(ranked[:MOST_REMEDIES]), alternatives.complete and len(ranked) <= MOST_REMEDIES


def _remedy(state: State, pending: Conjunction) -> Remedy:
    measurements = []
    repairs = []
    for what, interval in pending.items():
        if isinstance(what, Repair):
            repairs.append(what)
            continue
        attribute = state.network.attributes[what]
        how = ""
        if _is_counted_violated(state, attribute):
            how = "measured again"
        elif state.value[attribute] in interval:
            how = "for longer"
        measurements.append(Measured(what, interval, attribute.attribute.unit, how))
    measurements.sort(key=lambda fact: fact.attribute)
    return Remedy((*measurements, *sorted(repairs, key=str)))
