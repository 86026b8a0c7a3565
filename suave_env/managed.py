"""The managed system: its components can be activated, deactivated and given parameters, which takes simulated time."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from suave_env.agenda import Agenda
from suave_env.components import Component
from suave_env.exceptions import SuaveEnvError, unknown_name
from suave_env.settings import Settings

__all__ = ["Change", "HIGHEST_ALTITUDE_M", "ManagedSystem", "Operation"]

HIGHEST_ALTITUDE_M = 19.0
"""Altitude above the seabed [m] that a parameter may command at most: 1 m below the surface."""


@dataclass(frozen=True)
class Change:
    """A component that was activated, deactivated or given other parameters.

    Attributes:
        time: When that was carried out [s].
        component: Its name.
        active: Whether it is active from then on.
        parameters: Its parameters from then on.
    """

    time: float
    component: str
    active: bool
    parameters: Mapping[str, float]

    def __str__(self) -> str:
        values = "".join(f", {name} = {value:g}" for name, value in self.parameters.items())
        return f"{self.component} is {'active' if self.active else 'inactive'}{values}"


class Operation:
    """A change under way, like `concurrent.futures.Future` but finished by simulated time."""

    def __init__(self) -> None:
        self._done = False
        self._exception: BaseException | None = None

    def done(self) -> bool:
        """Return whether the change has been carried out or has failed."""
        return self._done

    def exception(self) -> BaseException | None:
        """Return why the change failed; None if it was carried out or is still under way."""
        return self._exception

    def _finish(self, exception: BaseException | None = None) -> None:
        self._done = True
        self._exception = exception


class ManagedSystem:
    """The components by name. Changes of one component are carried out in the order in which they were asked for.

    Args:
        settings: How long changes take.
        components: What is managed.
        agenda: Where the end of each change is entered.
        clock: Returns the time [s].
        hold: Called with the time [s] when the last component that moves the vehicle was deactivated.
        switched: Called with the time [s] after each change that changed something.
    """

    def __init__(
        self,
        settings: Settings,
        components: Iterable[Component],
        agenda: Agenda,
        clock: Callable[[], float],
        hold: Callable[[float], None],
        switched: Callable[[float], None],
    ) -> None:
        self._settings = settings
        self._components = {component.name: component for component in components}
        self._agenda = agenda
        self._clock = clock
        self._hold = hold
        self._switched = switched
        self._busy_until = dict.fromkeys(self._components, 0.0)
        self._pending: list[Operation] = []
        self._closed = False
        self._changes = 0
        self._history: list[Change] = []

    @property
    def changes(self) -> int:
        """How many changes have been carried out so far, those that changed nothing among them."""
        return self._changes

    @property
    def history(self) -> tuple[Change, ...]:
        """Every change so far that changed something, in order of time."""
        return tuple(self._history)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the components."""
        return tuple(self._components)

    @property
    def active(self) -> tuple[str, ...]:
        """The names of the components that are active."""
        return tuple(name for name, component in self._components.items() if component.active)

    def is_active(self, name: str) -> bool:
        """Return whether a component is active; one whose activation is under way is not yet."""
        return self._component(name).active

    def parameters(self, name: str) -> dict[str, float]:
        """Return a copy of the parameters in force of a component."""
        return dict(self._component(name).parameters)

    def activate(self, name: str) -> Operation:
        """Ask for a component to become active; one that is active already stays as it is.

        Raises:
            SuaveEnvError: If there is no such component or the environment is closed.
        """
        component = self._component(name)
        return self._carry_out(name, self._settings.activation_s, lambda time: _activate(component, time))

    def deactivate(self, name: str) -> Operation:
        """Ask for a component to become inactive; one that is inactive already stays as it is.

        Raises:
            SuaveEnvError: If there is no such component or the environment is closed.
        """
        component = self._component(name)
        return self._carry_out(name, self._settings.deactivation_s, lambda time: self._deactivate(component, time))

    def set_parameters(self, name: str, values: Mapping[str, object]) -> Operation:
        """Ask for parameters of a component to be set, all at the same time.

        Args:
            name: The component.
            values: New values by parameter name.

        Raises:
            SuaveEnvError: If there is no such component or parameter, a value is not allowed, or the environment is
                closed.
        """
        component = self._component(name)
        checked = {key: _checked(component, key, value) for key, value in values.items()}
        return self._carry_out(name, self._settings.parameter_s, lambda time: component.parameters.update(checked))

    def close(self) -> None:
        """Fail every change under way and refuse further ones."""
        self._closed = True
        for operation in self._pending:
            operation._finish(SuaveEnvError("the environment was closed before the change was carried out"))
        self._pending.clear()

    def _component(self, name: str) -> Component:
        if name not in self._components:
            raise unknown_name("component", name, self._components)
        return self._components[name]

    def _carry_out(self, name: str, duration: float, change: Callable[[float], None]) -> Operation:
        if self._closed:
            raise SuaveEnvError(f"component {name} cannot be changed: the environment is closed")
        component, operation = self._components[name], Operation()
        self._pending.append(operation)
        self._busy_until[name] = max(self._clock(), self._busy_until[name]) + duration

        def end(time: float) -> None:
            before = component.active, dict(component.parameters)
            change(time)
            if before != (component.active, component.parameters):
                self._history.append(Change(time, name, component.active, dict(component.parameters)))
                self._switched(time)
            self._pending.remove(operation)
            operation._finish()
            self._changes += 1

        self._agenda.at(self._busy_until[name], end)
        return operation

    def _deactivate(self, component: Component, time: float) -> None:
        if not component.active:
            return
        component.active = False
        component.deactivated(time)
        if component.moves and not any(other.active and other.moves for other in self._components.values()):
            self._hold(time)


def _activate(component: Component, time: float) -> None:
    if not component.active:
        component.active = True
        component.activated(time)


def _checked(component: Component, name: str, value: object) -> float:
    if name not in component.parameters:
        raise unknown_name(f"parameter of {component.name}", name, component.parameters)
    number = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
    if not 0 < number <= HIGHEST_ALTITUDE_M:
        raise SuaveEnvError(
            f"parameter {name} of {component.name} cannot be {value!r}; allowed is a number above 0 and up to "
            f"{HIGHEST_ALTITUDE_M:g} [m]"
        )
    return number
