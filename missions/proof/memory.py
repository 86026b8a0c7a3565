"""What a program remembers, read from its objects as one value that can be compared, kept, and written back.

A state is restored in place: every object below the roots stays the object that it is, and only what differs is
written. So tree, knowledge base and manager need not know that they are explored, and nothing is copied twice.
"""

import functools
import logging
import types
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from enum import Enum
from operator import is_
from typing import Any, Final, NamedTuple
from uuid import UUID

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Composite, Selector, Sequence
from py_trees.decorators import Decorator

from kb import ConfigurationManager, KnowledgeBase, Model
from kb.elements import Element
from kb.events import Log, Publisher
from kb.execution.executor import StagedExecutor
from kb.knowledge import Knowledge
from kb.measurements import Alarms, Measurements
from kb.network import Network, Node
from kb.records import HistoryView, Records, RequiredAction
from kb.state import History, Marked, Overlay, State
from kb.views import Views
from missions.engine.mission import MissionError
from rosa_bt.composites import DoUntilUnfeasible, SafeSwitch
from rosa_bt.decorators import ForAction, UntilSuccess

Content = tuple[Any, ...]
"""What one object holds; equal contents decide alike."""

_ATOMS: Final = (int, float, str, bytes, bool, type(None), type, Enum, UUID)
_FIXED: Final = (Model, Network, Node, Element)
"""What does not change while a mission runs; it may be held anew by whoever remembers something."""
_LEFT: Final = (
    *(*_FIXED, Log, Publisher, History, HistoryView, Views, Overlay, Alarms, logging.Logger, types.ModuleType),
    *(types.FunctionType, types.BuiltinFunctionType, types.MethodType, types.GeneratorType, functools.partial),
    *(weakref.ref, types.MappingProxyType),
)
"""What is left as it is: it does not change, or what it holds decides nothing."""
_IDLE: Final[Mapping[type, frozenset[str]]] = {
    Behaviour: frozenset({"iterator", "feedback_message", "logger", "id", "known"}),
    Knowledge: frozenset(
        "changed_by feasibility revision now pending _before _amended _is_laid _layer serials in_words".split()
    ),
    State: frozenset({"reasons", "histories", "version", "visited"}),
    Marked: frozenset({"_most"}),
    Records: frozenset("requests plans processes attempts answers ended last_end begins rejected _full".split()),
    StagedExecutor: frozenset("_known _plan _stages _stage _failed _commanded _paused".split()),
    RequiredAction: frozenset({"number", "cause", "start"}),
}
"""What decides nothing: the past, and what is said of it. A plan has ended whenever a state is read."""
_REPLACED: Final[Mapping[type, frozenset[str]]] = {Marked: frozenset({"_own"}), Records: frozenset({"open_plans"})}
"""Containers that are replaced by others now and then, so that nobody else holds them."""
_AFRESH: Final[Mapping[type, Mapping[str, Any]]] = {ConfigurationManager: {"_planned_at": -1}}
"""What is the same in every state that is restored: the manager looks at it anew."""
_UNORDERED: Final = (Marked, Measurements, State)
"""Whose mappings are asked by key, never in order."""
_FORGETFUL: Final = (Selector, Sequence, UntilSuccess, ForAction, DoUntilUnfeasible, SafeSwitch)
"""Composites, and decorators with those of py_trees, to which a child that has ended is as one that never ran."""
_ABSENT: Final = object()


class _Cell(NamedTuple):
    """An object that is remembered: how it is read, and how what was read is written back."""

    read: Callable[[], Content]
    write: Callable[[Content], None]


class Memory:
    """All that changes below some objects.

    Args:
        roots: where to begin; what they lead to is found once, so what comes later belongs to what held it.
        apart: objects that belong to another memory.
        reduced: leave out how behaviours ended where it decides nothing.

    Raises:
        MissionError: something cannot be written back, such as a generator that is under way; it is named.
    """

    def __init__(self, roots: Iterable[object], apart: Iterable[object] = (), *, reduced: bool = True) -> None:
        self._is_reduced = reduced
        self._objects: list[Any] = []
        self._numbers: dict[int, int] = {}
        self._cells: list[_Cell] = []
        self._pool: dict[Content, Content] = {}
        for one in apart:
            self._note(one)
        for root in roots:
            self._find(root)
        self._loaded = self.read()

    def read(self) -> Content:
        """Return what is remembered now."""
        pool = self._pool
        contents = [cell.read() for cell in self._cells]
        self._loaded = tuple([pool.setdefault(one, one) for one in contents])
        return self._loaded

    def assume(self, contents: Content) -> None:
        """Take it from whoever knows that this is what would be read now."""
        self._loaded = contents

    def write(self, contents: Content) -> None:
        """Have everything be as it was when this was read; it was read or written last by this memory."""
        for cell, wanted, present in zip(self._cells, contents, self._loaded, strict=True):
            if wanted is not present:
                cell.write(wanted)
        self._loaded = contents

    def _note(self, what: object) -> None:
        self._numbers[id(what)] = len(self._objects)
        self._objects.append(what)

    def _find(self, what: Any, of: object = None) -> None:  # noqa: ANN401  # whatever a program holds
        if isinstance(what, _ATOMS) or id(what) in self._numbers:
            return
        self._note(what)
        if isinstance(what, _LEFT):
            return
        below: list[Any] = []
        if isinstance(what, dict):
            below += [*what, *what.values()]
            in_order: Callable[[Iterable[Any]], Any] = frozenset if isinstance(of, _UNORDERED) else tuple
            self._cells.append(_Cell(lambda: in_order(self._items(what)), lambda content: self._refill(what, content)))
        elif isinstance(what, list | set | deque):
            below += what
            self._cells.append(_Cell(lambda: self._sequence(what), lambda content: self._replace(what, content)))
        elif isinstance(what, tuple | frozenset):
            below += what
        named, idle = dict(_attributes(what)), _names(_IDLE, what)
        for name in _names(_REPLACED, what):
            del named[name]
        for value in (*below, *(value for name, value in named.items() if name not in idle)):
            self._find(value, what)
        if named or _names(_REPLACED, what):
            self._cells.append(self._cell_of(what, named, idle))

    def _cell_of(self, what: Any, base: dict[str, Any], idle: frozenset[str]) -> _Cell:  # noqa: ANN401
        """Return the cell of an object's attributes: only what is not as it was at first."""
        encoded = {name: self._of(value) for name, value in base.items() if name not in idle}
        own = getattr(what, "__dict__", None)
        is_unordered = isinstance(what, _UNORDERED)
        over = _over(what) if isinstance(what, Behaviour) and self._is_reduced else None
        afresh = next((values for kind, values in _AFRESH.items() if isinstance(what, kind)), {})

        last: list[tuple[Any, ...]] = [(_ABSENT,)]
        known: list[Content] = [()]

        def read() -> Content:
            found = []
            now = own if own is not None else _attributes(what)
            held = tuple(now.values())
            if len(held) == len(last[0]) and all(map(is_, held, last[0])):
                return known[0]
            for name, value in now.items():
                if value is not base.get(name, _ABSENT) and name not in idle and name not in afresh:
                    content = self._of(value)
                    if is_unordered and type(content) is tuple and content[0] == "dict":
                        content = ("dict", frozenset(content[1]))
                    if name not in encoded or content != encoded[name]:
                        found.append((name, content))
            if len(now) < len(base):
                found += [(name, ("gone",)) for name in base if name not in now]
            if len(found) > 1:
                found.sort(key=lambda one: one[0])
            content = over(found) if over is not None else tuple(found)
            last[0] = held if _is_shallow(value for _, value in found) else (_ABSENT,)
            known[0] = content
            return content

        def write(content: Content) -> None:
            wanted = {**base, **afresh, **{name: self._decoded(value) for name, value in content}}
            for name in [name for name in _attributes(what) if name not in wanted and name not in idle]:
                object.__delattr__(what, name)
            for name, value in wanted.items():
                if name not in idle and getattr(what, name, _ABSENT) is not value:
                    object.__setattr__(what, name, value)

        return _Cell(read, write)

    def _items(self, what: Mapping[Any, Any]) -> Content:
        return tuple([(self._of(key), self._of(value)) for key, value in what.items()])

    def _refill(self, what: dict[Any, Any], content: Content) -> None:
        what.clear()
        what.update((self._decoded(key), self._decoded(value)) for key, value in content)

    def _sequence(self, what: Any) -> Content:  # noqa: ANN401  # a list, set or deque
        values = tuple(what)
        if all(map(_is_atomic, set(map(type, values)))):
            return values
        return tuple([self._of(value) for value in what])

    def _replace(self, what: Any, content: Content) -> None:  # noqa: ANN401  # a list, set or deque
        what.clear()
        (what.update if isinstance(what, set) else what.extend)([self._decoded(value) for value in content])

    def _of(self, value: Any) -> Any:  # noqa: ANN401  # whatever a program holds
        """Return a value as something that can be compared and hashed."""
        if _is_atomic(type(value)):
            return value
        number = self._numbers.get(id(value))
        if number is not None:
            return ("known", number)
        kind = type(value)
        if kind in (list, tuple, set, frozenset, deque):
            return (kind.__name__, tuple([self._of(one) for one in value]))
        if kind in (dict, types.MappingProxyType):
            return ("dict" if kind is dict else "proxy", self._items(value))
        if isinstance(value, tuple):
            return ("made", kind, tuple([self._of(one) for one in value]))
        if isinstance(value, _FIXED) or (not isinstance(value, _LEFT) and _is_value(value)):
            return ("value", value)
        named = _attributes(value)
        if not named or isinstance(value, _LEFT) or hasattr(value, "__next__"):
            raise MissionError(f"{value!r:.120} came to be while the mission ran and cannot be restored")
        idle = _names(_IDLE, value)
        held = [(name, self._of(one) if name not in idle else one and type(one)()) for name, one in named.items()]
        return ("object", kind, tuple(held))

    def _decoded(self, content: Any) -> Any:  # noqa: ANN401  # what was encoded
        if type(content) is not tuple:
            return content
        kind, *rest = content
        if kind == "known":
            return self._objects[rest[0]]
        if kind == "value":
            return rest[0]
        if kind in ("dict", "proxy"):
            items = {self._decoded(key): self._decoded(value) for key, value in rest[0]}
            return items if kind == "dict" else types.MappingProxyType(items)
        if kind == "made":
            return rest[0]._make(map(self._decoded, rest[1]))
        if kind == "object":
            made = object.__new__(rest[0])
            for name, value in rest[1]:
                object.__setattr__(made, name, self._decoded(value))
            return made
        return _CONTAINERS[kind](map(self._decoded, rest[0]))


_CONTAINERS: Final[Mapping[str, Callable[..., Any]]] = {
    "list": list,
    "tuple": tuple,
    "set": set,
    "frozenset": frozenset,
    "deque": deque,
}


def _attributes(what: object) -> dict[str, Any]:
    """Return the attributes of an object, those in slots too."""
    slots = _slots(type(what))
    if not slots:
        return getattr(what, "__dict__", {})
    found = {name: value for name in slots if (value := getattr(what, name, _ABSENT)) is not _ABSENT}
    return {**found, **getattr(what, "__dict__", {})}


def _over(behaviour: Behaviour) -> Callable[[list[tuple[str, Any]]], Content]:
    """Return what leaves out of what a behaviour remembers how it ended, where that decides nothing any more.

    py_trees' own composites, decorators and leaves, and ours, ask of a child that they have not ticked only whether it
    runs, and where a composite is matters while it runs.
    """
    parent = behaviour.parent
    is_of_no_use = parent is not None and _is_forgetful(parent)
    is_restarting = isinstance(behaviour, Composite) and _is_forgetful(behaviour)
    ended = (Status.SUCCESS, Status.FAILURE)

    def content(found: list[tuple[str, Any]]) -> Content:
        status = next((value for name, value in found if name == "status"), Status.INVALID)
        left = {"current_child"} if is_restarting and status is not Status.RUNNING else set()
        if is_of_no_use and status in ended:
            left.add("status")
        return tuple([one for one in found if one[0] not in left]) if left else tuple(found)

    return content


def _is_forgetful(behaviour: Behaviour) -> bool:
    is_of_py_trees = isinstance(behaviour, Decorator) and type(behaviour).__module__ == Decorator.__module__
    return type(behaviour) in _FORGETFUL or is_of_py_trees


def _is_value(value: object) -> bool:
    """Tell whether an object is compared by what it holds, all of which can be compared."""
    if type(value).__hash__ in (None, object.__hash__):
        return False
    try:
        hash(value)
    except TypeError:
        return False
    return True


def _is_shallow(contents: Iterable[Any]) -> bool:
    """Tell whether all of it is as long as the same objects are held: what is held cannot change by itself."""
    return all(type(one) is not tuple or one[0] in ("known", "value", "gone") for one in contents)


@functools.cache
def _is_atomic(kind: type) -> bool:
    return issubclass(kind, _ATOMS)


@functools.cache
def _slots(kind: type) -> tuple[str, ...]:
    named = [vars(one).get("__slots__", ()) for one in kind.__mro__]
    flat = [name for names in named for name in ((names,) if isinstance(names, str) else names)]
    return tuple(name for name in flat if name not in ("__dict__", "__weakref__"))


def _names(table: Mapping[type, frozenset[str]], what: object) -> frozenset[str]:
    return frozenset().union(*(names for kind, names in table.items() if isinstance(what, kind)))
