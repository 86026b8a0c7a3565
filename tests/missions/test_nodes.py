"""One contract of all nodes that talk ROS 2: by rosbridge from both sides, by rclpy, by DDS to another process."""

import json
import os
import re
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import pytest
import rclpy_double
from cut_wires import requests_through_cuts
from ros_peer import ARRAY, ASK, DIAGNOSTICS, STRING, attend

from missions.engine.mission import MissionError
from missions.wires import ros
from missions.wires.dds import DdsNode, Structs
from missions.wires.node import RosError, made, message_of
from missions.wires.ros import Messages, RclpyNode
from missions.wires.rosbridge import Rosbridge, RosbridgeServer

HERE = Path(__file__).parent
DOMAIN = 40 + os.getpid() % 50
TYPED = ("rclpy", "dds")


@contextmanager
def rosbridge(*, is_server):
    server = RosbridgeServer(0)
    client = Rosbridge(f"ws://127.0.0.1:{server.port}")
    ours, peer = (server, client) if is_server else (client, server)
    attend(peer)
    until(lambda: client.is_connected)
    try:
        yield ours
    finally:
        client.close()
        server.close()


@contextmanager
def rclpy():
    with rclpy_double.installed():
        ours, peer = RclpyNode(), RclpyNode("peer")
        attend(peer)
        try:
            yield ours
        finally:
            ours.close()
            peer.close()


@cache
def dds_peer():
    """Start the program that all nodes here talk to."""
    command = [sys.executable, str(HERE / "ros_peer.py"), str(DOMAIN)]
    path = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(HERE.parents[1]), os.environ.get("PYTHONPATH", "")]),
    }
    program = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=path)
    program.stdout.readline()
    return program


@pytest.fixture(scope="module", autouse=True)
def peer_ends():
    yield
    if dds_peer.cache_info().currsize:
        dds_peer().communicate()  # its input ends
        dds_peer.cache_clear()


@contextmanager
def dds():
    assert dds_peer().poll() is None
    ours = DdsNode(DOMAIN)
    try:
        yield ours
    finally:
        ours.close()


BACKENDS = {
    "rosbridge": lambda: rosbridge(is_server=False),
    "rosbridge served": lambda: rosbridge(is_server=True),
    "rclpy": rclpy,
    "dds": dds,
}


def until(holds, *, seconds=120.0, turn=lambda: None):
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, "it never came true"
        turn()
        time.sleep(0.02)


@pytest.fixture(params=BACKENDS)
def backend(request):
    return request.param


@pytest.fixture
def node(backend):
    with BACKENDS[backend]() as made_node:
        yield made_node


def echoed(node, name, kind, message):
    """Return what comes back of a message that is handed over and back."""
    heard = []
    node.subscribe(f"/from/{name}", kind, heard.append)
    until(lambda: heard, turn=lambda: node.publish(f"/to/{name}", kind, message))
    return heard[0]


def test_text_comes_back_as_it_was(node):
    text = {"data": 'é water, "quoted" \n and long ' + "x" * 20_000}
    assert echoed(node, "text", STRING, text) == text


def test_arrays_come_back_and_what_is_no_number_is_null(node):
    nothing, empty = float("nan"), {"dim": [], "data_offset": 0}
    sent = {"layout": empty, "data": [1.0, -2.5, nothing, float("inf"), 1e300]}
    assert echoed(node, "array", ARRAY, sent)["data"][:3] == [1.0, -2.5, None]


def test_nested_messages_come_back_as_they_were(node):
    pairs = [{"key": "battery_level", "value": "0.25"}, {"key": "", "value": "é"}]
    statuses = [
        {
            "level": level,
            "name": f"n{level}",
            "message": "QA status",
            "hardware_id": "",
            "values": pairs[:level],
        }
        for level in range(3)
    ]
    stamp = {"sec": 1_700_000_000, "nanosec": 999_999_999}
    sent = {"header": {"stamp": stamp, "frame_id": "base"}, "status": statuses}
    assert echoed(node, "diagnostics", DIAGNOSTICS, sent) == sent


def test_services_are_called_both_ways(node):
    action = {"name": "explore", "status": "", "is_required": True}
    wanted = {"action": action, "success": True}
    until(lambda: asked(node, "/peer/ask", action=action, preference="") == wanted)
    calls, said = [], []
    node.serve(
        "/ours/ask",
        ASK,
        lambda one: calls.append(one) or {"action": one["action"], "success": True},
    )
    node.subscribe("/called", STRING, lambda one: said.append(json.loads(one["data"])))
    call = {
        "data": json.dumps(
            {"service": "/ours/ask", "request": {"action": action, "preference": "é"}}
        )
    }
    until(
        lambda: wanted in said, turn=lambda: (node.publish("/call", STRING, call), time.sleep(0.3))
    )
    assert calls[0] == {"action": action, "preference": "é"}


def asked(node, service, **request):
    """Return the answer to a call; None while nobody serves it yet."""
    try:
        return node.call(service, ASK, request).result(60)
    except RosError as error:
        if "nobody serves" in str(error) or "no connection" in str(error):
            return None
        return {"success": False, "reason": str(error)}


def test_call_that_its_caller_gives_up_leaves_the_node_as_it_is(node):
    action = {"name": "explore", "status": "", "is_required": True}
    until(lambda: asked(node, "/peer/ask", action=action) is not None)
    told = []
    node.watch(lambda is_there, _: told.append(is_there))
    for _ in range(5):
        node.call("/peer/ask", ASK, {"action": action}).cancel()
    assert asked(node, "/peer/ask", action=action)["success"]
    assert told in ([False], [True], [False, True]), "who was there is still there"


@pytest.mark.parametrize("service", ["/peer/refuse", "/peer/fail"])
def test_what_is_refused_or_fails_never_reads_as_success(node, service):
    answers = []
    until(
        lambda: answers and answers[-1] is not None,
        turn=lambda: answers.append(asked(node, service)),
    )
    assert answers[-1]["success"] is False


def test_call_of_what_nobody_serves_fails_in_words(node, monkeypatch):
    monkeypatch.setattr("missions.wires.node._FIND_S", 0.2)  # so long nobody is sought in vain
    with pytest.raises(RosError, match="nobody serves /nowhere"):
        node.call("/nowhere", ASK, {}).result(60)


def test_many_threads_get_their_own_answers(node):
    until(lambda: asked(node, "/peer/ask", action={"name": "first"}) is not None)
    names = [f"action {number}" for number in range(120)]
    with ThreadPoolExecutor(6) as pool:
        answers = list(
            pool.map(lambda name: asked(node, "/peer/ask", action={"name": name}), names)
        )
    assert [one["action"]["name"] for one in answers] == names


def test_listener_that_fails_does_not_end_the_node(node):
    def fail(_):
        raise ValueError("ours")

    node.subscribe("/from/text", STRING, fail)
    assert echoed(node, "text", STRING, {"data": "on"}) == {"data": "on"}


def test_closing_ends_what_is_open(backend):
    with BACKENDS[backend]():
        pass
    until(
        lambda: (
            not [
                one
                for one in threading.enumerate()
                if one.name in ("rclpy", "dds", "rosbridge", "ros-send")
            ]
        )
    )


@pytest.mark.parametrize("backend", TYPED)
def test_messages_are_checked_against_their_types(node):
    for kind, message, said in (
        (STRING, {"date": "x"}, "no field 'date'; it has data"),
        (STRING, {"data": 3}, "data of std_msgs/msg/String must be a string, not 3"),
        (ARRAY, {"data": [1.0, "x"]}, "must be a float64, not 'x'"),
        (ARRAY, {"data": 3.0}, "must be a list"),
        ("std_msgs/msg/UInt8", {"data": 256}, "must be a uint8, not 256"),
        ("std_msgs/msg/Bool", {"data": 1}, "must be a bool, not 1"),
        ("somebody_msgs/msg/Secret", {}, "somebody_msgs/msg/Secret"),
    ):
        with pytest.raises(RosError, match=said):
            node.publish("/to/nobody", kind, message)


@pytest.mark.parametrize("backend", TYPED)
@pytest.mark.parametrize("kind", ["", "String", "somebody_msgs/msg/Secret"])
def test_topic_without_a_known_type_is_refused_in_words(node, kind):
    with pytest.raises(RosError, match=kind or "type"):
        node.subscribe("/from/nobody", kind, lambda _: None)


@pytest.mark.parametrize("backend", TYPED)
def test_who_is_there_is_told(node):
    seen = []
    node.watch(lambda is_there, text: seen.append((is_there, text)))
    node.subscribe("/from/text", STRING, lambda _: None)
    until(lambda: seen[-1][0], turn=lambda: node.publish("/to/text", STRING, {"data": ""}))


def recorded(name):
    return json.loads((HERE / "data" / name).read_text())


def test_bytes_are_those_of_ros_2_and_of_rosbags():
    structs, messages = Structs(), recorded("ros2_cdr.json")["messages"]
    assert len(messages) == 9
    for one in messages:
        thing, data = made(structs, one["type"], one["fields"]), bytes.fromhex(one["cdr"])
        assert thing.serialize() == data
        assert (
            message_of(structs, one["type"], structs.find(one["type"]).deserialize(data))
            == one["fields"]
        )
        kept = ros.types()
        assert (
            kept.store.serialize_cdr(kept.decode(one["type"], data), one["type"])[: len(data)]
            == data
        )


def test_double_of_rclpy_has_the_fields_that_ros_2_wrote():
    with rclpy_double.installed():
        messages = Messages()
        for one in recorded("ros2_cdr.json")["messages"]:
            assert list(messages.fields(one["type"])) == list(one["fields"])
            assert (
                message_of(messages, one["type"], made(messages, one["type"], one["fields"]))
                == one["fields"]
            )
        answered = recorded("ros2_service_wire.json")["reply_to_us"]["decoded"]
        names = re.findall(r"(\w+)=", answered.split("component=Component(")[1].split(")")[0])
        assert list(messages.fields("rosa_msgs/msg/Component"))[: len(names)] == names


def test_service_header_is_that_of_rmw_cyclonedds():
    structs, wire = Structs(), recorded("ros2_service_wire.json")
    asked_of_us = structs.find("rosa_msgs/srv/ActionQueryArray_Request", has_header=True)
    requests = [
        asked_of_us.deserialize(bytes.fromhex(one)) for one in wire["request_to_us"]["raw_cdr"]
    ]
    assert [one.rmw_seq for one in requests] == [1, 2, 3]
    assert len({one.rmw_guid for one in requests}) == 1
    assert asked_of_us.__idl__.idl_transformed_typename == wire["request_to_us"]["type"]
    reply = wire["reply_to_us"]
    kind = "rosa_msgs/srv/ComponentQuery_Response"
    answer = structs.find(kind, has_header=True).deserialize(bytes.fromhex(reply["raw_cdr"]))
    assert message_of(structs, kind, answer)["component"]["status"] == "from_ros"
    request = made(
        structs, "rosa_msgs/srv/ComponentQuery_Request", {"component": {"name": "c_thruster_1"}}
    )
    sent = structs.with_header(
        "rosa_msgs/srv/ComponentQuery_Request", answer.rmw_guid, 1, request
    ).serialize()
    assert bytes.fromhex(reply["our_request_cdr"])[: len(sent)] == sent


def test_dds_is_of_this_machine_unless_told_otherwise():
    node, said = DdsNode(DOMAIN + 50), []
    try:
        node.watch(lambda _, text: said.append(text))
        assert "127.0.0.1" in said[0]
        with pytest.raises(MissionError, match=r"on 127\.0\.0\.1, not on 192\.0\.2\.77"):
            DdsNode(DOMAIN + 50, "192.0.2.77")
    finally:
        node.close()


def test_rclpy_that_is_not_there_is_told():
    with pytest.raises(MissionError, match="it comes with ROS 2"):
        RclpyNode()


def test_nothing_acknowledged_is_lost_and_nothing_is_done_twice_when_the_wire_is_cut():
    outcome = requests_through_cuts(1, cuts=10)
    assert outcome.acknowledged >= 30
    assert (outcome.lost, outcome.doubled) == (0, 0)
