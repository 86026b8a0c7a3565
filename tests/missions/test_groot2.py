"""Groot2's wire, asked by an independent client of BehaviorTree.CPP's publisher, and by hand."""

import socket
import struct
import sys
from contextlib import contextmanager, suppress

import msgpack
import pytest
import zmq
from btview.client import Groot2Client
from btview.model import NodeStatus
from py_trees.behaviour import Behaviour
from py_trees.behaviours import StatusQueue, Success
from py_trees.blackboard import Blackboard
from py_trees.common import Status
from py_trees.composites import Selector, Sequence
from py_trees.trees import BehaviourTree

from missions.engine.mission import MissionError
from missions.wires.groot2 import Groot2Publisher
from rosa_bt import BehaviourRegistry, load_xml

S, F, R = Status.SUCCESS, Status.FAILURE, Status.RUNNING
LOADED = """
<root BTCPP_format="4" main_tree_to_execute="Main">
  <BehaviorTree ID="Main">
    <Sequence name="mission">
      <Script code=" left := 3 "/>
      <AlwaysSuccess _skipIf="left == 3"/>
      <SubTree ID="Dock" name="first dock"/>
      <SubTree ID="Dock" name="second dock"/>
    </Sequence>
  </BehaviorTree>
  <BehaviorTree ID="Dock"><Inverter><Work/></Inverter></BehaviorTree>
</root>
"""


class Work(Behaviour):
    """Runs for ever."""

    def initialise(self): ...

    def update(self):
        return R


def free_port():
    for _ in range(100):
        with socket.socket() as one, socket.socket() as next_one:
            one.bind(("127.0.0.1", 0))
            port = one.getsockname()[1]
            try:
                next_one.bind(("127.0.0.1", port + 1))
            except OSError:
                continue
            return port
    raise AssertionError("no two free ports in a row")


@contextmanager
def watched(root):
    tree, publisher = BehaviourTree(root), None
    while publisher is None:
        port = free_port()
        with suppress(MissionError):  # somebody else has taken it meanwhile
            publisher = Groot2Publisher(tree, port)
    client = Groot2Client(port=port, timeout_ms=120_000)
    try:
        yield tree, client
    finally:
        client.close()
        publisher.close()


def statuses(client):
    names = {node.uid: node.name or node.registration for node in client.fetch_tree().walk()}
    return {
        names[uid]: (state.status, state.previous) for uid, state in client.poll().statuses.items()
    }


def ask(client, *frames):
    with zmq.Context() as context, context.socket(zmq.REQ) as one:
        one.setsockopt(zmq.RCVTIMEO, 120_000)
        one.connect(f"tcp://127.0.0.1:{client.port}")
        one.send_multipart(frames)
        return one.recv_multipart()


def head(kind):
    return struct.pack("<BBI", 2, ord(kind), 7)


def own_tree():
    first = StatusQueue("look", [F, S, S], eventually=S)
    return Selector(
        "mission",
        memory=False,
        children=[first, Sequence("search", memory=True, children=[Work("swim")])],
    )


def test_own_tree_is_shown_tick_by_tick():
    with watched(own_tree()) as (tree, client):
        assert {status for status, _ in statuses(client).values()} == {NodeStatus.IDLE}
        tree.tick()
        assert {name: one[0].name for name, one in statuses(client).items()} == {
            **{"mission": "RUNNING", "look": "FAILURE", "search": "RUNNING", "swim": "RUNNING"}
        }
        tree.tick()
        now = statuses(client)
        assert now["mission"][0] is NodeStatus.SUCCESS
        assert now["swim"] == (NodeStatus.IDLE, NodeStatus.RUNNING), (
            "what has just become idle says what it was"
        )


def test_kinds_of_nodes_are_shown():
    with watched(own_tree()) as (_, client):
        kinds = {
            node.name: (node.registration, node.kind.name) for node in client.fetch_tree().walk()
        }
    assert kinds["mission"] == ("ReactiveFallback", "CONTROL")
    assert kinds["search"] == ("Sequence", "CONTROL")
    assert kinds["swim"] == ("Work", "ACTION")


def test_loaded_tree_is_shown_with_its_subtrees_and_blackboards():
    registry = BehaviourRegistry()
    registry.register("Work", Work)
    with watched(load_xml(LOADED, registry)) as (tree, client):
        tree.tick()
        nodes = list(client.fetch_tree().walk())
        now = client.poll().statuses
        shown = {node.name or node.registration: now[node.uid].status.name for node in nodes}
        assert len({node.uid for node in nodes}) == len(nodes) == 9
        assert (shown["first dock"], shown["AlwaysSuccess"]) == ("RUNNING", "SKIPPED")
        assert shown["second dock"] == "IDLE"
        assert client.fetch_blackboard(["Main"]) == {"Main": {"left": 3}}
        assert client.fetch_blackboard().keys() == {"Main", "first dock", "second dock"}


def test_tree_that_changes_is_another_tree():
    with watched(own_tree()) as (tree, client):
        tree.tick()
        statuses(client)
        before = client.tree_uuid
        tree.insert_subtree(Success("new"), tree.root.id, 0)
        tree.tick()
        assert statuses(client)["new"][0] is NodeStatus.SUCCESS
        assert client.tree_uuid != before


@pytest.mark.parametrize(
    ("frames", "said"),
    [
        ([b""], "begins with 6 bytes"),
        ([b"\x01T\0\0\0\0"], "begins with 6 bytes"),
        ([head("Z")], "unknown request 'Z'"),
        ([head("I"), b"{}"], "not accepted"),
        ([head("r"), b"\xff" * 40], "not recorded here"),
        ([b"\x00" * 10_000, b"x" * 10_000], "begins with 6 bytes"),
    ],
)
def test_nonsense_is_refused_in_words_and_the_next_is_answered(frames, said):
    with watched(own_tree()) as (tree, client):
        refused = ask(client, *frames)
        assert refused[0] == b"error"
        assert said in refused[1].decode()
        tree.tick()
        assert statuses(client)["look"][0] is NodeStatus.FAILURE


class Untold:
    """A value that has no text."""

    def __repr__(self):
        raise ValueError("no text")


@pytest.mark.parametrize(
    ("value", "said"),
    [(Untold(), b"that cannot be shown: ValueError: no text"), ("\ud800", b"UnicodeEncodeError")],
)
def test_value_that_cannot_be_shown_is_refused_and_the_next_is_answered(value, said):
    with watched(own_tree()) as (tree, client):
        Blackboard.storage["/odd"] = value
        try:
            refused = ask(client, head("B"), b"")
        finally:
            del Blackboard.storage["/odd"]
        assert refused[0] == b"error"
        assert said in refused[1]
        tree.tick()
        assert statuses(client)["look"][0] is NodeStatus.FAILURE


def test_number_beyond_64_bits_is_shown_as_text():
    with watched(own_tree()) as (_, client):
        Blackboard.storage["/huge"] = 2**70
        try:
            shown = msgpack.unpackb(ask(client, head("B"), b"")[1])
        finally:
            del Blackboard.storage["/huge"]
        assert [board["huge"] for board in shown.values()] == [str(2**70)]


def test_message_without_end_is_cut_and_the_next_is_answered():
    with watched(own_tree()) as (tree, client):
        with zmq.Context() as context, context.socket(zmq.REQ) as one:
            one.setsockopt(zmq.LINGER, 0)
            one.connect(f"tcp://127.0.0.1:{client.port}")
            one.send(b"x" * 10_000_000)
        tree.tick()
        assert statuses(client)["look"][0] is NodeStatus.FAILURE


def test_taken_port_is_told():
    with (
        watched(own_tree()) as (tree, client),
        pytest.raises(MissionError, match=f"TCP ports {client.port} and"),
    ):
        Groot2Publisher(tree, client.port)


def test_missing_extra_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "zmq", None)
    with pytest.raises(MissionError, match=r"pip install 'rosa-taca\[groot2\]'"):
        Groot2Publisher(BehaviourTree(own_tree()))
