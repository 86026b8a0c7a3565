"""What keeps a tree alive: an exception of a behaviour becomes its FAILURE, and nobody changes a tree within a tick."""

from collections.abc import Callable, Iterable, Iterator
from typing import Final

from py_trees.behaviour import Behaviour
from py_trees.behaviours import Failure, Running, Success
from py_trees.common import Status
from py_trees.composites import Selector, Sequence
from py_trees.decorators import Decorator

from rosa_bt.behaviours import KbBehaviour, RosaAction
from rosa_bt.decorators import ForAction
from rosa_bt.endings import halt, told
from rosa_bt.exceptions import TreeChangeError

__all__ = ["Children", "Lock", "guard", "is_trusted", "put_back"]

_TRUSTED: Final = frozenset({Failure, Running, Selector, Sequence, Success})
"""What raises nothing of its own; a subclass may."""
_CAREFUL: Final = (KbBehaviour, RosaAction, ForAction)
"""What deals with exceptions itself, also below a plain tree; unless a subclass ticks in another way."""


class Lock:
    """Whether a tree is being ticked, and what was refused because of that.

    Attributes:
        is_closed: nothing may be changed now.
        refused: what was tried all the same.
    """

    def __init__(self) -> None:
        self.is_closed = False
        self.refused: list[TreeChangeError] = []

    def refuse(self, parent: Behaviour) -> TreeChangeError:
        """Note that the children of a behaviour were to be changed, and return the error that says so."""
        error = TreeChangeError(
            f"the children of {parent.name!r} were to be changed in the middle of a tick; ask the runner "
            "instead (insert, replace, prune): it changes them before the next tick"
        )
        self.refused.append(error)
        return error


class Children(list[Behaviour]):
    """The children of a behaviour, which cannot be changed while the tree is being ticked."""

    def __init__(self, children: Iterable[Behaviour], parent: Behaviour, lock: Lock) -> None:
        super().__init__(children)
        self._parent = parent
        self.lock = lock

    def _check(self) -> None:
        if not self.lock.is_closed:
            return
        raise self.lock.refuse(self._parent)


def _checked(name: str) -> Callable[..., object]:
    change = getattr(list, name)

    def checked(self: Children, *given: object, **named: object) -> object:
        self._check()
        return change(self, *given, **named)

    checked.__name__ = name
    return checked


for _name in (
    *("append", "clear", "extend", "insert", "pop", "remove", "reverse", "sort"),
    *("__delitem__", "__iadd__", "__imul__", "__setitem__"),
):
    setattr(Children, _name, _checked(_name))


def put_back(parent: Behaviour, children: Children) -> bool:
    """Undo that other children were put in the place of a behaviour's, and refuse it; tell whether there was need."""
    found = [parent.decorated] if isinstance(parent, Decorator) else []
    if parent.children is children and found == children[: len(found)]:
        return False
    for stranger in [one for one in (*parent.children, *found) if one not in children]:
        halt(stranger)
    parent.children = children
    if isinstance(parent, Decorator):
        parent.decorated = children[0]
    children.lock.refuse(parent)
    return True


def is_trusted(behaviour: Behaviour) -> bool:
    """Tell whether a behaviour needs no guard, which costs a little of each tick."""
    kind = type(behaviour)
    if kind in _TRUSTED:
        return True
    return any(
        isinstance(behaviour, careful) and kind.tick is careful.tick and kind.stop is careful.stop
        for careful in _CAREFUL
    )


class _EndedBadly(Exception):
    """A behaviour raised when it was stopped after success or failure; it has been dealt with."""


def guard(behaviour: Behaviour) -> Callable[[], None]:
    """Turn what a behaviour raises into its FAILURE, with the text as feedback, and stop what runs below it.

    What it raises on being interrupted is its feedback only; the interruption goes on.

    Returns:
        What takes the guard away again.
    """
    own = {name: method for name, method in vars(behaviour).items() if name in ("tick", "stop")}
    tick, stop = behaviour.tick, behaviour.stop

    def guarded_tick() -> Iterator[Behaviour]:
        try:
            yield from tick()
        except Exception as error:
            _fail(behaviour, stop, error)
            yield behaviour

    def guarded_stop(new_status: Status = Status.INVALID) -> None:
        try:
            stop(new_status)
        except Exception as error:
            for child in behaviour.children:
                halt(child)
            behaviour.feedback_message = f"{told(error)} (at the end)"
            behaviour.status = Status.INVALID if new_status is Status.INVALID else Status.FAILURE
            if new_status is not Status.INVALID:
                raise _EndedBadly from error

    def release() -> None:
        if behaviour.__dict__.get("tick") is guarded_tick:  # else another tree has taken the behaviour over
            del behaviour.__dict__["tick"], behaviour.__dict__["stop"]
            behaviour.__dict__.update(own)

    behaviour.__dict__.update(tick=guarded_tick, stop=guarded_stop)
    return release


def _fail(behaviour: Behaviour, stop: Callable[[Status], None], error: Exception) -> None:
    if not isinstance(error, _EndedBadly):
        behaviour.feedback_message = told(error)
        for child in behaviour.children:
            halt(child)
        try:
            stop(Status.FAILURE)
        except Exception as another:
            behaviour.feedback_message += f"; then {told(another)} (at the end)"
    behaviour.status = Status.FAILURE
