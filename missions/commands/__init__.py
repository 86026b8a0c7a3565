"""The sub-commands of `rosa`: what they share, and `rosa list`, `rosa settings`, `rosa store`."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from typer import Argument, Option, Typer, echo

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

File = Path | None
Text = str | None
Texts = list[str] | None
Breakpoints = Annotated[
    Texts,
    Option("--break", metavar="CONDITION", help='Stop at e.g. "inspect_pipeline unfeasible".'),
]
Store = Annotated[File, Option(help="Keep what becomes known in this file.")]
StoreFile = Annotated[Path, Argument(metavar="FILE", help="The store.")]
Token = Annotated[str, Option(envvar="ROSA_TOKEN", help="The token of the connection.")]


def open_console() -> "Console":
    """Return the console for results; in a pipe or a file, lines are not wrapped."""
    from rich.console import Console

    console = Console(emoji=False, highlight=False)
    console.soft_wrap = not console.is_terminal
    return console


def assignments(texts: Texts, option: str) -> dict[str, str]:
    """Read the values of an option such as `--set NAME=VALUE`, by name.

    Raises:
        MissionError: a text has another form.
    """
    from missions.engine.mission import MissionError

    values = {}
    for text in texts or ():
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise MissionError(f"{option} takes NAME=VALUE, not {text!r}")
        values[name.strip()] = value.strip()
    return values


def tree_builder(reference: str) -> Callable[..., object]:
    """Import a function given as module:callable.

    Raises:
        MissionError: it cannot be imported, or it is no function.
    """
    from missions.engine.mission import MissionError, load

    advice = "none by name, a tree is given as module:callable"
    builder: object = load("tree", reference, {}, advice)
    if not callable(builder):
        kind = type(builder).__name__
        raise MissionError(f"{reference!r} is a {kind}, not a function that builds a tree")
    return builder


def complain(text: str) -> None:
    from rich.console import Console
    from rich.markup import escape

    console = Console(stderr=True, soft_wrap=True, emoji=False, highlight=False)
    console.print(f"[bold red]rosa:[/] {escape(text)}")


def print_lines(lines: Iterable[object], style: str = "") -> None:
    console = open_console()
    for line in lines:
        console.print(str(line), style=style, markup=False)


def list_missions() -> None:
    """List the missions."""
    wide = max(map(len, SUMMARIES)) + 2
    for name, summary in SUMMARIES.items():
        echo(f"{name:<{wide}}{summary}")


def list_settings(
    mission: Annotated[str, Argument(help=MISSION)],
    manager: Annotated[str, Option(help="Also list the settings of this manager.")] = "ours",
) -> None:
    """List the settings of a mission: default, unit, what is allowed, meaning and source."""
    from missions.engine.mission import find_mission, settings_of
    from missions.engine.runner import find_manager

    named = find_mission(mission)
    for setting in (*find_manager(manager, named).options, *settings_of(named)):
        default = named.fixed.get(setting.name, setting.default)
        shown = f"{default:g}" if isinstance(default, float) else str(default)
        row = f"{setting.name:<32} {shown:>9} {setting.unit:<8} {setting.allowed}"
        print_lines([row.rstrip()], "bold")
        print_lines([f"    {setting.meaning} [{setting.source}]"], "dim")


store: Final = Typer(
    help="Show or copy the store of a knowledge base.", no_args_is_help=True, add_completion=False
)


@store.command()
def info(file: StoreFile) -> None:
    """Check a store that is not in use, and show what is in it."""
    from kb.store import store_info

    for title, value in store_info(file).items():
        echo(f"{title}: {value}")


@store.command()
def backup(
    file: StoreFile,
    copy: Annotated[Path, Argument(metavar="COPY", help="A file that does not exist yet.")],
) -> None:
    """Copy a store that is not in use."""
    from kb.store import backup_store

    backup_store(file, copy)
    echo(f"{file} is copied to {copy}")
