"""One run of a mission: world, knowledge base, manager and task layer, in lock-step with the world's clock."""

from collections import defaultdict
from dataclasses import dataclass, field
from math import nan
from time import perf_counter
from typing import TYPE_CHECKING

from py_trees.common import Status
from py_trees.trees import BehaviourTree

from kb import ConfigurationManager, DiagnosticProblem, Event, EventKind, KnowledgeBase
from missions.engine.adaptations import Adaptation, AdaptationLog
from missions.engine.mission import Message, Mission, Sample, Verdict, World
from missions.engine.percepts import Percepts
from missions.engine.settings import RunSettings
from missions.engine.task_layer import build_task
from rosa_bt import TreeRunner

if TYPE_CHECKING:
    from rosa_pddl import PlanRecord

__all__ = ["Listener", "MissionRun", "Trace"]

SAMPLE_PERIOD_S = 0.5


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
        """Hear that the task layer has been ticked."""


@dataclass(slots=True)
class Trace:
    """What there was to see during a run, for pictures.

    Attributes:
        samples: what was seen, with the action and the configurations of that moment.
        designs: the designs of each of these moments, of required functions that have more than one.
    """

    samples: list[tuple[Sample, str, str]] = field(default_factory=list)
    designs: list[str] = field(default_factory=list)


class MissionRun:
    """Runs a mission to its end.

    Args:
        mission: what to run.
        task: the kind of task layer, "bt" or "pddl".
        world: where it happens.
        settings: how it is run.
        listeners: who hears of it.

    Attributes:
        manager: whose run it is, as `rosa run --manager` takes it.
        kb: the knowledge base.
        trace: what was seen.
        compute_s: seconds of this machine's time by part, not part of any decision.
        problems: parts of messages that could not be used, with their times [s].

    Raises:
        MissionError, rosa_pddl.RosaPddlError, kb.KnowledgeBaseError: the mission cannot be run.
    """

    def __init__(
        self,
        mission: Mission,
        task: str,
        world: World,
        settings: RunSettings | None = None,
        listeners: tuple[Listener, ...] = (),
    ) -> None:
        self.manager = "ours"
        self.mission = mission
        self.task = task
        self.world = world
        self.settings = settings or RunSettings()
        self.trace = Trace()
        self.compute_s: defaultdict[str, float] = defaultdict(float)
        self.problems: list[tuple[float, DiagnosticProblem]] = []
        self._listeners = listeners
        self._sampled_at = -SAMPLE_PERIOD_S
        self._plans_heard = 0
        self._answered = -1
        self.kb = KnowledgeBase(mission.model(), clock=self._now)
        self._configurable = [one for one in self.kb.components.values() if one.configurations]
        self._choices = [one for one in self.kb.functions.values() if len(one.designs) > 1]
        self._percepts = Percepts()
        self._manager = ConfigurationManager(self.kb, world.managed)
        delay = self.settings.planning_delay_s
        self._task = build_task(task, mission, self.kb, self._percepts, self._now, delay)
        deciding = self._task.plans if self._task.is_planned else tuple
        self._log = AdaptationLog(self.kb, self._tell_adaptation, deciding)
        self.kb.subscribe(self._hear)
        self._runner = TreeRunner(self._task.root, clock=self._now, period=self.settings.tick_period_s)
        self._runner.tree.setup()

    @property
    def adaptations(self) -> list[Adaptation]:
        """Every adaptation so far, in the order in which they were decided."""
        return self._log.adaptations

    @property
    def plans(self) -> tuple["PlanRecord", ...]:
        """The task plans so far; none for a tree in which nothing plans."""
        return self._task.plans()

    @property
    def tree(self) -> BehaviourTree:
        """The tree of the task layer, for visitors."""
        return self._runner.tree

    def run(self) -> Verdict:
        """Run until the task is done or the time limit is reached; nothing is left running however this ends."""
        trouble: Verdict | None = None
        left = ""
        try:
            while (
                trouble is None
                and self._runner.status is not Status.SUCCESS
                and self.world.now < self.settings.duration_s
            ):
                self._turn()
                trouble = self._hear_plans()
            if self._runner.status is not Status.SUCCESS:
                self._log.finish()
            left = " and ".join(f"{one.action} since {one.start:.1f} s" for one in self.kb.required_actions)
        finally:
            self._runner.shutdown()
            self._task.close()
            self.world.close()
        if trouble is not None:
            return trouble
        verdict = self.mission.world.verdict(self._percepts, self.world.results(), self.kb)
        return verdict if verdict.success else verdict._replace(reason=self._in_full(verdict.reason, left))

    def _in_full(self, reason: str, left: str) -> str:
        """Add to the reason of a failure what was under way, why there was no plan, or why an action failed last."""
        if left:
            return f"{reason}; under way: {left}"
        plan = self.plans[-1] if self.plans and self._task.is_planned else None
        if plan is not None and not plan.outcome.is_solved:
            return f"{reason}; there was no plan: {plan.outcome}"
        failed = next((one for one in reversed(self.kb.action_history) if one.result == "failed"), None)
        return f"{reason}; {failed.action} failed last: {failed.reason or 'no reason told'}" if failed else reason

    def _turn(self) -> None:
        """Let the world go on to the next news or tick, and answer it."""
        spent, started = self.compute_s, perf_counter()
        messages = self.world.advance(min(self._runner.due, self.settings.duration_s))
        advanced = perf_counter()
        for message in messages:
            self._take_in(message)
        told = perf_counter()
        self._manage()
        managed = perf_counter()
        self._task.catch_up()
        caught_up = perf_counter()
        if self.world.now >= self._runner.due:
            self._log.ticking(self.world.now)
        ticked = self._runner.update()
        decided = perf_counter()
        spent["world"] += advanced - started
        spent["knowledge base"] += told - advanced
        spent["manager"] += managed - told
        spent["waiting for plans"] += caught_up - managed
        spent["task layer"] += decided - caught_up
        if ticked:
            if self.kb.revision != self._answered:
                self._manage()
            spent["manager"] += perf_counter() - decided
            self._sample()
            for listener in self._listeners:
                listener.tick(self)

    def _hear_plans(self) -> Verdict | None:
        """Pass on the task plans that are new; end the mission if the planner itself could not do its work."""
        plans = self.plans
        heard, self._plans_heard = self._plans_heard, len(plans)
        for plan in plans[heard:]:
            for listener in self._listeners:
                listener.plan(plan, self.world.now)
            if plan.outcome.is_trouble and self._task.is_planned:  # a tree may have something else to do
                return Verdict("aborted", f"no plan, {plan.outcome}: {plan.engine}", plan.message)
        return None

    def _take_in(self, message: Message) -> None:
        stamp = float(message["time"])
        self._log.news(stamp)
        problems = self.kb.receive(message)
        self._sense(message)
        self._log.news(None)
        for listener in self._listeners:
            listener.message(message)
        for problem in problems:
            self.problems.append((stamp, problem))
            for listener in self._listeners:
                listener.problem(problem, stamp)

    def _sense(self, message: Message) -> None:
        """Pass on what the task layer alone is told, and note what is not so any more, or only now."""
        keys = [key for status in message["status"] for key in status["values"]]
        held = {key: self._percepts.holds(key) for key in keys}
        self._percepts.receive(message)
        for key, before in held.items():
            if self._percepts.holds(key) is not before:
                self._log.sensed(f"{key} is {'false' if before else 'true'}")

    def _manage(self) -> None:
        self._manager.update()
        self._log.settle()
        self._answered = self.kb.revision

    def _now(self) -> float:
        return self.world.now

    def _sample(self) -> None:
        if self.world.now < self._sampled_at + SAMPLE_PERIOD_S - 1e-9:
            return
        self._sampled_at = self.world.now
        sample = self.world.sample() or self._measured()
        action = ", ".join(required.action for required in self.kb.required_actions)
        configured = (one.selected_configuration for one in self._configurable if one.is_active)
        self.trace.samples.append((sample, action, ", ".join(name for name in configured if name)))
        open_choices = [name for one in self._choices if one.is_required for name in one.designs]
        designs = [name for name in open_choices if self.kb.designs[name].is_selected]
        self.trace.designs.append(", ".join(designs))

    def _measured(self) -> Sample:
        """Return what the knowledge base was told, for a world that shows nothing of itself."""
        values = {name: view.value for name, view in self.kb.attributes.items()}
        signals = {name: nan if value is None else value for name, value in values.items()}
        return Sample(self.world.now, (nan, nan, nan), signals)

    def _hear(self, event: Event) -> None:
        if event.kind is EventKind.ACTION_UPDATE:
            for listener in self._listeners:
                listener.action(event.text, event.time)

    def _tell_adaptation(self, adaptation: Adaptation) -> None:
        for listener in self._listeners:
            listener.adaptation(adaptation)
