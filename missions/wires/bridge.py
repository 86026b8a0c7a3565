"""Connects a robot in ROS 2: topics measure attributes, nodes are components.

settings = BridgeSettings(attributes={"battery_level": "/battery_state.percentage"})
bridge = Bridge(kb, Rosbridge("ws://127.0.0.1:9090"), settings)
manager = ConfigurationManager(kb, bridge.managed)
"""

import logging
import math
from functools import partial
from typing import Any, Final

from kb import DiagnosticRules, Event, EventKind, KnowledgeBase
from kb.views import AttributeView
from missions.engine.mission import MissionError, Percepts
from missions.wires import ros
from missions.wires.actions import connect
from missions.wires.components import BridgeSettings, RosComponents
from missions.wires.node import Message, Node
from missions.wires.services import LOG, RosaServices

__all__ = ["Bridge", "BridgeSettings", "SimulatedClock"]

_log = logging.getLogger(__name__)
_WORDS: Final = {
    EventKind.MONITORING_DATA: "insert_monitoring_data",
    EventKind.ACTION_UPDATE: "action_update",
    EventKind.RECONFIGURATION_PLAN: "insert_reconfiguration_plan",
}
"""The words by which the original ROSA's planner and executor recognise events."""
_REPORT_S: Final = 60.0
"""The period at which it is reported which diagnostics are not understood [s]."""
_NAMES: Final = 5
"""How many of their names are reported."""


class SimulatedClock:
    """The time of `/clock` [s]; it never goes back, also when the simulation is begun again.

    Attributes:
        now_s: the time as it was published last.
        has_begun: whether a time was heard.
    """

    def __init__(self, node: Node) -> None:
        self.now_s = 0.0
        self.has_begun = False
        self._offset_s = 0.0
        node.subscribe("/clock", "rosgraph_msgs/msg/Clock", self._hear)

    def __call__(self) -> float:
        return self.now_s + self._offset_s

    def _hear(self, message: Message) -> None:
        time_s = _seconds(message["clock"])
        if time_s < self.now_s:
            _log.warning("/clock went back from %g s to %g s; time goes on", self.now_s, time_s)
            self._offset_s += self.now_s - time_s
        self.now_s = time_s
        self.has_begun = True


class Bridge:
    """Connects a knowledge base and a robot, in both directions, until `close`.

    Measurements are recorded by the thread of the connection. Events are published on
    `/rosa_kb/events`, decisions with their reasons on `/rosa/log`, and ROSA's services are served.
    While there is no connection, the attributes that are measured over it are stale. Measurements
    age by the stamps in their headers.

    Args:
        percepts: get the diagnostics too, for the conditions of a mission.
        clock: the simulated one, if the knowledge base and the header stamps go by it.

    Attributes:
        managed: the robot's nodes, as the managed system of a `ConfigurationManager`.

    Raises:
        MissionError, kb.UnknownName: the settings name a place that is malformed, or an unknown
            element.
    """

    def __init__(
        self,
        kb: KnowledgeBase,
        node: Node,
        settings: BridgeSettings | None = None,
        percepts: Percepts | None = None,
        clock: SimulatedClock | None = None,
    ) -> None:
        settings = settings or BridgeSettings()
        self.managed = RosComponents(kb, node, settings, self._observe)
        self._kb = kb
        self._node = node
        self._clock = clock
        self._percepts = percepts
        self._stamps = dict.fromkeys(settings.attributes, math.inf)
        for name, place in settings.attributes.items():
            topic, path, kind = _place(name, place)
            node.subscribe(topic, kind, partial(self._measure, kb.attributes[name], path))
        self._rules = DiagnosticRules(settings.diagnostics)
        self._rules.check(kb)
        self._report_s = node.clock() + _REPORT_S
        node.subscribe("/diagnostics", ros.DIAGNOSTICS, self._receive)
        RosaServices(kb, node)
        connect(kb, node)
        self._unsubscribe = kb.subscribe(self._publish)
        node.watch(self._change)

    @property
    def is_connected(self) -> bool:
        """Whether robot and clock are there; while not, do not update the manager."""
        return self._node.is_connected and (self._clock is None or self._clock.has_begun)

    @property
    def _now(self) -> float:
        """The time as it is in header stamps [s]."""
        return self._kb.now if self._clock is None else self._clock.now_s

    def close(self) -> None:
        """Stop publishing, and close the node."""
        self._unsubscribe()
        self.managed.close()
        self._node.close()

    def _observe(self) -> None:
        """Notice measurements whose stamps are too old; called at each update of the manager."""
        for name, stamp in self._stamps.items():
            view = self._kb.attributes[name]
            if self._now - stamp > view.max_age and not view.is_stale:
                self._make_stale(view)
        if self._node.clock() >= self._report_s:
            self._report_s = self._node.clock() + _REPORT_S
            self._report_diagnostics()

    def _report_diagnostics(self) -> None:
        """Log how many statuses were not understood, and of which names, since the last time."""
        unknown = self._rules.not_understood
        if not unknown:
            return
        names = ", ".join(f"{name!r} ({count})" for name, count in unknown.most_common(_NAMES))
        more = ", ..." if len(unknown) > _NAMES else ""
        advice = "a line under [diagnostics] says what they mean"
        text = "%d diagnostics of %d names were not understood: %s%s; %s"
        _log.warning(text, unknown.total(), len(unknown), names, more, advice)
        unknown.clear()

    def _measure(self, view: AttributeView, path: list[str], message: Message) -> None:
        value: Any = message
        for part in path:
            value = value[int(part)] if isinstance(value, list) else value[part]
        stamp = _stamp(message)
        if stamp < self._stamps[view.name] <= self._now:
            raise ValueError("a message is older than the one before it")
        if self._now - stamp > view.max_age:
            raise ValueError("a message is older than max_age; are the clocks the same?")
        self._kb.measure(view.name, value)
        self._stamps[view.name] = stamp

    def _make_stale(self, view: AttributeView) -> None:
        if view.value is not None:
            self._kb.replay(Event(0, self._kb.now, "stale", (view.name,)))

    def _receive(self, message: Message) -> None:
        problems = self._kb.receive(message, rules=self._rules)
        if self._percepts is not None:
            self._percepts.receive({"status": ros.plain_statuses(message)})
        for problem in problems:
            self._node.refused.add(f"{problem.key}: {problem.reason}")  # whatever the value

    def _publish(self, event: Event) -> None:
        word = _WORDS.get(event.kind)
        if word is None:
            return
        self._node.publish("/rosa_kb/events", ros.STRING, {"data": word})
        if event.kind is not EventKind.MONITORING_DATA or event.changes:
            changes = "".join(f"; {change.name} is {change.new}" for change in event.changes)
            self._node.publish(LOG, ros.LOG, ros.log_of(event, changes))

    def _change(self, is_connected: bool, text: str) -> None:
        _log.log(logging.INFO if is_connected else logging.WARNING, "%s", text)
        if not is_connected:
            self.managed.forget()
            for name in self._stamps:
                self._make_stale(self._kb.attributes[name])


def _place(attribute: str, text: str) -> tuple[str, list[str], str]:
    """Return the topic, the path to the field, and the message type (may be empty)."""
    place, _, kind = text.strip().partition(" ")
    topic, *path = place.split(".")
    if not topic.startswith("/") or not all(path) or not path:
        raise MissionError(
            f"{attribute} is measured by {text!r}; "
            "write /topic.field, e.g. /battery_state.percentage"
        )
    return topic, path, kind.strip()


def _seconds(stamp: Message) -> float:
    return float(stamp["sec"]) + float(stamp["nanosec"]) * 1e-9


def _stamp(message: Message) -> float:
    """Return the time in a message's header [s]; infinity if there is none, or it was not set."""
    header = message.get("header")
    if not isinstance(header, dict):
        return math.inf
    return _seconds(header["stamp"]) or math.inf
