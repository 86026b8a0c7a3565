"""The rover of the examples in a program of its own, against doubles."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from ros_rig import until
from ros_robot import ActionServer, LifecycleNode
from rosbridge_double import RosbridgeDouble

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "ros2_rover"


class Rover:
    """Three lifecycle nodes, Nav2's action server, battery, light and diagnostics."""

    def __init__(self):
        self.host = RosbridgeDouble()
        self.battery = 0.9
        self.light = 0.9
        self.heard = []
        names = ("/front/camera", "/lidar", "/navigator")
        self.camera, self.lidar, self.navigator = (LifecycleNode(self.host, name) for name in names)
        self.nav2 = ActionServer(self.host)
        self.host.subscribe("/rosa_kb/events", "", lambda one: self.heard.append(one["data"]))

    def publish(self):
        self.host.publish(
            "/battery_state", "", {"percentage": self.battery, "cell_voltage": [None]}
        )
        self.host.publish("/light_sensor", "", {"illuminance": self.light, "variance": 0.0})

    def diagnose(self, name, level, message):
        status = {"name": name, "level": level, "message": message, "hardware_id": "", "values": []}
        self.host.publish("/diagnostics", "", {"header": {}, "status": [status]})

    def until(self, holds):
        until(holds, turn=self.publish)


@pytest.fixture
def rover():
    robot = Rover()
    yield robot
    robot.host.close()


@pytest.fixture
def program(rover):
    command = [sys.executable, "-m", "missions", "bridge", "rover:model", "--tree", "rover:tree"]
    paths = (str(ROOT), os.environ.get("PYTHONPATH"))
    started = subprocess.Popen(
        [*command, "--config", "bridge.toml", "--url", rover.host.url],
        cwd=EXAMPLE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))},
    )
    yield started
    started.kill()
    started.communicate(timeout=60)


def test_rover_drives_on_when_its_camera_dies_and_docks_when_low(rover, program):
    """The story of docs/ros2.md, but that nobody needs to wait three seconds for a dead node."""
    rover.until(lambda: rover.camera.state == 3 and rover.navigator.state == 3)
    rover.until(lambda: rover.nav2.received)
    assert rover.nav2.received[0]["pose"]["pose"]["position"] == {"x": 4.0, "y": 0.0}
    assert rover.camera.parameters["gain"]["double_value"] == 1.0
    rover.light = 0.1
    rover.until(lambda: rover.camera.parameters["gain"]["double_value"] == 8.0)
    rover.camera.vanish()
    rover.until(lambda: rover.lidar.state == 3)
    rover.battery = 0.1
    rover.until(lambda: rover.nav2.asked)
    assert len(rover.nav2.received) == 1, "the way to the dock begins when the patrol is over"
    rover.nav2.end(5)
    rover.until(lambda: len(rover.nav2.received) == 2)
    assert rover.nav2.received[1]["pose"]["pose"]["position"] == {"x": 0.0, "y": 0.0}
    rover.until(lambda: rover.lidar.state == 2)
    rover.nav2.end(4)
    rover.until(lambda: len(rover.nav2.received) == 3)
    words = {"insert_monitoring_data", "action_update", "insert_reconfiguration_plan"}
    assert words <= set(rover.heard)
    rover.nav2.confirms_cancels = True
    program.terminate()
    text = program.communicate(timeout=60)[0]
    assert not rover.nav2.goals, "it leaves no goal behind"
    assert "camera has failed" in text
    assert "patrol is abandoned" in text
    assert "return_to_dock is requested" in text


def test_rover_hears_diagnostic_updater(rover, program):
    rover.until(lambda: rover.camera.state == 3)
    rover.diagnose("camera_driver: frame rate", 2, "Frequency too low.")
    rover.until(lambda: rover.lidar.state == 3 and rover.camera.state == 2)
    rover.diagnose("camera_driver: frame rate", 0, "Desired frequency met")
    rover.until(lambda: rover.camera.state == 3)
