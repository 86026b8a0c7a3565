"""The robot's nodes as a managed system, watched so that one that dies or restarts is noticed.

The settings say what of a robot is what of a model, in Python or in `bridge.toml`.
"""

import logging
import math
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from kb import ComponentKind, KnowledgeBase
from kb.elements import Parameters
from kb.managed_system import Operation
from kb.processes import ProcessComponents, ros_node_programs
from missions.engine.settings import MissionError, from_table, read_toml
from missions.wires.node import (
    TIMEOUT_S,
    Disconnected,
    Message,
    Node,
    Reply,
    RosError,
    Unanswered,
)
from missions.wires.services import parameter_messages

_UNCONFIGURED, _INACTIVE, _ACTIVE = 1, 2, 3
"""States of lifecycle_msgs/State that a transition leaves; the others do not wait for one."""
_CONFIGURE, _ACTIVATE, _DEACTIVATE = 1, 3, 4
"""Transitions of lifecycle_msgs/Transition."""
Calls = Generator[Reply, Message, None]
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class BridgeSettings:
    """Which topics and nodes of a robot are which attributes and components, as in `bridge.toml`.

    Attributes:
        url: of the robot's rosbridge, e.g. "ws://127.0.0.1:9090".
        attributes: for each name the field that measures it, "/topic.field" (more dots lead to
            deeper fields and array elements), and after a space the type, e.g.
            "/battery_state.percentage sensor_msgs/msg/BatteryState".
        components: for each name its node, e.g. "/camera"; a lifecycle component that is not named
            here is the node with its own name.
        diagnostics: what the statuses of a name mean, by pattern; see `kb.DiagnosticRules`.
        timeout_s: how long a call of a node may take [s].
        timeouts: the same for single components, by name [s].
        poll_s: the period at which each node is asked for its state [s].
        notice_s: after which a node that does not answer has failed [s].
        restarted: "recover" if a node that was restarted is used again, "fail" if it stays failed.
        use_sim_time: run by `/clock`, as the nodes do that have this parameter.
    """

    url: str = "ws://127.0.0.1:9090"
    attributes: Mapping[str, str] = field(default_factory=dict)
    components: Mapping[str, str] = field(default_factory=dict)
    diagnostics: Mapping[str, Any] = field(default_factory=dict)
    timeout_s: float = TIMEOUT_S
    timeouts: Mapping[str, float] = field(default_factory=dict)
    poll_s: float = 1.0
    notice_s: float = 3.0
    restarted: str = "recover"
    use_sim_time: bool = False

    def __post_init__(self) -> None:
        if self.restarted not in ("recover", "fail"):
            raise MissionError(f"restarted is recover or fail, not {self.restarted!r}")
        for seconds in (self.timeout_s, self.poll_s, self.notice_s, *self.timeouts.values()):
            if not 0 < seconds < math.inf:
                raise MissionError(f"a time of the bridge is more than 0 s, not {seconds!r}")

    @classmethod
    def load(cls, path: str | Path) -> "BridgeSettings":
        """Read `bridge.toml`.

        Raises:
            MissionError: it cannot be read, or a field is unknown or of the wrong type.
        """
        return from_table(cls, read_toml(Path(path)), str(path))


@dataclass(eq=False)
class _Watch:
    """A lifecycle node, and what is known of it.

    Attributes:
        timeout_s: how long a call may take [s].
        state: the last known one; None if there is none.
        alive_s: when it was last asked with success [s]; infinity before.
        poll: the open call for its state, one at a time.
        commands: the commands under way, during which it is not polled.
        is_published: whether somebody publishes its transitions.
        is_changing: whether one was published since it was asked.
    """

    place: str
    timeout_s: float
    state: int | None = None
    alive_s: float = math.inf
    asked_s: float = -math.inf
    poll: Reply | None = None
    commands: set[Future[None]] = field(default_factory=set)
    is_published: bool = False
    is_changing: bool = False
    is_lost: bool = False


class RosComponents:
    """The nodes of a robot.

    Lifecycle nodes are switched by change_state. One that is killed says nothing, and one that is
    restarted is unconfigured and says nothing either; so each is asked for its state, one call at a
    time, and silence counts. Plain nodes, components with a package and an executable, are started
    and stopped as processes by `ros2 run`. Parameters of both are set by set_parameters_atomically.

    Args:
        settings: name the nodes by component, and say how long things may take.
        on_observe: called at each update of the manager.
    """

    def __init__(
        self,
        kb: KnowledgeBase,
        node: Node,
        settings: BridgeSettings,
        on_observe: Callable[[], object] = lambda: None,
    ) -> None:
        self._kb = kb
        self._on_observe = on_observe
        self._node = node
        self._settings = settings
        for name in (*settings.components, *settings.timeouts):
            _ = kb.components[name]
        self._programs = ros_node_programs(kb.components.values())
        self._processes = ProcessComponents(
            {
                name: replace(program, configure=partial(self._configure, name))
                for name, program in self._programs.items()
            }
        )
        self._watches: dict[str, _Watch] = {}
        for name, view in kb.components.items():
            is_lifecycle = view.kind is ComponentKind.LIFECYCLE or name in settings.components
            if is_lifecycle and name not in self._programs:
                watch = self._watches[name] = _Watch(*self._address(name))
                topic = f"{watch.place}/transition_event"
                node.subscribe(
                    topic, "lifecycle_msgs/msg/TransitionEvent", partial(self._ask, name)
                )

    def close(self) -> None:
        """End the nodes that were started as processes."""
        self._processes.close()

    # ---------------------------------------------------------------- the managed system

    def activate(self, component: str, /) -> Operation | None:
        if component in self._programs:
            self._processes.activate(component)
            return None
        return self._follow(component, self._switch(component, _ACTIVE))

    def deactivate(self, component: str, /) -> Operation | None:
        if component in self._programs:
            return self._processes.deactivate(component)
        return self._follow(component, self._switch(component, _INACTIVE))

    def set_parameters(self, component: str, parameters: Parameters, /) -> Operation | None:
        if component in self._programs:
            return self._processes.set_parameters(component, parameters)
        return self._configure(component, parameters)

    def is_active(self, component: str, /) -> bool | None:
        """Return whether a node is active, as last known; None if nothing is known."""
        if component in self._programs:
            return self._processes.is_active(component)
        watch = self._watches.get(component)
        if watch is None or (watch.state is None and not watch.is_lost):
            return None
        return watch.state == _ACTIVE

    # ---------------------------------------------------------------- watching

    def forget(self) -> None:
        """Forget all states, as the connection is lost; nodes that are gone have failed."""
        for component, watch in self._watches.items():
            if watch.is_published and self._publishers(watch) == 0:
                self._lose(component, watch, f"{watch.place} is gone")
            fresh = _Watch(watch.place, watch.timeout_s, is_lost=watch.is_lost)
            self._watches[component] = fresh

    def observe(self, kb: KnowledgeBase) -> None:
        """Take in the nodes' answers, and ask those whose turn it is; the manager calls this."""
        self._node.update()
        self._on_observe()
        self._processes.observe(kb)
        if not self._node.is_connected:
            return
        now = self._node.clock()
        for component, watch in self._watches.items():
            watch.alive_s = min(watch.alive_s, now)
            count = self._publishers(watch)
            if watch.is_published and count == 0:
                self._lose(component, watch, f"{watch.place} is gone")
            watch.is_published = bool(count)
            if watch.commands:
                continue
            if watch.poll is not None and watch.poll.done():
                self._take(component, watch, watch.poll)
                watch.poll = None
            is_due = watch.is_changing or now >= watch.asked_s + self._settings.poll_s
            if watch.poll is None and is_due:
                watch.is_changing = False
                watch.asked_s = now
                watch.poll = self._state_call(watch)

    def _publishers(self, watch: _Watch) -> int | None:
        return self._node.publishers(f"{watch.place}/transition_event")

    def _ask(self, component: str, _: Message) -> None:
        """Ask for the state at once, as a transition is going on; its events may come late."""
        self._watches[component].is_changing = True

    def _state_call(self, watch: _Watch) -> Reply:
        """Ask a node for its state; it is overdue when the node has been silent for too long."""
        left_s = watch.alive_s + self._settings.notice_s - self._node.clock()
        timeout_s = self._settings.notice_s if watch.is_lost else max(left_s, self._settings.poll_s)
        kind = "lifecycle_msgs/srv/GetState"
        return self._node.call(f"{watch.place}/get_state", kind, {}, timeout_s)

    def _take(self, component: str, watch: _Watch, poll: Reply) -> None:
        if isinstance(poll.exception(), Disconnected):
            return
        try:
            state = poll.result()["current_state"]["id"]
        except (RosError, KeyError) as error:
            self._lose(component, watch, f"{watch.place} gives no state: {error}")
            return
        was_active = watch.state == _ACTIVE
        watch.state = state
        watch.alive_s = watch.asked_s
        if watch.is_lost:
            watch.is_lost = False
            if self._settings.restarted == "recover":
                self._kb.component_recovered(component)
        elif was_active and state == _UNCONFIGURED:
            reason = f"{watch.place} was restarted, it is unconfigured"
            self._kb.component_active(component, False, reason)
            if self._settings.restarted == "fail":
                self._kb.component_failed(component, reason)

    def _lose(self, component: str, watch: _Watch, reason: str) -> None:
        if watch.is_lost:
            return
        _log.warning("%s has failed: %s", component, reason)
        watch.is_lost = True
        watch.state = None
        watch.poll = None  # its answer may be older
        self._kb.component_active(component, False, reason)
        self._kb.component_failed(component, reason)

    # ---------------------------------------------------------------- commands

    def _switch(self, component: str, goal: int) -> Calls:
        """Send the transitions to a state; one that is not allowed may end a node."""
        watch = self._watches[component]
        asked_s = self._node.clock()
        try:
            answer = yield self._state_call(watch)
        except Unanswered as error:
            self._lose(component, watch, str(error))
            raise
        state = watch.state = answer["current_state"]["id"]
        watch.alive_s = asked_s
        if state not in (_UNCONFIGURED, _INACTIVE, _ACTIVE):
            raise RosError(f"{watch.place} is in state {state}, which no transition leaves now")
        if state == goal or (state == _UNCONFIGURED and goal == _INACTIVE):
            return
        if state == _UNCONFIGURED:
            yield from self._change(watch, _CONFIGURE, _INACTIVE)
        yield from self._change(watch, _ACTIVATE if goal == _ACTIVE else _DEACTIVATE, goal)

    def _change(self, watch: _Watch, transition: int, goal: int) -> Calls:
        service = f"{watch.place}/change_state"
        kind = "lifecycle_msgs/srv/ChangeState"
        request = {"transition": {"id": transition, "label": ""}}
        answer = yield self._node.call(service, kind, request, watch.timeout_s)
        if not answer["success"]:
            raise RosError(f"{watch.place} refuses the transition {transition} from {watch.state}")
        watch.state = goal

    def _configure(self, component: str, parameters: Parameters) -> "Future[None]":
        return self._follow(component, self._set(component, parameters))

    def _set(self, component: str, parameters: Parameters) -> Calls:
        place, timeout_s = self._address(component)
        service = f"{place}/set_parameters_atomically"
        kind = "rcl_interfaces/srv/SetParametersAtomically"
        request = {"parameters": parameter_messages(parameters)}
        answer = yield self._node.call(service, kind, request, timeout_s)
        result = answer["result"]
        if not result["successful"]:
            raise RosError(f"{place} refuses the parameters: {result['reason']}")

    def _address(self, component: str) -> tuple[str, float]:
        """Return the name of a component's node, and how long a call of it may take [s]."""
        place = self._settings.components.get(component, component).strip("/")
        timeout_s = self._settings.timeouts.get(component, self._settings.timeout_s)
        return f"/{place}", timeout_s

    def _follow(self, component: str, calls: Calls) -> "Future[None]":
        """Make calls one after the other, each when the last is answered; cancelling stops them."""
        command: Future[None] = Future()

        def advance(answered: Reply | None = None) -> None:
            if command.cancelled():
                return
            try:
                if answered is None:
                    call = next(calls)
                elif (error := answered.exception()) is not None:
                    call = calls.throw(error)
                else:
                    call = calls.send(answered.result())
            except StopIteration:
                command.set_result(None)
            except Exception as error:  # the command ends with this error
                command.set_exception(error)
            else:
                call.add_done_callback(advance)

        watch = self._watches.get(component)
        if watch is None and component not in self._programs:
            names = ", ".join([*self._watches, *self._programs]) or "none"
            raise RosError(
                f"there is no node for {component!r}, only for {names}"
                ": name its node under components"
            )
        if watch is not None:
            if watch.is_lost:
                raise RosError(f"{watch.place} does not answer")
            watch.poll = None  # its answer may be older than what the command does
            watch.commands.add(command)
            command.add_done_callback(watch.commands.discard)
        advance()
        return command
