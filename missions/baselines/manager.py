"""What a manager of the sea's vehicle is, the few lines to write for one of your own, and a run under it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING, ClassVar, TypeVar

from kb import DiagnosticProblem, RequiredAction
from missions.engine.mission import Message, Mission, MissionError, Percepts, Verdict
from missions.engine.runner import Listener, MissionRun
from missions.engine.settings import RunSettings, Setting
from rosa_bt.exceptions import in_words

if TYPE_CHECKING:
    from numpy.random import Generator

    from missions.suave.world import Sea


MEASUREMENTS = ("ea measurement", "qa status")
COMPONENT_STATUS = "component status"


class Robot:
    """What a manager knows of the vehicle, and how it acts on it.

    Components are asked to become active, inactive or to take parameters; that takes as long as the settings of the
    sea say, whoever asks for it. `is_active` and `parameters` say what is in force by now: see `kb.ManagedSystem`.

    Attributes:
        mission: what is to be done: its model, its tree.
        settings: the constants of the sea and of SUAVE's nodes.
        rng: all the manager's chance.
        options: values of the manager's options by name.
        measured: last published number by key, e.g. {"water_visibility": 3.1, "battery_level": 0.9}.
        reported: last published word by component, e.g. {"c_thruster_1": "FALSE"}.
        percepts: what else was published, e.g. whether it `holds("pipeline_found")`.
        deadline_s: when the mission ends at the latest [s].
        way_m: says how far it is from the station, by its own odometry [m].
        tasks: every task that was begun, in order.
        agenda: what is to happen when.
    """

    def __init__(
        self, mission: Mission, world: "Sea", rng: "Generator", options: Mapping[str, float], deadline_s: float
    ) -> None:
        from suave_env.components import Agenda

        self.mission, self.settings, self.rng, self.options = mission, world.settings, rng, options
        self.deadline_s, self.way_m = deadline_s, world.way_m
        self.measured: dict[str, float] = {}
        self.reported: dict[str, str] = {}
        self.percepts = Percepts()
        self.tasks: list[RequiredAction] = []
        managed = world.managed
        self.activate, self.deactivate, self.is_active = managed.activate, managed.deactivate, managed.is_active
        self.set_parameters, self.parameters = managed.set_parameters, managed.parameters
        self._world, self.agenda = world, Agenda()

    @property
    def now(self) -> float:
        return self._world.now

    @property
    def task(self) -> str | None:
        """The task that is being done."""
        return self.tasks[-1].action if self.tasks and self.tasks[-1].end is None else None

    def later(self, delay_s: float, what: Callable[[], None]) -> None:
        """Have something called after a delay [s]: how a manager takes time without waiting.

        Raises:
            MissionError: the delay is no number from 0 on.
        """
        if not 0 <= delay_s < inf:
            raise MissionError(f"cannot put something off by {delay_s!r} s; allowed is a number from 0")
        self.agenda.at(self.now + delay_s, lambda time: what())

    def begin(self, task: str) -> None:
        """Take down that a task is begun; called by whoever decides about tasks, and refused while one is done."""
        if self.task is not None:
            raise MissionError(f"cannot begin {task}: {self.task} is being done; end it first")
        self.tasks.append(RequiredAction(task, None, self.now))

    def end(self, result: str, reason: str = "") -> None:
        """Take down that the task has ended: "completed", "abandoned" or "failed"."""
        if self.task is None:
            raise MissionError("no task is being done that could end; begin one first")
        self.tasks[-1] = replace(self.tasks[-1], end=self.now, result=result, reason=reason)

    def receive(self, message: Message) -> None:
        for status in message["status"]:
            text = status["message"].casefold()
            for key, value in status["values"].items():
                if text in MEASUREMENTS:
                    self.measured[key] = float(value)
                elif text == COMPONENT_STATUS:
                    self.reported[key] = value
        self.percepts.receive(message)


class Manager:
    """Keeps the vehicle configured for the task that is being done; run with `rosa run suave --manager package:Class`.

    By default the mission is that of SUAVE's mission node: search until the pipeline is found, then inspect it. A
    manager that decides about tasks itself says so in `decides_tasks`, and calls `robot.begin` and `robot.end`.

    Attributes:
        robot: what is managed.
        period_s: from one update to the next [s]; the first comes at a moment of chance within it.
        options: numbers that can be set from outside; their values are in `robot.options`.
    """

    tasks: ClassVar[tuple[str, ...]] = ("bt",)  # what it brings
    decides_tasks: ClassVar[bool] = False
    options: ClassVar[tuple[Setting, ...]] = ()
    period_s: float = 0.1

    def __init__(self, robot: Robot) -> None:
        self.robot = robot

    def begin(self, task: str) -> None:
        """Configure the vehicle for a task that begins: "search_pipeline" or "inspect_pipeline"."""

    def end(self, task: str) -> None:
        """Undo what was done for a task, which has ended."""

    def receive(self, message: Message) -> None:
        """Hear of what was published, at once."""

    def update(self) -> None:
        """Look at the vehicle and change what needs to be changed; called every `period_s`, and never waits."""

    def close(self) -> None:
        """Let go of everything; the run is over, however it ended."""

    @property
    def is_done(self) -> bool:
        """Whether a manager that decides about tasks has done all of them."""
        return False


SEARCH, INSPECT = "search_pipeline", "inspect_pipeline"
_UNTIL = {SEARCH: "pipeline_found", INSPECT: "pipeline_inspected"}
LOW_LEVEL = 0.25

T = TypeVar("T")


class BaselineRun(MissionRun):
    """Has a manager of the sea's vehicle decide; of its options, those that were published show among the results.

    Raises:
        MissionError: whatever the manager raises, here or later, with its name, the moment and the line.
    """

    def __init__(
        self,
        mission: Mission,
        world: "Sea",
        settings: RunSettings,
        listeners: Sequence[Listener],
        name: str,
        manager: type[Manager],
        rng: "Generator",
        options: Mapping[str, float],
    ) -> None:
        task = "tree of the manager" if manager.decides_tasks else "mission node"
        super().__init__(mission, world, settings, name, task)
        published = [one.name for one in manager.options if one.is_published]
        self.inputs = {f"input_from_paper_{name}": options[name] for name in published}
        self._changes = world.history
        phases = rng.random(2).tolist()
        self.robot = Robot(mission, world, rng, options, settings.duration_s)
        self._manager = self._ask(manager, self.robot)
        mission_s, period_s = world.settings.mission_period_s, self._manager.period_s
        if not 0 < period_s < inf:
            raise MissionError(f"manager {name}: period_s is {period_s!r}; allowed is a number of seconds above 0")
        self.robot.agenda.every(mission_s, phases[0] * mission_s, self._decide_task)
        self.robot.agenda.every(period_s, phases[1] * period_s, self._update)
        self._is_ticked = False
        self._tasks_reported = self._changes_reported = 0
        self.listen(*listeners)

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
        with self.spending("manager"):
            self.robot.receive(message)
            self._ask(self._manager.receive, message)
        return ()

    def decide(self) -> bool:
        self._is_ticked = False
        with self.spending("manager"):
            while self.due <= self.world.now:
                self._ask(self.robot.agenda.happen)
        self._report()
        return self._is_ticked

    def end(self) -> None:
        if self.robot.task is not None:
            self.robot.end("abandoned", "the mission has ended")
        self._ask(self._manager.close)

    def verdict(self, results: Mapping[str, float | None]) -> Verdict:
        is_low = self.robot.measured.get("battery_level", 1.0) < LOW_LEVEL
        recharges = is_low or any(task.action == "recharge" for task in self.robot.tasks)
        from missions.suave.world import SEA  # no other mission imports that

        return SEA.judge(self.robot.percepts, results, recharges)

    def _ask(self, what: Callable[..., T], *args: object) -> T:
        try:
            return what(*args)
        except Exception as error:
            said = in_words(error, "suave_env")
            raise MissionError(f"manager {self.manager} failed after {self.world.now:.2f} s: {said}") from error

    def _update(self, time: float) -> None:
        self._manager.update()
        self._is_ticked = True

    def _decide_task(self, time: float) -> None:
        """Begin and end tasks as SUAVE's mission node does: search until the pipeline is found, then inspect it."""
        robot, manager = self.robot, self._manager
        if manager.decides_tasks:
            return
        task = robot.task
        if task is not None and robot.percepts.holds(_UNTIL.get(task, "")):
            robot.end("completed")
            manager.end(task)
        elif task is not None:
            return
        if task != INSPECT:
            following = INSPECT if task else SEARCH
            robot.begin(following)
            manager.begin(following)

    def _report(self) -> None:
        """Tell the listeners what has been done since the last time."""
        if not self.listeners:
            return
        tasks, changes = self.robot.tasks, self._changes
        said = [(task.start, f"{task.action} is begun") for task in tasks[self._tasks_reported :]]
        said += [(change.time, str(change)) for change in changes[self._changes_reported :]]
        self._tasks_reported, self._changes_reported = len(tasks), len(changes)
        for time, text in sorted(said):
            for listener in self.listeners:
                listener.action(text, time)
