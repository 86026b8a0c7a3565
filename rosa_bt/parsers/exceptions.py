"""What can be wrong with a tree in XML; each message begins with the file and the line."""

from collections.abc import Iterable
from difflib import get_close_matches

from rosa_bt.exceptions import RosaBtError

__all__ = ["ExportError", "RegistryError", "XmlError", "hint"]


class XmlError(RosaBtError, ValueError):
    """A tree in XML cannot be read, or not be made.

    Args:
        where: file and line.
        problem: what is wrong, and what to do.
    """

    def __init__(self, where: str, problem: str) -> None:
        super().__init__(f"{where}: {problem}")


class RegistryError(RosaBtError, ValueError):
    """A behaviour cannot be registered like that."""


class ExportError(RosaBtError, ValueError):
    """A behaviour has no exact counterpart in BehaviorTree.CPP."""


def hint(name: str, known: Iterable[str], what: str) -> str:
    """Return the end of a message about an unknown name: what is near it, and what there is."""
    names = sorted(known)
    if not names:
        return f"there are no {what}"
    near = get_close_matches(name, names, n=3)
    shown = ", ".join(names[:20]) + (", ..." if len(names) > 20 else "")
    guess = f"did you mean {' or '.join(repr(one) for one in near)}? " if near else ""
    return f"{guess}{what}: {shown}"
