"""The state of a tree: read from its objects as one value, and written back in place.

Every object keeps its identity, so neither the tree nor what it holds needs to know that it is
explored.
"""

import functools
import logging
import pickle
import types
import weakref
from collections.abc import Iterable, Mapping
from enum import Enum
from io import BytesIO
from typing import Any, Final

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Composite, Selector, Sequence
from py_trees.decorators import Decorator

from missions.engine.mission import MissionError
from rosa_bt import ForAction, UntilSuccess
from rosa_bt.composites import DoUntilUnfeasible, SafeSwitch

_ATOMS: Final = {int, float, bool, str, bytes, type(None)}
_FIXED: Final = (
    *(logging.Logger, types.ModuleType, types.FunctionType, type, Enum),
    *(types.BuiltinFunctionType, types.MethodType, functools.partial, weakref.ref),
)
"""Not part of the state: what cannot change, and the knowledge base, whose facts are read apart."""
_IGNORED: Final = {
    *("iterator", "feedback_message", "finish_time", "plans", "_since", "_halting_since"),
    *("last_event", "_planned", "reasons", "advanced_at"),
}
"""Attributes that decide nothing: texts, records, and times by a clock that stands still."""
_FORGETFUL: Final = (Selector, Sequence, UntilSuccess, ForAction, DoUntilUnfeasible, SafeSwitch)
"""These treat a child that has ended as one that never ran; so do the decorators of py_trees."""


class Memory:
    """The state of all objects that can be reached from some roots."""

    def __init__(self, roots: Iterable[object]) -> None:
        self._objects: list[Any] = []
        self._numbers: dict[int, int] = {}
        self._fixed: dict[Any, int] = {}
        self._stateful: list[Any] = []
        pending = [*roots]
        while pending:
            each = pending.pop()
            if self._number(each) is None and type(each) not in _ATOMS:
                self._numbers[id(each)] = len(self._objects)
                self._objects.append(each)
                attributes = _attributes(each)
                if attributes or isinstance(each, list | set | dict):
                    self._stateful.append(each)
                pending += attributes.values()
                if isinstance(each, Mapping):
                    pending += [*each.keys(), *each.values()]
                elif isinstance(each, list | tuple | set | frozenset):
                    pending += each

    def _number(self, value: Any) -> int | None:  # noqa: ANN401  # any value of a program
        """Return the number of a known object or a fixed value; None if it is neither."""
        if type(value) in _ATOMS:
            return None
        if id(value) in self._numbers:
            return self._numbers[id(value)]
        if not is_fixed(value):
            return None
        if value not in self._fixed:
            self._fixed[value] = len(self._objects)
            self._objects.append(value)
        return self._fixed[value]

    def read(self) -> bytes:
        """Return the present state, equal states as equal bytes.

        Raises:
            MissionError: something that came to be cannot be restored, such as a running generator.
        """
        state = BytesIO()
        pickler = pickle.Pickler(state)
        pickler.fast = True  # else the bytes would tell which of equal parts are the same
        pickler.persistent_id = self._number  # type: ignore[method-assign]  # as pickle allows
        try:
            pickler.dump([_content(each) for each in self._stateful])
        except (TypeError, AttributeError, pickle.PicklingError) as error:
            raise MissionError(
                f"no state holds what came to be while the tree ran: {error}"
            ) from error
        return state.getvalue()

    def write(self, state: bytes) -> None:
        """Restore a state."""
        unpickler = pickle.Unpickler(BytesIO(state))
        unpickler.persistent_load = self._objects.__getitem__  # type: ignore[method-assign]  # also allowed
        for each, content in zip(self._stateful, unpickler.load(), strict=True):
            if isinstance(each, dict | set):
                each.clear()
                each.update(content)
            elif isinstance(each, list):
                each[:] = content
            else:
                for name in _attributes(each).keys() - content.keys():
                    object.__delattr__(each, name)
                for name, value in content.items():
                    object.__setattr__(each, name, value)


def is_fixed(value: object) -> bool:
    """Tell whether a value is no part of the state."""
    return isinstance(value, _FIXED) or type(value).__module__.startswith("kb.")


def _content(each: Any) -> Any:  # noqa: ANN401  # any object of a program
    if isinstance(each, dict):
        return sorted(each.items(), key=repr)
    if isinstance(each, set):
        return sorted(each, key=repr)
    if isinstance(each, list):
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
    kind = type(behaviour)
    return kind in _FORGETFUL or kind.__module__ == Decorator.__module__
