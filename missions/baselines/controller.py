"""Who decides in a run of a baseline: SUAVE's mission node, or the manager itself, and the manager."""

from collections.abc import Callable, Mapping, Sequence
from math import inf
from time import perf_counter
from typing import TYPE_CHECKING, TypeVar

from kb import DiagnosticProblem, RequiredAction
from missions.baselines.manager import Manager, Robot
from missions.engine.mission import Message, Mission, MissionError, Verdict
from missions.engine.runner import Controller
from missions.suave.world import SEA, Sea
from rosa_bt.exceptions import in_words

if TYPE_CHECKING:
    from numpy.random import Generator

SEARCH, INSPECT = "search_pipeline", "inspect_pipeline"
LOW_LEVEL = 0.25

T = TypeVar("T")


class BaselineController(Controller):
    """Has a manager of the sea's vehicle decide; of its options, those that were published show among the results.

    Raises:
        MissionError: whatever the manager raises, here or later, with its name, the moment and the line.
    """

    def __init__(
        self,
        mission: Mission,
        name: str,
        manager: type[Manager],
        world: Sea,
        rng: "Generator",
        options: Mapping[str, float],
        deadline_s: float,
    ) -> None:
        super().__init__(name, "tree of the manager" if manager.decides_tasks else "mission node")
        published = [one.name for one in manager.options if one.is_published]
        self.inputs = {f"input_from_paper_{name}": options[name] for name in published}
        self._world = world
        phases = rng.random(2).tolist()
        self.robot = Robot(mission, world, rng, options, deadline_s)
        self._manager = self._ask(manager, self.robot)
        for period_s, phase, what in (
            (world.settings.mission_period_s, phases[0], self._decide_task),
            (self._ask(_checked, self._manager.period_s), phases[1], self._update),
        ):
            self.robot.agenda.every(period_s, phase * period_s, what)
        self._is_ticked = False
        self._tasks_reported = self._changes_reported = 0

    @property
    def due(self) -> float:
        return self.robot.agenda.next_time

    @property
    def is_done(self) -> bool:
        return self._ask(lambda: self._manager.is_done) or any(
            task.action == INSPECT and task.result == "completed" for task in self.robot.tasks
        )

    @property
    def actions(self) -> Sequence[RequiredAction]:
        return self.robot.tasks

    @property
    def measured(self) -> Mapping[str, float | None]:
        return self.robot.measured

    def receive(self, message: Message) -> Sequence[DiagnosticProblem]:
        started = perf_counter()
        self.robot.receive(message)
        self._ask(self._manager.receive, message)
        self.compute_s["manager"] += perf_counter() - started
        return ()

    def decide(self) -> bool:
        started = perf_counter()
        self._is_ticked = False
        while self.due <= self._world.now:
            self._ask(self.robot.agenda.happen)
        self.compute_s["manager"] += perf_counter() - started
        self._report()
        return self._is_ticked

    def end(self) -> None:
        if self.robot.task is not None:
            self.robot.end("abandoned", "the mission has ended")
        self._ask(self._manager.close)

    def verdict(self, results: Mapping[str, float | None]) -> Verdict:
        is_low = self.robot.measured.get("battery_level", 1.0) < LOW_LEVEL
        recharges = is_low or any(task.action == "recharge" for task in self.robot.tasks)
        return SEA.judge(self.robot.percepts, results, recharges)

    def _ask(self, what: Callable[..., T], *args: object) -> T:
        try:
            return what(*args)
        except Exception as error:
            said = in_words(error, "suave_env")
            raise MissionError(f"manager {self.manager} failed after {self._world.now:.2f} s: {said}") from error

    def _update(self, time: float) -> None:
        self._manager.update()
        self._is_ticked = True

    def _decide_task(self, time: float) -> None:
        """Begin and end tasks as SUAVE's mission node does: search until the pipeline is found, then inspect it."""
        task = self.robot.task
        if self._manager.decides_tasks:
            return
        if task is None:
            self._begin(SEARCH)
        elif task == SEARCH and self.robot.percepts.holds("pipeline_found"):
            self._end(SEARCH)
            self._begin(INSPECT)
        elif task == INSPECT and self.robot.percepts.holds("pipeline_inspected"):
            self._end(INSPECT)

    def _begin(self, task: str) -> None:
        self.robot.begin(task)
        self._manager.begin(task)

    def _end(self, task: str) -> None:
        self.robot.end("completed")
        self._manager.end(task)

    def _report(self) -> None:
        """Tell the listeners what has been done since the last time."""
        if not self.listeners:
            return
        tasks, changes = self.robot.tasks, self._world.history
        said = [(task.start, f"{task.action} is begun") for task in tasks[self._tasks_reported :]]
        said += [(change.time, str(change)) for change in changes[self._changes_reported :]]
        self._tasks_reported, self._changes_reported = len(tasks), len(changes)
        for time, text in sorted(said):
            for listener in self.listeners:
                listener.action(text, time)


def _checked(period_s: float) -> float:
    if not 0 < period_s < inf:
        raise MissionError(f"period_s is {period_s!r}; allowed is a number of seconds above 0")
    return period_s
