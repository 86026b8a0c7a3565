"""Replay a recorded stream of diagnostics without a simulator; what is decided then, assertions and golden traces.

The knowledge base, the manager and the task layer receive the recorded messages at their times, and decide again. Their
commands take as long as in the recording, and have no effect on the messages.
"""

import math
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from difflib import ndiff, unified_diff
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, NamedTuple, TypeVar

from py_trees.behaviour import Behaviour

from kb import DiagnosticProblem, Event, EventKind, KnowledgeBase, Model, ReconfigurationPlan
from kb.files import write_file
from missions.engine.adaptations import Adaptation
from missions.engine.components import VERBS
from missions.engine.mission import (
    Message,
    Mission,
    MissionError,
    Percepts,
    Verdict,
    World,
    WorldKind,
    blamed,
    built,
    find_mission,
)
from missions.engine.recording import read_recording
from missions.engine.runner import MissionRun, RosaRun
from missions.engine.settings import RunSettings
from missions.testing.scripted import FakeClock, ScriptedManaged
from missions.wires.mcap import Bag, is_bag, read_bag
from rosa_bt import Trace, TraceVisitor, read_trace

if TYPE_CHECKING:
    from numpy.random import Generator

    from rosa_pddl import PlanRecord

SLACK_S: Final = 1e-6  # tolerance for rounding errors of summed ticks [s]
AROUND: Final = 3  # how many moments before and after the expected time a failure shows
MOST: Final = 40  # how many lines of one kind a failure shows at most
T = TypeVar("T")
Names = str | Iterable[str]
Steps = list[tuple[str, tuple[str, ...]]]
"""Changes by plans: verbs, each with names of components or configurations."""
TaskFactory = Callable[[KnowledgeBase, Percepts], Behaviour]
"""Makes what decides about actions: a tree, or a plan executor (whose clock is then `lambda: kb.now`)."""

SWITCHING_S: Final = 0.05
"""How long a command takes if the recording does not say it [s]."""
AFTERMATH_S: Final = 1.0
"""How long a replay goes on after the last message, for the reaction to it [s]."""


class Moment(NamedTuple):
    """One line of a timeline, at a time [s]; `reason` is empty if none is known."""

    time: float
    what: str
    """One of "heard", "action" or "plan"; or "end" of a mission that ended before its recording."""
    text: str
    reason: str = ""

    def __str__(self) -> str:
        line = f"{seconds(self.time):>11}  {self.what:<8}  {self.text}"
        return f"{line}\n{'':23}because {self.reason}" if self.reason else line


@dataclass(frozen=True, slots=True)
class Decisions:
    """All decisions of a replay about task and architecture, in order; times in [s].

    The assertions take `at`, the earliest time at which something may happen, and `within`, how long after that it has
    to be in force. A name that the model does not have is an error, never a silent success.

    Attributes:
        actions: (name, start, end, result) of every action; end and result are None if the recording ends before.
        adaptations: every adaptation with its reason.
        task_plans: every task plan; none for a tree.
        problems: (time, what) of every part of a message that could not be used; failures show them.
        timeline: what became known and was decided, for people.
        trace: every tick of the task layer, as data.
        events: all events of the knowledge base, as data.
        kb: the knowledge base at the end, for anything else that a test wants to know.
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
        return tuple(one for one in self.adaptations if one.action in self.kb.actions)

    def assert_actions(self, *names: str) -> None:
        """Assert that exactly these actions were begun, in this order."""
        __tracebackhide__ = True
        self._check("actions", *names)
        begun = [name for name, *_ in self.actions]
        if begun != list(names):
            actions = "\n".join(
                str(moment) for moment in self.timeline if moment.what in ("action", "end")
            )
            diff = "\n".join(
                line.rstrip() for line in ndiff(names, begun) if not line.startswith("?")
            )
            headline = "other actions were begun (-: expected, +: what was done)"
            raise self._error(headline, f"{diff}\n\nwhat happened:\n{actions}")

    def assert_begins(self, action: str, *, at: float, within: float = 1.0) -> None:
        """Assert that an action begins."""
        __tracebackhide__ = True
        self._check("actions", action)
        starts = [start for name, start, _, _ in self.actions if name == action]
        found = [(start, start, f"it begins at {seconds(start)}", action) for start in starts]
        self._in_time(f"{action} begins", at, within, found)

    def assert_ends(
        self, action: str, result: str = "completed", *, at: float, within: float = 1.0
    ) -> None:
        """Assert that an action ends "completed", "failed" or "abandoned"."""
        __tracebackhide__ = True
        self._check("actions", action)
        ends = [
            (end, how) for name, _, end, how in self.actions if name == action and end is not None
        ]
        found = [
            (end, end if how == result else math.inf, f"it is {how} at {seconds(end)}", action)
            for end, how in ends
        ]
        self._in_time(f"{action} is {result}", at, within, found)

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
        self._check("actions", *filter(None, (from_, to)))
        changes = [
            one for one in self.changes if from_ in (None, one.before) and to in (None, one.action)
        ]
        found = [(one.at_s, one.in_force_s, _in_words(one), one) for one in changes]
        return self._in_time(f"{from_ or 'any'} -> {to or 'any'}", at, within, found)

    def assert_reconfigures(
        self,
        *,
        at: float,
        activate: Names = (),
        deactivate: Names = (),
        configure: Names = (),
        within: float = 1.0,
    ) -> ReconfigurationPlan:
        """Assert that a plan makes at least these changes, by names of components and configurations; return it.

        The event that calls for it happens at `at` [s]; the plan must be carried out at most `within` [s] later.
        """
        __tracebackhide__ = True
        wanted = self._steps(activate, deactivate, configure)
        plans = [
            plan
            for plan in self.plans
            if all(set(names) <= set(_done(plan)[verb]) for verb, names in wanted)
        ]
        found = [(one.start, _in_force(one), _ended(one), one) for one in plans]
        return self._in_time("; ".join(_phrases(wanted)), at, within, found)

    def assert_never(
        self,
        *,
        action: Names = (),
        activate: Names = (),
        deactivate: Names = (),
        configure: Names = (),
        since: float = 0.0,
        until: float = math.inf,
    ) -> None:
        """Assert that none of these begins from `since` until `until` [s].

        Raises:
            ValueError: the replay has no such time, or nothing is named, which would hold for any replay.
        """
        __tracebackhide__ = True
        if not since <= min(until, self.kb.now):
            raise ValueError(
                f"from {since:g} s until {until:g} s is no time of this replay of {self.kb.now:g} s"
            )
        actions = _names(action)
        self._check("actions", *actions)
        unwanted = self._steps(activate, deactivate, configure, least=0 if actions else 1)
        begun = [
            (start, f"{name} is requested") for name, start, _, _ in self.actions if name in actions
        ]
        for plan in self.plans:
            done = [
                f"{verb} {name}"
                for verb, names in unwanted
                for name in names
                if name in _done(plan)[verb]
            ]
            begun += [(plan.start, text) for text in done]
        found = sorted(
            (time, text) for time, text in begun if since - SLACK_S <= time <= until + SLACK_S
        )
        if found:
            never = "never " + " or ".join(
                [*(f"begin {name}" for name in actions), *_phrases(unwanted)]
            )
            times = _list(f"{text} at {seconds(time)}" for time, text in found)
            shown = _around(self.timeline, found[0][0], found[0][0], never)
            raise self._error(f"expected: {never}", f"{times}\n\nwhat happened:\n{shown}")

    def _steps(self, activate: Names, deactivate: Names, configure: Names, least: int = 1) -> Steps:
        steps = [("activate", activate), ("deactivate", deactivate), ("configure", configure)]
        asked = [(verb, _names(names)) for verb, names in steps if names]
        if len(asked) < least:
            raise ValueError("say what to look for: activate=..., deactivate=... or configure=...")
        for verb, names in asked:
            self._check("configurations" if verb == "configure" else "components", *names)
        return asked

    def _check(self, kind: str, *names: str) -> None:
        for name in names:
            getattr(self.kb, kind)[name]

    def _in_time(
        self, expected: str, at: float, within: float, found: Sequence[tuple[float, float, str, T]]
    ) -> T:
        """Return the first thing found (begin [s], in force [s], in words, thing) that is in time; raise if none is."""
        __tracebackhide__ = True
        for begin, end, _, one in found:
            if begin >= at - SLACK_S and end <= at + within + SLACK_S:
                return one
        headline = f"expected between {seconds(at)} and {seconds(at + within)}: {expected}"
        instead = _list([words for _, _, words, _ in found] or ["it never does"])
        shown = _around(self.timeline, at, at + within, expected)
        raise self._error(headline, f"{instead}\n\nwhat happened around {seconds(at)}:\n{shown}")

    def _error(self, headline: str, rest: str) -> AssertionError:
        first = {problem: time for time, problem in reversed(self.problems)}
        unused = [
            f"{seconds(first[one]):>11}  {one}" for one in sorted(first, key=first.__getitem__)
        ]
        told = ["", "what could not be used, the first time:", *_cut(unused)] if unused else []
        return AssertionError("\n".join([headline, rest, *told]))


def seconds(time: float) -> str:
    """Return a time as text, to the hundredth of a second."""
    return f"{time:.2f} s"


def timeline(events: Iterable[Event], adaptations: Iterable[Adaptation]) -> tuple[Moment, ...]:
    """Return all events, in order, as moments, with the reasons of the adaptations."""
    reasons = {(one.at_s, one.action): one.why for one in adaptations}
    moments = []
    for event in events:
        if event.plan is not None:
            plan = event.plan
            commanded = str(plan).partition("; note as ")[0]  # without what a plan only notes
            ending = "still open" if plan.end is None else f"{plan.result} at {seconds(plan.end)}"
            moments.append(Moment(event.time, "plan", f"{commanded}: {ending}", plan.reason))
        elif event.kind is EventKind.ACTION_UPDATE:
            is_begun = event.verb == "request_action"
            reason = reasons.get((event.time, event.subject), "") if is_begun else ""
            moments.append(Moment(event.time, "action", event.text, reason))
        elif not _is_our_own(event):
            moments.append(Moment(event.time, "heard", event.text))
    return tuple(moments)


def _around(moments: Sequence[Moment], begin: float, end: float, expected: str) -> str:
    """Return the moments in an interval [s], a few before and after it, and the expectation in its place, as text."""
    before = [one for one in moments if one.time < begin]
    within = [one for one in moments if begin <= one.time <= end]
    after = [one for one in moments if one.time > end]
    shown = [*map(str, before[-AROUND:]), f"{seconds(begin):>11}  EXPECTED  {expected}"]
    return "\n".join([*shown, *_cut([str(one) for one in within]), *map(str, after[:AROUND])])


def _cut(lines: Sequence[str]) -> list[str]:
    return [*lines[:MOST], *([f"... and {len(lines) - MOST} more"] if len(lines) > MOST else [])]


def _is_our_own(event: Event) -> bool:
    """Whether an event only notes what a plan has switched, which the line of the plan says already."""
    if event.verb != "component_active":
        return event.kind is EventKind.RECORD
    _, is_active, reason = event.arguments
    return is_active or not reason


def _list(items: Iterable[str]) -> str:
    return "\n".join(f"  but {item}" for item in items)


def _names(names: Names) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else tuple(names)


def _in_words(change: Adaptation) -> str:
    never = math.isinf(change.in_force_s)
    soon = "is never in force" if never else f"is in force at {seconds(change.in_force_s)}"
    return f"{change.before} -> {change.action} is decided at {seconds(change.at_s)} and {soon} (because {change.why})"


def _done(plan: ReconfigurationPlan) -> dict[str, tuple[str, ...]]:
    return {"activate": plan.activate, "deactivate": plan.deactivate, "configure": plan.parameters}


def _in_force(plan: ReconfigurationPlan) -> float:
    return plan.end if plan.result == "completed" and plan.end is not None else math.inf


def _phrases(steps: Steps) -> list[str]:
    return [f"{verb} {', '.join(names)}" for verb, names in steps]


def _ended(plan: ReconfigurationPlan) -> str:
    how = (
        "is still open at the end"
        if plan.end is None
        else f"is {plan.result} at {seconds(plan.end)}"
    )
    return f"the plan of {seconds(plan.start)} {how} (because {plan.reason})"


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
        source: a recording, as `rosa run MISSION --record FILE` writes it, or written by hand; a rosbag2 with
            diagnostics (MCAP or sqlite3), or one that was read already; or the messages themselves.
        mission: the mission that decides, or its name; or, if a behaviour is given, only a model or a function that
            makes one.
        behaviour: makes a task layer that replaces the mission's, given the knowledge base and the percepts.
        task: the kind of the mission's task layer, "bt" or "pddl".
        settings: of the run, by default those of the recording; it ends a second after the recording at the latest.
        managed: the system that takes the commands, with its clock at 0; by default one that always obeys.
        watch: called with the run of the replay before it begins, e.g. to `listen` to it.
        traced: whether to keep the ticks of the tree, as `Decisions.trace`.
        on_error: what a behaviour that raises does: "raise" ends the replay, "fail" is as on a robot.

    Raises:
        MissionError: a behaviour raises; the recording cannot be read; there is no such mission, task layer or behaviour; or a part of a
            message cannot be used, if the messages themselves are given (of a recording it is in `problems`).
        kb.UnknownName: a script names a component that the model does not have.
    """
    messages = _messages_of(source)
    recorded = messages[0].get("run", {}) if messages else {}
    world = Recording(messages, managed or ScriptedManaged(FakeClock()))
    end_s = max((message["time"] for message in messages), default=0.0) + AFTERMATH_S
    with blamed(lambda: "what the recording says of how it was run cannot be used"):
        takes_s = recorded.get("switching_s", {})
        world.managed.follow(
            recorded.get("commands", ()), {verb: takes_s.get(verb, SWITCHING_S) for verb in VERBS}
        )
        as_recorded = {"duration_s": end_s, **recorded.get("settings", {})}
        limits = settings or RunSettings.read(
            {name: str(value) for name, value in as_recorded.items()}
        )
    limits = replace(limits, duration_s=min(limits.duration_s, end_s))
    kind = "bt" if behaviour else task
    run = RosaRun(_asked(mission, behaviour), kind, world, limits, on_error=on_error)
    if watch is not None:
        watch(run)
    decisions = _decided(run, world, traced=traced)
    if decisions.problems and not isinstance(source, str | Path | Bag):
        found = "".join(
            f"\n  at {seconds(time)}: {problem}" for time, problem in decisions.problems
        )
        raise MissionError(f"the messages cannot be used as they are:{found}")
    return decisions


class Recording(World):
    """A world that publishes the recorded messages, and nothing else.

    Its clock is that of the managed system, which has to show 0.
    """

    def __init__(self, messages: Iterable[Message], managed: ScriptedManaged) -> None:
        if managed.clock.now != 0.0:
            raise MissionError(
                f"a replay begins at 0 s, not at {managed.clock.now:g} s; hand in a new managed system"
            )
        self.unheard, self._managed = deque(messages), managed
        self._now = 0.0

    @property
    def now(self) -> float:
        return self._now

    @property
    def managed(self) -> ScriptedManaged:
        return self._managed

    def advance(self, until: float) -> list[Message]:
        """Go on to the next message or end of a command, at most until `until` [s]."""
        unheard = self.unheard
        following = unheard[0]["time"] if unheard else math.inf
        now = max(self._now, min(until, following, self._managed.next_event()))
        self._now = self._managed.clock.advance_to(now)
        heard = []
        while unheard and unheard[0]["time"] <= now:
            heard.append(unheard.popleft())
        return heard


class _Nowhere(WorldKind):
    """The world of a model without a mission; it exists for replays only."""

    def open(self, values: Mapping[str, str], rng: "Generator") -> World:
        raise MissionError("a model alone has no world; replay a recording to it")

    def verdict(
        self, percepts: Percepts, results: Mapping[str, float | None], kb: KnowledgeBase
    ) -> Verdict:
        return Verdict("replayed", "")


def _asked(
    mission: Mission | Model | Callable[[], Model] | str, behaviour: TaskFactory | None
) -> Mission:
    if behaviour is not None and (isinstance(behaviour, Behaviour) or not callable(behaviour)):
        raise MissionError(
            f"what decides is made for each replay: lambda kb, percepts: ..., not {behaviour!r}"
        )
    wanted = find_mission(mission) if isinstance(mission, str) else mission
    if not isinstance(wanted, Mission | Model) and not callable(wanted):
        raise MissionError(
            f"what is replayed to is a mission, its name, a model or what makes one, not {wanted!r}"
        )
    if not isinstance(wanted, Mission):
        model = (
            wanted if isinstance(wanted, Model) else built("the model to replay to", Model, wanted)
        )
        if behaviour is None:
            raise MissionError(
                f"the model {model.name} decides nothing by itself; replay(source, model, behaviour)"
            )
        return Mission(model.name, "", lambda: model, behaviour, _Nowhere())
    return replace(wanted, tree=behaviour or wanted.tree)


def _messages_of(source: str | Path | Bag | Iterable[Message]) -> list[Message]:
    if isinstance(source, str | Path) and is_bag(source):
        source = read_bag(source)
    if not isinstance(source, Bag):
        return list(read_recording(source))
    return [source.header(), *source.messages] if source.run else source.messages


def _decided(run: RosaRun, world: Recording, *, traced: bool) -> Decisions:
    for component in world.managed.scripted:
        _ = run.kb.components[component]  # raises if there is none: the script is a mistake
    events: list[Event] = []
    run.kb.log.witnesses += (events.append,)
    with TraceVisitor(run.kb) if traced else nullcontext() as visitor:
        if visitor is not None:
            run.tree.add_visitor(visitor)
        verdict = run.run()
        trace = Trace(run.kb.model.name, ()) if visitor is None else visitor.trace
    moments = list(timeline(events, run.adaptations))
    if world.unheard:
        is_late = world.now >= run.settings.duration_s
        how = "aborted" if verdict.outcome == "aborted" else "time limit" if is_late else "SUCCESS"
        count = f"{len(world.unheard)} message{'s were' if len(world.unheard) > 1 else ' was'} not heard"
        moments.append(Moment(world.now, "end", f"the mission ended ({how}); {count}"))
    return Decisions(
        actions=tuple(
            (one.action, one.start, one.end, one.result) for one in run.kb.history.actions
        ),
        plans=run.kb.plans,
        adaptations=tuple(run.adaptations),
        task_plans=run.plans,
        problems=tuple(run.problems),
        timeline=tuple(moments),
        trace=trace,
        events=tuple(events),
        kb=run.kb,
    )


# -------------------------------------------------------------------- golden traces


def golden_path(test_file: Path, test: str, name: str = "") -> Path:
    """Return the path of a test's golden trace, in a folder beside its file; `name` if a test has several."""
    words = (
        re.sub(r"[^\w\-]+", "_", part).strip("_") for part in (test_file.stem, test, name) if part
    )
    return test_file.parent / "golden" / f"{'.'.join(words)}.trace"


def check_golden(trace: Trace, path: Path, *, update: bool, command: str) -> bool:
    """Compare a trace with the golden one; with `update`, write it if it differs. Return whether it was written.

    Raises:
        AssertionError: it differs or is missing; the message shows how, and the command that writes it.
        rosa_bt.TraceError: the file is no trace.
    """
    __tracebackhide__ = True
    if not isinstance(trace, Trace):
        raise TypeError(
            f"a golden trace is a rosa_bt.Trace, such as decisions.trace, not a {type(trace).__name__}"
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
        what, how, shown = "there is no golden trace", "write", now
    else:
        golden = list(readable(read_trace(path)))
        what, how = "not as in the golden trace", "update"
        shown = list(unified_diff(golden, now, "golden", "now", lineterm="", n=4))
    lines = "\n".join(_cut(shown))
    raise AssertionError(
        f"{what} {path}\nif this is as it should be, {how} it: {command}\n\n{lines}"
    )


def readable(trace: Trace) -> Iterator[str]:
    """Yield a trace as lines for people: for each tick with news, the events, the nodes ticked and the decisions."""
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
