"""The parts of a mission that is explored: its plan executor, what can happen around it, and all of it put together.

The composites and decorators above the leaves, and the leaves that ask the knowledge base, are the real ones.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations, pairwise
from math import inf
from typing import Any, Final, NamedTuple

from py_trees.behaviour import Behaviour
from py_trees.behaviours import ProbabilisticBehaviour
from py_trees.blackboard import Blackboard
from py_trees.common import Status
from py_trees.composites import Sequence
from py_trees.decorators import Decorator, FailureIsRunning
from py_trees.timers import Timer
from py_trees.visitors import VisitorBase

from kb import ConfigurationManager, Event, KnowledgeBase, Model, PriorityPlanner, UnknownName
from kb import Planner as ConfigurationPlanner
from kb.elements import Attribute, ComponentKind, Constraint, Parameters
from kb.execution import Budgets
from kb.status import OPERATORS
from missions.engine.mission import Condition, Mission, Percepts
from missions.engine.task_layer import Made, mission_domain, planner_of
from missions.proof.tape import Choices, Tape
from missions.testing.scripted import LETTERS, replace_work
from rosa_bt import ForAction, RosaAction, TreeRunner
from rosa_bt.behaviours import HasStatus, KbBehaviour, Measurement
from rosa_pddl import Domain, PlanExecutor, Planner, PlanningResult, Step
from rosa_pddl.grounding import Grounded
from rosa_pddl.planner import awaited
from rosa_pddl.problem import Problem, initial_state

STALE = "stale"


class _AtOnce:
    """A planner that waits for the answer when it is asked."""

    def __init__(self, planner: Planner) -> None:
        self._planner, self.timeout_s = planner, planner.timeout_s

    def start(self, problem: Problem) -> "Future[PlanningResult]":
        found = self._planner.start(problem)
        awaited(found, self.timeout_s)
        return found


class Planned(Decorator):
    """A plan executor whose pauses are all over before the next tick, so a step that failed is planned with again.

    Attributes:
        steps: the behaviours of all steps that plans may have.
    """

    def __init__(self, executor: PlanExecutor, steps: Mapping[Step, Behaviour]) -> None:
        super().__init__(
            f"until {executor.name} is done", FailureIsRunning("until the goal holds", executor)
        )
        self.steps, self._executor = tuple(steps.values()), executor

    def tick(self) -> Iterator[Behaviour]:
        """Tick as if all that the executor waits for were over."""
        self._executor.wait_no_more()
        yield from super().tick()

    def update(self) -> Status:
        """Return the status of the executor; reset the status of ended steps, which decides nothing any more."""
        for one in self.steps:
            one.status = one.status if one.status is Status.RUNNING else Status.INVALID
        return self.decorated.status


def nodes(root: Behaviour) -> list[Behaviour]:
    """Return the nodes of a tree, including those of all steps that its plans may have."""
    every = list(root.iterate())
    steps = [step for one in every if isinstance(one, Planned) for step in one.steps]
    return list(dict.fromkeys([*every, *(node for step in steps for node in step.iterate())]))


def stage_of(root: Behaviour) -> tuple[object, ...]:
    """Return the progress of a tree: the current child of each running sequence with memory, and executors' beliefs."""
    every = nodes(root)
    sequences = [one for one in every if isinstance(one, Sequence) and one.memory]
    places = [
        one.current_child and one.current_child.name
        for one in sequences
        if one.status is Status.RUNNING
    ]
    return (*places, *(one.state for one in every if isinstance(one, PlanExecutor)))


def planned(mission: Mission) -> Callable[[KnowledgeBase], Behaviour]:
    """Return a function that makes a mission's plan executor; it believes the effects of steps and senses nothing."""
    domain = mission_domain(mission)
    planner, steps = _AtOnce(planner_of(mission, domain)), _steps(domain)

    def build(kb: KnowledgeBase) -> Behaviour:
        made = Made(kb, Percepts())
        behaviours = {
            step: made.by(step.schema, mission.actions[step.schema])(step) for step in steps
        }
        executor = PlanExecutor(
            f"plan for {mission.name}",
            kb=kb,
            domain=domain,
            behaviours=dict.fromkeys(mission.actions, behaviours.__getitem__),
            sense=dict,
            clock=lambda: kb.now,
            planner=planner,
            delay_s=None,
        )
        return Planned(executor, behaviours)

    return build


def _steps(domain: Domain) -> list[Step]:
    """Return all steps that are reachable from the initial state, whatever becomes feasible."""
    first = initial_state(domain).union(domain.feasibility)
    task = Grounded(domain, first, first, lambda instances: None)
    return [task.step(number) for number in range(task.size)]


class Change(NamedTuple):
    """One change of a fact: an attribute is measured or goes stale, a component fails (True) or recovers (False)."""

    name: str
    to: float | bool | str

    def __str__(self) -> str:
        if isinstance(self.to, bool):
            return f"{self.name} {'fails' if self.to else 'recovers'}"
        return (
            f"{self.name} is stale" if self.to == STALE else f"{self.name} is measured {self.to:g}"
        )

    def tell(self, kb: KnowledgeBase) -> None:
        if isinstance(self.to, bool):
            (kb.component_failed if self.to else kb.component_recovered)(self.name)
        elif isinstance(self.to, float):
            kb.measure(self.name, self.to)
        else:
            kb.tell(Event(kb.log.last + 1, kb.now, STALE, (self.name,)))


class Surroundings:
    """All facts of a model that can change, with one value for each difference that values make.

    Args:
        kb: of the robot.
        root: of the tree, whose own conditions on measurements count too.
        failures: how many components are failed at once at most.
        at_once: how many facts change between two ticks at most.
        values: by attribute, further thresholds that the tree or a property compares with.
        failing: the components that can fail; None for all.
        symmetric: of several components that the model does not distinguish, let only the first fail.

    Attributes:
        failures: how many components are failed at once at most.
        at_once: how many facts change between two ticks at most.
        values: by attribute, one value for each difference.
        alike: the components that can fail, in groups that the model does not distinguish.
        worst: by attribute, the value that satisfies the fewest constraints.
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
        self.values = {
            name: _distinct(asked[name], known[name]) for name in kb.attributes if asked[name]
        }
        self.worst = {
            name: min(found, key=partial(_satisfied, asked[name]))
            for name, found in self.values.items()
        }
        names = (
            list(kb.components) if failing is None else [kb.components[one].name for one in failing]
        )
        named = {one.element.name for one in nodes(root) if isinstance(one, HasStatus)}
        self.alike = _alike(kb, names, named) if symmetric else [(one,) for one in names]
        self._ageing = [name for name in self.values if kb.model.attributes[name].max_age != inf]

    def failed(self) -> tuple[str, ...]:
        """Return the components that are reported failed now."""
        return tuple(name for name, one in self._kb.components.items() if one.status == "failure")

    def changes(self) -> Iterator[tuple[Change, ...]]:
        """Yield the sets of changes that can happen next, beginning with the empty one."""
        single = [one for name in self.values for one in self._measured(name)]
        down = self.failed()
        single += [
            Change(broken[-1], False)
            for alike in self.alike
            if (broken := [o for o in alike if o in down])
        ]
        single += [
            Change(working[0], True)
            for alike in self.alike
            if (working := [o for o in alike if o not in down])
        ]
        for count in range(self.at_once + 1):
            for chosen in combinations(single, count):
                more = sum(1 if one.to else -1 for one in chosen if isinstance(one.to, bool))
                if len({one.name for one in chosen}) == count and (
                    more <= 0 or len(down) + more <= self.failures
                ):
                    yield chosen

    def _measured(self, name: str) -> Iterator[Change]:
        view = self._kb.attributes[name]
        repeats = self._kb.model.attributes[name].agreement != (1, 1)
        for value in self.values[name]:
            if repeats or view.is_stale or value != view.value:
                yield Change(name, value)
        if name in self._ageing and view.value is not None and not view.is_stale:
            yield Change(name, STALE)


def _satisfied(asked: Iterable[tuple[str, float]], value: float) -> int:
    """Return how many comparisons (operator, threshold) a value satisfies."""
    return sum(OPERATORS[sign](value, of) for sign, of in asked)


def _thresholds(kb: KnowledgeBase, root: Behaviour) -> defaultdict[str, set[tuple[str, float]]]:
    """Return the comparisons of each attribute in the model and in the conditions of the tree."""
    found: defaultdict[str, set[tuple[str, float]]] = defaultdict(set)
    for elements in (kb.actions, kb.designs, kb.components, kb.configurations):
        for element in elements.values():
            for one in (view.element for view in element.constraints):
                assert isinstance(one, Constraint)
                found[one.attribute] |= {
                    (one.operator, one.value + side * one.hysteresis) for side in (1, 0, -1)
                }
    for leaf in nodes(root):
        if isinstance(leaf, Measurement):
            found[leaf.attribute.name].add((leaf.operator, leaf.value))
    return found


def _distinct(asked: set[tuple[str, float]], attribute: Attribute) -> tuple[float, ...]:
    """Return values of an attribute, one for each possible combination of results of the comparisons."""
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
    """Group components that nothing distinguishes; one that the tree asks for by name is alone."""
    groups: defaultdict[object, list[str]] = defaultdict(list)
    for name in names:
        view = kb.components[name]
        users = frozenset(design for design, one in kb.designs.items() if name in one.components)
        is_plain = not view.configurations and not view.constraints and name not in named
        groups[(users, view.kind, view.always_improve) if is_plain else name].append(name)
    return [tuple(group) for group in groups.values()]


Values = Mapping[str, tuple[float, ...]]
"""By attribute, what can be measured."""

_CHANCE: Final = (Timer, ProbabilisticBehaviour)
"""Leaves of py_trees that decide by the wall clock or by chance; all others are deterministic."""


@dataclass(frozen=True)
class Leaf:
    """What a leaf may return, and what it does to facts.

    Attributes:
        answers: letters of "R", "S" and "F"; empty: the leaf works as it is.
        effects: by letter, the attributes that are measured when it returns that, such as
            {"S": {"battery_level": 1.0}}.
    """

    answers: str = "RSF"
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        wrong = [one for one in (*self.answers, *self.effects) if one not in LETTERS]
        if wrong:
            raise ValueError(f"the answers of a leaf are letters of R, S and F, not {wrong[0]!r}")


def usual(leaf: Behaviour, kb: KnowledgeBase, values: Values) -> Leaf:
    """Return what an undeclared leaf may return; on success, what its schema makes feasible becomes so."""
    is_ours = isinstance(leaf, KbBehaviour) and not isinstance(leaf, RosaAction)
    is_known = type(leaf).__module__.startswith(("py_trees.", "rosa_bt.")) and not isinstance(
        leaf, RosaAction
    )
    if is_ours or (is_known and not isinstance(leaf, _CHANCE)):
        return Leaf("")
    promised = getattr(getattr(leaf, "schema", None), "makes_feasible", ())
    asked = defaultdict[str, list[tuple[str, float]]](list)
    for one in (needed for action in promised for needed in kb.actions[action].constraints):
        asked[one.attribute].append((one.operator, one.value))
    met = {name: max(values[name], key=partial(_satisfied, those)) for name, those in asked.items()}
    return Leaf("FS") if isinstance(leaf, Condition) else Leaf(effects={"S": met} if met else {})


def take_over(
    root: Behaviour,
    kb: KnowledgeBase,
    declared: Mapping[str, Leaf],
    values: Values,
    choices: Choices,
) -> dict[str, str]:
    """Replace the work of leaves by chosen answers; return their letters by name. Actions are still requested.

    Raises:
        UnknownName: a declaration names a leaf that the tree does not have.
    """
    leaves = [one for one in nodes(root) if not one.children and not isinstance(one, PlanExecutor)]
    for name in declared:
        if name not in {leaf.name for leaf in leaves}:
            raise UnknownName("leaf", name, dict.fromkeys(leaf.name for leaf in leaves))
    letters: dict[str, str] = {}
    for leaf in leaves:
        said = declared.get(leaf.name) or usual(leaf, kb, values)
        if said.answers:
            replace_work(leaf, partial(_answered, leaf, said, kb, choices))
            letters[leaf.name] = said.answers
    return letters


def _answered(leaf: Behaviour, said: Leaf, kb: KnowledgeBase, choices: Choices) -> Status:
    letter = choices.choose(leaf, said.answers)
    for attribute, value in said.effects.get(letter, {}).items():
        kb.measure(attribute, value)
    return LETTERS[letter]


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
        known = [
            self.kb.configurations[one] for one in self.kb.components[component].configurations
        ]
        is_allowed = any(
            one.parameters == parameters and one.status != "unfeasible" for one in known
        )
        self._note(
            "configures",
            component,
            "" if is_allowed else f"no feasible configuration has {dict(parameters)}",
        )

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
    planner: Callable[[], ConfigurationPlanner] | None = None
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
        self._robot, self._budgets = (
            _Robot(self.kb),
            Budgets(getattr(self.planner, "budgets", None)),
        )
        self._manager = ConfigurationManager(self.kb, self._robot, planner=self.planner)
        self.choices = Choices()
        self.tape = Tape(
            self.kb, self.choices, is_on=setup.planner is None
        )  # a tree may know another planner
        self.root = setup.tree(self.tape.kb)
        self.surroundings = Surroundings(self.kb, self.root, **setup.surroundings)
        self.letters = take_over(
            self.root, self.tape.kb, setup.leaves, self.surroundings.values, self.choices
        )
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
                if (
                    self._manager.update() is None and self.kb.revision == revision
                ) or is_settled():
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
