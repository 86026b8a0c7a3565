"""The bridge: what a robot says becomes known, and ages, whatever the wire."""

from contextlib import closing
from functools import partial

import numpy as np
import pytest
from ros_rig import BATTERY, WIRES, connected, rig, rover, until
from rosbridge_double import RosbridgeDouble
from running import called

from kb import ConfigurationManager, KnowledgeBase, Model
from missions.engine.mission import MissionError
from missions.wires.bridge import Bridge, BridgeSettings, SimulatedClock
from missions.wires.node import RosError
from missions.wires.rosbridge import Rosbridge
from missions.wires.services import parameter_messages

ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
CLOCK = "rosgraph_msgs/msg/Clock"
DOUBLE = "std_msgs/msg/Float64"


def status(name, level, message="", **values):
    pairs = [{"key": key, "value": str(value)} for key, value in values.items()]
    return {"level": level, "name": name, "message": message, "hardware_id": "", "values": pairs}


def diagnose(robot, *statuses):
    before = robot.heard
    robot.host.publish("/diagnostics", ARRAY, {"status": list(statuses)})
    until(lambda: robot.heard > before)


def test_rosas_own_diagnostics_are_understood(robot):
    diagnose(robot, status("robot", 0, "QA status", energy=0.1))
    assert not robot.kb.is_feasible("explore")
    diagnose(robot, status("robot", 2, "Component status", camera="failure"))
    assert robot.kb.components["camera"].status == "failure"


@pytest.mark.parametrize("wire", WIRES)
def test_diagnostics_of_everybody_are_understood_by_rules(wire, caplog):
    rules = {
        "camera: *": "camera",
        "battery: charge": {"attributes": {"Charge": "energy"}},
        "radar": {"component": "radar", "stale": "failed"},
    }
    with rig(wire, diagnostics=rules) as robot:
        components = robot.kb.components
        energy = robot.kb.attributes["energy"]
        diagnose(robot, status("camera: rate", 2, "too low"), status("camera: heat", 0))
        assert components["camera"].status == "failure"
        diagnose(robot, status("camera: rate", 0))
        assert components["camera"].status != "failure"
        diagnose(robot, status("battery: charge", 0, "ok", Charge=0.1))
        assert energy.value == 0.1
        diagnose(robot, status("battery: charge", 3, "no news"), status("radar", 3))
        assert energy.is_stale
        assert components["radar"].status == "failure"
        for _ in range(3):
            diagnose(robot, status("gps: fix", 1), status("lidar", 0))
        text = "2 names were not understood: 'gps: fix' (3), 'lidar' (3)"
        robot.turn(lambda: text in caplog.text, 61)
        robot.now += 100.0
        robot.manager.update()
        assert caplog.text.count("not understood") == 1


def test_measurement_is_as_old_as_its_stamp(robot):
    energy = robot.kb.attributes["energy"]
    robot.now = 100.0
    robot.measure(0.5, stamp=98.0)
    until(lambda: energy.value == 0.5)
    for late in (97.0, 90.0):
        robot.measure(0.1, stamp=late)
    until(lambda: robot.node.refused.total() == 2)
    robot.now = 102.9
    robot.manager.update()
    assert energy.value == 0.5
    assert not energy.is_stale
    robot.now = 103.1  # 5.1 s after the stamp, 3.1 s after it was heard
    robot.manager.update()
    assert energy.is_stale


@pytest.mark.parametrize("wire", WIRES)
def test_value_latched_before_is_heard(wire):
    with connected(wire) as (host, node):
        host.advertise("/light", DOUBLE, is_latched=True)
        host.publish("/light", DOUBLE, {"data": 0.7})
        heard = []
        node.subscribe("/light", DOUBLE, heard.append)
        until(lambda: heard)
        host.publish("/light", DOUBLE, {"data": 0.8})
        until(lambda: [message["data"] for message in heard] == [0.7, 0.8])


@pytest.mark.parametrize("wire", WIRES)
def test_bridge_runs_by_the_simulated_clock(wire, caplog):
    with connected(wire) as (host, node):
        for topic, kind in (("/clock", CLOCK), ("/battery_state", BATTERY)):
            host.advertise(topic, kind)
        clock = SimulatedClock(node)
        with closing(KnowledgeBase(rover(), clock=clock)) as kb:
            settings = BridgeSettings(attributes={"energy": f"/battery_state.percentage {BATTERY}"})
            bridge = Bridge(kb, node, settings, clock=clock)
            assert not bridge.is_connected

            def tell(sec):
                message = {"clock": {"sec": sec, "nanosec": 0}}
                until(
                    lambda: clock.now_s == sec, turn=lambda: host.publish("/clock", CLOCK, message)
                )

            tell(126)
            until(lambda: bridge.is_connected)
            message = {"header": {"stamp": {"sec": 124, "nanosec": 0}}, "percentage": 0.5}
            publish = partial(host.publish, "/battery_state", BATTERY, message)
            until(lambda: kb.attributes["energy"].value == 0.5, turn=publish)
            tell(130)
            bridge.managed.observe(kb)
            assert kb.attributes["energy"].is_stale, "it is 6 s old by that clock"
            tell(3)
            tell(5)
            assert kb.now == 132.0, "it never goes back"
            assert "/clock went back from 130 s to 3 s" in caplog.text


def test_call_that_is_not_answered_fails_by_its_time_out(robot):
    robot.camera.kill()
    reply = robot.node.call("/camera/get_state", "lifecycle_msgs/srv/GetState", {}, 4.0)
    robot.now = 3.9
    robot.node.update()
    assert not reply.done()
    robot.now = 4.0
    robot.node.update()
    assert "has not answered in time" in str(reply.exception())


def test_plain_node_is_a_process(tmp_path, monkeypatch):
    program = tmp_path / "ros2"
    program.write_text('#!/bin/sh\necho "$@" >> "$0.log"\nexec sleep 60\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    model = Model("rover")
    mapper = model.component("mapper", kind="ros_node", package="slam", executable="mapper")
    mapper.configuration("fine", {"resolution": 0.05}, priority=1)
    model.function("map").design("by_mapper", [mapper])
    model.action("explore", requires=["map"])
    answer = {"result": {"successful": True}}
    with connected("rosbridge") as (host, node), closing(KnowledgeBase(model)) as kb:
        host.serve("/mapper/set_parameters_atomically", "x", lambda _: answer)
        with closing(Bridge(kb, node)) as bridge:
            manager = ConfigurationManager(kb, bridge.managed)
            kb.request_action("explore")
            until(lambda: kb.components["mapper"].is_active, turn=manager.update)
            until((tmp_path / "ros2.log").exists)
            assert "run slam mapper --ros-args" in (tmp_path / "ros2.log").read_text()
            kb.cancel_action("explore")


def test_command_cancelled_commands_nothing_more(robot):
    assert robot.bridge.managed.activate("camera").cancel()
    robot.turn(lambda: robot.now > 1.5, 2)
    assert robot.camera.transitions == []


# ------------------------------------------------------------ ROSA's own services and events


@pytest.fixture
def server():
    with rig("rosbridge") as made:
        last = "/rosa_kb/reconfiguration_plan/result/set"
        until(lambda: any(last in client.services for client in made.host.clients))
        made.kb.measure("energy", 0.9)
        yield made


def test_services_of_the_original_are_served(server):
    logged = []
    server.host.subscribe("/rosa/log", "rcl_interfaces/msg/Log", logged.append)

    def call(service, **request):
        return server.host.call(f"/rosa_kb/{service}", request)["values"]

    def names(field, service, **request):
        return [element["name"] for element in call(service, **request)[field]]

    explore = {"name": "explore", "is_required": True}
    assert names("actions", "action/selectable", actions=[]) == ["explore", "charge"]
    answer = call("action/request", action=explore, preference="")
    assert answer == {"action": {**explore, "status": "unsolved"}, "success": True}
    assert call("action/exists", action=explore)["action"]["is_required"]
    assert names("functions", "function/adaptable") == ["look"]
    designs = call("function_designs/selectable", function={"name": "look"})["fds"]
    priorities = call("function_designs/priority", fds=designs)["fds"]
    assert [(design["name"], design["priority"]) for design in priorities] == [
        ("by_camera", 1.0),
        ("by_radar", 2.0),
    ]
    assert names("components", "component/adaptable", selected_fds=["by_camera"]) == ["camera"]
    camera = {"name": "camera"}
    sharp = call("component_configuration/selectable", component=camera)["c_configs"]
    assert names("c_configs", "component_configuration/priority", c_configs=sharp) == ["sharp"]
    choice = {"selected_fds": designs[:1], "selected_component_configs": sharp}
    assert call("select_configuration", **choice) == {"success": True}
    plan = call("reconfiguration_plan/get_latest")["reconfig_plan"]
    assert [component["name"] for component in plan["components_activate"]] == ["camera"]
    parameters = call("component_parameters/get", c_config={"name": "sharp"})["parameters"]
    assert parameters[0] == {"name": "width", "value": {"type": 2, "integer_value": 1280}}
    done = call("reconfiguration_plan/result/set", reconfig_plan={**plan, "result": "completed"})
    assert (done["success"], done["reconfig_plan"]["result"]) == (True, "completed")
    assert call("reconfiguration_plan/get", reconfig_plan=plan)["success"]
    assert call("component/active/set", component={**camera, "is_active": True})["success"]
    assert call("component/active/get", component=camera)["component"]["is_active"]
    process = {"pid": 4711, "component": camera}
    assert call("component_process/insert", component_process=process)["success"]
    (active,) = call("component_process/get_active")["component_process"]
    assert active["pid"] == 4711
    assert call("component_process/end/set", component_process=process)["success"]
    assert not call("component_process/get_active")["component_process"]
    call("action/request", action={**explore, "is_required": False})
    assert not server.kb.required_actions
    misspelt = {"name": "exlpore", "is_required": True}
    assert call("action/request", action=misspelt) == {"success": False}
    assert call("reconfiguration_plan/get", reconfig_plan={}) == {"success": False}
    until(lambda: any("did you mean 'explore'" in message["msg"] for message in logged))


def test_events_are_published_as_the_original_compares_them(server):
    words = []
    texts = []
    server.host.subscribe("/rosa_kb/events", "", lambda message: words.append(message["data"]))
    server.host.subscribe("/rosa/log", "", lambda message: texts.append(message["msg"]))
    server.explore()
    wanted = {"insert_monitoring_data", "action_update", "insert_reconfiguration_plan"}
    until(lambda: wanted <= set(words))
    until(lambda: any("because function look is needed by explore" in text for text in texts))


def test_connection_lost_makes_stale_and_publishes_later(server):
    words = []
    energy = server.kb.attributes["energy"]
    server.host.close()
    until(lambda: energy.is_stale)
    assert server.bridge.managed.is_active("camera") is None
    server.kb.request_action("charge")
    with closing(RosbridgeDouble(server.host.port)) as server.host:
        server.host.subscribe("/rosa_kb/events", "", lambda message: words.append(message["data"]))
        until(lambda: words.count("action_update") == 1)
        until(lambda: not energy.is_stale, turn=lambda: server.measure(0.9))


NONSENSE = (
    "no JSON",
    "[]",
    '{"op": 3}',
    '{"op": "publish"}',
    '{"op": "publish", "topic": "/battery_state", "msg": 3}',
    '{"op": "call_service", "service": "/x", "args": [1]}',
    '{"op": "service_response", "id": "call:1"}',
    '{"op": "action_result", "status": 4}',
    b"\x00\xff binary",
)


def test_nonsense_is_counted_and_survived(server):
    for client in list(server.host.clients):
        for text in NONSENSE:
            client.websocket.send(text)
    until(lambda: server.node.refused.total() >= 6)
    until(lambda: server.kb.attributes["energy"].value == 0.7, turn=lambda: server.measure(0.7))


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.float64(0.5), {"type": 3, "double_value": 0.5}),
        (True, {"type": 1, "bool_value": True}),
        (["x"], {"type": 9, "string_array_value": ["x"]}),
    ],
)
def test_parameter_has_its_type(value, message):
    assert parameter_messages({"a": value}) == [{"name": "a", "value": message}]


DIGGER = """
from kb import Model
from py_trees.behaviour import Behaviour
from py_trees.common import Status
def model():
    return Model("digger")
class Horn(Behaviour):
    def setup(self, **kwargs): self.horn = "made"
    def update(self):
        print("horn is", self.horn)
        return Status.RUNNING
def tree(kb, percepts): return Horn("horn")
"""


def test_tree_is_set_up_before_its_first_tick(monkeypatch, capsys, tmp_path):
    (tmp_path / "digger.py").write_text(DIGGER)
    monkeypatch.syspath_prepend(tmp_path)
    with closing(RosbridgeDouble()) as host:
        command = ("bridge", "digger:model", "--tree", "digger:tree", "--url", host.url)
        code, out, _ = called(capsys, monkeypatch, *command, "--seconds", 0.5)
    assert code == 0
    assert "horn is made" in out


# ------------------------------------------------------------ what is wrong is told in a sentence


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("small_rover:ENERGY_DROP", "is no mission, no model and no function that makes one"),
        ("small_rover", "one of your own is a"),
        ("suave --tree small_rover:ENERGY_DROP", "not a function that builds a tree"),
        ("suave --tree small_rover:rover_model", "cannot build the tree of"),
        ("suave --config nowhere.toml", "cannot read nowhere.toml: No such file"),
        ("suave --rclpy", "rclpy is not installed"),
        ("suave --url robot:9090", "not the address of a rosbridge"),
    ],
)
def test_bridge_that_cannot_be_made_exits_2(monkeypatch, capsys, arguments, words):
    code, _, err = called(capsys, monkeypatch, "bridge", *arguments.split(), "--seconds", 0.1)
    assert code == 2
    assert words in err


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize("kind", ["String", "std_msgs/msg/Nothing"])
def test_message_type_unknown_is_refused(wire, kind):
    with connected(wire) as (_, node), pytest.raises(RosError, match=kind):
        node.subscribe("/x", kind, print)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[attributes", "cannot read"),
        ("timeout_s = '5'", "timeout_s is '5'; expected is a number"),
        ("timeout_s = 0", "more than 0 s"),
        ("restarted = 'never'", "restarted is recover or fail"),
    ],
)
def test_settings_that_are_wrong_are_refused(tmp_path, text, words):
    file = tmp_path / "bridge.toml"
    file.write_text(text)
    with pytest.raises(MissionError, match=words):
        BridgeSettings.load(file)


def test_settings_are_read(tmp_path):
    file = tmp_path / "bridge.toml"
    file.write_text(
        'use_sim_time = true\nnotice_s = 2\n[components]\ncamera = "/front/camera"\n'
        '[timeouts]\ncamera = 20\n[diagnostics]\n"b" = { attributes = { c = "energy" } }\n'
    )
    assert BridgeSettings.load(file) == BridgeSettings(
        use_sim_time=True,
        notice_s=2,
        components={"camera": "/front/camera"},
        timeouts={"camera": 20},
        diagnostics={"b": {"attributes": {"c": "energy"}}},
    )


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"attributes": {"enegry": f"/a.b {BATTERY}"}}, "energy"),
        (
            {"attributes": {"energy": "/a.b std_msgs/msg/Flaot64"}},
            "did you mean std_msgs/msg/Float64",
        ),
        ({"attributes": {"energy": "battery"}}, "write /topic.field"),
        ({"components": {"camrea": "/camera"}}, "camera"),
        ({"diagnostics": {"x": "camrea"}}, "camera"),
    ],
)
def test_settings_that_do_not_fit_the_model_are_refused(settings, words):
    with connected("rosbridge") as (_, node), pytest.raises(Exception, match=words):
        Bridge(KnowledgeBase(rover(), clock=lambda: 0.0), node, BridgeSettings(**settings))


def test_token_is_given_to_the_rosbridge():
    with closing(RosbridgeDouble()) as host, closing(Rosbridge(host.url, token="secret")):
        until(lambda: host.clients)
        assert host.clients[0].websocket.request.headers["Authorization"] == "Bearer secret"
