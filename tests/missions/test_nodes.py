"""One contract of the nodes by rosbridge and by rclpy; and what is theirs alone."""

import json
import random
import threading
import time
from contextlib import closing
from pathlib import Path

import pytest
import rclpy_double
from ros_rig import WIRES, connected, until
from rosbridge_double import RosbridgeDouble

from missions.engine.mission import MissionError
from missions.wires import ros
from missions.wires.node import RosError
from missions.wires.rclpy import Messages, RclpyNode
from missions.wires.ros import to_message
from missions.wires.rosbridge import QUEUED, Rosbridge

DATA = Path(__file__).parent / "data"
ARRAY, STRING = "std_msgs/msg/Float64MultiArray", "std_msgs/msg/String"
ASK = "rosa_msgs/srv/ActionQuery"
NOWHERE = "ws://127.0.0.1:9"
EXPLORE = {"name": "explore", "status": "", "is_required": True}


@pytest.fixture(params=WIRES)
def pair(request):
    """A node, and another one that serves and calls; the graph is between them."""
    wire = request.param
    with connected(wire) as (host, node):
        other = Rosbridge(host.url) if wire == "rosbridge" else RclpyNode("other")
        other.serve("/other/ask", ASK, lambda request: {"action": request["action"]})
        until(lambda: wire == "rclpy" or other.is_connected)
        with closing(other):
            yield node, other


def echo(pair, kind, message):
    """Return a message as the other node hears it."""
    node, other = pair
    heard = []
    topic = f"/echo/{kind.split('/')[-1]}"
    other.subscribe(topic, kind, heard.append)
    until(lambda: heard, turn=lambda: node.publish(topic, kind, message))
    return heard[0]


def ask(node, service, **request):
    """Return the answer to a call; None while nobody serves it yet."""
    try:
        return node.call(service, ASK, request).result(60)
    except RosError:
        return None


def test_message_comes_over_as_it_was(pair):
    about = {"name": "n", "message": 'é "quoted" \n', "hardware_id": "", "level": 1}
    values = [{"key": "battery_level", "value": "0.25"}]
    stamp = {"sec": 1_700_000_000, "nanosec": 999_999_999}
    header = {"stamp": stamp, "frame_id": "base"}
    sent = {"header": header, "status": [{**about, "values": values}, {**about, "values": []}]}
    assert echo(pair, ros.DIAGNOSTICS, sent) == sent
    numbers = [1.0, -2.5, float("nan"), float("inf"), 1e300]
    heard = echo(pair, ARRAY, {"layout": {"dim": [], "data_offset": 0}, "data": numbers})
    assert heard["data"][:3] == [1.0, -2.5, None]


def test_services_are_called_both_ways(pair):
    node, other = pair
    until(lambda: ask(node, "/other/ask", action=EXPLORE, preference=""))
    requests = []
    node.serve("/ours/ask", ASK, lambda request: requests.append(request) or {"success": True})
    until(lambda: ask(other, "/ours/ask", action=EXPLORE, preference="é"))
    assert requests[0] == {"action": EXPLORE, "preference": "é"}


def test_hearer_that_fails_does_not_end_the_node(pair):
    _, other = pair
    other.subscribe("/echo/String", STRING, lambda message: message["nothing"])
    assert echo(pair, STRING, {"data": "on"}) == {"data": "on"}
    assert other.refused["/echo/String: KeyError: 'nothing'"]


def test_call_whose_server_raises_is_answered_as_refused(pair):
    node, other = pair
    other.serve("/other/fail", ASK, lambda request: request["nothing"])
    answers = []

    def turn():
        try:
            answers.append(node.call("/other/fail", ASK, {}).result(60))
        except RosError as error:
            answers.append({"success": "'nothing'" not in str(error)})

    until(lambda: answers and not answers[-1]["success"], turn=turn)
    assert other.refused["KeyError: 'nothing'"]


@pytest.mark.parametrize("wire", WIRES)
def test_call_that_nobody_serves_fails_in_words(wire):
    now = [0.0]
    with connected(wire, clock=lambda: now[0]) as (_, node):
        reply = node.call("/nowhere", ASK, {}, 2.0)

        def turn():
            now[0] += 0.01
            node.update()

        until(reply.done, turn=turn)
        assert any(words in str(reply.exception()) for words in ("nobody serves", "does not exist"))
        node.call("/nowhere", ASK, {})
    names = ("rclpy", "rosbridge", "ros-send")
    until(lambda: not [thread for thread in threading.enumerate() if thread.name in names])


# ------------------------------------------------------------ types


def test_definitions_of_rosa_have_the_fields_in_their_order():
    types = json.loads((DATA / "rosa_fields.json").read_text())["types"]
    assert len(types) == 25
    for name, parts in types.items():
        for part, fields in parts.items():
            kind = f"rosa_msgs/msg/{name}"
            if part != "fields":
                kind = f"rosa_msgs/srv/{name}_{part.capitalize()}"
            assert list(ros.types().fields(kind)) == [field for _, field in fields], kind


def test_bytes_are_those_of_ros_2_and_of_rosbags():
    cases = json.loads((DATA / "ros2_cdr.json").read_text())["messages"]
    assert len(cases) == 9
    with rclpy_double.installed():
        library = Messages()
        for case in cases:
            kind = case["type"]
            message = case["fields"]
            data = bytes.fromhex(case["cdr"])
            assert ros.types().encode(kind, message)[: len(data)] == data
            assert ros.types().decode(kind, data) == message
            assert list(library.fields(kind)) == list(message)
            assert to_message(library.to_object(kind, message)) == message


@pytest.mark.parametrize(
    ("kind", "message", "words"),
    [
        (STRING, {"date": "x"}, "is no std_msgs/msg/String of data: 'date'"),
        (STRING, {"data": 3}, "is no std_msgs/msg/String of data: must be of type"),
        (ARRAY, {"data": [1.0, "x"]}, "could not convert string to float: 'x'"),
        ("somebody_msgs/msg/Secret", {}, "source the workspace that has it"),
    ],
)
def test_message_is_checked_against_its_type(kind, message, words):
    with rclpy_double.installed(), pytest.raises(RosError, match=words):
        Messages().to_object(kind, message)


# ------------------------------------------------------------ of rclpy alone


def test_rclpy_that_is_missing_or_cannot_start_is_told(monkeypatch):
    with pytest.raises(MissionError, match="it comes with ROS 2"):
        RclpyNode()
    with rclpy_double.installed():
        import rclpy

        def fail(**_):
            raise RuntimeError("failed to initialize rcl: rmw_zenoh_cpp is not there")

        monkeypatch.setattr(rclpy, "init", fail)
        with pytest.raises(MissionError, match=r"rclpy cannot start: .*rmw_zenoh.*ros2 topic list"):
            RclpyNode()


def test_rclpy_hears_best_effort_publishers():
    with connected("rclpy") as (host, node):
        best_effort = rclpy_double.ReliabilityPolicy.BEST_EFFORT
        quality = rclpy_double.QoSProfile(depth=1, reliability=best_effort)
        kind = host.types.find(STRING)
        publisher = host.node.create_publisher(kind, "/scan", quality)
        heard = []
        node.subscribe("/scan", STRING, heard.append)
        until(lambda: heard, turn=lambda: publisher.publish(kind(data="x")))
        assert node.is_connected


# ------------------------------------------------------------ of rosbridge alone


def test_call_without_a_connection_fails_at_once():
    texts = []
    with closing(Rosbridge(NOWHERE)) as node:
        with pytest.raises(RosError, match="connection has ended"):
            node.call("/camera/get_state", "", {}).result(60)
        for count in (1, 2):  # who asks later is told, too
            node.watch(lambda _, text: texts.append(text))
            until(lambda count=count: len(texts) >= count)
    assert f"no connection to {NOWHERE}: " in texts[0]


def test_unanswered_call_blocks_no_other_call():
    now = [0.0]
    with connected("rosbridge", clock=lambda: now[0]) as (host, node):
        host.serve("/stuck/ask", ASK, lambda _: None)
        host.serve("/other/ask", ASK, lambda request: request)
        stuck = node.call("/stuck/ask", ASK, {}, 3.0)
        assert node.call("/other/ask", ASK, {"a": 1}).result(60) == {"a": 1}
        now[0] = 3.0
        node.update()
        assert "not answered" in str(stuck.exception())
        host.serve("/stuck/ask", ASK, lambda request: request)
        assert node.call("/stuck/ask", ASK, {"b": 2}).result(60) == {"b": 2}


def test_publications_waiting_at_a_cut_are_sent_later():
    host = RosbridgeDouble()
    heard = []
    with closing(Rosbridge(host.url)) as node:
        until(lambda: node.is_connected)
        host.close()
        until(lambda: not node.is_connected)
        for number in range(QUEUED + 5):  # the last are dropped
            node.publish("/news", "", {"number": number})
        with closing(RosbridgeDouble(host.port)) as again:
            again.subscribe("/news", "", lambda message: heard.append(message["number"]))
            until(lambda: heard == [*range(QUEUED)])


def test_connection_that_is_not_read_is_closed_nevertheless(monkeypatch):
    monkeypatch.setattr("missions.wires.rosbridge._FLUSH_S", 0.01)
    release = threading.Event()
    with closing(RosbridgeDouble()) as host:
        host.do = lambda *_: release.wait(60.0)
        node = Rosbridge(host.url)
        until(lambda: node.is_connected)
        for _ in range(200):
            node.publish("/news", "", {"data": "x" * 2**19})
        started = time.monotonic()
        node.close()
        assert time.monotonic() - started < 10.0
        release.set()


def test_nothing_acknowledged_is_lost_or_done_twice_when_cut():
    """Requests and events go over a connection that is cut at random."""
    rng = random.Random(1)
    stop = threading.Event()
    arrived = []
    heard = []
    acknowledged = []

    def request():
        number = 0
        while not stop.is_set():
            number += 1
            try:
                reply = node.call("/do", "", {"number": number})
                until(reply.done, turn=node.update)
                acknowledged.append(reply.result()["number"])
            except RosError:  # it is not known whether it was done, so it is never sent again
                time.sleep(0.01)
            node.publish("/events", "", {"number": number})

    thread = threading.Thread(target=request)
    with closing(RosbridgeDouble()) as host, closing(Rosbridge(host.url)) as node:
        host.serve("/do", "x", lambda request: arrived.append(request["number"]) or request)
        host.subscribe("/events", "", lambda message: heard.append(message["number"]))
        thread.start()
        for cut in range(10):
            until(lambda cut=cut: len(acknowledged) >= 3 * cut)
            time.sleep(rng.uniform(0.0, 0.05))
            host.cut()
        until(lambda: len(acknowledged) >= 30)
        stop.set()
        thread.join()
    assert set(acknowledged) <= set(arrived)
    for numbers in (arrived, heard):
        assert len(numbers) == len(set(numbers))
