"""`rosa watch`: a live view in a terminal."""

from typing import Annotated

import typer

from missions.views.terminal import SocketFeed, TerminalView


def watch(
    address: Annotated[str, typer.Argument(metavar="HOST:PORT", help="Of `rosa run --live`, or the link it printed.")],
    token: Annotated[str, typer.Option(envvar="ROSA_TOKEN", help="Of the live view, if it asks for one.")] = "",
) -> None:
    """Watch a robot in the terminal: tree, statuses, adaptations with reasons, measurements."""
    TerminalView(SocketFeed(address, token)).run()
