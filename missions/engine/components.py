"""A managed system that does as it is scripted: at once, slowly, wrongly, not at all, or not as it says."""

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple, Self

from kb.elements import Parameters
from missions.testing.clock import FakeClock

__all__ = ["Command", "CommandFailed", "ScriptedManaged", "VERBS"]

VERBS: Final = ("activate", "deactivate", "set_parameters")


class CommandFailed(Exception):
    """A command failed because a script says so."""


class Command(NamedTuple):
    """What a component was told.

    Attributes:
        time: when [s].
        verb: "activate", "deactivate" or "set_parameters".
        component: its name.
        parameters: empty unless they are what is set.
    """

    time: float
    verb: str
    component: str
    parameters: Parameters


@dataclass(frozen=True, slots=True)
class _Script:
    """How a component takes one kind of command; `takes` None is as the system's other components."""

    takes: float | None = None
    fail_first: float = 0
    hangs: bool = False
    lies: bool = False
    crash_after: float = math.inf


_AS_TOLD: Final = _Script()


@dataclass(slots=True)
class _Operation:
    """A command that is under way."""

    clock: FakeClock
    end: float
    effect: Callable[[float], None] | None
    error: CommandFailed | None = None

    def done(self) -> bool:
        if self.clock.now < self.end:
            return False
        effect, self.effect = self.effect, None
        if effect is not None:
            effect(self.end)
        return True

    def exception(self) -> CommandFailed | None:
        return self.error

    def cancel(self) -> None:
        self.effect = None


@dataclass(slots=True)
class _State:
    """What is true of a component."""

    is_active: bool = False
    crashes_at: float = math.inf
    busy_until: float = 0.0
    parameters: Parameters = field(default_factory=dict)
    under_way: list[_Operation] = field(default_factory=list)


class ScriptedManaged:
    """A managed system without a robot; every component does what it is told unless a script says otherwise.

    Commands to one component are carried out one after the other.

    Args:
        clock: gives the time, and is moved by the test, or by the replay.
        takes: how long a command takes [s], or that by its verb; None: no time, in a replay as long as recorded.
    """

    def __init__(self, clock: FakeClock, takes: float | Mapping[str, float] | None = None) -> None:
        self.clock = clock
        self._takes = None if takes is None else _by_verb(takes)
        self._scripts: dict[tuple[str, str], _Script] = {}
        self._given: Counter[tuple[str, str]] = Counter()
        self._states: dict[str, _State] = {}
        self._commands: list[Command] = []

    def script(
        self,
        component: str,
        *verbs: str,
        takes: float | None = None,
        fail_first: float = 0,
        hangs: bool = False,
        lies: bool = False,
        crash_after: float = math.inf,
    ) -> Self:
        """Say how a component behaves from now on; what was said of the same commands before is forgotten.

        Args:
            component: its name.
            verbs: the commands that this is about: "activate", "deactivate", "set_parameters"; none: all.
            takes: how long a command takes [s].
            fail_first: how many commands of each kind fail; `math.inf` for all.
            hangs: commands never end.
            lies: commands are said to be done, and nothing has happened.
            crash_after: how long after each start the component stops by itself [s].

        Returns:
            The system, for the next script.

        Raises:
            ValueError: no such command, or a number below 0.
        """
        numbers = {"takes": takes or 0.0, "fail_first": fail_first, "crash_after": crash_after}
        for name, number in numbers.items():
            if not number >= 0:
                raise ValueError(f"{name} of {component} is {number!r}; allowed is a number from 0")
        for verb in verbs or VERBS:
            _check_verb(verb)
            self._given[verb, component] = 0
            self._scripts[verb, component] = _Script(takes, fail_first, hangs, lies, crash_after)
        return self

    def take(self, takes: float | Mapping[str, float]) -> None:
        """Say how long commands take that no script is about [s], unless that was said before."""
        if self._takes is None:
            self._takes = _by_verb(takes)

    @property
    def commands(self) -> tuple[Command, ...]:
        """Every command that was given, in order."""
        return tuple(self._commands)

    @property
    def active(self) -> frozenset[str]:
        """The components that truly run now."""
        return frozenset(name for name in self._states if self.is_active(name))

    def parameters(self, component: str) -> Parameters:
        """Return the parameters that a component truly has; empty if it never got any."""
        return dict(self._now(component).parameters) if component in self._states else {}

    def scripted(self) -> tuple[str, ...]:
        """Return the names of the components that there are scripts for."""
        return tuple(dict.fromkeys(component for _, component in self._scripts))

    def next_event(self) -> float:
        """When a command that is under way ends next, or a component crashes [s]; infinity for never."""
        ahead = math.inf
        for name in self._states:
            state = self._now(name)
            ends = [operation.end for operation in state.under_way if operation.effect or operation.error]
            ahead = min([ahead, state.crashes_at, *ends])
        return ahead

    def activate(self, component: str) -> _Operation:
        """Start a component."""
        crash_after = self._script("activate", component).crash_after

        def start(state: _State, time: float) -> None:
            if not state.is_active or state.crashes_at <= time:
                state.is_active, state.crashes_at = True, time + crash_after

        return self._command("activate", component, {}, start)

    def deactivate(self, component: str) -> _Operation:
        """Stop a component."""

        def stop(state: _State, time: float) -> None:
            state.is_active, state.crashes_at = False, math.inf

        return self._command("deactivate", component, {}, stop)

    def set_parameters(self, component: str, parameters: Parameters) -> _Operation:
        """Give a component its parameters."""

        def take(state: _State, time: float) -> None:
            state.parameters = dict(parameters)

        return self._command("set_parameters", component, parameters, take)

    def is_active(self, component: str) -> bool:
        """Tell the truth, also of one that lies; what was never told anything does not run."""
        return component in self._states and self._now(component).is_active

    def _command(
        self, verb: str, component: str, parameters: Parameters, effect: Callable[[_State, float], None]
    ) -> _Operation:
        now = self.clock.now
        self._commands.append(Command(now, verb, component, dict(parameters)))
        state = self._states.setdefault(component, _State())
        script = self._script(verb, component)
        self._given[verb, component] += 1
        given = self._given[verb, component]
        takes = script.takes if script.takes is not None else (self._takes or {}).get(verb, 0.0)
        if script.hangs:
            return _Operation(self.clock, math.inf, None)
        state.busy_until = max(now, state.busy_until) + takes
        if given <= script.fail_first:
            error = CommandFailed(f"{verb} {component} fails by its script, time {given}")
            operation = _Operation(self.clock, state.busy_until, None, error)
        elif script.lies:
            operation = _Operation(self.clock, state.busy_until, lambda time: None)
        else:
            operation = _Operation(self.clock, state.busy_until, lambda time: effect(state, time))
        state.under_way.append(operation)
        return operation

    def _script(self, verb: str, component: str) -> _Script:
        return self._scripts.get((verb, component), _AS_TOLD)

    def _now(self, component: str) -> _State:
        """Return what is true of a component by now: what has ended has had its effect."""
        state = self._states[component]
        if state.under_way:
            state.under_way = [operation for operation in state.under_way if not operation.done()]
        if self.clock.now >= state.crashes_at:
            state.is_active, state.crashes_at = False, math.inf
        return state


def _by_verb(takes: float | Mapping[str, float]) -> Mapping[str, float]:
    by_verb = dict(takes) if isinstance(takes, Mapping) else dict.fromkeys(VERBS, takes)
    for verb, seconds in by_verb.items():
        _check_verb(verb)
        if not seconds >= 0:
            raise ValueError(f"{verb} takes {seconds!r}; allowed is a number of seconds from 0")
    return by_verb


def _check_verb(verb: str) -> None:
    if verb not in VERBS:
        raise ValueError(f"{verb!r} is no command; commands are {', '.join(VERBS)}")
