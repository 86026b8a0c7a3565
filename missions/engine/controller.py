"""Who decides in a run of ours: knowledge base, configuration manager and task layer, a tree or a plan executor."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from inspect import signature
from math import inf
from time import perf_counter
from typing import TYPE_CHECKING, Any, Final

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.decorators import Decorator, FailureIsRunning

from kb import ConfigurationManager, DiagnosticProblem, Event, EventKind, KnowledgeBase, Model, RequiredAction
from kb import Planner as ConfigurationPlanner
from missions.engine.adaptations import Adaptation, AdaptationLog
from missions.engine.mission import Message, Mission, MissionError, Percepts, Verdict, World, built
from missions.engine.runner import Listener, MissionRun
from missions.engine.settings import RunSettings
from rosa_bt import TreeRunner

if TYPE_CHECKING:
    from rosa_pddl import Domain, Planner, PlanRecord, Step

OURS: Final = "ours"
"""The name under which the knowledge base and its configuration manager run, with the task layer that is asked for."""

TASK_KINDS: Final = ("bt", "pddl")


class RosaRun(MissionRun):
    """The knowledge base hears what is published, the manager keeps the architecture right, the task layer decides.

    Args:
        planner: who does; by priority if it is not given.
        hears: returns what is heard of a message.

    Attributes:
        percepts: what the task layer perceives beside what the knowledge base knows.
        tree: what is ticked.

    Raises:
        MissionError, rosa_pddl.RosaPddlError, kb.KnowledgeBaseError: the mission cannot be run.
    """

    def __init__(
        self,
        mission: Mission,
        task: str,
        world: World,
        settings: RunSettings,
        listeners: Sequence[Listener] = (),
        manager: str = OURS,
        planner: ConfigurationPlanner | None = None,
        hears: Callable[[Message], Message] = lambda message: message,
    ) -> None:
        super().__init__(mission, world, settings, manager, task)
        self.percepts = Percepts()
        self._kb = KnowledgeBase(mission.model(), clock=self._now)
        self._manager, self._hears = ConfigurationManager(self._kb, world.managed, planner=planner), hears
        self._task = build_task(task, mission, self._kb, self.percepts, settings.planning_delay_s)
        deciding = self._task.plans if self._task.is_planned else tuple
        self._log = AdaptationLog(self._kb, self._report_adaptation, deciding)
        self.adaptations = self._log.adaptations
        self._runner = TreeRunner(self._task.root, clock=self._now, period=settings.tick_period_s)
        self.tree = self._runner.tree
        self.tree.setup()
        self._may_rest = mission.waits_for_news and task == "bt" and planner is None
        self._statuses: list[Status] = []
        self._rests_at: tuple[int, int] | None = None  # what was known and sensed when it began to rest
        self._is_told = False
        self._answered = -1
        self._left = ""
        self.listen(*listeners)

    @property
    def kb(self) -> KnowledgeBase:
        return self._kb

    @property
    def model(self) -> Model:
        return self._kb.model

    @property
    def due(self) -> float:
        return self._runner.due if self._rests_at is None else inf

    @property
    def is_done(self) -> bool:
        return self._runner.status is Status.SUCCESS

    @property
    def actions(self) -> Sequence[RequiredAction]:
        return self._kb.history.actions

    @property
    def measured(self) -> Mapping[str, float | None]:
        return {name: view.value for name, view in self._kb.attributes.items()}

    @property
    def plans(self) -> tuple["PlanRecord", ...]:
        return self._task.plans()

    def listen(self, *listeners: Listener) -> None:
        if listeners and not self.listeners:
            self._kb.subscribe(self._hear)
        super().listen(*listeners)

    def receive(self, message: Message) -> Sequence[DiagnosticProblem]:
        started = perf_counter()
        if self._rests_at is not None:
            self._log.passed_over(self._runner.put_off(self._now()))
            self._is_told = True
        message = self._hears(message)
        self._log.news(float(message["time"]))
        problems = self._kb.receive(message)
        for key in self.percepts.receive(message):
            self._log.sensed(f"{key} is {str(self.percepts.holds(key)).lower()}")
        self._log.news(None)
        self.compute_s["knowledge base"] += perf_counter() - started
        return problems

    def decide(self) -> bool:
        if self._rests_at is not None and self._goes_on_resting():
            return False
        spent, started = self.compute_s, perf_counter()
        is_due, before = self._now() >= self._runner.due, self._kb.revision
        self._may_rest = self._may_rest and self._now() <= self._runner.due  # else ticks come when the world has time
        if is_due or self._kb.revision != self._answered or self._kb.pending_plan is not None:
            self._manage()  # between two ticks there is nothing to manage where no status changed
        managed = perf_counter()
        self._task.catch_up()
        caught_up = perf_counter()
        if is_due:
            self._log.ticking(self._now())
        is_ticked = is_due and self._runner.update()
        decided = perf_counter()
        if is_ticked and self._kb.revision != self._answered:
            self._manage()
        spent["manager"] += managed - started + perf_counter() - decided
        spent["waiting for plans"] += caught_up - managed
        spent["task layer"] += decided - caught_up
        if is_ticked and self.world.is_still and self._kb.pending_plan is None:
            self.is_stuck = bool(self.mission.why_not(self._kb, self.percepts))
        if is_ticked and self._may_rest:
            self._consider_resting(before)
        return is_ticked

    def _consider_resting(self, before: int) -> None:
        """Rest if the tick has changed nothing, nothing is under way, and nothing changes with time alone."""
        kb, tree = self._kb, self.tree
        known, self._statuses = self._statuses, [one.status for one in tree.root.iterate()]
        if self._statuses != known or kb.revision != before or kb.pending_plan is not None or not self._log.is_at_rest:
            return
        is_watched = bool(self.listeners or tree.visitors or tree.pre_tick_handlers or tree.post_tick_handlers)
        if not is_watched and _is_timeless(kb):
            self._rests_at, self._is_told = (before, self.percepts.revision), False

    def _goes_on_resting(self) -> bool:
        """Whether there is no news, and it is not a command that has ended for which the world has stopped."""
        is_told, self._is_told = self._is_told, False
        if is_told and (self._kb.revision, self.percepts.revision) == self._rests_at and not self.listeners:
            return True
        self._rests_at = None
        self._log.passed_over(self._runner.put_off(self._now()))
        return False

    def end(self) -> None:
        try:
            if not self.is_done:
                self._log.finish()
            self.findings = self._task.findings()
            self._left = " and ".join(f"{one.action} since {one.start:.1f} s" for one in self._kb.required_actions)
        finally:
            self._runner.shutdown()
            self._task.close()

    def verdict(self, results: Mapping[str, float | None]) -> Verdict:
        verdict = self.mission.world.verdict(self.percepts, results, self._kb)
        if verdict.success:
            return verdict
        plan = self.plans[-1] if self.plans and self._task.is_planned else None
        failed = next((one for one in reversed(self._kb.history.actions) if one.result == "failed"), None)
        if self._left:
            more = f"under way: {self._left}"
        elif plan is not None and not plan.outcome.is_solved:
            more = f"there was no plan: {plan.outcome}"
        elif failed:
            more = f"{failed.action} failed last: {failed.reason or 'no reason given'}"
        else:
            return verdict
        return Verdict(verdict.outcome, f"{verdict.reason}; {more}", verdict.detail)

    def _now(self) -> float:
        return self.world.now

    def _manage(self) -> None:
        self._manager.update()
        self._log.settle()
        self._answered = self._kb.revision

    def hear_plan(self, plan: "PlanRecord") -> None:
        super().hear_plan(plan)
        if plan.outcome.is_trouble and self._task.is_planned:  # a tree may have something else to do then
            self.trouble = Verdict("aborted", f"no plan, {plan.outcome}: {plan.engine}", plan.message)

    def _hear(self, event: Event) -> None:
        if event.kind is EventKind.ACTION_UPDATE:
            for listener in self.listeners:
                listener.action(event.text, event.time)

    def _report_adaptation(self, adaptation: Adaptation) -> None:
        for listener in self.listeners:
            listener.adaptation(adaptation)


def _is_timeless(kb: KnowledgeBase) -> bool:
    """Whether no status changes with time alone: no measurement ages, no constraint dwells, no assertion lapses."""
    with kb.reading() as state:
        nodes, asserted = state.network.present(), state.asserted
        return not any(
            asserted[node.index] is not None
            or getattr(node.element, "max_age", inf) != inf
            or getattr(node.element, "dwell", 0.0) > 0.0
            for node in nodes
        )


class TaskLayer:
    """What decides about actions: the behaviour to tick, and the task plans of all behaviours in it that plan.

    One that can `catch_up`, as `rosa_pddl.PlanExecutor`, waits between ticks for an answer that is due: no tick does.

    Attributes:
        close: to be called at the end: lets go of what was used for planning.
        is_planned: whether the actions are those of the plans, none of a tree's own.
    """

    def __init__(self, root: Behaviour, close: Callable[[], None] = lambda: None, made: "Made | None" = None) -> None:
        self.root, self.close, self._made = root, close, made
        self._planning: list[Any] = [one for one in root.iterate() if has_plans(one)]
        self._waiting = [one for one in self._planning if hasattr(one, "catch_up")]
        self._heard = [0] * len(self._planning)
        self._plans: tuple[PlanRecord, ...] = ()
        while isinstance(root, Decorator):
            root = root.decorated
        self.is_planned = root in self._waiting

    def catch_up(self) -> None:
        """Wait for answers that are due; to be called between ticks."""
        for one in self._waiting:
            one.catch_up()
        if self._made is not None and self._made.error is not None:
            raise self._made.error

    def plans(self) -> tuple["PlanRecord", ...]:
        """Return the plans so far, in the order in which they are found here."""
        for number, one in enumerate(self._planning):
            if len(one.plans) > self._heard[number]:
                self._plans += one.plans[self._heard[number] :]
                self._heard[number] = len(one.plans)
        return self._plans

    def findings(self) -> Sequence[str]:
        """Return what may be an oversight in what is planned with, once each."""
        return list(dict.fromkeys(text for one in self._planning for text in getattr(one, "findings", ())))


def has_plans(behaviour: Behaviour) -> bool:
    """Whether a behaviour plans: its `plans`, a tuple of `rosa_pddl.PlanRecord`, are then those of the run."""
    return isinstance(getattr(behaviour, "plans", None), tuple)


def check_task(kind: str) -> None:
    if kind not in TASK_KINDS:
        raise MissionError(f"unknown task layer {kind!r}; there are {' and '.join(TASK_KINDS)}")


def build_task(kind: str, mission: Mission, kb: KnowledgeBase, percepts: Percepts, delay_s: float = 0.0) -> TaskLayer:
    """Build the task layer of a mission, of a kind "bt" or "pddl"; a plan is found in that simulated time [s].

    Raises:
        MissionError: no such kind, or the mission has no task logic of that kind.
    """
    check_task(kind)
    if kind == "bt":
        if mission.tree is None:
            raise MissionError(f"mission {mission.name} has no tree; run it with --task pddl, or give it tree=...")
        return TaskLayer(built(f"the tree of mission {mission.name}", Behaviour, partial(mission.tree, kb, percepts)))  # type: ignore[type-abstract]  # only asked about
    return _planning(mission, kb, percepts, delay_s)


def _planning(mission: Mission, kb: KnowledgeBase, percepts: Percepts, delay_s: float) -> TaskLayer:
    from missions.engine.declared import mission_domain
    from rosa_pddl import PlanExecutor

    domain = mission_domain(mission)
    planner, made = planner_of(mission, domain), Made(kb, percepts)
    executor = PlanExecutor(
        f"plan for {mission.name}",
        kb=kb,
        domain=domain,
        behaviours={schema: made.by(schema, action) for schema, action in mission.actions.items()},
        sense=lambda: mission.facts(kb, percepts),
        clock=lambda: kb.now,
        planner=planner,
        delay_s=delay_s,
    )
    return TaskLayer(FailureIsRunning("until the goal holds", executor), planner.close, made)


def planner_of(mission: Mission, domain: "Domain") -> "Planner":
    """Return what plans for a mission; MissionError if it is not installed, or cannot plan in that domain."""
    from rosa_pddl import Planner

    planner = Planner(mission.engines[0], fallback=mission.engines[1:]) if mission.engines else Planner()
    if (missing := planner.missing(domain)) is not None:
        raise MissionError(missing)
    return planner


class Made:
    """Makes the behaviours of steps, and keeps the error if one cannot be made: a tree would make a failure of it."""

    def __init__(self, kb: KnowledgeBase, percepts: Percepts) -> None:
        self.error: Exception | None = None
        self._kb, self._percepts = kb, percepts

    def by(self, schema: str, action: Callable[..., Behaviour]) -> Callable[["Step"], Behaviour]:
        """Return what makes the behaviour of a step; it is given the step if it asks for it, and nothing else."""
        parameters = signature(action)
        takes_step = "step" in parameters.parameters
        try:
            parameters.bind(self._kb, self._percepts, **({"step": None} if takes_step else {}))
        except TypeError as error:
            given = "the knowledge base, the percepts and, as `step`, the step"
            raise MissionError(f"what does the PDDL action {schema} is given {given}: {error}") from error

        def make(step: "Step") -> Behaviour:
            try:
                made = action(self._kb, self._percepts, **({"step": step} if takes_step else {}))
                if not isinstance(made, Behaviour):
                    raise MissionError(f"what does the PDDL action {schema} is {made!r}, not a py_trees behaviour")
                return made
            except Exception as error:
                self.error = error
                raise

        return make
