"""ROS 2 by a robot's rosbridge (protocol v2: JSON over WebSocket).

A rosbridge with its default parameters does one thing at a time for a connection: a call without an
answer, or a goal that is under way, blocks it for good, but for topics. So each node is called by a
connection of its own, which is opened anew after an overdue call, and so is each goal.
"""

import json
import logging
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from socket import SHUT_RDWR
from threading import Condition, Event, Thread
from typing import Any, Final
from urllib.parse import urlsplit
from uuid import uuid4

from missions.engine.mission import MissionError, needs
from missions.views.output import plain
from missions.wires import ros
from missions.wires.node import (
    NONSENSE,
    SUCCEEDED,
    TIMEOUT_S,
    Answer,
    Clock,
    Disconnected,
    Goal,
    Heard,
    Message,
    Node,
    RosError,
)

PORT: Final = 9090
QUEUED: Final = 10_000
"""How many messages may wait to be sent."""
FLUSH_S: Final = 1.0
"""How long sending the queued messages may take when a connection is closed [s]."""
_LARGEST: Final = 2**20
"""The longest message [bytes]."""
_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.25, 8.0
_log = logging.getLogger(__name__)


class Connection:
    """One WebSocket to a rosbridge; messages that are sent before it is open wait in its queue.

    A full queue drops its oldest message, and a slow receiver holds up nobody: a thread writes.

    Args:
        link: returns the WebSocket, connected.
        on_message: called with each message, by the thread that reads.
    """

    def __init__(self, link: Callable[[], Any], on_message: Callable[[Message], object]) -> None:
        self._link = link
        self._on_message = on_message
        self._queue = deque[Message](maxlen=QUEUED)
        self._news = Condition()
        self._socket: Any = None
        self._writer = Thread(target=self._write_all, name="ros-send", daemon=True)
        self.is_closed = False

    def send(self, message: Message) -> None:
        with self._news:
            self._queue.append(plain(message))
            self._news.notify()

    def start(self, on_end: Callable[[str], object]) -> None:
        """Run it in a thread of its own, and call a function with the reason when it has ended."""

        def run() -> None:
            try:
                on_end(self.run())
            except Exception as error:  # it could not be opened
                on_end(str(error) or type(error).__name__)

        Thread(target=run, name="rosbridge", daemon=True).start()

    def run(self, on_open: Callable[[], object] = lambda: None) -> str:
        """Connect and read until the connection ends; return the reason in words, empty if closed.

        Raises:
            Exception: it cannot be opened.
        """
        with self._link() as socket:
            self._socket = socket
            on_open()
            self._writer.start()
            if self.is_closed:  # while it was being opened
                self.close()
            try:
                for text in socket:
                    self._on_message(_read(text))
            except Exception as error:  # also of a connection that was cut
                return str(error) or type(error).__name__
            finally:
                self._stop_writing()
            return ""

    def close(self) -> list[Message]:
        """Send the queued messages for at most a second, then close; return those not sent."""
        self._stop_writing()
        unsent = self.unsent()
        if self._socket is None:
            return unsent
        if unsent:  # the other side does not read, so it would not answer the closing handshake
            with suppress(OSError):
                self._socket.socket.shutdown(SHUT_RDWR)
        with suppress(Exception):  # it may be gone
            self._socket.close()
        return unsent

    def unsent(self) -> list[Message]:
        """Take the messages that were not sent out of the queue."""
        with self._news:
            left = list(self._queue)
            self._queue.clear()
        return left

    def _stop_writing(self) -> None:
        with self._news:
            self.is_closed = True
            self._news.notify()
        with suppress(RuntimeError):  # it was not started
            self._writer.join(FLUSH_S)

    def _write_all(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._queue or self.is_closed)
                if not self._queue:
                    return
                message = self._queue[0]
            try:
                self._socket.send(json.dumps(message))
            except Exception as error:  # the thread that reads fails too
                _log.info("nothing more is sent: %s", error)
                return
            with self._news:
                if self._queue and self._queue[0] is message:  # else a newer one pushed it out
                    self._queue.popleft()


class BridgedGoal(Goal):
    """A goal by a connection of its own; its id is unique, as ids are shared by all clients."""

    uuid = ""
    """The server's identifier, once it is seen on the status topic."""

    def __init__(self, node: "Rosbridge", action: str, kind: str, goal: Message) -> None:
        super().__init__(action)
        self._node = node
        self._id = f"goal:{uuid4().hex}"
        self.connection = node.connection(self._hear)
        request = {"op": "send_action_goal", "id": self._id, "action": action}
        self.connection.send({**request, "action_type": kind, "args": goal, "feedback": True})
        self.connection.start(self._lose)

    def cancel(self) -> None:
        request = {"op": "cancel_action_goal", "id": self._id, "action": self.action}
        self._node.lane(f"cancel {self.action}").send(request)

    def close(self) -> None:
        Thread(target=self.connection.close, daemon=True).start()

    def see(self, status: int) -> None:
        """Take in the status of the goal on the status topic; the result says how it ended."""
        self._progress(min(status, SUCCEEDED - 1))

    def _hear(self, message: Message) -> None:
        if message["op"] == "action_feedback":
            self.feedback = message["values"]
            self._progress(2)
        elif message["op"] == "action_result" and message.get("result"):
            self.result = message["values"]
            self._progress(int(message["status"]))
        elif message["op"] == "action_result":
            self.error = f"{self.action} cannot be asked so: {message.get('values')}"

    def _lose(self, reason: str) -> None:
        if not self.is_over:
            self.error = f"the connection of the goal has ended ({reason}); the goal may go on"


class Rosbridge(Node):
    """A client of a robot's rosbridge; it reconnects by itself, at intervals that grow up to 8 s.

    Args:
        url: e.g. "ws://127.0.0.1:9090"; `wss://` for an encrypted one.
        token: sent as `Authorization: Bearer TOKEN`, if the server asks for one.

    Raises:
        MissionError: the extra `ros2` is missing, or `url` is not the address of a rosbridge.
    """

    def __init__(self, url: str, token: str = "", *, clock: Clock = time.monotonic) -> None:
        with needs("ros2", "rosbridge"):
            from websockets.sync.client import connect
        address = urlsplit(url)
        if address.scheme not in ("ws", "wss") or not address.hostname:
            raise MissionError(f"{url!r} is not the address of a rosbridge; write ws://HOST:{PORT}")
        super().__init__(clock)
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        limits: Any = {"max_size": _LARGEST, "open_timeout": 5, "close_timeout": 1}
        self._link = lambda: connect(url, additional_headers=headers, **limits)
        self._url = url
        self._declarations: list[Message] = []
        self._hearers: dict[str, list[Heard]] = {}
        self._advertised: set[str] = set()
        self._answers: dict[str, Answer] = {}
        self._unsent = deque[Message](maxlen=QUEUED)
        self._main: Connection | None = None
        self._lanes: dict[str, Connection] = {}
        self._goals: dict[str, list[BridgedGoal]] = {}
        self._uuids: dict[str, set[str]] = {}
        self._wait_s = _FIRST_WAIT_S
        self._closing = Event()
        self._thread = Thread(target=self._run, name="rosbridge", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._closing.set()
        with self._lock:
            goals = [goal.connection for goals in self._goals.values() for goal in goals]
            connections = [self._main, *self._lanes.values(), *goals]
        for connection in connections:
            if connection is not None:
                connection.close()
        self._thread.join()

    def subscribe(self, topic: str, kind: str, hearer: Heard) -> None:
        ros.check_kind(kind)
        with self._lock:
            self._hearers.setdefault(topic, []).append(hearer)
            self._declare({"op": "subscribe", "topic": topic, "type": kind})

    def publish(self, topic: str, kind: str, message: Message) -> None:
        with self._lock:
            if topic not in self._advertised:
                self._advertised.add(topic)
                self._declare({"op": "advertise", "topic": topic, "type": kind})
            publication = {"op": "publish", "topic": topic, "msg": message}
            if self._main is None:
                self._unsent.append(plain(publication))
            else:
                self._main.send(publication)

    def call(
        self, service: str, kind: str, request: Message, timeout_s: float = TIMEOUT_S
    ) -> "Future[Message]":
        number, call = self._open_call(service, kind, timeout_s)
        if self._main is None:
            error = f"{service} cannot be called: there is no connection"
            self._end_call(number, Disconnected(error))
            return call.future
        message = {"op": "call_service", "id": number, "service": service}
        call.details = self.lane(service.rpartition("/")[0])
        call.details.send({**message, "type": kind, "args": request})
        return call.future

    def serve(self, service: str, kind: str, answer: Answer) -> None:
        with self._lock:
            self._answers[service] = answer
            self._declare({"op": "advertise_service", "service": service, "type": kind})

    def send_goal(self, action: str, kind: str, goal: Message) -> BridgedGoal:
        """Send a goal; only the status topic tells at once whether it is accepted."""
        topic = f"{action}/_action/status"
        if action not in self._goals:
            self._goals[action] = []
            self.subscribe(topic, "action_msgs/msg/GoalStatusArray", lambda m: self._see(action, m))
        sent = BridgedGoal(self, action, kind, goal)
        self._goals[action] = [goal for goal in self._goals[action] if not goal.is_over]
        self._goals[action].append(sent)
        return sent

    def connection(self, on_message: Callable[[Message], object]) -> Connection:
        """Return a further connection to the same rosbridge, not open yet."""

        def hear(message: Message | Exception) -> None:
            try:
                if isinstance(message, Exception):
                    raise message
                on_message(message)
            except NONSENSE as error:
                self.refused.add(error)

        return Connection(self._link, hear)

    def lane(self, name: str) -> Connection:
        """Return the connection of this name for calls; opened when it is first asked for."""
        with self._lock:
            lane = self._lanes.get(name)
            if lane is None:
                lane = self._lanes[name] = self.connection(self._hear)
                lane.start(partial(self._drop, name, lane))
        return lane

    def _drop(self, name: str, lane: Connection, reason: str) -> None:
        """Forget a connection that has ended, and fail its calls."""
        with self._lock:
            if self._lanes.get(name) is lane:
                del self._lanes[name]
            lost = [number for number, call in self._calls.items() if call.details is lane]
        for number in lost:
            self._end_call(number, Disconnected(f"the connection has ended {reason}".rstrip()))

    def _expire(self, number: str) -> None:
        """Fail an overdue call, and close its connection, which it may have blocked for good."""
        call = self._calls.get(number)
        super()._expire(number)
        if call is not None and call.details is not None:
            self._drop(call.service.rpartition("/")[0], call.details, "as a call was overdue")
            Thread(target=call.details.close, daemon=True).start()

    def _declare(self, message: Message) -> None:
        """Send a declaration (subscribe, advertise), now and again after each reconnection."""
        self._declarations.append(message)
        if self._main is not None:
            self._main.send(message)

    def _run(self) -> None:
        while not self._closing.is_set():
            connection = self.connection(self._hear)
            try:
                reason = connection.run(partial(self._begin, connection))
            except Exception as error:  # refused, unknown host, no WebSocket, wrong token
                self._report(False, self._advice(error))
                self._closing.wait(self._wait_s)
                self._wait_s = min(2 * self._wait_s, _LONGEST_WAIT_S)
            else:
                self._end(connection, reason)

    def _advice(self, error: Exception) -> str:
        problem = f"no connection to {self._url}: {error or type(error).__name__}"
        return (
            f"{problem}; it tries again, at last every {_LONGEST_WAIT_S:g} s. "
            "Is a rosbridge running there, and is the address (--url) right?"
        )

    def _begin(self, connection: Connection) -> None:
        self._wait_s = _FIRST_WAIT_S
        with self._lock:
            for message in self._declarations:
                connection.send(message)
            room = QUEUED - len(self._declarations)  # more would push out the declarations
            late = deque(self._unsent, maxlen=room)
            for message in late:
                connection.send(message)
            self._unsent.clear()
            self._main = connection
            if self._closing.is_set():  # `close` came meanwhile, and did not see this connection
                connection.is_closed = True
        text = "messages published there meanwhile are lost, ours are sent now"
        self._report(True, f"connected to {self._url}; {text}: {len(late)}")

    def _end(self, connection: Connection, reason: str) -> None:
        left = [message for message in connection.close() if message["op"] == "publish"]
        with self._lock:
            self._main = None
            self._unsent = deque([*left, *self._unsent], maxlen=QUEUED)
        if not self._closing.is_set():
            text = f"the connection to {self._url} has ended"
            self._report(False, f"{text}: {reason}" if reason else text)

    def _hear(self, message: Message) -> None:
        if message["op"] == "publish":
            hearers = self._hearers[message["topic"]]
            self.refused.hand_on(message.get("msg", {}), hearers)
        elif message["op"] == "service_response":
            self._end_call(message["id"], _answer(message))
        elif message["op"] == "call_service" and self._main is not None:
            self._main.send(_response(self._answers[message["service"]], message))

    def _see(self, action: str, message: Message) -> None:
        """Take in who executes goals: a new one is ours if one of ours is not accepted yet."""
        known = self._uuids.get(action, set())
        statuses = {
            str(entry["goal_info"]["goal_id"]["uuid"]): int(entry["status"])
            for entry in message["status_list"]
        }
        goals = self._goals[action]
        for uuid, status in statuses.items():
            new = [goal for goal in goals if not goal.uuid]
            if uuid not in known and new and status < SUCCEEDED:
                new[0].uuid = uuid
            for goal in goals:
                if goal.uuid == uuid:
                    goal.see(status)
        self._uuids[action] = set(statuses)


def _read(text: str | bytes) -> Any:  # noqa: ANN401  # a message, or the error that it is
    try:
        if isinstance(text, bytes):
            raise ValueError("binary messages are not accepted; send JSON (compression none)")
        message = json.loads(text)
        if not isinstance(message, dict) or not isinstance(message.get("op"), str):
            raise ValueError('a message must be an object with a text "op"')
    except NONSENSE as error:
        return error
    return message


def _answer(message: Message) -> Message | RosError:
    values = message.get("values")
    if message.get("result", True) and isinstance(values, dict):
        return values
    return RosError(f"{message.get('service', 'the service')} failed: {values}")


def _response(answer: Answer, message: Message) -> Message:
    response = {"op": "service_response", "id": message.get("id"), "service": message["service"]}
    try:
        return {**response, "values": answer(message.get("args", {})), "result": True}
    except RosError as error:
        return {**response, "values": str(error), "result": False}
    except Exception as error:  # our own error must not end the connection
        _log.exception("%s could not be answered", message["service"])
        return {**response, "values": f"{type(error).__name__}: {error}", "result": False}
