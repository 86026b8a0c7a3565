"""Replay recorded diagnostics without a simulator; what is decided then, assertions, golden traces.

The knowledge base, the manager and the task layer receive the recorded messages at their times, and
decide again. Their commands take as long as in the recording, and have no effect on the messages.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import ndiff, unified_diff
from itertools import islice
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, NamedTuple, TypeVar

from py_trees.behaviour import Behaviour

from kb import DiagnosticProblem, Event, EventKind, KnowledgeBase, Model, ReconfigurationPlan
from kb.files import write_file
from missions.engine.adaptations import Adaptation
from missions.engine.components import VERBS
from missions.engine.mission import (
    Mission,
    Verdict,
    World,
    WorldKind,
    blamed,
    find_mission,
)
from missions.engine.percepts import Message, Percepts
from missions.engine.recording import read_recording
from missions.engine.runner import MissionRun, RosaRun
from missions.engine.settings import MissionError, RunSettings
from missions.testing.scripted import CommandFailed as CommandFailed
from missions.testing.scripted import FakeClock, ScriptedManaged
from missions.testing.scripted import LeafMock as LeafMock
from missions.testing.scripted import mock_leaf as mock_leaf
from missions.wires.mcap import Bag, is_bag, read_bag
from rosa_bt import Trace, TraceVisitor
from rosa_bt.trace import Node, Visit

if TYPE_CHECKING:
    from numpy.random import Generator

SLACK_S: Final = 1e-6
"""Tolerance for rounding errors of summed ticks [s]."""
BEFORE: Final = 3
"""How many moments before the expected time a failure shows."""
MOST: Final = 40
"""How many lines of one kind a failure shows at most."""
SWITCHING_S: Final = 0.05
"""How long a command takes if the recording does not say it [s]."""
AFTERMATH_S: Final = 1.0
"""How long a replay goes on after the last message, for the reaction to it [s]."""

T = TypeVar("T")
Names = str | Iterable[str]
Candidate = tuple[float, float, str, T]
"""What may be meant: when it begins and when it is in force [s], in words, and the thing itself."""
Step = tuple[str, str]
"""A verb of `_KINDS` and a name."""
_KINDS: Final[Mapping[str, str]] = {
    "begin": "actions",
    "activate": "components",
    "deactivate": "components",
    "configure": "configurations",
}
"""What the names are of that a step begins, activates, deactivates or configures."""
TaskFactory = Callable[[KnowledgeBase, Percepts], Behaviour]
"""Makes what decides about actions: a tree, or a plan executor (with clock `lambda: kb.now`)."""


class Moment(NamedTuple):
    """One line of a timeline, at a time [s]; `reason` is empty if none is known.

    `what` is "heard", "action" or "plan"; or "end" of a mission that ended before its recording.
    """

    time: float
    what: str
    text: str
    reason: str = ""

    def __str__(self) -> str:
        line = f"{seconds(self.time):>11}  {self.what:<8}  {self.text}"
        return f"{line}\n{'':23}because {self.reason}" if self.reason else line


@dataclass(frozen=True, slots=True)
class Decisions:
    """All decisions of a replay about task and architecture, in order; times in [s].

    The assertions take `at`, the earliest time at which something may happen, and `within`, how
    long after that it has to be in force. A name that the model does not have is an error.

    Attributes:
        actions: (name, start, end, result) of every action; None if the recording ends before.
        adaptations: every adaptation with its reason.
        problems: (time, what) of every part of a message that could not be used.
        timeline: what became known and was decided, for people.
        trace: every tick of the task layer, as data.
        events: all events of the knowledge base, as data.
        kb: the knowledge base at the end, for anything else that a test needs.
    """

    actions: tuple[tuple[str, float, float | None, str | None], ...]
    plans: tuple[ReconfigurationPlan, ...]
    adaptations: tuple[Adaptation, ...]
    problems: tuple[tuple[float, DiagnosticProblem], ...]
    timeline: tuple[Moment, ...] = field(repr=False)
    trace: Trace = field(repr=False)
    events: tuple[Event, ...] = field(repr=False)
    kb: KnowledgeBase = field(repr=False)

    def __str__(self) -> str:
        return "\n".join(map(str, self.timeline))

    @property
    def changes(self) -> tuple[Adaptation, ...]:
        """Every change of the task, in which one action replaces another, with its reason."""
        return tuple(entry for entry in self.adaptations if entry.action in self.kb.actions)

    def assert_actions(self, *names: str) -> None:
        """Assert that exactly these actions were begun, in this order."""
        __tracebackhide__ = True
        self._steps(begin=names)
        begun = [name for name, *_ in self.actions]
        if begun != list(names):
            diff = [line.rstrip() for line in ndiff(names, begun) if not line.startswith("?")]
            headline = "other actions were begun (-: expected, +: what was done)"
            raise self._error([headline, *diff], 0.0, ", ".join(names))

    def assert_adapts(
        self, *, at: float, from_: str | None = None, to: str | None = None, within: float = 1.0
    ) -> Adaptation:
        """Assert that one action replaces another, and that the robot is configured for it in time.

        Args:
            at: when the event happens that calls for it [s].
            from_: the action that is given up or has ended; None for any.
            to: the action that replaces it; None for any.
            within: how long after `at` the robot is configured for it [s].

        Returns:
            The adaptation, with its reason.
        """
        __tracebackhide__ = True
        self._steps(begin=[name for name in (from_, to) if name])
        candidates = []
        for change in self.changes:
            if from_ in (None, change.before) and to in (None, change.action):
                words = (
                    f"{change.before} -> {change.action} is decided at {seconds(change.at_s)}, "
                    f"in force at {seconds(change.in_force_s)} (because {change.why})"
                )
                candidates.append((change.at_s, change.in_force_s, words, change))
        return self._first(f"{from_ or 'any'} -> {to or 'any'}", at, within, candidates)

    def assert_reconfigures(
        self,
        *,
        at: float,
        activate: Names = (),
        deactivate: Names = (),
        configure: Names = (),
        within: float = 1.0,
    ) -> ReconfigurationPlan:
        """Assert that a plan makes at least these changes, by names; return it.

        The event that calls for it happens at `at` [s]; the plan must be carried out at most
        `within` [s] later.
        """
        __tracebackhide__ = True
        steps = self._steps(activate=activate, deactivate=deactivate, configure=configure)
        candidates = []
        for plan in self.plans:
            if steps <= set(_steps_of(plan)):
                ending = f"{_ending(plan)} (because {plan.reason})"
                end = inf if plan.end is None or plan.result != "completed" else plan.end
                words = f"the plan of {seconds(plan.start)} is {ending}"
                candidates.append((plan.start, end, words, plan))
        return self._first(_phrase(steps), at, within, candidates)

    def assert_never(
        self,
        *,
        action: Names = (),
        activate: Names = (),
        deactivate: Names = (),
        configure: Names = (),
        since: float = 0.0,
        until: float = inf,
    ) -> None:
        """Assert that none of these begins from `since` until `until` [s].

        Raises:
            ValueError: the replay has no such time, or nothing is named, which always holds.
        """
        __tracebackhide__ = True
        if not since <= min(until, self.kb.now):
            span = f"from {since:g} s until {until:g} s"
            raise ValueError(f"{span} is no time of this replay of {self.kb.now:g} s")
        unwanted = self._steps(
            begin=action, activate=activate, deactivate=deactivate, configure=configure
        )
        steps = [(start, ("begin", name)) for name, start, *_ in self.actions]
        for plan in self.plans:
            steps += [(plan.start, step) for step in _steps_of(plan)]
        for time, step in sorted(steps):
            if step in unwanted and since - SLACK_S <= time <= until + SLACK_S:
                expected = f"never {_phrase(unwanted)}"
                lines = [f"expected: {expected}", f"  but {' '.join(step)} at {seconds(time)}"]
                raise self._error(lines, time, expected)

    def _steps(self, **names: Names) -> set[Step]:
        """Return the steps with these names, by verb; the model has to have them."""
        steps = set[Step]()
        for verb, several in names.items():
            for name in [several] if isinstance(several, str) else several:
                views: Mapping[str, object] = getattr(self.kb, _KINDS[verb])
                _ = views[name]  # raises, and names the nearest
                steps.add((verb, name))
        if not steps and "activate" in names:
            raise ValueError("say what to look for: activate=..., deactivate=... or configure=...")
        return steps

    def _first(
        self, expected: str, at: float, within: float, candidates: Sequence[Candidate[T]]
    ) -> T:
        """Return the first candidate in time."""
        __tracebackhide__ = True
        for begin, in_force, _, thing in candidates:
            if begin >= at - SLACK_S and in_force <= at + within + SLACK_S:
                return thing
        span = f"between {seconds(at)} and {seconds(at + within)}"
        lines = [f"  but {words}" for _, _, words, _ in candidates] or ["  but it never does"]
        raise self._error([f"expected {span}: {expected}", *lines], at, expected)

    def _error(self, lines: Sequence[str], time: float, expected: str) -> AssertionError:
        """Return an error with the timeline around a time [s], the expectation in its place."""
        place = Moment(time, "EXPECTED", expected)
        moments = sorted([place, *self.timeline], key=lambda moment: moment.time)
        first = max(moments.index(place) - BEFORE, 0)
        around = map(str, moments[first : first + MOST])
        unused = dict.fromkeys(f"could not be used: {problem}" for _, problem in self.problems)
        text = [*lines, "", "what happened:", *around, *[*unused][:MOST]]
        return AssertionError("\n".join(text))


def seconds(time: float) -> str:
    """Return a time as text, to the hundredth of a second."""
    return f"{time:.2f} s"


def timeline(events: Iterable[Event], adaptations: Iterable[Adaptation]) -> tuple[Moment, ...]:
    """Return all events, in order, as moments, with the reasons of the adaptations."""
    reasons = {(entry.at_s, entry.action): entry.why for entry in adaptations}
    moments = []
    for event in events:
        plan = event.plan
        if plan is not None:
            commanded = str(plan).partition("; note as ")[0]  # without what a plan only notes
            text = f"{commanded}: {_ending(plan)}"
            moments.append(Moment(event.time, "plan", text, plan.reason))
        elif event.kind is EventKind.ACTION_UPDATE:
            reason = reasons.get((event.time, event.subject), "")
            moments.append(Moment(event.time, "action", event.text, reason))
        elif event.kind is not EventKind.RECORD and not _is_of_plan(event):
            moments.append(Moment(event.time, "heard", event.text))
    return tuple(moments)


def _is_of_plan(event: Event) -> bool:
    """Tell whether a component was switched, as the line of a plan says; a crash has a reason."""
    return event.verb == "component_active" and bool(event.arguments[1] or not event.arguments[2])


def _ending(plan: ReconfigurationPlan) -> str:
    return "still open" if plan.end is None else f"{plan.result} at {seconds(plan.end)}"


def _steps_of(plan: ReconfigurationPlan) -> list[Step]:
    steps = [("activate", name) for name in plan.activate]
    steps += [("deactivate", name) for name in plan.deactivate]
    return steps + [("configure", name) for name in plan.parameters]


def _phrase(steps: Iterable[Step]) -> str:
    return ", ".join(" ".join(step) for step in sorted(steps))


# -------------------------------------------------------------------- replay


def replay(
    source: str | Path | Bag | Iterable[Message],
    mission: Mission | Model | str,
    behaviour: TaskFactory | None = None,
    *,
    task: str = "bt",
    managed: ScriptedManaged | None = None,
    watch: Callable[[MissionRun], object] | None = None,
    on_error: Literal["fail", "raise"] = "raise",
) -> Decisions:
    """Replay a recording, and return what is decided now.

    Args:
        source: a recording, as `rosa run MISSION --record FILE` writes it, or written by hand; a
            rosbag2 with diagnostics (MCAP or sqlite3), or one that was read already; or the
            messages themselves.
        mission: the mission that decides, or its name; or, if a behaviour is given, only a model.
        behaviour: makes a task layer that replaces the mission's, given the knowledge base and the
            percepts.
        task: the kind of the mission's task layer, "bt" or "pddl".
        managed: the system that takes the commands, with its clock at 0; by default one that always
            obeys.
        watch: called with the run of the replay before it begins, e.g. to `listen` to it.
        on_error: what a behaviour that raises does: "raise" ends the replay, "fail" is as on a
            robot.

    Raises:
        MissionError: a behaviour raises; the recording cannot be read; there is no such mission,
            task layer or behaviour; or a part of a message cannot be used, if the messages
            themselves are given (of a recording it is in `problems`).
        kb.UnknownName: a script names a component that the model does not have.
    """
    messages = _messages_of(source)
    recorded = messages[0].get("run", {}) if messages else {}
    world = Recording(messages, managed or ScriptedManaged(FakeClock()))
    end_s = max((message["time"] for message in messages), default=0.0) + AFTERMATH_S
    with blamed(lambda: "what the recording says of how it was run cannot be used"):
        usual_s = dict.fromkeys(VERBS, SWITCHING_S) | recorded.get("switching_s", {})
        world.managed.follow(recorded.get("commands", ()), usual_s)
        values = {"duration_s": end_s, **recorded.get("settings", {})}
        texts = {name: str(value) for name, value in values.items()}
        limits = RunSettings.read(texts)
    limits = replace(limits, duration_s=min(limits.duration_s, end_s))
    kind = "bt" if behaviour else task
    run_type = RosaRun if on_error == "fail" else _StrictRun
    run = run_type(_mission_of(mission, behaviour), kind, world, limits)
    if watch is not None:
        watch(run)
    for component in world.managed.scripted:
        _ = run.kb.components[component]  # raises if there is none: the script is a mistake
    decisions = _decide(run, world)
    if decisions.problems and not isinstance(source, str | Path | Bag):
        lines = [f"\n  at {seconds(time)}: {problem}" for time, problem in decisions.problems]
        raise MissionError(f"the messages cannot be used as they are:{''.join(lines)}")
    return decisions


class _StrictRun(RosaRun):
    """A run that ends when a behaviour raises."""

    on_error = "raise"


class Recording(World):
    """A world that publishes the recorded messages, and nothing else.

    Its clock is that of the managed system, which has to show 0.
    """

    def __init__(self, messages: Iterable[Message], managed: ScriptedManaged) -> None:
        if managed.clock.now != 0.0:
            now = f"{managed.clock.now:g} s"
            raise MissionError(
                f"a replay begins at 0 s, not at {now}; hand in a new managed system"
            )
        self.unheard = deque(messages)
        self._managed = managed

    @property
    def now(self) -> float:
        return self._managed.clock.now

    @property
    def managed(self) -> ScriptedManaged:
        return self._managed

    def advance(self, until: float) -> list[Message]:
        """Go on to the next message or end of a command, at most until `until` [s]."""
        following = self.unheard[0]["time"] if self.unheard else inf
        now = max(self.now, min(until, following, self._managed.next_event()))
        self._managed.clock.advance_to(now)
        heard = []
        while self.unheard and self.unheard[0]["time"] <= now:
            heard.append(self.unheard.popleft())
        return heard


class _Nowhere(WorldKind):
    """The world of a model without a mission; it exists for replays only."""

    def open(self, values: Mapping[str, object], rng: "Generator") -> World:
        raise MissionError("a model alone has no world; replay a recording to it")

    def verdict(
        self, percepts: Percepts, results: Mapping[str, float | None], kb: KnowledgeBase
    ) -> Verdict:
        return Verdict("replayed", "")


def _mission_of(source: Mission | Model | str, behaviour: TaskFactory | None) -> Mission:
    """Return the mission that decides, with the behaviour as its tree."""
    mission = find_mission(source) if isinstance(source, str) else source
    if isinstance(mission, Mission):
        return replace(mission, tree=behaviour or mission.tree)
    if not isinstance(mission, Model) or behaviour is None:
        raise MissionError("nothing here decides; write replay(source, model, behaviour)")
    model = mission
    return Mission(model.name, "", lambda: model, behaviour, _Nowhere())


def _messages_of(source: str | Path | Bag | Iterable[Message]) -> list[Message]:
    if isinstance(source, str | Path) and is_bag(source):
        source = read_bag(source)
    if not isinstance(source, Bag):
        return list(read_recording(source))
    return [source.header(), *source.messages] if source.run else source.messages


def _decide(run: RosaRun, world: Recording) -> Decisions:
    events: list[Event] = []
    run.kb.log.witnesses += (events.append,)
    with TraceVisitor(run.kb) as visitor:
        run.tree.add_visitor(visitor)
        verdict = run.run()
    moments = timeline(events, run.adaptations)
    if world.unheard:
        text = f"the mission ended ({verdict.outcome}) before {len(world.unheard)} messages"
        moments += (Moment(world.now, "end", text),)
    return Decisions(
        tuple((record.action, record.start, record.end, record.result) for record in run.actions),
        run.kb.plans,
        tuple(run.adaptations),
        tuple(run.problems),
        moments,
        visitor.trace,
        tuple(events),
        run.kb,
    )


# -------------------------------------------------------------------- golden traces


def check_golden(trace: Trace, path: Path, command: str, *, update: bool) -> None:
    """Compare a trace, in words, with a file; with `update`, write the file.

    Raises:
        AssertionError: they differ, or there is no file; the message shows how, and the command
            that writes it.
    """
    __tracebackhide__ = True
    lines = list(readable(trace))
    if update:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, "".join(f"{line}\n" for line in lines).encode())
    golden = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    if lines != golden:
        diff = unified_diff(golden, lines, "golden", "now", lineterm="", n=4)
        how = f"if this is as it should be, write it: {command}"
        raise AssertionError("\n".join([f"not as in {path}", how, "", *islice(diff, MOST)]))


def readable(trace: Trace) -> Iterator[str]:
    """Yield a trace as lines for people: for each tick with news, what changed in it."""
    yield f"model {trace.model}"
    tree: Sequence[Node] = ()
    visited: Sequence[Visit] = ()
    for tick in trace.ticks:
        lines = [
            f"  {'decided' if place is None else 'event  '}  {event.text}"
            for event, place in tick.events
        ]
        if tick.tree != tree:
            lines += [f"  tree     {'  ' * depth}{kind} {name}" for depth, kind, name in tick.tree]
        if tick.visited != visited:
            for node, status, feedback in tick.visited:
                why = f" ({feedback})" if feedback else ""
                lines.append(f"  ticked   {tick.tree[node].name}: {status}{why}")
        if lines:
            yield f"tick {tick.number} at {tick.time:.2f} s"
            yield from lines
        tree = tick.tree
        visited = tick.visited
    yield f"{len(trace.ticks)} ticks"
