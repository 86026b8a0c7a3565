"""The base of managers of the sea's vehicle: what they know of it, and how they act on it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING, ClassVar

from kb import DiagnosticProblem, RequiredAction
from missions.engine.mission import SEA_MANAGERS, Message, Mission, MissionError, Verdict
from missions.engine.runner import MissionRun

if TYPE_CHECKING:
    from missions.suave.world import Sea

MEASUREMENTS = ("ea measurement", "qa status")
COMPONENT_STATUS = "component status"
SEARCH, INSPECT = "search_pipeline", "inspect_pipeline"
_UNTIL = {SEARCH: "pipeline_found", INSPECT: "pipeline_inspected"}
LOW_LEVEL = 0.25


class Manager(MissionRun):
    """Configures the sea's vehicle for the task that is under way.

    Run with `rosa run suave --manager package:Class`.

    By default tasks are those of SUAVE's mission node: search until the pipeline is found, then
    inspect it. A manager that decides about tasks itself sets `decides_tasks`, and calls
    `begin_task` and `end_task`. Published options are among the results.

    Attributes:
        period_s: time between two updates [s]; the first update comes at a random time within one
            period.
        managed: takes the commands, see `kb.ManagedSystem`; for every manager one takes as long as
            the settings of the sea say.
        constants: those of the sea and of SUAVE's nodes.
        measured: last published number by key, e.g. {"water_visibility": 3.1, "battery_level":
            0.9}.
        reported: last published word by component, e.g. {"c_thruster_1": "FALSE"}.
        actions: all tasks that were begun, in order.
        agenda: the events to come, by time.

    Raises:
        MissionError: the manager raises an error, here or later; the message has its name, the time
            and the line.
    """

    tasks = ("bt",)
    decides_tasks: ClassVar[bool] = False
    world: "Sea"

    @classmethod
    def refusal(cls, mission: Mission) -> str:
        if mission.world.managers is SEA_MANAGERS:
            return ""
        return (
            f"{cls.__name__} commands the sea's vehicle, and {mission.name} does not happen in "
            "the sea; make it a subclass of missions.baselines.Policy"
        )

    def setup(self) -> None:
        from suave_env.components import Agenda

        self.task = "tree of the manager" if self.decides_tasks else "mission node"
        published = [option.name for option in self.options if option.is_published]
        self.inputs = {f"input_from_paper_{name}": self.values[name] for name in published}
        self.managed = self.world.managed
        self.constants = self.world.settings
        self.measured: dict[str, float] = {}
        self.reported: dict[str, str] = {}
        self.actions: list[RequiredAction] = []
        self.agenda = Agenda()
        self._is_ticked = False
        self._changes_told = 0
        if not 0 < self.period_s < inf:
            raise MissionError(
                f"manager {self.manager}: period_s is {self.period_s!r}; "
                "allowed is a number of seconds above 0"
            )
        for period_s, what in (
            (self.constants.mission_period_s, self._decide_task),
            (self.period_s, self._update),
        ):
            self.agenda.every(period_s, float(self.rng.random()) * period_s, what)

    # ---------------------------------------------------------------- what a manager overrides

    @property
    def period_s(self) -> float:
        return 0.1

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

    # ---------------------------------------------------------------- what a manager calls

    @property
    def now(self) -> float:
        return self.world.now

    @property
    def doing(self) -> str | None:
        """The task that is under way; None if there is none."""
        last = self.actions[-1] if self.actions else None
        return last.action if last and last.end is None else None

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

    def begin_task(self, task: str) -> None:
        """Record that a task begins; whoever decides about tasks calls it.

        ValueError while one is under way.
        """
        if self.doing is not None:
            raise ValueError(f"cannot begin {task}: {self.doing} is being done; end it first")
        self.actions.append(RequiredAction(task, None, self.now))
        self.act(f"{task} is begun", self.now)

    def end_task(self, result: str, reason: str = "") -> None:
        """Record that the task has ended: "completed", "abandoned" or "failed".

        ValueError if there is none.
        """
        if self.doing is None:
            raise ValueError("no task is being done that could end; begin one first")
        self.actions[-1] = replace(self.actions[-1], end=self.now, result=result, reason=reason)

    # ---------------------------------------------------------------- the run

    @property
    def due(self) -> float:
        return self.agenda.next_time

    @property
    def is_done(self) -> bool:
        return any(task.action == INSPECT and task.result == "completed" for task in self.actions)

    def hear(self, message: Message) -> Sequence[DiagnosticProblem]:
        for status in message["status"]:
            text = status["message"].casefold()
            for key, value in status["values"].items():
                if text in MEASUREMENTS:
                    self.measured[key] = float(value)
                elif text == COMPONENT_STATUS:
                    self.reported[key] = value
        self.percepts.receive(message)
        self.receive(message)
        return ()

    def decide(self) -> bool:
        for change in self.world.history[self._changes_told :]:
            self._changes_told += 1
            self.act(str(change), change.time)
        self._is_ticked = False
        while self.due <= self.now:
            self.agenda.happen()
        return self._is_ticked

    def release(self) -> None:
        """Release all resources; called at the end of a run, also if it failed."""
        if self.doing is not None:
            self.end_task("abandoned", "the mission has ended")

    def verdict(self, results: Mapping[str, float | None]) -> Verdict:
        from missions.suave.world import SEA  # no other mission imports that

        is_low = self.measured.get("battery_level", 1.0) < LOW_LEVEL
        recharges = is_low or any(task.action == "recharge" for task in self.actions)
        return SEA.judge(self.percepts, results, recharges)

    def _update(self, time: float) -> None:
        self.update()
        self._is_ticked = True

    def _decide_task(self, time: float) -> None:
        """Begin and end tasks as SUAVE's mission node does: search until found, then inspect."""
        if self.decides_tasks:
            return
        task = self.doing
        if task is not None and self.percepts.holds(_UNTIL.get(task, "")):
            self.end_task("completed")
            self.end(task)
        elif task is not None:
            return
        if task != INSPECT:
            following = INSPECT if task else SEARCH
            self.begin_task(following)
            self.begin(following)
