"""ROS 2 by a robot's rosbridge (protocol v2: JSON over WebSocket).

A rosbridge with its default parameters does one thing at a time for a connection: a call without an
answer, or a goal that is under way, blocks it for good, but for topics. So each node is called by a
connection of its own, which is opened anew after an overdue call, and so is each goal.
"""

import json
import math
import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from queue import SimpleQueue
from threading import Event, Thread
from typing import Any, Final
from urllib.parse import urlsplit
from uuid import uuid4

from missions.engine.mission import MissionError, needs
from missions.views.output import plain
from missions.wires import ros
from missions.wires.node import (
    SUCCEEDED,
    TIMEOUT_S,
    Answer,
    Call,
    Clock,
    Disconnected,
    Goal,
    Heard,
    Message,
    Node,
    Reply,
    RosError,
    Unanswered,
)

PORT: Final = 9090
QUEUED: Final = 10_000
"""How many messages may wait to be sent."""
_FLUSH_S: Final = 1.0
"""How long sending the queued messages may take when a connection is closed [s]."""
_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.25, 8.0


class Connection:
    """A WebSocket to a rosbridge, which can be opened again; messages wait in its queue meanwhile.

    A full queue takes no more, and a slow receiver holds up nobody: a thread writes.

    Args:
        link: returns the WebSocket, connected.
        on_message: called with each message, by the thread that reads.
    """

    def __init__(
        self, link: Callable[[], Any], on_message: Callable[[str | bytes], object]
    ) -> None:
        self._link = link
        self._on_message = on_message
        self._queue = SimpleQueue[Any]()

    def send(self, message: Message) -> None:
        if self._queue.qsize() < QUEUED:
            self._queue.put(plain(message))

    def start(self, on_end: Callable[[str], object]) -> None:
        """Run it in a thread of its own, and call a function with the reason when it has ended."""
        Thread(target=lambda: on_end(self.run()), name="rosbridge", daemon=True).start()

    def run(self, on_open: Callable[[Any], object] = lambda _: None) -> str:
        """Connect and read until the connection ends; return the reason in words, empty if closed.

        Args:
            on_open: called with the WebSocket before anything is sent.
        """
        try:
            with self._link() as socket:
                on_open(socket)
                writer = Thread(target=self._write, args=[socket], name="ros-send", daemon=True)
                writer.start()
                try:
                    for text in socket:
                        self._on_message(text)
                finally:
                    self._queue.put(socket)
                    writer.join()
        except Exception as error:  # refused, unknown host, no WebSocket, wrong token, cut
            return str(error) or type(error).__name__
        return ""

    def close(self) -> None:
        """Let the thread that writes send the queued messages, then end the connection."""
        self._queue.put(None)

    def _write(self, socket: Any) -> None:  # noqa: ANN401  # websockets is imported late
        with suppress(Exception):  # the thread that reads fails too
            for message in iter(self._queue.get, socket):
                if message is None:
                    socket.close()
                elif isinstance(message, dict):  # else the mark of an earlier connection
                    socket.send(json.dumps(message))


class BridgedGoal(Goal):
    """A goal by a connection of its own; its id is unique, as ids are shared by all clients.

    A rosbridge does not say whether the server accepts a goal, nor under which identifier. The
    status topic shows all goals of a server, so each that begins after ours was sent may be ours.
    Ours is not, or its result is lost, when all of these have ended and no result has come.
    """

    def __init__(self, node: "Rosbridge", action: str, kind: str, goal: Message) -> None:
        super().__init__(action)
        self._node = node
        self._id = f"goal:{uuid4().hex}"
        self._candidates = set[str]()
        self._first_s = self._ended_s = math.inf
        self.connection = node.connection(self._hear)
        self.connection.send(
            {
                "op": "send_action_goal",
                "id": self._id,
                "action": action,
                "action_type": kind,
                "args": goal,
                "feedback": True,
            }
        )

    def start(self) -> None:
        """Send the goal, once the node shows it the status topic."""
        self.connection.start(self._lose)

    def cancel(self) -> None:
        request = {"op": "cancel_action_goal", "id": self._id, "action": self.action}
        self._node.lane(f"cancel {self.action}").send(request)

    def close(self) -> None:
        self.connection.close()

    def see(self, live: set[str], new: set[str]) -> None:
        """Take in the identifiers of the goals that the server has, and which of them are new."""
        now = self._node.clock()
        if now < self._first_s + TIMEOUT_S:
            self._candidates |= new
        if self._candidates & live:
            self._first_s = min(self._first_s, now)
            self._ended_s = math.inf
            self._progress(2)
        elif self._candidates:
            self._ended_s = min(self._ended_s, now)

    def check(self) -> None:
        if self._node.clock() >= self._ended_s + TIMEOUT_S and not self.is_over:
            self.error = (
                f"{self.action} rejects the goal, or it is lost: "
                "the goals that may have been ours have ended, and no result has come"
            )

    def _hear(self, message: Message) -> None:
        if message["op"] == "action_feedback":
            self.feedback = message["values"]
            self._progress(2)
        elif message["result"]:
            self.result = message["values"]
            self._progress(int(message["status"]))
        else:
            self.error = f"{self.action} cannot be asked so: {message['values']}"

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
        self._link = partial(
            connect,
            url,
            additional_headers=headers,
            close_timeout=1,
        )
        self._url = url
        self._declarations: list[Message] = []
        self._hearers = defaultdict[str, list[Heard]](list)
        self._answers: dict[str, Answer] = {}
        self._main = self.connection(self._hear)
        self._lanes: dict[str, Connection] = {}
        self._goals: dict[str, list[BridgedGoal]] = {}
        self._live: dict[str, set[str]] = {}
        self._closing = Event()
        self._thread = Thread(target=self._run, name="rosbridge", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._closing.set()
        goals = [goal.connection for goals in self._goals.values() for goal in goals]
        for connection in (self._main, *self._lanes.copy().values(), *goals):
            connection.close()
        self._thread.join(_FLUSH_S)

    def subscribe(self, topic: str, kind: str, hearer: Heard) -> None:
        ros.check_kind(kind)
        self._hearers[topic].append(hearer)
        self._declare({"op": "subscribe", "topic": topic, "type": kind})

    def publish(self, topic: str, kind: str, message: Message) -> None:
        self._declare({"op": "advertise", "topic": topic, "type": kind})
        self._main.send({"op": "publish", "topic": topic, "msg": message})

    def call(
        self, service: str, kind: str, request: Message, timeout_s: float = TIMEOUT_S
    ) -> Reply:
        with self._lock:  # so that a lane that ends meanwhile ends this call, too
            lane = self.lane(service.rpartition("/")[0])
            call = self._open_call(service, timeout_s, lane)
        call.reply.add_done_callback(partial(self._close_blocked, call))
        lane.send(
            {"op": "call_service", "id": call.id, "service": service, "type": kind, "args": request}
        )
        return call.reply

    def serve(self, service: str, kind: str, answer: Answer) -> None:
        self._answers[service] = answer
        self._declare({"op": "advertise_service", "service": service, "type": kind})

    def send_goal(self, action: str, kind: str, goal: Message) -> BridgedGoal:
        if action not in self._goals:
            self._goals[action] = []
            topic = f"{action}/_action/status"
            self.subscribe(topic, "action_msgs/msg/GoalStatusArray", partial(self._see, action))
        sent = BridgedGoal(self, action, kind, goal)
        self._goals[action] = [*(g for g in self._goals[action] if not g.is_over), sent]
        sent.start()
        return sent

    def update(self) -> None:
        super().update()
        for goals in self._goals.values():
            for goal in goals:
                goal.check()

    def connection(self, on_message: Heard) -> Connection:
        """Return a further connection to the same rosbridge, not open yet."""

        def hear(text: str | bytes) -> None:
            try:
                on_message(json.loads(text))
            except Exception as error:  # of the other side, or our own, which must not end it
                self.refused.add(error)

        return Connection(self._link, hear)

    def lane(self, name: str) -> Connection:
        """Return the connection of this name for calls; opened when it is first asked for."""
        with self._lock:
            lane = self._lanes.get(name)
            if lane is None:
                lane = self._lanes[name] = self.connection(self._hear)
                lane.start(partial(self._drop, lane))
        return lane

    def _drop(self, lane: Connection, reason: str) -> None:
        """Forget a connection that has ended, and fail its calls."""
        with self._lock:
            self._lanes = {name: other for name, other in self._lanes.items() if other is not lane}
            calls = [call for call in self._calls.values() if call.details is lane]
        for call in calls:
            self._end_call(call, Disconnected(f"the connection has ended {reason}".rstrip()))

    def _close_blocked(self, call: Call, reply: Reply) -> None:
        """Close the connection of an overdue call, which may have blocked it for good."""
        if isinstance(reply.exception(), Unanswered):
            self._drop(call.details, "as a call was overdue")
            call.details.close()

    def _declare(self, message: Message) -> None:
        """Send a declaration (subscribe, advertise), now and again after each reconnection."""
        with self._lock:
            if message in self._declarations:
                return
            self._declarations.append(message)
            if self.is_connected:
                self._main.send(message)

    def _run(self) -> None:
        wait_s = _FIRST_WAIT_S
        while not self._closing.is_set():
            reason = self._main.run(self._begin)
            if self._closing.is_set():
                return
            if self.is_connected:
                wait_s = _FIRST_WAIT_S
                self._report(False, f"the connection to {self._url} has ended {reason}".rstrip())
                continue
            advice = "is a rosbridge running there, and is the address (--url) right?"
            self._report(False, f"no connection to {self._url}: {reason}; {advice}")
            self._closing.wait(wait_s)
            wait_s = min(2 * wait_s, _LONGEST_WAIT_S)

    def _begin(self, socket: Any) -> None:  # noqa: ANN401  # websockets is imported late
        with self._lock:
            for message in self._declarations:
                socket.send(json.dumps(message))
            self.is_connected = True
        self._report(
            True,
            f"connected to {self._url}; "
            "messages published there meanwhile are lost, ours are sent now",
        )

    def _hear(self, message: Message) -> None:
        if message["op"] == "publish":
            for hearer in self._hearers[message["topic"]]:
                self._hand_on(message["topic"], message["msg"], hearer)
        elif message["op"] == "service_response":
            call = self._calls[message["id"]]
            values = message["values"]
            if message.get("result", True) and isinstance(values, dict):
                self._end_call(call, values)
            else:
                self._end_call(call, RosError(f"{call.service} failed: {values}"))
        elif message["op"] == "call_service":
            service = message["service"]
            answer = self._answers[service]
            response = {"op": "service_response", "id": message["id"], "service": service}
            try:
                response |= {"values": answer(message["args"]), "result": True}
            except Exception as error:  # whoever calls must not wait for ever
                self.refused.add(error)
                response |= {"values": f"{type(error).__name__}: {error}", "result": False}
            self._main.send(response)

    def _see(self, action: str, message: Message) -> None:
        """Tell the goals of an action which goals its server has."""
        live = {
            str(entry["goal_info"]["goal_id"]["uuid"])
            for entry in message["status_list"]
            if entry["status"] < SUCCEEDED
        }
        for goal in self._goals[action]:
            goal.see(live, live - self._live.get(action, set()))
        self._live[action] = live
