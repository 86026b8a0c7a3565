"""One contract of the nodes by rosbridge and by rclpy; and what is theirs alone."""

import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import rclpy_double
from cut_wires import requests_through_cuts
from ros_rig import WIRES, connected, until
from rosbridge_double import RosbridgeDouble

from missions.engine.mission import MissionError
from missions.wires import ros
from missions.wires.node import Refusals, RosError
from missions.wires.rclpy import Messages, RclpyNode
from missions.wires.ros import to_message
from missions.wires.rosbridge import QUEUED, Rosbridge

DATA = Path(__file__).parent / "data"
ARRAY, STRING = "std_msgs/msg/Float64MultiArray", "std_msgs/msg/String"
DIAGNOSTICS, ASK = "diagnostic_msgs/msg/DiagnosticArray", "rosa_msgs/srv/ActionQuery"


@pytest.fixture(params=WIRES)
def wire(request):
    return request.param


@pytest.fixture
def pair(wire):
    """A node, and another one that serves and calls; the graph is between them."""
    with connected(wire) as (host, node):
        other = Rosbridge(host.url) if wire == "rosbridge" else RclpyNode("other")
        other.serve("/other/ask", ASK, lambda one: {"action": one["action"], "success": True})
        until(lambda: wire == "rclpy" or other.is_connected)
        try:
            yield node, other
        finally:
            other.close()


def echo(pair, kind, message):
    """Return a message as the other node hears it."""
    node, other = pair
    heard = []
    other.subscribe("/echo", kind, heard.append)
    until(lambda: heard, turn=lambda: node.publish("/echo", kind, message))
    return heard[0]


def ask(node, service, **request):
    """Return the answer to a call; None while nobody serves it yet."""
    try:
        return node.call(service, ASK, request).result(60)
    except RosError as error:
        return None if "does not exist" in str(error) else {"success": False, "reason": str(error)}


def test_text_comes_over_as_it_was(pair):
    text = {"data": 'é water, "quoted" \n and long ' + "x" * 20_000}
    assert echo(pair, STRING, text) == text


def test_what_is_no_number_comes_over_as_null(pair):
    data = [1.0, -2.5, float("nan"), float("inf"), 1e300]
    sent = {"layout": {"dim": [], "data_offset": 0}, "data": data}
    assert echo(pair, ARRAY, sent)["data"][:3] == [1.0, -2.5, None]


def test_nested_messages_come_over_as_they_were(pair):
    pairs = [{"key": "battery_level", "value": "0.25"}, {"key": "", "value": "é"}]
    about = {"message": "QA status", "hardware_id": ""}
    statuses = [{"level": n, "name": f"n{n}", **about, "values": pairs[:n]} for n in range(3)]
    stamp = {"sec": 1_700_000_000, "nanosec": 999_999_999}
    sent = {"header": {"stamp": stamp, "frame_id": "base"}, "status": statuses}
    assert echo(pair, DIAGNOSTICS, sent) == sent


def test_services_are_called_both_ways(pair):
    node, other = pair
    action = {"name": "explore", "status": "", "is_required": True}
    answer = {"action": action, "success": True}
    until(lambda: ask(node, "/other/ask", action=action, preference="") == answer)
    requests = []
    node.serve("/ours/ask", ASK, lambda one: requests.append(one) or {"action": one["action"]})
    until(lambda: ask(other, "/ours/ask", action=action, preference="é") is not None)
    assert requests[0] == {"action": action, "preference": "é"}


def test_many_threads_get_their_own_answers(pair):
    node = pair[0]
    until(lambda: ask(node, "/other/ask", action={"name": "first"}) is not None)
    names = [f"action {number}" for number in range(60)]
    with ThreadPoolExecutor(6) as pool:
        answers = list(pool.map(lambda name: ask(node, "/other/ask", action={"name": name}), names))
    assert [answer["action"]["name"] for answer in answers] == names


def test_hearer_that_fails_does_not_end_the_node(pair):
    pair[1].subscribe("/echo", STRING, lambda one: one["nothing"])
    assert echo(pair, STRING, {"data": "on"}) == {"data": "on"}


def test_call_that_nobody_serves_fails_in_words(wire):
    now = [0.0]
    with connected(wire, clock=lambda: now[0]) as (_, node):
        future = node.call("/nowhere", ASK, {}, 2.0)

        def turn():
            now[0] += 0.01
            node.update()

        until(future.done, turn=turn)
        assert any(
            words in str(future.exception()) for words in ("nobody serves", "does not exist")
        )


def test_closing_ends_all_threads(wire):
    with connected(wire) as (_, node):
        node.call("/nowhere", ASK, {})
    names = ("rclpy", "rosbridge", "ros-send")
    until(lambda: not [one for one in threading.enumerate() if one.name in names])


def test_refusals_log_each_kind_once(caplog):
    refusals = Refusals()
    for number in range(300):
        refusals.add(f"kind {number}")
        refusals.add("kind 0")
    assert (refusals["kind 0"], refusals["something else"], len(refusals)) == (301, 200, 101)
    assert caplog.text.count("refused: kind 0\n") == 1


# ------------------------------------------------------------ types


def test_definitions_of_rosa_have_the_fields_in_their_order():
    known = ros.types().store.fielddefs
    types = json.loads((DATA / "rosa_fields.json").read_text())["types"]
    assert len(types) == 25
    for name, parts in types.items():
        for part, fields in parts.items():
            kind = f"rosa_msgs/msg/{name}"
            if part != "fields":
                kind = f"rosa_msgs/srv/{name}_{part.capitalize()}"
            names = [field for field, _ in known[kind][1] if field != ros.NOTHING]
            assert names == [field for _, field in fields], kind


def test_bytes_are_those_of_ros_2_and_of_rosbags():
    messages = json.loads((DATA / "ros2_cdr.json").read_text())["messages"]
    assert len(messages) == 9
    with rclpy_double.installed():
        library = Messages()
        for one in messages:
            data, types = bytes.fromhex(one["cdr"]), ros.types()
            assert types.encode(one["type"], one["fields"])[: len(data)] == data
            assert types.decode(one["type"], data) == one["fields"]
            assert list(library.fields(one["type"])) == list(one["fields"])
            assert to_message(library.to_object(one["type"], one["fields"])) == one["fields"]


def test_messages_are_checked_against_their_types():
    with rclpy_double.installed():
        library = Messages()
        for kind, message, words in (
            (STRING, {"date": "x"}, "no field 'date'; it has data"),
            (STRING, {"data": 3}, "is no std_msgs/msg/String: must be of type"),
            (ARRAY, {"data": [1.0, "x"]}, "could not convert string to float: 'x'"),
            (ARRAY, {"data": 3.0}, "not iterable"),
            ("std_msgs/msg/Bool", {"data": 1}, "is no std_msgs/msg/Bool"),
            ("somebody_msgs/msg/Secret", {}, "source the workspace that has it"),
        ):
            with pytest.raises(RosError, match=words):
                library.to_object(kind, message)


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
        quality = rclpy_double.QoSProfile(
            depth=1, reliability=rclpy_double.ReliabilityPolicy.BEST_EFFORT
        )
        kind = host.types.find(STRING)
        publisher = host.node.create_publisher(kind, "/scan", quality)
        heard = []
        node.subscribe("/scan", STRING, heard.append)
        until(lambda: heard, turn=lambda: publisher.publish(kind(data="x")))
        assert node.is_connected


# ------------------------------------------------------------ of rosbridge alone


def test_call_without_a_connection_fails_at_once():
    node = Rosbridge("ws://127.0.0.1:9")
    with pytest.raises(RosError, match="no connection"):
        node.call("/camera/get_state", "", {}).result(60)
    for _ in range(2):  # who asks later is told, too
        told, texts = threading.Event(), []
        node.watch(lambda _, text, told=told, texts=texts: (texts.append(text), told.set()))
        assert told.wait(60.0)
        assert "no connection to ws://127.0.0.1:9: " in texts[0]
    node.close()


def test_unanswered_call_blocks_no_other_call():
    now = [0.0]
    with connected("rosbridge", clock=lambda: now[0]) as (host, node):
        host.serve("/stuck/ask", ASK, lambda _: None)
        host.serve("/other/ask", ASK, lambda one: one)
        stuck = node.call("/stuck/ask", ASK, {}, 3.0)
        assert node.call("/other/ask", ASK, {"a": 1}).result(60) == {"a": 1}
        now[0] = 3.0
        node.update()
        assert "not answered" in str(stuck.exception())
        host.serve("/stuck/ask", ASK, lambda one: one)
        assert node.call("/stuck/ask", ASK, {"b": 2}).result(60) == {"b": 2}


def test_publications_waiting_at_a_cut_are_sent_later():
    host, heard = RosbridgeDouble(), []
    port = host.port
    node = Rosbridge(host.url)
    until(lambda: node.is_connected)
    host.close()
    until(lambda: not node.is_connected)
    for number in range(500):
        node.publish("/news", "", {"number": number})
    again = RosbridgeDouble(port)
    again.subscribe("/news", "", lambda one: heard.append(one["number"]))
    until(lambda: heard == [*range(500)])
    node.close()
    again.close()


def test_full_queue_drops_old_publications_only():
    node = Rosbridge("ws://127.0.0.1:9")
    for number in range(QUEUED + 5):
        node.publish("/news", "", {"number": number})
    numbers = [message["msg"]["number"] for message in node._main.queue]
    assert (len(numbers), numbers[-1]) == (QUEUED, QUEUED + 4)
    node.close()


def test_connection_that_is_not_read_is_closed_nevertheless(monkeypatch):
    monkeypatch.setattr("missions.wires.rosbridge._FLUSH_S", 0.01)
    release = threading.Event()
    host = RosbridgeDouble()
    host.do = lambda *_: release.wait(60.0)
    node = Rosbridge(host.url)
    until(lambda: node.is_connected)
    for _ in range(200):
        node.publish("/news", "", {"data": "x" * 2**19})
    started = time.monotonic()
    node.close()
    assert time.monotonic() - started < 10.0
    release.set()
    host.close()


def test_nothing_acknowledged_is_lost_or_done_twice_when_cut():
    outcome = requests_through_cuts(1, cuts=10)
    assert outcome.acknowledged >= 30
    assert (outcome.lost, outcome.doubled) == (0, 0)
