"""Publishes a running tree to Groot2, as BehaviorTree.CPP's Groot2Publisher does (protocol 2).

    publisher = Groot2Publisher(tree)       # a py_trees.trees.BehaviourTree
    ...                                     # ticks as before
    publisher.close()

Groot2 asks, over ZeroMQ on TCP port 1667, for the tree as XML, the statuses of its nodes and its
blackboards. The protocol has no token, so it is served on this machine only; from elsewhere, use
`ssh -L 1667:127.0.0.1:1667 -L 1668:127.0.0.1:1668 ROBOT`. Requests that would change how the tree
runs (breakpoints, replaced nodes) are refused. So are recordings of transitions; use `rosa run
--record` or `--report` instead.
"""

import struct
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple
from uuid import uuid4

from py_trees.behaviour import Behaviour
from py_trees.blackboard import Blackboard
from py_trees.common import Status
from py_trees.trees import BehaviourTree
from py_trees.visitors import VisitorBase

from missions.engine.mission import MissionError, needs
from rosa_bt.xml import NumberedTree

PORT: Final = 1667
_HEAD: Final = struct.Struct("<BBI")
"""The head of a request: protocol, letter of its kind, number."""
_PROTOCOL: Final = 2
_STATUS: Final = struct.Struct("<HB")
_LARGEST_REQUEST: Final = 2**16
_IDLE, _SKIPPED, _WAS = 0, 4, 10
"""The code of an idle node is 10 + the status that it had before, or 0 if it never had one."""
_CODES: Final = {Status.INVALID: _IDLE, Status.RUNNING: 1, Status.SUCCESS: 2, Status.FAILURE: 3}
_LOOK_MS: Final = 100
_NO_RECORD: Final = (
    "transitions are not recorded here: `rosa run --record FILE.mcap` and `--report` do it"
)
_NO_HOOKS: Final = (
    "breakpoints and replaced nodes are not accepted: a robot does what its own program says"
)
_NOT_SERVED: Final = {**dict.fromkeys("IRUAX", _NO_HOOKS), **dict.fromkeys("rt", _NO_RECORD)}


class _Present(NamedTuple):
    """The tree after a tick."""

    tree: NumberedTree
    identity: bytes
    """A new one for each tree, so that a client asks for the tree again."""
    codes: Mapping[Behaviour, int]

    def statuses(self) -> bytes:
        return b"".join(
            _STATUS.pack(number, self.codes[node]) for node, number in self.tree.numbers.items()
        )


class Groot2Publisher(VisitorBase):
    """Publishes the statuses of a tree after each tick, and the tree again when it changes.

    A tick only writes down the statuses; a thread of its own answers clients, so they do not slow
    the tick.

    Args:
        port: TCP port on 127.0.0.1; the next port is used too, as clients listen there for
            breakpoints.

    Raises:
        MissionError: a port is taken, or the extra `groot2` is missing.
    """

    def __init__(self, tree: BehaviourTree, port: int = PORT) -> None:
        super().__init__(full=False)
        with needs("groot2", "Groot2's wire"):
            import msgpack
            import zmq
        self._tree = tree
        self._visited: set[Behaviour] = set()
        self._present = self._seen(None)
        self._packed = msgpack.packb
        self._context = zmq.Context()
        self._context.setsockopt(zmq.LINGER, 0)
        try:
            self._socket = self._bound(zmq.REP, port)
            self._notices = self._bound(zmq.PUB, port + 1)
        except zmq.ZMQError as error:
            self._context.destroy()
            taken = (
                f"Groot2's wire needs the TCP ports {port} and {port + 1} of this machine: {error}"
            )
            raise MissionError(f"{taken}; give another port") from None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="groot2", daemon=True)
        self._thread.start()
        tree.visitors.append(self)

    def close(self) -> None:
        """Stop publishing, and free the ports."""
        if self in self._tree.visitors:
            self._tree.visitors.remove(self)
        self._closing.set()
        self._thread.join()

    def initialise(self) -> None:
        self._visited.clear()

    def run(self, behaviour: Behaviour) -> None:
        """Note a node that is ticked: if it is INVALID then, it was skipped, not idle."""
        self._visited.add(behaviour)

    def finalise(self) -> None:
        """Write down the status of each node after a tick."""
        self._present = self._seen(self._present)

    def _seen(self, before: _Present | None) -> _Present:
        if before is None or not before.tree.shows(self._tree.root):
            tree = NumberedTree(self._tree.root)
            before = _Present(tree, uuid4().bytes, dict.fromkeys(tree.numbers, _IDLE))
        codes = {node: self._code(node, code) for node, code in before.codes.items()}
        return _Present(before.tree, before.identity, codes)

    def _code(self, node: Behaviour, before: int) -> int:
        if node.status is not Status.INVALID:
            return _CODES[node.status]
        if node in self._visited:
            return _SKIPPED
        return before if before == _IDLE or before > _WAS else _WAS + before

    def _bound(self, kind: int, port: int) -> Any:  # noqa: ANN401  # zmq is imported late
        import zmq

        socket = self._context.socket(kind)
        socket.setsockopt(zmq.MAXMSGSIZE, _LARGEST_REQUEST)
        socket.bind(f"tcp://127.0.0.1:{port}")
        return socket

    def _serve(self) -> None:
        while not self._closing.is_set():
            if self._socket.poll(_LOOK_MS):
                frames = self._socket.recv_multipart()
                try:
                    answer = self._answer(frames)
                except (
                    Exception
                ) as error:  # e.g. a value on a blackboard that has no text; the next is answered
                    answer = _refusal(f"that cannot be shown: {type(error).__name__}: {error}")
                self._socket.send_multipart(answer)
        self._context.destroy()

    def _answer(self, frames: Sequence[bytes]) -> list[bytes]:
        head, argument = frames[0], b"".join(frames[1:2])
        if len(head) != _HEAD.size or head[0] != _PROTOCOL:
            return _refusal(
                f"a request begins with 6 bytes: {_PROTOCOL}, a letter and a number of 4 bytes"
            )
        kind, present = chr(head[1]), self._present
        served: Mapping[str, Callable[[], bytes]] = {
            "T": present.tree.xml.encode,
            "S": present.statuses,
            "B": lambda: self._packed(
                self._boards(present.tree, argument.decode(errors="replace").split(";"))
            ),
            "D": lambda: b"[]",
        }
        if kind not in served:
            return _refusal(
                _NOT_SERVED.get(kind, f"unknown request {kind!r}; served are {' '.join(served)}")
            )
        return [head + present.identity, served[kind]()]

    def _boards(self, tree: NumberedTree, names: Sequence[str]) -> Mapping[str, Mapping[str, Any]]:
        chosen = [name for name in names if name in tree.subtrees] or list(tree.subtrees)
        return {
            name: _values(None if (one := tree.subtrees[name]) is None else one.blackboard)
            for name in chosen
        }


def _values(subtree: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return a blackboard's entries, others than numbers as text; a tick may write meanwhile."""
    board = Blackboard.storage if subtree is None else subtree
    return {
        key.lstrip("/"): one if _is_plain(one) else repr(one) for key, one in list(board.items())
    }


def _is_plain(value: object) -> bool:
    """Return whether the wire can hold a value as it is; it has integers of 64 bits."""
    return isinstance(value, float | str) or (isinstance(value, int) and value.bit_length() < 64)


def _refusal(why: str) -> list[bytes]:
    return [b"error", why.encode(errors="replace")]
