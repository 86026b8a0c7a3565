"""The command line: `rosa`, the same as `python -m missions`."""

import sys
from importlib import import_module
from typing import Annotated, Any, Final

import typer
from typer.core import TyperGroup
from typer.main import get_command

from missions.commands import FAILED, WRONG_USE, complain

__all__ = ["app", "main"]

COMMANDS: Final = {
    "new": (
        "new:new",
        "Write a package with model, task logic, world and tests that runs at once.",
    ),
    "list": (":list_missions", "List the missions."),
    "settings": (":list_settings", "List what `rosa run MISSION --set NAME=VALUE` takes."),
    "run": (
        "run:run",
        "Run a mission, say what happened and why, and exit with 0 if it did what it was for.",
    ),
    "bridge": (
        "robots:bridge",
        "Manage a robot in ROS 2: hear its diagnostics, switch its nodes, run its tree.",
    ),
    "mcp": (
        "robots:mcp",
        "Serve the questions of a robot's knowledge base to assistants (Model Context Protocol).",
    ),
    "replay": (
        "recordings:replay",
        "Decide again what was recorded, and exit with 1 if that differs.",
    ),
    "check": ("check:check", "Judge a model, and say what to do about each finding."),
    "plan": (
        "plan:plan",
        "Plan, say why actions are out or why there is no plan, and exit with 0 if there is one.",
    ),
    "verify": (
        "plan:verify",
        "Verify a mission's tree exhaustively, and exit with 0 if all properties hold.",
    ),
    "campaign": ("experiments:campaign", "Run missions with many managers, settings and seeds."),
    "report": (
        "experiments:report",
        "Write the report on a campaign, or show a recording as a page.",
    ),
    "learn": (
        "experiments:learn",
        "Compare a model with runs: rates and durations, each with its interval.",
    ),
    "store": (":store", "Show or copy the store of a knowledge base."),
}
"""The sub-commands: where each is in `missions.commands`, and its help. It is imported only when it
is called."""


class Commands(TyperGroup):
    """The group of sub-commands, which lists them without importing them."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:  # noqa: ANN401  # click is private
        name, _, rest = super().resolve_command(ctx, args)
        module, _, attribute = COMMANDS[str(name)][0].partition(":")
        command = getattr(import_module(f"missions.commands.{module}".rstrip(".")), attribute)
        if isinstance(command, typer.Typer):
            command.rich_markup_mode = None  # as [s] in a help text is a unit
        else:
            group = typer.Typer(add_completion=False, rich_markup_mode=None)
            group.command(name)(command)
            command = group
        return name, get_command(command), rest


app = typer.Typer(
    help="Run missions of robots that adapt what they do and how they are built.",
    cls=Commands,
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
for _name, (_, _help) in COMMANDS.items():
    app.command(_name, help=_help)(lambda: None)


def _say_version(is_asked: bool) -> None:
    if is_asked:
        from importlib.metadata import version

        typer.echo(f"rosa-taca {version('rosa-taca')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_say_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command line; an error of use is shown as one clear message, without a traceback."""
    import logging
    import signal
    from contextlib import suppress
    from pathlib import Path

    sys.path.append(str(Path.cwd()))  # so that module:NAME finds your own missions
    logging.basicConfig(
        level=logging.ERROR, format="rosa: %(message)s"
    )  # the console shows less severe messages
    signal.signal(
        signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM)
    )  # so that drafts of files are removed
    try:
        app()
    except OSError as error:  # standard output is closed, or the disk is full
        with suppress(OSError):
            sys.stdout.close()
        complain(f"cannot print: {error.strerror or error}")
        sys.exit(FAILED)
    except Exception as error:
        from kb import KnowledgeBaseError
        from missions.engine.mission import MissionError
        from rosa_pddl import RosaPddlError

        if not isinstance(error, MissionError | KnowledgeBaseError | RosaPddlError):
            raise  # a bug
        complain(str(error))
        sys.exit(WRONG_USE)
