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
from collections.abc import Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from missions.engine.mission import MissionError
from missions.proof.rig import Predicate, Rig, Setup
from missions.proof.rounds import (
    CAN_COPY,
    Changed,
    Doing,
    Known,
    Onward,
    Rounds,
    Seen,
    Situation,
    Step,
    Ticked,
    Way,
    Workers,
    megabytes,
)
from missions.proof.surroundings import Change

_AT_A_TIME: Final = 32
"""So many situations each of several processes goes on from before it is looked whether there is time for more."""

_ALONE_S: Final = 1.0
"""For so long one process explores: most missions are known then [s]."""

_PARTS: Final = (Situation, Step, Change, Changed, Ticked, Seen, Known, Doing, frozenset)

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
        states: by number, what matters of it.
        onward: by number, what may follow, as far as that is known.
        faults: of the manager, in words, with the rounds that lead there first.
        holds: by predicate, in which situations it does.
        transitions: how many changes and ticks were found.
        seconds: how long it took [s].
        megabytes: the most memory that one process has held [MB].
    """

    def __init__(self, setup: Setup, predicates: Sequence[Predicate] = (), goal: Predicate | None = None) -> None:
        predicates, self._goal = [*predicates, *filter(None, [goal])], goal
        self._rounds = rounds = Rounds(setup, predicates)
        self.rig = rounds.rig
        self.faults = {fault: list[Step]() for fault in rounds.faults}
        self.situations: list[Situation] = []
        self.states: list[Seen] = []
        self.onward: list[Onward] = []
        self._steps: list[tuple[int, Step]] = []
        self._numbers: dict[Situation, int] = {}
        self.holds: dict[Predicate, set[int]] = {one: set() for one in predicates}
        self._ticked: set[Situation] = set()
        self.transitions, self.seconds, self.megabytes = 0, 0.0, 0.0
        self._is_stopped = False
        sources = [Path(getattr(one, "__file__", None) or "") for one in [*sys.modules.values()]]
        self._newest = max(one.stat().st_mtime_ns for one in sources if one.suffix == ".py" and one.is_file())
        self._reach(rounds.first, rounds.seen(rounds.first), -1, Step())

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
                    crew = Workers(self._rounds, cores)
                self._round(self.unexplored[: 1 if crew is None else _AT_A_TIME * cores], crew)
        finally:
            gc.set_threshold(*collected)
            self.seconds += time.perf_counter() - begun
            if crew is not None:
                crew.close()
            self.megabytes = megabytes()
        return self

    def stop(self) -> None:
        """Have `explore` end as if its time were over, soon; for other threads and what handles signals."""
        self._is_stopped = True

    @property
    def unexplored(self) -> range:
        """The situations of which it is not known yet what follows."""
        return range(len(self.onward), len(self.situations))

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
        return {number for number, one in enumerate(self.states) if one.doing.status == "SUCCESS"}

    @property
    def occurring(self) -> set[tuple[str, str]]:
        """Kind and name of all that was selected or required in what was explored."""
        changed = [change.facts for onward in self.onward for change, _ in onward]
        return set().union(*(one.occurring for one in (*changed, *(one.facts for one in self.states))))

    def following(self, number: int, *, still: bool = False) -> Iterator[tuple[Step, Known, int]]:
        """Yield each round that may follow, what is known before its tick and where it leads.

        If still, those in which nothing happens.
        """
        for change, ticks in self.onward[number] if number < len(self.onward) else ():
            is_news = change.changes or change.is_late
            for tick in () if still and is_news else ticks:
                if not (still and tick.is_late):
                    step = Step(change.changes, tick.answers, (change.is_late, tick.is_late))
                    yield step, change.facts, self._numbers[tick.after]

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
        return self._rounds.load(self._rounds.bring(self._way(number)))

    def path(self, number: int) -> list[Step]:
        """Return the rounds by which a situation was reached first."""
        return [step for _, step, _ in self._way(number)]

    def as_bytes(self) -> bytes:
        """Return what was found, for `go_on_from`: what led where, not what states hold."""
        size = len(self.situations) + self.is_finished
        saved = self._mark(), size, len(self.onward), self.seconds, (self._rounds.found, self._rounds.ticked)
        return gzip.compress(pickle.dumps(saved), mtime=0)  # which says whether it is whole

    def go_on_from(self, kept: bytes) -> None:
        """Take over what an earlier exploration of the same mission has found.

        For a second it is explored from the beginning, and compared: a smaller mission is so explored anew.

        Raises:
            MissionError: it is not what one has left, or one of another mission, or the mission does otherwise now.
        """
        try:
            mark, size, count, seconds, news = _Reader(io.BytesIO(gzip.decompress(kept))).load()
        except Exception as error:  # whatever gzip and pickle make of what is none
            raise MissionError(f"it is not what an exploration has left: {error!r}") from error
        if mark == self._mark():
            self.explore(size, _ALONE_S, cores=1)
        both = zip(self._rounds.found, news[0], strict=True)
        if mark != self._mark() or any(not mine.items() <= theirs.items() for mine, theirs in both):
            raise MissionError("it is of another mission, of other options, or the mission has been changed since")
        self.seconds = seconds
        self._rounds.hear(news)
        while len(self.onward) < count:
            self._round(self.unexplored[:1], None)

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
        ways = {one: self._way(one) for one in batch if not self.states[one].doing.is_over}
        if crew is not None:
            crew.explore([*ways.values()])
        for one in batch:
            self._take_in(self._rounds.onward(ways[one]) if one in ways else [])

    def _take_in(self, onward: Onward) -> None:
        """Note what follows the first situation of which that was not known."""
        number = len(self.onward)
        for change, ticks in onward:
            self._note(change.faults, number, Step(change.changes))
            self.transitions += 1
            moment = Situation(self.situations[number].tree, change.known)
            for tick in () if moment in self._ticked else ticks:
                step = Step(change.changes, tick.answers, (change.is_late, tick.is_late))
                self._note(tick.faults, number, step)
                self._reach(tick.after, tick.seen, number, step)
                self.transitions += 1
            self._ticked.add(moment)
        self.onward.append(onward)

    def _note(self, faults: Sequence[str], before: int, step: Step) -> None:
        for fault in faults:
            self.faults.setdefault(fault, [*self.path(before), step])

    def _reach(self, situation: Situation, seen: Seen, before: int, step: Step) -> None:
        number = self._numbers.setdefault(situation, len(self.situations))
        if number == len(self.situations):
            self.situations.append(situation)
            self.states.append(seen)
            self._steps.append((before, step))
            for holds, is_so in zip(self.holds.values(), seen.holds, strict=True):
                if is_so:
                    holds.add(number)


class _Reader(pickle.Unpickler):
    """Makes nothing but what an exploration is made of, whoever has written the file."""

    def find_class(self, module: str, name: str) -> Any:  # noqa: ANN401  # a class of those
        return next(one for one in _PARTS if (one.__module__, one.__qualname__) == (module, name))
