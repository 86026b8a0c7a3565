"""The facts of one moment and what is inferred from them, as arrays over a network; and layers of "what if" on top.

A layer answers from its own changes first and from the state below otherwise, so that it costs what it changes and
copies nothing. What a layer holds can be put in place in the state below, at once or again.
"""

import math
from array import array
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping
from operator import attrgetter
from typing import Any, Final, Generic, NamedTuple, Protocol, TypeVar

from kb.elements import Parameters
from kb.exceptions import InvalidValue
from kb.network import Network, Node
from kb.records import Memory
from kb.status import Status

T = TypeVar("T")

_INDEX = attrgetter("index")


class Array(Protocol[T]):
    """One value for each node, by `Node.index`."""

    def __getitem__(self, index: int, /) -> T: ...
    def __setitem__(self, index: int, value: T, /) -> None: ...


class Reason(NamedTuple):
    """What whoever told a fact said of it."""

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

    def __init__(self, below: Array[T]) -> None:
        self.below = below

    def __missing__(self, index: int) -> T:
        return self.below[index]


class Marked:
    """A set of nodes; one on top of another answers from its own changes first."""

    __slots__ = ("_below", "_most", "_own")

    def __init__(self, below: "Marked | None" = None) -> None:
        self._below = below
        self._own: dict[Node, bool] = {}
        self._most = 0

    def mark(self, node: Node, yes: bool) -> None:
        if self._below is not None:
            self._own[node] = yes
        elif yes:
            self._own[node] = True
            self._most = max(self._most, len(self._own))
        elif self._own.pop(node, False) and len(self._own) < self._most // 8:
            self._own = dict(self._own)  # a dict keeps the room that it once took, and is walked through in full
            self._most = len(self._own)

    def nodes(self) -> list[Node]:
        return sorted(self, key=_INDEX)

    def put_in_place(self) -> None:
        assert self._below is not None
        for node, yes in self._own.items():
            self._below.mark(node, yes)

    def clear(self) -> None:
        self._own.clear()

    def __contains__(self, node: Node) -> bool:
        yes = self._own.get(node)
        return yes if yes is not None else self._below is not None and node in self._below

    def __bool__(self) -> bool:
        return bool(self._own) if self._below is None else any(True for _ in self)

    def __iter__(self) -> Iterator[Node]:
        return iter(self._own) if self._below is None else self._merged(self._below)

    def _merged(self, below: "Marked") -> Iterator[Node]:
        yield from (node for node, yes in self._own.items() if yes)
        yield from (node for node in below if node not in self._own)


_NOBODY: Final = Marked()


class Users(dict[int, Marked]):
    """Who uses each node: of a function its required actions, of a component its selected designs."""

    __slots__ = ("_below",)

    def __init__(self, below: "Users | None" = None) -> None:
        self._below = below

    def __missing__(self, index: int) -> Marked:
        return _NOBODY if self._below is None else self._below[index]

    def mark(self, index: int, user: Node, uses: bool) -> None:
        self.of(index).mark(user, uses)

    def of(self, index: int) -> Marked:
        if index not in self:
            self[index] = Marked(None if self._below is None else self._below.of(index))
        return self[index]

    def put_in_place(self) -> None:
        for users in self.values():
            users.put_in_place()


class History:
    """The measurements of one attribute, by time, 16 bytes each; the newest, and at most twice as many as wanted.

    Attributes:
        pairs: of time and value, in one array, so that a measurement is there as a whole or not.
        begins: the time from which on every measurement is held [s]; `-math.inf` while none is forgotten.
        many: how long `pairs` is when something may have to be forgotten.
    """

    __slots__ = ("_memory", "begins", "many", "pairs")

    def __init__(self, memory: Memory, packed: bytes = b"", begins: float | None = None) -> None:
        self._memory, self.pairs = memory, array("d", packed)
        self.begins = -math.inf if begins is None else begins
        self.many = 4 * memory.measurements if memory.span == math.inf else 2

    def __len__(self) -> int:
        return len(self.pairs) // 2

    def add(self, time: float, value: float) -> None:
        pairs = self.pairs
        if not pairs or time >= pairs[-2]:
            pairs.extend((time, value))
        else:
            place = 2 * self._place(time)
            pairs[place:place] = array("d", (time, value))

    def forget(self) -> None:
        """Forget what is too much or too old, if that is much; before it is counted what is there."""
        pairs, memory = self.pairs, self._memory
        most = 2 * memory.measurements
        if pairs and (len(pairs) >= 2 * most or pairs[0] < pairs[-2] - 2 * memory.span):
            excess = min(max(len(pairs) - most, 2 * self._place(pairs[-2] - memory.span)), len(pairs) - 2)
            self.begins = max(self.begins, pairs[excess])
            del pairs[:excess]

    def at(self, time: float) -> float | None:
        """Return the value that was the latest at a time [s], or None before the first."""
        place = self._place(time)
        if not place and time < self.begins:
            raise InvalidValue(f"what was measured by {time!r} s is forgotten; memory begins at {self.begins!r} s")
        return self.pairs[2 * place - 1] if place else None

    def samples(self, most: int | None = None) -> tuple[tuple[float, float], ...]:
        """Return all of it, or the newest only, as (time [s], value)."""
        pairs = self.pairs if most is None else self.pairs[-2 * most :]
        return tuple(zip(pairs[::2], pairs[1::2], strict=True))

    def packed(self, most: int) -> bytes:
        return self.pairs[-2 * most :].tobytes()

    def begins_within(self, most: int) -> float | None:
        """Return what `begins` is if only the newest are taken, None for never."""
        begins = self.begins if len(self) <= most else self.pairs[-2 * most]
        return None if begins == -math.inf else begins

    def _place(self, time: float) -> int:
        return bisect_right(range(len(self)), time, key=lambda place: self.pairs[2 * place])


FACTS: Final[Mapping[str, object]] = {
    "value": None,
    "time": None,
    "stale": False,
    "verdict": None,
    "failed": False,
    "active": False,
    "selected": False,
    "requested": False,
    "asserted": None,
    "asserted_required": False,
}
"""The arrays of base facts, and what is in them where nothing is known."""

_INFERRED: Final[Mapping[str, object]] = {"required": False, "served": 0, "status": Status.FEASIBLE}


def unset(node: Node) -> Status:
    """Return the status of an element where nothing is known."""
    return Status.NOT_EVALUATED if node.kind == "constraint" else Status.FEASIBLE


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
        parameters: which a component was last given, by its name.
        histories: every measurement of an attribute, by its index.
        users: inferred: what requires it: of a function its required actions, of a component its selected designs.
        required: inferred: an open required action, a function of one, a component of a selected design.
        served: inferred: how many designs, selected or not, of required functions a component is in.
        status: inferred, exactly one for each element.
        adaptable: inferred: the functions and components to choose for, or to choose better for.
        obsolete: inferred: the active components and selected designs and configurations of no required function.
        lacking: inferred: the required components that are not active.
        visited: how many nodes were consulted so far to infer all this.
        version: number of the event that last changed anything here but a measurement and its time.
    """

    value: Array[float | None]
    time: Array[float | None]
    stale: Array[bool]
    verdict: Array[Status | None]
    failed: Array[bool]
    active: Array[bool]
    selected: Array[bool]
    requested: Array[bool]
    asserted: Array[Status | None]
    asserted_required: Array[bool]
    required: Array[bool]
    served: Array[int]
    status: Array[Status]

    def __init__(self, network: Network) -> None:
        self.network = network
        self.columns: dict[str, list[Any]] = {name: [] for name in (*FACTS, *_INFERRED)}
        for name, column in self.columns.items():
            setattr(self, name, column)
        self.reasons: dict[tuple[str, int], Reason] = {}
        self.parameters: dict[str, Parameters] = {}
        self.histories: dict[int, History] = {}
        self.users, self.adaptable, self.obsolete, self.lacking = Users(), Marked(), Marked(), Marked()
        self.visited = self.version = 0
        self.grow()

    @property
    def marks(self) -> "tuple[Users | Marked, ...]":
        """The sets of nodes that are inferred."""
        return self.users, self.adaptable, self.obsolete, self.lacking

    def grow(self) -> None:
        count = len(self.network.nodes)
        for name, unset in {**FACTS, **_INFERRED}.items():
            column = self.columns[name]
            column += [unset] * (count - len(column))

    def forget(self, node: Node) -> None:
        """Know nothing of a node any more."""
        for name, unset in FACTS.items():
            self.columns[name][node.index] = unset
        self.histories.pop(node.index, None)
        for key in [key for key in self.reasons if key[1] == node.index]:
            del self.reasons[key]

    def forget_inferred(self) -> None:
        for node in self.network.present():
            index = node.index
            self.required[index], self.served[index], self.status[index] = False, 0, unset(node)
        for marked in self.marks:
            marked.clear()

    def reason(self, column: str, node: Node) -> Reason:
        return self.reasons.get((column, node.index), _UNSAID)

    def give_reason(self, column: str, node: Node, text: str = "", until: float | None = None) -> None:
        self.reasons[column, node.index] = Reason(text, until)


class Overlay(State):
    """A state on top of another: changes made here leave the one below as it is."""

    def __init__(self, below: State, *, lasting: bool = False) -> None:
        self.network = below.network
        self._below = below
        self._layers: dict[str, _Layer[Any]] = {}
        for name in (*FACTS, *_INFERRED):
            column = getattr(below, name)
            cls: type[_Layer[Any]] = _Layer
            if lasting:  # one that finds what is below without a call; it takes longer to make
                cls = type("_QuickLayer", (_Layer,), {"__slots__": (), "__missing__": column.__getitem__})
            self._layers[name] = layer = cls(column)
            setattr(self, name, layer)
        self.reasons = {}
        self.parameters = below.parameters
        self.histories = below.histories
        self.users, self.adaptable = Users(below.users), Marked(below.adaptable)
        self.obsolete, self.lacking = Marked(below.obsolete), Marked(below.lacking)
        self.visited = 0
        self.version = below.version

    def reason(self, column: str, node: Node) -> Reason:
        found = self.reasons.get((column, node.index))
        return self._below.reason(column, node) if found is None else found

    def is_on(self, below: State) -> bool:
        return self._below is below

    def changed(self) -> Iterable[int]:
        """Return the indices of the nodes whose statuses were inferred anew here, and are not what they were."""
        return self._layers["status"]

    def put_in_place(self) -> None:
        """Make the state below what this one is. It may be done again, as it has to be where it was interrupted."""
        below = self._below
        for layer in self._layers.values():
            if layer:
                column = layer.below
                for index, value in layer.items():
                    column[index] = value
        below.reasons.update(self.reasons)
        for marked in self.marks:
            marked.put_in_place()

    def clear(self) -> None:
        for layer in self._layers.values():
            if layer:
                layer.clear()
        self.reasons.clear()
        for marked in self.marks:
            marked.clear()
        self.visited = 0
