"""Who runs rounds for an exploration: this process alone, or copies of it, each a part of them."""

import multiprocessing
import signal
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from resource import RUSAGE_SELF, getrusage
from typing import Any, Final, NamedTuple

from missions.engine.mission import MissionError
from missions.proof.rounds import Changed, Rounds, Situation, Step

Way = Sequence[tuple[Situation, Step, Situation]]
"""Rounds, one after another, and between which situations they lead."""

CAN_COPY: Final = sys.platform.startswith("linux")
"""Whether a process can begin as a copy of this one: what makes a tree is often something that cannot be sent."""


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


def _answer(rounds: Rounds, job: Job, way: Callable[[int], Way]) -> list[Any]:
    if not rounds.has_been_in(job.moment):
        if not rounds.has_been_in(job.before):
            bring(rounds, way(job.number))
        if job.change is not None:
            _, changes, is_late, _ = job.change
            _same(rounds.change(job.before.known, changes, is_late=is_late), job.change.known)
    return rounds.changes(job.before.known) if job.change is None else rounds.ticks(job.moment)


class Alone:
    """This process; `way` tells how a situation, by number, is reached."""

    megabytes = 0.0

    def __init__(self, rounds: Rounds, way: Callable[[int], Way]) -> None:
        self._rounds, self._way = rounds, way

    def ask(self, jobs: Iterable[Job]) -> list[list[Any]]:
        """Return what is found, for each job `Changed` or `Ticked`."""
        return [_answer(self._rounds, job, self._way) for job in jobs]

    def close(self) -> None: ...


class Workers:
    """Copies of this process, until it is closed.

    Attributes:
        megabytes: the most memory that they have held together; what they share is counted for each [MB].
    """

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

    @property
    def megabytes(self) -> float:
        return sum(self._held)

    def ask(self, jobs: Iterable[Job]) -> list[list[Any]]:
        """Return what is found, for each job `Changed` or `Ticked`; what one finds of a state, it is asked again."""
        places = [(job, job.moment.known % len(self._pipes)) for job in jobs]
        found: list[Iterator[list[Any]]] = []
        try:
            for number, pipe in enumerate(self._pipes):
                part = [job for job, place in places if place == number]
                pipe.send((part, {one: self._way(one) for one in {job.number for job in part}}))
            told = [pipe.recv() for pipe in self._pipes]
        except (EOFError, OSError) as error:
            raise MissionError("a process that explores has died; if memory ran out, use fewer --cores") from error
        self._held = [held for *_, held in told]
        for answers, news, _ in told:
            if isinstance(answers, str):
                raise MissionError(answers)
            self._rounds.hear(news)
            found.append(iter(answers))
        return [next(found[place]) for _, place in places]

    def close(self) -> None:
        for one in self._copies:
            one.kill()
            one.join()


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
                answers = [_answer(rounds, job, ways.__getitem__) for job in jobs]
            except Exception as error:
                answers = str(error) if isinstance(error, MissionError) else f"{type(error).__name__}: {error}"
            pipe.send((answers, rounds.news(), megabytes()))
