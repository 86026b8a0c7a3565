"""Publishes a running tree to Groot2, as BehaviorTree.CPP's Groot2Publisher does (protocol 2).

    publisher = Groot2Publisher(tree)       # a py_trees.trees.BehaviourTree
    ...                                     # ticks as before
    publisher.close()

Groot2 asks, over ZeroMQ on TCP port 1667, for the tree as XML, the statuses of its nodes and its
blackboards. The protocol has no token, so it is served on this machine only; from elsewhere, use
`ssh -L 1667:127.0.0.1:1667 ROBOT`. Requests that would change how the tree runs (breakpoints,
replaced nodes) are refused. So are recordings of transitions; use `rosa run --record` or `--report`
instead.
"""

import struct
import threading
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple
from uuid import uuid4

from py_trees.behaviour import Behaviour
from py_trees.blackboard import Blackboard
from py_trees.common import Status
from py_trees.trees import BehaviourTree

from missions.engine.mission import MissionError, needs
from rosa_bt.xml import NumberedTree

PORT: Final = 1667
_PROTOCOL: Final = 2
_HEAD: Final = struct.Struct("<BBI")
"""The head of a request: protocol, letter of its kind, number."""
_STATUS: Final = struct.Struct("<HB")
_IDLE, _WAS = 0, 10
"""The code of an idle node is 10 + the status that it had before, or 0 if it never had one."""
_CODES: Final = {Status.RUNNING: 1, Status.SUCCESS: 2, Status.FAILURE: 3}
_LOOK_MS: Final = 100
_REFUSED: Final = (
    "served are only T, S, B and D of protocol 2: breakpoints and replaced nodes are not accepted, "
    "and `rosa run --record FILE.mcap` records transitions"
)


class _Present(NamedTuple):
    """The tree after a tick."""

    tree: NumberedTree
    identity: bytes
    """A new one for each tree, so that a client asks for the tree again."""
    codes: Mapping[Behaviour, int]


class Groot2Publisher:
    """Publishes the statuses of a tree after each tick, and the tree again when it changes.

    A tick only writes down the statuses; a thread of its own answers clients, so they do not slow
    the tick.

    Args:
        port: TCP port on 127.0.0.1.

    Raises:
        MissionError: the port is taken, or the extra `groot2` is missing.
    """

    def __init__(self, tree: BehaviourTree, port: int = PORT) -> None:
        with needs("groot2", "Groot2's wire"):
            import msgpack
            import zmq
        self._pack = msgpack.packb
        self._tree = tree
        self._present = self._new_present()
        self._context = zmq.Context()
        self._context.setsockopt(zmq.LINGER, 0)
        try:
            self._socket = self._context.socket(zmq.REP)
            self._socket.bind(f"tcp://127.0.0.1:{port}")
        except zmq.ZMQError as error:
            self._context.destroy()
            raise MissionError(
                f"Groot2's wire needs the TCP port {port} of this machine: {error}"
                "; give another port"
            ) from None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="groot2", daemon=True)
        self._thread.start()
        tree.add_post_tick_handler(self._tick)

    def close(self) -> None:
        """Stop publishing, and free the ports."""
        self._tree.post_tick_handlers.remove(self._tick)
        self._closing.set()
        self._thread.join()

    def _tick(self, tree: BehaviourTree) -> None:
        """Write down the status of each node after a tick."""
        before = self._present
        if not before.tree.shows(tree.root):
            before = self._new_present()
        codes = {node: self._code(node, code) for node, code in before.codes.items()}
        self._present = before._replace(codes=codes)

    def _new_present(self) -> _Present:
        tree = NumberedTree(self._tree.root)
        codes = {node: _CODES.get(node.status, _IDLE) for node in tree.numbers}
        return _Present(tree, uuid4().bytes, codes)

    def _code(self, node: Behaviour, before: int) -> int:
        if node.status in _CODES:
            return _CODES[node.status]
        return before if before == _IDLE or before > _WAS else _WAS + before

    def _serve(self) -> None:
        while not self._closing.is_set():
            if self._socket.poll(_LOOK_MS):
                head, *more = self._socket.recv_multipart()
                try:
                    frames = self._answer(head, b"".join(more[:1]), self._present)
                except Exception as error:  # e.g. a value on a blackboard that has no text
                    reason = f"that cannot be shown: {type(error).__name__}: {error}"
                    frames = [b"error", reason.encode(errors="replace")]
                self._socket.send_multipart(frames)
        self._context.destroy()

    def _answer(self, head: bytes, argument: bytes, present: _Present) -> list[bytes]:
        kind = chr(head[1]) if len(head) == _HEAD.size and head[0] == _PROTOCOL else ""
        if kind == "T":
            answer = present.tree.xml.encode()
        elif kind == "S":
            numbers = present.tree.numbers.items()
            answer = b"".join(_STATUS.pack(number, present.codes[node]) for node, number in numbers)
        elif kind == "B":
            boards = _boards(present.tree, argument.decode(errors="replace").split(";"))
            answer = self._pack(boards, default=repr)  # a large number has a text, too
        elif kind == "D":
            answer = b"[]"
        else:
            return [b"error", _REFUSED.encode()]
        return [head + present.identity, answer]


def _boards(tree: NumberedTree, names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the entries of blackboards by the names of these, of all if none is known."""
    chosen = [name for name in names if name in tree.subtrees] or list(tree.subtrees)
    boards = {}
    for name in chosen:
        subtree = tree.subtrees[name]
        board = Blackboard.storage if subtree is None else subtree.blackboard
        entries = list(board.items())  # a tick may write meanwhile
        boards[name] = {key.lstrip("/"): value for key, value in entries}
    return boards
