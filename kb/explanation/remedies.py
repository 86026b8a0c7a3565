"""What would make something unfeasible feasible: the smallest sets of facts that would have to be others."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from typing import Final, NamedTuple

from kb.explanation.requirements import Box, Interval, Repair, Requirements, is_counted_violated, is_outside
from kb.inference.network import Node
from kb.inference.state import State
from kb.status import Status

__all__ = ["ChangedFact", "Measured", "Remedies", "Remedy", "remedies"]

MOST: Final = 16
"""How many remedies are told at most."""
WORK: Final = 1_000_000
"""How many elements are looked at to make remedies smaller, when there are too many to look at all."""


@dataclass(frozen=True, slots=True)
class Measured:
    """An attribute is measured with a value in an interval.

    Attributes:
        attribute: its name.
        interval: in its unit.
        again: what is known of it is too old.
        longer: it was measured so already, but not for as long or as often as a steady constraint asks for.
    """

    attribute: str
    interval: Interval
    again: bool = False
    longer: bool = False

    def __str__(self) -> str:
        bounds = self.interval.text(self.attribute)
        return f"{bounds} measured anew" if self.again else f"{bounds} for longer" if self.longer else bounds


ChangedFact = Measured | Repair


@dataclass(frozen=True, slots=True)
class Remedy:
    """Facts that together would make an element feasible; no fewer of them would, whatever their values.

    Attributes:
        facts: what is to be measured, by name, and then what is to be repaired.
    """

    facts: tuple[ChangedFact, ...]

    def __str__(self) -> str:
        return " and ".join(str(fact) for fact in self.facts)

    @property
    def _subjects(self) -> frozenset[str | Repair]:
        """What has to change, whatever to."""
        return frozenset(fact.attribute if isinstance(fact, Measured) else fact for fact in self.facts)

    def _covers(self, other: "Remedy") -> bool:
        """Tell whether the other one asks for more: other facts too, or the same in narrower intervals."""
        if self._subjects != other._subjects:
            return self._subjects < other._subjects
        pairs = zip(self.facts, other.facts, strict=True)
        return all(
            mine.interval.covers(theirs.interval)
            for mine, theirs in pairs
            if isinstance(mine, Measured) and isinstance(theirs, Measured)
        )


class Remedies(NamedTuple):
    """What would make an element feasible.

    Attributes:
        found: the smallest first; empty if it is not unfeasible, or if nothing would help.
        complete: these are all.
    """

    found: tuple[Remedy, ...]
    complete: bool


def remedies(state: State, node: Node) -> Remedies:
    """Return what would make an element feasible that is unfeasible or in failure."""
    if state.status[node.index] not in (Status.UNFEASIBLE, Status.FAILURE):
        return Remedies((), True)
    requirements = Requirements(state)
    ways = requirements.of(node)
    found = _smallest(_remedy(state, box) for box in ways.boxes)
    if not ways.complete:
        found = _reduced(state, node, requirements, found)
    return Remedies(tuple(found[:MOST]), ways.complete and len(found) <= MOST)


def _remedy(state: State, box: Box) -> Remedy:
    """Return what of a box is not so already."""
    measured = []
    for name in sorted(box.intervals):
        attribute, interval = state.network.attributes[name], box.intervals[name]
        if is_outside(state, attribute, interval):
            value, again = state.value[attribute.index], is_counted_violated(state, attribute)
            measured.append(Measured(name, interval, again, not again and value is not None and value in interval))
    return Remedy((*measured, *sorted(box.repairs, key=str)))


def _smallest(candidates: Iterable[Remedy]) -> list[Remedy]:
    """Return the remedies that no other covers, the smallest first."""
    kept: list[Remedy] = []
    for remedy in sorted(candidates, key=lambda one: (len(one.facts), str(one))):
        if not any(other._covers(remedy) for other in kept):
            kept = [other for other in kept if not remedy._covers(other)]
            kept.append(remedy)
    return kept


def _reduced(state: State, node: Node, requirements: Requirements, found: list[Remedy]) -> list[Remedy]:
    """Take from remedies what is not needed: where not every way was looked at, a smaller one may have been missed."""
    looks = WORK // requirements.size
    reduced: list[Remedy] = []
    for remedy in islice(found, MOST):
        looks -= len(remedy.facts)
        if looks < 0:
            break
        reduced += _least(state, node, requirements, remedy)
    return _smallest(reduced) or found


def _least(state: State, node: Node, requirements: Requirements, remedy: Remedy) -> list[Remedy]:
    subjects = remedy._subjects
    for subject in sorted(subjects, key=str):
        fewer = subjects - {subject}
        if requirements.only(fewer).of(node).boxes:
            subjects = fewer
    return [_remedy(state, box) for box in requirements.only(subjects).of(node).boxes]
