"""The other side of rosbridge: roslib, Foxglove, other bridges and robots connect to us, without ROS.

It is a `Node` too: what is published, subscribed and served here meets what the clients do.
"""

import logging
from concurrent.futures import Future
from hmac import compare_digest
from itertools import count
from threading import RLock, Thread
from typing import Any, Final, NamedTuple
from urllib.parse import parse_qs, urlsplit

from missions.engine.mission import MissionError
from missions.extras import needs
from missions.wires.node import LOOPBACK, NONSENSE, Answer, Heard, Message, Refusals
from missions.wires.rosbridge import LARGEST, PORT, Peer, answered, dict_of, finish, read, text_of

_REFUSALS_TOLD: Final = 100
"""To one client; more are only counted."""
_log = logging.getLogger(__name__)


class _Client(Peer):
    """A connection, with what it subscribes to and what it serves."""

    def __init__(self, socket: Any) -> None:  # noqa: ANN401  # websockets is imported late
        super().__init__(socket)
        self.topics: set[str] = set()
        self.services: dict[str, str] = {}
        self.refusals = 0


class _Call(NamedTuple):
    """A call that a client is to answer: whose it is, a client's with its number, or ours with a future."""

    server: _Client | None
    service: str
    caller: _Client | None = None
    number: object = None
    future: "Future[Message] | None" = None


class RosbridgeServer:
    """Serves rosbridge's protocol, on this machine unless told otherwise.

    Args:
        port: TCP port; 0 for any that is free.
        host: where to listen; anything but this machine needs a token.
        token: what a client has to give, as `Authorization: Bearer TOKEN` or `?token=TOKEN`.

    Attributes:
        port: where it listens.
        refused: how many messages made no sense, by what was wrong.

    Raises:
        MissionError: the port is taken, a token is missing, or the extra `ros2` is.
    """

    def __init__(self, port: int = PORT, host: str = "127.0.0.1", token: str = "") -> None:
        with needs("ros2", "rosbridge"):
            from websockets.sync.server import serve
        if host not in LOOPBACK and not token:
            raise MissionError(f"{host} is not this machine only: give a token that clients have to give too")
        self._token = token
        self.refused = Refusals()
        self._lock, self._ids = RLock(), count(1)
        self._peers: set[_Client] = set()
        self._heard: dict[str, list[Heard]] = {}
        self._types: dict[str, str] = {}
        self._served: dict[str, tuple[str, Answer]] = {}
        self._forwarded: dict[str, _Call] = {}
        try:
            self._server = serve(
                self._attend,
                host,
                port,
                process_request=self._admit,
                max_size=LARGEST,
                close_timeout=1,
                compression=None,
            )
        except (OSError, OverflowError) as error:
            raise MissionError(f"rosbridge cannot be served on {host}:{port}: {error}; give another port") from None
        self.port = int(self._server.socket.getsockname()[1])
        self._introspect()
        self._thread = Thread(target=self._server.serve_forever, name="rosbridge-server", daemon=True)
        self._thread.start()

    def subscribe(self, topic: str, kind: str, heard: Heard) -> None:
        with self._lock:
            self._types.setdefault(topic, kind)
            self._heard.setdefault(topic, []).append(heard)

    def publish(self, topic: str, kind: str, message: Message) -> None:
        with self._lock:
            self._types.setdefault(topic, kind)
            peers = [one for one in self._peers if topic in one.topics]
        for peer in peers:
            peer.send({"op": "publish", "topic": topic, "msg": message})

    def call(self, service: str, kind: str, request: Message) -> "Future[Message]":
        future: Future[Message] = Future()
        if service in self._served:
            finish(
                future, answered(self._served[service][1], {"op": "call_service", "service": service, "args": request})
            )
            return future
        self._forward(service, request, future=future)
        return future

    def serve(self, service: str, kind: str, answer: Answer) -> None:
        self._served[service] = kind, answer

    def watch(self, changed: Any) -> None:  # noqa: ANN401  # as in Node
        changed(True, f"serving rosbridge on port {self.port}")

    def close(self) -> None:
        self._server.shutdown()
        for peer in list(self._peers):
            peer.close()
        self._thread.join()

    def _admit(self, connection: Any, request: Any) -> Any:  # noqa: ANN401  # websockets is imported late
        """Refuse who has no token where one is asked for; and a page of another site, which a browser would let in."""
        query = parse_qs(urlsplit(request.path).query)
        given = request.headers.get("Authorization", "").removeprefix("Bearer ") or query.get("token", [""])[0]
        if self._token:
            if not compare_digest(given.encode(), self._token.encode()):
                return connection.respond(401, "a token is needed: ?token=TOKEN, or Authorization: Bearer TOKEN\n")
        elif (urlsplit(request.headers.get("Origin", "")).hostname or LOOPBACK[0]) not in LOOPBACK:
            return connection.respond(403, "pages of other sites are let in with a token only\n")
        return None

    def _attend(self, socket: Any) -> None:  # noqa: ANN401  # websockets is imported late
        peer = _Client(socket)
        with self._lock:
            self._peers.add(peer)
        try:
            for text in socket:
                self._take(peer, text)
        except Exception as error:  # cut off, or too big: this client only
            _log.info("a rosbridge client is gone: %s", error)
        finally:
            with self._lock:
                self._peers.discard(peer)
                left = [number for number, call in self._forwarded.items() if call.server is peer]
            for number in left:
                self._respond(number, {"values": "who served it is gone", "result": False})
            peer.close()

    def _take(self, peer: _Client, text: str | bytes) -> None:
        try:
            message = read(text)
            getattr(self, f"_op_{message['op']}", self._op_unknown)(peer, message)
        except NONSENSE as error:
            why = self.refused.add(error)
            peer.refusals += 1
            if peer.refusals <= _REFUSALS_TOLD:
                peer.send({"op": "status", "level": "error", "msg": why})

    def _op_unknown(self, peer: _Client, message: Message) -> None:
        raise ValueError(f"op {message['op']!r:.40} is not served")

    def _op_advertise(self, peer: _Client, message: Message) -> None:
        self._types.setdefault(text_of(message, "topic"), str(message.get("type", "")))

    def _op_unadvertise(self, peer: _Client, message: Message) -> None:
        text_of(message, "topic")

    def _op_subscribe(self, peer: _Client, message: Message) -> None:
        peer.topics.add(text_of(message, "topic"))

    def _op_unsubscribe(self, peer: _Client, message: Message) -> None:
        peer.topics.discard(text_of(message, "topic"))

    def _op_publish(self, peer: _Client, message: Message) -> None:
        topic, content = text_of(message, "topic"), dict_of(message, "msg")
        self.refused.hand_on(content, self._heard.get(topic, ()))
        self.publish(topic, "", content)

    def _op_advertise_service(self, peer: _Client, message: Message) -> None:
        peer.services[text_of(message, "service")] = str(message.get("type", ""))

    def _op_unadvertise_service(self, peer: _Client, message: Message) -> None:
        peer.services.pop(text_of(message, "service"), None)

    def _op_call_service(self, peer: _Client, message: Message) -> None:
        service = text_of(message, "service")
        if isinstance(message.get("args"), list):  # by place, which rosbridge allows and nobody can check
            raise ValueError('"args" of call_service is an object')
        if service in self._served:
            peer.send(answered(self._served[service][1], message))
        else:
            self._forward(service, dict_of(message, "args"), peer, message.get("id"))

    def _op_service_response(self, peer: _Client, message: Message) -> None:
        number = text_of(message, "id")
        if number not in self._forwarded or self._forwarded[number].server is not peer:
            raise ValueError(f"nobody waits for the answer {number!r:.40}")
        self._respond(number, message)

    def _op_status(self, peer: _Client, message: Message) -> None:
        _log.info("a rosbridge client says: %s", str(message.get("msg"))[:200])

    _op_set_level = _op_status

    def _forward(
        self,
        service: str,
        request: Message,
        caller: _Client | None = None,
        number: object = None,
        future: "Future[Message] | None" = None,
    ) -> None:
        """Have the client that serves it answer a call, of another client or of ours."""
        with self._lock:
            server = next((one for one in self._peers if service in one.services), None)
            own = f"call_service:{next(self._ids)}"
            self._forwarded[own] = _Call(server, service, caller, number, future)
        if server is None:
            self._respond(own, {"values": f"nobody serves {service}", "result": False})
        else:
            server.send({"op": "call_service", "id": own, "service": service, "args": request})

    def _respond(self, own: str, answer: Message) -> None:
        with self._lock:
            call = self._forwarded.pop(own)
        made = {"op": "service_response", "service": call.service, "values": answer.get("values")}
        made |= {"result": answer.get("result", True)} | ({} if call.number is None else {"id": call.number})
        if call.caller is not None:
            call.caller.send(made)
        if call.future is not None:
            finish(call.future, made)

    def _introspect(self) -> None:
        told: dict[str, Answer] = {
            "Topics": lambda _: {"topics": list(self._types), "types": list(self._types.values())},
            "TopicType": lambda one: {"type": self._types.get(str(one.get("topic")), "")},
            "Nodes": lambda _: {"nodes": ["/rosa_kb"]},
            "Services": lambda _: {"services": list(self._services())},
            "ServiceType": lambda one: {"type": self._services().get(str(one.get("service")), "")},
        }
        for kind, answer in told.items():
            name = "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in kind).lstrip("_")
            self.serve(f"/rosapi/{name}", f"rosapi/srv/{kind}", answer)

    def _services(self) -> dict[str, str]:
        with self._lock:
            theirs = {name: kind for one in self._peers for name, kind in one.services.items()}
        return {name: kind for name, (kind, _) in self._served.items()} | theirs
