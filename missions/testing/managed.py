"""A managed system without a robot, for tests: its components are a set of names and their parameters."""

from collections.abc import Mapping

from kb.elements import Parameters
from missions.engine.components import VERBS, SimulatedComponents, checked_times
from missions.testing.clock import FakeClock

__all__ = ["ScriptedManaged"]


class _Names:
    """Components that are no more than their names."""

    def __init__(self) -> None:
        self.active: set[str] = set()
        self.taken: dict[str, Parameters] = {}

    def check(self, component: str, parameters: Parameters) -> None:
        """Take any."""

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
