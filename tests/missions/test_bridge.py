"""The bridge: what a robot says becomes known, and ages, whatever the wire."""

import random
from concurrent.futures import Future

import numpy as np
import pytest
from ros_rig import BATTERY, WIRES, connected, rig, rover, until
from rosbridge_double import RosbridgeDouble
from running import called

from kb import KnowledgeBase, Model
from missions.engine.mission import MissionError
from missions.wires.bridge import Bridge, BridgeSettings, SimulatedClock
from missions.wires.components import RosComponents
from missions.wires.node import Node, RosError
from missions.wires.rosbridge import Rosbridge
from missions.wires.services import parameter_messages

ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
DOUBLE = "std_msgs/msg/Float64"


@pytest.fixture(params=WIRES)
def robot(request):
    with rig(request.param) as made:
        yield made


def status(name, level, message="", **values):
    pairs = [{"key": key, "value": str(value)} for key, value in values.items()]
    return {"level": level, "name": name, "message": message, "hardware_id": "", "values": pairs}


def diagnose(robot, *statuses):
    before = robot.bridge.heard
    robot.host.publish("/diagnostics", ARRAY, {"status": list(statuses)})
    until(lambda: robot.bridge.heard > before)


def test_parameters_are_set_with_their_types(robot):
    robot.explore()
    assert robot.camera.parameters["width"]["integer_value"] == 1280
    assert robot.camera.parameters["gain"]["double_value"] == 0.5
    assert robot.camera.parameters["mode"]["string_value"] == "day"
    assert robot.camera.parameters["hdr"]["bool_value"] is True
    assert [robot.camera.parameters[name]["type"] for name in ("hdr", "width", "gain", "mode")] == [
        1,
        2,
        3,
        4,
    ]


def test_rosas_own_diagnostics_are_understood(robot):
    diagnose(robot, status("robot", 0, "QA status", energy=0.1))
    assert not robot.kb.is_feasible("explore")
    diagnose(robot, status("robot", 2, "Component status", camera="failure"))
    assert robot.kb.components["camera"].status == "failure"


@pytest.mark.parametrize("wire", WIRES)
def test_everybodys_diagnostics_are_understood_by_rules(wire, caplog):
    rules = {
        "camera: *": "camera",
        "battery: charge": {"attributes": {"Charge": "energy"}},
        "radar": {"component": "radar", "stale": "failed"},
    }
    with rig(wire, diagnostics=rules) as robot:
        diagnose(
            robot, status("camera: frame rate", 2, "Frequency too low"), status("camera: heat", 0)
        )
        assert robot.kb.components["camera"].status == "failure"
        diagnose(robot, status("camera: frame rate", 0))
        assert robot.kb.components["camera"].status != "failure"
        diagnose(robot, status("battery: charge", 0, "ok", Charge=0.1))
        assert robot.kb.attributes["energy"].value == 0.1
        diagnose(robot, status("battery: charge", 3, "no news"), status("radar", 3))
        assert robot.kb.attributes["energy"].is_stale
        assert robot.kb.components["radar"].status == "failure"
        for _ in range(3):
            diagnose(robot, status("gps: fix", 1), status("lidar", 0))
        robot.turn(
            lambda: "2 names were not understood: 'gps: fix' (3), 'lidar' (3)" in caplog.text, 61
        )
        first = len(caplog.records)
        robot.now += 100.0
        robot.manager.update()
        assert "not understood" not in "".join(r.getMessage() for r in caplog.records[first:])


def test_measurements_age_by_their_stamps(robot):
    robot.now = 100.0
    robot.measure(0.5, stamp=98.0)
    until(lambda: robot.kb.attributes["energy"].value == 0.5)
    robot.now = 102.9
    robot.manager.update()
    assert not robot.kb.attributes["energy"].is_stale
    robot.now = 103.1  # 5.1 s after the stamp, 3.1 s after it was heard
    robot.manager.update()
    assert robot.kb.attributes["energy"].is_stale


def test_late_messages_are_refused(robot):
    robot.now = 100.0
    robot.measure(0.5, stamp=99.0)
    until(lambda: robot.kb.attributes["energy"].value == 0.5)
    robot.measure(0.1, stamp=98.0)
    robot.measure(0.1, stamp=90.0)
    until(lambda: robot.bridge.refused.total() == 2)
    assert robot.kb.attributes["energy"].value == 0.5


def test_refused_values_are_counted_by_kind(robot, caplog):
    for value in (float("nan"), 2.0**300, float("nan")):
        robot.measure(value)
    until(lambda: robot.bridge.refused.total() >= 2)
    for number in range(3):
        diagnose(robot, status("robot", 0, "QA status", enrgy=number))
    assert robot.bridge.refused["enrgy: unknown attribute 'enrgy'; did you mean 'energy'?"] == 3
    assert caplog.text.count("unknown attribute 'enrgy'") <= 4


@pytest.mark.parametrize("wire", WIRES)
def test_latched_value_published_before_is_heard(wire):
    with connected(wire) as (host, node):
        host.advertise("/light", DOUBLE, is_latched=True)
        host.publish("/light", DOUBLE, {"data": 0.7})
        heard = []
        node.subscribe("/light", DOUBLE, heard.append)
        until(lambda: heard)
        host.publish("/light", DOUBLE, {"data": 0.8})
        until(lambda: [message["data"] for message in heard] == [0.7, 0.8])


@pytest.mark.parametrize("wire", WIRES)
def test_simulated_clock_follows_and_never_goes_back(wire, caplog):
    with connected(wire) as (host, node):
        host.advertise("/clock", "rosgraph_msgs/msg/Clock")
        clock = SimulatedClock(node)
        seen = []
        for sec in (126, 127, 3, 5):
            message = {"clock": {"sec": sec, "nanosec": 500_000_000}}
            until(
                lambda sec=sec: clock.now_s == sec + 0.5,
                turn=lambda m=message: host.publish("/clock", "rosgraph_msgs/msg/Clock", m),
            )
            seen.append(clock())
        assert seen == [126.5, 127.5, 127.5, 129.5]
        assert clock.has_begun
        assert "/clock went back from 127.5 s to 3.5 s" in caplog.text


@pytest.mark.parametrize("wire", WIRES)
def test_bridge_waits_for_the_simulated_clock_and_ages_by_it(wire):
    with connected(wire) as (host, node):
        host.advertise("/clock", "rosgraph_msgs/msg/Clock")
        host.advertise("/battery_state", BATTERY)
        clock = SimulatedClock(node)
        kb = KnowledgeBase(rover(), clock=clock)
        settings = BridgeSettings(attributes={"energy": f"/battery_state.percentage {BATTERY}"})
        bridge = Bridge(kb, node, settings, clock=clock)
        assert not bridge.is_connected

        def tell(sec):
            message = {"clock": {"sec": sec, "nanosec": 0}}
            host.publish("/clock", "rosgraph_msgs/msg/Clock", message)

        until(lambda: bridge.is_connected, turn=lambda: tell(126))
        stamp = {"stamp": {"sec": 124, "nanosec": 0}, "frame_id": ""}
        reading = {"header": stamp, "percentage": 0.5}
        until(
            lambda: kb.attributes["energy"].value == 0.5,
            turn=lambda: host.publish("/battery_state", BATTERY, reading),
        )
        until(lambda: kb.now == 130.0, turn=lambda: tell(130))
        bridge.managed.observe(kb)
        assert kb.attributes["energy"].is_stale, "it is 6 s old by the clock of the simulation"
        kb.close()


@pytest.mark.parametrize("wire", WIRES)
def test_call_that_is_not_answered_fails_by_its_time_out(wire):
    with rig(wire) as robot:
        robot.camera.kill()
        future = robot.node.call("/camera/get_state", "lifecycle_msgs/srv/GetState", {}, 4.0)
        robot.now = 3.9
        robot.node.update()
        assert not future.done()
        robot.now = 4.0
        robot.node.update()
        assert "has not answered in time" in str(future.exception())


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
    with connected("rosbridge") as (host, node), KnowledgeBaseOf(model) as kb:
        from kb import ConfigurationManager

        host.serve(
            "/mapper/set_parameters_atomically", "x", lambda _: {"result": {"successful": True}}
        )
        bridge = Bridge(kb, node)
        manager = ConfigurationManager(kb, bridge.managed)
        kb.request_action("explore")
        until(lambda: kb.components["mapper"].is_active, turn=manager.update)
        until((tmp_path / "ros2.log").exists)
        assert "run slam mapper --ros-args" in (tmp_path / "ros2.log").read_text()
        kb.cancel_action("explore")
        bridge.close()


class KnowledgeBaseOf:
    def __init__(self, model):
        self.kb = KnowledgeBase(model)

    def __enter__(self):
        return self.kb

    def __exit__(self, *_):
        self.kb.close()


def test_cancelled_command_commands_nothing_more():
    class SlowNode(Node):
        """Answers when the test says so."""

        calls = []  # noqa: RUF012  # of this test's own

        def call(self, service, kind, request, timeout_s=5.0):
            self.calls.append((service, Future()))
            return self.calls[-1][1]

        def subscribe(self, *_): ...

        publish = serve = send_goal = close = subscribe

    kb, node = KnowledgeBase(rover(), clock=lambda: 0.0), SlowNode()
    command = RosComponents(kb, node, BridgeSettings()).activate("camera")
    assert command.cancel()
    node.calls[0][1].set_result({"current_state": {"id": 1}})
    assert [service for service, _ in node.calls] == ["/camera/get_state"]


# ------------------------------------------------------------ ROSA's own services and events


@pytest.fixture
def server():
    with rig("rosbridge") as made:
        until(lambda: any("/rosa_kb/query" in one.services for one in made.host.clients))
        made.kb.measure("energy", 0.9)
        yield made


def test_originals_services_are_served(server):
    kb = server.kb

    def call(service, **request):
        return server.host.call(f"/rosa_kb/{service}", request)["values"]

    assert {one["name"] for one in call("action/selectable", actions=[])["actions"]} == {
        "explore",
        "charge",
    }
    asked = call("action/request", action={"name": "explore", "is_required": True}, preference="")
    assert asked["action"] == {"name": "explore", "status": "unsolved", "is_required": True}
    assert [one["name"] for one in call("function/adaptable")["functions"]] == ["look"]
    designs = call("function_designs/selectable", function={"name": "look"})["fds"]
    assert [one["name"] for one in designs] == ["by_camera", "by_radar"]
    priorities = call("function_designs/priority", fds=designs)["fds"]
    assert [one["priority"] for one in priorities] == [1.0, 2.0]
    components = call("component/adaptable", selected_fds=["by_camera"])["components"]
    assert [one["name"] for one in components] == ["camera"]
    found = call("component_configuration/selectable", component={"name": "camera"})["c_configs"]
    assert [one["name"] for one in found] == ["sharp"]
    selected = call(
        "select_configuration", selected_fds=designs[:1], selected_component_configs=found
    )
    assert selected == {"success": True}
    plan = call("reconfiguration_plan/get_latest")["reconfig_plan"]
    assert [one["name"] for one in plan["components_activate"]] == ["camera"]
    values = call("component_parameters/get", c_config={"name": "sharp"})["parameters"]
    assert values[0] == {"name": "width", "value": {"type": 2, "integer_value": 1280}}
    done = call("reconfiguration_plan/result/set", reconfig_plan={**plan, "result": "completed"})
    assert (done["success"], done["reconfig_plan"]["result"]) == (True, "completed")
    assert call("reconfiguration_plan/get", reconfig_plan=plan)["success"]
    process = {"pid": 4711, "component": {"name": "camera"}}
    assert call("component_process/insert", component_process=process)["success"]
    assert [one["pid"] for one in call("component_process/get_active")["component_process"]] == [
        4711
    ]
    assert call("component_process/end/set", component_process=process)["success"]
    assert not call("component_process/get_active")["component_process"]
    call("action/request", action={"name": "explore", "is_required": False})
    assert not kb.required_actions
    said = []
    server.host.subscribe("/rosa/log", "rcl_interfaces/msg/Log", said.append)
    assert call("action/request", action={"name": "exlpore", "is_required": True}) == {
        "success": False
    }
    until(
        lambda: any(one["level"] == 30 and "did you mean 'explore'" in one["msg"] for one in said)
    )
    assert call("action/insert", action={"name": "wave"})["success"]
    assert call("action/exists", action={"name": "wave"})["action"]["name"] == "wave"
    assert not call("query", query="match $a isa Action; get $a;")["success"]


def test_events_are_published_as_the_original_compares_them(server):
    heard, said = [], []
    server.host.subscribe("/rosa_kb/events", "", lambda one: heard.append(one["data"]))
    server.host.subscribe("/rosa/log", "", lambda one: said.append(one["msg"]))
    server.explore()
    until(
        lambda: (
            {"insert_monitoring_data", "action_update", "insert_reconfiguration_plan"} <= set(heard)
        )
    )
    until(lambda: any("because function look is needed by explore" in one for one in said))


def test_lost_connection_makes_stale_and_publishes_later(server):
    heard = []
    server.host.subscribe("/rosa_kb/events", "", lambda one: heard.append(one["data"]))
    (enough,) = server.kb.actions["explore"].constraints
    assert enough.status == "satisfied"
    port, host = server.host.port, server.host
    host.close()
    until(lambda: enough.status == "not evaluated")
    assert server.bridge.managed.is_active("camera") is None
    server.kb.request_action("charge")
    again = server.host = RosbridgeDouble(port)
    again.subscribe("/rosa_kb/events", "", lambda one: heard.append(one["data"]))
    try:
        until(lambda: heard.count("action_update") == 1)
        until(lambda: enough.status == "satisfied", turn=lambda: server.measure(0.9))
    finally:
        again.close()


NONSENSE = (
    "",
    "no JSON",
    "[]",
    "17",
    "{}",
    '{"op": 3}',
    '{"op": "fly"}',
    '{"op": "publish"}',
    '{"op": "publish", "topic": 3, "msg": {}}',
    '{"op": "publish", "topic": "/battery_state", "msg": 3}',
    '{"op": "call_service", "service": "/x", "args": [1]}',
    '{"op": "service_response", "id": "call:1"}',
    '{"op": "service_response"}',
    '{"op": "action_result", "status": 4}',
    '{"op": "fragment", "data": "x"}',
    "[" * 5000,
    b"\x00\xff binary",
)


def test_nonsense_is_counted_refused_and_survived(server):
    rng = random.Random(4)
    for client in list(server.host.clients):
        for _ in range(100):
            client.websocket.send(rng.choice(NONSENSE))
    until(lambda: server.node.refused.total() > 50)
    until(lambda: server.kb.attributes["energy"].value == 0.7, turn=lambda: server.measure(0.7))


def test_parameters_have_their_types_those_of_numpy_too():
    messages = parameter_messages({"a": np.float64(0.5), "b": True, "c": 3, "d": ["x"], "e": []})
    assert [one["value"] for one in messages] == [
        {"type": 3, "double_value": 0.5},
        {"type": 1, "bool_value": True},
        {"type": 2, "integer_value": 3},
        {"type": 9, "string_array_value": ["x"]},
        {"type": 8, "double_array_value": []},
    ]


def test_tree_is_set_up_before_its_first_tick(monkeypatch, capsys, tmp_path):
    (tmp_path / "digger.py").write_text(DIGGER)
    monkeypatch.syspath_prepend(tmp_path)
    host = RosbridgeDouble()
    command = ("bridge", "digger:model", "--tree", "digger:tree", "--url", host.url)
    code, out, _ = called(capsys, monkeypatch, *command, "--seconds", 0.5)
    host.close()
    assert code == 0
    assert "horn is made" in out


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


# ------------------------------------------------------------ what is wrong is told in a sentence


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["small_rover:ENERGY_DROP"], "is no mission, no model and no function that makes one"),
        (["small_rover"], "one of your own is a"),
        (["small_rover:rover_tree", "--answer"], "cannot build small_rover:rover_tree"),
        (["suave", "--tree", "small_rover:ENERGY_DROP"], "not a function that builds a tree"),
        (["suave", "--tree", "small_rover:rover_model"], "cannot build the tree of"),
        (["suave", "--config", "nowhere.toml"], "cannot read nowhere.toml: No such file"),
        (["suave", "--rclpy"], "rclpy is not installed"),
        (["suave", "--attribute", "speed=/a.b"], "unknown attribute 'speed'"),
        (
            ["suave", "--attribute", "water_visibility=/a.b std_msgs/msg/Flaot64"],
            "did you mean std_msgs/msg/Float64?",
        ),
        (["suave", "--attribute", "water_visibility=/a.b Float64"], "write PACKAGE/msg/TYPE"),
    ],
)
def test_bridge_that_cannot_be_made_exits_2(monkeypatch, capsys, arguments, words):
    code, _, err = called(capsys, monkeypatch, "bridge", *arguments, "--seconds", 0.1)
    assert code == 2
    assert words in err
    assert "Traceback" not in err


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize("kind", ["String", "std_msgs/msg/Nothing"])
def test_unknown_message_type_is_refused(wire, kind):
    with connected(wire) as (_, node), pytest.raises(RosError, match=kind):
        node.subscribe("/x", kind, print)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("url = 3", "url .* must be a text"),
        ("speed = 3", "unknown field 'speed'"),
        ("[attributes", "cannot read"),
        ("timeout_s = '5'", "timeout_s .* must be a number"),
        ("timeout_s = 0", "more than 0 s"),
        ("[timeouts]\ncamera = true", "timeouts .* must be a table of numbers"),
        ("use_sim_time = 1", "use_sim_time .* must be true or false"),
        ("restarted = 'never'", "restarted is recover or fail"),
        ("diagnostics = '/diagnostics'", "diagnostics .* must be a table"),
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
        '[timeouts]\ncamera = 20\n[diagnostics]\n"camera: *" = "camera"\n"b" = { attributes = { c = "energy" } }\n'
    )
    settings = BridgeSettings.load(file)
    assert (settings.use_sim_time, settings.notice_s, settings.timeouts) == (
        True,
        2,
        {"camera": 20},
    )
    assert settings.diagnostics["b"] == {"attributes": {"c": "energy"}}


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"attributes": {"enegry": f"/a.b {BATTERY}"}}, "energy"),
        ({"attributes": {"energy": "battery"}}, "write /topic.field"),
        ({"components": {"camrea": "/camera"}}, "camera"),
        ({"timeouts": {"camrea": 3.0}}, "camera"),
        ({"diagnostics": {"x": "camrea"}}, "camera"),
    ],
)
def test_settings_that_do_not_fit_the_model_are_refused(settings, words):
    kb = KnowledgeBase(rover(), clock=lambda: 0.0)
    with connected("rosbridge") as (_, node), pytest.raises(Exception, match=words):
        Bridge(kb, node, BridgeSettings(**settings))


def test_address_that_is_none_is_refused():
    with pytest.raises(MissionError, match="not the address"):
        Rosbridge("robot:9090")


def test_message_that_is_too_big_ends_its_connection_only(server):
    client = next(one for one in server.host.clients if one.topics)
    client.send(op="publish", topic="/battery_state", msg={"data": "x" * 2**21})
    until(lambda: server.kb.attributes["energy"].value == 0.4, turn=lambda: server.measure(0.4))


def test_token_is_given_to_the_rosbridge():
    host = RosbridgeDouble()
    node = Rosbridge(host.url, token="secret")
    until(lambda: host.clients)
    assert host.clients[0].websocket.request.headers["Authorization"] == "Bearer secret"
    node.close()
    host.close()
