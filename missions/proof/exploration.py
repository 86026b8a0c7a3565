"""The graph of all situations that tree, knowledge base and manager can get into.

In a round some facts change, the manager takes its turns, the tree is ticked and each leaf answers,
and the manager takes its turns again.
"""

import time
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from py_trees.blackboard import Blackboard
from py_trees.common import Status
from py_trees.composites import Sequence as SequenceNode

from missions.proof.memory import Memory
from missions.proof.rig import Answer, Rig, Step
from missions.proof.setup import Change, Facts, Predicate, Setup
from rosa_bt.requests import requests_of


class Situation(NamedTuple):
    """The states of the tree and of the knowledge base, and what was brought about.

    Before or after a tick.
    """

    tree: bytes
    facts: Facts
    deeds: frozenset[str]


class Seen(NamedTuple):
    """What properties look at in a situation.

    Attributes:
        required, unfeasible: the actions that are requested, and those that are although they are
            unfeasible.
        feasible: the actions that could be requested.
        running: the actions of behaviours that run.
        stage: where the sequences with memory have got to.
        has_succeeded: whether the root has.
    """

    required: tuple[str, ...]
    unfeasible: tuple[str, ...]
    feasible: frozenset[str]
    running: frozenset[str]
    stage: tuple[str, ...]
    has_succeeded: bool


class Round(NamedTuple):
    """A round: what happens, the actions required though unfeasible, and what follows."""

    step: Step
    late: tuple[str, ...]
    after: int
    is_caused: bool


Wrong = tuple[str, Sequence[Step] | None]
"""What is wrong, in words, and the rounds that lead there; None if no single story shows it."""


class Exploration:
    """The situations that were found so far, and the questions about them that properties ask.

    Attributes:
        rig: the parts of the mission; `load` puts them into a situation.
        situations: by number; 0 is the initial one, and those that fewer rounds lead to come first.
        rounds: by number of the situation, all that may follow it; empty until it is explored.
        seen: by number, what properties look at.
        faults: of the manager, in words, each with the fewest rounds that lead there.
        holds: by predicate, the situations in which it holds.
        transitions: how many different ticks were run.
        seconds: how long the exploration took [s].
    """

    def __init__(self, setup: Setup) -> None:
        self.rig = rig = Rig(setup)
        self.faults: dict[str, Sequence[Step]] = dict.fromkeys(rig.begin(), ())
        self.situations: list[Situation] = []
        self.seen: list[Seen] = []
        self.rounds: list[list[Round]] = []
        self.holds: defaultdict[Predicate, set[int]] = defaultdict(set)
        self.transitions = 0
        self.seconds = 0.0
        self._predicates = [predicate for each in setup.wanted for predicate in each.predicates]
        requests = requests_of(rig.kb)
        kept = [requests.open, requests.halting, requests.progress]
        self._memory = Memory([rig.root, Blackboard.storage, rig.senses, *kept])
        self._count = 0
        self._reached_by: list[tuple[int, Step]] = []
        self._numbers: dict[Situation, int] = {}
        self._settled: dict[Facts, Facts] = {}
        self._ticks: dict[Situation, list[Round]] = {}
        self._number(Situation(self._memory.read(), rig.read(), frozenset()), -1, Step())

    def explore(self) -> "Exploration":
        """Explore, breadth first, until all is found, or as much or as long as the setup says.

        Ctrl-C ends it, too.
        """
        begun = time.perf_counter()
        try:
            while not self.is_finished and len(self.situations) < self.rig.setup.most:
                if time.perf_counter() > begun + self.rig.setup.seconds:
                    break
                self.rounds[self._count] = list(self._onward(self._count))
                self._count += 1
        except KeyboardInterrupt:
            pass
        self.seconds = time.perf_counter() - begun
        return self

    @property
    def is_finished(self) -> bool:
        """Whether all situations were explored from."""
        return self._count == len(self.situations)

    @property
    def unexplored(self) -> range:
        """The numbers of the situations that were not explored from yet."""
        return range(self._count, len(self.situations))

    @property
    def every(self) -> range:
        """The numbers of all situations."""
        return range(len(self.situations))

    @property
    def occurring(self) -> set[tuple[str, str]]:
        """What was ever selected or required, as kind and name."""
        occurring = set[tuple[str, str]]()
        for facts in self._settled.values():
            occurring |= {*facts.selected, *(("action", action) for action, _ in facts.requested)}
        return occurring

    @property
    def goals(self) -> set[int]:
        """The situations in which the goal is reached."""
        ended = (number for number in self.every if self.seen[number].has_succeeded)
        return {number for number in ended if not self.misses(number)}

    def misses(self, number: int) -> str:
        """Return in words why the success of the root is not that of the mission.

        Empty if it is.
        """
        deeds = self.situations[number].deeds
        for deed in deeds:
            if deed.startswith("the success of "):
                return f"{deed}; write do_until_unfeasible(task, meanwhile)"
        goal = self.rig.setup.causes.goal
        lacking = sorted(effect for effect in goal if f"{effect} done" not in deeds)
        return f"it ends, and nothing has brought about {', '.join(lacking)}" if lacking else ""

    def caused(self) -> list[int]:
        """Return what can be reached if nothing succeeds before the deed that brings it about.

        The nearest first.
        """
        onward: dict[int, list[int]] = {}
        for number, rounds in enumerate(self.rounds):
            onward[number] = [each.after for each in rounds if each.is_caused]
        return _closure([0], onward)

    def first(self, bad: Iterable[int], what: str) -> Wrong | None:
        """Return what is wrong in these situations, with the rounds to the nearest of them.

        None if there is none.
        """
        number = min(bad, default=None)
        return None if number is None else (what, self.path(number))

    def reaching(
        self, goals: Iterable[int], *, still: bool = False, within: Collection[int] | None = None
    ) -> set[int]:
        """Return the goals, and all from which one can be reached by caused successes.

        If still, only rounds in which no fact changes count.
        """
        inside = self.every if within is None else within
        before: defaultdict[int, list[int]] = defaultdict(list)
        for number in inside:
            for each in self.rounds[number]:
                if each.is_caused and each.after in inside and not (still and each.step.changes):
                    before[each.after].append(number)
        return {*_closure(goals, before)}

    def load(self, situation: Situation) -> Rig:
        """Put the parts of the mission into a situation and return them."""
        self.rig.write(situation.facts)
        self._memory.write(situation.tree)
        self.rig.deeds = situation.deeds
        return self.rig

    def path(self, number: int) -> list[Step]:
        """Return the fewest rounds that lead to a situation."""
        steps = []
        while number > 0:
            number, step = self._reached_by[number]
            steps.append(step)
        return steps[::-1]

    def _onward(self, number: int) -> Iterator[Round]:
        """Yield all rounds that may follow a situation.

        Those that lead to the same are given once.
        """
        situation = self.situations[number]
        seen: set[Facts] = set()
        if self.seen[number].has_succeeded:
            return
        for changes, changed in list(self.rig.environment.changes(situation.facts)):
            facts = self._settle(changed, number, Step(changes))
            if facts not in seen:
                seen.add(facts)
                moment = situation._replace(facts=facts)
                if moment not in self._ticks:
                    self._ticks[moment] = list(self._ticked(moment, number, changes))
                for each in self._ticks[moment]:
                    yield each._replace(step=each.step._replace(changes=changes))

    def _ticked(
        self, moment: Situation, number: int, changes: tuple[Change, ...]
    ) -> Iterator[Round]:
        """Yield what may follow a tick in a situation, for every combination of answers."""
        rig = self.rig
        scripts: list[tuple[Answer, ...]] = [()]
        while scripts:
            self.load(moment)
            late = rig.unfeasible
            rig.tick(scripts.pop())
            scripts += rig.others
            step = Step(changes, rig.taken)
            tree = self._memory.read()
            facts = self._settle(rig.read(), number, step)
            self.transitions += 1
            after = self._number(Situation(tree, facts, rig.deeds), number, step)
            yield Round(step, late, after, rig.is_caused)

    def _settle(self, facts: Facts, before: int, step: Step) -> Facts:
        """Let the manager take its turns until it rests; return the facts then."""
        if facts not in self._settled:
            self.rig.write(facts)
            faults = self.rig.settle()
            self._settled[facts] = self.rig.read()
            for fault in faults:
                self.faults.setdefault(fault, [*self.path(before), step])
        return self._settled[facts]

    def _number(self, situation: Situation, before: int, step: Step) -> int:
        number = self._numbers.setdefault(situation, len(self.situations))
        if number < len(self.situations):
            return number
        self.situations.append(situation)
        self.rounds.append([])
        self._reached_by.append((before, step))
        rig = self.load(situation)
        running = [node for node in rig.nodes if node.status is Status.RUNNING]
        steps = [each for each in running if isinstance(each, SequenceNode) and each.memory]
        stage = tuple(each.current_child.name for each in steps if each.current_child)
        feasible = frozenset(name for name in rig.kb.actions if rig.kb.is_feasible(name))
        has_succeeded = rig.root.status is Status.SUCCESS
        self.seen.append(
            Seen(rig.required, rig.unfeasible, feasible, rig.running, stage, has_succeeded)
        )
        for predicate in self._predicates:
            if predicate(rig):
                self.holds[predicate].add(number)
        return number


def _closure(start: Iterable[int], onward: Mapping[int, Iterable[int]]) -> list[int]:
    """Return all numbers that can be reached from some, the nearest first."""
    pending = [*start]
    reached = {*pending}
    for number in pending:
        for after in onward.get(number, ()):
            if after not in reached:
                reached.add(after)
                pending.append(after)
    return pending
