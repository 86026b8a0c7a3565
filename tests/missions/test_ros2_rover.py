"""The rover of the examples, driven against a simulated ROS 2 side in another process."""

import math
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from threading import Timer

import pytest

from missions.wires.rosbridge import RosbridgeServer

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "ros2_rover"
ROSLIB = ROOT / "missions" / "views" / "page" / "node_modules" / "roslib"
NODES = ("/front/camera", "/lidar", "/navigator")


class SimulatedRover:
    """Lifecycle nodes behind a rosbridge, and their battery, light and diagnostics."""

    def __init__(self):
        self.server = RosbridgeServer(0)
        self.states = dict.fromkeys(NODES, 1)
        self.parameters, self.heard = {}, []
        for node in NODES:
            self.server.serve(
                f"{node}/get_state", "lifecycle_msgs/srv/GetState", lambda _, n=node: self.state(n)
            )
            self.server.serve(
                f"{node}/change_state",
                "lifecycle_msgs/srv/ChangeState",
                lambda one, n=node: self.go(n, one),
            )
            self.server.serve(
                f"{node}/set_parameters_atomically", "x", lambda one, n=node: self.set(n, one)
            )
        self.server.subscribe(
            "/rosa_kb/events", "std_msgs/msg/String", lambda one: self.heard.append(one["data"])
        )

    def state(self, node):
        return {"current_state": {"id": self.states[node], "label": ""}}

    def go(self, node, request):
        goal = {(1, 1): 2, (2, 3): 3, (3, 4): 2}.get(
            (self.states[node], request["transition"]["id"])
        )
        self.states[node] = goal or self.states[node]
        return {"success": goal is not None}

    def set(self, node, request):
        self.parameters[node] = {
            one["name"]: one["value"]["double_value"] for one in request["parameters"]
        }
        return {"result": {"successful": True, "reason": ""}}

    def say(self, battery, light=0.9, **components):
        publish = self.server.publish
        publish(
            "/battery_state",
            "sensor_msgs/msg/BatteryState",
            {"percentage": battery, "cell_voltage": [math.nan]},
        )
        publish(
            "/light_sensor", "sensor_msgs/msg/Illuminance", {"illuminance": light, "variance": 0.0}
        )
        values = [{"key": name, "value": said} for name, said in components.items()]
        status = {
            "level": 2,
            "name": "watchdog",
            "message": "Component status",
            "hardware_id": "",
            "values": values,
        }
        publish(
            "/diagnostics",
            "diagnostic_msgs/msg/DiagnosticArray",
            {"header": {}, "status": [status]},
        )

    def until(self, holds, **said):
        end = time.monotonic() + 120
        while not holds():
            assert time.monotonic() < end, (self.states, self.parameters)
            self.say(**said)
            time.sleep(0.05)


@pytest.fixture
def rover():
    simulated = SimulatedRover()
    yield simulated
    simulated.server.close()


def start(rover, *arguments):
    return bridge("--url", f"ws://127.0.0.1:{rover.server.port}", *arguments)


def bridge(*arguments, **variables):
    command = [
        sys.executable,
        "-m",
        "missions",
        "bridge",
        "rover:model",
        "--config",
        "bridge.toml",
        *arguments,
    ]
    environment = {
        **os.environ,
        **variables,
        "PYTHONPATH": os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH")))),
    }
    return subprocess.Popen(
        command,
        cwd=EXAMPLE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=environment,
    )


def test_rover_is_managed_through_battery_drop_and_failed_node(rover):
    with start(rover, "--tree", "rover:tree") as program:
        try:
            rover.until(
                lambda: rover.states["/front/camera"] == 3 and rover.states["/navigator"] == 3,
                battery=0.9,
            )
            assert rover.parameters["/front/camera"] == {"exposure": 0.01, "gain": 1.0}
            rover.until(
                lambda: rover.parameters["/front/camera"]["gain"] == 8.0, battery=0.9, light=0.1
            )
            rover.until(lambda: rover.states["/lidar"] == 3, battery=0.9, camera="failure")
            assert rover.states["/front/camera"] == 2
            rover.say(battery="much")
            rover.until(lambda: rover.states["/lidar"] == 2, battery=0.1)
            assert rover.states["/navigator"] == 3, "the way to the dock is driven with it"
            assert {
                "insert_monitoring_data",
                "action_update",
                "insert_reconfiguration_plan",
            } <= set(rover.heard)
        finally:
            program.terminate()
            said = program.stdout.read()
    assert "patrol is abandoned" in said
    assert "return_to_dock is requested" in said
    assert said.count("refused: battery_level: ") == 1


@pytest.mark.skipif(
    not (shutil.which("node") and ROSLIB.exists()),
    reason="needs Node.js and roslib: npm ci in missions/views/page",
)
def test_roslib_asks_the_knowledge_base(rover, tmp_path):
    script = tmp_path / "ask.mjs"
    script.write_text(f"""
import * as ROSLIB from '{ROSLIB.as_posix()}/dist/RosLib.js';
const ros = new ROSLIB.Ros({{ url: 'ws://127.0.0.1:{rover.server.port}' }});
ros.on('error', (error) => {{ console.log('error', error); process.exit(2); }});
ros.on('connection', () => {{
  const name = '/rosa_kb/action/selectable';
  const request = new ROSLIB.Service({{ ros, name, serviceType: 'rosa_msgs/srv/ActionQueryArray' }});
  const ask = () => request.callService({{ actions: [] }}, (answer) => {{
    const names = (answer.actions || []).map((one) => one.name).sort();
    if (names.length === 2) {{ console.log(names.join(' ')); process.exit(0); }}
    setTimeout(ask, 100);
  }}, () => setTimeout(ask, 100));
  const battery = new ROSLIB.Topic({{ ros, name: '/battery_state', messageType: 'sensor_msgs/msg/BatteryState' }});
  setInterval(() => battery.publish({{ percentage: 0.8 }}), 100);
  ask();
}});
setTimeout(() => process.exit(3), 180000);
""")
    with start(rover, "--answer") as program:
        try:
            done = subprocess.run(
                ["node", str(script)], capture_output=True, text=True, timeout=200, check=False
            )
        finally:
            program.terminate()
            program.stdout.read()
    assert (done.returncode, done.stdout.split()) == (0, ["patrol", "return_to_dock"]), done.stderr


def test_rover_is_managed_over_dds_by_types_that_are_not_ours():
    domain = str(100 + os.getpid() % 100)
    only_here = '<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1" multicast="true"/>'
    only_here += "</Interfaces></General></Domain></CycloneDDS>"
    variables = {
        **os.environ,
        "ROS_DOMAIN_ID": domain,
        "CYCLONEDDS_URI": only_here.replace("Domain>", f'Domain Id="{domain}">', 1),
    }
    side = [sys.executable, str(Path(__file__).with_name("dds_rover.py"))]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with (
        subprocess.Popen(side, env=variables, **pipes) as robot,
        bridge("--tree", "rover:tree", "--dds", ROS_DOMAIN_ID=domain) as program,
    ):
        heard = []

        def until(*wanted):
            missing = set(wanted)
            while missing:
                line = robot.stdout.readline()
                assert line, f"{missing} never happened; it said {heard[-20:]}"
                heard.append(line.strip())
                missing.discard(line.strip())

        def say(text):
            robot.stdin.write(f"{text}\n")
            robot.stdin.flush()

        watchdog = Timer(180, robot.kill)
        watchdog.start()
        try:
            until("/front/camera 3", "/navigator 3", "/front/camera gain 1.0")
            say("light 0.1")
            until("/front/camera gain 8.0")
            say("failed camera")
            until("/front/camera 2", "/lidar 3")
            say("battery 0.1")
            until("/lidar 2", "action_update")
            assert {"insert_monitoring_data", "insert_reconfiguration_plan"} <= set(heard)
        finally:
            watchdog.cancel()
            robot.stdin.close()
            program.terminate()
            said = program.stdout.read()
    assert "patrol is abandoned" in said
    assert "return_to_dock is requested" in said
