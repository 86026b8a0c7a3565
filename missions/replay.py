"""A recorded mission decided once more, without a simulator.

The knowledge base, the manager and the task layer hear the recorded messages at their times, and decide; nothing is
measured anew. What they command takes as long as it did, and has no effect on the recording.

    from missions.replay import replay

    def test_it_recharges_when_the_battery_drops():
        decisions = replay("battery_drop.jsonl", "suave_extended", task="bt")
        assert [name for _, name in decisions.requested][:3] == ["search_pipeline", "inspect_pipeline", "recharge"]
"""

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from kb import DiagnosticProblem, ManagedSystem, ReconfigurationPlan
from missions.adaptations import Adaptation
from missions.mission import Message, Mission, World
from missions.recording import read_recording
from missions.registry import find_mission
from missions.runner import MissionRun
from missions.settings import RunSettings

if TYPE_CHECKING:
    from rosa_pddl import PlanRecord

__all__ = ["Decisions", "Recording", "replay"]

VERBS: Final = ("activate", "deactivate", "set_parameters")
SWITCHING_S: Final = 0.05
"""How long a command takes where a recording does not say [s]."""
AFTERMATH_S: Final = 1.0
"""How long a replay goes on after the last message, for what that set off [s]."""


@dataclass(frozen=True, slots=True)
class Decisions:
    """What was decided, task and architecture, in order; times in [s].

    Attributes:
        actions: (name, start, end, result) of every action; end and result None where the recording ends first.
        plans: every reconfiguration plan.
        adaptations: every adaptation with its reason.
        task_plans: every task plan; none for a tree.
        problems: (time, what) of every part of a message that could not be used.
    """

    actions: tuple[tuple[str, float, float | None, str | None], ...]
    plans: tuple[ReconfigurationPlan, ...]
    adaptations: tuple[Adaptation, ...]
    task_plans: tuple["PlanRecord", ...]
    problems: tuple[tuple[float, DiagnosticProblem], ...]

    @property
    def requested(self) -> tuple[tuple[float, str], ...]:
        """(time, name) of every action that was begun."""
        return tuple((start, name) for name, start, _, _ in self.actions)


def replay(
    path: str | Path,
    mission: Mission | str,
    *,
    task: str = "bt",
    settings: RunSettings | None = None,
    switching_s: float | None = None,
) -> Decisions:
    """Decide a recorded mission once more.

    Args:
        path: a recording, as `rosa run MISSION --record FILE` writes it, or written by hand.
        mission: whose model and task layer decide, or its name.
        task: the kind of task layer, "bt" or "pddl".
        settings: how it is run, by default as it was recorded; it ends a second after the recording at the latest.
        switching_s: how long a command to a component takes [s], by default as it was recorded, or 0.05.

    Raises:
        MissionError: the recording cannot be read, or there is no such mission or task layer.
    """
    wanted = find_mission(mission) if isinstance(mission, str) else mission
    messages = list(read_recording(path))
    recorded = messages[0].get("run", {}) if messages else {}
    limits = settings or RunSettings(**recorded.get("settings", {}))
    takes_s = recorded.get("switching_s", {}) if switching_s is None else {}
    default_s = SWITCHING_S if switching_s is None else switching_s
    world = Recording(messages, {verb: takes_s.get(verb, default_s) for verb in VERBS})
    end_s = max((message["time"] for message in messages), default=0.0) + AFTERMATH_S
    limits = replace(limits, duration_s=min(limits.duration_s, end_s))
    run = MissionRun(wanted, task, world, limits)
    run.run()
    return Decisions(
        actions=tuple((one.action, one.start, one.end, one.result) for one in run.kb.action_history),
        plans=run.kb.plans,
        adaptations=tuple(run.adaptations),
        task_plans=run.plans,
        problems=tuple(run.problems),
    )


class _Command:
    """A command that ends at a set time; carried out without a robot."""

    def __init__(self, end_s: float, clock: Callable[[], float]) -> None:
        self.end_s = end_s
        self._clock = clock

    def done(self) -> bool:
        return self._clock() >= self.end_s

    def exception(self) -> None:
        return None


class _Commanded:
    """A managed system in which every command succeeds after a set time, one after the other for each component."""

    def __init__(self, clock: Callable[[], float], switching_s: Mapping[str, float]) -> None:
        self._clock = clock
        self._switching_s = switching_s
        self._busy_until: dict[str, float] = {}

    def next_end(self) -> float:
        """When the next command that is under way ends [s], infinity if none is."""
        return min((end for end in self._busy_until.values() if end > self._clock()), default=float("inf"))

    def activate(self, component: str) -> _Command:
        return self._command("activate", component)

    def deactivate(self, component: str) -> _Command:
        return self._command("deactivate", component)

    def set_parameters(self, component: str, parameters: object) -> _Command:
        return self._command("set_parameters", component)

    def _command(self, verb: str, component: str) -> _Command:
        begin = max(self._clock(), self._busy_until.get(component, 0.0))
        self._busy_until[component] = begin + self._switching_s[verb]
        return _Command(self._busy_until[component], self._clock)


class Recording(World):
    """A world in which what was recorded happens, and nothing else.

    Args:
        messages: in order of time.
        switching_s: how long a command takes, by its verb [s].
    """

    def __init__(self, messages: Iterable[Message], switching_s: Mapping[str, float]) -> None:
        self._messages = deque(messages)
        self._now = 0.0
        self._managed = _Commanded(lambda: self._now, switching_s)

    @property
    def now(self) -> float:
        """The time of the recording [s]."""
        return self._now

    @property
    def managed(self) -> ManagedSystem:
        """What takes the commands."""
        return self._managed

    def advance(self, until: float) -> list[Message]:
        """Go on to the next message or end of a command, at most to the time `until` [s]."""
        following = self._messages[0]["time"] if self._messages else float("inf")
        self._now = max(self._now, min(until, following, self._managed.next_end()))
        heard = []
        while self._messages and self._messages[0]["time"] <= self._now:
            heard.append(self._messages.popleft())
        return heard
