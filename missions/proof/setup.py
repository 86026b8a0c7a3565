"""What is verified: model, tree, causes, and what can happen to a robot.

What can happen are the facts of a model that change, with one value for each difference that values
make. Facts that make no difference apart are explored as one: of attributes that only violate the
constraints of the same elements, and of components that the model does not tell apart, only the
first changes.
"""

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import inf
from operator import itemgetter
from typing import Any, NamedTuple

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from kb import Event, KnowledgeBase, Model, PriorityPlanner
from kb import Planner as ConfigurationPlanner
from kb.elements import Attribute, Constraint
from kb.status import OPERATORS
from missions.engine.mission import Mission, Percepts
from missions.engine.task_layer import mission_domain
from missions.testing.scripted import LETTERS
from rosa_bt.behaviours import HasStatus, Measurement
from rosa_pddl.domain import FEASIBLE, names_in

Predicates = frozenset[str]
Predicate = Callable[[Any], bool]
"""Called with the `Rig` in a situation."""


class Senses(Percepts):
    """Percepts of which some hold, and that note which ones are asked for."""

    def __init__(self) -> None:
        super().__init__()
        self.holding: frozenset[str] = frozenset()
        self.asked: set[str] = set()

    def holds(self, key: str) -> bool:
        """Return whether a key holds now."""
        self.asked.add(key)
        return key in self.holding


@dataclass(frozen=True)
class Causes:
    """What the actions of a mission bring about.

    Attributes:
        effects: by action, the predicates that it makes true.
        goal: the predicates of the goal that some action makes true.
        facts: returns what is sensed, as facts of the PDDL problem.
    """

    effects: Mapping[str, set[str]] = field(default_factory=dict)
    goal: Predicates = frozenset()
    facts: Callable[[KnowledgeBase, Percepts], Mapping[str, bool | float]] = lambda kb, percepts: {}

    @property
    def brought(self) -> Predicates:
        """All predicates that some action makes true."""
        return frozenset().union(*self.effects.values())

    def needed(self, leaf: Behaviour, kb: KnowledgeBase, senses: Senses) -> Predicates:
        """Return the predicates of which one is needed before a condition can succeed.

        Empty if it may succeed before anything is done, or if that is not known.
        """

        def succeeds(keys: set[str]) -> bool:
            senses.holding = frozenset(keys)
            return leaf.update() is Status.SUCCESS

        keys: set[str] = set()
        is_satisfiable = succeeds(keys)
        while not senses.asked <= keys:
            keys |= senses.asked
            is_satisfiable = succeeds(keys)
        brought_by_key = {key: self._predicates(key, kb, senses) for key in keys}
        is_free = succeeds({key for key in keys if not brought_by_key[key]})
        senses.asked = set()
        senses.holding = frozenset()
        return (
            frozenset().union(*brought_by_key.values())
            if is_satisfiable and not is_free
            else frozenset()
        )

    def _predicates(self, key: str, kb: KnowledgeBase, senses: Senses) -> Predicates:
        """Return the predicates that a percept makes true and that some action brings about."""
        senses.holding = frozenset()
        before = self.facts(kb, senses)
        senses.holding = frozenset({key})
        after = self.facts(kb, senses)
        new = {fact for fact, is_so in after.items() if is_so is True and not before.get(fact)}
        return frozenset(fact.strip("()").split()[0].lower() for fact in new) & self.brought


def causes_of(mission: Mission) -> Causes:
    """Return what the actions of a mission bring about, as its PDDL says.

    Nothing if it has none.
    """
    if mission.domain is None or mission.problem is None:
        return Causes()
    domain = mission_domain(mission)
    effects: defaultdict[str, set[str]] = defaultdict(set)
    for schema in domain.schema_of.values():
        for action in domain.rosa_actions:
            if domain.may_do(schema, action):
                added = [effect.name for effect in schema.effects if effect.kind == "add"]
                effects[action] |= {name.lower() for name in added if name != FEASIBLE}
    causes = Causes(effects, facts=mission.facts)
    goal = {name.lower() for name in names_in(domain.goal)}
    return replace(causes, goal=causes.brought & goal)


@dataclass(frozen=True)
class Leaf:
    """What a leaf may return, and what it does to facts.

    Attributes:
        answers: letters of "R", "S" and "F"; empty: the leaf works as it is.
        effects: by letter, the attributes that are measured when it returns that, such as
            {"S": {"battery_level": 1.0}}.
        after: of a condition, the actions or leaves of which one has to be under way before it can
            succeed.
    """

    answers: str = "RSF"
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    after: Collection[str] = ()

    def __post_init__(self) -> None:
        for letter in (*self.answers, *self.effects):
            if letter not in LETTERS:
                raise ValueError(f"the answers of a leaf are letters of R, S and F, not {letter!r}")


@dataclass(frozen=True)
class Setup:
    """What is verified.

    Attributes:
        build: makes the tree, given the knowledge base and percepts.
        model: makes what the robot consists of and can do, anew at each call.
        leaves: by name, what leaves may return.
        planner: makes the planner that chooses configurations.
        start: attributes that are measured before the first tick, with their values.
        causes: which deeds bring about what is sensed.
        failures: how many components are failed at once at most.
        symmetric: let only the first of several facts that make no difference apart change.
        wanted: further properties; see `always`, `never`, `eventually` and `leads_to`.
        most: explore about this number of situations at most.
        seconds: explore for about this time at most [s].
    """

    build: Callable[[KnowledgeBase, Senses], Behaviour]
    model: Callable[[], Model]
    leaves: Mapping[str, Leaf] = field(default_factory=dict)
    planner: Callable[[], ConfigurationPlanner] = PriorityPlanner
    start: Mapping[str, float] = field(default_factory=dict)
    causes: Causes = field(default_factory=Causes)
    failures: int = 1
    symmetric: bool = True
    wanted: Sequence[Any] = ()
    most: float = 100_000
    seconds: float = 60.0


# -------------------------------------------------------------------- what can happen

Value = float | None
"""What was measured last; None if nothing was measured, or if that is too old."""
Signature = frozenset[object]
"""What a value violates: elements of the model, and comparisons of the tree."""


class Facts(NamedTuple):
    """All that a knowledge base is told and decides; statuses follow from it."""

    values: tuple[tuple[str, Value], ...]
    failed: frozenset[str]
    active: frozenset[str]
    selected: frozenset[tuple[str, str]]
    requested: tuple[tuple[str, str], ...]


class Change(NamedTuple):
    """A change: an attribute is measured or stale, a component fails (True) or recovers."""

    name: str
    to: Value | bool

    def __str__(self) -> str:
        if isinstance(self.to, bool):
            return f"{self.name} {'fails' if self.to else 'recovers'}"
        is_stale = self.to is None
        return f"{self.name} is stale" if is_stale else f"{self.name} is measured {self.to:g}"

    def apply(self, kb: KnowledgeBase) -> None:
        """Let it happen."""
        if self.to is True:
            kb.component_failed(self.name)
        elif self.to is False:
            kb.component_recovered(self.name)
        elif isinstance(self.to, float):
            kb.measure(self.name, self.to)
        else:
            kb.replay(Event(kb.log.last + 1, kb.now, "stale", (self.name,)))


def without_debouncing(model: Model) -> Model:
    """Let each measurement count at once.

    Hysteresis, dwell and agreement only delay what is explored anyway.
    """
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
        setup: how they change.

    Attributes:
        values: by attribute that changes, one value for each difference, with what it violates.
        read: the attributes that the tree compares by itself.
        told: the attributes that leaves declare to measure (`measures`), which stay as they are.
        alike: the components that can fail, in groups that the model does not tell apart.
    """

    def __init__(self, kb: KnowledgeBase, leaves: Iterable[Behaviour], setup: Setup) -> None:
        self._setup = setup
        self._compared = _comparisons(kb)
        self.read: set[str] = set()
        self.told: set[str] = set()
        for leaf in leaves:
            self.told |= {*getattr(leaf, "measures", ())}
            if isinstance(leaf, Measurement):
                self._compared[leaf.attribute.name].append((leaf, leaf.operator, leaf.value))
                self.read.add(leaf.attribute.name)
        attributes = kb.model.attributes
        self.ageing = {name for name in kb.attributes if attributes[name].max_age != inf}
        self.values: dict[str, dict[float, Signature]] = {}
        seen = set[frozenset[Signature]]()
        for name in [name for name in kb.attributes if self._compared[name]]:
            values = self._distinct(attributes[name])
            signatures = frozenset(values.values())
            is_one_bit = len(signatures) == 2 and frozenset() in signatures
            if setup.symmetric and is_one_bit and name not in self.read | self.ageing:
                if signatures in seen:
                    continue
                seen.add(signatures)
            self.values[name] = values
        components = [*kb.components]
        named = {leaf.element.name for leaf in leaves if isinstance(leaf, HasStatus)}
        self.alike: list[tuple[str, ...]] = [(name,) for name in components]
        if setup.symmetric:
            self.alike = _alike(kb, components, named)

    def best(self, name: str) -> float:
        """Return the value of an attribute that violates least."""
        return min(self.values[name], key=lambda value: len(self.values[name][value]))

    @property
    def worst(self) -> dict[str, float]:
        """By attribute that changes by itself, the value that violates most."""
        by_count = {}
        for name, values in self.values.items():
            if name not in self.told:
                by_count[name] = max(values, key=lambda value: len(values[value]))
        return by_count

    def changes(self, facts: Facts) -> Iterator[tuple[tuple[Change, ...], Facts]]:
        """Yield what can happen next, beginning with nothing, and the facts after it."""
        yield (), facts
        for place, (name, present) in enumerate(facts.values):
            if name in self.told:
                continue
            options: list[Value] = [value for value in self.values[name] if value != present]
            if name in self.ageing and present is not None:
                options.append(None)
            for value in options:
                values = [*facts.values]
                values[place] = (name, value)
                yield (Change(name, value),), facts._replace(values=tuple(values))
        for group in self.alike:
            down = [name for name in group if name in facts.failed]
            up = [name for name in group if name not in facts.failed]
            if down:
                yield (Change(down[-1], False),), facts._replace(failed=facts.failed - {down[-1]})
            if up and len(facts.failed) < self._setup.failures:
                yield (Change(up[0], True),), facts._replace(failed=facts.failed | {up[0]})

    def _distinct(self, attribute: Attribute) -> dict[float, Signature]:
        """Return values of an attribute, one for each possible signature."""
        compared = self._compared[attribute.name]
        limits = sorted({limit for _, _, limit in compared})
        low = attribute.low
        high = attribute.high
        below = (low + limits[0]) / 2 if low > -inf else limits[0] - 1.0
        above = (limits[-1] + high) / 2 if high < inf else limits[-1] + 1.0
        between = [(left + right) / 2 for left, right in pairwise(limits)]
        values: dict[Signature, float] = {}
        for value in (below, *between, above, *limits):
            violated = [who for who, how, limit in compared if not OPERATORS[how](value, limit)]
            if low <= value <= high:
                values.setdefault(frozenset(violated), value)
        return {value: each for each, value in sorted(values.items(), key=itemgetter(1))}


def _comparisons(kb: KnowledgeBase) -> defaultdict[str, list[tuple[object, str, float]]]:
    """Return who compares each attribute, by which operator and with which value."""
    compared: defaultdict[str, list[tuple[object, str, float]]] = defaultdict(list)
    for table in (kb.actions, kb.designs, kb.components, kb.configurations):
        for element in table.values():
            for view in element.constraints:
                limit = view.element
                assert isinstance(limit, Constraint)
                asker = (element.node.kind, element.name)
                compared[limit.attribute].append((asker, limit.operator, limit.value))
    return compared


def _alike(kb: KnowledgeBase, names: Iterable[str], named: set[str]) -> list[tuple[str, ...]]:
    """Group components that nothing tells apart; one that the tree asks for by name is alone."""
    groups: defaultdict[object, list[str]] = defaultdict(list)
    for name in names:
        view = kb.components[name]
        users = frozenset(design for design, each in kb.designs.items() if name in each.components)
        is_plain = not view.configurations and not view.constraints and name not in named
        groups[(users, view.kind, view.always_improve) if is_plain else name].append(name)
    return [tuple(group) for group in groups.values()]
