"""Every situation that a tree, its knowledge base and the manager can get into, found by running them.

A round is what happens around the robot, the manager's turns, a tick in which each leaf answers, and the manager's
turns again. What facts and the manager make of what is known does not depend on the tree, so it is found once for each
state of the knowledge base; a tick is run in each state of both, for all answers.
"""

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from resource import RUSAGE_SELF, getrusage
from typing import Any, Final, NamedTuple

from py_trees.behaviour import Behaviour
from py_trees.blackboard import Blackboard
from py_trees.common import Status
from py_trees.visitors import VisitorBase

from kb import ConfigurationManager, KnowledgeBase, Model
from kb.elements import ComponentKind, Parameters
from kb.execution.safeguards import Budgets
from kb.manager import Planner, PriorityPlanner
from missions.proof.leaves import Answer, Choices, Leaf, take_over
from missions.proof.memory import Memory
from missions.proof.planned import nodes, stage_of
from missions.proof.surroundings import Change, Surroundings
from missions.proof.tape import Tape
from rosa_bt import ForAction, RosaAction, TreeRunner
from rosa_bt.behaviours import kept

Build = Callable[[KnowledgeBase], Behaviour]
Predicate = Callable[["Rig"], bool]

_MOST_TURNS: Final = 20
"""So many turns of the manager settle everything, or it never comes to rest."""

_AT_A_TIME: Final = 64
"""So many situations are gone on from before it is looked whether there is time for more."""


class _Robot:
    """A managed system that does what it is told, at once, and notes what a model does not allow."""

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

    def tree(self, kb: KnowledgeBase) -> Behaviour:
        """Make the tree, with nothing on the blackboard that another has left there."""
        Blackboard.storage.clear()
        return self.build(kb)


class Rig(VisitorBase):
    """The parts of a mission in one situation; this is what a predicate of a user is asked about.

    Attributes:
        kb: the knowledge base.
        root: of the tree.
        clock: the time [s]; it stands still while exploring.
        letters: what leaves may answer, by name.
        ticked: the behaviours that were ever ticked.
    """

    def __init__(self, setup: Setup, choices: Choices | None = None) -> None:
        super().__init__(full=False)
        self.clock, self._start = 0.0, setup.start
        self.kb = KnowledgeBase(setup.model(), clock=lambda: self.clock)
        self.planner = PriorityPlanner() if setup.planner is None else setup.planner()
        self._robot, self._budgets = _Robot(self.kb), Budgets(getattr(self.planner, "budgets", None))
        self._manager = ConfigurationManager(self.kb, self._robot, planner=self.planner)
        self.choices = Choices() if choices is None else choices
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
        """Tell whether an action is requested."""
        return any(one.action == action for one in self.kb.required_actions)

    def measured(self, attribute: str) -> float | None:
        """Return the latest measurement."""
        return self.kb.attributes[attribute].value

    @property
    def required(self) -> tuple[str, ...]:
        """The actions that are requested."""
        return tuple(sorted(one.action for one in self.kb.required_actions))

    def begin(self) -> tuple[str, ...]:
        """Measure what is measured before the first tick, and have the manager take its turns."""
        for name, value in self._start.items():
            self.kb.measure(name, value)
        return self.settle()

    @property
    def unfeasible(self) -> tuple[str, ...]:
        """The actions that are requested although they are unfeasible."""
        return tuple(one for one in self.required if not self.kb.is_feasible(one))

    def settle(self, is_settled: Callable[[], bool] = lambda: False) -> tuple[str, ...]:
        """Have the manager take its turns until it has nothing to do; return what was wrong about that, in words."""
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


class Known(NamedTuple):
    """What matters of a state of the knowledge base."""

    required: tuple[str, ...]
    unfeasible: tuple[str, ...]  # required all the same
    occurring: frozenset[tuple[str, str]]  # kind and name of what is selected or required
    failed: tuple[str, ...]
    values: tuple[tuple[str, float | str | None], ...]
    feasible: tuple[str, ...]  # of all actions


class Doing(NamedTuple):
    """What matters of the state of a tree after a tick."""

    status: Status
    running: frozenset[str]  # the actions of its behaviours that run
    stage: tuple[object, ...]  # where the sequences that remember it have got to, and what plans believe
    is_over: bool  # it has succeeded, or ended for good


class Step(NamedTuple):
    """A round: what changes, what leaves answer, and whether the manager misses its turn before and after the tick."""

    changes: tuple[Change, ...] = ()
    answers: tuple[Answer, ...] = ()
    late: tuple[bool, bool] = (False, False)


class Situation(NamedTuple):
    """Numbers of the states of tree and knowledge base: after a round, or after changes and before a tick."""

    tree: int
    known: int


class Move(NamedTuple):
    """A round that may follow a situation, up to its tick: changes lead to a moment."""

    moment: Situation
    changes: tuple[Change, ...]
    is_late: bool


class Tick(NamedTuple):
    """What follows a moment: answers lead to a situation, of that number."""

    situation: int
    answers: tuple[Answer, ...]
    is_late: bool


class Exploration:
    """All situations that can be reached, as far as they were found.

    Attributes:
        rig: the parts of the mission; `load` puts them into a situation.
        situations: by number, that in the beginning first, then by the fewest rounds that lead there.
        moves: by number of situation, the rounds that may follow.
        ticks: by moment, what may follow.
        known, doing: what matters of states, by their numbers.
        faults: of the manager, in words, with the rounds that lead there first.
        holds: by predicate, in which situations it does.
        is_finished: whether nothing is left to be found.
        transitions: how many changes and ticks were found.
        seconds: how long it took [s].
        megabytes: the most memory that the process has held when it ended [MB].
    """

    def __init__(self, setup: Setup, predicates: Sequence[Predicate] = ()) -> None:
        self.rig = rig = Rig(setup)
        self._slow, self.faults = setup.slow, {fault: list[Step]() for fault in rig.begin()}
        self._known = Memory([rig.kb, rig.planner], parameters=bool(setup.planner or predicates))
        self._tree = Memory(
            [rig.root, Blackboard.storage, *kept(rig.tape.kb)], apart=[rig.kb, rig.planner, rig.choices]
        )
        self.known: dict[int, Known] = {}
        self.doing: dict[int, Doing] = {}
        self.situations: list[Situation] = []
        self.moves: list[list[Move]] = []
        self.ticks: dict[Situation, list[Tick]] = {}
        self._steps: list[tuple[int, Step]] = []
        self._numbers: dict[Situation, int] = {}
        self.holds: dict[Predicate, set[int]] = {one: set() for one in predicates}
        self._settled: dict[int, int] = {}
        self._changed: dict[int, list[tuple[int, tuple[Change, ...], bool]]] = {}
        self.is_finished, self.transitions, self.seconds, self.megabytes = False, 0, 0.0, 0.0
        self._waiting: list[int] = []
        self._reach(Situation(self._tree.read(), self._known.read()), -1, Step())

    def explore(self, most: int = 100_000, seconds: float = 60.0) -> "Exploration":
        """Find what can be reached, at most so many situations and for so long [s]; called again, it goes on."""
        begun = time.perf_counter()
        while self._waiting and len(self.situations) < most and time.perf_counter() < begun + seconds:
            batch, self._waiting = self._waiting[:_AT_A_TIME], self._waiting[_AT_A_TIME:]
            self._round(batch, most, begun + seconds)
        self.is_finished = not self._waiting
        self.seconds += time.perf_counter() - begun
        self.megabytes = getrusage(RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)
        return self

    @property
    def unexplored(self) -> frozenset[int]:
        """The situations of which it is not known yet what follows."""
        return frozenset(self._waiting)

    def load(self, number: int) -> Rig:
        """Put the parts of the mission into a situation and return them."""
        tree, known = self.situations[number]
        self._known.write(known)
        self._tree.write(tree)
        return self.rig

    def path(self, number: int) -> list[Step]:
        """Return the rounds by which a situation was reached first."""
        found = []
        while number > 0:
            number, step = self._steps[number]
            found.append(step)
        return found[::-1]

    def _round(self, layer: Sequence[int], most: int, end: float) -> None:
        """Find what follows situations; those for which there is no room or time any more wait for the next call."""
        new: list[tuple[int, int, Move]] = []
        for place, number in enumerate(layer):
            if time.perf_counter() > end or len(self.situations) >= most:
                self._waiting[:0] = layer[place:]
                break
            tree, known = self.situations[number]
            for after, changes, is_late in () if self.doing[tree].is_over else self._changes(known, number):
                move = Move(Situation(tree, after), changes, is_late)
                if move.moment not in self.ticks:
                    self.ticks[move.moment] = []
                    self._describe(move.moment)
                    new.append((after, number, move))
                self.moves[number].append(move)
                self.transitions += 1
        for _, before, move in sorted(new, key=itemgetter(0)):  # what is known is written only once
            self._tick(before, move)

    def _tick(self, before: int, move: Move) -> None:
        """Tick in a moment with every combination of answers."""
        for after_tree, after, answers in self._outcomes(move.moment):
            step = Step(move.changes, answers, (move.is_late, False))
            settled = self._settle(after, before, step)
            for reached in dict.fromkeys((settled, after) if self._slow else (settled,)):
                late = Step(step.changes, step.answers, (move.is_late, reached != settled))
                number = self._reach(Situation(after_tree, reached), before, late)
                self.ticks[move.moment].append(Tick(number, step.answers, late.late[1]))
                self.transitions += 1

    def _outcomes(self, moment: Situation) -> Iterator[tuple[int, int, tuple[Answer, ...]]]:
        """Yield the states of tree and knowledge base after a tick, for all answers."""
        rig, (tree, known) = self.rig, moment
        scripts: list[tuple[Answer, ...]] = [()]
        while scripts:
            rig.choices.begin(script := scripts.pop())
            after = rig.tape.follow(tree, known, self._known)
            if after is None:
                self._known.write(known)
                self._tree.write(tree)
                rig.choices.begin(script)
                rig.runner.tick()
                after = self._tree.read(), self._known.read()
                rig.tape.keep(tree, after[0])
            scripts += rig.choices.others
            yield *after, tuple(rig.choices.taken)

    def _reach(self, situation: Situation, before: int, step: Step) -> int:
        number = self._numbers.setdefault(situation, len(self.situations))
        if number == len(self.situations):
            self.situations.append(situation)
            self._steps.append((before, step))
            self.moves.append([])
            self._waiting.append(number)
            self._describe(situation)
            for predicate, holds in self.holds.items():
                if predicate(self.load(number)):
                    holds.add(number)
        return number

    def _settle(self, known: int, before: int, step: Step) -> int:
        """Return what is known when the manager has nothing to do any more; its faults are noted with the way there."""
        found = self._settled.get(known)
        if found is None:
            self._known.write(known)
            faults = self.rig.settle(lambda: self._settled.get(number := self._known.read()) == number)
            found = self._settled[known] = self._known.read()
            self._settled.setdefault(found, found)
            for fault in faults:
                self.faults.setdefault(fault, [*self.path(before), step])
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
                reached.setdefault(self._settle(told, number, Step(changes)), (changes, False))
                if self._slow:
                    reached.setdefault(told, (changes, True))
            found = self._changed[known] = [(after, *how) for after, how in reached.items()]
        return found

    def _describe(self, situation: Situation) -> None:
        """Note what matters of states that are new."""
        tree, known = situation
        rig, kb = self.rig, self.rig.kb
        if tree not in self.doing:
            self._tree.write(tree)
            running = frozenset(one.action for one in rig.doing if one.status is Status.RUNNING)
            is_over = rig.root.status is Status.SUCCESS or getattr(rig.root, "final_status", None) is not None
            self.doing[tree] = Doing(rig.root.status, running, stage_of(rig.root), is_over)
        if known not in self.known:
            self._known.write(known)
            chosen = [one for table in (kb.designs, kb.configurations) for one in table.values() if one.is_selected]
            occurring = [("action", one) for one in rig.required] + [(one.node.kind, one.name) for one in chosen]
            attributes = [kb.attributes[name] for name in rig.surroundings.values]
            values = tuple((one.name, "stale" if one.is_stale else one.value) for one in attributes)
            failed = rig.surroundings.failed()
            feasible = tuple(kb.selectable_actions())
            self.known[known] = Known(rig.required, rig.unfeasible, frozenset(occurring), failed, values, feasible)
