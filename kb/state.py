"""The facts of one moment and what is inferred from them, as arrays over a network; and layers of "what if" on top.

A layer answers from its own changes first and from the state below otherwise, so that it costs what it changes and
copies nothing.
"""

from collections.abc import Iterable
from operator import attrgetter
from typing import Generic, TypeVar

from kb.network import Network, Node
from kb.status import Status

__all__ = ["Marked", "Overlay", "State"]

T = TypeVar("T")

_INDEX = attrgetter("index")


class _Layer(dict[int, T], Generic[T]):
    """An array seen through a few replaced entries."""

    __slots__ = ("below",)

    def __init__(self, below: "list[T] | _Layer[T]") -> None:
        self.below = below

    def __missing__(self, index: int) -> T:
        return self.below[index]


class Marked:
    """A set of nodes; one on top of another answers from its own changes first."""

    __slots__ = ("_below", "_own")

    def __init__(self, below: "Marked | None" = None) -> None:
        self._below = below
        self._own: dict[Node, bool] = {}

    def mark(self, node: Node, yes: bool) -> None:
        """Have a node in the set, or not."""
        if yes or self._below is not None:
            self._own[node] = yes
        else:
            self._own.pop(node, None)

    def nodes(self) -> list[Node]:
        """Return the nodes in order of declaration."""
        return sorted(self._members(), key=_INDEX)

    def _members(self) -> Iterable[Node]:
        if self._below is None:
            return self._own
        members = dict.fromkeys(self._below._members(), True) | self._own
        return [node for node, yes in members.items() if yes]


class State:
    """Base facts, and what is inferred from them; every array is indexed by `Node.index`.

    Attributes:
        value: latest measurement of an attribute, or None.
        time: when that was measured [s].
        stale: the latest measurement of an attribute is older than it may be.
        failed: a component is reported failed.
        active: a component is running.
        selected: a design or configuration is chosen.
        requested: an action has an open required-action.
        asserted: a status that stands in place of the inferred one, or None.
        asserted_required: required by assertion, whatever is inferred.
        users: inferred: what requires it: of a function its required actions, of a component its selected designs.
        required: inferred: an open required action, a function of one, a component of a selected design.
        served: inferred: how many designs, selected or not, of required functions a component is in.
        status: inferred, exactly one for each element.
        adaptable: inferred: the functions and components to choose for, or to choose better for.
        obsolete: inferred: the active components and selected designs and configurations of no required function.
        lacking: inferred: the required components that are not active.
        visited: how many nodes were consulted so far to infer all this.
    """

    def __init__(self, network: Network) -> None:
        self.network = network
        self.value: list[float | None] | _Layer[float | None] = []
        self.time: list[float | None] | _Layer[float | None] = []
        self.stale: list[bool] | _Layer[bool] = []
        self.failed: list[bool] | _Layer[bool] = []
        self.active: list[bool] | _Layer[bool] = []
        self.selected: list[bool] | _Layer[bool] = []
        self.requested: list[bool] | _Layer[bool] = []
        self.asserted: list[Status | None] | _Layer[Status | None] = []
        self.asserted_required: list[bool] | _Layer[bool] = []
        self.users: list[tuple[Node, ...]] | _Layer[tuple[Node, ...]] = []
        self.required: list[bool] | _Layer[bool] = []
        self.served: list[int] | _Layer[int] = []
        self.status: list[Status] | _Layer[Status] = []
        self.adaptable = Marked()
        self.obsolete = Marked()
        self.lacking = Marked()
        self.visited = 0
        self.grow()

    def grow(self) -> None:
        """Make room for the nodes that the network got, with no fact about any of them."""
        new = self.network.nodes[len(self.status) :]
        size = len(new)
        for unset in (self.value, self.time, self.asserted):
            unset += [None] * size  # type: ignore[operator]  # a base state, so these are lists
        for false in (
            self.stale,
            self.failed,
            self.active,
            self.selected,
            self.requested,
            self.asserted_required,
            self.required,
        ):
            false += [False] * size  # type: ignore[operator]  # as above
        self.users += [()] * size  # type: ignore[operator]  # as above
        self.served += [0] * size  # type: ignore[operator]  # as above
        statuses = {"constraint": Status.NOT_EVALUATED}
        self.status += [statuses.get(node.kind, Status.FEASIBLE) for node in new]  # type: ignore[operator]  # as above


class Overlay(State):
    """A state on top of another: changes made here leave the one below as it is."""

    def __init__(self, below: State) -> None:
        self.network = below.network
        self.value = _Layer(below.value)
        self.time = _Layer(below.time)
        self.stale = _Layer(below.stale)
        self.failed = _Layer(below.failed)
        self.active = _Layer(below.active)
        self.selected = _Layer(below.selected)
        self.requested = _Layer(below.requested)
        self.asserted = _Layer(below.asserted)
        self.asserted_required = _Layer(below.asserted_required)
        self.users = _Layer(below.users)
        self.required = _Layer(below.required)
        self.served = _Layer(below.served)
        self.status = _Layer(below.status)
        self.adaptable = Marked(below.adaptable)
        self.obsolete = Marked(below.obsolete)
        self.lacking = Marked(below.lacking)
        self.visited = 0
