"""A robot for tests: a clock that a test moves, and components that are no more than names and their parameters."""

from collections.abc import Mapping

from kb.elements import Parameters
from missions.engine.components import VERBS, SimulatedComponents, checked_times


class FakeClock:
    """A clock that stands still until it is moved; hand it to whatever takes a `clock`.

    Args:
        now: what it shows first [s].
    """

    def __init__(self, now: float = 0.0) -> None:
        self._now = now

    @property
    def now(self) -> float:
        return self._now

    def __call__(self) -> float:
        return self._now

    def advance(self, seconds: float) -> float:
        """Let time pass [s]; return the time then."""
        return self.advance_to(self._now + seconds)

    def advance_to(self, time: float) -> float:
        """Let time pass until `time` [s], and return it; ValueError if that is over, or is no time."""
        if not time >= self._now:
            raise ValueError(f"a clock that shows {self._now:g} s cannot be moved to {time:g} s; time only passes")
        self._now = time
        return time


class _Names:
    def __init__(self) -> None:
        self.active: set[str] = set()
        self.taken: dict[str, Parameters] = {}

    def check(self, component: str, parameters: Parameters) -> None:
        pass

    def activate(self, component: str) -> None:
        self.active.add(component)

    def deactivate(self, component: str) -> None:
        self.active.discard(component)

    def set_parameters(self, component: str, parameters: Parameters) -> None:
        self.taken[component] = parameters

    def is_active(self, component: str) -> bool:
        return component in self.active

    def parameters(self, component: str) -> Parameters:
        return dict(self.taken.get(component, {}))


class ScriptedManaged(SimulatedComponents):
    """A managed system without a robot; see `script` for what can go wrong in it.

    Args:
        clock: gives the time, and is moved by the test, or by the replay.
        takes: how long a command takes [s], or that by its verb; None: no time, in a replay as long as recorded.
    """

    def __init__(self, clock: FakeClock, takes: float | Mapping[str, float] | None = None) -> None:
        self._names = _Names()
        by_verb = takes if takes is None or isinstance(takes, Mapping) else dict.fromkeys(VERBS, takes)
        super().__init__(clock, self._names, by_verb)
        self.clock = clock
        self._is_timed = takes is not None

    def take(self, takes: Mapping[str, float]) -> None:
        """Say how long commands take [s] that no script is about, unless that was said before."""
        if not self._is_timed:
            self.takes, self._is_timed = checked_times(takes), True

    @property
    def active(self) -> frozenset[str]:
        """The components that truly run now."""
        self.catch_up()
        return frozenset(self._names.active)
