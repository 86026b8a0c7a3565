"""Finds what an element needs to be feasible, and the smallest sets of facts that have to change.

By the status tables a model is an and/or structure: an action needs all its functions, a function
one of its designs, a design all its components, a component one of its configurations, and each of
them its own constraints. Each way through this structure is a conjunction of intervals and repairs.
"""

import math
import sys
from collections.abc import Iterable
from typing import Final, NamedTuple

from kb.debounce import turning_point
from kb.elements import Action, Attribute, Constraint, Element, exact
from kb.network import Node
from kb.state import State
from kb.status import IMPOSSIBLE, VIOLATED, Status

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


class Conjunction(dict[Attribute | Repair, Interval]):
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

    def is_restored_by(self, action: Action) -> bool:
        """Return whether it is all about attributes and components that an action restores.

        An asserted status or a missing design is nothing that an action can restore. A status that
        lapses needs no action.
        """
        for what in self:
            is_restored = what in action.restores
            if isinstance(what, Repair):
                is_recovered = what.what == "recovered" and what.element in action.restores
                is_restored = is_recovered or what.what == "lapsed"
            if not is_restored:
                return False
        return True

    def __str__(self) -> str:
        texts = []
        for what, interval in self.items():
            text = str(what)
            if isinstance(what, Attribute):
                text = interval.text(what.name, what.unit)
            texts.append(text)
        return " and ".join(sorted(texts))


Alternatives = tuple[Conjunction, ...]
"""The conjunctions of an element, none of which covers another."""
TRUE: Final = (Conjunction(),)
FALSE: Final = ()


class Requirements:
    """What the elements of one network need.

    Args:
        state: the present facts. An attribute that is not measured or violates nothing is not
            restricted. With None, the question is what is possible at all: each constraint
            counts, nothing has failed, and a function without a design is impossible.
        limit: the most conjunctions of each element.

    Attributes:
        are_all: no alternative was left out because of the limit.
    """

    def __init__(self, state: State | None = None, limit: int = LIMIT) -> None:
        self._state = state
        self._limit = limit
        self.are_all = True
        self._alternatives: dict[Node, Alternatives] = {}
        self._violated: set[Node] = set()
        """The constraints that measurements violate."""
        if state is not None:
            constraints = state.network.kinds["constraint"].values()
            self._violated = {node for node in constraints if state.compare(node) is VIOLATED}

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
            choices = [conjunction for part in node.requires for conjunction in self.of(part)]
            needed.append(self._smallest(choices))
        else:
            needed += [self.of(part) for part in node.requires]
        return self._all_of(needed)

    def _bound(self, node: Node, attribute: Node) -> Alternatives:
        interval = Interval.of(node.constraint)
        possible = interval
        if self._state is not None:
            if self._violated.isdisjoint(attribute.constraints):
                return TRUE
            interval = self._required(node)
            possible = interval.meet(Interval(attribute.attribute.low, attribute.attribute.high))
        if possible.is_empty:
            return FALSE
        return (Conjunction({attribute.attribute: interval}),)

    def _required(self, node: Node) -> Interval:
        """Return the values that satisfy a constraint, beyond its hysteresis."""
        verdict = None if self._state is None else self._state.verdict(node)
        return Interval.of(node.constraint, turning_point(node.constraint, verdict))

    def pending(self, conjunction: Conjunction) -> Conjunction:
        """Return the part of a conjunction that does not hold yet."""
        if self._state is None:
            return conjunction
        pending = Conjunction()
        for what, interval in conjunction.items():
            nodes: list[Node] = []
            if isinstance(what, Attribute):
                nodes = self._state.network.attributes[what.name].constraints
            if isinstance(what, Repair) or any(
                self._required(node).covers(interval) for node in nodes if node in self._violated
            ):
                pending[what] = interval
        return pending

    def _all_of(self, needed: list[Alternatives]) -> Alternatives:
        together: Alternatives = TRUE
        for conjunctions in sorted(needed, key=len):
            meetings: list[Conjunction | None] = []
            for mine in together:
                is_covered = any(other.covers(mine) for other in conjunctions)
                meetings += [mine] if is_covered else [mine.meet(other) for other in conjunctions]
            together = self._smallest(meeting for meeting in meetings if meeting is not None)
        return together

    def _smallest(self, conjunctions: Iterable[Conjunction]) -> Alternatives:
        """Return those that no other covers, the fewest changes first, up to the limit."""
        smallest: list[Conjunction] = []
        for conjunction in sorted(conjunctions, key=self._changes):
            if any(other.covers(conjunction) for other in smallest):
                continue
            smallest = [other for other in smallest if not conjunction.covers(other)]
            if len(smallest) == self._limit:
                self.are_all = False
                break
            smallest.append(conjunction)
        return tuple(smallest)

    def _changes(self, conjunction: Conjunction) -> tuple[int, int]:
        return len(self.pending(conjunction)), len(conjunction)


def _repaired(what: str, node: Node) -> Alternatives:
    return (Conjunction({Repair(what, node.element): Interval()}),)


def remedies(state: State, node: Node) -> tuple[tuple[Conjunction, ...], bool]:
    """Return what would make an unfeasible or failed element feasible, smallest first.

    Also return whether these are all. If so, no subset of the facts of one of them is enough,
    whatever their values.
    """
    if node.kind == "constraint" or state.status[node] not in IMPOSSIBLE:
        return (), True
    requirements = Requirements(state)
    pending = [requirements.pending(conjunction) for conjunction in requirements.of(node)]
    smallest = {}
    for mine in pending:
        is_smallest = not any(
            other.keys() < mine.keys()
            or (other.keys() == mine.keys() and other != mine and other.covers(mine))
            for other in pending
        )
        if is_smallest:
            smallest[len(mine), str(mine)] = mine
    ranked = [smallest[rank] for rank in sorted(smallest)]
    return tuple(ranked[:MOST_REMEDIES]), requirements.are_all and len(ranked) <= MOST_REMEDIES
