"""The parts of a mission that is explored, in one situation: knowledge base, manager, and tree with free answers.

The composites, the decorators and the leaves that ask the knowledge base are the real ones, and so is the manager.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final, NamedTuple

from py_trees.behaviour import Behaviour
from py_trees.behaviours import ProbabilisticBehaviour
from py_trees.blackboard import Blackboard
from py_trees.common import Status
from py_trees.composites import Composite, Selector
from py_trees.decorators import Decorator, Timeout
from py_trees.timers import Timer
from py_trees.visitors import VisitorBase

from kb import ConfigurationManager, KnowledgeBase, Model, PriorityPlanner, UnknownName
from kb import Planner as ConfigurationPlanner
from kb.elements import AttributeKind, ComponentKind, Parameters
from kb.status import OPERATORS
from missions.engine.mission import Condition
from missions.proof.causes import Causes, Senses
from missions.proof.environment import (
    STALE,
    Change,
    Environment,
    Facts,
    make_stale,
    without_debouncing,
)
from missions.testing.scripted import LETTERS, replace_work
from rosa_bt import ForAction, RosaAction, TreeRunner
from rosa_bt.behaviours import KbBehaviour
from rosa_bt.composites import DoUntilUnfeasible

Answer = tuple[str, str]
"""The name of a leaf or time-out, and the letter of what it returned: R, S or F."""
Build = Callable[[KnowledgeBase, Senses], Behaviour]
Predicate = Callable[["Rig"], bool]

_MOST_TURNS: Final = 20
"""After this many turns in a row, the manager is said not to come to rest."""


class Step(NamedTuple):
    """A round: changes, answers of leaves, and whether the manager misses its turn before and after the tick."""

    changes: tuple[Change, ...] = ()
    answers: tuple[Answer, ...] = ()
    late: tuple[bool, bool] = (False, False)


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
        wrong = [letter for letter in (*self.answers, *self.effects) if letter not in LETTERS]
        if wrong:
            raise ValueError(f"the answers of a leaf are letters of R, S and F, not {wrong[0]!r}")


@dataclass(frozen=True)
class Setup:
    """What is explored: a model, what decides about actions, and what may happen.

    Attributes:
        model: builds what the robot is made of and can do, anew at each call.
        build: makes the tree, given the knowledge base and what is sensed.
        leaves: by name, what leaves may return.
        planner: makes the planner that chooses configurations; None: by priority.
        start: attributes that are measured before the first tick, with their values.
        environment: how facts change, see `Environment`.
        slow: whether the manager may miss its turn, as while commands take time.
        causes: which deeds bring about what is sensed.
    """

    model: Callable[[], Model]
    build: Build
    leaves: Mapping[str, Leaf] = field(default_factory=dict)
    planner: Callable[[], ConfigurationPlanner] | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    environment: Mapping[str, Any] = field(default_factory=dict)
    slow: bool = False
    causes: Causes = field(default_factory=Causes)


class Choices:
    """Decides what leaves answer in a tick: by a script, then the first letter; asked again, a leaf says the same.

    Attributes:
        taken: the answers since `begin`.
        others: scripts for the answers that were possible but not taken, each once.
    """

    def __init__(self) -> None:
        self.begin(())

    def begin(self, script: tuple[Answer, ...]) -> None:
        """Begin a tick."""
        self.taken: list[Answer] = []
        self.others: list[tuple[Answer, ...]] = []
        self._script = script
        self._answers: dict[Behaviour, str] = {}

    def choose(self, leaf: Behaviour, letters: str) -> str:
        """Return the answer of a leaf in this tick."""
        if leaf in self._answers:
            return self._answers[leaf]
        place = len(self.taken)
        letter = letters[0]
        if place < len(self._script):
            letter = self._script[place][1]
        else:
            before = tuple(self.taken)
            self.others += [(*before, (leaf.name, other)) for other in letters[1:]]
        self.taken.append((leaf.name, letter))
        self._answers[leaf] = letter
        return letter


class _Robot:
    """A managed system that obeys at once, and notes commands that the model does not allow."""

    def __init__(self, kb: KnowledgeBase) -> None:
        self.kb = kb
        self.faults: list[str] = []

    def activate(self, component: str) -> None:
        is_unusable = self.kb.components[component].status in ("failure", "unfeasible")
        self._note("activates", component, "it cannot be used" if is_unusable else "")

    def deactivate(self, component: str) -> None:
        self._note("deactivates", component, "")

    def set_parameters(self, component: str, parameters: Parameters) -> None:
        names = self.kb.components[component].configurations
        views = [self.kb.configurations[name] for name in names]
        fitting = [one for one in views if one.parameters == parameters]
        is_allowed = any(one.status != "unfeasible" for one in fitting)
        why_not = "" if is_allowed else f"no feasible configuration has {dict(parameters)}"
        self._note("configures", component, why_not)

    def _note(self, does: str, component: str, why_not: str) -> None:
        if self.kb.components[component].kind is ComponentKind.PLAIN and does != "configures":
            why_not = "nobody switches it"
        if why_not:
            self.faults.append(f"the manager {does} {component}, but {why_not}")


class Rig(VisitorBase):
    """The parts of a mission in one situation; predicates of users are called with it.

    Attributes:
        kb: the knowledge base.
        root: of the tree.
        letters: by name, what leaves and time-outs may answer.
        ticked: the behaviours that were ever ticked.
        is_caused: whether, in the last tick, nothing succeeded before the deed that brings it about.
        deeds: what was brought about or is under way, as far as conditions and the goal ask for it.
        requesting: the names of leaves that request actions by themselves.
    """

    def __init__(self, setup: Setup) -> None:
        super().__init__(full=False)
        self.clock = 0.0
        self.setup = setup
        model = without_debouncing(setup.model())
        self.kb = kb = KnowledgeBase(model, clock=lambda: self.clock)
        self.planner = PriorityPlanner() if setup.planner is None else setup.planner()
        self._robot = _Robot(kb)
        self._manager = ConfigurationManager(kb, self._robot, planner=self.planner)
        self.choices = Choices()
        self._senses = Senses()
        Blackboard.storage.clear()  # the whole process shares it
        self.root = setup.build(kb, self._senses)
        self.nodes = list(self.root.iterate())
        leaves = [node for node in self.nodes if not node.children]
        self.environment = Environment(kb, leaves, **setup.environment)
        self.doing = [node for node in self.nodes if isinstance(node, RosaAction | ForAction)]
        self.letters: dict[str, str] = {}
        self.ticked: set[Behaviour] = set()
        self.requesting: list[Behaviour] = []
        self.deeds: frozenset[str] = frozenset()
        self.is_caused = True
        self._needed: dict[Behaviour, frozenset[str]] = {}
        self.runner = TreeRunner(self.root, clock=lambda: self.clock)
        self.runner.tree.add_visitor(self)
        self._take_over(leaves)
        self._asked = frozenset().union(*self._needed.values())
        self._facts: Facts | None = None
        self._revision = -1

    def run(self, behaviour: Behaviour) -> None:
        self.ticked.add(behaviour)

    # the answers of leaves

    def _take_over(self, leaves: list[Behaviour]) -> None:
        """Replace the work of leaves by free answers; actions are still requested.

        Raises:
            UnknownName: a declaration names a leaf that the tree does not have.
        """
        declared = self.setup.leaves
        for name in declared:
            if name not in {leaf.name for leaf in leaves}:
                raise UnknownName("leaf", name, dict.fromkeys(leaf.name for leaf in leaves))
        for leaf in leaves:
            says = declared.get(leaf.name) or self._usual(leaf)
            if says.answers:
                needed = frozenset(says.after)
                if isinstance(leaf, Condition) and not needed:
                    needed = self.setup.causes.needed(leaf, self.kb, self._senses)
                self._needed[leaf] = needed
                if _requests(leaf):
                    self.requesting.append(leaf)
                    vars(leaf)["update"] = partial(self._answer, leaf, says, leaf.update)
                else:
                    replace_work(leaf, partial(self._answer, leaf, says, None))
                self.letters[leaf.name] = says.answers
        for node in self.nodes:
            if node.children and callable(getattr(node, "is_over", None)):
                self.letters[node.name] = "RS"
                vars(node)["is_over"] = partial(self._is_over, node)
            elif isinstance(node, Timeout):
                self.letters[node.name] = "RS"
                vars(node).update(update=partial(self._time_out, node), initialise=lambda: None)

    def _usual(self, leaf: Behaviour) -> Leaf:
        """Return what an undeclared leaf may return; on success, what it makes feasible becomes so."""
        if isinstance(leaf, Timer):
            return Leaf("RS")
        is_ours = isinstance(leaf, KbBehaviour) and not isinstance(leaf, RosaAction)
        is_of_py_trees = type(leaf).__module__.startswith("py_trees.")
        if is_ours or (is_of_py_trees and not isinstance(leaf, ProbabilisticBehaviour)):
            return Leaf("")
        if isinstance(leaf, Condition):
            return Leaf("FS")
        limits: defaultdict[str, list[tuple[str, float]]] = defaultdict(list)
        for action in self.enabled_by(leaf):
            for limit in self.kb.actions[action].constraints:
                limits[limit.attribute].append((limit.operator, limit.value))
        met = {}
        for name in self.restored_by(leaf):
            options = self.environment.values[name]
            met[name] = min(options, key=lambda value, name=name: self._violated(name, value))  # type: ignore[misc]  # bound in the loop
        for name, asked in limits.items():
            options = self.environment.values.get(name, ())
            met[name] = max(options, key=partial(_satisfied, asked), default=asked[0][1])
        return Leaf(effects={"S": met} if met else {})

    def enabled_by(self, leaf: Behaviour) -> frozenset[str]:
        """Return the actions that a leaf makes feasible, as its schema or the PDDL file says."""
        causes = self.setup.causes
        own = getattr(getattr(leaf, "schema", None), "makes_feasible", ())
        return causes.enables.get(causes.schema_of(leaf), frozenset(own))

    def restored_by(self, leaf: Behaviour) -> set[str]:
        """Return the attributes that change which the action of a leaf restores, as the model says."""
        if not isinstance(leaf, RosaAction):
            return set()
        restores = self.kb.model.actions[leaf.action].restores
        return {element.name for element in restores} & self.environment.values.keys()

    def _violated(self, name: str, value: float) -> int:
        return len(self.environment.signature(name, value))

    def _answer(self, leaf: Behaviour, says: Leaf, own: Callable[[], object] | None) -> Status:
        if own is not None:
            own()  # for its requests; what it returns is one of the free answers
        letter = self.choices.choose(leaf, says.answers)
        needed = self._needed[leaf]
        action = getattr(leaf, "action", None)
        is_able = not isinstance(leaf, RosaAction) or self.kb.is_feasible(leaf.action)
        if letter == "S" and (not is_able or (needed and not needed & self.deeds)):
            self.is_caused = False
        if letter != "F" and is_able and not isinstance(leaf, Condition):
            effects = self.setup.causes.effects.get(self.setup.causes.schema_of(leaf), frozenset())
            self.deeds |= (effects | {leaf.name, str(action)}) & self._asked
            if letter == "S":
                self.deeds |= {f"{effect} done" for effect in effects & self.setup.causes.goal}
        for attribute, value in says.effects.get(letter, {}).items():
            self.kb.measure(attribute, value)
        return LETTERS[letter]

    def _is_over(self, node: Behaviour, *_: float) -> bool:
        """Let the time of a decorator be over by now, or not; a child that a delay has begun goes on."""
        has_begun = node.children[0].status is Status.RUNNING and type(node).__name__ == "Delay"
        return has_begun or self.choices.choose(node, "RS") == "S"

    def _time_out(self, node: Timeout) -> Status:
        if node.decorated.status is Status.RUNNING and self._is_over(node):
            node.decorated.stop(Status.INVALID)
            return Status.FAILURE
        return node.decorated.status

    # rounds

    def begin(self) -> tuple[str, ...]:
        """Measure the start values and let the manager take its turns; return its faults, in words."""
        for name, value in self.setup.start.items():
            self.kb.measure(name, value)
        for name in self.environment.values:
            best = self.environment.best(name)
            if self.kb.attributes[name].value is None and best is not None:
                self.kb.measure(name, best)  # as good as no measurement
        return self.settle()

    def tick(self, script: tuple[Answer, ...]) -> None:
        """Tick the tree with these answers, then with the first ones possible."""
        self.choices.begin(script)
        self.is_caused = True
        self.runner.tick()
        if self.root.status is Status.SUCCESS:
            instead = self._instead(self.root)
            self.deeds |= {f"instead {instead}"} if instead else set()

    def settle(self) -> tuple[str, ...]:
        """Let the manager take its turns until it has nothing to do; return its faults, in words."""
        faults = self._robot.faults
        faults.clear()
        try:
            for _ in range(_MOST_TURNS):
                revision = self.kb.revision
                if self._manager.update() is None and self.kb.revision == revision:
                    break
            else:
                faults.append("the manager does not come to rest")
        except Exception as error:
            faults.append(f"the manager raised {type(error).__name__}: {error}")
        if self.kb.pending_plan is not None:
            faults.append(f"the plan {self.kb.pending_plan} does not end")
        for action in self.required:
            if self.kb.actions[action].status not in ("unfeasible", "solved"):
                faults.append(f"the manager does not configure the robot for {action}")
        return tuple(faults)

    # facts

    def read(self) -> Facts:
        """Return all facts, with the value that stands for each measurement."""
        kb = self.kb
        if self._facts is not None and kb.revision == self._revision:
            return self._facts
        values = []
        for name in self.environment.values:
            view = kb.attributes[name]
            value = STALE if view.is_stale else view.value
            values.append(self.environment.representative(name, value))
        selected = [
            (view.node.kind, name)
            for table in (kb.designs, kb.configurations)
            for name, view in table.items()
            if view.is_selected
        ]
        components = kb.components
        self._facts = Facts(
            tuple(values),
            frozenset(name for name, view in components.items() if view.status == "failure"),
            frozenset(name for name, view in components.items() if view.is_active),
            frozenset(selected),
            tuple(
                sorted((each.action, str(each.preference or "")) for each in kb.required_actions)
            ),
        )
        self._revision = kb.revision
        return self._facts

    def write(self, facts: Facts) -> None:
        """Bring about facts, by telling the knowledge base what differs."""
        kb, present = self.kb, self.read()
        if facts == present:
            return
        for action in {action for action, _ in {*present.requested} - {*facts.requested}}:
            kb.cancel_action(action)
        for name in present.failed - facts.failed:
            kb.component_recovered(name)
        for name, value, before in zip(
            self.environment.values, facts.values, present.values, strict=True
        ):
            if isinstance(value, float):
                if value != before:
                    kb.measure(name, value)
            elif value != before:
                make_stale(kb, name)  # also for what was never measured
        for name in facts.failed - present.failed:
            kb.component_failed(name)
        for name in present.active ^ facts.active:
            kb.component_active(name, name in facts.active)
        for kind, name in present.selected ^ facts.selected:
            table: Mapping[str, Any] = (
                kb.designs if kind == "function design" else kb.configurations
            )
            kb.assert_selected(table[name], (kind, name) in facts.selected)
        for action, preference in {*facts.requested} - {*present.requested}:
            view = kb.actions[action]
            if kb.is_feasible(action):
                kb.request_action(action, preference or None)
            else:
                kb.assert_status(view, "feasible")
                kb.request_action(action, preference or None)
                kb.retract_status(view)
        self._facts = facts
        self._revision = kb.revision

    # what properties ask

    def is_required(self, action: str) -> bool:
        """Return whether an action is requested."""
        return action in self.required

    def measured(self, attribute: str) -> float | None:
        """Return the latest measurement of an attribute; None if there is none."""
        return self.kb.attributes[attribute].value

    @property
    def qualities(self) -> set[str]:
        """The attributes that change which are qualities of the robot, not of its surroundings."""
        attributes = self.kb.model.attributes
        names = self.environment.values
        return {name for name in names if attributes[name].kind is AttributeKind.QUALITY}

    @property
    def failed(self) -> frozenset[str]:
        """The components that have failed."""
        return self.read().failed

    @property
    def required(self) -> tuple[str, ...]:
        """The actions that are requested."""
        return tuple(sorted(each.action for each in self.kb.required_actions))

    @property
    def unfeasible(self) -> tuple[str, ...]:
        """The actions that are requested although they are unfeasible."""
        return tuple(action for action in self.required if not self.kb.is_feasible(action))

    @property
    def running(self) -> frozenset[str]:
        """The actions of the behaviours that run; of leaves that request by themselves, all that are requested."""
        running = {node.action for node in self.doing if node.status is Status.RUNNING}
        if any(leaf.status is Status.RUNNING for leaf in self.requesting):
            running |= set(self.required)
        return frozenset(running)

    def _instead(self, node: Behaviour) -> str:
        """Return the action whose success a node passes on in place of what it is for; empty if there is none."""
        if isinstance(node, DoUntilUnfeasible):
            return self._instead(node.children[0])
        if isinstance(node, Selector):
            ended = [child for child in node.children if child.status is Status.SUCCESS]
            before = node.children[: node.children.index(ended[0])] if ended else []
            wanted = {leaf.action for leaf in self._acting(before)}
            acting = self._acting(ended[:1])
            if acting and all(self._serves(leaf, wanted) for leaf in acting):
                return str(acting[-1].action)
            return self._instead(ended[0]) if ended else ""
        if isinstance(node, Composite | Decorator) and not isinstance(node, ForAction):
            for child in node.children:
                if child.status is Status.SUCCESS and (action := self._instead(child)):
                    return action
        return ""

    def _acting(self, nodes: Iterable[Behaviour]) -> list[Any]:
        return [each for node in nodes for each in node.iterate() if each in self.doing]

    def _serves(self, leaf: Any, wanted: set[str]) -> bool:  # noqa: ANN401  # RosaAction or ForAction
        """Tell whether an action only makes others feasible: it is free of a limit on the robot that they have."""
        if leaf.action in wanted or self.enabled_by(leaf) & wanted:
            return leaf.action not in wanted
        attributes = self.kb.model.attributes
        free = {limit.attribute for limit in self.kb.actions[leaf.action].constraints}
        limited = {
            limit.attribute for name in wanted for limit in self.kb.actions[name].constraints
        }
        if self.restored_by(leaf) & limited:
            return True
        return any(attributes[name].kind is AttributeKind.QUALITY for name in limited - free)


def _requests(leaf: Behaviour) -> bool:
    """Tell whether the work of a leaf requests actions by itself."""
    kind = type(leaf)
    methods = (kind.update, kind.initialise, kind.terminate)
    return any("request_action" in method.__code__.co_names for method in methods)


def _satisfied(asked: Iterable[tuple[str, float]], value: float) -> int:
    """Return how many comparisons (operator, threshold) a value satisfies."""
    return sum(OPERATORS[operator](value, limit) for operator, limit in asked)
