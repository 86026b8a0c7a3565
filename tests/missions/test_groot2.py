"""Groot2's wire, asked by an independent client of BehaviorTree.CPP's publisher, and by hand."""

import socket
import struct
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

S = Status.SUCCESS
F = Status.FAILURE
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
        return Status.RUNNING


def free_port():
    with socket.socket() as some:
        some.bind(("127.0.0.1", 0))
        return some.getsockname()[1]


@contextmanager
def watched(root):
    tree = BehaviourTree(root)
    publisher = None
    while publisher is None:
        port = free_port()
        with suppress(MissionError):  # that port is taken
            publisher = Groot2Publisher(tree, port)
    client = Groot2Client(port=port, timeout_ms=120_000)
    try:
        yield tree, client
    finally:
        client.close()
        publisher.close()


def statuses(client):
    names = {node.uid: node.name or node.registration for node in client.fetch_tree().walk()}
    states = client.poll().statuses
    return {names[uid]: (state.status, state.previous) for uid, state in states.items()}


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
    search = Sequence("search", memory=True, children=[Work("swim")])
    return Selector("mission", memory=False, children=[first, search])


def test_own_tree_is_shown_tick_by_tick():
    with watched(own_tree()) as (tree, client):
        kinds = {n.name: (n.registration, n.kind.name) for n in client.fetch_tree().walk()}
        assert kinds["mission"] == ("ReactiveFallback", "CONTROL")
        assert kinds["swim"] == ("Work", "ACTION")
        assert {status for status, _ in statuses(client).values()} == {NodeStatus.IDLE}
        tree.tick()
        shown = {name: status.name for name, (status, _) in statuses(client).items()}
        running = dict.fromkeys(("mission", "search", "swim"), "RUNNING")
        assert shown == {**running, "look": "FAILURE"}
        tree.tick()
        shown = statuses(client)
        assert shown["mission"][0] is NodeStatus.SUCCESS
        assert shown["swim"] == (NodeStatus.IDLE, NodeStatus.RUNNING), "what it was before"
        identity = client.tree_uuid
        tree.insert_subtree(Success("new"), tree.root.id, 0)
        tree.tick()
        assert statuses(client)["new"][0] is NodeStatus.SUCCESS
        assert client.tree_uuid != identity


def test_tree_loaded_is_shown_with_its_subtrees_and_blackboards():
    registry = BehaviourRegistry()
    registry.register("Work", Work)
    with watched(load_xml(LOADED, registry)) as (tree, client):
        tree.tick()
        nodes = list(client.fetch_tree().walk())
        states = client.poll().statuses
        shown = {node.name or node.registration: states[node.uid].status.name for node in nodes}
        assert len({node.uid for node in nodes}) == len(nodes) == 9
        assert shown["first dock"] == "RUNNING"
        assert shown["AlwaysSuccess"] == shown["second dock"] == "IDLE"
        assert client.fetch_blackboard(["Main"]) == {"Main": {"left": 3}}
        assert client.fetch_blackboard().keys() == {"Main", "first dock", "second dock"}


class Untold:
    """A value that has no text."""

    def __repr__(self):
        raise ValueError("no text")


@pytest.mark.parametrize(
    ("frames", "value", "words"),
    [
        ([b"\x01T\0\0\0\0"], 0, "of protocol 2"),
        ([head("I"), b"{}"], 0, "not accepted"),
        ([head("B"), b""], Untold(), "that cannot be shown: ValueError: no text"),
    ],
)
def test_request_refused_is_told_and_the_next_is_answered(monkeypatch, frames, value, words):
    monkeypatch.setitem(Blackboard.storage, "/odd", value)
    with watched(own_tree()) as (tree, client):
        kind, text = ask(client, *frames)
        assert kind == b"error"
        assert words in text.decode()
        tree.tick()
        assert statuses(client)["look"][0] is NodeStatus.FAILURE


def test_number_beyond_64_bits_is_shown_as_text(monkeypatch):
    monkeypatch.setitem(Blackboard.storage, "/huge", 2**70)
    with watched(own_tree()) as (_, client):
        (board,) = msgpack.unpackb(ask(client, head("B"), b"")[1]).values()
        assert board["huge"] == str(2**70)


def test_port_taken_is_told():
    with watched(own_tree()) as (tree, client):
        port = client.port
        with pytest.raises(MissionError, match=f"TCP port {port} of"):
            Groot2Publisher(tree, port)
