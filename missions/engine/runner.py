"""One run of a mission: a world and who decides in it, in lock-step with the world's clock."""

from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from math import isfinite, nan
from numbers import Real
from time import perf_counter
from typing import TYPE_CHECKING

from kb import DiagnosticProblem, KnowledgeBase, KnowledgeBaseError, Model, RequiredAction
from missions.engine.adaptations import Adaptation
from missions.engine.mission import (
    NO_SUCCESS,
    TIME_LIMIT,
    Message,
    Mission,
    MissionError,
    Reaction,
    Sample,
    Verdict,
    World,
)
from missions.engine.settings import RunSettings
from rosa_bt.exceptions import in_words

if TYPE_CHECKING:
    from rosa_pddl import PlanRecord

SAMPLE_PERIOD_S = 0.5
STANDSTILL = 10_000
"""How often a world may be asked to go on without a millisecond passing, until it counts as standing still."""


class Listener:
    """Hears of a run as it happens; a subclass overrides what it wants to hear."""

    def message(self, message: Message) -> None:
        """Hear what was published."""

    def problem(self, problem: DiagnosticProblem, time_s: float) -> None:
        """Hear of a part of a message that could not be used."""

    def adaptation(self, adaptation: Adaptation) -> None:
        """Hear of an adaptation that is in force, or has failed."""

    def action(self, text: str, time_s: float) -> None:
        """Hear of an action that was requested or has ended."""

    def plan(self, plan: "PlanRecord", time_s: float) -> None:
        """Hear of a task plan, or that there is none."""

    def tick(self, run: "MissionRun") -> None:
        """Hear that something was decided."""

    def sample(self, sample: Sample) -> None:
        """Hear what there is to see of the world, twice a second at most."""


class MissionRun(ABC):
    """One run of a mission, to its end: by our knowledge base, manager and task layer, or by a baseline.

    It lets the world go on to the time that it is due, takes in what was published by then, and decides.

    Attributes:
        manager: whose run it is, as `rosa run --manager` takes it.
        problems: parts of messages that could not be used, with their times [s].
        alter: returns what is heard in place of what was published by a time [s]; a disturbance from outside.
        inputs: figures of results that were put in, by name.
        compute_s: seconds of this machine's time by part, not part of any decision.
        listeners: who hears of it.
        trouble: how the mission has to end at once; None if it may go on.
        findings: what may be an oversight in what was planned with, in sentences; known at the end.
        adaptations: every one so far, in the order in which they were decided.
        is_stuck: whether nothing can be done any more, whatever time passes: the mission ends, and is judged.
    """

    def __init__(self, mission: Mission, world: World, settings: RunSettings, manager: str, task: str) -> None:
        self.mission, self.world, self.settings = mission, world, settings
        self.manager, self.task = manager, task
        self.problems: list[tuple[float, DiagnosticProblem]] = []
        self.alter: Callable[[Sequence[Message], float], Sequence[Message]] | None = None
        self.inputs: Mapping[str, float] = {}
        self.compute_s = defaultdict[str, float](float, world=0.0)
        self.listeners: Sequence[Listener] = ()
        self.trouble: Verdict | None = None
        self.findings: Sequence[str] = ()
        self.adaptations: list[Adaptation] = []
        self.is_stuck = False
        self._decided_s: list[tuple[float, float]] = []
        self._sampled_at, self._plans_heard = -SAMPLE_PERIOD_S, 0
        self._moved_s, self._turns = world.now, 0

    def listen(self, *listeners: Listener) -> None:
        """Have these hear of the run, too."""
        self.listeners = (*self.listeners, *listeners)

    @property
    def kb(self) -> KnowledgeBase:
        """The knowledge base.

        Raises:
            MissionError: it is the run of a baseline, which has none.
        """
        raise MissionError(f"manager {self.manager} has no knowledge base")

    @property
    def model(self) -> Model:
        """The model of the mission, amended as far as it was."""
        return self.mission.model()

    @property
    def plans(self) -> tuple["PlanRecord", ...]:
        """The task plans so far, only added to; none for a tree in which nothing plans."""
        return ()

    @property
    @abstractmethod
    def due(self) -> float:
        """When it wants to decide next, whatever is published until then [s]."""

    @property
    @abstractmethod
    def is_done(self) -> bool:
        """Whether the mission is over."""

    @property
    @abstractmethod
    def actions(self) -> Sequence[RequiredAction]:
        """Every action that was begun."""

    @property
    @abstractmethod
    def measured(self) -> Mapping[str, float | None]:
        """What was measured last, by attribute."""

    @abstractmethod
    def receive(self, message: Message) -> Sequence[DiagnosticProblem]:
        """Take in what was published; return what of it cannot be used."""

    @abstractmethod
    def decide(self) -> bool:
        """Answer what was taken in, and do what is due; return whether something was."""

    @abstractmethod
    def end(self) -> None:
        """Let go of everything; the run is over however it ended."""

    @abstractmethod
    def verdict(self, results: Mapping[str, float | None]) -> Verdict:
        """Say how the mission, which is over, has ended."""

    @property
    def reactions(self) -> Sequence[tuple[Reaction, float]]:
        """Each reaction that the world knows of, and the time of this machine that went into it [s]."""
        return [
            (one, sum(took for time, took in self._decided_s if one.start_s <= time < one.end_s))
            for one in self.world.reactions()
        ]

    def results(self) -> Mapping[str, float | None]:
        """Return the mission's figures up to now by name, units in the names; those that were put in among them."""
        figures, gives = self.world.results(), f"results() of {type(self.world).__name__} gives"
        if not isinstance(figures, Mapping):
            raise MissionError(f"{gives} {figures!r:.80}; expected is a mapping, empty if there are no figures")
        for name, value in figures.items():
            if value is not None and not isinstance(value, Real):
                wrong = f"{gives} {name!r} as {value!r:.80}"
                raise MissionError(f"{wrong}; expected is a number, or None for what did not happen")
        return {**figures, **self.inputs}

    def run(self) -> Verdict:
        """Run until the mission is done, stuck or out of time; nothing is left running however this ends.

        Raises:
            MissionError: the world does not let time pass, or what is of the mission's own raises; names it.
        """
        world, duration_s = self.world, self.settings.duration_s
        with closing(world):
            try:
                while not (self.trouble or self.is_stuck or self.is_done or world.now >= duration_s):
                    self._turn()
            finally:
                self.end()
        if self.trouble:
            return self.trouble
        verdict = self.verdict(self.results())
        if self.is_done and world.now < duration_s and verdict.outcome in (*NO_SUCCESS, TIME_LIMIT):
            # it was judged by a goal that is not reached, as if time had run out
            ended = f"the task ended after {world.now:.1f} s of {duration_s:g} s, short of the mission's goal"
            return Verdict("ended_early", ended)
        return verdict

    def _turn(self) -> None:
        """Let the world go on to the next news, or to when something is due, and answer it."""
        started = perf_counter()
        messages = self._advanced(min(self.due, self.settings.duration_s))
        self.compute_s["world"] += perf_counter() - started
        if self.alter is not None:
            messages = self.alter(messages, self.world.now)
        took_s = 0.0
        for message in messages:
            took_s += self._take_in(message)
        started = perf_counter()
        is_decided = self.decide()
        self._decided_s.append((self.world.now, took_s + perf_counter() - started))
        if is_decided and self.listeners:
            self._sample()
            for listener in self.listeners:
                listener.tick(self)
        heard, self._plans_heard = self._plans_heard, len(self.plans)
        for plan in self.plans[heard:]:
            self.hear_plan(plan)

    def hear_plan(self, plan: "PlanRecord") -> None:
        """Pass on a task plan that was made."""
        for listener in self.listeners:
            listener.plan(plan, self.world.now)

    def _advanced(self, until: float) -> Sequence[Message]:
        world, before, name = self.world, self.world.now, self.mission.name
        try:
            given = world.advance(until)
            if isinstance(given, Mapping) or not isinstance(given, Iterable):
                said = f"advance() of {type(world).__name__} returned {given!r:.80}"
                raise MissionError(f"{said}; it is to return a list of messages, empty if there are none")
            messages = [*given]
        except (MissionError, KnowledgeBaseError):
            raise
        except Exception as error:  # whatever an author's world may raise
            raise MissionError(f"the world of mission {name} failed after {before:.1f} s: {in_words(error)}") from error
        now = world.now
        if not isfinite(now) or now < before:
            raise MissionError(f"the world of mission {name} shows {now!r} s after {before!r} s; its time has to pass")
        self._turns += 1
        if now >= self._moved_s + 1e-3:
            self._moved_s, self._turns = now, 0
        elif self._turns > STANDSTILL:
            stands = f"the world of mission {name} stands still at {now:.3f} s, asked to go on to {until:.3f} s"
            advice = "advance() goes on until something is published, a command has ended, or to the time asked for"
            raise MissionError(f"{stands}; {advice}")
        return messages

    def _take_in(self, message: Message) -> float:
        """Have a message heard; return how long it took to take it in [s]."""
        started = perf_counter()
        problems = self.receive(message)
        took_s = perf_counter() - started
        for listener in self.listeners:
            listener.message(message)
        for problem in problems:
            self.problems.append((float(message["time"]), problem))
            for listener in self.listeners:
                listener.problem(problem, float(message["time"]))
        return took_s

    def _sample(self) -> None:
        if self.world.now < self._sampled_at + SAMPLE_PERIOD_S - 1e-9:
            return
        self._sampled_at = self.world.now
        sample = self.world.sample()
        if sample is None:
            signals = {name: nan if value is None else value for name, value in self.measured.items()}
            sample = Sample(self.world.now, (nan, nan, nan), signals)
        for listener in self.listeners:
            listener.sample(sample)
