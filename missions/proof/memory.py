"""Read the state of a program from its objects, as one value that can be compared and kept, and write it back.

A state is restored in place: every object keeps its identity, and only what differs is written. So tree, knowledge
base and manager need not know that they are explored, and nothing is copied twice.
"""

import functools
import json
import logging
import types
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from collections.abc import Sequence as Items
from dataclasses import fields, is_dataclass
from enum import Enum
from hashlib import blake2b
from operator import itemgetter
from typing import Any, Final, NamedTuple
from uuid import UUID

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Composite, Selector, Sequence
from py_trees.decorators import Decorator

from kb import Model
from kb.elements import Element
from kb.events import Log, Publisher
from kb.knowledge import Knowledge
from kb.network import Network, Node
from kb.records import HistoryView, RequiredAction
from kb.state import FACTS
from kb.views import Views
from missions.engine.mission import MissionError
from missions.proof.tape import Asked, settled
from rosa_bt.composites import DoUntilUnfeasible, SafeSwitch
from rosa_bt.decorators import ForAction, UntilSuccess
from rosa_pddl import Domain, Planner
from rosa_pddl.belief import FeasibilityEvents
from rosa_pddl.executor import RunningStep
from rosa_pddl.goals import Goals, Relevance, SoftGoals
from rosa_pddl.plan_monitor import PlanMonitor
from rosa_pddl.resource_usage import ResourceUsage

Content = tuple[Any, ...]
"""The encoded state of one object, or of all; programs with equal contents decide alike."""

_ATOMS: Final = (int, float, str, bytes, bool, type(None), type, Enum, UUID)
_FIXED: Final = (Model, Network, Node, Element, Domain)
"""Does not change while a mission runs; a state may refer to it."""
_LEFT: Final = (
    *(*_FIXED, Log, Publisher, HistoryView, Views, logging.Logger, types.ModuleType),
    *(
        types.FunctionType,
        types.BuiltinFunctionType,
        types.MethodType,
        types.GeneratorType,
        functools.partial,
    ),
    *(
        weakref.ref,
        types.MappingProxyType,
        Planner,
        Goals,
        PlanMonitor,
        SoftGoals,
        Relevance,
        ResourceUsage,
    ),
    *(FeasibilityEvents, Asked),
)
"""Not read or restored: it does not change, or what it holds decides nothing."""
_FOREIGN: Final[Mapping[type, str]] = {Behaviour: "iterator feedback_message logger id"}
"""Attributes of foreign classes that decide nothing; our own classes name theirs as `BOOKKEEPING`."""
_HOOKS: Final = frozenset({"tick", "stop"})
"""Attributes that a runner sets on behaviours and removes again."""
_FORGETFUL: Final = (Selector, Sequence, UntilSuccess, ForAction, DoUntilUnfeasible, SafeSwitch)
"""Composites and decorators that treat a child that has ended as one that never ran; so do those of py_trees."""
_KINDS: Final[Mapping[str, Any]] = {
    kind.__name__: kind
    for kind in (list, tuple, set, frozenset, deque, dict, types.MappingProxyType)
}
_ABSENT: Final = object()


class _Cell(NamedTuple):
    """One object of the state: `read` returns its (pooled) content, `write` restores it."""

    read: Callable[[], Any]
    write: Callable[[Any], None]


class Memory:
    """The state of all objects that can be reached from some roots.

    Args:
        roots: where to begin. The objects are found once; an object made later belongs to the one that holds it.
        apart: objects that belong to another memory.
        parameters: include the parameters that are in force, which only budgets and users ask for.

    Raises:
        MissionError: an object cannot be restored, such as a running generator, or a class names an attribute as
            `BOOKKEEPING` that it does not have; the message names it.
    """

    def __init__(
        self, roots: Iterable[object], apart: Iterable[object] = (), *, parameters: bool = True
    ) -> None:
        self.objects: list[Any] = []
        self._numbers: dict[int, int] = {}
        self._cells: list[_Cell] = []
        self._pool: dict[Any, Any] = {}
        self._shared: dict[Any, Any] = {}  # objects that keep their identity in all states
        self._states: dict[int, Content] = {}
        self._by_ids: dict[tuple[int, ...], int] = {}
        self.with_parameters = parameters
        for one in apart:
            self._note(one)
        for root in roots:
            self._find(root)
        self._loaded = self._states[self.read()]

    def __contains__(self, key: int) -> bool:
        return key in self._states

    def read(self) -> int:
        """Return the key of the present state; equal states have equal keys, in every process."""
        self._loaded = state = tuple([cell.read() for cell in self._cells])
        ids = tuple(map(id, state))
        key = self._by_ids.get(ids)
        if key is None:
            text = "\n".join(map(said, state))
            key = int.from_bytes(blake2b(text.encode(), digest_size=8).digest())
            self._by_ids[ids] = key
            if self._states.setdefault(key, state) is not state:
                raise MissionError(
                    "two states of the mission differ, but the repr() of their values is equal"
                )
        return key

    def write(self, key: int) -> None:
        """Restore the state with this key."""
        wanted_state = self._states[key]
        for cell, wanted, present in zip(self._cells, wanted_state, self._loaded, strict=True):
            if wanted is not present:
                cell.write(wanted)
        self._loaded = wanted_state

    def pooled(self, content: Any) -> Any:  # noqa: ANN401  # what was encoded
        """Return one and the same object for all equal contents."""
        return self._pool.setdefault(content, content)

    def _note(self, what: object) -> None:
        self._numbers[id(what)] = len(self.objects)
        self.objects.append(what)

    def _find(self, what: Any) -> None:  # noqa: ANN401  # whatever a program holds
        if isinstance(what, _ATOMS) or id(what) in self._numbers:
            return
        self._note(what)
        if isinstance(what, Knowledge):
            self._cells.append(_facts(what, self))
        if isinstance(what, (*_LEFT, Knowledge)):
            return
        below: list[Any] = []
        if isinstance(what, dict):
            below += [*what, *what.values()]
        elif isinstance(what, list | set | deque | tuple | frozenset):
            below += what
        if isinstance(what, dict | list | set | deque):
            self._cells.append(
                _Cell(lambda: self.pooled(self.held(what)), lambda held: self.refill(what, held))
            )
        named, idle = dict(_attributes(what)), _idle(type(what))  # type: ignore[arg-type]  # a type can be hashed
        if missing := idle - named.keys() - _HOOKS:
            raise MissionError(
                f"{type(what).__name__} has no {min(missing)}, which it names as its BOOKKEEPING"
            )
        for value in (*below, *(value for name, value in named.items() if name not in idle)):
            self._find(value)
        if named:
            self._cells.append(self._cell_of(what, named, idle))

    def _cell_of(self, what: Any, base: dict[str, Any], idle: frozenset[str]) -> _Cell:  # noqa: ANN401  # whatever object
        """Return the cell of an object's attributes; its content holds only those that differ from the first state."""
        encoded = {name: self.of(value) for name, value in base.items() if name not in idle}
        own = vars(what) if _attributes(what) is getattr(what, "__dict__", None) else None
        of_no_use = _of_no_use(what) if isinstance(what, Behaviour) else None

        def read() -> Content:
            now = own if own is not None else _attributes(what)
            found = (
                [(name, ("gone",)) for name in base if name not in now]
                if len(now) < len(base)
                else []
            )
            for name, value in now.items():
                if value is not base.get(name, _ABSENT) and name not in idle:
                    content = self.of(value)
                    if name not in encoded or content != encoded[name]:
                        found.append((name, content))
            left = of_no_use(dict(found)) if of_no_use is not None else ()
            for name in left:  # reset what decides nothing: it must not differ between equal states
                setattr(what, name, base[name])
            kept: Content = self.pooled(
                tuple(sorted((one for one in found if one[0] not in left), key=itemgetter(0)))
            )
            return kept

        def write(content: Content) -> None:
            wanted = {**base, **{name: self.decoded(value) for name, value in content}}
            for name in [
                name for name in _attributes(what) if name not in wanted and name not in idle
            ]:
                object.__delattr__(what, name)
            for name, value in wanted.items():
                if name not in idle and getattr(what, name, _ABSENT) is not value:
                    object.__setattr__(what, name, value)

        return _Cell(read, write)

    def held(self, what: Any) -> Any:  # noqa: ANN401  # a container
        if isinstance(what, Mapping):
            return tuple([(self.of(key), self.of(value)) for key, value in what.items()])
        in_order: Callable[[Iterable[Any]], Any] = (
            frozenset if isinstance(what, set | frozenset) else tuple
        )
        return in_order(
            what if all(map(_is_atomic, set(map(type, what)))) else [self.of(one) for one in what]
        )

    def refill(self, what: Any, content: Iterable[Any]) -> None:  # noqa: ANN401  # a container
        what.clear()
        if isinstance(what, dict):
            what.update((self.decoded(key), self.decoded(value)) for key, value in content)
        else:
            (what.update if isinstance(what, set) else what.extend)(
                [self.decoded(value) for value in content]
            )

    def of(self, value: Any) -> Any:  # noqa: ANN401  # whatever a program holds
        """Encode a value so that it can be compared and hashed; `decoded` is the inverse."""
        value = settled(value) if type(value) is Asked else value
        kind = type(value)
        if kind is Asked:
            return ("value", value)
        if _is_atomic(kind):  # type: ignore[arg-type]  # a type can be hashed
            return value
        number = self._numbers.get(id(value))
        if number is not None:
            return ("known", number)
        if kind in _KINDS.values():
            return (type(value).__name__, self.held(value))
        if isinstance(value, tuple):
            return ("made", kind, tuple([self.of(one) for one in value]))
        idle = _idle(kind)  # type: ignore[arg-type]  # a type can be hashed
        if isinstance(value, _FIXED) or (
            not isinstance(value, _LEFT) and not idle and _is_value(value)
        ):
            return ("value", value)
        named = _attributes(value)
        if not named or isinstance(value, _LEFT) or hasattr(value, "__next__"):
            raise MissionError(
                f"{value!r:.120} came to be while the mission ran and cannot be restored"
            )
        held = [
            (name, self.of(one) if name not in idle else one and type(one)())
            for name, one in named.items()
        ]
        content = ("object", kind, tuple(held))
        if kind is RunningStep:
            self._shared[content] = value
        return content

    def decoded(self, content: Any) -> Any:  # noqa: ANN401  # what was encoded
        if type(content) is not tuple:
            return content
        kind, first, *rest = content
        if kind == "known":
            return self.objects[first]
        if kind == "value":
            return first
        if kind == "made":
            return tuple.__new__(first, map(self.decoded, rest[0]))
        if kind == "object":
            made = self._shared.get(content) or object.__new__(first)
            for name, value in rest[0]:
                object.__setattr__(made, name, self.decoded(value))
            return made
        if kind in ("dict", "mappingproxy"):
            items = {self.decoded(key): self.decoded(value) for key, value in first}
            return items if kind == "dict" else types.MappingProxyType(items)
        return _KINDS[kind](map(self.decoded, first))


def said(content: Any) -> str:  # noqa: ANN401  # what was encoded
    """Return a content as text, the same in every process: sets are sorted, and no memory address appears."""
    return json.dumps(content, default=_plain)


def _plain(content: Any) -> object:  # noqa: ANN401  # a value that JSON does not know
    kind = type(content)
    if issubclass(kind, set | frozenset):
        return sorted(map(said, content))
    if kind is Asked:
        return repr(content)
    if hasattr(content, "__qualname__"):
        return f"{content.__module__}.{content.__qualname__}"
    if issubclass(kind, _FIXED):
        return f"{kind.__name__} {getattr(content, 'name', content)}"
    if not is_dataclass(kind):
        return repr(content)
    return [kind.__name__, *(getattr(content, one.name) for one in fields(kind) if one.compare)]


def _attributes(what: object) -> dict[str, Any]:
    """Return the attributes of an object, including those in slots."""
    own: dict[str, Any] = getattr(what, "__dict__", {})
    slots = _slots(type(what))  # type: ignore[arg-type]  # a type can be hashed
    return (
        own
        if not slots
        else {name: getattr(what, name) for name in slots if hasattr(what, name)} | own
    )


def _of_no_use(behaviour: Behaviour) -> Callable[[Mapping[str, Any]], set[str]]:
    """Return a function that names the attributes of a behaviour that decide nothing in its present state.

    The composites and decorators of py_trees, and ours, ask of a child that they have not ticked only whether it runs.
    The current child of a composite matters only while the composite runs.
    """
    is_below = behaviour.parent is not None and _is_forgetful(behaviour.parent)
    is_restarting = isinstance(behaviour, Composite) and _is_forgetful(behaviour)

    def names(found: Mapping[str, Any]) -> set[str]:
        status = found.get("status", Status.INVALID)
        place = {"current_child"} if is_restarting and status is not Status.RUNNING else set()
        return place | ({"status"} if is_below and status is not Status.RUNNING else set())

    return names


def _is_forgetful(behaviour: Behaviour) -> bool:
    is_of_py_trees = (
        isinstance(behaviour, Decorator) and type(behaviour).__module__ == Decorator.__module__
    )
    return type(behaviour) in _FORGETFUL or is_of_py_trees


def _is_value(value: object) -> bool:
    """Return whether an object is compared by value, and all that it holds can be hashed."""
    try:
        return type(value).__hash__ is not object.__hash__ and hash(value) is not None
    except TypeError:
        return False


@functools.cache
def _is_atomic(kind: Any) -> bool:  # noqa: ANN401  # whatever type
    return issubclass(kind, _ATOMS)


@functools.cache
def _slots(kind: Any) -> tuple[str, ...]:  # noqa: ANN401  # whatever type
    named = [vars(one).get("__slots__", ()) for one in kind.__mro__]
    flat = [name for names in named for name in ((names,) if isinstance(names, str) else names)]
    return tuple(name for name in flat if name not in ("__dict__", "__weakref__"))


@functools.cache
def _idle(kind: Any) -> frozenset[str]:  # noqa: ANN401  # whatever type
    """Return the attributes of objects of a class that decide nothing."""
    named = [vars(one).get("BOOKKEEPING", _FOREIGN.get(one, "")) for one in kind.__mro__]
    return frozenset(" ".join(named).split()) | (
        _HOOKS if issubclass(kind, Behaviour) else frozenset()
    )


class _Facts(tuple[Any, ...]):
    """The facts of a knowledge base; as attributes, not compared, what is inferred from them."""

    columns: Items[tuple[Any, ...]]
    marks: Items[tuple[int, Items[int]]]


def _facts(known: Knowledge, memory: Memory) -> _Cell:
    """Return the cell of a knowledge base."""
    state, measurements, records = known.state, known.measurements, known.records
    facts = [state.columns[name] for name in FACTS]
    inferred = [column for name, column in state.columns.items() if name not in FACTS]
    tables: tuple[dict[Any, Any], ...] = (measurements.recent, measurements.since, records.progress)

    def read() -> _Facts:
        known.settled()
        requests = [(one.action, memory.of(one.preference)) for one in records.required.values()]
        given = frozenset(memory.held(state.parameters) if memory.with_parameters else ())
        others = tuple(requests), *(frozenset(one.items()) for one in tables), given
        now = _Facts((*map(tuple, facts), *others))
        found: _Facts = memory.pooled(now)
        if found is now:
            every = [
                (-3, state.lacking),
                (-2, state.obsolete),
                (-1, state.adaptable),
                *state.users.items(),
            ]
            now.marks = [
                (place, [node.index for node in marked]) for place, marked in every if marked
            ]
            now.columns = [tuple(one) for one in inferred]
        return found

    def write(content: _Facts) -> None:
        known.settled()  # or an interrupted event would be undone later, in the restored state
        known.log.last += 1  # a new revision, so that caches are refreshed
        known.revision = known.log.last
        for column, values in (
            *zip(facts, content, strict=False),
            *zip(inferred, content.columns, strict=True),
        ):
            column[:] = values
        requests, *kept, given = content[len(facts) :]
        records.required.clear()
        for action, preference in requests:
            records.required[action] = RequiredAction(action, memory.decoded(preference), known.now)
        for table, held in zip(tables, kept, strict=True):
            table.clear()
            table.update(held)
        if memory.with_parameters:
            memory.refill(state.parameters, given)
        for inference in state.marks:
            inference.clear()
        for place, nodes in content.marks:
            marked = (
                state.users.of(place)
                if place >= 0
                else (state.lacking, state.obsolete, state.adaptable)[place]
            )
            for index in nodes:
                marked[state.network.nodes[index]] = True

    return _Cell(read, write)
