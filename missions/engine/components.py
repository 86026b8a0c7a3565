"""Components that switch in simulated time; scripts can make their commands go wrong."""

import heapq
from collections import Counter
from collections.abc import Callable, Mapping
from functools import partial
from itertools import count
from math import inf
from typing import Any, Final, NamedTuple, Self

from kb.elements import Parameters

VERBS: Final = ("activate", "deactivate", "set_parameters")

_AT_ONCE_S: Final = 1e-9  # tolerance for the rounding errors of clocks that add up periods


class CommandFailed(Exception):
    """A command failed because a script says so."""


class Command(NamedTuple):
    """A command to a component at a time [s]; `parameters` is empty unless it sets them."""

    time: float
    verb: str
    component: str
    parameters: Parameters


class NamedComponents:
    """Components without behaviour: a set of those that run, and the parameters of each.

    Each method takes effect at once, when a command is finished. If it raises, it must not have had
    an effect; the command has then failed.
    """

    def __init__(self) -> None:
        self.active: set[str] = set()
        self.taken: dict[str, Parameters] = {}

    def check(self, component: str, parameters: Parameters, /) -> None:
        """Raise, when a command is given, if there is no such component or parameter."""

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
    """How a component carries out a kind of command: see `SimulatedComponents.script`."""

    takes: float | None = None
    fail_first: float = 0
    hangs: bool = False
    lies: bool = False


class Operation:
    """A command under way, like `concurrent.futures.Future`, finished in simulated time."""

    def __init__(self, effect: Callable[[], object], catch_up: Callable[[], object]) -> None:
        self._effect = effect
        self._catch_up = catch_up
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
            self._effect()
        except Exception as error:
            self._error = error
        self._is_done = True


class SimulatedComponents:
    """A managed system in simulated time: every component obeys unless a script says otherwise.

    Commands to one component are carried out one after the other; see `kb.ManagedSystem`.

    Args:
        clock: returns the time [s].
        takes: how long a command takes [s], by its verb; by default no time.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        components: Any,  # noqa: ANN401  # `NamedComponents`, or others with these methods
        takes: Mapping[str, float] | None = None,
    ) -> None:
        self.takes = checked_times(takes or {})
        self.commands: list[Command] = []
        self._clock = clock
        self._components = components
        self._scripts: dict[tuple[str, str], Script] = {}
        self._counts: Counter[tuple[str, str]] = Counter()
        self._busy_until: dict[str, float] = {}
        self._under_way: list[tuple[float, int, Operation]] = []  # a heap
        self._numbers = count()

    def script(
        self,
        component: str,
        *verbs: str,
        takes: float | None = None,
        fail_first: float = 0,
        hangs: bool = False,
        lies: bool = False,
    ) -> Self:
        """Script how a component behaves from now on; replaces scripts for the same commands.

        Args:
            component: its name.
            verbs: the commands: "activate", "deactivate", "set_parameters"; none: all.
            takes: how long a command takes [s].
            fail_first: how many commands of each kind fail; `math.inf` for all.
            hangs: commands never end.
            lies: commands are reported as done, but have no effect.

        Returns:
            The system, for the next script.

        Raises:
            ValueError: no such command, or a number below 0.
        """
        for verb in verbs or VERBS:
            checked_times({verb: takes or 0.0})
            checked_times({verb: fail_first})
            self._counts[verb, component] = 0
            self._scripts[verb, component] = Script(takes, fail_first, hangs, lies)
        return self

    @property
    def scripted(self) -> tuple[str, ...]:
        """The names of the components with scripts."""
        return tuple(dict.fromkeys(component for _, component in self._scripts))

    def activate(self, component: str, /) -> Operation:
        return self._command("activate", component)

    def deactivate(self, component: str, /) -> Operation:
        return self._command("deactivate", component)

    def set_parameters(self, component: str, parameters: Parameters, /) -> Operation:
        return self._command("set_parameters", component, dict(parameters))

    def is_active(self, component: str, /) -> bool:
        """Return whether a component truly runs; not while its activation is under way."""
        self.catch_up()
        return bool(self._components.is_active(component))

    def parameters(self, component: str, /) -> Parameters:
        self.catch_up()
        parameters: Parameters = self._components.parameters(component)
        return parameters

    def next_event(self) -> float:
        """When a command that is under way ends next [s]; infinity if there is none."""
        self.catch_up()
        return self._under_way[0][0] if self._under_way else inf

    def catch_up(self) -> bool:
        """Carry out what is due by now, in order of time; return whether anything was."""
        is_any = False
        while self._under_way and self._under_way[0][0] <= self._clock() + _AT_ONCE_S:
            heapq.heappop(self._under_way)[2].finish()
            is_any = True
        return is_any

    def _command(self, verb: str, component: str, *parameters: Parameters) -> Operation:
        taken: Parameters = dict(*parameters)
        self._components.check(component, taken)
        effect: Callable[[], object] = partial(
            getattr(self._components, verb), component, *parameters
        )
        now = self._clock()
        script = self._script(verb, component)
        self.commands.append(Command(now, verb, component, taken))
        self._counts[verb, component] += 1
        number = self._counts[verb, component]
        if script.hangs:
            return Operation(effect, self.catch_up)
        if number <= script.fail_first:
            effect = partial(_fail, f"{verb} {component} fails by its script, time {number}")
        elif script.lies:
            effect = _nothing
        takes = self.takes.get(verb, 0.0) if script.takes is None else script.takes
        end = max(now, self._busy_until.get(component, 0.0)) + takes
        self._busy_until[component] = end
        operation = Operation(effect, self.catch_up)
        heapq.heappush(self._under_way, (end, next(self._numbers), operation))
        return operation

    def _script(self, verb: str, component: str) -> Script:
        return self._scripts.get((verb, component), Script())


def checked_times(takes: Mapping[str, float]) -> Mapping[str, float]:
    """Return numbers by verb; ValueError if there is no such command, or one is below 0."""
    for verb, number in takes.items():
        if verb not in VERBS:
            raise ValueError(f"{verb!r} is no command; commands are {', '.join(VERBS)}")
        if not (isinstance(number, int | float) and number >= 0):
            raise ValueError(f"{verb} takes {number!r}; allowed is a number from 0")
    return takes


def _nothing() -> None:
    """Have no effect."""


def _fail(text: str) -> None:
    raise CommandFailed(text)
