"""Replay a recorded stream of diagnostics without a simulator, and decide again.

The knowledge base, the manager and the task layer receive the recorded messages at their times, and decide. Their
commands take as long as in the recording, and have no effect on the messages.
"""

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from py_trees.behaviour import Behaviour

from kb import Event, KnowledgeBase, Model
from missions.engine.components import VERBS
from missions.engine.mission import Message, Mission, MissionError, Percepts, Verdict, World, WorldKind, built
from missions.engine.recording import read_recording
from missions.engine.registry import find_mission
from missions.engine.runner import MissionRun, RosaRun
from missions.engine.settings import RunSettings
from missions.testing.decisions import Decisions, Moment, seconds, timeline
from missions.testing.scripted import FakeClock, ScriptedManaged
from rosa_bt import Trace, TraceVisitor

if TYPE_CHECKING:
    from numpy.random import Generator

    from missions.wires.mcap import Bag


TaskFactory = Callable[[KnowledgeBase, Percepts], Behaviour]
"""Makes what decides about actions: a tree, or a plan executor (whose clock is then `lambda: kb.now`)."""

SWITCHING_S: Final = 0.05
"""How long a command takes if the recording does not say it [s]."""
AFTERMATH_S: Final = 1.0
"""How long a replay goes on after the last message, for the reaction to it [s]."""


def replay(
    source: "str | Path | Bag | Iterable[Message]",
    mission: Mission | Model | Callable[[], Model] | str,
    behaviour: TaskFactory | None = None,
    *,
    task: str = "bt",
    settings: RunSettings | None = None,
    managed: ScriptedManaged | None = None,
    strict: bool | None = None,
    watch: Callable[[MissionRun], object] | None = None,
    traced: bool = True,
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
        strict: whether parts of messages that the model does not know are an error; by default only if the messages
            themselves are given, not a file.
        watch: called with the run of the replay before it begins, e.g. to `listen` to it.
        traced: whether to keep the ticks of the tree, as `Decisions.trace`.

    Raises:
        MissionError: the recording cannot be read; there is no such mission, task layer or behaviour; or, if strict,
            a part of a message cannot be used (otherwise it is in `problems`).
        kb.UnknownName: a script names a component that the model does not have.
    """
    messages = _messages_of(source)
    recorded = messages[0].get("run", {}) if messages else {}
    world = Recording(messages, managed or ScriptedManaged(FakeClock()))
    takes_s = recorded.get("switching_s", {})
    world.managed.follow(recorded.get("commands", ()), {verb: takes_s.get(verb, SWITCHING_S) for verb in VERBS})
    end_s = max((message["time"] for message in messages), default=0.0) + AFTERMATH_S
    as_recorded = {"duration_s": end_s, **recorded.get("settings", {})}
    limits = settings or RunSettings.read({name: str(value) for name, value in as_recorded.items()})
    limits = replace(limits, duration_s=min(limits.duration_s, end_s))
    decisions = _decide(_asked(mission, behaviour), "bt" if behaviour else task, world, limits, watch, traced=traced)
    is_strict = not isinstance(source, str | Path) if strict is None else strict
    if is_strict and decisions.problems:
        found = "".join(f"\n  at {seconds(time)}: {problem}" for time, problem in decisions.problems)
        raise MissionError(f"the messages cannot be used as they are:{found}")
    return decisions


class Recording(World):
    """A world that publishes the recorded messages, and nothing else.

    Its clock is that of the managed system, which has to show 0.
    """

    def __init__(self, messages: Iterable[Message], managed: ScriptedManaged) -> None:
        if managed.clock.now != 0.0:
            raise MissionError(f"a replay begins at 0 s, not at {managed.clock.now:g} s; hand in a new managed system")
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

    def verdict(self, percepts: Percepts, results: Mapping[str, float | None], kb: KnowledgeBase) -> Verdict:
        return Verdict("replayed", "")


def _asked(mission: Mission | Model | Callable[[], Model] | str, behaviour: TaskFactory | None) -> Mission:
    if behaviour is not None and (isinstance(behaviour, Behaviour) or not callable(behaviour)):
        raise MissionError(f"what decides is made for each replay: lambda kb, percepts: ..., not {behaviour!r}")
    wanted = find_mission(mission) if isinstance(mission, str) else mission
    if not isinstance(wanted, Mission | Model) and not callable(wanted):
        raise MissionError(f"what is replayed to is a mission, its name, a model or what makes one, not {wanted!r}")
    if not isinstance(wanted, Mission):
        model = wanted if isinstance(wanted, Model) else built("the model to replay to", Model, wanted)
        if behaviour is None:
            raise MissionError(f"the model {model.name} decides nothing by itself; replay(source, model, behaviour)")
        return Mission(model.name, "", lambda: model, behaviour, _Nowhere())
    return replace(wanted, tree=behaviour or wanted.tree)


def _messages_of(source: "str | Path | Bag | Iterable[Message]") -> list[Message]:
    from missions.wires.mcap import Bag, is_bag, read_bag

    if isinstance(source, str | Path) and is_bag(source):
        source = read_bag(source)
    return [source.header(), *source.messages] if isinstance(source, Bag) else list(read_recording(source))


def _decide(
    mission: Mission,
    task: str,
    world: Recording,
    limits: RunSettings,
    watch: Callable[[MissionRun], object] | None,
    *,
    traced: bool,
) -> Decisions:
    run = RosaRun(mission, task, world, limits)
    if watch is not None:
        watch(run)
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
        is_late = world.now >= limits.duration_s
        how = "aborted" if verdict.outcome == "aborted" else "time limit" if is_late else "SUCCESS"
        count = f"{len(world.unheard)} message{'s were' if len(world.unheard) > 1 else ' was'} not heard"
        moments.append(Moment(world.now, "end", f"the mission ended ({how}); {count}"))
    return Decisions(
        actions=tuple((one.action, one.start, one.end, one.result) for one in run.kb.history.actions),
        plans=run.kb.plans,
        adaptations=tuple(run.adaptations),
        task_plans=run.plans,
        problems=tuple(run.problems),
        timeline=tuple(moments),
        trace=trace,
        events=tuple(events),
        kb=run.kb,
    )
