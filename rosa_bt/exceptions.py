"""The errors of this package, and how messages are made: they say what was given, what exists and what to do."""

from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from sys import stdlib_module_names
from traceback import walk_tb
from typing import Final

_OURS: Final = ("kb", "rosa_bt", "rosa_pddl", "missions", "py_trees")


class RosaBtError(Exception):
    """Base of every error that this package raises on purpose."""


class TreeChangeError(RosaBtError):
    """A tree cannot be changed in this way."""


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


def hint(name: str, known: Iterable[str], what: str) -> str:
    """Return the end of a message about an unknown name: similar names, and the names that exist."""
    names = sorted(known)
    if not names:
        return f"there are no {what}"
    near = get_close_matches(name, names, n=3)
    shown = ", ".join(names[:20]) + (", ..." if len(names) > 20 else "")
    guess = f"did you mean {' or '.join(repr(one) for one in near)}? " if near else ""
    return f"{guess}{what}: {shown}"


def in_words(error: Exception) -> str:
    """Return an exception as text, with the last line of the user's code in its traceback, if there is one."""
    return f"{type(error).__name__}: {error}{line_in_words(error)}"


def line_in_words(error: Exception, *ours: str) -> str:
    """Return the last line of the user's code in a traceback, as `; tree.py, line 3`, or nothing if there is none."""
    own = (*_OURS, *ours, *stdlib_module_names)
    frames = [
        one
        for one in walk_tb(error.__traceback__)
        if str(one[0].f_globals.get("__name__")).split(".")[0] not in own
    ]
    return "".join(
        f"; {Path(one.f_code.co_filename).name}, line {line}" for one, line in frames[-1:]
    )
