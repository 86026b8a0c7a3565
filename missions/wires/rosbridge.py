"""ROS 2 by rosbridge (protocol v2: JSON over WebSocket): a node on a robot's rosbridge."""

import json
import logging
import time
from collections import deque
from concurrent.futures import Future
from contextlib import AbstractContextManager, suppress
from itertools import count
from threading import Event, Lock, Thread
from typing import Any, Final
from urllib.parse import urlsplit

from missions.engine.mission import MissionError
from missions.engine.registry import needs
from missions.views.facts import plain
from missions.wires.node import NONSENSE, QUEUED, Answer, Heard, Message, Node, Outbox, RosError, begun

PORT: Final = 9090
LARGEST: Final = 2**20
"""Of a message [bytes]."""
_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.25, 8.0
_log = logging.getLogger(__name__)


class Peer(Outbox):
    """One connection."""

    def __init__(self, socket: Any) -> None:  # noqa: ANN401  # websockets is imported late
        super().__init__(lambda message: socket.send(json.dumps(message)))
        self.socket = socket

    def send(self, message: Message) -> None:
        self.put(plain(message))

    def close(self) -> list[Message]:
        left = super().close()
        with suppress(Exception):  # it may be gone
            self.socket.close()
        return left


class Wire(Node):
    """A node by rosbridge's messages, whatever carries them.

    Args:
        sending: held while something is sent that goes with what is open.
    """

    def __init__(self, sending: AbstractContextManager[object]) -> None:
        super().__init__()
        self._sending, self._ids = sending, count(1)
        self._declared: list[Message] = []
        self._subscribed: dict[str, list[Heard]] = {}
        self._advertised: set[str] = set()
        self._served: dict[str, Answer] = {}
        self._open: dict[str, Future[Message]] = {}

    def subscribe(self, topic: str, kind: str, heard: Heard) -> None:
        with self._sending:
            self._subscribed.setdefault(topic, []).append(heard)
            self._declare({"op": "subscribe", "topic": topic, "type": kind})

    def publish(self, topic: str, kind: str, message: Message) -> None:
        with self._sending:
            if topic not in self._advertised:
                self._advertised.add(topic)
                self._declare({"op": "advertise", "topic": topic, "type": kind})
            self._send({"op": "publish", "topic": topic, "msg": message})

    def call(self, service: str, kind: str, request: Message) -> "Future[Message]":
        future, number = begun(), f"call_service:{next(self._ids)}"
        made = {"op": "call_service", "id": number, "service": service, "type": kind, "args": request}
        with self._sending:
            self._open[number] = future  # before it is sent: the answer may be there at once
            if not self._send(made):
                del self._open[number]
                future.set_exception(RosError(f"{service} cannot be called: there is no connection"))
        return future

    def serve(self, service: str, kind: str, answer: Answer) -> None:
        with self._sending:
            self._served[service] = answer
            self._declare({"op": "advertise_service", "service": service, "type": kind})

    def _declare(self, message: Message) -> None:
        """Say what holds from now on, to whoever is the other side then, too."""
        self._declared.append(message)
        self._send(message)

    def _send(self, message: Message) -> bool:
        """Send a message to the other side; tell whether it is there."""
        raise NotImplementedError

    def _hear(self, message: Message) -> None:
        if message["op"] == "publish":
            self.refused.hand_on(dict_of(message, "msg"), self._subscribed[text_of(message, "topic")])
        elif message["op"] == "service_response":
            future = self._open.pop(text_of(message, "id"), None)
            if future is not None:
                _finish(future, message)
        elif message["op"] == "call_service":
            self._send(_answered(self._served[text_of(message, "service")], message))
        elif message["op"] == "status" and message.get("level") in ("error", "warning"):
            _log.warning("the other side of rosbridge says: %s", message.get("msg"))


class Rosbridge(Wire):
    """A node on a robot's rosbridge; connects again by itself, at longer and longer intervals up to 8 s.

    Args:
        url: e.g. "ws://127.0.0.1:9090"; `wss://` for an encrypted one.
        token: sent as `Authorization: Bearer`, where the other side asks for one.

    Raises:
        MissionError: the extra `ros2` is missing, or this is no address.
    """

    def __init__(self, url: str, token: str = "") -> None:
        with needs("ros2", "rosbridge"):
            import websockets.sync.client as client
        if urlsplit(url).scheme not in ("ws", "wss") or not urlsplit(url).hostname:
            raise MissionError(f"{url!r} is no address of a rosbridge; write ws://HOST:{PORT}")
        super().__init__(Lock())
        self._connect = client.connect
        self._url, self._headers = url, {"Authorization": f"Bearer {token}"} if token else {}
        self._closing = Event()
        self._peer: Peer | None = None
        self._unsent: deque[Message] = deque(maxlen=QUEUED)
        self._thread = Thread(target=self._run, name="rosbridge", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._closing.set()
        if (peer := self._peer) is not None:  # read once: the connection may end meanwhile
            peer.close()
        self._thread.join()

    def _send(self, message: Message) -> bool:
        """Send a message; without a connection the last 10,000 that are to be published are kept until there is one."""
        peer = self._peer
        if peer is not None:
            peer.send(message)
        elif message["op"] == "publish":
            self._unsent.append(plain(message))
        return peer is not None

    def _run(self) -> None:
        wait_s, self._away_since = _FIRST_WAIT_S, time.monotonic()
        while not self._closing.is_set():
            try:
                limits: Any = {"max_size": LARGEST, "open_timeout": 5, "close_timeout": 1}
                with self._connect(self._url, additional_headers=self._headers, **limits) as socket:
                    wait_s = _FIRST_WAIT_S
                    self._talk(socket)
            except Exception as error:  # refused, unknown, no WebSocket, wrong token: all are tried again
                said = f"no connection to {self._url}: {error or type(error).__name__}; it is tried again, every "
                said += f"{_LONGEST_WAIT_S:g} s at last: is a rosbridge started there, and is it that address (--url)?"
                self._tell(False, said)
                self._closing.wait(wait_s)
                wait_s = min(2 * wait_s, _LONGEST_WAIT_S)

    def _talk(self, socket: Any) -> None:  # noqa: ANN401  # websockets is imported late
        why = ""
        self._begin(Peer(socket), time.monotonic() - self._away_since)
        try:
            if self._closing.is_set():  # closed while it was being connected: nobody else ends it
                socket.close()
            for text in socket:
                try:
                    self._hear(read(text))
                except NONSENSE as error:
                    self.refused.add(error)
        except Exception as error:  # also one that was cut
            why = f": {error}"
        self._away_since = time.monotonic()
        self._end(f"the connection to {self._url} has ended{why}")

    def _begin(self, peer: Peer, away_s: float) -> None:
        with self._sending:
            for message in self._declared:
                peer.send(message)
            late = deque(self._unsent, maxlen=QUEUED - len(self._declared))  # more would push out what is declared
            for message in late:
                peer.put(message)
            self._unsent.clear()
            self._peer = peer
        missed = f"what was published there meanwhile is missed, {len(late)} of ours are sent now"
        self._tell(True, f"connected to {self._url} after {away_s:.1f} s; {missed}")

    def _end(self, why: str) -> None:
        with self._sending:
            peer, self._peer = self._peer, None
            failed, self._open = self._open, {}
        if peer is not None:
            left = [one for one in peer.close() if one["op"] == "publish"]
            with self._sending:
                self._unsent = deque([*left, *self._unsent], maxlen=QUEUED)
        for future in failed.values():
            future.set_exception(RosError(why))
        if not self._closing.is_set():
            self._tell(False, why)


def read(text: str | bytes) -> Message:
    if isinstance(text, bytes):
        raise ValueError("binary messages are not taken; send JSON (compression none)")
    message = json.loads(text)
    if not isinstance(message, dict) or not isinstance(message.get("op"), str):
        raise ValueError('a message is an object with a text "op"')
    return message


def text_of(message: Message, key: str) -> str:
    value = message.get(key)
    if not isinstance(value, str) or not value:
        raise ValueError(f'{message["op"]} has a text "{key}"')
    return value


def dict_of(message: Message, key: str) -> Message:
    value = message.get(key, {})
    if not isinstance(value, dict):
        raise ValueError(f'"{key}" of {message["op"]} is an object')
    return value


def _finish(future: "Future[Message]", message: Message) -> None:
    values = message.get("values")
    if message.get("result", True) and isinstance(values, dict):
        future.set_result(values)
    else:
        future.set_exception(RosError(f"{message.get('service', 'the service')} failed: {values}"))


def _answered(answer: Answer, message: Message) -> Message:
    made = {"op": "service_response", "id": message.get("id"), "service": message["service"]}
    try:
        return {**made, "values": answer(dict_of(message, "args")), "result": True}
    except RosError as error:
        return {**made, "values": str(error), "result": False}
    except Exception as error:  # ours is not the caller's to suffer
        _log.exception("%s could not be answered", message["service"])
        return {**made, "values": f"{type(error).__name__}: {error}", "result": False}
