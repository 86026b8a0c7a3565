"""Every situation that a tree, its knowledge base and the manager can get into, found by running them."""

import gc
import gzip
import io
import json
import os
import pickle
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from missions.engine.mission import MissionError
from missions.proof.rig import Predicate, Rig, Setup
from missions.proof.rounds import (
    CAN_COPY,
    Changed,
    Doing,
    Job,
    Known,
    Rounds,
    Situation,
    Step,
    Ticked,
    Way,
    Workers,
    answered,
    bring,
    megabytes,
)
from missions.proof.surroundings import Change

_AT_A_TIME: Final = 32
"""So many situations each of several processes goes on from before it is looked whether there is time for more."""

_ALONE_S: Final = 1.0
"""For so long one process explores: most missions are known then [s]."""

_PARTS: Final = (Situation, Step, Change, Changed, Ticked, Known, Doing, frozenset)

Wrong = tuple[str, Sequence[Step] | None]
"""What is wrong, in words, and the rounds that lead there, if a story shows it."""


class Exploration:
    """All situations that can be reached, as far as they were found, with the questions that properties ask of them.

    Args:
        setup: what is explored.
        predicates: of which it is noted where they hold.
        goal: what the mission is to reach; by default that its root succeeds.

    Attributes:
        rig: the parts of the mission; `load` puts them into a situation.
        situations: by number, that in the beginning first, then by the fewest rounds that lead there.
        states: by number, what matters of its tree and of its knowledge base.
        count: how many of them it is known of what follows, the first ones.
        ticks: by moment, what may follow.
        known, doing: what matters of states, by their keys.
        faults: of the manager, in words, with the rounds that lead there first.
        holds: by predicate, in which situations it does.
        transitions: how many changes and ticks were found.
        seconds: how long it took [s].
        megabytes: the most memory that was held when it ended, by all processes together [MB].
    """

    def __init__(self, setup: Setup, predicates: Sequence[Predicate] = (), goal: Predicate | None = None) -> None:
        predicates, self._goal = [*predicates, *filter(None, [goal])], goal
        self._rounds = rounds = Rounds(setup, predicates)
        self.rig, self.known, self.doing = rounds.rig, rounds.known, rounds.doing
        self.faults = {fault: list[Step]() for fault in rounds.faults}
        self.situations: list[Situation] = []
        self.states: list[tuple[Doing, Known]] = []
        self.count = 0
        self.ticks: dict[Situation, list[Ticked]] = {}
        self._steps: list[tuple[int, Step]] = []
        self._numbers: dict[Situation, int] = {}
        self.holds: dict[Predicate, set[int]] = {one: set() for one in predicates}
        self._changed: dict[int, list[Changed]] = {}
        self._ticked: set[Situation] = set()
        self.transitions, self.seconds, self.megabytes = 0, 0.0, 0.0
        self._is_stopped = False
        sources = [Path(getattr(one, "__file__", None) or "") for one in [*sys.modules.values()]]
        self._newest = max(one.stat().st_mtime_ns for one in sources if one.suffix == ".py" and one.is_file())
        self._reach(rounds.first, -1, Step())

    def explore(self, most: int = 100_000, seconds: float = 60.0, cores: int | None = None) -> "Exploration":
        """Find what can be reached; called again, it goes on.

        Args:
            most: so many situations, about.
            seconds: for so long, about [s].
            cores: processes that share the work; by default as many as this one may use. What is found is the same.
        """
        begun, self._is_stopped = time.perf_counter(), False
        cores = (cores or len(os.sched_getaffinity(0))) if CAN_COPY else 1
        crew: Workers | None = None
        collected = gc.get_threshold()
        gc.set_threshold(100_000, *collected[1:])  # what is found is kept: to look for garbage took a sixth
        try:
            while self.unexplored and len(self.situations) < most and time.perf_counter() < begun + seconds:
                if self._is_stopped:
                    break
                if crew is None and cores > 1 and time.perf_counter() > begun + _ALONE_S:
                    crew = Workers(self._rounds, self._way, cores)
                self._round(self.unexplored[: 1 if crew is None else _AT_A_TIME * cores], crew)
        finally:
            gc.set_threshold(*collected)
            self.seconds += time.perf_counter() - begun
            self.megabytes = megabytes() + (0.0 if crew is None else crew.close())
        return self

    def stop(self) -> None:
        """Have `explore` end as if its time were over, soon; for other threads and what handles signals."""
        self._is_stopped = True

    @property
    def unexplored(self) -> range:
        """The situations of which it is not known yet what follows."""
        return range(self.count, len(self.situations))

    @property
    def is_finished(self) -> bool:
        """Whether nothing is left to be found."""
        return not self.unexplored

    @property
    def every(self) -> range:
        """The numbers of all situations."""
        return range(len(self.situations))

    @property
    def goals(self) -> set[int]:
        """The situations in which the goal is reached."""
        if self._goal is not None:
            return self.holds[self._goal]
        return {number for number, (doing, _) in enumerate(self.states) if doing.status == "SUCCESS"}

    def following(self, number: int, *, still: bool = False) -> Iterator[tuple[Step, Situation, int]]:
        """Yield each round that may follow, its moment and where it leads; if still, those in which nothing happens."""
        tree, known = self.situations[number]
        is_over = number >= self.count or self.doing[tree].is_over
        for after_changes, changes, was_late, _ in () if is_over else self._changed[known]:
            moment = Situation(tree, after_changes)
            for after, answers, is_late, _ in () if still and (changes or was_late) else self.ticks[moment]:
                if not (still and is_late):
                    yield Step(changes, answers, (was_late, is_late)), moment, self._numbers[after]

    def first(self, bad: Iterable[int], what: str) -> Wrong | None:
        """Return what is wrong in situations, with the way to the nearest of them; None if there are none."""
        number = min(bad, default=None)
        return None if number is None else (what, self.path(number))

    def reaching(
        self, wanted: Collection[int], *, still: bool = False, within: Collection[int] | None = None
    ) -> set[int]:
        """Return the situations from which one of those that are wanted can be reached, those included."""
        before: defaultdict[int, list[int]] = defaultdict(list)
        for number in self.every if within is None else within:
            for _, _, after in self.following(number, still=still):
                if within is None or after in within:
                    before[after].append(number)
        reached, pending = set(wanted), list(wanted)
        while pending:
            new = [one for one in before[pending.pop()] if one not in reached]
            reached.update(new)
            pending += new
        return reached

    def avoiding(self, number: int, wanted: Collection[int], rounds: int) -> list[Step] | None:
        """Return rounds after which nothing that is wanted was reached; None if there are no such."""
        layer: dict[int, list[Step]] = {} if number in wanted else {number: []}
        for _ in range(rounds):
            onward = [(trail, *one) for number, trail in layer.items() for one in self.following(number)]
            layer = {after: [*trail, step] for trail, step, _, after in reversed(onward) if after not in wanted}
        return next(iter(layer.values()), None)

    def load(self, number: int) -> Rig:
        """Put the parts of the mission into a situation and return them."""
        situation = self.situations[number]
        if not self._rounds.has_been_in(situation):
            bring(self._rounds, self._way(number))
        return self._rounds.load(situation)

    def path(self, number: int) -> list[Step]:
        """Return the rounds by which a situation was reached first."""
        return [step for _, step, _ in self._way(number)]

    def as_bytes(self) -> bytes:
        """Return what was found, for `go_on_from`: what led where, not what states hold."""
        size, done = len(self.situations) + self.is_finished, (self.count, self.seconds)
        saved = self._mark(), size, done, self.ticks, self._changed, self._rounds.news(of_all=True)
        return gzip.compress(pickle.dumps(saved), mtime=0)  # which says whether it is whole

    def go_on_from(self, kept: bytes) -> None:
        """Take over what an earlier exploration of the same mission has found.

        For a second it is explored from the beginning, and compared: a smaller mission is so explored anew.

        Raises:
            MissionError: it is not what one has left, or one of another mission, or the mission does otherwise now.
        """
        try:
            mark, size, (count, seconds), ticks, changed, news = _Reader(io.BytesIO(gzip.decompress(kept))).load()
        except Exception as error:  # whatever gzip and pickle make of what is none
            raise MissionError(f"it is not what an exploration has left: {error!r}") from error
        if mark == self._mark():
            self.explore(size, _ALONE_S, cores=1)
        found: list[dict[Any, Any]] = [self.ticks, self._changed, *self._rounds.news(of_all=True)[0]]
        kept_of = [ticks, changed, *news[0]]
        if mark != self._mark() or any(not one.items() <= of.items() for one, of in zip(found, kept_of, strict=True)):
            raise MissionError("it is of another mission, of other options, or the mission has been changed since")
        self.ticks, self._changed, self.seconds = ticks, changed, seconds
        self._rounds.hear(news)
        while self.count < count:  # what follows is known, and found once more
            self._round([self.count], None)

    def _mark(self) -> str:
        """Return what tells explorations apart."""
        around, rounds = self.rig.surroundings, self._rounds
        bounds = around.values, around.alike, around.failures, around.at_once
        return json.dumps([self._newest, rounds.first, self.rig.letters, *bounds, rounds.is_slow, len(self.holds)])

    def _way(self, number: int) -> Way:
        found = []
        while number > 0:
            before, step = self._steps[number]
            found.append((self.situations[before], step, self.situations[number]))
            number = before
        return found[::-1]

    def _round(self, batch: Sequence[int], crew: Workers | None) -> None:
        """Find what follows situations, by others or alone."""
        ask: Callable[[Iterable[Job]], list[list[Any]]] = partial(answered, self._rounds, self._way)
        ask = ask if crew is None else crew.ask
        open_ = [(one, self.situations[one]) for one in batch if not self.doing[self.situations[one].tree].is_over]
        unknown = {one.known: Job(number, one) for number, one in open_ if one.known not in self._changed}
        self._changed.update(zip(unknown, ask(unknown.values()), strict=True))
        jobs: dict[Situation, Job] = {}
        for number, one in open_:
            for change in self._changed[one.known]:
                job = Job(number, one, change)
                if job.moment not in self.ticks:
                    jobs.setdefault(job.moment, job)
        self.ticks.update(zip(jobs, ask(jobs.values()), strict=True))
        for number, one in open_:
            for change in self._changed[one.known]:
                moment = Situation(one.tree, change.known)
                self._note(change.faults, number, Step(change.changes))
                self.transitions += 1
                for tick in () if moment in self._ticked else self.ticks[moment]:
                    step = Step(change.changes, tick.answers, (change.is_late, tick.is_late))
                    self._note(tick.faults, number, step)
                    self._reach(tick.after, number, step)
                    self.transitions += 1
                self._ticked.add(moment)
        self.count += len(batch)

    def _note(self, faults: Sequence[str], before: int, step: Step) -> None:
        for fault in faults:
            self.faults.setdefault(fault, [*self.path(before), step])

    def _reach(self, situation: Situation, before: int, step: Step) -> None:
        number = self._numbers.setdefault(situation, len(self.situations))
        if number == len(self.situations):
            self.situations.append(situation)
            self.states.append((self.doing[situation.tree], self.known[situation.known]))
            self._steps.append((before, step))
            for holds, is_so in zip(self.holds.values(), self._rounds.holds.get(situation, ()), strict=True):
                if is_so:
                    holds.add(number)


class _Reader(pickle.Unpickler):
    """Makes nothing but what an exploration is made of, whoever has written the file."""

    def find_class(self, module: str, name: str) -> Any:  # noqa: ANN401  # a class of those
        return next(one for one in _PARTS if (one.__module__, one.__qualname__) == (module, name))
