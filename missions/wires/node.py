"""What talks ROS 2, whatever the wire: a `Node`; messages are dicts in the shape of ROS 2's JSON.

Nothing here waits for the network: what is heard is handed on in the thread of the connection, what is sent goes
through a queue with an end.
"""

import logging
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from threading import Condition, Thread
from typing import Any, Final

from missions.engine.mission import MissionError

Message = dict[str, Any]
Heard = Callable[[Message], object]
Answer = Callable[[Message], Message]

QUEUED: Final = 10_000
"""Messages that wait to be sent, at most."""
_KINDS: Final = 100
LOOPBACK: Final = ("127.0.0.1", "localhost", "::1")
_log = logging.getLogger(__name__)


class RosError(MissionError):
    """A call has failed, or a request is refused; the text says why."""


NONSENSE: Final = (ValueError, LookupError, TypeError, AttributeError, RecursionError)
"""What a message raises that is none; nothing has been done by then."""


class Refusals(Counter[str]):
    """How many messages made no sense, by what was wrong, each kind logged once; beyond a hundred they are one."""

    def add(self, error: Exception | str) -> str:
        text = (error if isinstance(error, str) else f"{type(error).__name__}: {error}")[:200]
        kind = text if text in self or len(self) < _KINDS else "something else"
        if kind not in self:
            _log.warning("refused: %s", kind)
        self[kind] += 1
        return text

    def hand_on(self, message: Message, hearers: Iterable[Heard]) -> None:
        """Have a message heard; who fails at it does not keep it from the others."""
        for heard in hearers:
            try:
                heard(message)
            except Exception as error:  # of who hears it, not of the wire
                self.add(error)


class Node(ABC):
    """What talks ROS 2: by rosbridge, by rclpy or by DDS. Types are named as ROS 2 does, e.g. "std_msgs/msg/String".

    Attributes:
        refused: how many messages made no sense, by what was wrong.
        is_connected: whether there is a connection, or anybody whose topics are heard.
    """

    def __init__(self) -> None:
        self.refused, self.is_connected = Refusals(), False
        self._told, self._watching = "", list[Callable[[bool, str], object]]()

    @abstractmethod
    def subscribe(self, topic: str, kind: str, heard: Heard) -> None:
        """Have a function called with each message of a topic."""

    @abstractmethod
    def publish(self, topic: str, kind: str, message: Message) -> None:
        """Publish a message."""

    @abstractmethod
    def call(self, service: str, kind: str, request: Message) -> "Future[Message]":
        """Call a service; the future ends with the answer, or with `RosError`."""

    @abstractmethod
    def serve(self, service: str, kind: str, answer: Answer) -> None:
        """Answer the calls of a service; a `RosError` refuses one."""

    @abstractmethod
    def close(self) -> None:
        """Let go of everything."""

    def watch(self, changed: Callable[[bool, str], object]) -> None:
        """Have a function called with whether there is a connection, and a sentence, now and when that changes."""
        self._watching.append(changed)
        if self._told:
            changed(self.is_connected, self._told)

    def _tell(self, is_connected: bool, text: str) -> None:
        """Say how the connection is, unless it was said before."""
        if (is_connected, text) != (self.is_connected, self._told):
            self.is_connected, self._told = is_connected, text
            for changed in self._watching:
                changed(is_connected, text)


class Outbox:
    """Sends in a thread of its own, so that who is slow or gone holds up nobody; a full queue drops its oldest.

    Attributes:
        dropped: how many messages were pushed out.
    """

    def __init__(self, write: Callable[[Any], object]) -> None:
        self.dropped = 0
        self._write = write
        self._queue: deque[Any] = deque()
        self._news, self._is_closed = Condition(), False
        self._thread = Thread(target=self._send_all, name="ros-send", daemon=True)
        self._thread.start()

    def put(self, one: object) -> None:
        with self._news:
            if len(self._queue) >= QUEUED:
                self._queue.popleft()
                self.dropped += 1
            self._queue.append(one)
            self._news.notify()

    def close(self) -> None:
        with self._news:
            self._is_closed = True
            self._news.notify()

    def _send_all(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._queue or self._is_closed)
                if self._is_closed:
                    return
                one = self._queue.popleft()
            try:
                self._write(one)
            except Exception as error:  # who reads of the same connection finds out too, and ends it
                _log.info("nothing more is sent: %s", error)
                return
