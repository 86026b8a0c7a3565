"""The graph of all situations that a tree, its knowledge base and the manager can get into, found by running them.

In a round some facts change, the manager takes its turns, the tree is ticked and each leaf answers, and the manager
takes its turns again.
"""

import sys
import time
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import NamedTuple
from weakref import WeakKeyDictionary

from py_trees.blackboard import Blackboard
from py_trees.common import Status
from py_trees.composites import Sequence as SequenceNode

from missions.proof.environment import Change, Facts, Value
from missions.proof.memory import Memory, attributes_of
from missions.proof.rig import Answer, Predicate, Rig, Setup, Step


class Situation(NamedTuple):
    """A state of the tree, by number, the facts, and what was brought about; before or after a tick."""

    tree: int
    facts: Facts
    deeds: frozenset[str]


class Known(NamedTuple):
    """What properties look at in a state of the knowledge base; `occurring` is what is selected or required."""

    required: tuple[str, ...]
    unfeasible: tuple[str, ...]
    feasible: frozenset[str]
    occurring: frozenset[tuple[str, str]]


class Doing(NamedTuple):
    """What properties look at in a state of the tree; the stage is where its sequences with memory have got to."""

    status: Status
    running: frozenset[str]
    stage: tuple[str, ...]
    is_over: bool


class Round(NamedTuple):
    """A round: what happens in it, the facts just before its tick, and the number of the situation after it."""

    step: Step
    before: Known
    after: int
    is_caused: bool

    @property
    def is_still(self) -> bool:
        """Whether no fact changes and the manager misses no turn."""
        return not self.step.changes and not any(self.step.late)


Wrong = tuple[str, Sequence[Step] | None]
"""What is wrong, in words, and the rounds that lead there; None if no single story shows it."""


class Exploration:
    """The situations that were found so far, and the questions about them that properties ask.

    Args:
        setup: what is explored.
        predicates: each is evaluated in every situation.
        goal: holds where the mission has reached its goal; by default what the PDDL file says, or else the success of
            the root.

    Attributes:
        rig: the parts of the mission; `load` puts them into a situation.
        situations: by number; 0 is the initial one, and those that fewer rounds lead to come first.
        rounds: by number of the situation, all that may follow it; shorter than `situations` until it is finished.
        faults: of the manager, in words, each with the fewest rounds that lead there.
        holds: by predicate, the situations in which it holds.
        seconds: how long the exploration took [s].
    """

    def __init__(
        self, setup: Setup, predicates: Sequence[Predicate] = (), goal: Predicate | None = None
    ) -> None:
        self.rig = rig = Rig(setup)
        self._goal = goal
        self._predicates = [*predicates, *([goal] if goal is not None else [])]
        self.faults: dict[str, Sequence[Step]] = dict.fromkeys(rig.begin(), ())
        self._apart = _kept_apart(rig)
        self._memory = Memory([rig.root, Blackboard.storage, *self._apart])
        self.situations: list[Situation] = []
        self.known: list[Known] = []
        self.doing: list[Doing] = []
        self.rounds: list[list[Round]] = []
        self.holds: dict[Predicate, set[int]] = {each: set() for each in self._predicates}
        self._reached_by: list[tuple[int, Step]] = []
        self._numbers: dict[Situation, int] = {}
        self._known_of: dict[Facts, Known] = {}
        self._settled: dict[Facts, tuple[Facts, tuple[str, ...]]] = {}
        self._ticks: dict[Situation, list[tuple[int, tuple[Answer, ...], bool, bool]]] = {}
        self._is_stopped = False
        self.seconds = 0.0
        first = Situation(self._read_tree(), rig.read(), frozenset())
        self._number(first, -1, Step())

    def explore(self, most: int = 100_000, seconds: float = 60.0) -> "Exploration":
        """Explore, breadth first; called again, it goes on where it stopped.

        Args:
            most: it stops at about this number of situations.
            seconds: it stops after about this time [s].
        """
        begun = time.perf_counter()
        self._is_stopped = False
        while not self.is_finished and len(self.situations) < most and not self._is_stopped:
            if time.perf_counter() > begun + seconds:
                break
            self.rounds.append(list(self._onward(len(self.rounds))))
        self.seconds += time.perf_counter() - begun
        return self

    def stop(self) -> None:
        """Let `explore` end soon, as if its time were over; may be called from signal handlers."""
        self._is_stopped = True

    @property
    def is_finished(self) -> bool:
        """Whether all situations were explored from."""
        return len(self.rounds) == len(self.situations)

    @property
    def unexplored(self) -> range:
        """The numbers of the situations that were not explored from yet."""
        return range(len(self.rounds), len(self.situations))

    @property
    def every(self) -> range:
        """The numbers of all situations."""
        return range(len(self.situations))

    @property
    def transitions(self) -> int:
        """How many different ticks were run."""
        return sum(map(len, self._ticks.values()))

    @property
    def ended(self) -> set[int]:
        """The situations in which the root has succeeded."""
        return {number for number in self.every if self.doing[number].status is Status.SUCCESS}

    @property
    def goals(self) -> set[int]:
        """The situations in which the goal is reached."""
        if self._goal is not None:
            return set(self.holds[self._goal])
        return {number for number in self.ended if not self.misses(number)}

    def misses(self, number: int) -> str:
        """Return in words why the success of the root is not that of the mission; empty if it is."""
        if self._goal is not None:
            return ""
        deeds = self.situations[number].deeds
        instead = [deed.removeprefix("instead ") for deed in deeds if deed.startswith("instead ")]
        if instead:
            wanted = "write do_until_unfeasible(task, meanwhile)"
            return f"the success of {instead[0]} ends the mission; {wanted}"
        goal = self.rig.setup.causes.goal
        open_goals = sorted(effect for effect in goal if f"{effect} done" not in deeds)
        return (
            f"it ends, and nothing has brought about {', '.join(open_goals)}" if open_goals else ""
        )

    def caused(self, start: Iterable[int] = (0,)) -> set[int]:
        """Return what can be reached from situations if nothing succeeds before the deed that brings it about."""
        reached = set(start)
        pending = list(reached)
        while pending:
            for each in self.following(pending.pop()):
                if each.is_caused and each.after not in reached:
                    reached.add(each.after)
                    pending.append(each.after)
        return reached

    def values(self, number: int) -> dict[str, Value]:
        """Return what is measured in a situation, by attribute."""
        return dict(
            zip(self.rig.environment.values, self.situations[number].facts.values, strict=True)
        )

    def following(self, number: int) -> list[Round]:
        """Return the rounds that may follow a situation."""
        return self.rounds[number] if number < len(self.rounds) else []

    def first(self, bad: Iterable[int], what: str) -> Wrong | None:
        """Return what is wrong in these situations, with the rounds to the nearest of them; None if there is none."""
        number = min(bad, default=None)
        return None if number is None else (what, self.path(number))

    def reaching(
        self, goals: Collection[int], *, still: bool = False, within: Collection[int] | None = None
    ) -> set[int]:
        """Return the goals, and all from which one can be reached by deeds that bring about what succeeds.

        If still, only rounds in which no fact changes count.
        """
        before: defaultdict[int, list[int]] = defaultdict(list)
        for number in self.every if within is None else within:
            for each in self.following(number):
                is_inside = within is None or each.after in within
                if is_inside and each.is_caused and (each.is_still or not still):
                    before[each.after].append(number)
        reached = set(goals)
        pending = list(goals)
        while pending:
            new = [number for number in before[pending.pop()] if number not in reached]
            reached.update(new)
            pending += new
        return reached

    def avoiding(self, number: int, goals: Collection[int], rounds: int) -> list[Step] | None:
        """Return so many rounds that avoid some situations; None if there are no such rounds."""
        layer: dict[int, list[Step]] = {} if number in goals else {number: []}
        for _ in range(rounds):
            after: dict[int, list[Step]] = {}
            for place, trail in layer.items():
                for each in self.following(place):
                    if each.after not in goals:
                        after.setdefault(each.after, [*trail, each.step])
            layer = after
        return next(iter(layer.values()), None)

    def load(self, number: int) -> Rig:
        """Put the parts of the mission into a situation and return them."""
        self._put(self.situations[number])
        return self.rig

    def path(self, number: int) -> list[Step]:
        """Return the fewest rounds that lead to a situation."""
        steps = []
        while number > 0:
            number, step = self._reached_by[number]
            steps.append(step)
        return steps[::-1]

    def _onward(self, number: int) -> Iterator[Round]:
        """Yield all rounds that may follow a situation; those that lead to the same are given once."""
        if self.doing[number].is_over:
            return
        situation = self.situations[number]
        seen: set[Facts] = set()
        for changes in list(self.rig.environment.changes(situation.facts)):
            told = self._changed(situation.facts, changes)
            settled, faults = self._settle(told)
            self._note(faults, number, Step(changes))
            moments = (
                [(settled, False), (told, True)] if self.rig.setup.slow else [(settled, False)]
            )
            for facts, is_late in moments:
                if facts not in seen:
                    seen.add(facts)
                    before = self._know(facts)
                    moment = Situation(situation.tree, facts, situation.deeds)
                    for after, answers, is_caused, late in self._ticked(moment, number, changes):
                        step = Step(changes, answers, (is_late, late))
                        yield Round(step, before, after, is_caused)

    def _changed(self, facts: Facts, changes: Iterable[Change]) -> Facts:
        """Return the facts after changes, before the manager knows of them."""
        values = dict(zip(self.rig.environment.values, facts.values, strict=True))
        failed = set(facts.failed)
        for change in changes:
            if not isinstance(change.to, bool):
                values[change.name] = change.to
            elif change.to:
                failed.add(change.name)
            else:
                failed.discard(change.name)
        return facts._replace(values=tuple(values.values()), failed=frozenset(failed))

    def _ticked(
        self, moment: Situation, number: int, changes: tuple[Change, ...]
    ) -> list[tuple[int, tuple[Answer, ...], bool, bool]]:
        """Return what may follow a tick in a situation: one or more for every combination of answers."""
        if moment in self._ticks:
            return self._ticks[moment]
        found = []
        scripts: list[tuple[Answer, ...]] = [()]
        while scripts:
            self._put(moment)
            self.rig.tick(scripts.pop())
            scripts += self.rig.choices.others
            answers = tuple(self.rig.choices.taken)
            is_caused, deeds = self.rig.is_caused, self.rig.deeds
            tree = self._read_tree()
            after = self.rig.read()
            settled, faults = self._settle(after)
            self._note(faults, number, Step(changes, answers))
            for facts in dict.fromkeys([settled, after] if self.rig.setup.slow else [settled]):
                late = facts != settled
                step = Step(changes, answers, (False, late))
                reached = self._number(Situation(tree, facts, deeds), number, step)
                found.append((reached, answers, is_caused, late))
        self._ticks[moment] = found
        return found

    def _read_tree(self) -> int:
        for table in self._apart:
            for entry in [entry for entry, value in table.items() if value == {}]:
                del table[entry]  # an action that nobody requests is as one that nobody ever did
        return self._memory.read()

    def _put(self, situation: Situation) -> None:
        self.rig.write(situation.facts)
        self._memory.write(situation.tree)
        self.rig.deeds = situation.deeds

    def _settle(self, facts: Facts) -> tuple[Facts, tuple[str, ...]]:
        """Let the manager take its turns until it rests; return the facts then, and its faults."""
        if facts not in self._settled:
            self.rig.write(facts)
            faults = self.rig.settle()
            self._settled[facts] = self.rig.read(), faults
        return self._settled[facts]

    def _note(self, faults: Sequence[str], before: int, step: Step) -> None:
        for fault in faults:
            if fault not in self.faults:
                self.faults[fault] = [*self.path(before), step]

    def _number(self, situation: Situation, before: int, step: Step) -> int:
        number = self._numbers.setdefault(situation, len(self.situations))
        if number == len(self.situations):
            self.situations.append(situation)
            self._reached_by.append((before, step))
            self._put(situation)
            self.known.append(self._know(situation.facts))
            root = self.rig.root
            is_over = (
                getattr(root, "final_status", None) is not None
            )  # a OneShot has ended for good
            is_over |= root.status is Status.SUCCESS
            stage = _stage(self.rig)
            self.doing.append(Doing(root.status, self.rig.running, stage, is_over))
            for predicate in self._predicates:
                if predicate(self.rig):
                    self.holds[predicate].add(number)
        return number

    def _know(self, facts: Facts) -> Known:
        if facts not in self._known_of:
            self.rig.write(facts)
            kb = self.rig.kb
            required = self.rig.required
            occurring = facts.selected | {("action", name) for name in required}
            feasible = frozenset(name for name in kb.actions if kb.is_feasible(name))
            self._known_of[facts] = Known(required, self.rig.unfeasible, feasible, occurring)
        return self._known_of[facts]


def _stage(rig: Rig) -> tuple[str, ...]:
    """Return the current child of each running sequence with memory."""
    running = [node for node in rig.nodes if node.status is Status.RUNNING]
    memorising = [node for node in running if isinstance(node, SequenceNode) and node.memory]
    return tuple(node.current_child.name for node in memorising if node.current_child is not None)


def _kept_apart(rig: Rig) -> list[dict[object, object]]:
    """Return what the behaviours of a knowledge base keep outside the tree: requests and progress."""
    modules = [module for name, module in sys.modules.items() if name.startswith("rosa_bt.")]
    every = [value for module in modules for value in vars(module).values()]
    tables = [value for value in every if isinstance(value, WeakKeyDictionary)]
    ledgers = [table[rig.kb] for table in tables if rig.kb in table]
    parts = [part for ledger in ledgers for part in attributes_of(ledger).values()]
    return [part for part in parts if isinstance(part, dict)]
