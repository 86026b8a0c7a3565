"""The managed system: what the manager commands, an adapter for objects of this process, and a look at what runs."""

from collections.abc import Mapping
from typing import Protocol

from kb.elements import Component, ComponentKind, Parameters
from kb.exceptions import UnknownName
from kb.knowledge_base import KnowledgeBase


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
    """A managed system made of objects in this process, given by component name."""

    def __init__(self, objects: Mapping[str, ManagedObject]) -> None:
        self._objects = dict(objects)

    def activate(self, component: str) -> Operation | None:
        """Activate the object of that name; see `ManagedObject`."""
        return self._object(component).activate()

    def deactivate(self, component: str) -> Operation | None:
        """Deactivate the object of that name."""
        return self._object(component).deactivate()

    def set_parameters(self, component: str, parameters: Parameters) -> Operation | None:
        """Give the object of that name its parameters."""
        return self._object(component).set_parameters(parameters)

    def is_active(self, component: str) -> bool | None:
        """Whether the object of that name runs; None if it cannot tell."""
        tell = getattr(self._object(component), "is_active", None)
        answer = tell() if callable(tell) else tell
        return answer if isinstance(answer, bool) else None

    def _object(self, component: str) -> ManagedObject:
        if component not in self._objects:
            raise UnknownName("managed object", component, self._objects)
        return self._objects[component]


def is_active(managed: ManagedSystem, component: str) -> bool | None:
    """Return what a managed system says of a component, None if it cannot tell."""
    answer = getattr(managed, "is_active", lambda _: None)(component)
    return answer if isinstance(answer, bool) else None


class ActivityMonitor:
    """A monitor that asks after each component that is believed to be active, while no plan is being carried out.

    One that was started by the last command to it, and is not running, has failed. Any other belief that is wrong is
    only put right: a component may have been stopped while the program was not there to see it.
    """

    def __init__(self, managed: ManagedSystem) -> None:
        self._managed = managed
        self._known: KnowledgeBase | None = None
        self._unmanaged: set[str] = set()
        self._believed: list[str] = []
        self._believed_at = -1

    def observe(self, kb: KnowledgeBase) -> None:
        if kb.pending_plan is not None:
            return
        if kb is not self._known or kb.revision != self._believed_at:
            self._believed, self._believed_at = _believed_active(kb), kb.revision
        for name in [name for name in self._believed if self._has_ended(name)]:
            reason = f"{name} is not running, though nobody has stopped it"
            was_started = kb is self._known and _was_started(kb, name)
            kb.component_active(name, False, reason)
            if was_started:
                kb.component_failed(name, reason)
        self._known = kb

    def _has_ended(self, name: str) -> bool:
        try:
            return name not in self._unmanaged and is_active(self._managed, name) is False
        except UnknownName:  # it is not this system that manages it
            self._unmanaged.add(name)
        except Exception:
            return False  # nobody can tell at this moment
        return False


def _believed_active(kb: KnowledgeBase) -> list[str]:
    """Return the names of the components that are commanded and believed to be active."""
    with kb.reading() as state:
        active = [node.element for node in state.network.components.values() if state.active[node.index]]
    return [one.name for one in active if isinstance(one, Component) and one.kind is not ComponentKind.PLAIN]


def _was_started(kb: KnowledgeBase, name: str) -> bool:
    """Tell whether the last command that switched a component has started it."""
    for one in reversed(kb.history.attempts):
        if one.component == name and one.operation != "configure":
            return (one.operation, one.result) == ("activate", "completed")
    return False
