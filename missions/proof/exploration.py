"""The graph of all situations that tree, knowledge base and manager can get into.

In a round a fact changes, the manager takes its turns, the tree is ticked and each leaf answers,
and the manager takes its turns again.
"""

import time
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Sequence, Set
from dataclasses import dataclass, field
from typing import NamedTuple

from py_trees.blackboard import Blackboard
from py_trees.common import Status
from py_trees.composites import Sequence as SequenceNode

from missions.proof.memory import Memory
from missions.proof.rig import Answer, Rig, Step
from missions.proof.setup import Fact, Facts, Setup

State = tuple[bytes, Facts, frozenset[str]]
"""The states of the tree and of the knowledge base, and what was brought about."""


class Round(NamedTuple):
    """A round: what happens, the actions required though unfeasible, and what follows."""

    step: Step
    late: list[str]
    after: "Situation"
    is_caused: bool


@dataclass(eq=False)
class Situation:
    """A situation after a tick, and what properties look at in it.

    Attributes:
        state: of all that it consists of.
        path: the fewest rounds that lead to it.
        required: the actions that are requested.
        feasible: the actions that could be requested.
        running: the actions of behaviours that run.
        stage: where the sequences with memory have got to.
        has_succeeded: whether the root has.
        rounds: all that may follow; empty until it is explored.
    """

    state: State
    path: Sequence[Step]
    required: tuple[str, ...]
    feasible: frozenset[str]
    running: set[str]
    stage: tuple[str, ...]
    has_succeeded: bool
    rounds: list[Round] = field(default_factory=list)

    @property
    def facts(self) -> Facts:
        """What the knowledge base is told and has decided."""
        return self.state[1]


Wrong = tuple[str, Sequence[Step] | None]
"""What is wrong, in words, and the rounds that lead there; None if no single story shows it."""


class Exploration:
    """The situations that were found so far, and the questions about them that properties ask.

    Attributes:
        rig: the parts of the mission; `load` puts them into a situation.
        situations: the initial one first, then those that fewer rounds lead to.
        unexplored: those that were not explored from yet.
        settled: by facts, what is left of them when the manager rests.
        faults: of the manager, in words, each with the fewest rounds that lead there.
        transitions: how many different ticks were run.
        seconds: how long the exploration took [s].
    """

    def __init__(self, setup: Setup) -> None:
        self.rig = rig = Rig(setup)
        self.faults: dict[str, Sequence[Step]] = dict.fromkeys(rig.begin(), ())
        self.situations: list[Situation] = []
        self.unexplored: list[Situation] = []
        self.transitions = 0
        self.seconds = 0.0
        self._memory = Memory([rig.root, Blackboard.storage, rig.senses])
        self._situations: dict[State, Situation] = {}
        self.settled: dict[Facts, Facts] = {}
        self._ticks: dict[State, list[Round]] = {}
        self._situation((self._memory.read(), rig.read(), frozenset()), ())

    def explore(self) -> "Exploration":
        """Explore, breadth first, until all is found, or as long as the setup says.

        Ctrl-C ends it, too.
        """
        begun = time.perf_counter()
        try:
            while self.unexplored and self.seconds <= self.rig.setup.seconds:
                situation = self.unexplored[0]
                situation.rounds = list(self._onward(situation))
                self.unexplored.remove(situation)
                self.seconds = time.perf_counter() - begun
        except KeyboardInterrupt:
            pass
        return self

    @property
    def goals(self) -> set[Situation]:
        """The situations in which the goal is reached."""
        return {each for each in self.situations if each.has_succeeded and not self.misses(each)}

    def misses(self, end: Situation) -> str:
        """Return in words why the success of the root is not that of the mission.

        Empty if it is.
        """
        _, _, deeds = end.state
        for deed in deeds:
            if deed.startswith("the success of "):
                return f"{deed}; write do_until_unfeasible(task, meanwhile)"
        goal = self.rig.setup.goal
        lacking = sorted(effect for effect in goal if f"{effect} done" not in deeds)
        return f"it ends, and nothing has brought about {', '.join(lacking)}" if lacking else ""

    def caused(self) -> list[Situation]:
        """Return what can be reached if nothing succeeds before the deed that brings it about.

        The nearest first.
        """
        onward = ((before, each.after) for before, each in self._caused_rounds())
        return _closure(self.situations[:1], onward)

    def reaching(
        self,
        goals: Iterable[Situation],
        *,
        changes: Collection[Fact | None] | None = None,
        within: Set[Situation] | None = None,
    ) -> set[Situation]:
        """Return the goals, and all from which one can be reached by caused successes.

        Args:
            goals: the situations to reach.
            changes: what may change meanwhile; by default everything.
            within: the situations that may be passed; by default all.
        """
        back = []
        for before, each in self._caused_rounds():
            is_allowed = changes is None or each.step.change in changes
            if is_allowed and (within is None or {before, each.after} <= within):
                back.append((each.after, before))
        return {*_closure(goals, back)}

    def load(self, state: State) -> Rig:
        """Put the parts of the mission into a state and return them."""
        tree, facts, deeds = state
        self.rig.write(facts)
        self._memory.write(tree)
        self.rig.deeds = deeds
        return self.rig

    def _caused_rounds(self) -> Iterator[tuple[Situation, Round]]:
        for situation in self.situations:
            yield from ((situation, each) for each in situation.rounds if each.is_caused)

    def _onward(self, situation: Situation) -> Iterator[Round]:
        """Yield all rounds that may follow a situation.

        Those that lead to the same are given once.
        """
        if situation.has_succeeded:
            return
        tree, present, deeds = situation.state
        seen: set[Facts] = set()
        for change, changed in self.rig.environment.changes(present):
            facts = self._settle(changed, [*situation.path, Step(change)])
            if facts not in seen:
                seen.add(facts)
                state = (tree, facts, deeds)
                if state not in self._ticks:
                    self._ticks[state] = list(self._ticked(state, situation.path, change))
                for each in self._ticks[state]:
                    yield each._replace(step=Step(change, each.step.answers))

    def _ticked(self, state: State, path: Sequence[Step], change: Fact | None) -> Iterator[Round]:
        """Yield what may follow a tick in a state, for every combination of answers."""
        rig = self.rig
        scripts: list[tuple[Answer, ...]] = [()]
        while scripts:
            self.load(state)
            late = [action for action in rig.required if not rig.kb.is_feasible(action)]
            rig.tick(scripts.pop())
            scripts += rig.others
            step = Step(change, rig.taken)
            tree = self._memory.read()
            facts = self._settle(rig.read(), [*path, step])
            self.transitions += 1
            after = self._situation((tree, facts, rig.deeds), [*path, step])
            yield Round(step, late, after, rig.is_caused)

    def _settle(self, facts: Facts, path: Sequence[Step]) -> Facts:
        """Let the manager take its turns until it rests; return the facts then."""
        if facts not in self.settled:
            self.rig.write(facts)
            faults = self.rig.settle()
            self.settled[facts] = self.rig.read()
            for fault in faults:
                self.faults.setdefault(fault, path)
        return self.settled[facts]

    def _situation(self, state: State, path: Sequence[Step]) -> Situation:
        """Return the situation with a state; new ones are added."""
        if state not in self._situations:
            rig = self.load(state)
            running = [node for node in rig.nodes if node.status is Status.RUNNING]
            steps = [each for each in running if isinstance(each, SequenceNode) and each.memory]
            situation = Situation(
                state,
                path,
                required=rig.required,
                feasible=frozenset(name for name in rig.kb.actions if rig.kb.is_feasible(name)),
                running=rig.running,
                stage=tuple(each.current_child.name for each in steps if each.current_child),
                has_succeeded=rig.root.status is Status.SUCCESS,
            )
            self._situations[state] = situation
            self.situations.append(situation)
            self.unexplored.append(situation)
        return self._situations[state]


def _closure(
    start: Iterable[Situation], edges: Iterable[tuple[Situation, Situation]]
) -> list[Situation]:
    """Return all situations that can be reached from some, the nearest first."""
    onward: defaultdict[Situation, list[Situation]] = defaultdict(list)
    for before, after in edges:
        onward[before].append(after)
    reached = dict.fromkeys(start)
    pending = [*reached]
    for situation in pending:
        for after in onward[situation]:
            if after not in reached:
                reached[after] = None
                pending.append(after)
    return pending
