"""The errors of this package, and how an exception of a behaviour is reported."""

import logging
from collections.abc import Iterable
from pathlib import Path
from sys import stdlib_module_names
from traceback import walk_tb
from weakref import WeakKeyDictionary

from py_trees.behaviour import Behaviour

from kb import UnknownName

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
    """Return the end of a message about an unknown name: similar names, or those that exist."""
    return str(UnknownName(what, name, names)).rpartition("; ")[2]


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


_logged: WeakKeyDictionary[Behaviour, set[tuple[str, str, str]]] = WeakKeyDictionary()
_errors: WeakKeyDictionary[Behaviour, list[tuple[Behaviour, Exception]]] = WeakKeyDictionary()


def errors_of(root: Behaviour) -> list[tuple[Behaviour, Exception]]:
    """Return the behaviours of a tree that raised, with their exceptions; its runner empties it."""
    return _errors.setdefault(root, [])


def path_of(behaviour: Behaviour) -> list[Behaviour]:
    """Return a behaviour and those above it, up to the root."""
    path = [behaviour]
    while path[-1].parent is not None:
        path.append(path[-1].parent)
    return path


def report(behaviour: Behaviour, error: Exception, note: str = "") -> None:
    """Make an exception the feedback of its behaviour, and enter it among the errors of the tree.

    Log the traceback the first time that a behaviour of this kind and name raises at this line.
    """
    behaviour.feedback_message = in_words(error) + note
    root = path_of(behaviour)[-1]
    kind = type(behaviour).__name__
    place = kind, behaviour.name, line_in_words(error)
    logged = _logged.setdefault(root, set())
    if place not in logged:  # a plan executor makes a new behaviour for each try of a step
        logged.add(place)
        _log.error("%s %r: %s", kind, behaviour.name, behaviour.feedback_message, exc_info=error)
    if root in _errors:
        _errors[root].append((behaviour, error))
