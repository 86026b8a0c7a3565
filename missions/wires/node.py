"""A `Node` publishes, subscribes, calls, serves and sends goals in ROS 2, whatever the wire.

Messages are dicts like ROS 2's JSON. Nothing here waits for the network: messages are handed on by
the thread of the connection, and `update`, called often, fails the calls that are overdue.
"""

import logging
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from threading import RLock
from typing import Any, Final
from uuid import uuid4

from missions.engine.mission import MissionError

Message = dict[str, Any]
Heard = Callable[[Message], object]
Answer = Callable[[Message], Message]
Clock = Callable[[], float]
Reply = Future[Message]
"""Ends with the answer to a call, or with `RosError`."""

TIMEOUT_S: Final = 5.0
"""How long a call may take unless it is set otherwise [s]."""
_KINDS: Final = 100
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
"""Statuses of a goal that has ended, as in action_msgs/GoalStatus."""
_log = logging.getLogger(__name__)


class RosError(MissionError):
    """A call failed, or a request was refused; the text says why."""


class Unanswered(RosError):
    """A call was not answered in time."""


class Disconnected(RosError):
    """There is no connection, or it ended before the answer came."""


class Refusals(Counter[str]):
    """Counts malformed messages by what is wrong.

    Each kind is logged once; kinds beyond a hundred are counted as one.
    """

    def add(self, error: Exception | str) -> None:
        text = error if isinstance(error, str) else f"{type(error).__name__}: {error}"
        kind = text[:200]
        if kind not in self and len(self) >= _KINDS:
            kind = "something else"
        if kind not in self:
            _log.warning("refused: %s", kind)
        self[kind] += 1


@dataclass(eq=False)
class Call:
    """A call without an answer yet.

    Attributes:
        due_s: when it fails for want of an answer, by the node's clock [s].
        overdue: what is said then.
        details: what the wire notes about it.
    """

    service: str
    due_s: float
    overdue: str
    details: Any = None
    reply: Reply = field(default_factory=Future)
    id: str = field(default_factory=lambda: f"call:{uuid4().hex}")


@dataclass(eq=False)
class Goal(ABC):
    """A goal of an action server, and what has become of it so far.

    Attributes:
        is_accepted: whether the server is known to have accepted it.
        status: as in action_msgs/GoalStatus: 2 executing, 3 canceling, 4 succeeded, 5 canceled, 6
            aborted.
        feedback: the latest one.
        signs: how many messages about it came.
        error: why no result will come.
    """

    action: str
    is_accepted: bool = False
    status: int = 0
    result: Message = field(default_factory=dict)
    feedback: Message = field(default_factory=dict)
    signs: int = 0
    error: str = ""

    @property
    def is_over(self) -> bool:
        return bool(self.error) or self.status >= SUCCEEDED

    @abstractmethod
    def cancel(self) -> None:
        """Ask the server to cancel the goal; it has done so when `status` is 5."""

    def close(self) -> None:  # noqa: B027  # most have nothing to close
        """Forget the goal; one that has not ended goes on."""

    def _progress(self, status: int) -> None:
        self.signs += 1
        self.is_accepted = True
        self.status = max(self.status, status)


class Node(ABC):
    """A node of ROS 2, by rosbridge or rclpy. Types have ROS 2's names, e.g. "std_msgs/msg/String".

    Args:
        clock: gives the time by which calls are overdue [s].

    Attributes:
        refused: how many messages were malformed, by what was wrong.
        is_connected: whether there is a connection or, by rclpy, another node that publishes to us.
    """

    def __init__(self, clock: Clock = time.monotonic) -> None:
        self.clock = clock
        self.refused = Refusals()
        self.is_connected = False
        self._text = ""
        self._watchers: list[Callable[[bool, str], object]] = []
        self._lock = RLock()
        self._calls: dict[str, Call] = {}

    @abstractmethod
    def subscribe(self, topic: str, kind: str, hearer: Heard) -> None:
        """Call a function with each message of a topic."""

    @abstractmethod
    def publish(self, topic: str, kind: str, message: Message) -> None:
        """Publish a message."""

    @abstractmethod
    def call(
        self, service: str, kind: str, request: Message, timeout_s: float = TIMEOUT_S
    ) -> Reply:
        """Call a service."""

    @abstractmethod
    def serve(self, service: str, kind: str, answer: Answer) -> None:
        """Answer the calls of a service; one that a function raises for is refused."""

    @abstractmethod
    def send_goal(self, action: str, kind: str, goal: Message) -> Goal:
        """Send a goal to an action server."""

    @abstractmethod
    def close(self) -> None:
        """End the connection, its threads and all open calls."""

    def publishers(self, topic: str) -> int | None:
        """Return how many publish on a topic; None if this wire cannot count them."""
        return None

    def update(self) -> None:
        """Fail the calls that are overdue."""
        now = self.clock()
        for call in list(self._calls.values()):
            if now >= call.due_s:
                self._end_call(call, Unanswered(call.overdue))

    def watch(self, watcher: Callable[[bool, str], object]) -> None:
        """Call a function with `is_connected` and a sentence about it, now and at each change."""
        self._watchers.append(watcher)
        if self._text:
            watcher(self.is_connected, self._text)

    def _report(self, is_connected: bool, text: str) -> None:
        if (is_connected, text) == (self.is_connected, self._text):
            return
        self.is_connected = is_connected
        self._text = text
        for watcher in self._watchers:
            watcher(is_connected, text)

    def _open_call(self, service: str, timeout_s: float, details: object) -> Call:
        overdue = f"{service} has not answered in time"
        call = Call(service, self.clock() + timeout_s, overdue, details)
        call.reply.set_running_or_notify_cancel()  # its caller need not wait, but cannot cancel it
        self._calls[call.id] = call
        return call

    def _end_call(self, call: Call, answer: Message | RosError) -> None:
        """End a call with its answer or error, unless it has ended."""
        if self._calls.pop(call.id, None) is None:
            return
        if isinstance(answer, RosError):
            call.reply.set_exception(answer)
        else:
            call.reply.set_result(answer)

    def _hand_on(self, topic: str, message: Message, hearer: Heard) -> None:
        try:
            hearer(message)
        except Exception as error:  # an error of the hearer, not of the wire
            self.refused.add(f"{topic}: {type(error).__name__}: {error}")
