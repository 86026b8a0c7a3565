"""ROS 2 by rosbridge (protocol v2: JSON over WebSocket): a client of a robot's rosbridge, and a server of our own.

With the server, roslib, Foxglove, other bridges and robots connect to us without ROS. It is a `Node` too: one of its
own clients, without a connection.
"""

import json
import logging
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext, suppress
from hmac import compare_digest
from itertools import count
from socket import SHUT_RDWR
from threading import Event, Lock, RLock, Thread
from typing import Any, Final, NamedTuple, cast
from urllib.parse import parse_qs, urlsplit

from missions.engine.mission import MissionError, needs
from missions.views.output import plain
from missions.wires.node import (
    LOOPBACK,
    NONSENSE,
    QUEUED,
    Answer,
    Heard,
    Message,
    Node,
    Outbox,
    RosError,
    begun,
)

PORT: Final = 9090
_LARGEST: Final = 2**20
"""The longest message [bytes]."""
_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.25, 8.0
_MOST_CLIENTS: Final = 200
_log = logging.getLogger(__name__)


class Peer(Outbox):
    """One connection, with a queue of messages to send."""

    def __init__(self, socket: Any) -> None:  # noqa: ANN401  # websockets is imported late
        super().__init__(lambda message: socket.send(json.dumps(message)))
        self.socket = socket

    def send(self, message: Message) -> None:
        self.put(plain(message))

    def close(self) -> list[Message]:
        left = super().close()
        if (
            left
        ):  # the other side does not read, so it would not answer the closing handshake either
            with suppress(OSError):
                self.socket.socket.shutdown(SHUT_RDWR)
        with suppress(Exception):  # it may be gone
            self.socket.close()
        return left


class Wire(Node):
    """A node that speaks rosbridge's messages, without saying what carries them.

    Args:
        sending: a lock, held while a message is sent and what it opens or declares is noted.
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
        made = {
            "op": "call_service",
            "id": number,
            "service": service,
            "type": kind,
            "args": request,
        }
        with self._sending:
            self._open[number] = future  # before it is sent, as the answer may come at once
            if not self._send(made):
                del self._open[number]
                future.set_exception(
                    RosError(f"{service} cannot be called: there is no connection")
                )
        return future

    def serve(self, service: str, kind: str, answer: Answer) -> None:
        with self._sending:
            self._served[service] = answer
            self._declare({"op": "advertise_service", "service": service, "type": kind})

    def _declare(self, message: Message) -> None:
        """Send a declaration (subscribe, advertise), now and again after each reconnection."""
        self._declared.append(message)
        self._send(message)

    def _send(self, message: Message) -> bool:
        """Send a message to the other side; return whether there is a connection."""
        raise NotImplementedError

    def _hear(self, message: Message) -> None:
        if message["op"] == "publish":
            self.refused.hand_on(
                _dict_of(message, "msg"), self._subscribed[_text_of(message, "topic")]
            )
        elif message["op"] == "service_response":
            future = self._open.pop(_text_of(message, "id"), None)
            if future is not None:
                _finish(future, message)
        elif message["op"] == "call_service":
            self._send(_answered(self._served[_text_of(message, "service")], message))
        elif message["op"] == "status" and message.get("level") in ("error", "warning"):
            _log.warning("the other side of rosbridge says: %s", message.get("msg"))


class Rosbridge(Wire):
    """A client of a robot's rosbridge; it reconnects by itself, at intervals that grow up to 8 s.

    Args:
        url: e.g. "ws://127.0.0.1:9090"; `wss://` for an encrypted one.
        token: sent as `Authorization: Bearer TOKEN`, if the server asks for one.

    Raises:
        MissionError: the extra `ros2` is missing, or `url` is not the address of a rosbridge.
    """

    def __init__(self, url: str, token: str = "") -> None:
        with needs("ros2", "rosbridge"):
            import websockets.sync.client as client
        if urlsplit(url).scheme not in ("ws", "wss") or not urlsplit(url).hostname:
            raise MissionError(f"{url!r} is not the address of a rosbridge; write ws://HOST:{PORT}")
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
        if (peer := self._peer) is not None:  # read once, as the connection may end meanwhile
            peer.close()
        self._thread.join()

    def _send(self, message: Message) -> bool:
        """Send a message; without a connection, keep the last 10,000 publications until there is one."""
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
                limits: Any = {"max_size": _LARGEST, "open_timeout": 5, "close_timeout": 1}
                with self._connect(self._url, additional_headers=self._headers, **limits) as socket:
                    wait_s = _FIRST_WAIT_S
                    self._talk(socket)
            except (
                Exception
            ) as error:  # refused, unknown host, no WebSocket, wrong token: try again
                said = f"no connection to {self._url}: {error or type(error).__name__}; it tries again, at last every "
                said += f"{_LONGEST_WAIT_S:g} s. Is a rosbridge running there, and is the address (--url) right?"
                self._tell(False, said)
                self._closing.wait(wait_s)
                wait_s = min(2 * wait_s, _LONGEST_WAIT_S)

    def _talk(self, socket: Any) -> None:  # noqa: ANN401  # websockets is imported late
        why = ""
        self._begin(Peer(socket), time.monotonic() - self._away_since)
        try:
            if (
                self._closing.is_set()
            ):  # `close` came while it connected and did not see this socket
                socket.close()
            for text in socket:
                try:
                    self._hear(_read(text))
                except NONSENSE as error:
                    self.refused.add(error)
        except Exception as error:  # also of a connection that was cut
            why = f": {error}"
        self._away_since = time.monotonic()
        self._end(f"the connection to {self._url} has ended{why}")

    def _begin(self, peer: Peer, away_s: float) -> None:
        with self._sending:
            for message in self._declared:
                peer.send(message)
            late = deque(
                self._unsent, maxlen=QUEUED - len(self._declared)
            )  # more would push out the declarations
            for message in late:
                peer.put(message)
            self._unsent.clear()
            self._peer = peer
        missed = f"messages published there meanwhile are lost, {len(late)} of ours are sent now"
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


class _Client:
    """A client of the server: types of what it advertises, subscribes to and serves; `send` gives it a message."""

    def __init__(self, send: Callable[[Message], object]) -> None:
        self.send = send
        self.said: dict[str, dict[str, str]] = {
            "advertise": {},
            "subscribe": {},
            "advertise_service": {},
        }

    def say(self, op: str, message: Message) -> None:
        """Note a declaration, or its end if the op begins with "un"; raise ValueError if there are too many."""
        what = op.removeprefix("un")
        said, name = (
            self.said[what],
            _text_of(message, "service" if what == "advertise_service" else "topic"),
        )
        if op != what:
            said.pop(name, None)
        elif name not in said and len(said) >= QUEUED:
            raise ValueError(f"a client may {what} {QUEUED} times at most")
        else:
            said[name] = said.get(name) or str(message.get("type") or "")


class _Call(NamedTuple):
    """A call that one client made and another is to answer; `number` is the id that the caller gave it."""

    server: _Client | None
    service: str
    caller: _Client
    number: object


class RosbridgeServer(Wire):
    """Serves rosbridge's protocol, on this machine unless set otherwise.

    Args:
        port: TCP port; 0 for any that is free.
        host: the address to listen on; any other than this machine's loopback needs a token.
        token: the token that clients must give, as `Authorization: Bearer TOKEN` or `?token=TOKEN`.

    Raises:
        MissionError: the port is taken, a token is missing, or the extra `ros2` is.
    """

    def __init__(self, port: int = PORT, host: str = "127.0.0.1", token: str = "") -> None:
        with needs("ros2", "rosbridge"):
            from websockets.sync.server import serve
        if host not in LOOPBACK and not token:
            raise MissionError(
                f"{host} can be reached from other machines: give a token, which clients must give too"
            )
        super().__init__(nullcontext())  # it needs no lock, as its own connection never ends
        self._token, self._lock, self._numbers = token, RLock(), count(1)
        self._own = _Client(lambda message: self._hear(cast("Message", plain(message))))
        self._clients: dict[_Client, Peer | None] = {self._own: None}
        self._forwarded: dict[str, _Call] = {}
        try:
            limits: Any = {"max_size": _LARGEST, "close_timeout": 1, "compression": None}
            self._server = serve(self._attend, host, port, process_request=self._admit, **limits)
        except (OSError, OverflowError) as error:
            raise MissionError(
                f"rosbridge cannot be served on {host}:{port}: {error}; give another port"
            ) from None
        self.port = int(self._server.socket.getsockname()[1])
        self._tell(True, f"serving rosbridge on port {self.port}")
        self._introspect()
        self._thread = Thread(
            target=self._server.serve_forever, name="rosbridge-server", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        with ThreadPoolExecutor(_MOST_CLIENTS) as pool:  # all at once, as each may take a second
            list(pool.map(Peer.close, filter(None, list(self._clients.values()))))
        self._server.shutdown()
        self._thread.join()

    def _admit(self, connection: Any, request: Any) -> Any:  # noqa: ANN401  # websockets is imported late
        """Refuse a client without the token; where none is asked for, a web page of another site."""
        query = parse_qs(urlsplit(request.path).query)
        given = (
            request.headers.get("Authorization", "").removeprefix("Bearer ")
            or query.get("token", [""])[0]
        )
        if self._token:
            if not compare_digest(given.encode(), self._token.encode()):
                return connection.respond(
                    401, "a token is needed: ?token=TOKEN, or Authorization: Bearer TOKEN\n"
                )
        elif not _is_of_this_machine(request.headers.get("Origin", "file:")):
            return connection.respond(403, "pages of other sites are let in with a token only\n")
        if (
            len(self._clients) > _MOST_CLIENTS
        ):  # one of them is this node; each takes files and threads of the robot
            return connection.respond(503, f"{_MOST_CLIENTS} clients are connected already\n")
        return None

    def _attend(self, socket: Any) -> None:  # noqa: ANN401  # websockets is imported late
        peer = Peer(socket)
        client = _Client(peer.send)
        with self._lock:
            self._clients[client] = peer
        try:
            for text in socket:
                self._take(client, text)
        except Exception as error:  # cut off, or a message too big: this client only
            _log.info("a rosbridge client is gone: %s", error)
        finally:
            with self._lock:
                del self._clients[client]
                left = [
                    number
                    for number, call in self._forwarded.items()
                    if client in (call.server, call.caller)
                ]
            for number in left:
                self._respond(
                    number,
                    {"values": "the client that served it has disconnected", "result": False},
                )
            peer.close()

    def _take(self, client: _Client, text: str | bytes) -> None:
        try:
            self._do(client, _read(text))
        except NONSENSE as error:
            client.send({"op": "status", "level": "error", "msg": self.refused.add(error)})

    def _send(self, message: Message) -> bool:
        self._do(self._own, message)
        return True

    def _do(self, client: _Client, message: Message) -> None:
        op = message["op"]
        if op.removeprefix("un") in client.said:
            client.say(op, message)
        else:
            getattr(self, f"_op_{op}", self._op_unknown)(client, message)

    def _op_unknown(self, client: _Client, message: Message) -> None:
        raise ValueError(f"op {message['op']!r:.40} is not served")

    def _op_publish(self, client: _Client, message: Message) -> None:
        topic, content = _text_of(message, "topic"), _dict_of(message, "msg")
        with self._lock:
            hearers = [one for one in self._clients if topic in one.said["subscribe"]]
        for one in hearers:
            one.send({"op": "publish", "topic": topic, "msg": content})

    def _op_call_service(self, client: _Client, message: Message) -> None:
        """Forward a call to the client that serves it."""
        service = _text_of(message, "service")
        request = _dict_of(message, "args")
        with self._lock:
            if len(self._forwarded) >= QUEUED:
                raise ValueError(f"{QUEUED} calls wait for their answers already")
            server = next(
                (one for one in self._clients if service in one.said["advertise_service"]), None
            )
            own = f"call_service:{next(self._numbers)}"
            self._forwarded[own] = _Call(server, service, client, message.get("id"))
        if server is None:
            self._respond(own, {"values": f"nobody serves {service}", "result": False})
        else:
            server.send({"op": "call_service", "id": own, "service": service, "args": request})

    def _op_service_response(self, client: _Client, message: Message) -> None:
        number = _text_of(message, "id")
        if number not in self._forwarded or self._forwarded[number].server is not client:
            raise ValueError(f"nobody waits for the answer {number!r:.40}")
        self._respond(number, message)

    def _op_status(self, client: _Client, message: Message) -> None:
        _log.info("a rosbridge client says: %s", str(message.get("msg"))[:200])

    _op_set_level = _op_status

    def _respond(self, own: str, answer: Message) -> None:
        with self._lock:
            call = self._forwarded.pop(own, None)
        if call is None:  # it was answered already, while caller or server disconnected
            return
        made = {"op": "service_response", "service": call.service, "values": answer.get("values")}
        made |= {"result": answer.get("result", True)} | (
            {} if call.number is None else {"id": call.number}
        )
        call.caller.send(made)

    def _introspect(self) -> None:
        topics, services = ("advertise", "subscribe"), ("advertise_service",)
        answers: dict[str, Answer] = {
            "Topics": lambda _: {
                "topics": list(known := self._known(*topics)),
                "types": list(known.values()),
            },
            "TopicType": lambda one: {"type": self._known(*topics).get(str(one.get("topic")), "")},
            "Nodes": lambda _: {"nodes": ["/rosa_kb"]},
            "Services": lambda _: {"services": list(self._known(*services))},
            "ServiceType": lambda one: {
                "type": self._known(*services).get(str(one.get("service")), "")
            },
        }
        for kind, answer in answers.items():
            name = "".join(
                f"_{letter.lower()}" if letter.isupper() else letter for letter in kind
            ).lstrip("_")
            self.serve(f"/rosapi/{name}", f"rosapi/srv/{kind}", answer)

    def _known(self, *ops: str) -> dict[str, str]:
        """Return the topics or services of all clients with their types; the first type that is given counts."""
        with self._lock:
            found = [
                one
                for client in self._clients
                for op in ops
                for one in list(client.said[op].items())
            ]
        return {**dict(found), **dict(one for one in reversed(found) if one[1])}


def _read(text: str | bytes) -> Message:
    if isinstance(text, bytes):
        raise ValueError("binary messages are not accepted; send JSON (compression none)")
    message = json.loads(text)
    if not isinstance(message, dict) or not isinstance(message.get("op"), str):
        raise ValueError('a message must be an object with a text "op"')
    return message


def _text_of(message: Message, key: str) -> str:
    value = message.get(key)
    if not isinstance(value, str) or not value:
        raise ValueError(f'{message["op"]} needs a text "{key}"')
    return value


def _dict_of(message: Message, key: str) -> Message:
    value = message.get(key, {})
    if not isinstance(value, dict):
        raise ValueError(f'"{key}" of {message["op"]} must be an object')
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
        return {**made, "values": answer(_dict_of(message, "args")), "result": True}
    except RosError as error:
        return {**made, "values": str(error), "result": False}
    except Exception as error:  # our own error must not end the connection
        _log.exception("%s could not be answered", message["service"])
        return {**made, "values": f"{type(error).__name__}: {error}", "result": False}


def _is_of_this_machine(origin: str) -> bool:
    """Tell whether a page comes from this machine; "null" does not count, as frames of other sites may send it."""
    place = urlsplit(origin)
    return place.scheme == "file" or place.hostname in LOOPBACK
