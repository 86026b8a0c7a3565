"""The sub-commands of `rosa`, a file each; what a command works with is imported when it is called."""

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rich.console import Console

FAILED: Final = 1
"""Exit status if it was done, but did not do what it was for."""
WRONG_USE: Final = 2
"""Exit status if it cannot be done as it was asked for."""
UNFINISHED: Final = 3
"""Exit status if nothing was wrong as far as was looked, which was not everything."""
ROBOT: Final = "A mission, a model file (.tql, .owl), or module:NAME that makes a model."
MISSION: Final = "A name that `rosa list` shows, or module:NAME of your own."


def open_console() -> "Console":
    """Return the console for results; in a pipe or a file, which has no width, a line is as long as what it says."""
    from rich.console import Console

    console = Console(emoji=False, highlight=False)
    console.soft_wrap = not console.is_terminal
    return console


def assignments(texts: Iterable[str], option: str, form: str = "NAME=VALUE") -> dict[str, str]:
    """Return what an option gives by name, several times; MissionError if it is not of that form."""
    from missions.engine.mission import MissionError

    values = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise MissionError(f"{option} takes {form}, not {text!r}")
        values[name.strip()] = value.strip()
    return values


def tree_builder(reference: str) -> Callable[..., object]:
    """Return what is given as module:callable; MissionError if it cannot be imported or called."""
    from missions.engine.mission import MissionError
    from missions.engine.registry import load

    found: object = load("tree", reference, {}, "none by name, a tree is given as module:callable")
    if not callable(found):
        raise MissionError(f"{reference!r} is a {type(found).__name__}, not a function that builds a tree")
    return found


def complain(text: str) -> None:
    from rich.console import Console
    from rich.markup import escape

    console = Console(stderr=True, soft_wrap=True, emoji=False, highlight=False)
    console.print(f"[bold red]rosa:[/] {escape(text)}")
