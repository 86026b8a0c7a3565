"""What is verified: model, tree, what may happen, causes, and what must hold."""

from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from kb import KnowledgeBase, Model, PriorityPlanner
from kb import Planner as ConfigurationPlanner
from missions.engine.mission import Mission, Percepts
from missions.engine.task_layer import mission_domain
from missions.testing.scripted import LETTERS
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
        failing: the components that can fail; empty for all.
        symmetric: let only the first of several facts that make no difference apart change.
        wanted: further properties; see `always`, `never`, `eventually` and `leads_to`.
        goal: holds where the mission has reached its goal; by default what the PDDL file says, or
            else where the root succeeds, unless what succeeded only makes other actions feasible.
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
    failing: Sequence[str] = ()
    symmetric: bool = True
    wanted: Sequence[Any] = ()
    goal: Predicate | None = None
    most: float = 100_000
    seconds: float = 60.0
