"""The command line: `rosa`, the same as `python -m missions`."""

import sys
from typing import Annotated

import typer

from missions.commands import (
    FAILED,
    WRONG_USE,
    bridge,
    campaign,
    check,
    complain,
    effort,
    learn,
    listing,
    mcp,
    new,
    plan,
    recordings,
    report,
    run,
    store,
    verify,
    watch,
)

__all__ = ["app", "main"]

app = typer.Typer(
    help="Run missions of robots that adapt what they do and how they are built.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _say_version(is_asked: bool) -> None:
    if is_asked:
        from importlib.metadata import version

        typer.echo(f"rosa-taca {version('rosa-taca')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_say_version, is_eager=True, help="Say which.")
    ] = False,
) -> None:
    pass


app.command("new")(new.new)
app.command("list")(listing.list_missions)
app.command("settings")(listing.list_settings)
app.command("run")(run.run)
app.command("watch")(watch.watch)
app.command("bridge")(bridge.bridge)
app.command("mcp")(mcp.mcp)
app.command("replay")(recordings.replay)
app.add_typer(recordings.record, name="record")
app.command("check")(check.check)
app.command("plan")(plan.plan)
app.command("verify")(verify.verify)
app.command("campaign")(campaign.campaign)
app.command("report")(report.report)
app.command("learn")(learn.learn)
app.command("effort")(effort.effort)
app.add_typer(store.app, name="store")


def main() -> None:
    """Run the command line; what goes wrong is one clear message, never a traceback."""
    import logging
    import signal
    from contextlib import suppress
    from pathlib import Path

    sys.path.append(str(Path.cwd()))  # where a mission of one's own is, given as module:NAME
    logging.basicConfig(level=logging.ERROR, format="rosa: %(message)s")  # the console shows what is less
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # so that no draft of a file stays
    try:
        app()
    except OSError as error:  # standard output is full or gone
        with suppress(OSError):
            sys.stdout.close()
        _exit(FAILED, f"cannot print: {error.strerror or error}")
    except Exception as error:
        if not _is_for_people(error):
            raise
        _exit(WRONG_USE, str(error))


def _is_for_people(error: Exception) -> bool:
    """Whether an error is a clear message, not a mistake of the program."""
    from kb import KnowledgeBaseError
    from missions.engine.mission import MissionError
    from rosa_pddl import RosaPddlError

    return isinstance(error, MissionError | KnowledgeBaseError | RosaPddlError)


def _exit(status: int, text: str) -> None:
    complain(text)
    sys.exit(status)
