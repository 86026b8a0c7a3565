"""A robot in ROS 2 by rosbridge: a simulated one, served by us, and clients that are not ours."""

import json
import random
import time
from contextlib import contextmanager, suppress
from threading import Event, Thread
from types import SimpleNamespace

import numpy as np
import pytest
from cut_wires import Wire
from running import called
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from kb import ConfigurationManager, KnowledgeBase, Model
from missions.engine.mission import MissionError
from missions.wires.bridge import Bridge, BridgeSettings, parameter_messages
from missions.wires.node import QUEUED, Outbox, RosError
from missions.wires.rosbridge import Peer, Rosbridge, RosbridgeServer

SETTINGS = BridgeSettings(
    attributes={"energy": "/battery_state.percentage sensor_msgs/msg/BatteryState"}
)


def rover():
    model = Model("rover")
    energy = model.quality_attribute("energy")
    look = model.function("look")
    camera = model.component("camera", kind="lifecycle")
    camera.configuration(
        "sharp", {"width": 1280, "gain": 0.5, "mode": "day", "hdr": True}, priority=1
    )
    look.design("by_camera", [camera], priority=1)
    look.design("by_radar", [model.component("radar", kind="lifecycle")], priority=2)
    model.action("explore", requires=[look], constraints=[energy >= 0.2])
    model.action("charge")
    return model


class Robot:
    """The ROS 2 side: lifecycle nodes that answer as rclcpp's do, on a rosbridge."""

    def __init__(self, port=0, **given):
        self.server = RosbridgeServer(port, **given)
        self.states = {"camera": 1, "radar": 1}
        self.parameters, self.calls, self.broken = {}, [], set()
        for name in self.states:
            self.server.serve(
                f"/{name}/get_state", "lifecycle_msgs/srv/GetState", lambda _, n=name: self.state(n)
            )
            self.server.serve(f"/{name}/change_state", "x", lambda one, n=name: self.change(n, one))
            self.server.serve(
                f"/{name}/set_parameters_atomically", "x", lambda one, n=name: self.set(n, one)
            )

    @property
    def url(self):
        return f"ws://127.0.0.1:{self.server.port}"

    def state(self, name):
        return {"current_state": {"id": self.states[name], "label": ""}}

    def change(self, name, request):
        transition = request["transition"]["id"]
        self.calls.append((name, transition))
        goal = {(1, 1): 2, (2, 3): 3, (3, 4): 2}.get((self.states[name], transition))
        if goal is None or name in self.broken:
            return {"success": False}
        self.states[name] = goal
        return {"success": True}

    def set(self, name, request):
        self.parameters[name] = {one["name"]: one["value"] for one in request["parameters"]}
        return {"result": {"successful": True, "reason": ""}}

    def measure(self, value):
        self.server.publish(
            "/battery_state", "sensor_msgs/msg/BatteryState", {"percentage": value, "cells": []}
        )

    def diagnose(self, **values):
        pairs = [{"key": key, "value": str(value)} for key, value in values.items()]
        status = {
            "level": 0,
            "name": "robot",
            "message": "QA status",
            "hardware_id": "",
            "values": pairs,
        }
        self.server.publish(
            "/diagnostics",
            "diagnostic_msgs/msg/DiagnosticArray",
            {"header": {}, "status": [status]},
        )


def until(holds, *, seconds=120.0, turn=lambda: None):
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, "it never came true"
        turn()
        time.sleep(0.005)


@contextmanager
def bridged(robot, url=None):
    kb = KnowledgeBase(rover(), clock=time.monotonic)
    node = Rosbridge(url or robot.url)
    bridge = Bridge(kb, node, SETTINGS)
    try:
        until(lambda: node.is_connected)
        yield kb, bridge
    finally:
        bridge.close()


@pytest.fixture
def robot():
    made = Robot()
    yield made
    made.server.close()


def test_battery_drop_and_failed_node_are_answered(robot):
    with bridged(robot) as (kb, bridge):
        manager = ConfigurationManager(kb, bridge.managed)
        until(lambda: kb.attributes["energy"].value == 0.9, turn=lambda: robot.measure(0.9))
        kb.request_action("explore")
        until(lambda: kb.components["camera"].is_active, turn=manager.update)
        assert robot.states == {"camera": 3, "radar": 1}
        assert robot.parameters["camera"] == {
            "width": {"type": 2, "integer_value": 1280},
            "gain": {"type": 3, "double_value": 0.5},
            "mode": {"type": 4, "string_value": "day"},
            "hdr": {"type": 1, "bool_value": True},
        }
        kb.component_failed("camera")
        until(lambda: robot.states == {"camera": 2, "radar": 3}, turn=manager.update)
        robot.measure(0.1)
        until(lambda: not kb.is_feasible("explore"))
        robot.diagnose(energy=0.8)
        until(lambda: kb.is_feasible("explore"))


def test_node_that_refuses_is_tried_again_and_then_done_without(robot):
    robot.broken.add("camera")
    with bridged(robot) as (kb, bridge):
        manager = ConfigurationManager(kb, bridge.managed)
        until(lambda: kb.attributes["energy"].value == 0.9, turn=lambda: robot.measure(0.9))
        kb.request_action("explore")
        until(lambda: robot.states["radar"] == 3, turn=manager.update)
        assert robot.calls.count(("camera", 1)) == 3
        assert "refuses the transition" in str(kb.explain("camera"))


def test_node_that_stops_by_itself_is_noticed(robot):
    with bridged(robot) as (kb, bridge):
        manager = ConfigurationManager(kb, bridge.managed)
        until(lambda: kb.attributes["energy"].value == 0.9, turn=lambda: robot.measure(0.9))
        kb.request_action("explore")
        until(
            lambda: kb.components["camera"].is_active and kb.pending_plan is None,
            turn=manager.update,
        )
        robot.states["camera"] = 2
        robot.server.publish(
            "/camera/transition_event", "x", {"goal_state": {"id": 2, "label": "inactive"}}
        )
        until(lambda: robot.states["radar"] == 3, turn=manager.update)


def test_lost_connection_comes_back_and_what_was_decided_meanwhile_is_told(robot):
    wire, heard = Wire(robot.server.port), []
    robot.server.subscribe("/rosa_kb/events", "std_msgs/msg/String", heard.append)
    with bridged(robot, f"ws://127.0.0.1:{wire.port}") as (kb, _):
        until(lambda: kb.attributes["energy"].value == 0.9, turn=lambda: robot.measure(0.9))
        (enough,) = kb.actions["explore"].constraints
        until(lambda: enough.status == "satisfied")
        wire.close()
        until(lambda: enough.status == "not evaluated")
        assert kb.attributes["energy"].is_stale
        told = [one for one in kb.log if one.verb == "stale"][-1].text
        assert told.startswith("energy is stale: measured ")
        assert told.endswith(" s ago, and no more")
        kb.request_action("charge")  # said when it is there again
        assert {"data": "action_update"} not in heard
        again = Wire(robot.server.port, wire.port)
        try:
            until(lambda: enough.status == "satisfied", turn=lambda: robot.measure(0.9))
            until(lambda: {"data": "action_update"} in heard)
            assert heard.count({"data": "action_update"}) == 1
        finally:
            again.close()


def test_originals_services_are_served(robot):
    with bridged(robot) as (kb, _):
        until(lambda: kb.attributes["energy"].value == 0.9, turn=lambda: robot.measure(0.9))

        def call(service, **request):
            return robot.server.call(f"/rosa_kb/{service}", "", request).result(120)

        until(
            lambda: (
                "/rosa_kb/query"
                in robot.server.call("/rosapi/services", "", {}).result(120)["services"]
            )
        )
        assert {one["name"] for one in call("action/selectable", actions=[])["actions"]} == {
            "explore",
            "charge",
        }
        asked = call(
            "action/request", action={"name": "explore", "is_required": True}, preference=""
        )
        assert asked["action"] == {"name": "explore", "status": "unsolved", "is_required": True}
        assert [one["name"] for one in call("function/adaptable")["functions"]] == ["look"]
        designs = call("function_designs/selectable", function={"name": "look"})["fds"]
        assert [one["name"] for one in designs] == ["by_camera", "by_radar"]
        priorities = call("function_designs/priority", fds=designs)["fds"]
        assert [one["priority"] for one in priorities] == [1.0, 2.0]
        components = call("component/adaptable", selected_fds=["by_camera"])["components"]
        assert [one["name"] for one in components] == ["camera"]
        found = call("component_configuration/selectable", component={"name": "camera"})[
            "c_configs"
        ]
        assert [one["name"] for one in found] == ["sharp"]
        selected = call(
            "select_configuration", selected_fds=designs[:1], selected_component_configs=found
        )
        assert selected == {"success": True}
        plan = call("reconfiguration_plan/get_latest")["reconfig_plan"]
        assert [one["name"] for one in plan["components_activate"]] == ["camera"]
        values = call("component_parameters/get", c_config={"name": "sharp"})["parameters"]
        assert values[0] == {"name": "width", "value": {"type": 2, "integer_value": 1280}}
        done = call(
            "reconfiguration_plan/result/set", reconfig_plan={**plan, "result": "completed"}
        )
        assert (done["success"], done["reconfig_plan"]["result"]) == (True, "completed")
        assert call("reconfiguration_plan/get", reconfig_plan=plan)["success"]
        process = {"pid": 4711, "component": {"name": "camera"}}
        assert call("component_process/insert", component_process=process)["success"]
        assert [
            one["pid"] for one in call("component_process/get_active")["component_process"]
        ] == [4711]
        assert call("component_process/end/set", component_process=process)["success"]
        assert not call("component_process/get_active")["component_process"]
        call("action/request", action={"name": "explore", "is_required": False})
        assert not kb.required_actions
        said = []
        robot.server.subscribe("/rosa/log", "rcl_interfaces/msg/Log", said.append)
        assert call("action/request", action={"name": "exlpore", "is_required": True}) == {
            "success": False
        }
        until(
            lambda: any(
                one["level"] == 30 and "did you mean 'explore'" in one["msg"] for one in said
            )
        )
        assert call("action/insert", action={"name": "wave"})["success"]
        assert call("action/exists", action={"name": "wave"})["action"]["name"] == "wave"
        assert not call("query", query="match $a isa Action; get $a;")["success"]


def test_events_are_published_as_the_original_compares_them(robot):
    heard, said = [], []
    robot.server.subscribe(
        "/rosa_kb/events", "std_msgs/msg/String", lambda one: heard.append(one["data"])
    )
    robot.server.subscribe(
        "/rosa/log", "rcl_interfaces/msg/Log", lambda one: said.append(one["msg"])
    )
    with bridged(robot) as (kb, bridge):
        manager = ConfigurationManager(kb, bridge.managed)
        until(lambda: kb.attributes["energy"].value == 0.9, turn=lambda: robot.measure(0.9))
        kb.request_action("explore")
        wanted = {"insert_monitoring_data", "action_update", "insert_reconfiguration_plan"}
        until(lambda: wanted <= set(heard), turn=manager.update)
        until(lambda: any("because function look is needed by explore" in one for one in said))


def test_unknown_keys_of_diagnostics_are_counted_each_as_one_kind(robot):
    with bridged(robot) as (kb, bridge):
        values = iter(range(10**6))
        until(
            lambda: sum(bridge.refused.values()) >= 5,
            turn=lambda: robot.diagnose(enrgy=next(values)),
        )
        assert list(bridge.refused) == ["enrgy: unknown attribute 'enrgy'; did you mean 'energy'?"]
        assert kb.attributes["energy"].value is None


def test_nonsense_is_counted_refused_logged_once_and_survived(robot, caplog):
    rng = random.Random(4)
    with bridged(robot) as (kb, bridge):
        with connect(
            robot.url, max_queue=None
        ) as peer:  # answers that nobody reads hold up no farewell
            for _ in range(300):
                peer.send(rng.choice(NONSENSE))
            sane = json.dumps(
                {"op": "publish", "topic": "/battery_state", "msg": {"percentage": 0.7}}
            )
            until(
                lambda: kb.attributes["energy"].value == 0.7, turn=lambda: peer.send(sane)
            )  # the bridge may be late
        assert sum(robot.server.refused.values()) > 200
        for value in (None, "much", [1], {"a": 1}, float("nan")):
            robot.server.publish("/battery_state", "", {"percentage": value})
        robot.server.publish("/battery_state", "", {})
        robot.server.publish("/battery_state", "", {"percentage": "much"})
        until(lambda: sum(bridge.refused.values()) >= 7)

        def logged():
            return [one.getMessage() for one in caplog.records if "'much'" in one.getMessage()]

        until(logged)
        assert len(logged()) == 1, "each kind once"
        assert logged()[0].startswith("refused: energy: ")
        assert kb.attributes["energy"].value == 0.7


NONSENSE = (
    "",
    "no JSON",
    "[]",
    "17",
    "{}",
    '{"op": 3}',
    '{"op": "fly"}',
    '{"op": "__init__"}',
    '{"op": "publish"}',
    '{"op": "publish", "topic": 3, "msg": {}}',
    '{"op": "publish", "topic": "/battery_state", "msg": 3}',
    '{"op": "call_service", "service": "/x", "args": [1]}',
    '{"op": "service_response", "id": "call_service:1"}',
    '{"op": "service_response"}',
    '{"op": "fragment", "data": "x"}',
    "[" * 5000,
    b"\x00\xff binary",
)


def test_client_that_never_reads_does_not_hold_up_closing():
    server = RosbridgeServer(0)
    with connect(f"ws://127.0.0.1:{server.port}", max_queue=1) as frozen:
        frozen.send(
            json.dumps({"op": "subscribe", "topic": "/camera", "type": "std_msgs/msg/String"})
        )
        until(lambda: "/camera" in server.call("/rosapi/topics", "", {}).result(60)["topics"])
        for _ in range(5000):  # more than a connection can hold
            server.publish("/camera", "std_msgs/msg/String", {"data": "x" * 10_000})
        start = time.monotonic()
        server.close()
        assert time.monotonic() - start < 12.0, "no waiting for its answer"


def test_what_clients_can_take_has_an_end(robot, monkeypatch):
    monkeypatch.setattr("missions.wires.rosbridge.QUEUED", 3)
    monkeypatch.setattr("missions.wires.rosbridge._MOST_CLIENTS", 1)
    url = f"ws://127.0.0.1:{robot.server.port}"

    def refused(peer, **message):
        for number in range(4):
            peer.send(json.dumps({key: value.format(number) for key, value in message.items()}))
        while (heard := json.loads(peer.recv(60)))["op"] != "status":
            pass
        return heard["msg"]

    with connect(url) as peer:
        assert "advertise 3 times at most" in refused(peer, op="advertise", topic="/t{}")
        with pytest.raises(
            InvalidStatus, match="503"
        ):  # now that the server has heard of the first one
            connect(url).__enter__()
        peer.send(json.dumps({"op": "advertise_service", "service": "/never"}))
        assert "3 calls wait" in refused(peer, op="call_service", service="/never")


def test_message_that_is_too_big_ends_its_connection_only(robot):
    with bridged(robot) as (kb, _):
        with connect(robot.url) as peer:
            with suppress(ConnectionClosed):
                peer.send("x" * 10_000_000)
            with pytest.raises(ConnectionClosed):
                peer.recv()
        until(lambda: kb.attributes["energy"].value == 0.4, turn=lambda: robot.measure(0.4))


def test_elsewhere_needs_a_token_and_pages_of_other_sites_are_refused():
    with pytest.raises(MissionError, match="give a token"):
        RosbridgeServer(0, host="0.0.0.0")
    server = RosbridgeServer(0, host="0.0.0.0", token="secret")
    try:
        url = f"ws://127.0.0.1:{server.port}"
        for wrong in ({}, {"additional_headers": {"Authorization": "Bearer wrong"}}):
            with pytest.raises(InvalidStatus, match="401"), connect(url, **wrong):
                pass
        with connect(f"{url}/?token=secret"):
            pass
        node = Rosbridge(url, token="secret")
        until(lambda: node.is_connected)
        node.close()
    finally:
        server.close()
    open_here = RosbridgeServer(0)
    try:
        url = f"ws://127.0.0.1:{open_here.port}"
        for origin in ("https://somewhere.example", "null"):  # null: a frame of somewhere's page
            with pytest.raises(InvalidStatus, match="403"), connect(url, origin=origin):
                pass
        with connect(url, origin="http://localhost:8080"):
            pass
    finally:
        open_here.close()


def test_what_a_client_that_has_gone_had_asked_and_declared_is_forgotten(robot):
    url = f"ws://127.0.0.1:{robot.server.port}"
    with connect(url) as slow, connect(url) as caller:
        slow.send(json.dumps({"op": "advertise_service", "service": "/slow", "type": "x"}))
        until(
            lambda: "/slow" in robot.server.call("/rosapi/services", "", {}).result(60)["services"]
        )
        caller.send(json.dumps({"op": "advertise", "topic": "/passing", "type": "y/msg/Z"}))
        caller.send(json.dumps({"op": "call_service", "service": "/slow", "id": "1"}))
        assert json.loads(slow.recv(60))["op"] == "call_service"
        assert robot.server.call("/rosapi/topic_type", "", {"topic": "/passing"}).result(60) == {
            "type": "y/msg/Z"
        }
        (number,) = robot.server._forwarded
        caller.close()
        until(lambda: not robot.server._forwarded)
        robot.server._respond(number, {})  # it is answered at the same moment
        assert "/passing" not in robot.server.call("/rosapi/topics", "", {}).result(60)["topics"]


def test_call_without_a_connection_or_a_server_fails_at_once(robot):
    node = Rosbridge("ws://127.0.0.1:9")
    with pytest.raises(RosError, match="no connection"):
        node.call("/camera/get_state", "", {}).result(60)
    for _ in range(2):  # who asks later is told, too, why there is none, and where it is sought
        told, texts = Event(), []
        node.watch(lambda _, text, told=told, texts=texts: (texts.append(text), told.set()))
        assert told.wait(60.0)
        assert "no connection to ws://127.0.0.1:9: " in texts[0]
        assert "refused" in texts[0]
    node.close()
    with pytest.raises(RosError, match="nobody serves"):
        robot.server.call("/nowhere", "", {}).result(60)


def test_node_that_is_closed_while_it_connects_ends(robot, monkeypatch):
    node = Rosbridge(robot.url)
    until(lambda: node.is_connected)
    begun, go_on, connected = Event(), Event(), node._begin

    def begin_late(*given):
        begun.set()
        assert go_on.wait(60.0)
        connected(*given)

    monkeypatch.setattr(node, "_begin", begin_late)
    node._peer.socket.close()
    assert begun.wait(60.0), "it connects again"
    closing = Thread(target=node.close, daemon=True)
    closing.start()
    until(node._closing.is_set)
    go_on.set()
    closing.join(60.0)
    assert not closing.is_alive()


def test_what_waited_to_be_sent_when_the_connection_was_cut_is_published_on_the_next(
    robot, monkeypatch
):
    monkeypatch.setattr("missions.wires.node._FLUSH_S", 60.0)
    node, heard, cut = Rosbridge(robot.url), [], Event()
    robot.server.subscribe("/news", "x", lambda one: heard.append(one["number"]))
    until(lambda: node.is_connected)

    def stuck(_):
        assert cut.wait(60.0)
        raise ConnectionError

    monkeypatch.setattr(node._peer, "_write", stuck)
    for number in range(5):
        node.publish("/news", "x", {"number": number})
    assert not node.call("/camera/get_state", "x", {}).done()
    node._peer.socket.close()
    cut.set()
    until(lambda: len(heard) == 5)
    assert heard == [*range(5)]
    for number in range(500):
        node.publish("/news", "x", {"number": number})
    node.close()
    until(lambda: heard == [*range(5), *range(500)])


def test_full_queue_of_what_is_late_pushes_out_nothing_that_is_declared():
    node, written, go_on = Rosbridge("ws://127.0.0.1:9"), [], Event()
    node.subscribe("/orders", "x", written.append)
    for number in range(QUEUED):
        node.publish("/news", "x", {"number": number})
    socket = SimpleNamespace(
        send=lambda text: go_on.wait(60.0) and written.append(json.loads(text)), close=go_on.set
    )
    node._begin(Peer(socket), 0.0)
    go_on.set()
    until(lambda: len(written) == QUEUED)
    assert [one["op"] for one in written[:3]] == ["subscribe", "advertise", "publish"]
    assert written[-1]["msg"] == {"number": QUEUED - 1}
    node.close()


def test_queue_that_is_closed_sends_no_more_than_what_was_under_way(monkeypatch):
    monkeypatch.setattr("missions.wires.node._FLUSH_S", 0.01)
    begun, go_on, written = Event(), Event(), []

    def write(one):
        begun.set()
        assert go_on.wait(60.0)
        written.append(one)

    queue = Outbox(write)
    for number in range(3):
        queue.put(number)
    assert begun.wait(60.0)
    assert queue.close() == [0, 1, 2]
    go_on.set()
    queue._thread.join(60.0)
    assert written == [0]


def test_operation_that_is_cancelled_commands_nothing_more(robot):
    asked, answer = Event(), Event()

    def state(_):
        asked.set()
        assert answer.wait(60.0)
        return {"current_state": {"id": 1, "label": ""}}

    with bridged(robot) as (_, bridge):
        until(lambda: bridge.managed.is_active("camera") is False)
        robot.server.serve("/camera/get_state", "x", state)
        operation = bridge.managed.activate("camera")
        assert asked.wait(60.0)
        assert operation.cancel()
        answer.set()
        bridge.managed.activate("radar").result(60)
    assert robot.calls == [("radar", 1), ("radar", 3)]


def test_parameters_are_told_by_their_types_those_of_numpy_too():
    told = parameter_messages({"a": np.float64(0.5), "b": True, "c": 3, "d": ["x"], "e": []})
    assert [one["value"] for one in told] == [
        {"type": 3, "double_value": 0.5},
        {"type": 1, "bool_value": True},
        {"type": 2, "integer_value": 3},
        {"type": 9, "string_array_value": ["x"]},
        {"type": 8, "double_array_value": []},
    ]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["small_rover:ENERGY_DROP"],
            "'small_rover:ENERGY_DROP' is no mission, no model and no function that makes one",
        ),
        (
            ["small_rover"],
            "unknown mission 'small_rover'; there are suave, suave_extended, agv, uav; one of your own is a",
        ),
        (["small_rover:rover_tree", "--answer"], "cannot build small_rover:rover_tree"),
        (
            ["suave", "--tree", "small_rover:ENERGY_DROP"],
            "is a list, not a function that builds a tree",
        ),
        (
            ["suave", "--tree", "small_rover:rover_model"],
            "cannot build the tree of small_rover:rover_model: TypeError",
        ),
        (
            ["suave", "--config", "nowhere.toml"],
            "cannot read nowhere.toml: No such file or directory\n",
        ),
    ],
)
def test_robot_or_tree_that_is_none_is_told_in_a_sentence(monkeypatch, capsys, arguments, words):
    code, _, err = called(capsys, monkeypatch, "bridge", *arguments, "--serve", 0, "--seconds", 0.1)
    assert code == 2
    assert words in err


def test_wrong_settings_are_told(tmp_path):
    kb = KnowledgeBase(rover(), clock=time.monotonic)
    server = RosbridgeServer(0)
    try:
        for wrong, said in (
            (BridgeSettings(attributes={"enegry": "/a.b"}), "energy"),
            (BridgeSettings(attributes={"energy": "battery"}), "write /topic.field"),
            (BridgeSettings(components={"camrea": "/camera"}), "camera"),
        ):
            with pytest.raises(Exception, match=said):
                Bridge(kb, server, wrong)
        file = tmp_path / "bridge.toml"
        for text, said in (
            ("url = 3", "url .* must be a text"),
            ("speed = 3", "unknown field 'speed'"),
            ("[attributes", "cannot read"),
        ):
            file.write_text(text)
            with pytest.raises(MissionError, match=said):
                BridgeSettings.load(file)
        file.write_text(
            '[attributes]\nenergy = "/battery_state.percentage"\n[components]\ncamera = "/camera"\n'
        )
        assert BridgeSettings.load(file).attributes == {"energy": "/battery_state.percentage"}
        with pytest.raises(MissionError, match="not the address"):
            Rosbridge("robot:9090")
        with pytest.raises(MissionError, match="give another port"):
            RosbridgeServer(server.port)
    finally:
        server.close()
