"""`rosa bridge` and `rosa mcp`: a knowledge base with a robot in ROS 2 or an assistant."""

import logging
import math
import signal
import time
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Event as Flag
from threading import Thread
from typing import Annotated, Final

import typer
from py_trees.behaviour import Behaviour
from py_trees.behaviours import Running

from kb import ConfigurationManager, Event, EventKind, KnowledgeBase, Model
from missions.commands import ROBOT, assignments, open_console, tree_builder
from missions.engine.mission import MissionError, Percepts, built, find_robot
from missions.wires.assistant import Assistant, mcp_server, serve_http
from missions.wires.bridge import Bridge, BridgeSettings, SimulatedClock
from missions.wires.node import Node
from missions.wires.rclpy import RclpyNode
from missions.wires.rosbridge import Rosbridge
from rosa_bt import TreeRunner

_TICK_S: Final = 0.1
_HALT_S: Final = 10.0


def bridge(
    robot: Annotated[str, typer.Argument(help=ROBOT)],
    tree: Annotated[
        str | None, typer.Option(help="What decides: module:NAME, given kb and percepts.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="bridge.toml: what of the robot is what of the model.")
    ] = None,
    url: Annotated[
        str | None, typer.Option(help="The robot's rosbridge, e.g. ws://127.0.0.1:9090.")
    ] = None,
    attribute: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=/TOPIC.FIELD", help="The field that measures an attribute."),
    ] = None,
    rclpy: Annotated[
        bool, typer.Option("--rclpy", help="By rclpy instead, where ROS 2 is installed.")
    ] = False,
    token: Annotated[
        str, typer.Option(envvar="ROSA_TOKEN", help="Given to the robot's rosbridge.")
    ] = "",
    answer: Annotated[
        bool, typer.Option("--answer", help="Leave deciding to others, by ROSA's services.")
    ] = False,
    store: Annotated[
        Path | None, typer.Option(help="Keep what becomes known in this file.")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(help="Stop after this time; without it, when interrupted.")
    ] = None,
) -> None:
    """Manage a robot in ROS 2: hear its diagnostics, switch its nodes, run its tree, answer its ROSA services."""
    settings, (model, mission) = _settings(config, url, attribute or []), find_robot(robot)
    make_tree = tree_builder(tree) if tree else None if mission is None else mission.tree
    if make_tree is None and not answer:
        raise MissionError(
            f"what decides for {model.name}? "
            "give --tree module:NAME, or --answer to leave it to others"
        )
    console, percepts = open_console(), Percepts()
    logging.getLogger("missions.wires.node").setLevel(logging.WARNING)  # what is refused

    def say(event: Event) -> None:
        if event.kind is not EventKind.RECORD and (event.verb != "measure" or event.changes):
            console.print(event.text, markup=False, soft_wrap=True)

    with ExitStack() as stack:
        ended_as_before = signal.signal(signal.SIGTERM, signal.default_int_handler)
        stack.callback(signal.signal, signal.SIGTERM, ended_as_before)
        node: Node = RclpyNode() if rclpy else Rosbridge(settings.url, token)
        kb, connected = _connect(stack, node, model, settings, store, percepts)
        kb.subscribe(say)
        node.watch(lambda _, text: console.print(text, markup=False))
        manager = ConfigurationManager(kb, connected.managed)
        root: Behaviour = Running("others decide")
        if make_tree is not None and not answer:
            make, what = partial(make_tree, kb, percepts), f"the tree of {tree or robot}"
            root = built(what, Behaviour, make)  # type: ignore[type-abstract]  # only asked about
        runner = TreeRunner(root, clock=lambda: kb.now, period=_TICK_S)
        runner.setup()
        end = math.inf if seconds is None else time.monotonic() + seconds
        try:
            while time.monotonic() < end:
                if connected.is_connected:
                    manager.update()
                    runner.update()
                time.sleep(_TICK_S / 2)
        except KeyboardInterrupt:  # also by SIGTERM, as a service manager sends it
            console.print("stopped by hand")
        finally:
            _halt(runner)


def _halt(runner: TreeRunner) -> None:
    """Interrupt the tree, let its actions halt, e.g. cancel their goals, and shut it down."""
    runner.stop()
    end = time.monotonic() + _HALT_S
    while runner.is_halting and time.monotonic() < end:
        runner.update()
        time.sleep(_TICK_S / 2)
    runner.shutdown()


def _settings(config: Path | None, url: str | None, attributes: list[str]) -> BridgeSettings:
    settings = BridgeSettings() if config is None else BridgeSettings.load(config)
    given = assignments(attributes, "--attribute", "NAME=/TOPIC.FIELD")
    return replace(settings, url=url or settings.url, attributes={**settings.attributes, **given})


def _connect(
    stack: ExitStack,
    node: Node,
    model: Model,
    settings: BridgeSettings,
    store: Path | None,
    percepts: Percepts | None = None,
) -> tuple[KnowledgeBase, Bridge]:
    """Return a knowledge base connected to its robot, and the bridge; the stack closes all."""
    stack.callback(node.close)
    clock = SimulatedClock(node) if settings.use_sim_time else None
    kb = KnowledgeBase(model, store=store, clock=clock or time.time)
    stack.callback(kb.close)
    bridge = Bridge(kb, node, settings, percepts, clock)
    stack.callback(bridge.close)
    return kb, bridge


def mcp(
    robot: Annotated[str, typer.Argument(help=ROBOT)],
    store: Annotated[Path | None, typer.Option(help="What became known, in this file.")] = None,
    config: Annotated[
        Path | None, typer.Option(help="bridge.toml of the robot to connect to.")
    ] = None,
    allow_actions: Annotated[
        bool, typer.Option("--allow-actions", help="Actions may be requested, too.")
    ] = False,
    http: Annotated[
        int | None, typer.Option(metavar="PORT", help="Serve over HTTP with a token, not stdio.")
    ] = None,
    token: Annotated[
        str, typer.Option(envvar="ROSA_TOKEN", help="Which a client over HTTP has to give.")
    ] = "",
) -> None:
    """Serve the questions of a robot's knowledge base to assistants (Model Context Protocol), over stdio."""
    model, mission = find_robot(robot)
    with ExitStack() as stack:
        if config is None:
            kb = KnowledgeBase(model, store=store, clock=time.time)
            stack.callback(kb.close)
        else:
            settings = BridgeSettings.load(config)
            node = Rosbridge(settings.url, token)
            kb, bridge = _connect(stack, node, model, settings, store)
            _manage(kb, bridge, stack)
        server = mcp_server(Assistant(kb, mission), allow_actions=allow_actions)
        if http is None:
            server.run("stdio")
        else:
            serve_http(server, http, token)


def _manage(kb: KnowledgeBase, bridge: Bridge, stack: ExitStack) -> None:
    """Manage the robot's components in a thread."""
    over = Flag()
    manager = ConfigurationManager(kb, bridge.managed)

    def manage() -> None:
        while not over.wait(_TICK_S / 2):
            if bridge.is_connected:
                manager.update()

    thread = Thread(target=manage, name="manager", daemon=True)
    thread.start()
    stack.callback(thread.join)
    stack.callback(over.set)
