"""The state of a tree: read from its objects as one value that can be compared, and written back in place.

Every object keeps its identity, so neither the tree nor what it holds needs to know that it is explored.
"""

import functools
import logging
import types
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from enum import Enum
from typing import Any, Final

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Composite, Selector, Sequence
from py_trees.decorators import Decorator

from kb import KnowledgeBase, Model
from missions.engine.mission import MissionError
from rosa_bt import ForAction, UntilSuccess
from rosa_bt.composites import DoUntilUnfeasible, SafeSwitch

_ATOMS: Final = (int, float, str, bytes, type(None), type, Enum)
_FIXED: Final = (
    *(KnowledgeBase, Model, logging.Logger, types.ModuleType, types.FunctionType),
    *(types.BuiltinFunctionType, types.MethodType),
    *(functools.partial, weakref.ref),
)
"""Not part of the state: what cannot change, and the knowledge base, whose facts are read apart."""
_IGNORED: Final = {
    *("iterator", "feedback_message", "logger", "id", "tick", "stop", "update", "initialise"),
    *("terminate", "save_progress", "restore_progress", "finish_time", "plans"),
    *("_since", "_halting_since", "_saved_s", "last_event", "reasons", "_planned"),
}
"""Attributes that decide nothing: functions, texts, records, and times by a clock that stands still."""
_FORGETFUL: Final = (Selector, Sequence, UntilSuccess, ForAction, DoUntilUnfeasible, SafeSwitch)
"""These treat a child that has ended as one that never ran; so do the decorators of py_trees."""
_CONTAINERS: Final = (list, set, deque, dict)
Content = Any


class Memory:
    """The state of all objects that can be reached from some roots.

    Raises:
        MissionError: an object cannot be restored, such as a running generator; the message names it.
    """

    def __init__(self, roots: Iterable[object]) -> None:
        self._objects: list[Any] = []
        self._numbers: dict[int, int] = {}
        self._states: list[tuple[Content, ...]] = []
        self._number_of: dict[tuple[Content, ...], int] = {}
        self._pool: dict[Content, Content] = {}
        self._stateful: list[Any] = []
        for root in roots:
            self._find(root)
        self._loaded: tuple[Content, ...] = ()
        self._loaded = self._states[self.read()]

    def read(self) -> int:
        """Return the number of the present state; equal states have equal numbers."""
        contents = []
        for each in self._stateful:
            content = self._content(each)
            contents.append(self._pool.setdefault(content, content))
        self._loaded = tuple(contents)
        number = self._number_of.setdefault(self._loaded, len(self._states))
        if number == len(self._states):
            self._states.append(self._loaded)
        return number

    def write(self, number: int) -> None:
        """Restore the state with this number."""
        state = self._states[number]
        for each, content, present in zip(self._stateful, state, self._loaded, strict=True):
            if content is not present:
                self._restore(each, content)
        self._loaded = state

    def _find(self, root: object) -> None:
        pending = [root]
        while pending:
            each = pending.pop()
            if isinstance(each, (*_ATOMS, *_FIXED)) or id(each) in self._numbers:
                continue
            if type(each).__module__.partition(".")[0] == "kb":
                continue
            if isinstance(each, Mapping):
                pending += [*each.keys(), *each.values()]
            elif isinstance(each, list | tuple | set | frozenset | deque):
                pending += each
            attributes = attributes_of(each)
            pending += attributes.values()
            self._numbers[id(each)] = len(self._objects)
            self._objects.append(each)
            if isinstance(each, _CONTAINERS) or (attributes and not isinstance(each, tuple)):
                self._stateful.append(each)

    def _content(self, each: Any) -> Content:  # noqa: ANN401  # any object of a program
        if isinstance(each, _CONTAINERS):
            return self._items(each)
        if isinstance(each, Behaviour):
            vars(each).update({name: _RESET[name] for name in _unneeded(each)})
        names = attributes_of(each).items()
        return tuple([(name, self._encoded(value)) for name, value in names])

    def _items(self, container: Any) -> Content:  # noqa: ANN401  # any container
        if isinstance(container, Mapping):
            pairs = [(self._encoded(k), self._encoded(v)) for k, v in container.items()]
            return tuple(sorted(pairs, key=_first_as_text))
        encoded = [self._encoded(item) for item in container]
        return frozenset(encoded) if isinstance(container, set | frozenset) else tuple(encoded)

    def _encoded(self, value: Any) -> Content:  # noqa: ANN401  # any value of a program
        number = self._numbers.get(id(value))
        if number is not None:
            return ("known", number)
        if isinstance(value, (*_ATOMS, *_FIXED)) or type(value).__module__.startswith("kb."):
            return value
        kind = dict if isinstance(value, Mapping) else type(value)
        if isinstance(value, list | tuple | set | frozenset | deque | Mapping):
            return ("items", kind, self._items(value))
        attributes = attributes_of(value)
        if not attributes or hasattr(value, "__next__"):
            raise MissionError(f"{value!r:.120} came to be while the tree ran; no state holds it")
        names = [(name, self._encoded(one)) for name, one in attributes.items()]
        return ("object", kind, tuple(names))

    def _decoded(self, content: Content) -> Any:  # noqa: ANN401  # any value of a program
        if type(content) is not tuple:
            return content
        if content[0] == "known":
            return self._objects[content[1]]
        _, kind, parts = content
        if content[0] == "object":
            made = object.__new__(kind)
            for name, part in parts:
                object.__setattr__(made, name, self._decoded(part))
            return made
        if issubclass(kind, dict):
            return {self._decoded(key): self._decoded(part) for key, part in parts}
        items = [self._decoded(part) for part in parts]
        return tuple.__new__(kind, items) if issubclass(kind, tuple) else kind(items)

    def _restore(self, each: Any, content: Content) -> None:  # noqa: ANN401  # any object
        if isinstance(each, _CONTAINERS):
            each.clear()
            if isinstance(each, dict):
                each.update({self._decoded(k): self._decoded(v) for k, v in content})
            else:
                add: Callable[[Any], object] = each.update if isinstance(each, set) else each.extend
                add([self._decoded(part) for part in content])
            return
        names = dict(content)
        for name in attributes_of(each):
            if name not in names:
                object.__delattr__(each, name)
        for name, part in names.items():
            object.__setattr__(each, name, self._decoded(part))


def _first_as_text(pair: tuple[Content, Content]) -> str:
    return repr(pair[0])


def attributes_of(each: Any) -> dict[str, Any]:  # noqa: ANN401  # any object
    """Return the attributes of an object that may decide something, including those in slots."""
    if isinstance(each, type):
        return {}
    if "__getstate__" in vars(type(each)) and each.__getstate__() is None:
        return {}  # it says itself that it has no state
    found: dict[str, Any] = dict(getattr(each, "__dict__", {}))
    slots = [vars(kind) for kind in type(each).__mro__ if "__slots__" in vars(kind)]
    for name, member in [item for attributes in slots for item in attributes.items()]:
        if isinstance(member, types.MemberDescriptorType):
            with suppress(AttributeError):  # not set yet
                found[name] = member.__get__(each)
    return {name: value for name, value in found.items() if name not in _IGNORED}


_RESET: Final = {"status": Status.INVALID, "current_child": None}


def _unneeded(behaviour: Behaviour) -> list[str]:
    """Return the attributes of a behaviour that decide nothing now: nobody asks how a child has ended."""
    if behaviour.status is Status.RUNNING:
        return []
    parent = behaviour.parent
    names = []
    if parent is not None and _is_forgetful(parent):
        names.append("status")
    if isinstance(behaviour, Composite) and _is_forgetful(behaviour):
        names.append("current_child")
    return names


def _is_forgetful(behaviour: Behaviour) -> bool:
    is_of_py_trees = type(behaviour).__module__ == Decorator.__module__
    return type(behaviour) in _FORGETFUL or (is_of_py_trees and isinstance(behaviour, Decorator))
