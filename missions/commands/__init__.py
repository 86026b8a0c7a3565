"""The sub-commands of `rosa`, a file each; what a command works with is imported when it is called."""

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["FAILED", "MISSION", "WRONG_USE", "complain", "open_console"]

FAILED: Final = 1
"""Exit status if it was done, but did not do what it was for."""
WRONG_USE: Final = 2
"""Exit status if it cannot be done as it was asked for."""
MISSION: Final = "A name that `rosa list` shows, or module:NAME of your own."


def open_console() -> "Console":
    """Return the console for results; in a pipe or a file, which has no width, a line is as long as what it says."""
    from rich.console import Console

    console = Console(emoji=False)
    console.soft_wrap = not console.is_terminal
    return console


def complain(text: str) -> None:
    from rich.console import Console
    from rich.markup import escape

    console = Console(stderr=True, soft_wrap=True, emoji=False)
    console.print(f"[bold red]rosa:[/] {escape(text)}", highlight=False)
