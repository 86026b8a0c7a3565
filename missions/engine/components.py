"""Components that switch in simulated time: each command takes a set time, and scripts can make it go wrong."""

import heapq
import math
from collections import Counter
from collections.abc import Callable, Mapping
from functools import partial
from itertools import count
from typing import Final, NamedTuple, Protocol, Self

from kb.elements import Parameters

VERBS: Final = ("activate", "deactivate", "set_parameters")

_AT_ONCE_S: Final = 1e-9  # tolerance for the rounding errors of clocks that add up periods


class CommandFailed(Exception):
    """A command failed because a script says so."""


class Command(NamedTuple):
    """A command to a component, given at this time [s]; `parameters` is empty unless they are set by it."""

    time: float
    verb: str
    component: str
    parameters: Parameters


class Components(Protocol):
    """The components of a world: each method takes effect at once; it is called when a command is finished.

    If a method raises, it must not have had an effect; the command has then failed.
    """

    def check(self, component: str, parameters: Parameters, /) -> None:
        """Raise if there is no such component, or it cannot take these parameters; called when a command is given."""

    def activate(self, component: str, /) -> object: ...
    def deactivate(self, component: str, /) -> object: ...
    def set_parameters(self, component: str, parameters: Parameters, /) -> object: ...
    def is_active(self, component: str, /) -> bool: ...
    def parameters(self, component: str, /) -> Parameters: ...


class NamedComponents:
    """Components without behaviour: a set of those that run, and the parameters of each."""

    def __init__(self) -> None:
        self.active: set[str] = set()
        self.taken: dict[str, Parameters] = {}

    def check(self, component: str, parameters: Parameters, /) -> None:
        """Accept any command."""

    def activate(self, component: str, /) -> None:
        self.active.add(component)

    def deactivate(self, component: str, /) -> None:
        self.active.discard(component)

    def set_parameters(self, component: str, parameters: Parameters, /) -> None:
        self.taken[component] = parameters

    def is_active(self, component: str, /) -> bool:
        return component in self.active

    def parameters(self, component: str, /) -> Parameters:
        return dict(self.taken.get(component, {}))


class Script(NamedTuple):
    """How a component carries out one kind of command, see `SimulatedComponents.script`; takes None: the default."""

    takes: float | None = None
    fail_first: float = 0
    hangs: bool = False
    lies: bool = False
    crash_after: float = math.inf


class Operation:
    """A command under way, like `concurrent.futures.Future`, but finished in simulated time, at its `end` [s]."""

    def __init__(
        self, end: float, effect: Callable[[float], object], catch_up: Callable[[], object]
    ) -> None:
        self.end, self._effect, self._catch_up = end, effect, catch_up
        self._is_done = False
        self._error: Exception | None = None

    def done(self) -> bool:
        self._catch_up()
        return self._is_done

    def exception(self) -> Exception | None:
        self._catch_up()
        return self._error

    def cancel(self) -> None:
        """Suppress the effect of the command, unless it has happened already."""
        self._effect = _nothing

    def finish(self) -> None:
        try:
            self._effect(self.end)
        except Exception as error:
            self._error = error
        self._is_done = True


class SimulatedComponents:
    """A managed system in simulated time: every component obeys unless a script says otherwise.

    Commands to one component are carried out one after the other. See `kb.ManagedSystem` for what they are.

    Args:
        clock: gives the time [s].
        takes: how long a command takes [s], by its verb; verbs that are not named take no time.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        components: Components,
        takes: Mapping[str, float] | None = None,
    ) -> None:
        self._clock, self._components = clock, components
        self.takes = checked_times(takes or {})
        self._busy_until: dict[str, float] = {}
        self._under_way: list[tuple[float, int, Operation]] = []
        self._entered = count()
        self._scripts: dict[tuple[str, str], Script] = {}
        self._given: Counter[tuple[str, str]] = Counter()
        self.commands: list[Command] = []
        self._crash: dict[str, Operation] = {}

    @property
    def scripted(self) -> tuple[str, ...]:
        """The names of the components with scripts."""
        return tuple(dict.fromkeys(component for _, component in self._scripts))

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
        """Script how a component behaves from now on; this replaces earlier scripts for the same commands.

        Args:
            component: its name.
            verbs: the commands that are scripted: "activate", "deactivate", "set_parameters"; none: all.
            takes: how long a command takes [s].
            fail_first: how many commands of each kind fail; `math.inf` for all.
            hangs: commands never end.
            lies: commands are reported as done, but have no effect.
            crash_after: how long after each start the component stops by itself [s].

        Returns:
            The system, for the next script.

        Raises:
            ValueError: no such command, or a number below 0.
        """
        for name, number in (
            ("takes", takes or 0.0),
            ("fail_first", fail_first),
            ("crash_after", crash_after),
        ):
            _check_number(f"{name} of {component} is", number)
        for verb in verbs or VERBS:
            _check_verb(verb)
            self._given[verb, component] = 0
            self._scripts[verb, component] = Script(takes, fail_first, hangs, lies, crash_after)
        return self

    def activate(self, component: str, /) -> Operation:
        start = partial(self._start, component, self._script("activate", component).crash_after)
        return self._command("activate", component, {}, start)

    def deactivate(self, component: str, /) -> Operation:
        return self._command("deactivate", component, {}, partial(self._stop, component))

    def set_parameters(self, component: str, parameters: Parameters, /) -> Operation:
        taken, obey = dict(parameters), self._components.set_parameters
        return self._command(
            "set_parameters", component, taken, lambda time: obey(component, taken)
        )

    def is_active(self, component: str, /) -> bool:
        """Tell whether a component truly runs; one whose activation is under way does not yet."""
        self.catch_up()
        return self._components.is_active(component)

    def parameters(self, component: str, /) -> Parameters:
        self.catch_up()
        return self._components.parameters(component)

    def next_event(self) -> float:
        """When a command that is under way ends next, or a component crashes [s]; infinity for never."""
        self.catch_up()
        return self._under_way[0][0] if self._under_way else math.inf

    def catch_up(self) -> bool:
        """Carry out what is due by now, in order of time; return whether anything was."""
        if not self._under_way:  # mostly
            return False
        now, is_any = self._clock() + _AT_ONCE_S, False
        while self._under_way and self._under_way[0][0] <= now:
            heapq.heappop(self._under_way)[2].finish()
            is_any = True
        return is_any

    def _start(self, component: str, crash_after: float, time: float) -> None:
        was_active = self._components.is_active(component)
        self._components.activate(component)
        if not was_active and crash_after < math.inf:
            stop = self._components.deactivate
            self._crash[component] = self._enter(time + crash_after, lambda _: stop(component))

    def _stop(self, component: str, time: float) -> None:
        self._components.deactivate(component)
        if component in self._crash:
            self._crash.pop(component).cancel()

    def _command(
        self, verb: str, component: str, parameters: Parameters, effect: Callable[[float], object]
    ) -> Operation:
        self._components.check(component, parameters)
        now, script = self._clock(), self._script(verb, component)
        self.commands.append(Command(now, verb, component, parameters))
        self._given[verb, component] += 1
        if script.hangs:
            return Operation(math.inf, effect, self.catch_up)
        takes = script.takes if script.takes is not None else self.takes.get(verb, 0.0)
        end = self._busy_until[component] = max(now, self._busy_until.get(component, 0.0)) + takes
        if self._given[verb, component] <= script.fail_first:
            effect = partial(
                _fail,
                f"{verb} {component} fails by its script, time {self._given[verb, component]}",
            )
        elif script.lies:
            effect = _nothing
        return self._enter(end, effect)

    def _enter(self, end: float, effect: Callable[[float], object]) -> Operation:
        operation = Operation(end, effect, self.catch_up)
        heapq.heappush(self._under_way, (end, next(self._entered), operation))
        return operation

    def _script(self, verb: str, component: str) -> Script:
        return self._scripts.get((verb, component), Script())


def checked_times(takes: Mapping[str, float]) -> Mapping[str, float]:
    """Return how long commands take by verb [s]; ValueError if there is no such command, or a number is below 0."""
    for verb, seconds in takes.items():
        _check_verb(verb)
        _check_number(f"{verb} takes", seconds)
    return takes


def _check_verb(verb: str) -> None:
    if verb not in VERBS:
        raise ValueError(f"{verb!r} is no command; commands are {', '.join(VERBS)}")


def _check_number(what: str, number: object) -> None:
    if not (isinstance(number, int | float) and number >= 0):
        raise ValueError(f"{what} {number!r}; allowed is a number from 0")


def _nothing(time: float) -> None:
    """Have no effect."""


def _fail(text: str, time: float) -> None:
    raise CommandFailed(text)
