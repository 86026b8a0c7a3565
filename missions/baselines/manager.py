"""The base of managers of the sea's vehicle, what a manager knows, and a run under it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING, ClassVar, cast

from kb import DiagnosticProblem, RequiredAction
from missions.engine.mission import (
    SEA_MANAGERS,
    Message,
    Mission,
    MissionError,
    Percepts,
    Verdict,
)
from missions.engine.runner import ManagerBase, MissionRun, Opening

if TYPE_CHECKING:
    from missions.suave.world import Sea

MEASUREMENTS = ("ea measurement", "qa status")
COMPONENT_STATUS = "component status"


class Robot:
    """What a manager knows of the vehicle, and how it acts on it.

    `activate`, `deactivate` and `set_parameters` ask a component for a change; for every manager it
    takes as long as the settings of the sea say. `is_active` and `parameters` return what is in
    force now: see `kb.ManagedSystem`.

    Attributes:
        mission: the mission that is run, with its model and its tree.
        settings: the constants of the sea and of SUAVE's nodes.
        rng: random generator of the manager, its only source of chance.
        options: values of the manager's options by name.
        measured: last published number by key, e.g. {"water_visibility": 3.1, "battery_level":
            0.9}.
        reported: last published word by component, e.g. {"c_thruster_1": "FALSE"}.
        percepts: what else was published, e.g. whether `percepts.holds("pipeline_found")`.
        deadline_s: latest end of the mission [s].
        history: all changes of components.
        way_m: function that returns the distance to the station by odometry [m].
        tasks: all tasks that were begun, in order.
        agenda: the events to come, by time.
    """

    def __init__(self, opening: Opening) -> None:
        from suave_env.components import Agenda

        world = cast("Sea", opening.world)  # else `Manager.refusal` has refused the mission
        self.mission = opening.mission
        self.settings = world.settings
        self.rng = opening.rng
        self.options = opening.options
        self.deadline_s = opening.settings.duration_s
        self.way_m = world.way_m
        self.measured: dict[str, float] = {}
        self.reported: dict[str, str] = {}
        self.percepts = Percepts()
        self.tasks: list[RequiredAction] = []
        self.history = world.history
        managed = world.managed
        self.activate = managed.activate
        self.deactivate = managed.deactivate
        self.is_active = managed.is_active
        self.set_parameters = managed.set_parameters
        self.parameters = managed.parameters
        self._world = world
        self.agenda = Agenda()

    @property
    def now(self) -> float:
        return self._world.now

    @property
    def task(self) -> str | None:
        """The task that is under way; None if there is none."""
        return self.tasks[-1].action if self.tasks and self.tasks[-1].end is None else None

    def later(self, delay_s: float, what: Callable[[], None]) -> None:
        """Call a function after a delay [s]: a manager that takes time uses this, and never waits.

        Raises:
            ValueError: the delay is not a finite number from 0.
        """
        if not 0 <= delay_s < inf:
            raise ValueError(
                f"cannot put something off by {delay_s!r} s; allowed is a number from 0"
            )
        self.agenda.at(self.now + delay_s, lambda time: what())

    def begin(self, task: str) -> None:
        """Record that a task begins; whoever decides about tasks calls it.

        ValueError while one is under way.
        """
        if self.task is not None:
            raise ValueError(f"cannot begin {task}: {self.task} is being done; end it first")
        self.tasks.append(RequiredAction(task, None, self.now))

    def end(self, result: str, reason: str = "") -> None:
        """Record that the task has ended: "completed", "abandoned" or "failed".

        ValueError if there is none.
        """
        if self.task is None:
            raise ValueError("no task is being done that could end; begin one first")
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


class Manager(ManagerBase):
    """Configures the vehicle for the task that is under way.

    Run with `rosa run suave --manager package:Class`.

    By default tasks are those of SUAVE's mission node: search until the pipeline is found, then
    inspect it. A manager that decides about tasks itself sets `decides_tasks`, and calls
    `robot.begin` and `robot.end`.

    Attributes:
        tasks: names of the task layers that it goes with.
        robot: the vehicle that it manages.
        period_s: time between two updates [s]; the first update comes at a random time within one
            period.
        options: numbers that can be set from outside; their values are in `robot.options`.
    """

    tasks: ClassVar[tuple[str, ...]] = ("bt",)
    decides_tasks: ClassVar[bool] = False
    period_s: float = 0.1

    @classmethod
    def refusal(cls, mission: Mission) -> str:
        if mission.world.managers is SEA_MANAGERS:
            return ""
        return (
            f"{cls.__name__} commands the sea's vehicle, and {mission.name} does not happen in "
            "the sea; make it a subclass of missions.baselines.Policy"
        )

    @classmethod
    def open(cls, opening: Opening) -> "BaselineRun":
        return BaselineRun(opening, cls)

    def __init__(self, robot: Robot) -> None:
        self.robot = robot

    def begin(self, task: str) -> None:
        """Configure the vehicle for a task.

        Called when "search_pipeline" or "inspect_pipeline" begins.
        """

    def end(self, task: str) -> None:
        """Undo the configuration for a task; called when the task has ended."""

    def receive(self, message: Message) -> None:
        """Take in a message; called when it is published."""

    def update(self) -> None:
        """Change what needs to be changed; called every `period_s`, and must not wait."""

    def close(self) -> None:
        """Release all resources; called at the end of a run, also if it failed."""

    @property
    def is_done(self) -> bool:
        """Whether all tasks are done; for a manager that decides about tasks."""
        return False


SEARCH, INSPECT = "search_pipeline", "inspect_pipeline"
_UNTIL = {SEARCH: "pipeline_found", INSPECT: "pipeline_inspected"}
LOW_LEVEL = 0.25


class BaselineRun(MissionRun):
    """A run in which a manager of the sea's vehicle decides.

    Its published options are among the results.

    Raises:
        MissionError: the manager raises an error, here or later; the message has its name, the time
            and the line.
    """

    def __init__(self, opening: Opening, manager: type[Manager]) -> None:
        task = "tree of the manager" if manager.decides_tasks else "mission node"
        super().__init__(opening.mission, opening.world, opening.settings, opening.manager, task)
        options = opening.options
        published = [option.name for option in manager.options if option.is_published]
        self.inputs = {f"input_from_paper_{name}": options[name] for name in published}
        phases = opening.rng.random(2).tolist()
        self.robot = Robot(opening)
        self._manager = manager(self.robot)
        mission_s = self.robot.settings.mission_period_s
        period_s = self._manager.period_s
        if not 0 < period_s < inf:
            raise MissionError(
                f"manager {self.manager}: period_s is {period_s!r}; "
                "allowed is a number of seconds above 0"
            )
        self.robot.agenda.every(mission_s, phases[0] * mission_s, self._decide_task)
        self.robot.agenda.every(period_s, phases[1] * period_s, self._update)
        self._is_ticked = False
        self._tasks_reported = self._changes_reported = 0

    @property
    def due(self) -> float:
        return self.robot.agenda.next_time

    @property
    def is_done(self) -> bool:
        return self._manager.is_done or any(
            task.action == INSPECT and task.result == "completed" for task in self.robot.tasks
        )

    @property
    def actions(self) -> Sequence[RequiredAction]:
        return self.robot.tasks

    @property
    def measured(self) -> Mapping[str, float | None]:
        return self.robot.measured

    def receive(self, message: Message) -> Sequence[DiagnosticProblem]:
        self.robot.receive(message)
        self._manager.receive(message)
        return ()

    def decide(self) -> bool:
        self._is_ticked = False
        while self.due <= self.world.now:
            self.robot.agenda.happen()
        self._report()
        return self._is_ticked

    def end(self) -> None:
        if self.robot.task is not None:
            self.robot.end("abandoned", "the mission has ended")
        self._manager.close()

    def verdict(self, results: Mapping[str, float | None]) -> Verdict:
        is_low = self.robot.measured.get("battery_level", 1.0) < LOW_LEVEL
        recharges = is_low or any(task.action == "recharge" for task in self.robot.tasks)
        from missions.suave.world import SEA  # no other mission imports that

        return SEA.judge(self.robot.percepts, results, recharges)

    def _update(self, time: float) -> None:
        self._manager.update()
        self._is_ticked = True

    def _decide_task(self, time: float) -> None:
        """Begin and end tasks as SUAVE's mission node does: search until found, then inspect."""
        robot = self.robot
        manager = self._manager
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
        """Report the tasks and changes since the last report to the listeners."""
        if not self.listeners:
            return
        tasks = self.robot.tasks
        changes = self.robot.history
        said = [(task.start, f"{task.action} is begun") for task in tasks[self._tasks_reported :]]
        said += [(change.time, str(change)) for change in changes[self._changes_reported :]]
        self._tasks_reported = len(tasks)
        self._changes_reported = len(changes)
        for time, text in sorted(said):
            for listener in self.listeners:
                listener.action(text, time)
