"""`rosa bridge` and `rosa mcp`: a knowledge base with a robot in ROS 2 or an assistant."""

import logging
import math
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from functools import partial
from threading import Event as Flag
from threading import Thread
from typing import Annotated, Final

from py_trees.behaviour import Behaviour
from py_trees.behaviours import Running
from typer import Argument, Option

from kb import ConfigurationManager, Event, EventKind, KnowledgeBase, Model
from missions.commands import (
    ROBOT,
    File,
    Store,
    Text,
    Token,
    print_lines,
    tree_builder,
)
from missions.engine.mission import MissionError, Percepts, built, find_robot
from missions.wires.assistant import Assistant, mcp_server
from missions.wires.bridge import Bridge, BridgeSettings, SimulatedClock
from missions.wires.node import Node
from missions.wires.rclpy import RclpyNode
from missions.wires.rosbridge import Rosbridge
from rosa_bt import TreeRunner

_TICK_S: Final = 0.1
_HALT_S: Final = 10.0


def bridge(
    robot: Annotated[str, Argument(help=ROBOT)],
    tree: Annotated[
        Text, Option(help="What decides: module:NAME, called with kb and percepts.")
    ] = None,
    config: Annotated[File, Option(help="bridge.toml: which topics and nodes are what.")] = None,
    url: Annotated[Text, Option(help="The robot's rosbridge: ws://127.0.0.1:9090.")] = None,
    rclpy: Annotated[bool, Option("--rclpy", help="By rclpy, where ROS 2 is installed.")] = False,
    token: Token = "",
    answer: Annotated[
        bool, Option("--answer", help="Leave deciding to others, by ROSA's services.")
    ] = False,
    store: Store = None,
    seconds: Annotated[
        float | None, Option(help="Stop after this time; default: when interrupted.")
    ] = None,
) -> None:
    """Manage a robot in ROS 2: hear its diagnostics, switch its nodes, run its tree."""
    settings = _settings(config)
    settings = replace(settings, url=url or settings.url)
    model, mission = find_robot(robot)
    build: Callable[..., object] | None = mission.tree if mission else None
    if tree:
        build = tree_builder(tree)
    if build is None and not answer:
        raise MissionError(
            f"what decides for {model.name}? "
            "give --tree module:NAME, or --answer to leave it to others"
        )
    percepts = Percepts()
    logging.getLogger("missions.wires.node").setLevel(logging.WARNING)  # what is refused
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        node: Node = RclpyNode() if rclpy else Rosbridge(settings.url, token)
        with _connected(node, model, settings, store, percepts) as (kb, connected):
            kb.subscribe(_print_event)
            node.watch(lambda _, text: print_lines([text]))
            manager = ConfigurationManager(kb, connected.managed)
            root: Behaviour = Running("others decide")
            if build is not None and not answer:
                title = f"the tree of {tree or robot}"
                root = built(title, Behaviour, partial(build, kb, percepts))  # type: ignore[type-abstract]  # only asked about
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
                print_lines(["stopped by hand"])
            finally:
                _halt(runner)
    finally:
        signal.signal(signal.SIGTERM, before)


def _print_event(event: Event) -> None:
    if event.kind is not EventKind.RECORD and (event.verb != "measure" or event.changes):
        print_lines([event.text])


def _halt(runner: TreeRunner) -> None:
    """Interrupt the tree, let its actions halt, e.g. cancel their goals, and shut it down."""
    runner.stop()
    end = time.monotonic() + _HALT_S
    while runner.is_halting and time.monotonic() < end:
        runner.update()
        time.sleep(_TICK_S / 2)
    runner.shutdown()


def _settings(config: File) -> BridgeSettings:
    return BridgeSettings.load(config) if config else BridgeSettings()


@contextmanager
def _connected(
    node: Node,
    model: Model,
    settings: BridgeSettings,
    store: File,
    percepts: Percepts | None = None,
) -> Iterator[tuple[KnowledgeBase, Bridge]]:
    """Yield a knowledge base connected to its robot, and the bridge."""
    with closing(node):
        clock = SimulatedClock(node) if settings.use_sim_time else None
        with (
            closing(KnowledgeBase(model, store=store, clock=clock or time.time)) as kb,
            closing(Bridge(kb, node, settings, percepts, clock)) as connected,
        ):
            yield kb, connected


def mcp(
    robot: Annotated[str, Argument(help=ROBOT)],
    store: Store = None,
    config: Annotated[File, Option(help="bridge.toml of the robot to connect to.")] = None,
    token: Token = "",
    allow_actions: Annotated[
        bool, Option("--allow-actions", help="Actions may be requested, too.")
    ] = False,
) -> None:
    """Serve the questions of a robot's knowledge base to assistants over stdio."""
    model, mission = find_robot(robot)
    with ExitStack() as stack:
        if config is None:
            kb = stack.enter_context(closing(KnowledgeBase(model, store=store, clock=time.time)))
        else:
            settings = _settings(config)
            node = Rosbridge(settings.url, token)
            kb, connected = stack.enter_context(_connected(node, model, settings, store))
            stack.enter_context(_managed(kb, connected))
        mcp_server(Assistant(kb, mission), allow_actions=allow_actions).run("stdio")


@contextmanager
def _managed(kb: KnowledgeBase, bridge: Bridge) -> Iterator[None]:
    """Manage the robot's components in a thread."""
    over = Flag()
    manager = ConfigurationManager(kb, bridge.managed)

    def manage() -> None:
        while not over.wait(_TICK_S / 2):
            if bridge.is_connected:
                manager.update()

    thread = Thread(target=manage, name="manager", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
