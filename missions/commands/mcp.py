"""`rosa mcp`: lets an assistant ask a robot's knowledge base."""

import time
from contextlib import ExitStack
from pathlib import Path
from threading import Event, Thread
from typing import Annotated, Final

import typer

from kb import ConfigurationManager, KnowledgeBase
from missions.commands import ROBOT
from missions.engine.registry import find_robot
from missions.wires.assistant import Assistant, mcp_server, serve_http
from missions.wires.bridge import Bridge, BridgeSettings
from missions.wires.rosbridge import Rosbridge

_TURN_S: Final = 0.05


def mcp(
    robot: Annotated[str, typer.Argument(help=ROBOT)],
    store: Annotated[Path | None, typer.Option(help="What became known, in this file.")] = None,
    config: Annotated[Path | None, typer.Option(help="bridge.toml of the robot to connect to.")] = None,
    allow_actions: Annotated[bool, typer.Option("--allow-actions", help="Actions may be requested, too.")] = False,
    http: Annotated[int | None, typer.Option(metavar="PORT", help="Serve over HTTP with a token, not stdio.")] = None,
    token: Annotated[str, typer.Option(envvar="ROSA_TOKEN", help="Which a client over HTTP has to give.")] = "",
) -> None:
    """Serve the questions of a robot's knowledge base to assistants (Model Context Protocol), over stdio."""
    model, mission = find_robot(robot)
    with ExitStack() as stack:
        kb = KnowledgeBase(model, store=store, clock=time.time)
        stack.callback(kb.close)
        if config is not None:
            _connect(kb, config, token, stack)
        server = mcp_server(Assistant(kb, mission), allow_actions=allow_actions)
        if http is None:
            server.run("stdio")
        else:
            serve_http(server, http, token)


def _connect(kb: KnowledgeBase, config: Path, token: str, stack: ExitStack) -> None:
    """Connect the knowledge base with its robot, and manage its components in a thread."""
    settings, over = BridgeSettings.load(config), Event()
    bridge = Bridge(kb, Rosbridge(settings.url, token), settings)
    stack.callback(bridge.close)
    manager = ConfigurationManager(kb, bridge.managed)

    def manage() -> None:
        while not over.wait(_TURN_S):
            if bridge.is_connected:
                manager.update()

    thread = Thread(target=manage, name="manager", daemon=True)
    thread.start()
    stack.callback(thread.join)
    stack.callback(over.set)
