"""What can happen around a robot: what can be measured, as far as it makes a difference, and what can fail."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from itertools import combinations, pairwise
from math import inf
from typing import NamedTuple

from py_trees.behaviour import Behaviour

from kb import Event, KnowledgeBase
from kb.elements import Attribute, Constraint
from kb.status import OPERATORS
from missions.proof.planned import nodes
from rosa_bt.behaviours import HasStatus, Measurement

STALE = "stale"


class Change(NamedTuple):
    """One fact that changes: an attribute is measured so or stale, a component fails (True) or recovers (False)."""

    name: str
    to: float | bool | str

    def __str__(self) -> str:
        if isinstance(self.to, bool):
            return f"{self.name} {'fails' if self.to else 'recovers'}"
        return f"{self.name} is stale" if self.to == STALE else f"{self.name} is measured {self.to:g}"

    def tell(self, kb: KnowledgeBase) -> None:
        if isinstance(self.to, bool):
            (kb.component_failed if self.to else kb.component_recovered)(self.name)
        elif isinstance(self.to, float):
            kb.measure(self.name, self.to)
        else:
            kb.tell(Event(kb.log.last + 1, kb.now, STALE, (self.name,)))


class Surroundings:
    """Everything that can change in a model, once for each difference that it makes.

    Args:
        kb: of the robot.
        root: of the tree, whose own conditions on measurements count too.
        failures: how many components are failed at once at most.
        at_once: how many facts change between two ticks at most.
        values: by attribute, what else can be measured: what the tree or a question asks beside the model.
        failing: the components that can fail; None for all.
        symmetric: let only the first of several components fail that are alike in all that the model says.

    Attributes:
        failures: how many components are failed at once at most.
        at_once: how many facts change between two ticks at most.
        values: by attribute, one value for each difference.
        alike: the components that can fail, in groups of those that can stand for one another.
        worst: by attribute, the value that leaves the fewest constraints satisfied.
    """

    def __init__(
        self,
        kb: KnowledgeBase,
        root: Behaviour,
        *,
        failures: int = 1,
        at_once: int = 1,
        values: Mapping[str, Iterable[float]] | None = None,
        failing: Iterable[str] | None = None,
        symmetric: bool = True,
    ) -> None:
        self._kb, self.failures, self.at_once = kb, failures, at_once
        asked = _thresholds(kb, root)
        for name, more in (values or {}).items():
            asked[kb.attributes[name].name] |= {(">=", float(one)) for one in more}
        known = kb.model.attributes
        self.values = {name: _distinct(asked[name], known[name]) for name in kb.attributes if asked[name]}
        self.worst = {name: min(found, key=partial(satisfied, asked[name])) for name, found in self.values.items()}
        names = list(kb.components) if failing is None else [kb.components[one].name for one in failing]
        named = {one.element.name for one in nodes(root) if isinstance(one, HasStatus)}
        self.alike = _alike(kb, names, named) if symmetric else [(one,) for one in names]
        self._ageing = [name for name in self.values if kb.model.attributes[name].max_age != inf]

    def failed(self) -> tuple[str, ...]:
        """Return the components that are reported failed now."""
        return tuple(name for name, one in self._kb.components.items() if one.status == "failure")

    def changes(self) -> Iterator[tuple[Change, ...]]:
        """Yield what can happen next, none of it first; the knowledge base says how it is now."""
        single = [one for name in self.values for one in self._measured(name)]
        down = self.failed()
        single += [Change(broken[-1], False) for alike in self.alike if (broken := [o for o in alike if o in down])]
        single += [Change(working[0], True) for alike in self.alike if (working := [o for o in alike if o not in down])]
        for count in range(self.at_once + 1):
            for chosen in combinations(single, count):
                more = sum(1 if one.to else -1 for one in chosen if isinstance(one.to, bool))
                if len({one.name for one in chosen}) == count and (more <= 0 or len(down) + more <= self.failures):
                    yield chosen

    def _measured(self, name: str) -> Iterator[Change]:
        view = self._kb.attributes[name]
        repeats = self._kb.model.attributes[name].agreement != (1, 1)
        for value in self.values[name]:
            if repeats or view.is_stale or value != view.value:
                yield Change(name, value)
        if name in self._ageing and view.value is not None and not view.is_stale:
            yield Change(name, STALE)


def satisfied(asked: Iterable[tuple[str, float]], value: float) -> int:
    """Return how many comparisons, each an operator and what is compared with, hold of a value."""
    return sum(OPERATORS[sign](value, of) for sign, of in asked)


def _thresholds(kb: KnowledgeBase, root: Behaviour) -> defaultdict[str, set[tuple[str, float]]]:
    """Return what each attribute is compared with, by the model and by the conditions of the tree."""
    found: defaultdict[str, set[tuple[str, float]]] = defaultdict(set)
    for elements in (kb.actions, kb.designs, kb.components, kb.configurations):
        for element in elements.values():
            for one in (view.element for view in element.constraints):
                assert isinstance(one, Constraint)
                found[one.attribute] |= {(one.operator, one.value + side * one.hysteresis) for side in (1, 0, -1)}
    for leaf in nodes(root):
        if isinstance(leaf, Measurement):
            found[leaf.attribute.name].add((leaf.operator, leaf.value))
    return found


def _distinct(asked: set[tuple[str, float]], attribute: Attribute) -> tuple[float, ...]:
    """Return values of an attribute, one for each combination of answers to comparisons that there can be."""
    low, high = attribute.low, attribute.high
    known = sorted({value for _, value in asked})
    below = (low + known[0]) / 2 if low > -inf else known[0] - 1.0
    above = (known[-1] + high) / 2 if high < inf else known[-1] + 1.0
    between = [(one + other) / 2 for one, other in pairwise(known)]
    found: dict[tuple[bool, ...], float] = {}
    for value in (below, *between, above, *known):
        if low <= value <= high:
            found.setdefault(tuple(OPERATORS[sign](value, of) for sign, of in sorted(asked)), value)
    return tuple(sorted(found.values()))


def _alike(kb: KnowledgeBase, names: Iterable[str], named: set[str]) -> list[tuple[str, ...]]:
    """Return the components in groups whose members can stand for one another; what is asked by name stands alone."""
    groups: defaultdict[object, list[str]] = defaultdict(list)
    for name in names:
        view = kb.components[name]
        users = frozenset(design for design, one in kb.designs.items() if name in one.components)
        is_plain = not view.configurations and not view.constraints and name not in named
        groups[(users, view.kind, view.always_improve) if is_plain else name].append(name)
    return [tuple(group) for group in groups.values()]
