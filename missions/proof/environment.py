"""What can happen to a robot: the facts of a model that change, with one value for each difference that values make.

Facts that make no difference apart are explored as one: of attributes that only violate the constraints of the same
elements, and of components that the model does not tell apart, only the first changes.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from itertools import combinations, pairwise
from math import inf
from typing import Final, NamedTuple

from py_trees.behaviour import Behaviour

from kb import Event, KnowledgeBase, Model
from kb.elements import Attribute, Constraint
from kb.status import OPERATORS
from rosa_bt.behaviours import HasStatus, Measurement

STALE: Final = "stale"
Value = float | str | None
"""What was measured last; STALE if that is too old, None if nothing was measured."""
Signature = frozenset[object]
"""What a value violates: elements of the model, and comparisons of the tree."""


class Facts(NamedTuple):
    """All that a knowledge base is told and decides; statuses follow from it."""

    values: tuple[Value, ...]
    failed: frozenset[str]
    active: frozenset[str]
    selected: frozenset[tuple[str, str]]
    requested: tuple[tuple[str, str], ...]


class Change(NamedTuple):
    """One change of a fact: an attribute is measured or goes stale, a component fails (True) or recovers (False)."""

    name: str
    to: float | bool | str

    def __str__(self) -> str:
        if isinstance(self.to, bool):
            return f"{self.name} {'fails' if self.to else 'recovers'}"
        if self.to == STALE:
            return f"{self.name} is stale"
        return f"{self.name} is measured {self.to:g}"

    def apply(self, kb: KnowledgeBase) -> None:
        """Let it happen."""
        if isinstance(self.to, bool):
            (kb.component_failed if self.to else kb.component_recovered)(self.name)
        elif isinstance(self.to, str):
            make_stale(kb, self.name)
        else:
            kb.measure(self.name, self.to)


def make_stale(kb: KnowledgeBase, attribute: str) -> None:
    kb.replay(Event(kb.log.last + 1, kb.now, STALE, (attribute,)))


def is_debounced(model: Model) -> bool:
    """Tell whether some measurement has to be confirmed by others or by time before it counts."""
    confirmed = any(each.agreement != (1, 1) for each in model.attributes.values())
    return confirmed or any(each.hysteresis or each.dwell for each in model.constraints)


def without_debouncing(model: Model) -> Model:
    """Let each measurement count at once: hysteresis, dwell and agreement only delay what is explored anyway."""
    if is_debounced(model):
        for constraint in model.constraints:
            model.change(constraint, hysteresis=0.0, dwell=0.0)
        for attribute in model.attributes.values():
            model.change(attribute, agreement=(1, 1))
    return model


class Environment:
    """The facts of a model that can change.

    Args:
        kb: of the robot.
        leaves: of the tree, whose own conditions on measurements count too.
        failures: how many components are failed at once at most.
        at_once: how many facts change between two ticks at most.
        values: by attribute, further thresholds that the tree or a property compares with.
        failing: the components that can fail; None for all.
        symmetric: let only the first of several facts that make no difference apart change.

    Attributes:
        values: by attribute that changes, one value for each difference.
        alike: the components that can fail, in groups that the model does not tell apart.
        worst: by attribute, the value that violates most.
    """

    def __init__(
        self,
        kb: KnowledgeBase,
        leaves: Iterable[Behaviour],
        *,
        failures: int = 1,
        at_once: int = 1,
        values: Mapping[str, Iterable[float]] | None = None,
        failing: Iterable[str] | None = None,
        symmetric: bool = True,
    ) -> None:
        self.kb = kb
        self.failures = failures
        self.at_once = at_once
        self._compared = _comparisons(kb)
        read: set[str] = set()
        thresholds = {kb.attributes[name].name: limits for name, limits in (values or {}).items()}
        for leaf in leaves:
            if isinstance(leaf, Measurement):
                name = leaf.attribute.name
                self._compared[name].append((leaf, leaf.operator, leaf.value))
                read.add(name)
        for name, limits in thresholds.items():
            self._compared[name] += [(limit, ">=", float(limit)) for limit in limits]
            read.add(name)
        attributes = kb.model.attributes
        every = {
            name: self._distinct(attributes[name]) for name in kb.attributes if self._compared[name]
        }
        self._read = read
        self.values = dict(_apart(self, every) if symmetric else every)
        self.worst = {
            name: max(options, key=lambda value, name=name: len(self.signature(name, value)))  # type: ignore[misc]  # bound in the loop
            for name, options in self.values.items()
        }
        named = {leaf.element.name for leaf in leaves if isinstance(leaf, HasStatus)}
        names = (
            [*kb.components] if failing is None else [kb.components[one].name for one in failing]
        )
        self.alike = _alike(kb, names, named) if symmetric else [(name,) for name in names]
        self.ageing = {name for name in self.values if attributes[name].max_age != inf}

    def is_read(self, name: str) -> bool:
        """Return whether somebody reads the value of an attribute itself."""
        return name in self._read

    def signature(self, name: str, value: Value) -> Signature:
        """Return what a value of an attribute violates; what is not measured violates nothing."""
        if not isinstance(value, float):
            return frozenset({value} if value == STALE or name in self._read else ())
        return frozenset(
            asker
            for asker, operator, limit in self._compared[name]
            if not OPERATORS[operator](value, limit)
        )

    def representative(self, name: str, value: Value) -> Value:
        """Return the value that stands for all with the same signature; for a new one, the value itself."""
        signature = self.signature(name, value)
        options: tuple[Value, ...] = self.values[name]
        return next((one for one in options if self.signature(name, one) == signature), value)

    def best(self, name: str) -> float | None:
        """Return a value that violates nothing, if nobody but the model looks at the attribute."""
        fitting = (one for one in self.values[name] if not self.signature(name, one))
        return None if name in self._read else next(fitting, None)

    def changes(self, facts: Facts) -> Iterator[tuple[Change, ...]]:
        """Yield the sets of changes that can happen next, beginning with the empty one."""
        single = [Change(name, value) for name, value in self._measurable(facts)]
        for group in self.alike:
            down = [name for name in group if name in facts.failed]
            up = [name for name in group if name not in facts.failed]
            single += [Change(name, False) for name in down[-1:]]
            single += [Change(name, True) for name in up[:1]]
        for count in range(self.at_once + 1):
            for chosen in combinations(single, count):
                more = sum(
                    1 if change.to else -1 for change in chosen if change.to in (True, False)
                )
                is_allowed = more <= 0 or len(facts.failed) + more <= self.failures
                if is_allowed and len({change.name for change in chosen}) == count:
                    yield chosen

    def _measurable(self, facts: Facts) -> Iterator[tuple[str, float | str]]:
        for name, present in zip(self.values, facts.values, strict=True):
            for value in self.values[name]:
                if value != present:
                    yield name, value
            if name in self.ageing and present not in (None, STALE):
                yield name, STALE

    def _distinct(self, attribute: Attribute) -> tuple[float, ...]:
        """Return values of an attribute, one for each possible signature."""
        limits = sorted({limit for _, _, limit in self._compared[attribute.name]})
        low, high = attribute.low, attribute.high
        below = (low + limits[0]) / 2 if low > -inf else limits[0] - 1.0
        above = (limits[-1] + high) / 2 if high < inf else limits[-1] + 1.0
        between = [(left + right) / 2 for left, right in pairwise(limits)]
        by_signature: dict[Signature, float] = {}
        for value in (below, *between, above, *limits):
            if low <= value <= high:
                by_signature.setdefault(self.signature(attribute.name, value), value)
        return tuple(sorted(by_signature.values()))


def _comparisons(kb: KnowledgeBase) -> defaultdict[str, list[tuple[object, str, float]]]:
    """Return who compares each attribute, by which operator and with which value."""
    compared: defaultdict[str, list[tuple[object, str, float]]] = defaultdict(list)
    for table in (kb.actions, kb.designs, kb.components, kb.configurations):
        for element in table.values():
            asker = (element.node.kind, element.name)
            for view in element.constraints:
                assert isinstance(view.element, Constraint)
                limit = view.element
                compared[limit.attribute].append((asker, limit.operator, limit.value))
    return compared


def _apart(
    environment: Environment, every: Mapping[str, tuple[float, ...]]
) -> Iterator[tuple[str, tuple[float, ...]]]:
    """Yield the attributes that make a difference; of those that violate the same, only the first."""
    seen = set[frozenset[Signature]]()
    for name, options in every.items():
        signatures = frozenset(environment.signature(name, value) for value in options)
        is_one_bit = len(signatures) == 2 and frozenset() in signatures
        is_alone = environment.is_read(name) or environment.kb.model.attributes[name].max_age != inf
        if is_one_bit and not is_alone and signatures in seen:
            continue
        if is_one_bit and not is_alone:
            seen.add(signatures)
        yield name, options


def _alike(kb: KnowledgeBase, names: Iterable[str], named: set[str]) -> list[tuple[str, ...]]:
    """Group components that nothing tells apart; one that the tree asks for by name is alone."""
    groups: defaultdict[object, list[str]] = defaultdict(list)
    for name in names:
        view = kb.components[name]
        users = frozenset(design for design, each in kb.designs.items() if name in each.components)
        is_plain = not view.configurations and not view.constraints and name not in named
        groups[(users, view.kind, view.always_improve) if is_plain else name].append(name)
    return [tuple(group) for group in groups.values()]
