"""The setup of an exploration, and its parts put together: tree, knowledge base, manager and surroundings."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from py_trees.behaviour import Behaviour
from py_trees.blackboard import Blackboard
from py_trees.visitors import VisitorBase

from kb import ConfigurationManager, KnowledgeBase, Model
from kb.elements import ComponentKind, Parameters
from kb.execution import Budgets
from kb.manager import Planner, PriorityPlanner
from missions.proof.planned import nodes
from missions.proof.surroundings import Choices, Leaf, Surroundings, take_over
from missions.proof.tape import Tape
from rosa_bt import ForAction, RosaAction, TreeRunner

Build = Callable[[KnowledgeBase], Behaviour]
Predicate = Callable[["Rig"], bool]

_MOST_TURNS: Final = 20
"""After this many turns in a row, the manager is said not to come to rest."""


class _Robot:
    """A managed system that obeys at once, and notes commands that the model does not allow."""

    def __init__(self, kb: KnowledgeBase) -> None:
        self.kb, self.faults = kb, list[str]()

    def activate(self, component: str) -> None:
        is_unusable = self.kb.components[component].status in ("failure", "unfeasible")
        self._note("activates", component, "it cannot be used" if is_unusable else "")

    def deactivate(self, component: str) -> None:
        self._note("deactivates", component, "")

    def set_parameters(self, component: str, parameters: Parameters) -> None:
        known = [self.kb.configurations[one] for one in self.kb.components[component].configurations]
        is_allowed = any(one.parameters == parameters and one.status != "unfeasible" for one in known)
        self._note("configures", component, "" if is_allowed else f"no feasible configuration has {dict(parameters)}")

    def _note(self, does: str, component: str, why_not: str) -> None:
        if self.kb.components[component].kind is ComponentKind.PLAIN and does != "configures":
            why_not = "nobody switches it"
        if why_not:
            self.faults.append(f"the manager {does} {component}, but {why_not}")


@dataclass(frozen=True)
class Setup:
    """What is explored: a model, what decides about actions, and what may happen.

    Attributes:
        model: builds what the robot is made of and can do, anew at each call.
        build: makes the tree, or another behaviour that decides.
        leaves: by name, what leaves may return; `surroundings.usual` says it for the others.
        planner: makes the planner that chooses configurations; None: by priority.
        start: attributes that are measured before the first tick, with their values; no others are.
        surroundings: how facts change, see `Surroundings`.
        slow: whether the manager may miss its turn, as while commands take time.
    """

    model: Callable[[], Model]
    build: Build
    leaves: Mapping[str, Leaf] = field(default_factory=dict)
    planner: Callable[[], Planner] | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    surroundings: Mapping[str, Any] = field(default_factory=dict)
    slow: bool = False

    def tree(self, kb: KnowledgeBase) -> Behaviour:
        """Empty the blackboard, which the whole process shares, and make the tree."""
        Blackboard.storage.clear()
        return self.build(kb)


class Rig(VisitorBase):
    """The parts of a mission in one situation; predicates of users are called with it.

    Attributes:
        kb: the knowledge base.
        root: of the tree.
        clock: the time [s]; it stands still while exploring.
        letters: what leaves may answer, by name.
        ticked: the behaviours that were ever ticked.
    """

    def __init__(self, setup: Setup) -> None:
        super().__init__(full=False)
        self.clock, self._start = 0.0, setup.start
        self.kb = KnowledgeBase(setup.model(), clock=lambda: self.clock)
        self.planner = PriorityPlanner() if setup.planner is None else setup.planner()
        self._robot, self._budgets = _Robot(self.kb), Budgets(getattr(self.planner, "budgets", None))
        self._manager = ConfigurationManager(self.kb, self._robot, planner=self.planner)
        self.choices = Choices()
        self.tape = Tape(self.kb, self.choices, is_on=setup.planner is None)  # a tree may know another planner
        self.root = setup.tree(self.tape.kb)
        self.surroundings = Surroundings(self.kb, self.root, **setup.surroundings)
        self.letters = take_over(self.root, self.tape.kb, setup.leaves, self.surroundings.values, self.choices)
        self.runner = TreeRunner(self.root, clock=lambda: self.clock)
        self.runner.tree.add_visitor(self)
        self.doing = [one for one in nodes(self.root) if isinstance(one, RosaAction | ForAction)]
        self.ticked: set[Behaviour] = set()

    def run(self, behaviour: Behaviour) -> None:
        self.ticked.add(behaviour)

    def is_required(self, action: str) -> bool:
        """Return whether an action is requested."""
        return any(one.action == action for one in self.kb.required_actions)

    def measured(self, attribute: str) -> float | None:
        """Return the latest measurement of an attribute; None if there is none."""
        return self.kb.attributes[attribute].value

    @property
    def required(self) -> tuple[str, ...]:
        """The actions that are requested."""
        return tuple(sorted(one.action for one in self.kb.required_actions))

    def begin(self) -> tuple[str, ...]:
        """Measure the start values and let the manager take its turns; return its faults, in words."""
        for name, value in self._start.items():
            self.kb.measure(name, value)
        return self.settle()

    @property
    def unfeasible(self) -> tuple[str, ...]:
        """The actions that are requested although they are unfeasible."""
        return tuple(one for one in self.required if not self.kb.is_feasible(one))

    def settle(self, is_settled: Callable[[], bool] = lambda: False) -> tuple[str, ...]:
        """Let the manager take its turns until it has nothing to do; return its faults, in words."""
        self._robot.faults.clear()
        try:
            for _ in range(_MOST_TURNS):
                revision = self.kb.revision
                if (self._manager.update() is None and self.kb.revision == revision) or is_settled():
                    break
            else:
                self._robot.faults.append("the manager does not come to rest")
        except Exception as error:
            self._robot.faults.append(f"the manager raised {type(error).__name__}: {error}")
        if self.kb.pending_plan is not None:
            self._robot.faults.append(f"the plan {self.kb.pending_plan} does not end")
        if not self._budgets.allow(self.kb, (), ()):
            self._robot.faults.append("a budget is exceeded")
        for action in self.required:
            if self.kb.actions[action].status not in ("unfeasible", "solved"):
                self._robot.faults.append(f"the manager does not configure the robot for {action}")
        return tuple(self._robot.faults)
