"""The components of the vehicle as the manager commands them; changes take simulated time."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from missions.agv.settings import Settings
from missions.engine.mission import MissionError

__all__ = ["Components"]


class _Change:
    """A change under way, like `concurrent.futures.Future` but finished by simulated time."""

    def __init__(self, due: float, carry_out: Callable[[], None]) -> None:
        self.due, self._carry_out, self._is_done = due, carry_out, False
        self._trouble: MissionError | None = None

    def finish(self) -> None:
        """Carry it out."""
        try:
            self._carry_out()
        except MissionError as error:
            self._trouble = error
        self._is_done = True

    def done(self) -> bool:
        """Tell whether it has been carried out or has failed."""
        return self._is_done

    def exception(self) -> BaseException | None:
        """Return why it failed, or None."""
        return self._trouble


class Components:
    """What runs, with which parameters; see `kb.ManagedSystem`.

    Args:
        names: of the components.
        settings: how long changes take.
        clock: gives the time [s].
    """

    def __init__(self, names: Iterable[str], settings: Settings, clock: Callable[[], float]) -> None:
        self._parameters: dict[str, Mapping[str, Any]] = {name: {} for name in names}
        self._settings, self._clock = settings, clock
        self._active: set[str] = set()
        self._failed: set[str] = set()
        self._under_way: list[_Change] = []

    def activate(self, component: str) -> _Change:
        """Start a component; one that has failed, or that the vehicle does not have, does not start."""
        return self._begin(self._settings.switching_s, lambda: self._start(component))

    def deactivate(self, component: str) -> _Change:
        """Stop a component."""
        return self._begin(self._settings.switching_s, lambda: self._active.discard(component))

    def set_parameters(self, component: str, parameters: Mapping[str, Any]) -> _Change:
        """Give a component its parameters."""
        return self._begin(self._settings.parameter_s, lambda: self._set(component, parameters))

    def is_active(self, component: str) -> bool:
        """Tell whether a component runs and works."""
        return component in self._active and component not in self._failed

    def parameters(self, component: str) -> Mapping[str, Any]:
        """Return the parameters of a component."""
        return self._parameters[component]

    def fail(self, component: str, is_failed: bool) -> None:
        """Let a component fail, or recover."""
        (self._failed.add if is_failed else self._failed.discard)(component)

    def settle(self) -> bool:
        """Carry out what is due; returns whether there was something."""
        due = [one for one in self._under_way if one.due <= self._clock() + 1e-9]
        for one in due:
            self._under_way.remove(one)
            one.finish()
        return bool(due)

    def _begin(self, takes_s: float, carry_out: Callable[[], None]) -> _Change:
        change = _Change(self._clock() + takes_s, carry_out)
        self._under_way.append(change)
        return change

    def _start(self, component: str) -> None:
        if component not in self._parameters:
            raise MissionError(f"the simulated vehicle has no component {component}")
        if component in self._failed:
            raise MissionError(f"{component} has failed and does not start")
        self._active.add(component)

    def _set(self, component: str, parameters: Mapping[str, Any]) -> None:
        self._parameters[component] = parameters
