"""Replay recorded diagnostics without a simulator; what is decided then, assertions, golden traces.

The knowledge base, the manager and the task layer receive the recorded messages at their times, and
decide again. Their commands take as long as in the recording, and have no effect on the messages.
"""

import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from difflib import ndiff, unified_diff
from math import inf, isinf
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
    built,
    find_mission,
)
from missions.engine.percepts import Message, Percepts
from missions.engine.recording import read_recording
from missions.engine.runner import MissionRun, RosaRun
from missions.engine.settings import MissionError, RunSettings
from missions.testing.scripted import FakeClock, ScriptedManaged
from missions.wires.mcap import Bag, is_bag, read_bag
from rosa_bt import Trace, TraceVisitor, read_trace

if TYPE_CHECKING:
    from numpy.random import Generator

    from rosa_pddl import PlanRecord

SLACK_S: Final = 1e-6
"""Tolerance for rounding errors of summed ticks [s]."""
AROUND: Final = 3
"""How many moments before and after the expected time a failure shows."""
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
        task_plans: every task plan; none for a tree.
        problems: (time, what) of every part of a message that could not be used.
        timeline: what became known and was decided, for people.
        trace: every tick of the task layer, as data.
        events: all events of the knowledge base, as data.
        kb: the knowledge base at the end, for anything else that a test needs.
    """

    actions: tuple[tuple[str, float, float | None, str | None], ...]
    plans: tuple[ReconfigurationPlan, ...]
    adaptations: tuple[Adaptation, ...]
    task_plans: tuple["PlanRecord", ...]
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
        self._check("actions", names)
        begun = [name for name, *_ in self.actions]
        if begun == list(names):
            return
        diff = [line.rstrip() for line in ndiff(names, begun) if not line.startswith("?")]
        shown = [str(moment) for moment in self.timeline if moment.what in ("action", "end")]
        headline = "other actions were begun (-: expected, +: what was done)"
        raise self._error([headline, *diff, "", "what happened:", *shown])

    def assert_begins(self, action: str, *, at: float, within: float = 1.0) -> None:
        """Assert that an action begins."""
        __tracebackhide__ = True
        self._check("actions", [action])
        starts = [start for name, start, _, _ in self.actions if name == action]
        candidates = [(start, start, f"it begins at {seconds(start)}", None) for start in starts]
        self._first(f"{action} begins", at, within, candidates)

    def assert_ends(
        self, action: str, result: str = "completed", *, at: float, within: float = 1.0
    ) -> None:
        """Assert that an action ends "completed", "failed" or "abandoned"."""
        __tracebackhide__ = True
        self._check("actions", [action])
        candidates = []
        for name, _, end, how in self.actions:
            if name == action and end is not None:
                in_force = end if how == result else inf
                candidates.append((end, in_force, f"it is {how} at {seconds(end)}", None))
        self._first(f"{action} is {result}", at, within, candidates)

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
        self._check("actions", filter(None, (from_, to)))
        candidates = []
        for change in self.changes:
            if from_ in (None, change.before) and to in (None, change.action):
                in_force = change.in_force_s
                ending = f"is in force at {seconds(in_force)}"
                words = (
                    f"{change.before} -> {change.action} is decided at {seconds(change.at_s)} and "
                    f"{'is never in force' if isinf(in_force) else ending} (because {change.why})"
                )
                candidates.append((change.at_s, in_force, words, change))
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
        steps = self._steps(activate, deactivate, configure)
        candidates = []
        for plan in self.plans:
            if set(steps) <= set(_steps_of(plan)):
                ending = f"is {plan.result} at {seconds(plan.end or 0.0)}"
                if plan.end is None:
                    ending = "is still open at the end"
                words = f"the plan of {seconds(plan.start)} {ending} (because {plan.reason})"
                in_force = inf
                if plan.result == "completed" and plan.end is not None:
                    in_force = plan.end
                candidates.append((plan.start, in_force, words, plan))
        return self._first("; ".join(_phrases(steps)), at, within, candidates)

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
        actions = _names(action)
        self._check("actions", actions)
        steps = self._steps(activate, deactivate, configure, is_needed=not actions)
        begun = [
            (start, f"{name} is requested") for name, start, _, _ in self.actions if name in actions
        ]
        for plan in self.plans:
            unwanted = [step for step in _steps_of(plan) if step in steps]
            begun += [(plan.start, " ".join(step)) for step in unwanted]
        begun = [entry for entry in sorted(begun) if since <= entry[0] + SLACK_S]
        begun = [entry for entry in begun if entry[0] <= until + SLACK_S]
        if begun:
            never = " or ".join([*(f"begin {name}" for name in actions), *_phrases(steps)])
            lines = [f"  but {text} at {seconds(time)}" for time, text in begun]
            shown = self._around(begun[0][0], begun[0][0], f"never {never}")
            headline = f"expected: never {never}"
            raise self._error([headline, *lines, "", "what happened:", *shown])

    def _steps(
        self, activate: Names, deactivate: Names, configure: Names, *, is_needed: bool = True
    ) -> list[tuple[str, str]]:
        """Return (verb, name) for each name; the model has to have them."""
        self._check("components", [*_names(activate), *_names(deactivate)])
        self._check("configurations", _names(configure))
        by_verb = {"activate": activate, "deactivate": deactivate, "configure": configure}
        steps = [(verb, name) for verb, names in by_verb.items() for name in _names(names)]
        if is_needed and not steps:
            raise ValueError("say what to look for: activate=..., deactivate=... or configure=...")
        return steps

    def _check(
        self, kind: Literal["actions", "components", "configurations"], names: Names
    ) -> None:
        views: Mapping[str, object] = getattr(self.kb, kind)
        for name in names:
            _ = views[name]  # raises, and names the nearest

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
        shown = self._around(at, at + within, expected)
        title = f"what happened around {seconds(at)}:"
        raise self._error([f"expected {span}: {expected}", *lines, "", title, *shown])

    def _around(self, begin: float, end: float, expected: str) -> list[str]:
        """Return the timeline near an interval [s], with the expectation in its place, as lines."""
        before = [str(moment) for moment in self.timeline if moment.time < begin]
        within = [str(moment) for moment in self.timeline if begin <= moment.time <= end]
        after = [str(moment) for moment in self.timeline if moment.time > end]
        place = f"{seconds(begin):>11}  EXPECTED  {expected}"
        return [*before[-AROUND:], place, *_cut(within), *after[:AROUND]]

    def _error(self, lines: Sequence[str]) -> AssertionError:
        first: dict[DiagnosticProblem, float] = {}
        for time, problem in self.problems:
            first.setdefault(problem, time)
        unused = [f"{seconds(time):>11}  {problem}" for problem, time in first.items()]
        if unused:
            lines = [*lines, "", "what could not be used, the first time:", *_cut(unused)]
        return AssertionError("\n".join(lines))


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
            ending = "still open" if plan.end is None else f"{plan.result} at {seconds(plan.end)}"
            moments.append(Moment(event.time, "plan", f"{commanded}: {ending}", plan.reason))
        elif event.kind is EventKind.ACTION_UPDATE:
            reason = ""
            if event.verb == "request_action":
                reason = reasons.get((event.time, event.subject), "")
            moments.append(Moment(event.time, "action", event.text, reason))
        elif event.verb == "component_active":
            if not event.arguments[1] and event.arguments[2]:  # else the plan's line says it
                moments.append(Moment(event.time, "heard", event.text))
        elif event.kind is not EventKind.RECORD:
            moments.append(Moment(event.time, "heard", event.text))
    return tuple(moments)


def _cut(lines: Sequence[str]) -> list[str]:
    more = len(lines) - MOST
    return [*lines[:MOST], *([f"... and {more} more"] if more > 0 else [])]


def _names(names: Names) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else tuple(names)


def _steps_of(plan: ReconfigurationPlan) -> list[tuple[str, str]]:
    steps = [("activate", name) for name in plan.activate]
    steps += [("deactivate", name) for name in plan.deactivate]
    return steps + [("configure", name) for name in plan.parameters]


def _phrases(steps: Iterable[tuple[str, str]]) -> list[str]:
    by_verb: dict[str, list[str]] = {}
    for verb, name in steps:
        by_verb.setdefault(verb, []).append(name)
    return [f"{verb} {', '.join(names)}" for verb, names in by_verb.items()]


# -------------------------------------------------------------------- replay


def replay(
    source: str | Path | Bag | Iterable[Message],
    mission: Mission | Model | Callable[[], Model] | str,
    behaviour: TaskFactory | None = None,
    *,
    task: str = "bt",
    settings: RunSettings | None = None,
    managed: ScriptedManaged | None = None,
    watch: Callable[[MissionRun], object] | None = None,
    traced: bool = True,
    on_error: Literal["fail", "raise"] = "raise",
) -> Decisions:
    """Replay a recording, and return what is decided now.

    Args:
        source: a recording, as `rosa run MISSION --record FILE` writes it, or written by hand; a
            rosbag2 with diagnostics (MCAP or sqlite3), or one that was read already; or the
            messages themselves.
        mission: the mission that decides, or its name; or, if a behaviour is given, only a model or
            a function that makes one.
        behaviour: makes a task layer that replaces the mission's, given the knowledge base and the
            percepts.
        task: the kind of the mission's task layer, "bt" or "pddl".
        settings: of the run, by default those of the recording; it ends a second after the
            recording at the latest.
        managed: the system that takes the commands, with its clock at 0; by default one that always
            obeys.
        watch: called with the run of the replay before it begins, e.g. to `listen` to it.
        traced: whether to keep the ticks of the tree, as `Decisions.trace`.
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
        takes_s = recorded.get("switching_s", {})
        usual_s = {verb: takes_s.get(verb, SWITCHING_S) for verb in VERBS}
        world.managed.follow(recorded.get("commands", ()), usual_s)
        values = {"duration_s": end_s, **recorded.get("settings", {})}
        texts = {name: str(value) for name, value in values.items()}
        limits = settings or RunSettings.read(texts)
    limits = replace(limits, duration_s=min(limits.duration_s, end_s))
    kind = "bt" if behaviour else task
    run = RosaRun(_mission_of(mission, behaviour), kind, world, limits, on_error=on_error)
    if watch is not None:
        watch(run)
    for component in world.managed.scripted:
        _ = run.kb.components[component]  # raises if there is none: the script is a mistake
    decisions = _decide(run, world, traced=traced)
    if decisions.problems and not isinstance(source, str | Path | Bag):
        lines = [f"\n  at {seconds(time)}: {problem}" for time, problem in decisions.problems]
        raise MissionError(f"the messages cannot be used as they are:{''.join(lines)}")
    return decisions


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


def _mission_of(
    source: Mission | Model | Callable[[], Model] | str, behaviour: TaskFactory | None
) -> Mission:
    """Return the mission that decides, with the behaviour as its tree."""
    if behaviour is not None and (isinstance(behaviour, Behaviour) or not callable(behaviour)):
        title = "what decides is made for each replay: lambda kb, percepts: ..."
        raise MissionError(f"{title}, not {behaviour!r}")
    mission = find_mission(source) if isinstance(source, str) else source
    if isinstance(mission, Mission):
        return replace(mission, tree=behaviour or mission.tree)
    if not isinstance(mission, Model) and not callable(mission):
        title = "what is replayed to is a mission, its name, a model or what makes one"
        raise MissionError(f"{title}, not {mission!r}")
    model = (
        mission if isinstance(mission, Model) else built("the model to replay to", Model, mission)
    )
    if behaviour is None:
        hint = "replay(source, model, behaviour)"
        raise MissionError(f"the model {model.name} decides nothing by itself; {hint}")
    return Mission(model.name, "", lambda: model, behaviour, _Nowhere())


def _messages_of(source: str | Path | Bag | Iterable[Message]) -> list[Message]:
    if isinstance(source, str | Path) and is_bag(source):
        source = read_bag(source)
    if not isinstance(source, Bag):
        return list(read_recording(source))
    return [source.header(), *source.messages] if source.run else source.messages


def _decide(run: RosaRun, world: Recording, *, traced: bool) -> Decisions:
    events: list[Event] = []
    run.kb.log.witnesses += (events.append,)
    trace = Trace(run.kb.model.name, ())
    with TraceVisitor(run.kb) if traced else nullcontext() as visitor:
        if visitor is not None:
            run.tree.add_visitor(visitor)
        verdict = run.run()
        if visitor is not None:
            trace = visitor.trace
    moments = timeline(events, run.adaptations)
    if world.unheard:
        ending = "time limit" if world.now >= run.settings.duration_s else "SUCCESS"
        ending = verdict.outcome if verdict.outcome == "aborted" else ending
        plural = "s were" if len(world.unheard) > 1 else " was"
        text = f"the mission ended ({ending}); {len(world.unheard)} message{plural} not heard"
        moments += (Moment(world.now, "end", text),)
    return Decisions(
        tuple((record.action, record.start, record.end, record.result) for record in run.actions),
        run.kb.plans,
        tuple(run.adaptations),
        run.plans,
        tuple(run.problems),
        moments,
        trace,
        tuple(events),
        run.kb,
    )


# -------------------------------------------------------------------- golden traces


def golden_path(test_file: Path, test: str, name: str = "") -> Path:
    """Return the path of a test's golden trace, in a folder beside its file.

    `name` if a test has several.
    """
    words = (
        re.sub(r"[^\w\-]+", "_", part).strip("_") for part in (test_file.stem, test, name) if part
    )
    return test_file.parent / "golden" / f"{'.'.join(words)}.trace"


def check_golden(trace: Trace, path: Path, *, update: bool, command: str) -> bool:
    """Compare a trace with the golden one; with `update`, write it if it differs.

    Return whether it was written.

    Raises:
        AssertionError: it differs or is missing; the message shows how, and the command that writes
            it.
        rosa_bt.TraceError: the file is no trace.
    """
    __tracebackhide__ = True
    if not isinstance(trace, Trace):
        raise TypeError(
            "a golden trace is a rosa_bt.Trace, such as decisions.trace, "
            f"not a {type(trace).__name__}"
        )
    text = str(trace)
    if path.exists() and path.read_text(encoding="utf-8") == text:
        return False
    if update:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, text.encode())
        return True
    now = list(readable(trace))
    if not path.exists():
        what = "there is no golden trace"
        how = "write"
        shown = now
    else:
        golden = list(readable(read_trace(path)))
        what = "not as in the golden trace"
        how = "update"
        shown = list(unified_diff(golden, now, "golden", "now", lineterm="", n=4))
    lines = "\n".join(_cut(shown))
    raise AssertionError(
        f"{what} {path}\nif this is as it should be, {how} it: {command}\n\n{lines}"
    )


def readable(trace: Trace) -> Iterator[str]:
    """Yield a trace as lines for people: for each tick with news, what changed in it."""
    yield f"model {trace.model}"
    before = None
    for tick in trace.ticks:
        told = [
            event for event, place in tick.events if place is not None
        ]  # not told by the tree itself
        lines = [
            f"  event    {event.verb} {', '.join(map(str, event.arguments))}" for event in told
        ]
        if before is None or tick.tree != before.tree:
            lines += [
                f"  tree     {'  ' * node.depth}{node.kind} {node.name}" for node in tick.tree
            ]
        if before is None or tick.visited != before.visited:
            for visit in tick.visited:
                feedback = f" ({visit.feedback})" if visit.feedback else ""
                lines.append(f"  ticked   {tick.tree[visit.node].name}: {visit.status}{feedback}")
        for decision in tick.decisions:
            reason = f": {decision.reason}" if decision.reason else ""
            lines.append(f"  decided  {decision.action} is {decision.what}{reason}")
        if lines:
            yield f"tick {tick.number} at {tick.time:.2f} s"
            yield from lines
        before = tick
    yield f"{len(trace.ticks)} ticks"
