"""The facts of one moment and what is inferred from them, as arrays over a network; and layers of "what if" on top.

A layer answers from its own changes first and from the state below otherwise, so that it costs what it changes and
copies nothing.
"""

from collections.abc import Iterator
from operator import attrgetter
from typing import Any, Final, Generic, NamedTuple, Protocol, TypeVar

from kb.inference.network import Network, Node
from kb.status import Status

__all__ = ["Array", "Marked", "Overlay", "Reason", "State", "Users"]

T = TypeVar("T")

_INDEX = attrgetter("index")


class Array(Protocol[T]):
    """One value for each node, by `Node.index`."""

    def __getitem__(self, index: int, /) -> T:
        """Return the value of a node."""

    def __setitem__(self, index: int, value: T, /) -> None:
        """Set the value of a node."""


class Reason(NamedTuple):
    """What whoever told a fact said of it.

    Attributes:
        text: why it is so, in words; may be empty.
        until: when it lapses [s]; None for never.
    """

    text: str = ""
    until: float | None = None

    def __str__(self) -> str:
        """Write it as it follows a statement: until when, and why in brackets."""
        lapse = "" if self.until is None else f" until {f'{self.until:.3f}'.rstrip('0').rstrip('.')} s"
        return f"{lapse} ({self.text})" if self.text else lapse


_UNSAID: Final = Reason()


class _Layer(dict[int, T], Generic[T]):
    """An array seen through a few replaced entries."""

    __slots__ = ("below",)

    def __init__(self, below: "Array[T]") -> None:
        self.below = below

    def __missing__(self, index: int) -> T:
        return self.below[index]


class Marked:
    """A set of nodes; one on top of another answers from its own changes first."""

    __slots__ = ("_below", "_count", "_most", "_own")

    def __init__(self, below: "Marked | None" = None) -> None:
        self._below = below
        self._own: dict[Node, bool] = {}
        self._count = 0 if below is None else len(below)
        self._most = 0

    def mark(self, node: Node, yes: bool) -> None:
        """Have a node in the set, or not."""
        if yes == (node in self):
            return
        self._count += 1 if yes else -1
        if self._below is not None:
            self._own[node] = yes
        elif yes:
            self._own[node] = True
            self._most = max(self._most, self._count)
        else:
            del self._own[node]
            if self._count < self._most // 8:  # a dict keeps the room that it once took, and is walked through in full
                self._own = dict(self._own.items())
                self._most = self._count

    def nodes(self) -> list[Node]:
        """Return the nodes in order of declaration."""
        return sorted(self, key=_INDEX)

    def __contains__(self, node: Node) -> bool:
        yes = self._own.get(node)
        return yes if yes is not None else self._below is not None and node in self._below

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[Node]:
        yield from self._own if self._below is None else self._merged(self._below)

    def _merged(self, below: "Marked") -> Iterator[Node]:
        yield from (node for node in below if node not in self._own)
        yield from (node for node, yes in self._own.items() if yes)


_NOBODY: Final = Marked()


class Users:
    """Who uses each node: of a function its required actions, of a component its selected designs."""

    __slots__ = ("_below", "_own")

    def __init__(self, below: "Users | None" = None) -> None:
        self._below = below
        self._own: dict[int, Marked] = {}

    def __getitem__(self, index: int) -> Marked:
        found = self._own.get(index)
        if found is None:
            return _NOBODY if self._below is None else self._below[index]
        return found

    def mark(self, index: int, user: Node, uses: bool) -> None:
        """Have a node use another one, or no longer."""
        users = self._own.get(index)
        if users is None:
            users = self._own[index] = Marked(None if self._below is None else self._below[index])
        users.mark(user, uses)


class State:
    """Base facts, and what is inferred from them; every array is indexed by `Node.index`.

    Attributes:
        value: latest measurement of an attribute, or None.
        time: when that was measured [s].
        stale: the latest measurement of an attribute is older than it may be.
        verdict: what a constraint that does not flap is after all that was measured; None for any other.
        failed: a component is reported failed.
        active: a component is running.
        selected: a design or configuration is chosen.
        requested: an action has an open required-action.
        asserted: a status that stands in place of the inferred one, or None.
        asserted_required: required by assertion, whatever is inferred.
        reasons: what was said of a fact: by name of its array, and index.
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
        self._columns: list[tuple[list[Any], object]] = []
        self.value: Array[float | None] = self._column(None)
        self.time: Array[float | None] = self._column(None)
        self.stale: Array[bool] = self._column(False)
        self.verdict: Array[Status | None] = self._column(None)
        self.failed: Array[bool] = self._column(False)
        self.active: Array[bool] = self._column(False)
        self.selected: Array[bool] = self._column(False)
        self.requested: Array[bool] = self._column(False)
        self.asserted: Array[Status | None] = self._column(None)
        self.asserted_required: Array[bool] = self._column(False)
        self.reasons: dict[tuple[str, int], Reason] = {}
        self.users = Users()
        self.required: Array[bool] = self._column(False)
        self.served: Array[int] = self._column(0)
        self.status: Array[Status] = self._column(Status.FEASIBLE)
        self.adaptable = Marked()
        self.obsolete = Marked()
        self.lacking = Marked()
        self.visited = 0
        self._size = 0
        self.grow()

    def grow(self) -> None:
        """Make room for the nodes that the network got, with no fact about any of them."""
        new = self.network.nodes[self._size :]
        self._size += len(new)
        for column, unset in self._columns:
            column += [unset] * len(new)
        for node in new:
            if node.kind == "constraint":
                self.status[node.index] = Status.NOT_EVALUATED

    def reason(self, column: str, node: Node) -> Reason:
        """Return what was said of a fact; nothing, if nothing was."""
        return self.reasons.get((column, node.index), _UNSAID)

    def give_reason(self, column: str, node: Node, text: str = "", until: float | None = None) -> None:
        """Keep what was said of a fact, in place of what was said of it before."""
        if text or until is not None:
            self.reasons[column, node.index] = Reason(text, until)
        else:
            self.reasons.pop((column, node.index), None)

    def _column(self, unset: object) -> Any:  # noqa: ANN401  # a list of whatever the array is declared to hold
        column: list[Any] = []
        self._columns.append((column, unset))
        return column


class Overlay(State):
    """A state on top of another: changes made here leave the one below as it is."""

    def __init__(self, below: State) -> None:
        self.network = below.network
        self.value = _Layer(below.value)
        self.time = _Layer(below.time)
        self.stale = _Layer(below.stale)
        self.verdict = _Layer(below.verdict)
        self.failed = _Layer(below.failed)
        self.active = _Layer(below.active)
        self.selected = _Layer(below.selected)
        self.requested = _Layer(below.requested)
        self.asserted = _Layer(below.asserted)
        self.asserted_required = _Layer(below.asserted_required)
        self.reasons = below.reasons
        self.users = Users(below.users)
        self.required = _Layer(below.required)
        self.served = _Layer(below.served)
        self.status = _Layer(below.status)
        self.adaptable = Marked(below.adaptable)
        self.obsolete = Marked(below.obsolete)
        self.lacking = Marked(below.lacking)
        self.visited = 0
