"""The components as the configuration manager commands them; a change takes simulated time."""

from collections.abc import Callable, Mapping
from difflib import get_close_matches

from missions.engine.mission import MissionError
from missions.uav.nodes import Node

__all__ = ["Components", "Operation"]


class Operation:
    """A change under way, like `concurrent.futures.Future` but finished by simulated time."""

    def __init__(self) -> None:
        self._is_done = False

    def done(self) -> bool:
        """Tell whether it has been carried out."""
        return self._is_done

    def exception(self) -> BaseException | None:
        """Return None: switching does not fail here."""
        return None

    def finish(self) -> None:
        """Note that it has been carried out."""
        self._is_done = True


class Components:
    """Switches components; the changes are carried out in the order in which they are due.

    Args:
        nodes: the components by name.
        clock: returns the time [s].
        activation_s: how long activating takes [s].
        deactivation_s: how long deactivating takes [s].
        hold: called when the last component that moves the vehicle was stopped.
    """

    def __init__(
        self,
        nodes: Mapping[str, Node],
        clock: Callable[[], float],
        activation_s: float,
        deactivation_s: float,
        hold: Callable[[], None],
    ) -> None:
        self._nodes, self._clock, self._hold = nodes, clock, hold
        self._takes_s = {True: activation_s, False: deactivation_s}
        self._pending: list[tuple[float, Node, bool, Operation]] = []

    def activate(self, component: str, /) -> Operation:
        """Ask for a component to become active."""
        return self._switch(component, True)

    def deactivate(self, component: str, /) -> Operation:
        """Ask for a component to become inactive."""
        return self._switch(component, False)

    def set_parameters(self, component: str, parameters: Mapping[str, object], /) -> None:
        """Take parameters.

        Raises:
            MissionError: always, for no component has any.
        """
        raise MissionError(f"{self._node(component).name} has no parameters; {', '.join(parameters)} cannot be set")

    def is_active(self, component: str) -> bool:
        """Return whether a component is active; one whose activation is under way is not yet."""
        return self._node(component).is_active

    def catch_up(self) -> bool:
        """Carry out what is due; return whether anything was."""
        due = [one for one in self._pending if one[0] <= self._clock() + 1e-9]
        self._pending = [one for one in self._pending if one not in due]
        for _, node, is_active, operation in sorted(due, key=lambda one: one[0]):
            self._carry_out(node, is_active)
            operation.finish()
        return bool(due)

    def _carry_out(self, node: Node, is_active: bool) -> None:
        if node.is_active == is_active:
            return
        node.is_active = is_active
        if is_active:
            node.begin()
            return
        node.end()
        if node.moves and not any(other.moves and other.is_active for other in self._nodes.values()):
            self._hold()

    def _switch(self, component: str, is_active: bool) -> Operation:
        operation = Operation()
        self._pending.append((self._clock() + self._takes_s[is_active], self._node(component), is_active, operation))
        return operation

    def _node(self, component: str) -> Node:
        if component not in self._nodes:
            near = get_close_matches(component, self._nodes, n=3) or list(self._nodes)
            raise MissionError(f"there is no component {component!r}; the nearest are {', '.join(near)}")
        return self._nodes[component]
