"""One run of a mission: a world and what decides in it, in lock-step with the world's clock."""

from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import partial
from math import isfinite, nan
from time import perf_counter
from typing import Any, Final, Literal, Protocol

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
from missions.engine.components import VERBS
from missions.engine.mission import (
    NO_SUCCESS,
    NUMBER,
    TIME_LIMIT,
    Message,
    Mission,
    MissionError,
    Percepts,
    Reaction,
    Sample,
    Verdict,
    World,
    blamed,
    built,
    check_message,
)
from missions.engine.settings import RunSettings
from missions.engine.task_layer import build_task
from rosa_bt import TreeRunner
from rosa_pddl import PlanRecord

OURS: Final = "ours"
"""The manager name of our own: the knowledge base, its configuration manager, and the task layer asked for."""
SAMPLE_PERIOD_S: Final = 0.5
STANDSTILL = 10_000
"""A world stands still if it is asked this often to go on and less than a millisecond passes."""

_GIVES: Final[Mapping[str, tuple[type, Callable[[Any], bool], str]]] = {
    "results": (
        Mapping,
        lambda one: isinstance(one[0], str) and (one[1] is None or isinstance(one[1], NUMBER)),
        "a mapping of names to numbers, None for what did not happen",
    ),
    "reactions": (
        Sequence,
        lambda one: (
            isinstance(one.uncertainty, str) and _are_numbers(one.start_s, one.end_s, one.delay_s)
        ),
        "a sequence of reactions, each with uncertainty, start_s, end_s and delay_s",
    ),
    "sample": (
        object,
        lambda one: one is None or _is_sample(one),
        "None or a missions.engine.mission.Sample: a time, a position of three numbers, and signals that are numbers",
    ),
    "disturbances": (
        Sequence,
        lambda one: len(one) == 2 and _are_numbers(one[0]) and isinstance(one[1], str),
        "a list of pairs of a time [s] and a text",
    ),
    "scenery": (
        Mapping,
        lambda one: (
            isinstance(one[0], str)
            and all(len(point) == 2 and _are_numbers(*point) for point in one[1])
        ),
        "a mapping of names to points, each of two numbers",
    ),
}
"""What methods of a world give: of which type, what is asked of each part, and in words what is wanted."""


def _are_numbers(*values: object) -> bool:
    return all(isinstance(one, NUMBER) for one in values)


def _is_sample(one: Any) -> bool:  # noqa: ANN401  # it may be anything before it is checked
    numbers, names = (one.time, *one.position, *one.signals.values()), one.signals
    return (
        len(one.position) == 3
        and _are_numbers(*numbers)
        and all(isinstance(name, str) for name in names)
    )


def _time_of(world: World) -> float:
    now: float = world.now
    if not isinstance(now, NUMBER):
        raise MissionError(
            f"now of {type(world).__name__} is {now!r:.100}; expected is the time, a number [s]"
        )
    return now


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

    def sample(self, sample: Sample) -> None:
        """Called with what can be seen of the world, at most twice a second."""


class Injector(Protocol):
    """Replaces messages by what injected faults say; see `missions.engine.faults`."""

    planned: tuple[Any, ...]
    injected: list[Any]
    held: dict[str, float]

    def add(self, faults: Iterable[Any]) -> None: ...
    def alter(self, messages: Sequence[Message], now: float) -> Sequence[Message]: ...


class MissionRun(ABC):
    """One run of a mission, to its end: by our knowledge base, manager and task layer, or by a baseline.

    In each turn it lets the world go on to the time that it is due, receives what was published, and decides.

    Attributes:
        model: of the mission, with all amendments so far.
        manager: its name, as in `rosa run --manager`.
        tree: the tree that is ticked; None if there is none.
        problems: parts of messages that could not be used, with their times [s].
        alter: replaces the messages published by a time [s], as a disturbance from outside; None for none.
        faults: the faults that are injected, see `missions.engine.faults.inject`; None for none.
        inputs: figures of published results that were given to the manager, by name.
        compute_s: computing time on this machine by part [s]; no decision depends on it.
        listeners: those that are notified.
        trouble: if set, the run ends at once with this verdict.
        findings: what may be mistakes in the PDDL, as sentences; known at the end.
        adaptations: all so far, in the order in which they were decided.
        is_stuck: whether nothing can be done any more, however long one waits; the mission then ends and is judged.
    """

    def __init__(
        self, mission: Mission, world: World, settings: RunSettings, manager: str, task: str
    ) -> None:
        self.mission, self.world, self.settings = mission, world, settings
        self._moved_s, self._turns = _time_of(world), 0
        if any(not callable(getattr(world.managed, verb, None)) for verb in VERBS):
            its = f"managed of {type(world).__name__} is {world.managed!r:.100}"
            raise MissionError(
                f"{its}; expected is a kb.ManagedSystem, which has the methods {', '.join(VERBS)}"
            )
        self.model = built(f"the model of mission {mission.name}", Model, mission.model)
        self.manager, self.task = manager, task
        self.tree: BehaviourTree | None = None
        self.problems: list[tuple[float, DiagnosticProblem]] = []
        self.alter: Callable[[Sequence[Message], float], Sequence[Message]] | None = None
        self.faults: Injector | None = None
        self.inputs: Mapping[str, float] = {}
        self.compute_s = defaultdict[str, float](float, world=0.0)
        self.listeners: Sequence[Listener] = ()
        self.trouble: Verdict | None = None
        self.findings: Sequence[str] = ()
        self.adaptations: list[Adaptation] = []
        self.is_stuck = False
        self._decided_s: list[tuple[float, float]] = []
        self._sampled_at = -SAMPLE_PERIOD_S
        self._plan_heard: PlanRecord | None = None

    def listen(self, *listeners: Listener) -> None:
        """Add listeners."""
        self.listeners = (*self.listeners, *listeners)

    def tell(self, heard: Callable[[Listener], object]) -> None:
        """Call a function with every listener."""
        for listener in self.listeners:
            heard(listener)

    @contextmanager
    def spending(self, part: str) -> Iterator[None]:
        """Add the computing time inside the block to that of a part."""
        started = perf_counter()
        yield
        self.compute_s[part] += perf_counter() - started

    @property
    def kb(self) -> KnowledgeBase:
        """The knowledge base.

        Raises:
            MissionError: the run of a baseline has none.
        """
        raise MissionError(f"manager {self.manager} has no knowledge base")

    @property
    def plans(self) -> tuple[PlanRecord, ...]:
        """The task plans so far, in order; empty if nothing plans."""
        return ()

    @property
    @abstractmethod
    def due(self) -> float:
        """When it decides next even if nothing is published until then [s]."""

    @property
    @abstractmethod
    def is_done(self) -> bool:
        """Whether the mission is over."""

    @property
    @abstractmethod
    def actions(self) -> Sequence[RequiredAction]:
        """All actions that were requested."""

    @property
    @abstractmethod
    def measured(self) -> Mapping[str, float | None]:
        """The last measurement of each attribute; None if there is none."""

    @abstractmethod
    def receive(self, message: Message) -> Sequence[DiagnosticProblem]:
        """Process a message; return the parts of it that cannot be used."""

    @abstractmethod
    def decide(self) -> bool:
        """React to what was received, and do what is due; return whether something was due."""

    @abstractmethod
    def end(self) -> None:
        """Release everything; called once, however the run ends."""

    @abstractmethod
    def verdict(self, results: Mapping[str, float | None]) -> Verdict:
        """Return how the mission has ended; called when it is over."""

    @property
    def reactions(self) -> Sequence[tuple[Reaction, float]]:
        """Each reaction that the world knows, with the computing time on this machine during it [s]."""
        return [
            (one, sum(took for time, took in self._decided_s if one.start_s <= time < one.end_s))
            for one in self.ask("reactions")
        ]

    def ask(self, method: str, known: tuple[str, ...] | None = None) -> Any:  # noqa: ANN401  # what the method gives is checked here
        """Call a method of the world without arguments: results, reactions, sample, disturbances or scenery.

        Parts of a mapping with the `known` names are not checked again.

        Raises:
            MissionError: it raises, or gives something else than it is to give.
        """
        kind, fits, wanted = _GIVES[method]
        its = f"{method}() of {type(self.world).__name__}"
        with blamed(lambda: f"{its} failed after {self.world.now:.1f} s"):
            given: Any = getattr(self.world, method)()
        try:
            parts = [given] if kind is object else given.items() if kind is Mapping else given
            is_known = kind is Mapping and tuple(given) == known
            is_fit = isinstance(given, kind) and (is_known or all(map(fits, parts)))
        except (TypeError, ValueError, AttributeError, LookupError):  # a part is missing
            is_fit = False
        if not is_fit:
            raise MissionError(f"{its} gives {given!r:.100}; expected is {wanted}")
        return given

    def disturbances(self) -> list[tuple[float, str]]:
        """Return what truly happened, and when [s], in order of time: by itself, or because it was injected."""
        happened = list(self.ask("disturbances"))
        if self.faults is not None:
            happened += [(fault.time, fault.words) for fault in self.faults.injected]
        return sorted(happened, key=lambda entry: entry[0])

    def results(self) -> Mapping[str, float | None]:
        """Return the mission's figures up to now by name, units in the names, including `inputs`."""
        return {**self.ask("results"), **self.inputs}

    def run(self) -> Verdict:
        """Run until the mission is done, stuck or out of time; nothing is left running however this ends.

        Raises:
            MissionError: the world lets no time pass, or code of the mission raises; the message names it.
        """
        world, duration_s = self.world, self.settings.duration_s
        doing = f"mission {self.mission.name} under manager {self.manager}"
        with (
            blamed(lambda: f"{doing} failed after {world.now:.2f} s", is_authors=False),
            closing(world),
        ):
            try:
                while not (
                    self.trouble or self.is_stuck or self.is_done or world.now >= duration_s
                ):
                    self._turn()
            finally:
                self.end()
        if self.trouble:
            return self.trouble
        verdict = self.verdict(self.results())
        if self.is_done and world.now < duration_s and verdict.outcome in (*NO_SUCCESS, TIME_LIMIT):
            # the verdict reads as if time had run out, but the task ended before
            ended = f"the task ended after {world.now:.1f} s of {duration_s:g} s, short of the mission's goal"
            return Verdict("ended_early", ended)
        return verdict

    def _turn(self) -> None:
        """Let the world go on to the next message, or to when something is due, and react."""
        started = perf_counter()
        messages = self._advanced(min(self.due, self.settings.duration_s))
        self.compute_s["world"] += perf_counter() - started
        spent_s = sum(self.compute_s.values())
        if self.alter is not None:
            messages = self.alter(messages, self.world.now)
        if self.faults is not None:
            messages = self.faults.alter(messages, self.world.now)
        for message in messages:
            self._take_in(message)
        is_decided = self.decide()
        self._decided_s.append((self.world.now, sum(self.compute_s.values()) - spent_s))
        if is_decided and self.listeners:
            self._sample()
            self.tell(lambda listener: listener.tick(self))
        for plan in plans_after(self._plan_heard, self.plans):
            self._plan_heard = plan
            self.hear_plan(plan)

    def hear_plan(self, plan: PlanRecord) -> None:
        """Notify the listeners of a task plan."""
        self.tell(lambda listener: listener.plan(plan, self.world.now))

    def _advanced(self, until: float) -> Sequence[Message]:
        world, before, its = self.world, self.world.now, f"the world of mission {self.mission.name}"
        with blamed(lambda: f"{its} failed after {before:.1f} s"):
            messages = world.advance(until)
        if not isinstance(messages, list):
            said = f"advance() of {type(world).__name__} gives {messages!r:.100}"
            raise MissionError(f"{said}; expected is a list of messages, empty if there are none")
        for message in messages:
            check_message(message, f"advance() of {type(world).__name__}")
        now = _time_of(world)
        if not isfinite(now) or now < before:
            raise MissionError(f"{its} shows {now!r} s after {before!r} s; its time has to pass")
        self._turns += 1
        if now >= self._moved_s + 1e-3:
            self._moved_s, self._turns = now, 0
        elif self._turns > STANDSTILL:
            advice = "advance() goes on until something is published, a command has ended, or to the time asked for"
            raise MissionError(
                f"{its} stands still at {now:.3f} s, asked to go on to {until:.3f} s; {advice}"
            )
        return messages

    def _take_in(self, message: Message) -> None:
        problems, time_s = self.receive(message), float(message["time"])
        self.tell(lambda listener: listener.message(message))
        for problem in problems:
            self.problems.append((time_s, problem))
            for listener in self.listeners:
                listener.problem(problem, time_s)

    def _sample(self) -> None:
        now = self.world.now
        if now < self._sampled_at + SAMPLE_PERIOD_S - 1e-9:
            return
        self._sampled_at = now
        measured = {name: nan if value is None else value for name, value in self.measured.items()}
        sample = self.ask("sample") or Sample(now, (nan, nan, nan), measured)
        self.tell(lambda listener: listener.sample(sample))


class RosaRun(MissionRun):
    """The run of our own: the knowledge base receives messages, the manager configures, the task layer decides.

    Args:
        planner: chooses the configurations; None: by priority.
        hears: replaces each message before it is received.
        on_error: as of `rosa_bt.TreeRunner`: a behaviour that raises fails, or the run raises.

    Attributes:
        percepts: what the task layer perceives besides what the knowledge base knows.

    Raises:
        MissionError, rosa_pddl.RosaPddlError, kb.KnowledgeBaseError: the mission cannot be run.
    """

    tree: BehaviourTree

    def __init__(
        self,
        mission: Mission,
        task: str,
        world: World,
        settings: RunSettings,
        manager: str = OURS,
        planner: ConfigurationPlanner | None = None,
        hears: Callable[[Message], Message] = lambda message: message,
        on_error: Literal["fail", "raise"] = "fail",
    ) -> None:
        super().__init__(mission, world, settings, manager, task)
        self.percepts = Percepts()
        self._kb = KnowledgeBase(self.model, clock=self._now)
        self._manager, self._hears = (
            ConfigurationManager(self._kb, world.managed, planner=planner),
            hears,
        )
        self._task = build_task(task, mission, self._kb, self.percepts, settings.planning_delay_s)
        deciding = self._task.plans if self._task.is_planned else tuple
        self._log = AdaptationLog(
            self._kb, lambda one: self.tell(lambda listener: listener.adaptation(one)), deciding
        )
        self.adaptations = self._log.adaptations
        self._runner = TreeRunner(
            self._task.root, clock=self._now, period=settings.tick_period_s, on_error=on_error
        )
        self.tree = self._runner.tree
        self.tree.setup()
        self._answered = -1
        self._left = ""

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
    def actions(self) -> Sequence[RequiredAction]:
        return self._kb.history.actions

    @property
    def measured(self) -> Mapping[str, float | None]:
        return {name: view.value for name, view in self._kb.attributes.items()}

    @property
    def plans(self) -> tuple[PlanRecord, ...]:
        return self._task.plans()

    def listen(self, *listeners: Listener) -> None:
        if listeners and not self.listeners:
            self._kb.subscribe(self._hear)
        super().listen(*listeners)

    def receive(self, message: Message) -> Sequence[DiagnosticProblem]:
        started = perf_counter()
        told, message = message, self._hears(message)
        if message is not told:
            check_message(message, f"hear() of manager {self.manager}")
        self._log.news(float(message["time"]))
        problems = self._kb.receive(message)
        for key in self.percepts.receive(message):
            self._log.sensed(f"{key} is {str(self.percepts.holds(key)).lower()}")
        self._log.news(None)
        self.compute_s["knowledge base"] += perf_counter() - started
        return problems

    def decide(self) -> bool:
        is_due = self._now() >= self._runner.due
        if is_due or self._kb.revision != self._answered or self._kb.pending_plan is not None:
            self._manage()  # between ticks, only a changed status needs the manager
        with self.spending("waiting for plans"):
            self._task.catch_up()
        with self.spending("task layer"):
            if is_due:
                self._log.ticking(self._now())
            is_ticked = is_due and self._runner.update()
        if is_ticked and self._kb.revision != self._answered:
            self._manage()
        if is_ticked and self.world.is_still and self._kb.pending_plan is None:
            self.is_stuck = bool(self.mission.why_not(self._kb, self.percepts))
        return is_ticked

    def end(self) -> None:
        try:
            if not self.is_done:
                self._log.finish()
            self.findings = self._task.findings()
            self._left = " and ".join(
                f"{one.action} since {one.start:.1f} s" for one in self._kb.required_actions
            )
        finally:
            self._runner.shutdown()
            self._task.close()

    def verdict(self, results: Mapping[str, float | None]) -> Verdict:
        kind = self.mission.world
        title = f"what verdict() of {type(kind).__name__} gives"
        verdict = built(title, Verdict, partial(kind.verdict, self.percepts, results, self._kb))
        if verdict.success:
            return verdict
        plan = self.plans[-1] if self.plans and self._task.is_planned else None
        failed = next(
            (one for one in reversed(self._kb.history.actions) if one.result == "failed"), None
        )
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
        with self.spending("manager"):
            self._manager.update()
            self._log.settle()
            self._answered = self._kb.revision

    def hear_plan(self, plan: PlanRecord) -> None:
        super().hear_plan(plan)
        if plan.outcome.is_trouble and self._task.is_planned:  # a tree may do something else then
            self.trouble = Verdict(
                "aborted", f"no plan, {plan.outcome}: {plan.engine}", plan.message
            )

    def _hear(self, event: Event) -> None:
        if event.kind is EventKind.ACTION_UPDATE:
            self.tell(lambda listener: listener.action(event.text, event.time))
