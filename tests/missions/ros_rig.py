"""A robot by each wire, with its bridge and manager, by a clock that a test turns."""

import time
from contextlib import contextmanager, suppress

import rclpy_double
from ros_robot import ActionServer, LifecycleNode
from rosbridge_double import RosbridgeDouble

from kb import ConfigurationManager, KnowledgeBase, Model
from missions.wires.bridge import Bridge, BridgeSettings
from missions.wires.rclpy import RclpyNode
from missions.wires.rosbridge import Rosbridge

BATTERY = "sensor_msgs/msg/BatteryState"
WIRES = ("rosbridge", "rclpy")
STEP_S = 0.1
GOAL = {"pose": {"header": {"frame_id": "map"}, "pose": {"orientation": {"w": 1.0}}}}
"""A goal of Nav2."""


def rover():
    model = Model("rover")
    energy = model.quality_attribute("energy", max_age=5.0)
    look = model.function("look")
    camera = model.component("camera", kind="lifecycle")
    values = {"width": 1280, "gain": 0.5, "mode": "day", "hdr": True}
    camera.configuration("sharp", values, priority=1)
    look.design("by_camera", [camera], priority=1)
    look.design("by_radar", [model.component("radar", kind="lifecycle")], priority=2)
    model.action("explore", requires=[look], constraints=[energy >= 0.2])
    model.action("charge")
    return model


def until(holds, *, turn=lambda: None):
    end = time.monotonic() + 120.0
    while not holds():
        assert time.monotonic() < end, "it never came true"
        turn()
        time.sleep(0.002)


@contextmanager
def connected(wire, clock=time.monotonic):
    """Yield a host for a robot, and a node that reaches it."""
    if wire == "rosbridge":
        host = RosbridgeDouble()
        node = Rosbridge(host.url, clock=clock)
        until(lambda: node.is_connected)
        try:
            yield host, node
        finally:
            node.close()
            host.close()
        return
    with rclpy_double.installed():
        host = rclpy_double.RobotHost()
        node = RclpyNode(clock=clock)
        try:
            yield host, node
        finally:
            with suppress(AssertionError):  # a test has closed it
                node.close()
            host.close()


class Rig:
    """The robot `rover`: camera, radar and an action server; `turn` lets time pass."""

    def __init__(self, host, node, **settings):
        self.now = 0.0
        self.host = host
        self.node = node
        self._lost = set()
        node.clock = lambda: self.now
        self.camera = LifecycleNode(host, "/camera")
        self.radar = LifecycleNode(host, "/radar")
        self.server = ActionServer(host)
        host.advertise("/battery_state", BATTERY)
        self.kb = KnowledgeBase(rover(), clock=lambda: self.now)
        self.heard = 0
        self._receive = self.kb.receive
        self.kb.receive = self.count_diagnostics
        places = {"energy": f"/battery_state.percentage {BATTERY}"}
        self.bridge = Bridge(self.kb, node, BridgeSettings(attributes=places, **settings))
        until(lambda: node.is_connected and host.has_hearer("/diagnostics"))
        self.manager = ConfigurationManager(self.kb, self.bridge.managed)

    def count_diagnostics(self, *given, **options):
        problems = self._receive(*given, **options)
        self.heard += 1
        return problems

    def measure(self, value, stamp=0.0):
        header = {"stamp": {"sec": int(stamp), "nanosec": round(stamp % 1 * 1e9)}, "frame_id": ""}
        self.host.publish("/battery_state", BATTERY, {"header": header, "percentage": value})

    def is_waiting(self):
        """Return whether a call to somebody who answers is under way."""
        silent = [node.name for node in (self.camera, self.radar) if node.is_frozen]
        silent += [self.server.name] if self.server.is_dead else []
        calls = dict(self.node._calls)
        self._lost |= {
            number for number, call in calls.items() if call.service.startswith(tuple(silent))
        }
        return bool(calls.keys() - self._lost)

    def turn(self, holds, within, also=lambda: None):
        """Turn the clock until something holds; return how long that takes [s]."""
        start = self.now
        while not holds():
            assert self.now - start <= within, f"it does not hold after {within} s"
            self.now = round(self.now + STEP_S, 6)
            self.manager.update()
            also()
            until(lambda: not self.is_waiting())
        return self.now - start

    def request(self):
        self.kb.measure("energy", 0.9)
        self.kb.request_action("explore")

    def explore(self):
        """Let it look by its camera."""
        until(lambda: self.kb.attributes["energy"].value == 0.5, turn=lambda: self.measure(0.5))
        self.kb.request_action("explore")
        self.turn(lambda: self.kb.components["camera"].is_active and not self.kb.pending_plan, 5)


@contextmanager
def rig(wire, **settings):
    with connected(wire, clock=lambda: 0.0) as (host, node):
        made = Rig(host, node, **settings)
        try:
            yield made
        finally:
            made.bridge.close()
            made.kb.close()
