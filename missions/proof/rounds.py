"""Find what may follow a situation by running it: one round after another.

In a round some facts change, the manager takes its turns, the tree is ticked and each leaf answers, and the manager
takes its turns again. The facts and the manager do not depend on the tree, so their part is run once for each state of
the knowledge base. The tick is run for each pair of states of tree and knowledge base, with all answers of the leaves.
This process does all of it, or forked copies of it share the work.
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
from missions.proof.rig import Change, Predicate, Rig, Setup, nodes, stage_of
from missions.proof.tape import Answer
from rosa_bt.requests import requests_of

CAN_COPY: Final = sys.platform.startswith("linux")
"""Whether this process can be forked. The functions that build a tree often cannot be sent to another process."""


class Known(NamedTuple):
    """The part of a state of the knowledge base that the properties look at."""

    required: tuple[str, ...]
    unfeasible: tuple[str, ...]  # required although unfeasible
    occurring: frozenset[tuple[str, str]]  # kind and name of what is selected or required
    failed: tuple[str, ...]
    values: tuple[tuple[str, float | str | None], ...]
    feasible: tuple[str, ...]  # of all actions


class Doing(NamedTuple):
    """The part of the state of a tree after a tick that the properties look at."""

    status: str
    running: frozenset[str]  # the actions of its running behaviours
    stage: str  # the current child of each sequence with memory, and what plan executors believe
    is_over: bool  # the root has succeeded, or a OneShot there has ended


class Step(NamedTuple):
    """A round: changes, answers of leaves, and whether the manager misses its turn before and after the tick."""

    changes: tuple[Change, ...] = ()
    answers: tuple[Answer, ...] = ()
    late: tuple[bool, bool] = (False, False)


class Situation(NamedTuple):
    """The keys of a state of the tree and of one of the knowledge base: after a round, or just before its tick."""

    tree: int
    known: int


Way = Sequence[tuple[Situation, Step, Situation]]
"""Consecutive rounds, each with the situation before and after it."""


class Changed(NamedTuple):
    """The state of the knowledge base after changes, and the faults of the manager on the way, in words."""

    known: int
    changes: tuple[Change, ...]
    is_late: bool
    faults: tuple[str, ...]
    facts: Known


class Seen(NamedTuple):
    """The parts of a situation that the properties look at, and which of the predicates hold in it."""

    doing: Doing
    facts: Known
    holds: tuple[bool, ...]


class Ticked(NamedTuple):
    """The situation after a tick, and the faults of the manager after it, in words."""

    after: Situation
    answers: tuple[Answer, ...]
    is_late: bool
    faults: tuple[str, ...]
    seen: Seen


Onward = list[tuple[Changed, list[Ticked]]]
"""All that may follow a situation: each change of facts, with all outcomes of the tick after it."""


News = tuple[Sequence[dict[Any, Any]], list[int]]
"""New entries for `Rounds.found`, and the indices of the nodes of the tree that were ticked."""


class Rounds:
    """Runs rounds from any situation that it has visited, and keeps their results.

    Attributes:
        rig: the parts of the mission; `load` puts them into a situation.
        first: the initial situation.
        is_slow: whether the manager may miss its turn.
        faults: of the manager before the first tick, in words.
        found: the changes that may follow, by state of the knowledge base; the ticks that may follow, by situation.
    """

    def __init__(self, setup: Setup, predicates: Sequence[Predicate] = ()) -> None:
        self.rig = rig = Rig(setup)
        self.is_slow, self._predicates, self.faults = setup.slow, predicates, rig.begin()
        self._known = Memory([rig.kb, rig.planner], parameters=bool(setup.planner or predicates))
        requests = requests_of(rig.tape.kb)
        for action in rig.tape.kb.actions:
            requests.requesters.setdefault(action, {})
        tables = [requests.requesters, requests.halting, requests.progress]
        self._tree = Memory(
            [rig.root, Blackboard.storage, *tables],
            apart=[rig.kb, rig.planner, rig.choices],
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
        """Return whether both states were visited here, together or apart, so that they can be restored."""
        return situation.tree in self._tree and situation.known in self._known

    def load(self, situation: Situation) -> Rig:
        """Put the parts of the mission into a situation and return them."""
        self._known.write(situation.known)
        self._tree.write(situation.tree)
        return self.rig

    @property
    def ticked(self) -> list[int]:
        """The indices of the nodes that were ever ticked."""
        return [place for place, one in enumerate(self._nodes) if one in self.rig.ticked]

    def news(self) -> News:
        """Return what was found since the last call, and which nodes were ever ticked."""
        new = [
            dict(islice(one.items(), sent, None))
            for one, sent in zip(self.found, self._sent, strict=True)
        ]
        self._sent = [len(one) for one in self.found]
        return new, self.ticked

    def hear(self, news: News) -> None:
        """Take over what another process has found."""
        for mine, theirs in zip(self.found, news[0], strict=True):
            mine.update(theirs)
        self.rig.ticked.update(self._nodes[place] for place in news[1])

    def bring(self, way: Way) -> Situation:
        """Run the rounds of a way that were not run in this process, and return the situation at its end.

        Raises:
            MissionError: a round leads to another situation than before.
        """
        places = range(len(way), 0, -1)
        last = next((place for place in places if self.has_been_in(way[place - 1][2])), 0)
        for before, step, after in way[last:]:
            _check(self.run(before, step) == after)
        return way[-1][2] if way else self.first

    def onward(self, way: Way) -> Onward:
        """Return all that may follow the situation at the end of a way."""
        tree, known = way[-1][2] if way else self.first
        if known not in self._changes:
            self.bring(way)
        found = []
        for change in self.changes(known):
            moment = Situation(tree, change.known)
            if moment not in self._ticks and not self.has_been_in(
                moment
            ):  # another process found the change
                self.run(self.bring(way), Step(change.changes, late=(change.is_late, False)))
                _check(self.has_been_in(moment))
            found.append((change, self.ticks(moment)))
        return found

    def run(self, before: Situation, step: Step) -> Situation:
        """Run one round and return the situation after it."""
        told = self._told(before.known, step.changes)
        moment = told if step.late[0] else self._settle(told)[0]
        after = self._outcome(Situation(before.tree, moment), step.answers)
        return after if step.late[1] else Situation(after.tree, self._settle(after.known)[0])

    def changes(self, known: int) -> list[Changed]:
        """Return the states of the knowledge base after changes, each once; if slow, also those without a turn."""
        if known in self._changes:
            return self._changes[known]
        self._known.write(known)
        reached: dict[int, Changed] = {}
        for changes in list(self.rig.surroundings.changes()):
            told = self._told(known, changes)
            settled, faults = self._settle(told)
            for now, is_late in (
                ((settled, False), (told, True)) if self.is_slow else ((settled, False),)
            ):
                if now not in reached:
                    reached[now] = Changed(
                        now, changes, is_late, () if is_late else faults, self._facts_of(now)
                    )
        return self._changes.setdefault(known, list(reached.values()))

    def ticks(self, moment: Situation) -> list[Ticked]:
        """Return the outcomes of a tick in a situation, one for every combination of answers."""
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
        """Let the manager take its turns until it rests; return the state then, and its faults."""
        found = self._settled.get(known)
        if found is None:
            self._known.write(known)
            faults = self.rig.settle(
                lambda: self._settled.get(now := self._known.read(), ("",))[0] == now
            )
            found = self._settled[known] = self._known.read(), faults
            self._settled.setdefault(found[0], (found[0], ()))
        return found

    def seen(self, situation: Situation) -> Seen:
        """Return what the properties look at, of a situation that was visited."""
        if situation not in self._seen:
            doing, facts = self._doing_of(situation.tree), self._facts_of(situation.known)
            holds = tuple([bool(one(self.load(situation))) for one in self._predicates])
            self._seen[situation] = Seen(doing, facts, holds)
        return self._seen[situation]

    def _doing_of(self, tree: int) -> Doing:
        if tree not in self._doing:
            self._tree.write(tree)
            root = self.rig.root
            running = frozenset(
                one.action for one in self.rig.doing if one.status is Status.RUNNING
            )
            is_over = (
                root.status is Status.SUCCESS or getattr(root, "final_status", None) is not None
            )
            self._doing[tree] = Doing(root.status.name, running, said(stage_of(root)), is_over)
        return self._doing[tree]

    def _facts_of(self, known: int) -> Known:
        if known not in self._facts:
            self._known.write(known)
            rig, kb = self.rig, self.rig.kb
            chosen = [
                one
                for table in (kb.designs, kb.configurations)
                for one in table.values()
                if one.is_selected
            ]
            occurring = [("action", one) for one in rig.required] + [
                (one.node.kind, one.name) for one in chosen
            ]
            attributes = [kb.attributes[name] for name in rig.surroundings.values]
            values = tuple((one.name, "stale" if one.is_stale else one.value) for one in attributes)
            failed, feasible = rig.surroundings.failed(), tuple(kb.selectable_actions())
            self._facts[known] = Known(
                rig.required, rig.unfeasible, frozenset(occurring), failed, values, feasible
            )
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
    """Forked copies of this process, until `close`; each is always asked about the same states of the tree."""

    def __init__(self, rounds: Rounds, count: int) -> None:
        self._rounds, context = rounds, multiprocessing.get_context("fork")
        self._copies = [
            ProcessPoolExecutor(1, context, _begin, (rounds, os.getpid())) for _ in range(count)
        ]

    def explore(self, ways: Sequence[Way]) -> None:
        """Let the copies find all that may follow the situations at the ends of these ways."""
        parts: list[list[Way]] = [[] for _ in self._copies]
        for way in ways:
            parts[way[-1][2].tree % len(parts) if way else 0].append(way)
        try:
            with warnings.catch_warnings(
                action="ignore", category=DeprecationWarning
            ):  # fork with threads: the copies use none of them
                asked = [
                    copy.submit(_found, part)
                    for copy, part in zip(self._copies, parts, strict=True)
                ]
            for one in asked:
                self._rounds.hear(one.result())
        except BrokenProcessPool as error:
            raise MissionError(
                "a process that explores has died; if memory ran out, use fewer --cores"
            ) from error

    def close(self) -> None:
        for one in self._copies:
            one.shutdown(cancel_futures=True)


_copied: list[Rounds] = []
"""In a forked copy: what it explores with."""


def _begin(rounds: Rounds, parent: int) -> None:
    """Set up a forked copy: it ignores Ctrl-C, and ends when its parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    rounds.news()
    _copied.append(rounds)
    end_with(parent)


def _found(ways: Sequence[Way]) -> News:
    rounds = _copied[-1]
    try:
        for way in ways:
            rounds.onward(way)
    except Exception as error:  # some exceptions cannot be sent to the parent
        text = f"{type(error).__name__}: {error}"
        raise MissionError(str(error) if isinstance(error, MissionError) else text) from None
    return rounds.news()
