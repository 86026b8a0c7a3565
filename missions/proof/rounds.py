"""What may follow a situation, found by running it.

A round is what happens around the robot, the manager's turns, a tick in which each leaf answers, and the manager's
turns again. What facts and the manager make of what is known does not depend on the tree, so it is found once for each
state of the knowledge base; a tick is run in each state of both, for all answers. That is done by this process alone,
or by copies of it, each a part.
"""

import multiprocessing
import signal
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import islice
from multiprocessing.connection import Connection
from resource import RUSAGE_SELF, getrusage
from typing import Any, Final, NamedTuple

from py_trees.blackboard import Blackboard
from py_trees.common import Status

from missions.engine.mission import MissionError
from missions.proof.leaves import Answer
from missions.proof.memory import Memory, said
from missions.proof.planned import nodes, stage_of
from missions.proof.rig import Predicate, Rig, Setup
from missions.proof.surroundings import Change
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


class Ticked(NamedTuple):
    """The situation after a tick, and what was wrong about what the manager did, in words."""

    after: Situation
    answers: tuple[Answer, ...]
    is_late: bool
    faults: tuple[str, ...]


class Rounds:
    """Runs rounds in any situation that it has been in.

    Attributes:
        rig: the parts of the mission; `load` puts them into a situation.
        first: the situation in the beginning.
        is_slow: whether the manager may miss its turn.
        faults: what was wrong about what the manager did in the beginning, in words.
        known, doing: what matters of states, by their keys.
        holds: by situation, which of the predicates hold in it.
    """

    def __init__(self, setup: Setup, predicates: Sequence[Predicate] = ()) -> None:
        self.rig = rig = Rig(setup)
        self.is_slow, self._predicates, self.faults = setup.slow, predicates, rig.begin()
        self._known = Memory([rig.kb, rig.planner], parameters=bool(setup.planner or predicates))
        self._tree = Memory(
            [rig.root, Blackboard.storage, *kept(rig.tape.kb)], apart=[rig.kb, rig.planner, rig.choices]
        )
        self.known: dict[int, Known] = {}
        self.doing: dict[int, Doing] = {}
        self.holds: dict[Situation, tuple[bool, ...]] = {}
        self._settled: dict[int, tuple[int, tuple[str, ...]]] = {}
        self._sent = [0, 0, 0]
        self._nodes = nodes(rig.root)
        self.first = Situation(self._tree.read(), self._known.read())
        self._describe(self.first)

    def has_been_in(self, situation: Situation) -> bool:
        """Tell whether these states of tree and knowledge base were there, together or apart."""
        return situation.tree in self._tree and situation.known in self._known

    def load(self, situation: Situation) -> Rig:
        """Put the parts of the mission into a situation and return them."""
        self._known.write(situation.known)
        self._tree.write(situation.tree)
        return self.rig

    def news(self, *, of_all: bool = False) -> tuple[list[dict[Any, Any]], list[int]]:
        """Return what has been noted of states since the last time, or ever, and which nodes were ticked, by place."""
        noted: list[dict[Any, Any]] = [self.known, self.doing, self.holds]
        if of_all:
            self._sent = [0, 0, 0]
        new = [dict(islice(one.items(), count, None)) for one, count in zip(noted, self._sent, strict=True)]
        self._sent = [len(one) for one in noted]
        return new, [place for place, one in enumerate(self._nodes) if one in self.rig.ticked]

    def hear(self, news: tuple[list[dict[Any, Any]], list[int]]) -> None:
        """Note what another has noted."""
        (known, doing, holds), ticked = news
        self.known |= known
        self.doing |= doing
        self.holds |= holds
        self.rig.ticked.update(self._nodes[place] for place in ticked)

    def run(self, before: Situation, step: Step) -> Situation:
        """Return where one round leads."""
        moment = self.change(before.known, step.changes, is_late=step.late[0])
        after = self._outcome(Situation(before.tree, moment), step.answers)
        return after if step.late[1] else Situation(after.tree, self._settle(after.known)[0])

    def change(self, known: int, changes: tuple[Change, ...], *, is_late: bool) -> int:
        """Return what is known after changes of facts."""
        told = self._told(known, changes)
        return told if is_late else self._settle(told)[0]

    def changes(self, known: int) -> list[Changed]:
        """Return what can be known next, each once, with and without the manager's turn."""
        self._known.write(known)
        reached: dict[int, Changed] = {}
        for changes in list(self.rig.surroundings.changes()):
            told = self._told(known, changes)
            settled, faults = self._settle(told)
            reached.setdefault(settled, Changed(settled, changes, False, faults))
            if self.is_slow:
                reached.setdefault(told, Changed(told, changes, True, ()))
        for one in reached:
            self._describe_known(one)
        return list(reached.values())

    def ticks(self, moment: Situation) -> list[Ticked]:
        """Return what a tick in a moment comes to, with every combination of answers."""
        found: list[Ticked] = []
        for after, answers in self._outcomes(moment):
            settled, faults = self._settle(after.known)
            for known in dict.fromkeys((settled, after.known) if self.is_slow else (settled,)):
                found.append(Ticked(Situation(after.tree, known), answers, known != settled, faults))
                self._describe(found[-1].after)
        return found

    def _outcomes(self, moment: Situation) -> Iterator[tuple[Situation, tuple[Answer, ...]]]:
        """Yield the situations after a tick, before the manager's turn, for all answers."""
        scripts: list[tuple[Answer, ...]] = [()]
        while scripts:
            after = self._outcome(moment, scripts.pop())
            scripts += self.rig.choices.others
            yield after, tuple(self.rig.choices.taken)

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

    def _describe(self, situation: Situation) -> None:
        """Note what matters of a situation, if it is new."""
        tree, rig = situation.tree, self.rig
        self._describe_known(situation.known)
        if tree not in self.doing:
            self._tree.write(tree)
            running = frozenset(one.action for one in rig.doing if one.status is Status.RUNNING)
            is_over = rig.root.status is Status.SUCCESS or getattr(rig.root, "final_status", None) is not None
            self.doing[tree] = Doing(rig.root.status.name, running, said(stage_of(rig.root)), is_over)
        if self._predicates and situation not in self.holds:
            self.holds[situation] = tuple([bool(one(self.load(situation))) for one in self._predicates])

    def _describe_known(self, known: int) -> None:
        if known in self.known:
            return
        self._known.write(known)
        rig, kb = self.rig, self.rig.kb
        chosen = [one for table in (kb.designs, kb.configurations) for one in table.values() if one.is_selected]
        occurring = [("action", one) for one in rig.required] + [(one.node.kind, one.name) for one in chosen]
        attributes = [kb.attributes[name] for name in rig.surroundings.values]
        values = tuple((one.name, "stale" if one.is_stale else one.value) for one in attributes)
        failed = rig.surroundings.failed()
        feasible = tuple(kb.selectable_actions())
        self.known[known] = Known(rig.required, rig.unfeasible, frozenset(occurring), failed, values, feasible)


class Job(NamedTuple):
    """What is to be found: what can be known next, or what a tick comes to after a change.

    Attributes:
        number: of the situation before.
        before: it.
        change: that is followed by a tick; None to find the changes.
    """

    number: int
    before: Situation
    change: Changed | None = None

    @property
    def moment(self) -> Situation:
        """Where it begins."""
        return self.before if self.change is None else Situation(self.before.tree, self.change.known)


def megabytes() -> float:
    """Return the most memory that this process has held [MB]."""
    return getrusage(RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)


def bring(rounds: Rounds, way: Way) -> None:
    """Have been where rounds lead that were run before, here or elsewhere.

    Raises:
        MissionError: they lead elsewhere now.
    """
    last = max((place for place, (_, _, after) in enumerate(way, start=1) if rounds.has_been_in(after)), default=0)
    for before, step, after in way[last:]:
        _same(rounds.run(before, step), after)


def _same(found: object, expected: object) -> None:
    if found != expected:
        why = "it has been changed, or it decides by chance or by the time of day"
        raise MissionError(f"the same round does not lead to the same situation again: {why}")


def answered(rounds: Rounds, way: Callable[[int], Way], jobs: Iterable[Job]) -> list[list[Any]]:
    """Return what is found here, for each job `Changed` or `Ticked`; `way` tells how a situation is reached."""
    return [_answer(rounds, job, way) for job in jobs]


def _answer(rounds: Rounds, job: Job, way: Callable[[int], Way]) -> list[Any]:
    if not rounds.has_been_in(job.moment):
        if not rounds.has_been_in(job.before):
            bring(rounds, way(job.number))
        if job.change is not None:
            _, changes, is_late, _ = job.change
            _same(rounds.change(job.before.known, changes, is_late=is_late), job.change.known)
    return rounds.changes(job.before.known) if job.change is None else rounds.ticks(job.moment)


class Workers:
    """Copies of this process, until it is closed."""

    def __init__(self, rounds: Rounds, way: Callable[[int], Way], count: int) -> None:
        self._rounds, self._way, self._held = rounds, way, [0.0] * count
        context = multiprocessing.get_context("fork")
        pipes = [context.Pipe() for _ in range(count)]
        self._pipes, ends = [ours for ours, _ in pipes], [end for pipe in pipes for end in pipe]
        self._copies = [context.Process(target=_work, args=(rounds, theirs, ends), daemon=True) for _, theirs in pipes]
        with warnings.catch_warnings(action="ignore", category=DeprecationWarning):  # of threads, which a copy lacks
            for one in self._copies:
                one.start()
        for _, theirs in pipes:  # held by the copies alone: who waits for one that has died hears of it
            theirs.close()

    def ask(self, jobs: Iterable[Job]) -> list[list[Any]]:
        """Return what is found, for each job `Changed` or `Ticked`; what one finds of a state, it is asked again."""
        places = [(job, job.moment.known % len(self._pipes)) for job in jobs]
        found: list[Iterator[list[Any]]] = []
        try:
            for number, pipe in enumerate(self._pipes):
                part = [job for job, place in places if place == number]
                pipe.send((part, {one: self._way(one) for one in {job.number for job in part}}))
            heard = [pipe.recv() for pipe in self._pipes]
        except (EOFError, OSError) as error:
            raise MissionError("a process that explores has died; if memory ran out, use fewer --cores") from error
        self._held = [held for *_, held in heard]
        for answers, news, _ in heard:
            if isinstance(answers, str):
                raise MissionError(answers)
            self._rounds.hear(news)
            found.append(iter(answers))
        return [next(found[place]) for _, place in places]

    def close(self) -> float:
        """End them, and return the most memory that they have held together; what they share counts for each [MB]."""
        for one in self._copies:
            one.kill()
            one.join()
        return sum(self._held)


def _work(rounds: Rounds, pipe: Connection, ends: Iterable[Connection]) -> None:
    """Answer until nobody asks any more: whoever holds an end keeps the one who waits at the other from knowing."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who has asked is interrupted, and ends this one
    for one in ends:
        if one is not pipe:
            one.close()
    with suppress(EOFError, OSError):
        while True:
            jobs, ways = pipe.recv()
            answers: list[list[Any]] | str
            try:
                answers = answered(rounds, ways.__getitem__, jobs)
            except Exception as error:
                answers = str(error) if isinstance(error, MissionError) else f"{type(error).__name__}: {error}"
            pipe.send((answers, rounds.news(), megabytes()))
