"""The managed system: what the manager commands, as a protocol, and an adapter for objects in this process."""

from collections.abc import Mapping
from typing import Protocol

from kb.elements import Parameters
from kb.exceptions import UnknownName

__all__ = ["ManagedObject", "ManagedObjects", "ManagedSystem", "Operation", "is_active"]


class Operation(Protocol):
    """Something under way; a `concurrent.futures.Future` is one."""

    def done(self) -> bool:
        """Tell, at once, whether it has ended."""

    def exception(self) -> BaseException | None:
        """Return what went wrong, or None; asked only after it has ended."""


class ManagedSystem(Protocol):
    """What can be told to switch components and set their parameters.

    Each call returns at once: None if it is done already, an operation if it takes time. What cannot be done raises,
    now or as the operation's exception.

    A system that can tell whether a component is running has a method `is_active(component)` too, which returns at once
    True, False, or None where it cannot tell; what is said to be done is then believed only when that agrees, and what
    has stopped by itself is noticed. An operation may have a method `cancel()`, which is called when nobody waits for
    it any longer.
    """

    def activate(self, component: str, /) -> Operation | None:
        """Make a component run; its parameters were set before."""

    def deactivate(self, component: str, /) -> Operation | None:
        """Make a component stop."""

    def set_parameters(self, component: str, parameters: Parameters, /) -> Operation | None:
        """Give a component its parameters; a stopped one keeps them for when it is activated."""


class ManagedObject(Protocol):
    """A component that lives in this process; it may have a method `is_active()` too, see `ManagedSystem`."""

    def activate(self) -> Operation | None:
        """Start working."""

    def deactivate(self) -> Operation | None:
        """Stop working."""

    def set_parameters(self, parameters: Parameters) -> Operation | None:
        """Take parameters."""


class ManagedObjects:
    """A managed system made of objects in this process.

    Args:
        objects: the objects by component name.
    """

    def __init__(self, objects: Mapping[str, ManagedObject]) -> None:
        self._objects = dict(objects)

    def activate(self, component: str) -> Operation | None:
        """Activate the object of that name."""
        return self._object(component).activate()

    def deactivate(self, component: str) -> Operation | None:
        """Deactivate the object of that name."""
        return self._object(component).deactivate()

    def set_parameters(self, component: str, parameters: Parameters) -> Operation | None:
        """Give the object of that name its parameters."""
        return self._object(component).set_parameters(parameters)

    def is_active(self, component: str) -> bool | None:
        """Ask the object of that name whether it works; None if it cannot tell."""
        tell = getattr(self._object(component), "is_active", None)
        answer = tell() if callable(tell) else tell
        return answer if isinstance(answer, bool) else None

    def _object(self, component: str) -> ManagedObject:
        if component not in self._objects:
            raise UnknownName("managed object", component, self._objects)
        return self._objects[component]


def is_active(managed: ManagedSystem, component: str) -> bool | None:
    """Return what a managed system says of a component, None if it cannot tell: `is_active` is an optional part."""
    tell = getattr(managed, "is_active", None)
    answer = tell(component) if callable(tell) else None
    return answer if isinstance(answer, bool) else None
