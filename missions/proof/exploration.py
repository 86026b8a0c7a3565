"""The graph of all situations that a tree, its knowledge base and the manager can get into, found by running them."""

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
from missions.proof.rig import Change, Predicate, Rig, Setup
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

_AT_A_TIME: Final = 32
"""How many situations each process explores between two looks at the clock."""

_ALONE_S: Final = 1.0
"""For how long one process explores alone; most missions are finished by then [s]."""

_PARTS: Final = (Situation, Step, Change, Changed, Ticked, Seen, Known, Doing, frozenset)

Wrong = tuple[str, Sequence[Step] | None]
"""What is wrong, in words, and the rounds that lead there; None if no single story shows it."""


class Exploration:
    """The situations that were found so far, and the questions about them that properties ask.

    Args:
        setup: what is explored.
        predicates: each is evaluated in every situation.
        goal: holds where the mission has reached its goal; by default where the root succeeds.

    Attributes:
        rig: the parts of the mission; `load` puts them into a situation.
        situations: by number; 0 is the initial one, and those that fewer rounds lead to come first.
        states: by number of the situation, the parts of it that properties look at.
        onward: by number of the situation, all that may follow it; shorter than `situations` until it is finished.
        faults: of the manager, in words, each with the fewest rounds that lead there.
        holds: by predicate, the situations in which it holds.
        transitions: the number of changes and ticks that were found.
        seconds: how long the exploration took [s].
        megabytes: the most memory that one process used [MB].
    """

    def __init__(
        self, setup: Setup, predicates: Sequence[Predicate] = (), goal: Predicate | None = None
    ) -> None:
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
        self._newest = max(
            one.stat().st_mtime_ns for one in sources if one.suffix == ".py" and one.is_file()
        )
        self._reach(rounds.first, rounds.seen(rounds.first), -1, Step())

    def explore(
        self, most: int = 100_000, seconds: float = 60.0, cores: int | None = None
    ) -> "Exploration":
        """Explore, breadth first; called again, it goes on where it stopped.

        Args:
            most: it stops at about this number of situations.
            seconds: it stops after about this time [s].
            cores: how many processes share the work; by default as many as there are cores. The result is the same.
        """
        begun, self._is_stopped = time.perf_counter(), False
        cores = (cores or len(os.sched_getaffinity(0))) if CAN_COPY else 1
        crew: Workers | None = None
        collected = gc.get_threshold()
        gc.set_threshold(
            100_000, *collected[1:]
        )  # what is found is kept; looking for garbage took a sixth
        try:
            while (
                self.unexplored
                and len(self.situations) < most
                and time.perf_counter() < begun + seconds
            ):
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
        """Let `explore` end soon, as if its time were over; may be called from other threads and signal handlers."""
        self._is_stopped = True

    @property
    def unexplored(self) -> range:
        """The numbers of the situations that were not explored from yet."""
        return range(len(self.onward), len(self.situations))

    @property
    def is_finished(self) -> bool:
        """Whether all situations were explored from."""
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
        """Kind and name of each element that was selected or required in some state."""
        changed = [change.facts for onward in self.onward for change, _ in onward]
        return set().union(
            *(one.occurring for one in (*changed, *(one.facts for one in self.states)))
        )

    def following(self, number: int, *, still: bool = False) -> Iterator[tuple[Step, Known, int]]:
        """Yield each round that may follow, the facts before its tick, and the number of the situation after it.

        If still, only rounds in which no fact changes and the manager misses no turn.
        """
        for change, ticks in self.onward[number] if number < len(self.onward) else ():
            is_news = change.changes or change.is_late
            for tick in () if still and is_news else ticks:
                if not (still and tick.is_late):
                    step = Step(change.changes, tick.answers, (change.is_late, tick.is_late))
                    yield step, change.facts, self._numbers[tick.after]

    def first(self, bad: Iterable[int], what: str) -> Wrong | None:
        """Return what is wrong in these situations, with the rounds to the nearest of them; None if there is none."""
        number = min(bad, default=None)
        return None if number is None else (what, self.path(number))

    def reaching(
        self, wanted: Collection[int], *, still: bool = False, within: Collection[int] | None = None
    ) -> set[int]:
        """Return the wanted situations, and all from which one of them can be reached."""
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
        """Return so many rounds that avoid the wanted situations; None if there are no such rounds."""
        layer: dict[int, list[Step]] = {} if number in wanted else {number: []}
        for _ in range(rounds):
            onward = [
                (trail, *one) for number, trail in layer.items() for one in self.following(number)
            ]
            layer = {
                after: [*trail, step]
                for trail, step, _, after in reversed(onward)
                if after not in wanted
            }
        return next(iter(layer.values()), None)

    def load(self, number: int) -> Rig:
        """Put the parts of the mission into a situation and return them."""
        return self._rounds.load(self._rounds.bring(self._way(number)))

    def path(self, number: int) -> list[Step]:
        """Return the fewest rounds that lead to a situation."""
        return [step for _, step, _ in self._way(number)]

    def as_bytes(self) -> bytes:
        """Return what was found, for `go_on_from`: which rounds lead where, without the contents of states."""
        size = len(self.situations) + self.is_finished
        saved = (
            self._mark(),
            size,
            len(self.onward),
            self.seconds,
            (self._rounds.found, self._rounds.ticked),
        )
        return gzip.compress(pickle.dumps(saved), mtime=0)  # its checksum detects damage

    def go_on_from(self, kept: bytes) -> None:
        """Take over what an earlier exploration of the same mission found (the bytes of `as_bytes`).

        First it explores for a second from the beginning and compares; a small mission is thus explored anew.

        Raises:
            MissionError: the bytes are damaged or of another mission, or the mission has changed since.
        """
        try:
            mark, size, count, seconds, news = _Reader(io.BytesIO(gzip.decompress(kept))).load()
        except Exception as error:  # gzip and pickle raise many kinds
            raise MissionError(f"it is not a saved exploration: {error!r}") from error
        if mark == self._mark():
            self.explore(size, _ALONE_S, cores=1)
        both = zip(self._rounds.found, news[0], strict=True)
        if mark != self._mark() or any(not mine.items() <= theirs.items() for mine, theirs in both):
            raise MissionError(
                "it is of another mission or of other options, or the mission has changed since"
            )
        self.seconds = seconds
        self._rounds.hear(news)
        while len(self.onward) < count:
            self._round(self.unexplored[:1], None)

    def _mark(self) -> str:
        """Return a text that differs for other missions, options and versions of the loaded modules."""
        around, rounds = self.rig.surroundings, self._rounds
        bounds = around.values, around.alike, around.failures, around.at_once
        return json.dumps(
            [self._newest, rounds.first, self.rig.letters, *bounds, rounds.is_slow, len(self.holds)]
        )

    def _way(self, number: int) -> Way:
        found = []
        while number > 0:
            before, step = self._steps[number]
            found.append((self.situations[before], step, self.situations[number]))
            number = before
        return found[::-1]

    def _round(self, batch: Sequence[int], crew: Workers | None) -> None:
        """Explore from situations, with the help of other processes if there are any."""
        ways = {one: self._way(one) for one in batch if not self.states[one].doing.is_over}
        if crew is not None:
            crew.explore([*ways.values()])
        for one in batch:
            self._take_in(self._rounds.onward(ways[one]) if one in ways else [])

    def _take_in(self, onward: Onward) -> None:
        """Note all that follows the first unexplored situation."""
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
    """Unpickles only the classes that an exploration consists of, so a file of a stranger cannot run code."""

    def find_class(self, module: str, name: str) -> Any:  # noqa: ANN401  # a class of those
        return next(one for one in _PARTS if (one.__module__, one.__qualname__) == (module, name))
