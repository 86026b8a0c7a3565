"""What is verified: model, tree, causes, and what can happen to a robot.

What can happen are the facts of a model that change, with one value for each difference that values
make. Of attributes that only violate the constraints of the same elements, only the first changes;
of components that the model does not tell apart, only as many as may be failed at once.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import inf
from typing import Any, NamedTuple

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from kb import Event, KnowledgeBase, Model, PriorityPlanner
from kb import Planner as ConfigurationPlanner
from kb.elements import Attribute, AttributeKind, Constraint
from kb.status import OPERATORS
from missions.engine.mission import Mission, MissionError, Percepts
from missions.engine.task_layer import build_task, mission_domain
from missions.testing.scripted import LETTERS
from rosa_bt.behaviours import HasStatus, Measurement
from rosa_pddl.domain import FEASIBLE, names_in

Predicates = frozenset[str]


class Senses(Percepts):
    """Percepts of which some hold."""

    holding: Collection[str] = ()

    def holds(self, key: str) -> bool:
        """Return whether a key holds now."""
        return key in self.holding


class _AskedKeys(set[str]):
    """The keys that were asked for so far, which hold from the second time on."""

    def __contains__(self, key: object) -> bool:
        is_known = super().__contains__(key)
        self.add(str(key))
        return is_known


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
        effects: by action, the predicates that it makes true, as the PDDL says.
        goal: the predicates of the goal that some action makes true.
        facts: returns what is sensed, as facts of the PDDL problem.
        failures: how many components are failed at once at most.
        symmetric: let only the first of several facts that make no difference apart change.
        wanted: further properties; see `always`, `never`, `eventually` and `leads_to`.
        seconds: explore for about this time at most [s].
    """

    build: Callable[[KnowledgeBase, Senses], Behaviour]
    model: Callable[[], Model]
    leaves: Mapping[str, Leaf] = field(default_factory=dict)
    planner: Callable[[], ConfigurationPlanner] = PriorityPlanner
    effects: Mapping[str, Predicates] = field(default_factory=dict)
    goal: Predicates = frozenset()
    facts: Callable[[KnowledgeBase, Percepts], Mapping[str, bool | float]] = lambda kb, percepts: {}
    failures: int = 1
    symmetric: bool = True
    wanted: Sequence[Any] = ()
    seconds: float = 60.0

    def causes(self, leaf: Behaviour, kb: KnowledgeBase, senses: Senses) -> Predicates:
        """Return the predicates of which one is needed before a condition can succeed.

        Empty if it may succeed before anything is done, or if that is not known.
        """
        senses.holding = keys = _AskedKeys()
        count = -1
        is_satisfiable = False
        while len(keys) > count:
            count = len(keys)
            is_satisfiable = leaf.update() is Status.SUCCESS
        causes_by_key = {key: self._causes_of(key, kb, senses) for key in keys}
        senses.holding = [key for key in keys if not causes_by_key[key]]
        is_free = leaf.update() is Status.SUCCESS
        senses.holding = ()
        needed: Predicates = frozenset().union(*causes_by_key.values())
        return needed if is_satisfiable and not is_free else frozenset()

    def _causes_of(self, key: str, kb: KnowledgeBase, senses: Senses) -> Predicates:
        """Return the predicates that a percept makes true and that some action brings about."""
        senses.holding = ()
        before = self.facts(kb, senses).items()
        senses.holding = (key,)
        new = self.facts(kb, senses).items() - before
        names = {fact.strip("()").split()[0].lower() for fact, value in new if value is True}
        return frozenset().union(*self.effects.values()) & names


def setup_of(mission: Mission, **options: Any) -> Setup:  # noqa: ANN401  # fields of Setup
    """Return the setup that explores the tree of a mission; its PDDL says what causes what.

    Raises:
        MissionError: it has no tree.
    """
    if mission.tree is None:
        raise MissionError(f"mission {mission.name} has no tree to verify; give it tree=...")

    def build(kb: KnowledgeBase, senses: Senses) -> Behaviour:
        return build_task("bt", mission, kb, senses).root

    if mission.domain is not None and mission.problem is not None:
        domain = mission_domain(mission)
        effects: defaultdict[str, Predicates] = defaultdict(frozenset)
        for schema in domain.schema_of.values():
            added = {effect.name.lower() for effect in schema.effects if effect.kind == "add"}
            for action in domain.rosa_actions:
                if domain.may_do(schema, action):
                    effects[action] |= added - {FEASIBLE}
        goal = {name.lower() for name in names_in(domain.goal)}
        options["goal"] = frozenset().union(*effects.values()) & goal
        options |= {"effects": effects, "facts": mission.facts}
    return Setup(build, mission.model, **options)


# -------------------------------------------------------------------- what can happen

Comparison = tuple[object, Constraint | Measurement]
"""Who compares an attribute, and with what."""
Signature = frozenset[object]
"""What a value violates: elements of the model, and comparisons of the tree."""


class Fact(NamedTuple):
    """A fact that a knowledge base is told or decides; statuses follow from all of them.

    Attributes:
        kind: of the element, or "activity".
        name: of the element.
        value: of an attribute the measurement, None if there is none or it is too old; of an action
            with which preference it is required, None if it is not; of a component whether it has
            failed; of an activity whether the component is active; else whether it is selected.
    """

    kind: str
    name: str
    value: Any

    def __str__(self) -> str:
        if self.kind == "component":
            return f"{self.name} {'fails' if self.value else 'recovers'}"
        is_stale = self.value is None
        return f"{self.name} is stale" if is_stale else f"{self.name} is measured {self.value:g}"

    def apply(self, kb: KnowledgeBase) -> None:
        """Let it be so."""
        kind, name, value = self
        if kind == "attribute" and value is None:
            kb.replay(Event(kb.log.last + 1, kb.now, "stale", (name,)))
        elif kind == "attribute":
            kb.measure(name, value)
        elif kind == "component" and value:
            kb.component_failed(name)
        elif kind == "component":
            kb.component_recovered(name)
        elif kind == "activity":
            kb.component_active(name, value)
        elif kind == "action" and value is None:
            kb.cancel_action(name)
        elif kind == "action":
            kb.assert_status(kb.actions[name], "feasible")  # it may have been requested earlier
            kb.request_action(name, value or None)
            kb.retract_status(kb.actions[name])
        else:
            kb.assert_selected((kind, name), value)


Facts = tuple[Fact, ...]
"""One for each thing that can change, always in the same order."""


def failed(facts: Facts) -> set[str]:
    return {fact.name for fact in facts if fact.kind == "component" and fact.value}


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
    """What can change for a robot.

    Args:
        kb: of the robot.
        leaves: of the tree, whose own conditions on measurements count too.
        setup: how much changes.

    Attributes:
        best: by attribute that changes, the value that violates least.
        start: what is measured at first: what violates nothing, if only the model compares it.
        told: the attributes that leaves declare to measure (`measures`), which stay as they are.
        bad: of each component the failure, of each attribute the value that violates most.
        outside: nothing, and the changes that are not up to the robot: what recovers, and what
            changes by itself.
        qualities: the attributes of the robot that change, not of its surroundings.
    """

    def __init__(self, kb: KnowledgeBase, leaves: Iterable[Behaviour], setup: Setup) -> None:
        compared: defaultdict[str, list[Comparison]] = defaultdict(list)
        for limit in kb.model.constraints:
            compared[limit.attribute] += [(element, limit) for element in limit.constrained]
        self.told = set[str]()
        named = set[str]()
        for leaf in leaves:
            self.told |= {*getattr(leaf, "measures", ())}
            if isinstance(leaf, Measurement):
                named.add(leaf.attribute.name)
                compared[leaf.attribute.name].append((leaf, leaf))
            if isinstance(leaf, HasStatus):
                named.add(leaf.element.name)
        self._failures = setup.failures
        self._changes: list[Fact] = []
        self.best: dict[str, float] = {}
        self.start: list[Fact] = []
        self.bad: list[Fact] = []
        self.outside: list[Fact | None] = [None]
        self.qualities = set[str]()
        counts = Counter[object]()
        for name, part in kb.components.items():
            users = frozenset(each for each, of in kb.designs.items() if name in of.components)
            is_plain = not part.configurations and not part.constraints and name not in named
            key = (users, part.kind, part.always_improve) if is_plain and setup.symmetric else name
            counts[key] += 1
            if counts[key] <= setup.failures:
                failure = Fact("component", name, True)
                recovery = Fact("component", name, False)
                self._changes += [recovery, failure]
                self.bad.append(failure)
                self.outside.append(recovery)
        seen = set[frozenset[Signature]]()
        for name in kb.attributes:
            if not compared[name]:
                continue
            attribute = kb.model.attributes[name]
            values = _values(attribute, compared[name])
            signatures = frozenset(values.values())
            is_one_bit = len(signatures) == 2 and frozenset() in signatures
            if setup.symmetric and is_one_bit and name not in named and attribute.max_age == inf:
                if signatures in seen:
                    continue
                seen.add(signatures)
            facts = [Fact("attribute", name, value) for value in values]
            best = facts[0].value
            self.best[name] = best
            is_known = name in named or values[best] or kb.attributes[name].value is not None
            self.start += [] if is_known else facts[:1]
            if name in self.told:
                continue
            self.bad.append(facts[-1])
            if attribute.max_age != inf:
                facts.append(Fact("attribute", name, None))
            self._changes += facts
            if attribute.kind is AttributeKind.QUALITY:
                self.qualities.add(name)
            if name not in self.qualities or not all(rate.while_ for rate in attribute.rates):
                self.outside += facts

    def changes(self, facts: Facts) -> Iterator[tuple[Fact | None, Facts]]:
        """Yield what can happen next, beginning with nothing, and the facts after it."""
        yield None, facts
        is_full = len(failed(facts)) == self._failures
        for change in self._changes:
            if change not in facts and not (is_full and change.value is True):
                yield change, tuple(change if fact[:2] == change[:2] else fact for fact in facts)


def _values(attribute: Attribute, compared: Sequence[Comparison]) -> dict[float, Signature]:
    """Return values of an attribute, one for each possible signature, by how much they violate."""
    limits = sorted({limit.value for _, limit in compared})
    low = attribute.low if attribute.low > -inf else limits[0] - 2.0
    high = attribute.high if attribute.high < inf else limits[-1] + 2.0
    between = [(left + right) / 2 for left, right in pairwise([low, *limits, high])]
    values: dict[Signature, float] = {}
    for value in (*between, *limits):
        if low <= value <= high:
            violated = frozenset(
                element
                for element, limit in compared
                if not OPERATORS[limit.operator](value, limit.value)
            )
            values.setdefault(violated, value)
    by_count = sorted(values.items(), key=lambda item: (len(item[0]), item[1]))
    return {value: signature for signature, value in by_count}
