"""One run of a mission: a world and who decides in it, in lock-step with the world's clock."""

from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from math import isfinite
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
        """Hear that the controller has decided."""


class Controller(ABC):
    """Who decides in a run: our knowledge base, manager and task layer, or a baseline.

    A run asks for the time that it is due, passes on what was published by then, and has it decide.

    Attributes:
        manager: its name, as `rosa run --manager` takes it.
        kb: its knowledge base; None if it has none.
        inputs: figures of results that were put in, by name.
        compute_s: seconds of this machine's time by part, not part of any decision.
        listeners: who hears of actions and adaptations.
        trouble: how the mission has to end at once; None if it may go on.
        findings: what may be an oversight in what was planned with, in sentences; known at the end.
        adaptations: every one so far, in the order in which they were decided.
        is_stuck: whether nothing can be done any more, whatever time passes: the mission ends, and is judged.
    """

    def __init__(self, manager: str, task: str) -> None:
        self.manager, self.task = manager, task
        self.kb: KnowledgeBase | None = None
        self.inputs: Mapping[str, float] = {}
        self.compute_s: defaultdict[str, float] = defaultdict(float)
        self.listeners: Sequence[Listener] = ()
        self.trouble: Verdict | None = None
        self.findings: Sequence[str] = ()
        self.adaptations: list[Adaptation] = []
        self.is_stuck = False

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

    @property
    def plans(self) -> tuple["PlanRecord", ...]:
        """The task plans so far; only added to."""
        return ()

    def attend(self, listeners: Sequence[Listener]) -> None:
        """Have these hear of actions and adaptations, and nobody else."""
        self.listeners = listeners

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


class MissionRun:
    """Runs a mission to its end.

    Attributes:
        trace: what there was to see of the world while somebody listened, for pages and pictures.
        problems: parts of messages that could not be used, with their times [s].
        alter: returns what is heard in place of what was published by a time [s]; a disturbance from outside.
    """

    def __init__(
        self,
        mission: Mission,
        controller: Controller,
        world: World,
        settings: RunSettings | None = None,
        listeners: Sequence[Listener] = (),
    ) -> None:
        self.mission, self.controller, self.world = mission, controller, world
        self.settings = settings or RunSettings()
        self.trace: list[Sample] = []
        self.problems: list[tuple[float, DiagnosticProblem]] = []
        self.alter: Callable[[Sequence[Message], float], Sequence[Message]] | None = None
        self._listeners = listeners
        self._decided_s: list[tuple[float, float]] = []
        self._world_s, self._sampled_at, self._plans_heard = 0.0, -SAMPLE_PERIOD_S, 0
        self._moved_s, self._turns = world.now, 0
        controller.attend(listeners)

    def listen(self, listener: Listener) -> None:
        self._listeners = (*self._listeners, listener)
        self.controller.attend(self._listeners)

    @property
    def manager(self) -> str:
        """Whose run it is, as `rosa run --manager` takes it."""
        return self.controller.manager

    @property
    def task(self) -> str:
        return self.controller.task

    @property
    def kb(self) -> KnowledgeBase:
        """The knowledge base.

        Raises:
            MissionError: it is the run of a baseline, which has none.
        """
        if self.controller.kb is None:
            raise MissionError(f"manager {self.manager} has no knowledge base")
        return self.controller.kb

    @property
    def model(self) -> Model:
        """The model of the mission, amended as far as it was."""
        return self.mission.model() if self.controller.kb is None else self.controller.kb.model

    @property
    def actions(self) -> Sequence[RequiredAction]:
        """Every action that was begun."""
        return self.controller.actions

    @property
    def adaptations(self) -> list[Adaptation]:
        """Every adaptation so far, in the order in which they were decided."""
        return self.controller.adaptations

    @property
    def plans(self) -> tuple["PlanRecord", ...]:
        """The task plans so far; none for a tree in which nothing plans."""
        return self.controller.plans

    @property
    def compute_s(self) -> dict[str, float]:
        """Seconds of this machine's time by part, not part of any decision."""
        return {"world": self._world_s, **self.controller.compute_s}

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
        return {**figures, **self.controller.inputs}

    def run(self) -> Verdict:
        """Run until the mission is done, stuck or out of time; nothing is left running however this ends.

        Raises:
            MissionError: the world does not let time pass, or what is of the mission's own raises; names it.
        """
        controller, world, duration_s = self.controller, self.world, self.settings.duration_s
        with closing(world):
            try:
                while not (controller.trouble or controller.is_stuck or controller.is_done or world.now >= duration_s):
                    self._turn()
            finally:
                controller.end()
        if controller.trouble:
            return controller.trouble
        verdict = controller.verdict(self.results())
        if controller.is_done and world.now < duration_s and verdict.outcome in (*NO_SUCCESS, TIME_LIMIT):
            # it was judged by a goal that is not reached, as if time had run out
            ended = f"the task ended after {world.now:.1f} s of {duration_s:g} s, short of the mission's goal"
            return Verdict("ended_early", ended)
        return verdict

    def _turn(self) -> None:
        """Let the world go on to the next news, or to when the controller is due, and have it answered."""
        controller, started = self.controller, perf_counter()
        messages = self._advanced(min(controller.due, self.settings.duration_s))
        self._world_s += perf_counter() - started
        if self.alter is not None:
            messages = self.alter(messages, self.world.now)
        took_s = 0.0
        for message in messages:
            took_s += self._take_in(message)
        started = perf_counter()
        is_decided = controller.decide()
        self._decided_s.append((self.world.now, took_s + perf_counter() - started))
        if is_decided and self._listeners:
            self._sample()
            for listener in self._listeners:
                listener.tick(self)
        self._report_plans()

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
        """Have a message heard; return how long that took the controller [s]."""
        started = perf_counter()
        problems = self.controller.receive(message)
        took_s = perf_counter() - started
        for listener in self._listeners:
            listener.message(message)
        for problem in problems:
            self.problems.append((float(message["time"]), problem))
            for listener in self._listeners:
                listener.problem(problem, float(message["time"]))
        return took_s

    def _report_plans(self) -> None:
        plans = self.plans
        heard, self._plans_heard = self._plans_heard, len(plans)
        for plan in plans[heard:]:
            for listener in self._listeners:
                listener.plan(plan, self.world.now)

    def _sample(self) -> None:
        if self.world.now < self._sampled_at + SAMPLE_PERIOD_S - 1e-9:
            return
        self._sampled_at = self.world.now
        self.trace.append(self.world.sample() or Sample.of(self.world.now, self.controller.measured))
