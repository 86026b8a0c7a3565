"""What is verified: a model, a tree, what may happen, and what must hold."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from py_trees.behaviour import Behaviour

from kb import KnowledgeBase, Model, PriorityPlanner
from kb import Planner as ConfigurationPlanner
from missions.proof.causes import Causes, Senses
from missions.testing.scripted import LETTERS

if TYPE_CHECKING:
    from missions.proof.properties import Property
    from missions.proof.rig import Rig

Predicate = Callable[["Rig"], bool]


@dataclass(frozen=True)
class Leaf:
    """What a leaf may return, and what it does to facts.

    Attributes:
        answers: letters of "R", "S" and "F"; empty: the leaf works as it is.
        effects: by letter, the attributes that are measured when it returns that, such as
            {"S": {"battery_level": 1.0}}.
        after: of a condition, the actions or leaves of which one has to be under way before it can succeed.
    """

    answers: str = "RSF"
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    after: tuple[str, ...] = ()

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
        at_once: how many facts change between two ticks at most.
        failing: the components that can fail; empty for all.
        symmetric: let only the first of several facts that make no difference apart change.
        wanted: further properties; see `always`, `never`, `eventually` and `leads_to`.
        exclusive: groups of actions; at most one of each may be required at a time.
        goal: holds where the mission has reached its goal; by default what the PDDL file says, or else where the
            root succeeds, unless what succeeded only makes other actions feasible.
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
    at_once: int = 1
    failing: Sequence[str] = ()
    symmetric: bool = True
    wanted: Sequence["Property"] = ()
    exclusive: Sequence[Collection[str]] = ()
    goal: Predicate | None = None
    most: float = 100_000
    seconds: float = 60.0
