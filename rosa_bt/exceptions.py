"""The errors of this package, and how an exception of a behaviour is reported."""

import logging
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from sys import stdlib_module_names
from traceback import walk_tb
from typing import Protocol
from weakref import ReferenceType, WeakKeyDictionary, WeakSet, ref

from py_trees.behaviour import Behaviour

_log = logging.getLogger(__name__)
_OURS = ("kb", "rosa_bt", "rosa_pddl", "missions", "py_trees")


class RosaBtError(Exception):
    """Base of every error that this package raises on purpose."""


class TreeChangeError(RosaBtError):
    """A tree cannot be changed in this way, or cannot be run in this way."""


class ClockError(RosaBtError, ValueError):
    """A clock was set back, and the runner is to refuse that."""


class TraceError(RosaBtError):
    """A file is not a trace, or a trace cannot be replayed."""


class XmlError(RosaBtError, ValueError):
    """A tree in XML cannot be read, or cannot be built; the message begins with file and line."""

    def __init__(self, where: str, problem: str) -> None:
        super().__init__(f"{where}: {problem}")


class RegistryError(RosaBtError, ValueError):
    """A behaviour cannot be registered in this way."""


class ExportError(RosaBtError, ValueError):
    """A behaviour has no exact counterpart in BehaviorTree.CPP."""


def hint(name: str, names: Iterable[str], what: str) -> str:
    """Return the end of a message about an unknown name: similar names, and those that exist."""
    existing = sorted(names)
    if not existing:
        return f"there are no {what}"
    similar = get_close_matches(name, existing, n=3)
    shown = ", ".join(existing[:20]) + (", ..." if len(existing) > 20 else "")
    guess = f"did you mean {' or '.join(map(repr, similar))}? " if similar else ""
    return f"{guess}{what}: {shown}"


def in_words(error: Exception) -> str:
    """Return an exception as text, with the last line of the user's code in its traceback."""
    return f"{type(error).__name__}: {error}{line_in_words(error)}"


def line_in_words(error: Exception, *ours: str) -> str:
    """Return the last line of the user's code in a traceback, e.g. `; tree.py, line 3`."""
    own = (*_OURS, *ours, *stdlib_module_names)
    place = ""
    for frame, line in walk_tb(error.__traceback__):
        module = str(frame.f_globals.get("__name__"))
        if module.split(".")[0] not in own:
            place = f"; {Path(frame.f_code.co_filename).name}, line {line}"
    return place


_logged: WeakSet[Behaviour] = WeakSet()
_listeners: WeakKeyDictionary[Behaviour, ReferenceType["ErrorListener"]] = WeakKeyDictionary()


class ErrorListener(Protocol):
    """Hears of the exceptions that the behaviours of a tree raise."""

    def note_error(self, behaviour: Behaviour, error: Exception) -> None: ...


def on_error(root: Behaviour, listener: ErrorListener) -> None:
    """Call `note_error` with every exception that a behaviour of this tree raises."""
    _listeners[root] = ref(listener)


def path_of(behaviour: Behaviour) -> list[Behaviour]:
    """Return a behaviour and those above it, up to the root."""
    path = [behaviour]
    while path[-1].parent is not None:
        path.append(path[-1].parent)
    return path


def report(behaviour: Behaviour, error: Exception, note: str = "") -> None:
    """Make an exception the feedback of its behaviour, and tell the tree.

    Log the first traceback.
    """
    behaviour.feedback_message = in_words(error) + note
    if behaviour not in _logged:
        _logged.add(behaviour)
        kind = type(behaviour).__name__
        _log.error("%s %r: %s", kind, behaviour.name, behaviour.feedback_message, exc_info=error)
    reference = _listeners.get(path_of(behaviour)[-1])
    listener = None if reference is None else reference()
    if listener is not None:
        listener.note_error(behaviour, error)
