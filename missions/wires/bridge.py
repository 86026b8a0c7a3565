"""Connects a robot in ROS 2 with its knowledge base: topics measure attributes, nodes are components.

settings = BridgeSettings(attributes={"battery_level": "/battery_state.percentage"})
bridge = Bridge(kb, Rosbridge("ws://127.0.0.1:9090"), settings)
manager = ConfigurationManager(kb, bridge.managed)
"""

import logging
import tomllib
from collections.abc import Generator, Iterator, Mapping
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Final

from kb import ComponentKind, Event, EventKind, KnowledgeBase, KnowledgeBaseError
from kb.elements import Parameters
from missions.engine.mission import MissionError, Percepts
from missions.wires import ros
from missions.wires.node import Message, Node, Refusals, RosError
from missions.wires.rosa_services import LOG, RosaServices, parameter_messages

_log = logging.getLogger(__name__)
_KINDS: Final = {
    EventKind.MONITORING_DATA: "insert_monitoring_data",
    EventKind.ACTION_UPDATE: "action_update",
    EventKind.RECONFIGURATION_PLAN: "insert_reconfiguration_plan",
}
"""The words by which the original ROSA's planner and executor recognise events."""
_UNCONFIGURED, _INACTIVE, _ACTIVE = 1, 2, 3
"""States of lifecycle_msgs/State."""
_CONFIGURE, _ACTIVATE, _DEACTIVATE = 1, 3, 4
"""Transitions of lifecycle_msgs/Transition."""
Calls = Generator[Future[Message], Message, None]


@dataclass(frozen=True)
class BridgeSettings:
    """Which topics and nodes of a robot are which attributes and components; `bridge.toml` has the same fields.

    Attributes:
        url: of the robot's rosbridge, e.g. "ws://127.0.0.1:9090".
        diagnostics: the topic of diagnostic_msgs/DiagnosticArray; empty for none.
        attributes: for each name the field that measures it, "/topic.field" (more dots lead to deeper fields and array
            elements), and after a space the type, e.g. "/battery_state.percentage sensor_msgs/msg/BatteryState".
        components: for each name its node, e.g. "/camera"; a lifecycle component that is not named here is the node
            with its own name.
    """

    url: str = "ws://127.0.0.1:9090"
    diagnostics: str = "/diagnostics"
    attributes: Mapping[str, str] = field(default_factory=dict)
    components: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def load(cls, path: str | Path) -> "BridgeSettings":
        """Read `bridge.toml`.

        Raises:
            MissionError: it cannot be read, or a field is unknown or of the wrong type.
        """
        try:
            read = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise MissionError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}") from None
        known = {one.name: one for one in fields(cls)}
        for name, value in read.items():
            if name not in known:
                raise MissionError(f"{path} has a field {name!r}; there are {', '.join(known)}")
            wanted = dict if name in ("attributes", "components") else str
            texts = value.values() if isinstance(value, dict) else (value,)
            if not isinstance(value, wanted) or not all(isinstance(one, str) for one in texts):
                raise MissionError(f"{name} in {path} is {'a table of texts' if wanted is dict else 'a text'}")
        return cls(**read)


class Bridge:
    """Connects a knowledge base and a robot, in both directions, until `close`.

    Measurements are told to the knowledge base in the thread of the connection. Events are published on
    `/rosa_kb/events`, decisions with their reasons on `/rosa/log`, and ROSA's services are served. While there is no
    connection, the attributes that are measured over it are stale.

    Args:
        percepts: get the diagnostics too, for the conditions of a mission.

    Attributes:
        managed: the robot's nodes, as the managed system of a `ConfigurationManager`.
        heard: how many messages were used.
        refused: how many were not used, by what was wrong.
        is_connected: whether the robot is connected; while it is not, do not update the manager.

    Raises:
        MissionError, kb.UnknownName: the settings name a place that is malformed, or an element that is unknown.
    """

    def __init__(
        self,
        kb: KnowledgeBase,
        node: Node,
        settings: BridgeSettings | None = None,
        percepts: Percepts | None = None,
    ) -> None:
        self.heard, self.refused, self.is_connected = 0, Refusals(), False
        self._kb, self._node, chosen = kb, node, settings or BridgeSettings()
        self.managed = RosComponents(kb, node, chosen.components)
        self._percepts = percepts
        self._measured = list(chosen.attributes)
        for name, place in chosen.attributes.items():
            _ = kb.attributes[name]
            topic, path, kind = _place(name, place)
            node.subscribe(topic, kind, partial(self._measure, name, path))
        if chosen.diagnostics:
            node.subscribe(chosen.diagnostics, ros.DIAGNOSTICS, self._receive)
        RosaServices(kb, node)
        self._stop = kb.subscribe(self._publish)
        node.watch(self._changed)

    def close(self) -> None:
        """Stop publishing, and close the node."""
        self._stop()
        self._node.close()

    def _measure(self, name: str, path: list[str], message: Message) -> None:
        value: object = message
        try:
            for part in path:
                value = value[int(part)] if isinstance(value, list) else value[part]  # type: ignore[index]  # what cannot be is refused
            self._kb.measure(name, value)  # type: ignore[arg-type]  # it is checked there
            self.heard += 1
        except (LookupError, TypeError, ValueError, KnowledgeBaseError) as error:
            self.refused.add(f"{name}: {type(error).__name__}: {error}")

    def _receive(self, message: Message) -> None:
        problems = self._kb.receive(message)
        self.heard += 1
        if self._percepts is not None:
            self._percepts.receive({"status": list(_statuses(message))})
        for problem in problems:
            self.refused.add(f"{problem.key}: {problem.reason}")  # one kind, whatever the value

    def _publish(self, event: Event) -> None:
        kind = _KINDS.get(event.kind)
        if kind is None:
            return
        self._node.publish("/rosa_kb/events", ros.STRING, {"data": kind})
        if event.kind is not EventKind.MONITORING_DATA or event.changes:
            changes = "".join(f"; {one.name} is {one.new}" for one in event.changes)
            self._node.publish(LOG, ros.LOG, ros.log_of(event, changes))

    def _changed(self, is_connected: bool, text: str) -> None:
        _log.log(logging.INFO if is_connected else logging.WARNING, "%s", text)
        self.is_connected = is_connected
        if is_connected:
            self.managed.ask()
            return
        self.managed.forget()
        for name in self._measured:
            if self._kb.attributes[name].value is not None:
                self._kb.tell(Event(0, self._kb.now, "stale", (name,)))


class RosComponents:
    """Lifecycle nodes as a managed system: change_state switches them, set_parameters_atomically sets parameters.

    Args:
        names: of the nodes, by component; a lifecycle component that is not named is the node with its own name.
    """

    def __init__(self, kb: KnowledgeBase, node: Node, names: Mapping[str, str]) -> None:
        self._node = node
        for name in names:
            _ = kb.components[name]
        own = {name: name for name, one in kb.components.items() if one.kind is ComponentKind.LIFECYCLE}
        self._names = {name: f"/{one.strip('/')}" for name, one in {**own, **names}.items()}
        self._states: dict[str, int] = {}
        for name, place in self._names.items():
            kind = "lifecycle_msgs/msg/TransitionEvent"
            node.subscribe(f"{place}/transition_event", kind, partial(self._changed, name))

    def _changed(self, component: str, message: Message) -> None:
        self._states[component] = int(message["goal_state"]["id"])

    def ask(self) -> None:
        for name in self._names:
            self._follow(self._look(name))

    def forget(self) -> None:
        """Forget the states of all nodes, as the connection is lost."""
        self._states.clear()

    def activate(self, component: str, /) -> "Future[None]":
        return self._follow(self._switch(component, _ACTIVE))

    def deactivate(self, component: str, /) -> "Future[None]":
        return self._follow(self._switch(component, _INACTIVE))

    def set_parameters(self, component: str, parameters: Parameters, /) -> "Future[None]":
        return self._follow(self._set(component, parameters))

    def is_active(self, component: str, /) -> bool | None:
        """Tell whether a node is active after its last known transition; None if none is known."""
        state = self._states.get(component)
        return None if state is None else state == _ACTIVE

    def _look(self, component: str) -> Calls:
        answer = yield self._node.call(f"{self._place(component)}/get_state", "lifecycle_msgs/srv/GetState", {})
        self._states[component] = int(answer["current_state"]["id"])

    def _switch(self, component: str, goal: int) -> Calls:
        yield from self._look(component)
        if self._states[component] == _UNCONFIGURED:
            if goal == _INACTIVE:
                return
            yield from self._change(component, _CONFIGURE, _INACTIVE)
        if self._states[component] != goal:
            yield from self._change(component, _ACTIVATE if goal == _ACTIVE else _DEACTIVATE, goal)

    def _change(self, component: str, transition: int, goal: int) -> Calls:
        request = {"transition": {"id": transition, "label": ""}}
        place = self._place(component)
        answer = yield self._node.call(f"{place}/change_state", "lifecycle_msgs/srv/ChangeState", request)
        if not answer.get("success"):
            raise RosError(f"{place} refuses the transition {transition} from {self._states[component]}")
        self._states[component] = goal

    def _set(self, component: str, parameters: Parameters) -> Calls:
        request = {"parameters": parameter_messages(parameters)}
        kind = "rcl_interfaces/srv/SetParametersAtomically"
        answer = yield self._node.call(f"{self._place(component)}/set_parameters_atomically", kind, request)
        result = answer.get("result") or {}
        if not result.get("successful"):
            reason = result.get("reason") or "without a reason"
            raise RosError(f"{self._place(component)} refuses the parameters: {reason}")

    def _place(self, component: str) -> str:
        if component not in self._names:
            known = ", ".join(self._names) or "none"
            raise RosError(f"no node is {component!r}; nodes are {known}: name it under components")
        return self._names[component]

    def _follow(self, calls: Calls) -> "Future[None]":
        """Make calls one after the other, each when the last is answered, without waiting; cancelling stops them."""
        done: Future[None] = Future()

        def go_on(answered: "Future[Message] | None" = None) -> None:
            if done.cancelled():
                return
            try:
                error = None if answered is None else answered.exception()
                if error is not None:
                    following = calls.throw(error)
                else:
                    following = calls.send(None if answered is None else answered.result())  # type: ignore[arg-type]  # the first is None
            except StopIteration:
                done.set_result(None)
            except Exception as failure:  # the operation ends with this error
                done.set_exception(failure)
            else:
                following.add_done_callback(go_on)

        go_on()
        return done


def _statuses(message: Message) -> Iterator[Message]:
    """Yield the statuses of a DiagnosticArray with their values as a dict; malformed ones are left out."""
    for status in message.get("status") or ():
        with suppress(TypeError, LookupError, AttributeError):
            values = {str(pair["key"]): str(pair["value"]) for pair in status["values"]}
            yield {"message": str(status["message"]), "values": values}


def _place(attribute: str, text: str) -> tuple[str, list[str], str]:
    """Return the topic, the path to the field, and the message type (may be empty), of a text in the settings."""
    where, _, kind = text.strip().partition(" ")
    topic, *path = where.split(".")
    if not topic.startswith("/") or not all(path) or not path:
        raise MissionError(f"{attribute} is measured by {text!r}; write /topic.field, e.g. /battery_state.percentage")
    return topic, path, kind.strip()
