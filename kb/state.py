"""The facts of one moment and what is inferred from them, as arrays over a network; and layers for "what if" on top.

A layer holds only its own changes and reads all else from the state below, so nothing is copied. While an event changes
the state itself, the old values are kept, so that they can be restored until the event is in.

After a fact changes, only the elements that depend on it are inferred again. Inference has two directions. "Required"
goes down: from an action to its functions, from a selected design to its components. Status goes up, level by level:
constraint, configuration, component, design, function, action. While a function or component stays possible, or
impossible, only its users (required actions, selected designs) are inferred.
"""

import math
from array import array
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping
from operator import attrgetter
from typing import Any, Final, Generic, NamedTuple, Protocol, TypeVar

from kb.elements import Constraint, Parameters, StalePolicy
from kb.events import StatusChange
from kb.exceptions import InvalidValue
from kb.network import LEVELS, Network, Node
from kb.records import Memory
from kb.status import (
    ERROR,
    IMPOSSIBLE,
    SOLVED,
    UNSOLVED,
    Status,
    action_status,
    component_status,
    configuration_status,
    constraint_status,
    design_status,
    function_status,
)

T = TypeVar("T")

_INDEX = attrgetter("index")


class Array(Protocol[T]):
    """One value for each node, by `Node.index`."""

    def __getitem__(self, index: int, /) -> T: ...
    def __setitem__(self, index: int, value: T, /) -> None: ...


class Reason(NamedTuple):
    """The reason that was given with a fact, and the time until which the fact holds [s]."""

    text: str = ""
    until: float | None = None

    def __str__(self) -> str:
        """Return the words that follow a statement: the time it ends, and the reason in brackets."""
        lapse = (
            "" if self.until is None else f" until {f'{self.until:.3f}'.rstrip('0').rstrip('.')} s"
        )
        return f"{lapse} ({self.text})" if self.text else lapse


_UNSAID: Final = Reason()


class _Layer(dict[Any, T], Generic[T]):
    """An array on top of another one, with a few entries replaced."""

    __slots__ = ("_below",)

    def __init__(self, below: Any) -> None:  # noqa: ANN401  # what can be indexed
        self._below = below

    def __missing__(self, index: Any) -> T:  # noqa: ANN401  # as what is below has
        found: T = self._below[index]
        return found


class Marked:
    """A set of nodes; `marked[node] = True` adds a node and `False` removes it."""

    __slots__ = ("own",)

    def __init__(self) -> None:
        self.own: dict[Node, bool] = {}

    def __setitem__(self, node: Node, yes: bool) -> None:
        own = self.own
        if yes:
            own[node] = True
        elif own.pop(node, False) and own.__sizeof__() > 1000 * len(own) + 1000:
            self.own = dict(own)  # a dict never shrinks, and iteration visits its empty places too

    def __bool__(self) -> bool:
        return bool(self.own)

    def __iter__(self) -> Iterator[Node]:
        return iter(self.own)

    def nodes(self) -> list[Node]:
        return sorted(self, key=_INDEX)

    def clear(self) -> None:
        self.own.clear()


class _Supposed(Marked):
    """A set on top of another one: its own entries replace those below."""

    __slots__ = ("_below",)

    def __init__(self, below: Marked) -> None:
        self.own, self._below = {}, below

    def __bool__(self) -> bool:
        own = self.own
        return any(own.values()) or (
            any(node not in own for node in self._below) if own else bool(self._below)
        )

    def __iter__(self) -> Iterator[Node]:
        own = self.own
        below = [node for node in self._below if node not in own] if own else self._below
        return iter([*(node for node, yes in own.items() if yes), *below])


_NOBODY: Final = Marked()


class Users(dict[int, Marked]):
    """The users of each node: for a function the required actions, for a component the selected designs."""

    __slots__ = ("_below",)

    def __init__(self, below: "Users | None" = None) -> None:
        self._below = below

    def __missing__(self, index: int) -> Marked:
        return _NOBODY if self._below is None else self._below[index]

    def of(self, index: int) -> Marked:
        found = self.get(index)
        if found is None:
            found = self[index] = (
                Marked() if self._below is None else _Supposed(self._below.of(index))
            )
        return found


class History:
    """The newest measurements of one attribute, in order of time, 16 bytes each; at most twice as many as asked for.

    Times and values are in one array, so that a measurement is added as a whole or not at all.
    """

    __slots__ = ("_memory", "begins", "many", "pairs")

    def __init__(self, memory: Memory, packed: bytes = b"", begins: float | None = None) -> None:
        self._memory, self.pairs = memory, array("d", packed)
        self.begins = (
            -math.inf if begins is None else begins
        )  # all measurements from this time on are held [s]
        self.many = (
            4 * memory.measurements if memory.span == math.inf else 2
        )  # `forget` is called from this length on

    def __len__(self) -> int:
        return len(self.pairs) // 2

    def add(self, time: float, value: float, count: int) -> None:
        """Add a measurement if `pairs` still holds `count` numbers; if it holds more, it was added already."""
        pairs, new = self.pairs, array("d", (time, value))
        place = 2 * self._place(time) if count and time < pairs[-2] else count
        if len(pairs) == count:
            pairs[place:place] = new

    def forget(self) -> None:
        """Forget what exceeds the memory in number or age, but only if that is much."""
        pairs, memory = self.pairs, self._memory
        most = 2 * memory.measurements
        if pairs and (len(pairs) >= 2 * most or pairs[0] < pairs[-2] - 2 * memory.span):
            excess = min(
                max(len(pairs) - most, 2 * self._place(pairs[-2] - memory.span)), len(pairs) - 2
            )
            self.begins = max(self.begins, pairs[excess])
            del pairs[:excess]

    def at(self, time: float) -> float | None:
        """Return the value that was the latest at a time [s], or None before the first."""
        place = self._place(time)
        if not place and time < self.begins:
            raise InvalidValue(
                f"what was measured by {time!r} s is forgotten; memory begins at {self.begins!r} s"
            )
        return self.pairs[2 * place - 1] if place else None

    def samples(self, most: int | None = None) -> tuple[tuple[float, float], ...]:
        """Return all measurements, or the newest `most` of them, as (time [s], value)."""
        pairs = self.pairs if most is None else self.pairs[-2 * most :]
        return tuple(zip(pairs[::2], pairs[1::2], strict=True))

    def packed(self, most: int) -> bytes:
        return self.pairs[-2 * most :].tobytes()

    def begins_within(self, most: int) -> float | None:
        """Return what `begins` would be for the newest `most` measurements; None if nothing is forgotten."""
        begins = self.begins if len(self) <= most else self.pairs[-2 * most]
        return None if begins == -math.inf else begins

    def _place(self, time: float) -> int:
        return bisect_right(range(len(self)), time, key=lambda place: self.pairs[2 * place])


_VALUES: Final = ("value", "time", "verdict", "asserted")
_FLAGS: Final = ("stale", "failed", "active", "selected", "requested", "asserted_required")
FACTS: Final[Mapping[str, object]] = {**dict.fromkeys(_VALUES), **dict.fromkeys(_FLAGS, False)}
"""The arrays of base facts, each with the value that means "nothing is known"."""

_INFERRED: Final[Mapping[str, object]] = {"required": False, "served": 0, "status": Status.FEASIBLE}

UNSET: Final[Mapping[str, Status]] = {
    **dict.fromkeys(LEVELS, Status.FEASIBLE),
    "constraint": Status.NOT_EVALUATED,
}
"""The status of an element of each kind while no fact about it is known."""


class _Said(dict[tuple[str, int], Reason]):
    def __missing__(self, key: tuple[str, int]) -> Reason:
        return _UNSAID


class State:
    """Base facts and what is inferred from them; every array is indexed by `Node.index`.

    Attributes:
        kept: the old values, as (array, key, value) in the order of changes; None while no event changes the state.
    """

    kept: list[tuple[Any, Any, Any]] | None = None

    value: Array[float | None]  # the latest measurement of an attribute
    time: Array[float | None]  # when that was measured [s]
    stale: Array[bool]  # an attribute's latest measurement is too old
    verdict: Array[
        Status | None
    ]  # the status of a constraint with debouncing, from all measurements
    failed: Array[bool]  # a component was reported as failed
    active: Array[bool]  # a component is running
    selected: Array[bool]  # a design or configuration is chosen
    requested: Array[bool]  # an action has an open request
    asserted: Array[Status | None]  # a status that replaces the inferred one
    asserted_required: Array[bool]  # stated to be required, whatever is inferred
    required: Array[
        bool
    ]  # inferred: a requested action, a function of one, a component of a selected design
    served: Array[
        int
    ]  # inferred: how many designs, selected or not, of required functions a component is in
    status: Array[Status]  # inferred: exactly one for each element

    def __init__(self, network: Network) -> None:
        self.network = network
        self.columns: dict[str, Any] = {name: [] for name in (*FACTS, *_INFERRED)}
        for name, column in self.columns.items():
            setattr(self, name, column)
        self.reasons: dict[tuple[str, int], Reason] = (
            _Said()
        )  # of a fact, by name of its array and index of the node
        self.parameters: dict[str, Parameters] = {}  # those last set on each component, by its name
        self.histories: dict[int, History] = {}
        self.users = Users()
        self.adaptable = (
            Marked()
        )  # functions and components that need a choice, or may get a better one
        self.obsolete = Marked()  # active or selected, but for no required function
        self.lacking = Marked()  # the required components that are not active
        self.visited = 0  # how many nodes inference has visited so far
        self.version = (
            0  # number of the last event that changed more here than a value and its time
        )
        self.grow()

    @property
    def marks(self) -> "tuple[Users | Marked, ...]":
        """All sets of nodes that are inferred."""
        return self.users, self.adaptable, self.obsolete, self.lacking

    def grow(self) -> None:
        for name, value in {**FACTS, **_INFERRED}.items():
            new = self.network.nodes[len(self.columns[name]) :]
            self.columns[name] += (
                [UNSET[node.kind] for node in new] if name == "status" else [value] * len(new)
            )

    def forget(self, node: Node) -> None:
        """Forget all facts about a node."""
        for name, unset in FACTS.items():
            self.columns[name][node.index] = unset
        self.histories.pop(node.index, None)
        for key in [key for key in self.reasons if key[1] == node.index]:
            del self.reasons[key]

    def reason(self, column: str, node: Node) -> Reason:
        return self.reasons[column, node.index]

    def give_reason(
        self, column: str, node: Node, text: str = "", until: float | None = None
    ) -> None:
        key, reason = (
            (column, node.index),
            Reason(text, until) if text or until is not None else _UNSAID,
        )
        if self.reasons[key] != reason:
            self.put(self.reasons, key, reason)

    def put(self, changed: Any, key: Any, value: object) -> None:  # noqa: ANN401  # each of ours
        """Change an entry; while old values are kept, `undo` restores the old one."""
        kept = self.kept
        if kept is not None:
            kept.append((changed, key, changed[key]))
        changed[key] = value

    def mark(self, marked: Marked, node: Node, yes: bool) -> None:
        """Add a node to a set, or remove it; `undo` reverses that."""
        own, kept = marked.own, self.kept
        if (node in own) != yes:
            if kept is not None:
                kept.append((marked, node, not yes))
            if yes:
                own[node] = True
            else:
                marked[node] = False

    def undo(self) -> None:
        """Restore all old values that are kept; it can be called again after an interrupt."""
        for changed, key, value in reversed(self.kept or ()):
            changed[key] = value
        self.kept = None


class Overlay(State):
    """A state on top of another: changes made here do not change the state below."""

    def __init__(self, below: State) -> None:
        self.network = below.network
        self.columns = {name: _Layer(column) for name, column in below.columns.items()}
        self.__dict__.update(self.columns)
        self.reasons = _Layer(below.reasons)
        self.parameters = below.parameters
        self.histories = below.histories
        self.users, self.adaptable = Users(below.users), _Supposed(below.adaptable)
        self.obsolete, self.lacking = _Supposed(below.obsolete), _Supposed(below.lacking)
        self.visited = 0
        self.version = below.version

    def mark(self, marked: Marked, node: Node, yes: bool) -> None:
        marked.own[node] = yes

    def changed(self) -> Iterable[int]:
        """Return the indices of the nodes whose status was changed in this layer."""
        assert isinstance(self.status, _Layer)
        return self.status


# -------------------------------------------------------------------- inference

Agenda = list[dict[Node, None]]

_TOP: Final = LEVELS["attribute"]
_NEW: Final = tuple.__new__  # quicker than the constructor


def propagate(state: State, touched: Iterable[Node]) -> list[StatusChange]:
    """Infer all that depends on the touched nodes, whose facts have changed; returns the changes of status."""
    agenda: Agenda = [{}, {}, {}, {}, {}, {}, {}]
    for node in touched:
        _touch(state, node, agenda)
    for node in agenda[_TOP]:
        agenda[0].update(dict.fromkeys(node.constraints))
    changes: list[StatusChange] = []
    status, kept = state.status, state.kept
    for nodes in agenda[:_TOP]:
        state.visited += len(nodes)
        for node in nodes:
            index, kind = node.index, node.kind
            old, new = status[index], infer(state, node)
            if new is old:
                continue
            if kept is not None:
                kept.append((status, index, old))
            status[index] = new
            changes.append(_NEW(StatusChange, (kind, node.name, old, new)))
            wholes: Iterable[Node] = node.wholes
            may_be_chosen_for = kind == "function" or kind == "component"
            if may_be_chosen_for:
                state.mark(state.adaptable, node, is_adaptable(state, node))
            if (old in IMPOSSIBLE) == (new in IMPOSSIBLE):
                wholes = (
                    state.users[index].nodes()
                    if may_be_chosen_for
                    else ()
                    if kind == "constraint"
                    else wholes
                )
            for whole in wholes:
                agenda[whole.level][whole] = None
    return changes


def _touch(state: State, node: Node, agenda: Agenda) -> None:
    index, kind = node.index, node.kind
    agenda[node.level][node] = None
    if kind == "function" or kind == "component":
        _require(state, node)
        if kind == "component":
            _mark_component(state, node)
    elif kind == "action":
        required = state.requested[index] or state.asserted_required[index]
        if required != state.required[index]:
            state.put(state.required, index, required)
            for function in node.parts:
                _use(state, function, node, required, agenda)
    elif kind == "function design":
        selected = state.selected[index]
        _touch(state, node.wholes[0], agenda)
        state.mark(state.obsolete, node, selected and not state.required[node.wholes[0].index])
        for component in node.parts:
            _use(state, component, node, selected, agenda)
    elif kind == "configuration":
        agenda[node.wholes[0].level][node.wholes[0]] = (
            None  # a component's status depends on which is selected
        )
        _mark_configuration(state, node)


def _use(state: State, part: Node, user: Node, uses: bool, agenda: Agenda) -> None:
    state.mark(state.users.of(part.index), user, uses)
    _touch(state, part, agenda)


def _require(state: State, node: Node) -> None:
    """Update whether a function or component is required, and which components its designs serve."""
    index = node.index
    required = state.asserted_required[index] or bool(state.users[index])
    if required == state.required[index]:
        return
    state.put(state.required, index, required)
    if node.kind == "function":
        for design in node.parts:
            _serve(state, design, required)


def _serve(state: State, design: Node, required: bool) -> None:
    """Update how many designs of required functions each component of this design is in."""
    selected, served, kept, mark = state.selected, state.served, state.kept, state.mark
    if selected[design.index]:
        mark(state.obsolete, design, not required)
    for component in design.parts:
        index = component.index
        before = served[index]
        after = before + (1 if required else -1)
        if kept is not None:
            kept.append((served, index, before))
        served[index] = after
        if not before or not after:
            if state.active[index]:
                mark(state.obsolete, component, not after)
            for configuration in component.parts:
                if selected[configuration.index]:
                    mark(state.obsolete, configuration, not after)


def _mark_component(state: State, component: Node) -> None:
    index = component.index
    state.mark(state.lacking, component, state.required[index] and not state.active[index])
    state.mark(state.obsolete, component, state.active[index] and not state.served[index])


def _mark_configuration(state: State, configuration: Node) -> None:
    selected = state.selected[configuration.index]
    state.mark(
        state.obsolete, configuration, selected and not state.served[configuration.wholes[0].index]
    )


def is_adaptable(state: State, node: Node) -> bool:
    """Tell whether a choice is needed for a function or component, or a better one may be looked for."""
    status = state.status[node.index]
    if status is SOLVED:
        return bool(node.element.always_improve)
    return status is UNSOLVED or status is ERROR


def infer(state: State, node: Node) -> Status:
    index, kind = node.index, node.kind
    asserted = state.asserted[index]
    if asserted is not None:
        return asserted
    if kind == "constraint":
        return _compared(state, node, node.element, node.parts[0])
    status, selected, required = state.status, state.selected, state.required[index]
    constraints = [status[one.index] for one in node.constraints] if node.constraints else ()
    if kind == "configuration":
        return configuration_status(constraints)
    parts = [status[part.index] for part in node.parts]
    if kind == "function design":
        return design_status(constraints, parts, selected[index])
    if kind == "action":
        return action_status(constraints, parts, required)
    chosen = [status[part.index] for part in node.parts if selected[part.index]] if required else ()
    if kind == "function":
        return function_status(parts, chosen, required)
    return component_status(
        state.failed[index], constraints, parts, chosen, required, state.active[index]
    )


def _compared(state: State, node: Node, constraint: Constraint, attribute: Node) -> Status:
    if not state.stale[attribute.index]:
        verdict = state.verdict[node.index]
        return verdict or constraint_status(
            state.value[attribute.index], constraint.operator, constraint.value
        )
    return (
        Status.VIOLATED
        if attribute.attribute.when_stale is StalePolicy.VIOLATED
        else Status.NOT_EVALUATED
    )


def infer_anew(state: State) -> None:
    """Infer everything from the facts, e.g. after a change of the model; it can be called again after an interrupt."""
    for node in state.network.present():
        index = node.index
        state.required[index], state.served[index], state.status[index] = False, 0, UNSET[node.kind]
    for marked in state.marks:
        marked.clear()
    propagate(state, state.network.present())
