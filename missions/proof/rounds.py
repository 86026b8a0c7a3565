"""What may follow a situation, found by running it.

A round is what happens around the robot, the manager's turns, a tick in which each leaf answers, and the manager's
turns again. What facts and the manager make of what is known does not depend on the tree, so it is found once for each
state of the knowledge base; a tick is run in each state of both, for all answers. That is done by this process alone,
or by copies of it, each a part.
"""

import multiprocessing
import os
import signal
import sys
import warnings
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from resource import RUSAGE_CHILDREN, RUSAGE_SELF, getrusage
from typing import Any, Final, NamedTuple

from py_trees.blackboard import Blackboard
from py_trees.common import Status

from missions.engine.mission import MissionError
from missions.experiments.workers import end_with
from missions.proof.memory import Memory, said
from missions.proof.planned import nodes, stage_of
from missions.proof.rig import Predicate, Rig, Setup
from missions.proof.surroundings import Answer, Change
from rosa_bt.behaviours import kept

CAN_COPY: Final = sys.platform.startswith("linux")
"""Whether a process can begin as a copy of this one: what makes a tree is often something that cannot be sent."""


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

    status: str
    running: frozenset[str]  # the actions of its behaviours that run
    stage: str  # where the sequences that remember it have got to, and what plans believe
    is_over: bool  # it has succeeded, or ended for good


class Step(NamedTuple):
    """A round: what changes, what leaves answer, and whether the manager misses its turn before and after the tick."""

    changes: tuple[Change, ...] = ()
    answers: tuple[Answer, ...] = ()
    late: tuple[bool, bool] = (False, False)


class Situation(NamedTuple):
    """Keys of the states of tree and knowledge base: after a round, or after changes and before a tick."""

    tree: int
    known: int


Way = Sequence[tuple[Situation, Step, Situation]]
"""Rounds, one after another, and between which situations they lead."""


class Changed(NamedTuple):
    """What is known after changes, and what was wrong about what the manager did, in words."""

    known: int
    changes: tuple[Change, ...]
    is_late: bool
    faults: tuple[str, ...]
    facts: Known


class Seen(NamedTuple):
    """What matters of a situation: of its tree and its knowledge base, and which of the predicates hold in it."""

    doing: Doing
    facts: Known
    holds: tuple[bool, ...]


class Ticked(NamedTuple):
    """The situation after a tick, and what was wrong about what the manager did, in words."""

    after: Situation
    answers: tuple[Answer, ...]
    is_late: bool
    faults: tuple[str, ...]
    seen: Seen


Onward = list[tuple[Changed, list[Ticked]]]
"""What may follow a situation: what can be known next, each with what a tick comes to then."""


News = tuple[Sequence[dict[Any, Any]], list[int]]
"""What was found of states and moments, by their keys, and which nodes of the tree were ticked, by their places."""


class Rounds:
    """Runs rounds in any situation that it has been in.

    Attributes:
        rig: the parts of the mission; `load` puts them into a situation.
        first: the situation in the beginning.
        is_slow: whether the manager may miss its turn.
        faults: what was wrong about what the manager did in the beginning, in words.
        found: by what is known which changes may follow, and by moment which ticks.
    """

    def __init__(self, setup: Setup, predicates: Sequence[Predicate] = ()) -> None:
        self.rig = rig = Rig(setup)
        self.is_slow, self._predicates, self.faults = setup.slow, predicates, rig.begin()
        self._known = Memory([rig.kb, rig.planner], parameters=bool(setup.planner or predicates))
        self._tree = Memory(
            [rig.root, Blackboard.storage, *kept(rig.tape.kb)], apart=[rig.kb, rig.planner, rig.choices]
        )
        self._facts: dict[int, Known] = {}
        self._doing: dict[int, Doing] = {}
        self._seen: dict[Situation, Seen] = {}
        self._settled: dict[int, tuple[int, tuple[str, ...]]] = {}
        self._changes: dict[int, list[Changed]] = {}
        self._ticks: dict[Situation, list[Ticked]] = {}
        self.found: tuple[dict[Any, Any], ...] = self._changes, self._ticks
        self._sent = [0, 0]
        self._nodes = nodes(rig.root)
        self.first = Situation(self._tree.read(), self._known.read())

    def has_been_in(self, situation: Situation) -> bool:
        """Tell whether these states of tree and knowledge base were there, together or apart."""
        return situation.tree in self._tree and situation.known in self._known

    def load(self, situation: Situation) -> Rig:
        """Put the parts of the mission into a situation and return them."""
        self._known.write(situation.known)
        self._tree.write(situation.tree)
        return self.rig

    @property
    def ticked(self) -> list[int]:
        """The nodes that were ever ticked, by their places."""
        return [place for place, one in enumerate(self._nodes) if one in self.rig.ticked]

    def news(self) -> News:
        """Return what was found since the last time, and which nodes were ever ticked."""
        new = [dict(islice(one.items(), sent, None)) for one, sent in zip(self.found, self._sent, strict=True)]
        self._sent = [len(one) for one in self.found]
        return new, self.ticked

    def hear(self, news: News) -> None:
        """Take over what another has found."""
        for mine, theirs in zip(self.found, news[0], strict=True):
            mine.update(theirs)
        self.rig.ticked.update(self._nodes[place] for place in news[1])

    def bring(self, way: Way) -> Situation:
        """Have been where rounds lead that were run before, here or elsewhere, and return it.

        Raises:
            MissionError: they lead elsewhere now.
        """
        places = range(len(way), 0, -1)
        last = next((place for place in places if self.has_been_in(way[place - 1][2])), 0)
        for before, step, after in way[last:]:
            _check(self.run(before, step) == after)
        return way[-1][2] if way else self.first

    def onward(self, way: Way) -> Onward:
        """Return what may follow the situation to which rounds lead."""
        tree, known = way[-1][2] if way else self.first
        if known not in self._changes:
            self.bring(way)
        found = []
        for change in self.changes(known):
            moment = Situation(tree, change.known)
            if moment not in self._ticks and not self.has_been_in(moment):  # another has found the change
                self.run(self.bring(way), Step(change.changes, late=(change.is_late, False)))
                _check(self.has_been_in(moment))
            found.append((change, self.ticks(moment)))
        return found

    def run(self, before: Situation, step: Step) -> Situation:
        """Return where one round leads."""
        told = self._told(before.known, step.changes)
        moment = told if step.late[0] else self._settle(told)[0]
        after = self._outcome(Situation(before.tree, moment), step.answers)
        return after if step.late[1] else Situation(after.tree, self._settle(after.known)[0])

    def changes(self, known: int) -> list[Changed]:
        """Return what can be known next, each once, with and without the manager's turn."""
        if known in self._changes:
            return self._changes[known]
        self._known.write(known)
        reached: dict[int, Changed] = {}
        for changes in list(self.rig.surroundings.changes()):
            told = self._told(known, changes)
            settled, faults = self._settle(told)
            for now, is_late in ((settled, False), (told, True)) if self.is_slow else ((settled, False),):
                if now not in reached:
                    reached[now] = Changed(now, changes, is_late, () if is_late else faults, self._facts_of(now))
        return self._changes.setdefault(known, list(reached.values()))

    def ticks(self, moment: Situation) -> list[Ticked]:
        """Return what a tick in a moment comes to, with every combination of answers."""
        if moment in self._ticks:
            return self._ticks[moment]
        found: list[Ticked] = []
        scripts: list[tuple[Answer, ...]] = [()]
        while scripts:
            after = self._outcome(moment, scripts.pop())
            scripts += self.rig.choices.others
            answers = tuple(self.rig.choices.taken)
            settled, faults = self._settle(after.known)
            for known in dict.fromkeys((settled, after.known) if self.is_slow else (settled,)):
                reached = Situation(after.tree, known)
                found.append(Ticked(reached, answers, known != settled, faults, self.seen(reached)))
        return self._ticks.setdefault(moment, found)

    def _outcome(self, moment: Situation, script: tuple[Answer, ...]) -> Situation:
        rig = self.rig
        rig.choices.begin(script)
        after = rig.tape.follow(*moment, self._known)
        if after is None:
            self.load(moment)
            rig.choices.begin(script)
            rig.runner.tick()
            after = self._tree.read(), self._known.read()
            rig.tape.keep(moment.tree, after[0])
        return Situation(*after)

    def _told(self, known: int, changes: tuple[Change, ...]) -> int:
        self._known.write(known)
        for change in changes:
            change.tell(self.rig.kb)
        return self._known.read()

    def _settle(self, known: int) -> tuple[int, tuple[str, ...]]:
        """Return what is known when the manager has nothing to do any more, and what was wrong about that."""
        found = self._settled.get(known)
        if found is None:
            self._known.write(known)
            faults = self.rig.settle(lambda: self._settled.get(now := self._known.read(), ("",))[0] == now)
            found = self._settled[known] = self._known.read(), faults
            self._settled.setdefault(found[0], (found[0], ()))
        return found

    def seen(self, situation: Situation) -> Seen:
        """Return what matters of a situation that was there."""
        if situation not in self._seen:
            doing, facts = self._doing_of(situation.tree), self._facts_of(situation.known)
            holds = tuple([bool(one(self.load(situation))) for one in self._predicates])
            self._seen[situation] = Seen(doing, facts, holds)
        return self._seen[situation]

    def _doing_of(self, tree: int) -> Doing:
        if tree not in self._doing:
            self._tree.write(tree)
            root = self.rig.root
            running = frozenset(one.action for one in self.rig.doing if one.status is Status.RUNNING)
            is_over = root.status is Status.SUCCESS or getattr(root, "final_status", None) is not None
            self._doing[tree] = Doing(root.status.name, running, said(stage_of(root)), is_over)
        return self._doing[tree]

    def _facts_of(self, known: int) -> Known:
        if known not in self._facts:
            self._known.write(known)
            rig, kb = self.rig, self.rig.kb
            chosen = [one for table in (kb.designs, kb.configurations) for one in table.values() if one.is_selected]
            occurring = [("action", one) for one in rig.required] + [(one.node.kind, one.name) for one in chosen]
            attributes = [kb.attributes[name] for name in rig.surroundings.values]
            values = tuple((one.name, "stale" if one.is_stale else one.value) for one in attributes)
            failed, feasible = rig.surroundings.failed(), tuple(kb.selectable_actions())
            self._facts[known] = Known(rig.required, rig.unfeasible, frozenset(occurring), failed, values, feasible)
        return self._facts[known]


def _check(is_same: bool) -> None:
    if not is_same:
        why = "it has been changed, or it decides by chance or by the time of day"
        raise MissionError(f"the same round does not lead to the same situation again: {why}")


def megabytes() -> float:
    """Return the most memory that this process has held, or one that it has begun and that has ended [MB]."""
    most = max(getrusage(who).ru_maxrss for who in (RUSAGE_SELF, RUSAGE_CHILDREN))
    return most / (1e6 if sys.platform == "darwin" else 1e3)


class Workers:
    """Copies of this process, until it is closed; what one finds of a tree in a state, it is asked again."""

    def __init__(self, rounds: Rounds, count: int) -> None:
        self._rounds, context = rounds, multiprocessing.get_context("fork")
        self._copies = [ProcessPoolExecutor(1, context, _begin, (rounds, os.getpid())) for _ in range(count)]

    def explore(self, ways: Sequence[Way]) -> None:
        """Have found what may follow the situations to which rounds lead."""
        parts: list[list[Way]] = [[] for _ in self._copies]
        for way in ways:
            parts[way[-1][2].tree % len(parts) if way else 0].append(way)
        try:
            with warnings.catch_warnings(action="ignore", category=DeprecationWarning):  # of threads: a copy has none
                asked = [copy.submit(_found, part) for copy, part in zip(self._copies, parts, strict=True)]
            for one in asked:
                self._rounds.hear(one.result())
        except BrokenProcessPool as error:
            raise MissionError("a process that explores has died; if memory ran out, use fewer --cores") from error

    def close(self) -> None:
        for one in self._copies:
            one.shutdown(cancel_futures=True)


_copied: list[Rounds] = []
"""In a copy of a process, what it explores."""


def _begin(rounds: Rounds, parent: int) -> None:
    """Begin as a copy, which is not interrupted, and ends when the process is gone that began it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    rounds.news()
    _copied.append(rounds)
    end_with(parent)


def _found(ways: Sequence[Way]) -> News:
    rounds = _copied[-1]
    try:
        for way in ways:
            rounds.onward(way)
    except Exception as error:  # of which not all can be sent
        text = f"{type(error).__name__}: {error}"
        raise MissionError(str(error) if isinstance(error, MissionError) else text) from None
    return rounds.news()
