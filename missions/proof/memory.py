"""The state of a tree: read from its objects as one value, and written back in place.

Every object keeps its identity, so neither the tree nor what it holds needs to know that it is
explored.
"""

import functools
import logging
import pickle
import types
import weakref
from collections import deque
from collections.abc import Iterable, Mapping
from enum import Enum
from io import BytesIO
from typing import Any, Final

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Composite, Selector, Sequence
from py_trees.decorators import Decorator

from kb import KnowledgeBase, Model
from missions.engine.mission import MissionError
from rosa_bt import ForAction, UntilSuccess
from rosa_bt.composites import DoUntilUnfeasible, SafeSwitch

_ATOMS: Final = {int, float, bool, str, bytes, type(None)}
_FIXED: Final = (
    *(KnowledgeBase, Model, logging.Logger, types.ModuleType, types.FunctionType, type, Enum),
    *(types.BuiltinFunctionType, types.MethodType, functools.partial, weakref.ref),
)
"""Not part of the state: what cannot change, and the knowledge base, whose facts are read apart."""
_IGNORED: Final = {
    *("iterator", "feedback_message", "logger", "id", "tick", "stop", "update", "initialise"),
    *("terminate", "save_progress", "restore_progress", "finish_time", "plans"),
    *("_since", "_halting_since", "last_event", "reasons", "_planned", "asked"),
}
"""Attributes that decide nothing: functions, texts, records, and times by a clock that stands
still."""
_FORGETFUL: Final = (Selector, Sequence, UntilSuccess, ForAction, DoUntilUnfeasible, SafeSwitch)
"""These treat a child that has ended as one that never ran; so do the decorators of py_trees."""
_CONTAINERS: Final = (list, set, deque, dict)


class Memory:
    """The state of all objects that can be reached from some roots."""

    def __init__(self, roots: Iterable[object]) -> None:
        self.objects: list[Any] = []
        self.numbers: dict[int, int] = {}
        self.fixed: dict[Any, int] = {}
        self._stateful: list[Any] = []
        self._states: dict[bytes, bytes] = {}
        pending = [*roots]
        while pending:
            each = pending.pop()
            if type(each) not in _ATOMS and not is_fixed(each) and id(each) not in self.numbers:
                pending += self._add(each)

    def _add(self, each: object) -> list[object]:
        """Add an object and return those that it refers to."""
        attributes = _attributes(each)
        self.numbers[id(each)] = len(self.objects)
        self.objects.append(each)
        if isinstance(each, _CONTAINERS) or (attributes and not isinstance(each, tuple)):
            self._stateful.append(each)
        items: list[object] = list(attributes.values())
        if isinstance(each, Mapping):
            items += [*each.keys(), *each.values()]
        elif isinstance(each, list | tuple | set | frozenset | deque):
            items += each
        return items

    def read(self) -> bytes:
        """Return the present state; equal states are the same object.

        Raises:
            MissionError: something that came to be cannot be restored, such as a running generator.
        """
        text = BytesIO()
        writer = _Writer(text, self)
        try:
            writer.dump([_content(each) for each in self._stateful])
        except (TypeError, AttributeError, pickle.PicklingError) as error:
            raise MissionError(
                f"no state holds what came to be while the tree ran: {error}"
            ) from error
        state = text.getvalue()
        return self._states.setdefault(state, state)

    def write(self, state: bytes) -> None:
        """Restore a state."""
        contents = _Reader(BytesIO(state), self).load()
        for each, content in zip(self._stateful, contents, strict=True):
            if isinstance(each, dict | set):
                each.clear()
                each.update(content)
            elif isinstance(each, list | deque):
                each.clear()
                each.extend(content)
            else:
                for name in _attributes(each).keys() - content.keys():
                    object.__delattr__(each, name)
                for name, value in content.items():
                    object.__setattr__(each, name, value)


class _Writer(pickle.Pickler):
    """Writes equal contents as equal bytes; objects that are known keep their identity."""

    def __init__(self, file: BytesIO, memory: Memory) -> None:
        super().__init__(file)
        self.fast = True  # else the bytes would tell which of equal parts are the same
        self._memory = memory

    def persistent_id(self, value: Any) -> Any:  # noqa: ANN401  # any value of a program
        if type(value) in _ATOMS:
            return None
        memory = self._memory
        if (number := memory.numbers.get(id(value))) is not None:
            return ("object", number)
        if is_fixed(value):
            return ("fixed", memory.fixed.setdefault(value, len(memory.fixed)))
        return None


class _Reader(pickle.Unpickler):
    def __init__(self, file: BytesIO, memory: Memory) -> None:
        super().__init__(file)
        self._objects = {"object": memory.objects, "fixed": [*memory.fixed]}

    def persistent_load(self, key: Any) -> Any:  # noqa: ANN401  # any value of a program
        kind, number = key
        return self._objects[kind][number]


def is_fixed(value: object) -> bool:
    """Tell whether a value is no part of the state."""
    return isinstance(value, _FIXED) or type(value).__module__.startswith("kb.")


def _content(each: Any) -> Any:  # noqa: ANN401  # any object of a program
    if isinstance(each, dict):
        return sorted(each.items(), key=repr)
    if isinstance(each, set):
        return sorted(each, key=repr)
    if isinstance(each, list | deque):
        return [*each]
    if isinstance(each, Behaviour) and each.status is not Status.RUNNING:
        if each.parent is not None and _is_forgetful(each.parent):
            each.status = Status.INVALID  # nobody asks how it has ended
        if isinstance(each, Composite) and _is_forgetful(each):
            each.current_child = None
    return _attributes(each)


def _attributes(each: Any) -> dict[str, Any]:  # noqa: ANN401  # any object
    """Return the attributes of an object that may decide something."""
    if "__getstate__" in vars(type(each)) and each.__getstate__() is None:
        return {}  # it says itself that it has no state
    attributes = getattr(each, "__dict__", {})
    return {name: value for name, value in attributes.items() if name not in _IGNORED}


def _is_forgetful(behaviour: Behaviour) -> bool:
    is_of_py_trees = type(behaviour).__module__ == Decorator.__module__
    return type(behaviour) in _FORGETFUL or (is_of_py_trees and isinstance(behaviour, Decorator))
