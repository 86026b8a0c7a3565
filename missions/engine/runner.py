"""One run of a mission: a world and what decides in it, in lock-step with the world's clock."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import closing
from functools import partial
from math import inf
from numbers import Real
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal

from py_trees.common import Status
from py_trees.trees import BehaviourTree

from kb import (
    ConfigurationManager,
    DiagnosticProblem,
    Event,
    EventKind,
    KnowledgeBase,
    Model,
    RequiredAction,
)
from kb import Planner as ConfigurationPlanner
from missions.engine.adaptations import Adaptation, AdaptationLog, plans_after
from missions.engine.faults import FaultInjector
from missions.engine.mission import (
    NO_SUCCESS,
    TIME_LIMIT,
    Mission,
    MissionError,
    Sample,
    Verdict,
    World,
    blamed,
    built,
    load,
    needs,
    split_settings,
)
from missions.engine.percepts import Message, Percepts, check_message
from missions.engine.settings import RunSettings, Setting
from missions.engine.task_layer import TASK_KINDS, build_task, check_task
from rosa_bt import TreeRunner
from rosa_pddl import PlanRecord

if TYPE_CHECKING:
    from numpy.random import Generator

OURS: Final = "ours"
"""The manager name of our own: knowledge base, configuration manager, and either task layer."""
POLICIES: Final = {
    OURS: "missions.engine.runner:RosaRun",
    "none": "missions.baselines.policies:Unmanaged",
    "random": "missions.baselines.policies:Random",
    "fixed": "missions.baselines.policies:Fixed",
}
"""Where the managers of every mission are defined."""
SAMPLE_PERIOD_S: Final = 0.5
STANDSTILL: Final = 10_000
"""A world stands still if it is asked this often to go on and less than a millisecond passes."""


class Listener:
    """Is notified of a run as it happens; a subclass overrides the methods that it needs."""

    def message(self, message: Message) -> None:
        """Called with each message that was published."""

    def problem(self, problem: DiagnosticProblem, time_s: float) -> None:
        """Called with each part of a message that could not be used."""

    def adaptation(self, adaptation: Adaptation) -> None:
        """Called when an adaptation is in force or has failed."""

    def action(self, text: str, time_s: float) -> None:
        """Called when an action is requested or ends."""

    def plan(self, plan: PlanRecord, time_s: float) -> None:
        """Called with each task plan, and with each failure to find one."""

    def tick(self, run: "MissionRun") -> None:
        """Called after each decision."""

    def sample(self, sample: Sample | None) -> None:
        """Called with what can be seen of the world, if that is anything, twice a second."""


class MissionRun(ABC):
    """One run of a mission, to its end; a subclass is a manager, and says what is decided.

    In each turn it advances the world to the next message, or to the time of the next decision,
    receives the messages, and decides.

    Attributes:
        tasks: names of the task layers that the manager goes with.
        options: settings of the manager that can be set from outside; see `values`.
        task: the name of its task layer.
        manager: its name, as in `rosa run --manager`.
        rng: random generator of the manager, its only source of chance.
        values: values of the manager's options by name.
        model: of the mission, with all amendments so far.
        percepts: what the task layer perceives besides what the knowledge base knows.
        actions: all actions that were requested.
        measured: the last measurement of each attribute; None if there is none.
        tree: the tree that is ticked; None if there is none.
        problems: parts of messages that could not be used, with their times [s].
        faults: the faults that are injected.
        inputs: figures of published results that the manager uses, by name.
        listeners: those that are notified.
        early_verdict: if set, the run ends at once with this verdict.
        findings: what may be mistakes in the PDDL, as sentences; complete at the end.
        adaptations: all so far, in the order in which they were decided.
        is_stuck: whether nothing can be done any more; the mission then ends and is judged.
        plans: the task plans so far, in order; empty if nothing plans.
    """

    tasks: ClassVar[tuple[str, ...]] = TASK_KINDS
    options: ClassVar[tuple[Setting, ...]] = ()
    rng: "Generator"
    actions: Sequence[RequiredAction]
    measured: Mapping[str, float | None]
    tree: BehaviourTree | None = None
    early_verdict: Verdict | None = None
    is_stuck = False
    inputs: Mapping[str, float] = {}
    findings: Sequence[str] = ()
    plans: tuple[PlanRecord, ...] = ()
    listeners: Sequence[Listener] = ()

    def __init__(
        self,
        mission: Mission,
        task: str,
        world: World,
        settings: RunSettings,
        manager: str = OURS,
        rng: Any = None,  # noqa: ANN401  # only a replay has none
        values: Mapping[str, Any] | None = None,
    ) -> None:
        self.mission = mission
        self.task = task
        self.world = world
        self.settings = settings
        self.manager = manager
        self.rng = rng
        self.values = values or {}
        self.percepts = Percepts()
        self.model = self.build_model()
        self.faults = FaultInjector(self.model, settings.duration_s)
        self.problems: list[tuple[float, DiagnosticProblem]] = []
        self.adaptations: list[Adaptation] = []
        self._moved_s = -inf
        self._turns = 0
        self._check_time(-inf)
        self._sampled_s = -SAMPLE_PERIOD_S
        self.setup()

    @classmethod
    def refusal(cls, mission: Mission) -> str:
        """Return why this manager cannot manage a mission; empty if it can."""
        if cls is RosaRun or not mission.selects:
            return ""
        title = f"the task layer of mission {mission.name}"
        return f"{title} selects configurations; run it under {OURS}"

    def build_model(self) -> Model:
        """Return the model to decide with."""
        return built(f"the model of mission {self.mission.name}", Model, self.mission.model)

    @abstractmethod
    def setup(self) -> None:
        """Make what decides; called when the run is opened."""

    def listen(self, *listeners: Listener) -> None:
        """Add listeners."""
        self.listeners = (*self.listeners, *listeners)

    @property
    def kb(self) -> KnowledgeBase:
        """The knowledge base.

        Raises:
            MissionError: the manager has none.
        """
        raise MissionError(f"manager {self.manager} has no knowledge base")

    @property
    @abstractmethod
    def due(self) -> float:
        """When it decides next even if nothing is published until then [s]."""

    @property
    @abstractmethod
    def is_done(self) -> bool:
        """Whether the mission is over."""

    @abstractmethod
    def hear(self, message: Message) -> Sequence[DiagnosticProblem]:
        """Process a message; return the parts of it that cannot be used."""

    @abstractmethod
    def decide(self) -> bool:
        """React to what was received, and do what is due; return whether something was due."""

    @abstractmethod
    def release(self) -> None:
        """Release everything; called once, however the run ends."""

    @abstractmethod
    def verdict(self, results: Mapping[str, float | None]) -> Verdict:
        """Return how the mission has ended; called when it is over."""

    def ask(self, method: str) -> Any:  # noqa: ANN401  # the type depends on the method
        """Call results, reactions, sample, disturbances or scenery of the world.

        Raises:
            MissionError: it raises; the message names it.
        """
        title = f"{method}() of {type(self.world).__name__}"
        with blamed(lambda: f"{title} failed after {self.world.now:.1f} s"):
            return getattr(self.world, method)()

    def disturbances(self) -> list[tuple[float, str]]:
        """Return what truly happened or was injected, and when [s], in order of time."""
        injected = [(fault.time, fault.words) for fault in self.faults.injected]
        return sorted([*self.ask("disturbances"), *injected], key=lambda entry: entry[0])

    def results(self) -> Mapping[str, float | None]:
        """Return the mission's figures up to now, units in the names, including `inputs`."""
        return {**self.ask("results"), **self.inputs}

    def run(self) -> Verdict:
        """Run until the mission is done, stuck or out of time; close the world and all else.

        Raises:
            MissionError: the world lets no time pass, or code of the mission raises; the message
                names it.
        """
        world = self.world
        duration_s = self.settings.duration_s
        title = f"mission {self.mission.name} under manager {self.manager} failed after"

        with (
            blamed(lambda: f"{title} {world.now:.2f} s", is_authors=False),
            closing(world),
        ):
            try:
                while not (self.early_verdict or self.is_stuck or self.is_done):
                    if world.now >= duration_s:
                        break
                    self._turn()
            finally:
                self.release()
        if self.early_verdict:
            return self.early_verdict
        verdict = self.verdict(self.results())
        # the time limit may be a success of its own, but not before the time is over
        is_short = verdict.outcome in (*NO_SUCCESS, TIME_LIMIT)
        if is_short and self.is_done and world.now < duration_s:
            ended = f"the task ended after {world.now:.1f} s of {duration_s:g} s"
            return Verdict("ended_early", f"{ended}, short of the mission's goal")
        return verdict

    def _turn(self) -> None:
        """Let the world go on to the next message, or to when something is due, and react."""
        messages = self._advance(min(self.due, self.settings.duration_s))
        for message in self.faults.alter(messages, self.world.now):
            self._receive(message)
        if self.decide() and self.listeners:
            self._sample()
            for listener in self.listeners:
                listener.tick(self)

    def act(self, text: str, time_s: float) -> None:
        """Notify the listeners that an action is requested or ends."""
        for listener in self.listeners:
            listener.action(text, time_s)

    def _advance(self, until: float) -> Sequence[Message]:
        """Advance the world; return its messages, which are checked, as is its clock."""
        before = self.world.now
        title = f"the world of mission {self.mission.name}"
        method = f"advance() of {type(self.world).__name__}"
        with blamed(lambda: f"{title} failed after {before:.1f} s"):
            messages = self.world.advance(until)
        if not isinstance(messages, list):
            expected = "a list of messages, empty if there are none"
            raise MissionError(f"{method} gives {messages!r:.100}; expected is {expected}")
        for message in messages:
            check_message(message, method)
        self._check_time(before)
        if self.world.now >= self._moved_s + 1e-3:
            self._moved_s = self.world.now
            self._turns = 0
        self._turns += 1
        if self._turns > STANDSTILL:
            raise MissionError(
                f"{title} stands still at {before:.3f} s, asked to go on to {until:.3f} s; "
                "advance() goes on until something is published, a command ends, or to that time"
            )
        return messages

    def _check_time(self, before: float) -> None:
        now: Any = self.world.now
        if not (isinstance(now, Real) and before <= float(now) < inf):
            title = f"now of {type(self.world).__name__} shows {now!r} after {before!r} s"
            raise MissionError(f"{title}; expected is the time [s], and it has to pass")

    def _receive(self, message: Message) -> None:
        problems = self.hear(message)
        time_s = float(message["time"])
        self.problems += [(time_s, problem) for problem in problems]
        for listener in self.listeners:
            listener.message(message)
            for problem in problems:
                listener.problem(problem, time_s)

    def _sample(self) -> None:
        """Notify the listeners of what can be seen, if that is due."""
        now = self.world.now
        if now < self._sampled_s + SAMPLE_PERIOD_S - 1e-9:
            return
        self._sampled_s = now
        sample = self.ask("sample")
        for listener in self.listeners:
            listener.sample(sample)


class RosaRun(MissionRun):
    """The run of our own: the knowledge base, the configuration manager and the task layer.

    Attributes:
        on_error: as of `rosa_bt.TreeRunner`: a behaviour that raises fails, or the run raises.
        planner: chooses the configurations; None: by priority.

    Raises:
        MissionError, rosa_pddl.RosaPddlError, kb.KnowledgeBaseError: the mission cannot be run.
    """

    tree: BehaviourTree
    on_error: ClassVar[Literal["fail", "raise"]] = "fail"
    planner: ConfigurationPlanner | None = None

    def setup(self) -> None:
        self._kb = KnowledgeBase(self.model, clock=self._now)
        self._manager = ConfigurationManager(self._kb, self.world.managed, planner=self.planner)
        self._task = build_task(self.task, self.mission, self._kb, self.percepts, self.settings)
        self._log = AdaptationLog(self._kb, self._on_adaptation)
        self.adaptations = self._log.adaptations
        self._runner = TreeRunner(
            self._task.root,
            clock=self._now,
            period=self.settings.tick_period_s,
            on_error=self.on_error,
        )
        self.tree = self._runner.tree
        self.tree.setup()
        self._kb.subscribe(self._on_event)
        self._revision = -1
        self._last_plan: PlanRecord | None = None
        self._under_way = ""

    @property
    def kb(self) -> KnowledgeBase:
        return self._kb

    @property
    def due(self) -> float:
        return self._runner.due

    @property
    def is_done(self) -> bool:
        return self._runner.status is Status.SUCCESS

    @property
    def actions(self) -> Sequence[RequiredAction]:  # type: ignore[override]  # read-only here
        return self._kb.history.actions

    @property
    def measured(self) -> Mapping[str, float | None]:  # type: ignore[override]  # read-only here
        return {name: view.value for name, view in self._kb.attributes.items()}

    @property
    def plans(self) -> tuple[PlanRecord, ...]:  # type: ignore[override]  # read-only here
        return self._task.plans()

    def hear(self, message: Message) -> Sequence[DiagnosticProblem]:
        problems = self._kb.receive(message)
        for key in self.percepts.receive(message):
            self._log.sensed(f"{key} is {str(self.percepts.holds(key)).lower()}")
        return problems

    def decide(self) -> bool:
        is_due = self._now() >= self._runner.due
        if is_due or self._kb.revision != self._revision or self._kb.pending_plan is not None:
            # between ticks, only a changed status or an open plan needs the manager
            self._manager.update()
            self._settle()
        self._task.catch_up()
        if is_due:
            self._log.ticking(self._now())
        self._log.is_listening = False
        is_ticked = is_due and self._runner.update()
        self._log.is_listening = True
        if is_ticked and self._kb.revision != self._revision:
            self._manager.update()
        if is_ticked:
            self._settle()
        if is_ticked and self.world.is_still and self._kb.pending_plan is None:
            self.is_stuck = bool(self.mission.why_not(self._kb, self.percepts))
        return is_ticked

    def release(self) -> None:
        try:
            if not self.is_done:
                self._log.finish()
            self.findings = self._task.findings()
            self._under_way = " and ".join(
                f"{required.action} since {required.start:.1f} s"
                for required in self._kb.required_actions
            )
        finally:
            self._runner.shutdown()
            self._task.close()

    def verdict(self, results: Mapping[str, float | None]) -> Verdict:
        kind = self.mission.world
        title = f"what verdict() of {type(kind).__name__} gives"
        verdict = built(title, Verdict, partial(kind.verdict, self.percepts, results, self._kb))
        more = "" if verdict.success else self._shortcoming()
        reason = "; ".join(filter(None, (verdict.reason, more)))
        return Verdict(verdict.outcome, reason, verdict.detail)

    def _shortcoming(self) -> str:
        """Return what kept the run from the goal, in words, as far as the records show it."""
        if self._under_way:
            return f"under way: {self._under_way}"
        plan = self.plans[-1] if self.plans and self._task.is_planned else None
        if plan is not None and not plan.outcome.is_solved:
            return f"there was no plan: {plan.outcome}"
        for required in reversed(self._kb.history.actions):
            if required.result == "failed":
                return f"{required.action} failed last: {required.reason or 'no reason given'}"
        return ""

    def _now(self) -> float:
        return self.world.now

    def _settle(self) -> None:
        """Enter what was decided since the last time, and notify the listeners of task plans."""
        plans = plans_after(self._last_plan, self.plans)
        self._log.settle(plans if self._task.is_planned else ())
        self._revision = self._kb.revision
        for plan in plans:
            self._last_plan = plan
            for listener in self.listeners:
                listener.plan(plan, self.world.now)
            if plan.outcome.is_trouble and self._task.is_planned:  # a tree goes on without a plan
                reason = f"no plan, {plan.outcome}: {plan.engine}"
                self.early_verdict = Verdict("aborted", reason, plan.message)

    def _on_adaptation(self, adaptation: Adaptation) -> None:
        for listener in self.listeners:
            listener.adaptation(adaptation)

    def _on_event(self, event: Event) -> None:
        if event.kind is EventKind.ACTION_UPDATE:
            self.act(event.text, event.time)


# ---------------------------------------------------------------- managers, and opening a run


def find_manager(name: str | type[MissionRun], mission: Mission) -> type[MissionRun]:
    """Return the class of a manager by its name, by "package:Class", or as the class itself.

    Raises:
        MissionError: no such manager, or it does not go with the mission; lists those that exist.
    """
    manager: Any = name
    if isinstance(name, str):
        homes = {**POLICIES, **mission.world.managers}
        own = "one of your own is given as package:Class"
        manager = load("manager", name, homes, f"{', '.join(homes)} in {mission.name}; {own}")
    if not (isinstance(manager, type) and issubclass(manager, MissionRun)):
        title = getattr(name, "__name__", name)
        raise MissionError(f"{title!r} is no subclass of missions.baselines.Policy or Manager")
    refusal = manager.refusal(mission)
    if refusal:
        raise MissionError(refusal)
    return manager


def open_run(
    mission: Mission,
    *,
    manager: str | type[MissionRun] = OURS,
    task: str | None = None,
    seed: int = 0,
    settings: Mapping[str, str] | None = None,
) -> MissionRun:
    """Open a run; the same mission, seed and settings give the same world under every manager.

    Args:
        mission: what to run.
        manager: the name of a manager, "package:Class", or the class itself.
        task: our task layer, "bt" or "pddl", by default the mission's; some managers have none.
        seed: seed of all chance in the run.
        settings: values that differ from the defaults; a unit at the end of a name may be left out.

    Raises:
        MissionError: no such manager, task layer or setting, or they do not go together.
    """
    import numpy

    kind = find_manager(manager, mission)
    name = manager if isinstance(manager, str) else f"{kind.__module__}:{kind.__qualname__}"
    if task is None:
        task = kind.tasks[-1 if mission.tree is None else 0]
    check_task(task)
    if task not in kind.tasks:
        raise MissionError(
            f"--task {task} is a task layer of ours; --manager {name} comes without one"
        )
    run_settings, world_settings, values = split_settings(mission, settings or {}, kind.options)
    rng = numpy.random.default_rng(seed)

    def open_world() -> object:
        with needs("sim", f"the world of {mission.name}"):
            return mission.world.open(world_settings, rng)

    title = f"what open() of {type(mission.world).__name__} gives"
    world = built(title, World, open_world)  # type: ignore[type-abstract]  # only for isinstance
    try:
        with blamed(lambda: f"mission {mission.name} under manager {name}", is_authors=False):
            chance = rng.spawn(1)[0]
            return kind(mission, task, world, run_settings, name, chance, values)
    except BaseException:
        world.close()
        raise
