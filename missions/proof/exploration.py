"""Every situation that a tree, its knowledge base and the manager can get into, found by running them.

A round is what happens around the robot, the manager's turn, a tick in which each leaf answers, and the manager's turn
again. What a change of facts and what a turn of the manager make of what is known does not depend on the tree, so it is
found once for each state of the knowledge base; a tick is run in each state of both, for every answer.
"""

import sys
import time
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any, Final, NamedTuple

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.visitors import VisitorBase

from kb import ConfigurationManager, KnowledgeBase, Model
from kb.managed_system import Operation
from kb.elements import ComponentKind, Parameters
from kb.execution.safeguards import Budgets
from kb.manager import Planner
from missions.proof.leaves import Answer, Choices, Leaf, take_over
from missions.proof.memory import Content, Memory
from missions.proof.surroundings import Change, Surroundings
from rosa_bt import ForAction, RosaAction, TreeRunner
from rosa_bt.behaviours import kept

Build = Callable[[KnowledgeBase], Behaviour]
Predicate = Callable[["Rig"], bool]

_MOST_TURNS: Final = 20
"""So many turns of the manager settle everything, or it never comes to rest."""


class Robot:
    """A managed system that does what it is told, at once, and notes what a model does not allow.

    Attributes:
        faults: what the manager should not have commanded, in words.
    """

    def __init__(self) -> None:
        self.faults: list[str] = []
        self.kb: KnowledgeBase | None = None

    def activate(self, component: str) -> None:
        """Note it if the component cannot work, or is never switched."""
        self._check("activates", component, "it cannot be used" if self._is_unusable(component) else "")

    def deactivate(self, component: str) -> None:
        """Note it if the component is never switched."""
        self._check("deactivates", component, "")

    def set_parameters(self, component: str, parameters: Parameters) -> None:
        """Note it if no configuration that can be had now says so."""
        assert self.kb is not None
        known = [self.kb.configurations[one] for one in self.kb.components[component].configurations]
        is_allowed = any(dict(one.parameters) == dict(parameters) and one.status != "unfeasible" for one in known)
        self._check("configures", component, "" if is_allowed else f"no feasible configuration has {dict(parameters)}")

    def _is_unusable(self, component: str) -> bool:
        assert self.kb is not None
        return self.kb.components[component].status in ("failure", "unfeasible")

    def _check(self, does: str, component: str, why_not: str) -> None:
        assert self.kb is not None
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
        leaves: by name, what leaves may return; others as `leaves.usual` says.
        planner: makes what chooses configurations; by priority without one.
        start: what is measured before the first tick; nothing else is.
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


class Rig(VisitorBase):
    """The parts of a mission in one situation; this is what a predicate of a user is asked about.

    Attributes:
        kb: the knowledge base.
        root: of the tree.
        clock: the time [s]; it stands still while exploring.
        ticked: the behaviours that were ever ticked.
    """

    def __init__(self, setup: Setup, choices: Choices | None = None) -> None:
        super().__init__(full=False)
        self.clock = 0.0
        self.robot = Robot()
        self.robot.kb = self.kb = KnowledgeBase(setup.model(), clock=lambda: self.clock)
        with self.kb.reading() as state:
            for index in range(len(state.columns["status"])):
                state.users.of(index)  # so that they are there in every state, also while nobody uses anything
        planner = None if setup.planner is None else setup.planner()
        self.budgets = Budgets(getattr(planner, "budgets", None))
        self.manager = ConfigurationManager(self.kb, self.robot, planner=planner)
        self.root = setup.build(self.kb)
        self.surroundings = Surroundings(self.kb, self.root, **setup.surroundings)
        self.choices = Choices() if choices is None else choices
        self.letters = take_over(self.root, self.kb, setup.leaves, self.surroundings.values, self.choices)
        self.runner = TreeRunner(self.root, clock=lambda: self.clock)
        self.runner.tree.add_visitor(self)
        for name, value in setup.start.items():
            self.kb.measure(name, value)
        self.doing = [one for one in self.root.iterate() if isinstance(one, RosaAction | ForAction)]
        self.ticked: set[Behaviour] = set()

    def run(self, behaviour: Behaviour) -> None:
        self.ticked.add(behaviour)

    def is_required(self, action: str) -> bool:
        """Tell whether an action is requested."""
        return any(one.action == action for one in self.kb.required_actions)

    def measured(self, attribute: str) -> float | None:
        """Return the latest measurement."""
        return self.kb.attributes[attribute].value

    @property
    def required(self) -> tuple[str, ...]:
        """The actions that are requested."""
        return tuple(sorted(one.action for one in self.kb.required_actions))

    @property
    def unfeasible(self) -> tuple[str, ...]:
        """The actions that are requested although they are unfeasible."""
        return tuple(one for one in self.required if not self.kb.is_feasible(one))

    def settle(self) -> tuple[str, ...]:
        """Have the manager take its turns until it has nothing to do; return what was wrong about that, in words."""
        self.robot.faults.clear()
        for _ in range(_MOST_TURNS):
            revision = self.kb.revision
            if self.manager.update() is None and self.kb.revision == revision:
                break
        else:
            self.robot.faults.append("the manager does not come to rest")
        if self.kb.pending_plan is not None:
            self.robot.faults.append(f"the plan {self.kb.pending_plan} does not end")
        if not self.budgets.allow(self.kb, (), ()):
            self.robot.faults.append("a budget is exceeded")
        for action in self.required:
            if self.kb.actions[action].status not in ("unfeasible", "solved"):
                self.robot.faults.append(f"the manager does not configure the robot for {action}")
        return tuple(self.robot.faults)


class Known(NamedTuple):
    """What matters of a state of the knowledge base, once the manager has had its turn."""

    required: tuple[str, ...]
    unfeasible: frozenset[str]  # required all the same
    occurring: frozenset[tuple[str, str]]  # kind and name of what is selected, active or required
    failed: tuple[str, ...]
    values: tuple[tuple[str, float | str | None], ...]

    @property
    def facts(self) -> tuple[object, object]:
        return self.failed, self.values


class Doing(NamedTuple):
    """What matters of the state of a tree after a tick."""

    status: Status
    running: frozenset[str]  # the actions of its behaviours that run


class Step(NamedTuple):
    """How a situation was reached from the one before: one round."""

    before: int
    changes: tuple[Change, ...]
    answers: tuple[Answer, ...]
    late: tuple[bool, bool] = (False, False)  # whether the manager missed its turn before and after the tick


class Situation(NamedTuple):
    """Tree and knowledge base after a round."""

    tree: int
    known: int


class _Table:
    """States by number, each once."""

    def __init__(self, memory: Memory) -> None:
        self.memory, self.contents, self._numbers = memory, list[Content](), dict[tuple[int, ...], int]()

    def read(self) -> int:
        contents = self.memory.read()
        key = tuple(map(id, contents))
        number = self._numbers.setdefault(key, len(self.contents))
        if number == len(self.contents):
            self.contents.append(contents)
        return number

    def write(self, number: int) -> None:
        self.memory.write(self.contents[number])


class Exploration:
    """All situations that can be reached, as far as they were found.

    Attributes:
        rig: the parts of the mission; `load` puts them into a situation.
        situations: by number, 0 the first.
        steps: by number of situation, how it was reached first, by the fewest rounds.
        moments: by number: a situation's tree with what is known before its tick.
        happening: from a situation to a moment: pairs of numbers.
        ticks: from a moment to a situation, with the answers.
        is_finished: whether nothing is left to be found.
        transitions: how many changes and ticks were found.
        seconds: how long it took [s].
        holds: by predicate, in which situations it does.
    """

    def __init__(self, setup: Setup, predicates: Sequence[Predicate] = ()) -> None:
        self.setup, self.rig = setup, Rig(setup)
        self.predicates = tuple(dict.fromkeys(predicates))
        rig = self.rig
        self.faults: dict[str, list[Step]] = {}
        with rig.kb.reading() as state:  # which parameters are in force is asked by budgets, and by users
            apart = [] if setup.planner or predicates else [state.parameters]
        self._known = _Table(Memory([rig.kb, rig.manager], apart))
        self._tree = _Table(Memory([rig.root, *kept(rig.kb)], apart=[rig.kb, rig.manager, rig.choices]))
        self.known: dict[int, Known] = {}
        self.doing: dict[int, Doing] = {}
        self.situations: list[Situation] = []
        self.steps: list[Step] = []
        self._numbers: dict[Situation, int] = {}
        self.moments: list[Situation] = []
        self.origins: list[Step] = []
        self._moment_numbers: dict[Situation, int] = {}
        self.happening: list[list[tuple[int, tuple[Change, ...], bool]]] = []
        self.ticks: list[list[tuple[int, tuple[Answer, ...], bool]]] = []
        self.holds: dict[Predicate, set[int]] = {one: set() for one in self.predicates}
        self._settled: dict[int, int] = {}
        self._changed: dict[int, list[tuple[int, tuple[Change, ...], bool]]] = {}
        self._told: dict[tuple[object, ...], int] = {}
        self.is_finished = False
        self.transitions, self.seconds = 0, 0.0
        self.first: list[Step] = []
        settled = self._settle(self._known.read(), lambda: [])
        self._waiting = [self._add(Situation(self._tree.read(), settled), Step(-1, (), ()))]

    def explore(self, most: int = 100_000, seconds: float = 60.0) -> "Exploration":
        """Find what can be reached, at most so many situations and for so long [s]; called again, it goes on."""
        begun = time.perf_counter()
        end, before = begun + seconds, self.seconds
        while self._waiting and len(self.situations) < most and time.perf_counter() < end:
            self._round(end, most)
        self.is_finished = not self._waiting
        self.seconds = before + time.perf_counter() - begun
        return self

    def load(self, number: int) -> Rig:
        """Put the parts of the mission into a situation and return them."""
        tree, known = self.situations[number]
        self._known.write(known)
        self._tree.write(tree)
        return self.rig

    def path(self, number: int) -> list[Step]:
        """Return the rounds by which a situation was reached first."""
        found = []
        while self.steps[number].before >= 0:
            found.append(self.steps[number])
            number = self.steps[number].before
        return found[::-1]

    def _round(self, end: float, most: int) -> None:
        layer, self._waiting = self._waiting, []
        new: list[tuple[int, int, tuple[Change, ...], bool]] = []
        for number in layer:
            tree, known = self.situations[number]
            if time.perf_counter() > end or len(self.situations) >= most:
                self._waiting.append(number)
                continue
            if self._doing(tree).status is Status.SUCCESS:
                continue
            for after, changes, is_late in self._changes(known, number):
                moment = Situation(tree, after)
                place = self._moment_numbers.setdefault(moment, len(self.moments))
                if place == len(self.moments):
                    self.moments.append(moment)
                    self.ticks.append([])
                    self.origins.append(Step(number, changes, (), (is_late, False)))
                    self._describe(moment)
                    new.append((place, number, changes, is_late))
                self.happening[number].append((place, changes, is_late))
                self.transitions += 1
        new.sort(key=lambda one: self.moments[one[0]][::-1])
        for place, number, changes, is_late in new:
            self._tick(place, number, changes, is_late)

    def _tick(self, place: int, before: int, changes: tuple[Change, ...], was_late: bool) -> None:
        """Tick in a moment with every combination of answers."""
        rig, (tree, known) = self.rig, self.moments[place]
        scripts: list[tuple[Answer, ...]] = [()]
        while scripts:
            self._known.write(known)
            self._tree.write(tree)
            rig.choices.begin(scripts.pop())
            last = rig.kb.log.last
            rig.runner.tick()
            scripts += rig.choices.others()
            answers, after_tree = tuple(rig.choices.taken), self._tree.read()
            after = self._after_tick(known, last)
            settled = self._settle(after, lambda: [*self.path(before), Step(before, changes, answers)])  # noqa: B023
            for reached in dict.fromkeys((settled, after) if self.setup.slow else (settled,)):
                is_late = reached != settled
                step = Step(before, changes, answers, (was_late, is_late))
                self.ticks[place].append((self._situated(Situation(after_tree, reached), step), answers, is_late))
                self.transitions += 1

    def _situated(self, situation: Situation, step: Step) -> int:
        number = self._numbers.get(situation)
        if number is None:
            number = self._add(situation, step)
            self._waiting.append(number)
        return number

    def _add(self, situation: Situation, step: Step) -> int:
        number = self._numbers[situation] = len(self.situations)
        self.situations.append(situation)
        self.steps.append(step)
        self.happening.append([])
        self._describe(situation)
        if self.predicates:
            rig = self.load(number)
            for predicate in self.predicates:
                if predicate(rig):
                    self.holds[predicate].add(number)
        return number

    def _after_tick(self, known: int, last: int) -> int:
        """Return what is known after a tick: what the tree told decides it."""
        log = self.rig.kb.log
        if log.last == last:
            return known
        key = (known, *((event.verb, str(event.arguments)) for event in log.since(last)))
        after = self._told.get(key)
        if after is None:
            after = self._told[key] = self._known.read()
        else:
            self._known.memory.assume(self._known.contents[after])
        return after

    def _settle(self, known: int, trail: Callable[[], list[Step]]) -> int:
        """Return what is known when the manager has done all there is to do; its faults are noted with the way there."""
        found = self._settled.get(known)
        if found is None:
            self._known.write(known)
            faults = self.rig.settle()
            found = self._settled[known] = self._known.read()
            self._settled.setdefault(found, found)
            for fault in faults:
                self.faults.setdefault(fault, trail())
        return found

    def _changes(self, known: int, number: int) -> list[tuple[int, tuple[Change, ...], bool]]:
        """Return what is known after each change of facts, with and without the manager's turn."""
        found = self._changed.get(known)
        if found is None:
            self._known.write(known)
            reached: dict[int, tuple[tuple[Change, ...], bool]] = {}
            for changes in list(self.rig.surroundings.changes()):
                self._known.write(known)
                for change in changes:
                    change.tell(self.rig.kb)
                told = self._known.read()
                trail = lambda: [*self.path(number), Step(number, changes, ())]  # noqa: B023, E731
                reached.setdefault(self._settle(told, trail), (changes, False))
                if self.setup.slow:
                    reached.setdefault(told, (changes, True))
                self._known.write(known)
            found = self._changed[known] = [(number, *how) for number, how in reached.items()]
        return found

    def _doing(self, tree: int) -> Doing:
        return self.doing[tree]

    def _describe(self, situation: Situation) -> None:
        """Note what matters of a state that is new; it is loaded for that."""
        tree, known = situation
        if tree not in self.doing:
            self._tree.write(tree)
            running = frozenset(one.action for one in self.rig.doing if one.status is Status.RUNNING)
            self.doing[tree] = Doing(self.rig.root.status, running)
        if known not in self.known:
            self._known.write(known)
            self.known[known] = _known(self.rig)


def _known(rig: Rig) -> Known:
    kb, required = rig.kb, rig.required
    tables = (("function design", kb.designs, "is_selected"), ("configuration", kb.configurations, "is_selected"))
    tables += (("component", kb.components, "is_active"), ("action", kb.actions, "is_required"))
    return Known(
        required,
        frozenset(rig.unfeasible),
        frozenset((kind, name) for kind, table, what in tables for name, one in table.items() if getattr(one, what)),
        rig.surroundings.failed(),
        tuple((name, "stale" if (one := kb.attributes[name]).is_stale else one.value) for name in rig.surroundings.values),
    )
