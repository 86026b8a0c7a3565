"""The sub-commands of `rosa`, imported when they are called: what they share, and `rosa list` and `rosa settings`."""

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Annotated, Final

import typer

from missions import SUMMARIES

if TYPE_CHECKING:
    from rich.console import Console

FAILED: Final = 1
"""Exit status: it was done, but without success."""
WRONG_USE: Final = 2
"""Exit status: it cannot be done as asked."""
UNFINISHED: Final = 3
"""Exit status: nothing was found wrong, but not everything was checked."""
ROBOT: Final = "A mission, a model file (.tql, .owl), or module:NAME that makes a model."
MISSION: Final = "A name that `rosa list` shows, or module:NAME of your own."


def open_console() -> "Console":
    """Return the console for results; in a pipe or a file, lines are not wrapped."""
    from rich.console import Console

    console = Console(emoji=False, highlight=False)
    console.soft_wrap = not console.is_terminal
    return console


def assignments(texts: Iterable[str], option: str, form: str = "NAME=VALUE") -> dict[str, str]:
    """Read the values of an option such as `--set NAME=VALUE`, by name; MissionError if one has another form."""
    from missions.engine.mission import MissionError

    values = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise MissionError(f"{option} takes {form}, not {text!r}")
        values[name.strip()] = value.strip()
    return values


def tree_builder(reference: str) -> Callable[..., object]:
    """Import a function given as module:callable; MissionError if that fails, or it is no function."""
    from missions.engine.mission import MissionError, load

    found: object = load("tree", reference, {}, "none by name, a tree is given as module:callable")
    if not callable(found):
        raise MissionError(
            f"{reference!r} is a {type(found).__name__}, not a function that builds a tree"
        )
    return found


def complain(text: str) -> None:
    from rich.console import Console
    from rich.markup import escape

    console = Console(stderr=True, soft_wrap=True, emoji=False, highlight=False)
    console.print(f"[bold red]rosa:[/] {escape(text)}")


def list_missions() -> None:
    """List the missions."""
    wide = max(map(len, SUMMARIES)) + 2
    for name, summary in SUMMARIES.items():
        typer.echo(f"{name:<{wide}}{summary}")


def list_settings(
    mission: Annotated[str, typer.Argument(help=MISSION)],
    manager: Annotated[
        str, typer.Option(help="List what is to be set of this manager, too.")
    ] = "ours",
) -> None:
    """List what `rosa run MISSION --set NAME=VALUE` takes, with default, unit, what is allowed, and source."""
    from missions.engine.managers import options_of
    from missions.engine.mission import find_mission, settings_of

    found, console = find_mission(mission), open_console()
    for setting in (*options_of(manager, found), *settings_of(found)):
        default = found.fixed.get(setting.name, setting.default)
        shown = f"{default:g}" if isinstance(default, float) else str(default)
        row = f"{setting.name:<32} {shown:>9} {setting.unit:<8} {setting.allowed}"
        console.print(row.rstrip(), style="bold", markup=False)
        console.print(f"    {setting.meaning} [{setting.source}]", style="dim", markup=False)
