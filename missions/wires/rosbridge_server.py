"""The other side of rosbridge: roslib, Foxglove, other bridges and robots connect to us, without ROS.

It is a `Node` too: one of its own clients, without a connection.
"""

import logging
from collections.abc import Callable
from contextlib import nullcontext
from hmac import compare_digest
from itertools import count
from threading import RLock, Thread
from typing import Any, Final, NamedTuple, cast
from urllib.parse import parse_qs, urlsplit

from missions.engine.mission import MissionError
from missions.engine.registry import needs
from missions.views.facts import plain
from missions.wires.node import LOOPBACK, NONSENSE, Answer, Message
from missions.wires.rosbridge import LARGEST, PORT, Peer, Wire, dict_of, read, text_of

_REFUSALS_LOGGED: Final = 100
"""To one client; more are only counted."""
_log = logging.getLogger(__name__)


class _Client:
    """Who takes part: what it subscribes to, which types its topics have, what it serves; `send` hands it a message."""

    def __init__(self, send: Callable[[Message], object]) -> None:
        self.send = send
        self.topics: set[str] = set()
        self.types: dict[str, str] = {}
        self.services: dict[str, str] = {}
        self.refusals = 0


class _Call(NamedTuple):
    """A call that a client is to answer, and whose it is, by what number there."""

    server: _Client | None
    service: str
    caller: _Client
    number: object


class RosbridgeServer(Wire):
    """Serves rosbridge's protocol, on this machine unless set otherwise.

    Args:
        port: TCP port; 0 for any that is free.
        host: where to listen; anything but this machine needs a token.
        token: what a client has to give, as `Authorization: Bearer TOKEN` or `?token=TOKEN`.

    Raises:
        MissionError: the port is taken, a token is missing, or the extra `ros2` is.
    """

    def __init__(self, port: int = PORT, host: str = "127.0.0.1", token: str = "") -> None:
        with needs("ros2", "rosbridge"):
            from websockets.sync.server import serve
        if host not in LOOPBACK and not token:
            raise MissionError(f"{host} is not this machine only: give a token that clients have to give too")
        super().__init__(nullcontext())  # its own connection never ends
        self._token, self._lock, self._numbers = token, RLock(), count(1)
        self._own = _Client(lambda message: self._hear(cast("Message", plain(message))))
        self._clients: dict[_Client, Peer | None] = {self._own: None}
        self._forwarded: dict[str, _Call] = {}
        try:
            limits: Any = {"max_size": LARGEST, "close_timeout": 1, "compression": None}
            self._server = serve(self._attend, host, port, process_request=self._admit, **limits)
        except (OSError, OverflowError) as error:
            raise MissionError(f"rosbridge cannot be served on {host}:{port}: {error}; give another port") from None
        self.port = int(self._server.socket.getsockname()[1])
        self._tell(True, f"serving rosbridge on port {self.port}")
        self._introspect()
        self._thread = Thread(target=self._server.serve_forever, name="rosbridge-server", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._server.shutdown()
        for peer in filter(None, list(self._clients.values())):
            peer.close()
        self._thread.join()

    def _admit(self, connection: Any, request: Any) -> Any:  # noqa: ANN401  # websockets is imported late
        """Refuse who has no token where one is asked for; and a page of another site, which a browser would let in."""
        query = parse_qs(urlsplit(request.path).query)
        given = request.headers.get("Authorization", "").removeprefix("Bearer ") or query.get("token", [""])[0]
        if self._token:
            if not compare_digest(given.encode(), self._token.encode()):
                return connection.respond(401, "a token is needed: ?token=TOKEN, or Authorization: Bearer TOKEN\n")
        elif not _is_of_this_machine(request.headers.get("Origin", "file:")):
            return connection.respond(403, "pages of other sites are let in with a token only\n")
        return None

    def _attend(self, socket: Any) -> None:  # noqa: ANN401  # websockets is imported late
        peer = Peer(socket)
        client = _Client(peer.send)
        with self._lock:
            self._clients[client] = peer
        try:
            for text in socket:
                self._take(client, text)
        except Exception as error:  # cut off, or too big: this client only
            _log.info("a rosbridge client is gone: %s", error)
        finally:
            with self._lock:
                del self._clients[client]
                left = [number for number, call in self._forwarded.items() if client in (call.server, call.caller)]
            for number in left:
                self._respond(number, {"values": "who served it is gone", "result": False})
            peer.close()

    def _take(self, client: _Client, text: str | bytes) -> None:
        try:
            self._do(client, read(text))
        except NONSENSE as error:
            why = self.refused.add(error)
            client.refusals += 1
            if client.refusals <= _REFUSALS_LOGGED:
                client.send({"op": "status", "level": "error", "msg": why})

    def _send(self, message: Message) -> bool:
        self._do(self._own, message)
        return True

    def _do(self, client: _Client, message: Message) -> None:
        getattr(self, f"_op_{message['op']}", self._op_unknown)(client, message)

    def _op_unknown(self, client: _Client, message: Message) -> None:
        raise ValueError(f"op {message['op']!r:.40} is not served")

    def _op_advertise(self, client: _Client, message: Message) -> None:
        client.types.setdefault(text_of(message, "topic"), str(message.get("type", "")))

    def _op_unadvertise(self, client: _Client, message: Message) -> None:
        client.types.pop(text_of(message, "topic"), None)

    def _op_subscribe(self, client: _Client, message: Message) -> None:
        client.topics.add(text_of(message, "topic"))
        if message.get("type"):
            client.types.setdefault(message["topic"], str(message["type"]))

    def _op_unsubscribe(self, client: _Client, message: Message) -> None:
        client.topics.discard(text_of(message, "topic"))

    def _op_publish(self, client: _Client, message: Message) -> None:
        topic, content = text_of(message, "topic"), dict_of(message, "msg")
        with self._lock:
            hearers = [one for one in self._clients if topic in one.topics]
        for one in hearers:
            one.send({"op": "publish", "topic": topic, "msg": content})

    def _op_advertise_service(self, client: _Client, message: Message) -> None:
        client.services[text_of(message, "service")] = str(message.get("type", ""))

    def _op_unadvertise_service(self, client: _Client, message: Message) -> None:
        client.services.pop(text_of(message, "service"), None)

    def _op_call_service(self, client: _Client, message: Message) -> None:
        """Have the client that serves it answer a call."""
        service = text_of(message, "service")
        if isinstance(message.get("args"), list):  # by place, which rosbridge allows and nobody can check
            raise ValueError('"args" of call_service is an object')
        request = dict_of(message, "args")
        with self._lock:
            server = next((one for one in self._clients if service in one.services), None)
            own = f"call_service:{next(self._numbers)}"
            self._forwarded[own] = _Call(server, service, client, message.get("id"))
        if server is None:
            self._respond(own, {"values": f"nobody serves {service}", "result": False})
        else:
            server.send({"op": "call_service", "id": own, "service": service, "args": request})

    def _op_service_response(self, client: _Client, message: Message) -> None:
        number = text_of(message, "id")
        if number not in self._forwarded or self._forwarded[number].server is not client:
            raise ValueError(f"nobody waits for the answer {number!r:.40}")
        self._respond(number, message)

    def _op_status(self, client: _Client, message: Message) -> None:
        _log.info("a rosbridge client says: %s", str(message.get("msg"))[:200])

    _op_set_level = _op_status

    def _respond(self, own: str, answer: Message) -> None:
        with self._lock:
            call = self._forwarded.pop(own, None)
        if call is None:  # it was answered while who had asked, or who served it, was going
            return
        made = {"op": "service_response", "service": call.service, "values": answer.get("values")}
        made |= {"result": answer.get("result", True)} | ({} if call.number is None else {"id": call.number})
        call.caller.send(made)

    def _introspect(self) -> None:
        answers: dict[str, Answer] = {
            "Topics": lambda _: {"topics": list(known := self._known("types")), "types": list(known.values())},
            "TopicType": lambda one: {"type": self._known("types").get(str(one.get("topic")), "")},
            "Nodes": lambda _: {"nodes": ["/rosa_kb"]},
            "Services": lambda _: {"services": list(self._known("services"))},
            "ServiceType": lambda one: {"type": self._known("services").get(str(one.get("service")), "")},
        }
        for kind, answer in answers.items():
            name = "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in kind).lstrip("_")
            self.serve(f"/rosapi/{name}", f"rosapi/srv/{kind}", answer)

    def _known(self, what: str) -> dict[str, str]:
        """Return the topics ("types") or services of all who take part, with their types; who came first counts."""
        with self._lock:
            found = [one for client in self._clients for one in list(getattr(client, what).items())]
        return {**dict(found), **dict(reversed(found))}


def _is_of_this_machine(origin: str) -> bool:
    """Tell whether a page comes from this machine; "null" is what frames of other sites can call themselves."""
    place = urlsplit(origin)
    return place.scheme == "file" or place.hostname in LOOPBACK
