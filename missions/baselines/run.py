"""One run of a mission in the sea under any manager: world, mission node and manager in lock-step."""

import sys
import traceback
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf
from pathlib import Path
from time import perf_counter
from types import MappingProxyType
from typing import TypeVar

from numpy.random import Generator

from kb import DiagnosticProblem, Model
from missions.baselines.manager import Manager, Robot, Task
from missions.baselines.reactions import LOW_LEVEL
from missions.baselines.registry import name_of
from missions.engine.adaptations import Adaptation
from missions.engine.mission import Mission, MissionError, Verdict
from missions.engine.percepts import Percepts
from missions.engine.runner import SAMPLE_PERIOD_S, Listener, Trace
from missions.engine.settings import RunSettings
from missions.suave.world import SEA, Sea

__all__ = ["ManagedRun", "Record"]

SEARCH, INSPECT = "search_pipeline", "inspect_pipeline"

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class _Value:
    value: float | None


class Record:
    """What a report looks at in a knowledge base, for a run that has none.

    Args:
        mission: whose model names thresholds.
        robot: what was measured and done.
    """

    def __init__(self, mission: Mission, robot: Robot) -> None:
        self._mission = mission
        self._robot = robot

    @property
    def model(self) -> Model:
        """The model of the mission, whose thresholds a picture shows."""
        return self._mission.model()

    @property
    def required_actions(self) -> tuple[Task, ...]:
        """The task that is being done."""
        return tuple(task for task in self._robot.tasks[-1:] if task.end is None)

    @property
    def action_history(self) -> tuple[Task, ...]:
        """Every task that was begun."""
        return tuple(self._robot.tasks)

    @property
    def attributes(self) -> MappingProxyType[str, _Value]:
        """What was measured last, by name."""
        return MappingProxyType({name: _Value(value) for name, value in self._robot.measured.items()})


class _Timer:
    """Due at a phase, then at every period after it."""

    def __init__(self, period_s: float, phase: float) -> None:
        self._period_s, self._first, self._count = period_s, phase * period_s, 0

    @property
    def due(self) -> float:
        return self._first + self._count * self._period_s

    def is_up(self, now: float) -> bool:
        """Tell whether it is due by now [s], and if so, wind it up again."""
        if now < self.due:
            return False
        self._count += 1
        return True


class ManagedRun:
    """Runs a mission under a manager to its end; has what reports and listeners look at in a `MissionRun`.

    Args:
        mission: suave, suave_extended, or another one in the sea.
        manager: class of the manager.
        world: the sea.
        settings: how it is run; of the task layer's settings none is used.
        rng: all chance of the manager and of its timers.
        listeners: who hears of it.
        options: values of the manager's options by name.

    Attributes:
        manager: its name, as `rosa run --manager` takes it.
        robot: what the manager knows and has done.
        kb: no knowledge base, but what a report looks at in one.
        trace: what was seen.
        compute_s: seconds of this machine's time by part, not part of any decision.

    Raises:
        MissionError: whatever the manager raises, here or in `run`, with its name, the moment and the line.
    """

    def __init__(
        self,
        mission: Mission,
        manager: type[Manager],
        world: Sea,
        settings: RunSettings,
        rng: Generator,
        listeners: tuple[Listener, ...] = (),
        options: Mapping[str, float] | None = None,
    ) -> None:
        self.mission, self.world, self.settings = mission, world, settings
        self._listeners = listeners
        phases = rng.random(2).tolist()
        self.robot = Robot(mission, world.managed, world.settings, rng, lambda: world.now, options)
        self._class, self.manager = manager, name_of(manager)
        self._manager = self._ask(manager, self.robot)
        self._percepts = Percepts()
        self.task = "tree of the manager" if manager.decides_tasks else "mission node"
        self._mission_timer = _Timer(world.settings.mission_period_s, phases[0])
        self._manager_timer = _Timer(self._ask(_checked, self._manager.period_s), phases[1])
        self.kb = Record(mission, self.robot)
        self.trace = Trace()
        self.compute_s: defaultdict[str, float] = defaultdict(float)
        self.problems: list[tuple[float, DiagnosticProblem]] = []
        self.adaptations: list[Adaptation] = []
        self.plans = ()
        self._sampled_at = -inf
        self._tasks_told = self._changes_told = 0

    def run(self) -> Verdict:
        """Run until the pipeline is inspected or the time limit is reached; the world is closed however this ends."""
        try:
            while self.world.now < self.settings.duration_s and not self._ask(self._is_done):
                self._turn()
        finally:
            self.world.close()
        if self.robot.task is not None:
            self.robot.end("abandoned", "the mission has ended")
        is_low = self.robot.measured.get("battery_level", 1.0) < LOW_LEVEL
        recharges = is_low or any(task.action == "recharge" for task in self.robot.tasks)
        return SEA.judge(self._percepts, self.world.results(), recharges)

    def _is_done(self) -> bool:
        return self._manager.is_done or any(
            task.action == INSPECT and task.result == "completed" for task in self.robot.tasks
        )

    def _ask(self, what: Callable[..., T], *args: object) -> T:
        try:
            return what(*args)
        except Exception as error:
            raise MissionError(self._blamed(error)) from error

    def _blamed(self, error: Exception) -> str:
        """Say which manager raised what, when, and at which line of its own file."""
        own = getattr(sys.modules.get(self._class.__module__), "__file__", None)
        frames = traceback.extract_tb(error.__traceback__)[1:]
        frame = next((one for one in reversed(frames) if one.filename == own), None)
        where = f"; {Path(frame.filename).name}, line {frame.lineno}, in {frame.name}" if frame else ""
        return f"manager {self.manager} failed after {self.world.now:.2f} s: {type(error).__name__}: {error}{where}"

    def _turn(self) -> None:
        """Let the world go on to the next news or timer, and answer it."""
        started = perf_counter()
        due = min(self._manager_timer.due, self._mission_timer.due, self.robot.due)
        messages = self.world.advance(min(due, self.settings.duration_s))
        advanced = perf_counter()
        for message in messages:
            self.robot.receive(message)
            self._percepts.receive(message)
            for listener in self._listeners:
                listener.message(message)
            self._ask(self._manager.receive, message)
        self._ask(self.robot.catch_up)
        now = self.world.now
        if self._mission_timer.is_up(now) and not self._manager.decides_tasks:
            self._decide()
        ticked = self._manager_timer.is_up(now)
        if ticked:
            self._ask(self._manager.update)
        self.compute_s["world"] += advanced - started
        self.compute_s["manager"] += perf_counter() - advanced
        if self._listeners:
            self._tell()
        if ticked:
            self._sample(now)
            for listener in self._listeners:
                listener.tick(self)  # type: ignore[arg-type]  # it has what a listener looks at

    def _decide(self) -> None:
        """Begin and end tasks as SUAVE's mission node does: search until the pipeline is found, then inspect it."""
        task = self.robot.task
        if task is None:
            self._begin(SEARCH)
        elif task == SEARCH and self._percepts.holds("pipeline_found"):
            self._end(SEARCH)
            self._begin(INSPECT)
        elif task == INSPECT and self._percepts.holds("pipeline_inspected"):
            self._end(INSPECT)

    def _begin(self, task: str) -> None:
        self.robot.begin(task)
        self._ask(self._manager.begin, task)

    def _end(self, task: str) -> None:
        self.robot.end("completed")
        self._ask(self._manager.end, task)

    def _tell(self) -> None:
        """Tell the listeners what has been done since they were told last."""
        tasks, changes = self.robot.tasks, self.world.history
        said = [(task.start, f"{task.action} is begun") for task in tasks[self._tasks_told :]]
        said += [(change.time, str(change)) for change in changes[self._changes_told :]]
        self._tasks_told, self._changes_told = len(tasks), len(changes)
        for time, text in sorted(said):
            for listener in self._listeners:
                listener.action(text, time)

    def _sample(self, now: float) -> None:
        if now >= self._sampled_at + SAMPLE_PERIOD_S - 1e-9:
            self._sampled_at = now
            searching = self.robot.is_active("spiral_search")
            altitude = f"{self.robot.parameters('spiral_search')['spiral_altitude']:g} m" if searching else ""
            self.trace.samples.append((self.world.sample(), self.robot.task or "", altitude))


def _checked(period_s: float) -> float:
    if not 0 < period_s < inf:
        raise MissionError(f"period_s is {period_s!r}; allowed is a number of seconds above 0")
    return period_s
