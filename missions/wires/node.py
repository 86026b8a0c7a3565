"""A `Node` publishes, subscribes, calls and serves in ROS 2, whatever the wire; messages are dicts like ROS 2's JSON.

A `TypedNode` has a library with a class for each message type (rclpy, or cyclonedds with the types of rosbags).

Nothing here waits for the network: received messages are handed on in the thread of the connection, and messages to
send go through a queue of limited length.
"""

import logging
import math
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from itertools import count
from threading import Condition, RLock, Thread
from time import monotonic
from typing import Any, Final, NamedTuple, Protocol

from missions.engine.mission import MissionError
from missions.views.output import plain

Message = dict[str, Any]
Heard = Callable[[Message], object]
Answer = Callable[[Message], Message]

QUEUED: Final = 10_000
"""How many messages may wait to be sent."""
_FLUSH_S: Final = 1.0
"""How long sending the queued messages may take when a queue is closed [s]."""
_KINDS: Final = 100
_FIND_S: Final = 3.0
"""How long a call waits for its service to appear before it fails [s]."""
_FLOATS: Final = ("float32", "float64")
_INTEGERS: Final = {
    **{f"int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
    **{f"uint{bits}": (0, 2**bits - 1) for bits in (8, 16, 32, 64)},
    "byte": (0, 255),
    "char": (0, 255),
}
"""The integer types of ROS 2, each with its least and greatest value."""
LOOPBACK: Final = ("127.0.0.1", "localhost", "::1")
_log = logging.getLogger(__name__)


class RosError(MissionError):
    """A call failed, or a request was refused; the text says why."""


NONSENSE: Final = (ValueError, LookupError, TypeError, AttributeError, RecursionError)
"""What a malformed message raises; it has had no effect by then."""


class Refusals(Counter[str]):
    """Counts malformed messages by what is wrong; logs each kind once, and counts kinds beyond a hundred as one."""

    def add(self, error: Exception | str) -> str:
        text = (error if isinstance(error, str) else f"{type(error).__name__}: {error}")[:200]
        kind = text if text in self or len(self) < _KINDS else "something else"
        if kind not in self:
            _log.warning("refused: %s", kind)
        self[kind] += 1
        return text

    def hand_on(self, message: Message, hearers: Iterable[Heard]) -> None:
        """Give a message to each hearer; one that raises does not keep it from the others."""
        for heard in hearers:
            try:
                heard(message)
            except Exception as error:  # an error of the hearer, not of the wire
                self.add(error)


class Node(ABC):
    """A node of ROS 2, by rosbridge, rclpy or DDS. Types have ROS 2's names, e.g. "std_msgs/msg/String".

    Attributes:
        refused: how many messages were malformed, by what was wrong.
        is_connected: whether there is a connection or, without a server between, another node that publishes to us.
    """

    def __init__(self) -> None:
        self.refused, self.is_connected = Refusals(), False
        self._said, self._watching = "", list[Callable[[bool, str], object]]()

    @abstractmethod
    def subscribe(self, topic: str, kind: str, heard: Heard) -> None:
        """Call a function with each message of a topic."""

    @abstractmethod
    def publish(self, topic: str, kind: str, message: Message) -> None:
        """Publish a message."""

    @abstractmethod
    def call(self, service: str, kind: str, request: Message) -> "Future[Message]":
        """Call a service; the future ends with the answer, or with `RosError`."""

    @abstractmethod
    def serve(self, service: str, kind: str, answer: Answer) -> None:
        """Answer the calls of a service with a function; when it raises `RosError`, the call is refused."""

    @abstractmethod
    def close(self) -> None:
        """End the connection, its threads and all open calls."""

    def watch(self, changed: Callable[[bool, str], object]) -> None:
        """Call a function with `is_connected` and a sentence about it, now and whenever either changes."""
        self._watching.append(changed)
        if self._said:
            changed(self.is_connected, self._said)

    def _tell(self, is_connected: bool, text: str) -> None:
        """Tell the watchers the state of the connection, unless it is the one told last."""
        if (is_connected, text) != (self.is_connected, self._said):
            self.is_connected, self._said = is_connected, text
            for changed in self._watching:
                changed(is_connected, text)


def begun() -> "Future[Message]":
    """Return a future for a call that is under way: the caller need not wait for it, but cannot cancel it."""
    future = Future[Message]()
    future.set_running_or_notify_cancel()
    return future


class Outbox:
    """Sends in a thread of its own, so that a slow receiver holds up nobody; a full queue drops its oldest message."""

    def __init__(self, write: Callable[[Any], object]) -> None:
        self._write = write
        self._queue = deque[Any](maxlen=QUEUED)
        self._news, self._is_closed = Condition(), False
        self._thread = Thread(target=self._send_all, name="ros-send", daemon=True)
        self._thread.start()

    def put(self, one: object) -> None:
        with self._news:
            self._queue.append(one)
            self._news.notify()

    def close(self) -> list[Any]:
        """Send the queued messages for at most a second, then stop; return those that were not sent."""
        with self._news:
            self._is_closed = True
            self._news.notify()
        self._thread.join(_FLUSH_S)
        with self._news:
            left = list(self._queue)
            self._queue.clear()
        return left

    def _send_all(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._queue or self._is_closed)
                if not self._queue:
                    return
                one = self._queue[0]
            try:
                self._write(one)
            except (
                Exception
            ) as error:  # the thread that reads this connection fails too, and ends it
                _log.info("nothing more is sent: %s", error)
                return
            with self._news:
                if self._queue and self._queue[0] is one:  # otherwise a newer one has pushed it out
                    self._queue.popleft()


class Field(NamedTuple):
    """The type of a field; `length` is None for a single value, 0 for a sequence, else the size of an array."""

    kind: str
    length: int | None = None


class Library(Protocol):
    """A library that has ROS 2's message types."""

    def fields(self, kind: str) -> Mapping[str, Field]:
        """Return the fields of a message type; `RosError` if it is not known."""

    def find(self, kind: str) -> Any:  # noqa: ANN401  # of the library
        """Return the class of a message type; `RosError` if it is not known."""

    def new(self, kind: str, values: Message) -> Any:  # noqa: ANN401  # an object of the library
        """Return a message with these values; all other fields are zero or empty."""


def made(library: Library, kind: str, message: Message) -> Any:  # noqa: ANN401  # an object of the library
    """Return the library's object for a message that is written as a dict.

    Raises:
        RosError: the type or a field is not known, or a value does not have the type of its field.
    """
    if not isinstance(message, dict):
        raise RosError(f"{kind} must be an object, not {message!r:.60}")
    fields = library.fields(kind)
    for name in message:
        if name not in fields:
            raise RosError(f"{kind} has no field {name!r}; it has {', '.join(fields) or 'none'}")
    given = {
        name: _made(library, *fields[name], value, f"{name} of {kind}")
        for name, value in message.items()
    }
    return library.new(kind, given)


def _made(library: Library, kind: str, length: int | None, value: Any, place: str) -> Any:  # noqa: ANN401  # of a field
    if length is not None:
        if not isinstance(value, list | tuple) or (length and len(value) != length):
            raise RosError(
                f"{place} must be a list of {length or 'any number of'} {kind}, not {value!r:.60}"
            )
        return [_made(library, kind, None, one, place) for one in value]
    if kind in _FLOATS and (
        value is None or (isinstance(value, int | float) and not isinstance(value, bool))
    ):
        return math.nan if value is None else float(value)
    if kind in _INTEGERS and isinstance(value, int) and not isinstance(value, bool):
        low, high = _INTEGERS[kind]
        if low <= value <= high:
            return value
    if (kind == "bool" and isinstance(value, bool)) or (
        kind == "string" and isinstance(value, str)
    ):
        return value
    if "/" in kind:
        return made(library, kind, value)
    raise RosError(f"{place} must be a {kind}, not {value!r:.60}")


def message_of(library: Library, kind: str, thing: Any) -> Message:  # noqa: ANN401  # an object of the library
    return {
        name: _value_of(library, *field, getattr(thing, name))
        for name, field in library.fields(kind).items()
    }


def _value_of(library: Library, kind: str, length: int | None, value: Any) -> object:  # noqa: ANN401  # of a field
    if length is not None:
        return [_value_of(library, kind, None, one) for one in value]
    if "/" in kind:
        return message_of(library, kind, value)
    if isinstance(value, bytes):  # rclpy's byte
        return value[0]
    return plain(float(value)) if kind in _FLOATS else value


@dataclass(eq=False)
class Reader:
    """A reader of a topic, which gives messages to `take`; it is opened anew as best-effort if a publisher is."""

    topic: str
    kind: Any
    take: Callable[[Any], object]
    opened: Any = None
    is_reliable: bool = True


class Client(NamedTuple):
    """Calls a service: tells whether it is served (`RosError` if it cannot be called), and sends numbered requests."""

    is_served: Callable[[], bool]
    send: Callable[[int, Any], object]


@dataclass(eq=False)
class _Call:
    """A call without an answer yet; it is sent when its service is there."""

    service: str
    kind: str
    request: Any
    future: "Future[Message]"
    until_s: float
    is_sent: bool = False


class TypedNode(Node):
    """What nodes of all libraries with types have in common; a subclass says how its library does it."""

    topics = ""
    """The prefix of topic names on the wire."""

    def __init__(self, name: str, library: Library) -> None:
        super().__init__()
        self._name, self._types, self._lock, self._numbers = name, library, RLock(), count(1)
        self._readers: list[Reader] = []
        self._writers: dict[str, Callable[[Any], object]] = {}
        self._clients: dict[str, Client] = {}
        self._open: dict[int, _Call] = {}
        self._tell(False, f"{name}: no other node is there")

    def subscribe(self, topic: str, kind: str, heard: Heard) -> None:
        found = self._types.find(kind)
        self._hear(
            f"{self.topics}{topic}",
            found,
            lambda thing: heard(message_of(self._types, kind, thing)),
        )

    def publish(self, topic: str, kind: str, message: Message) -> None:
        thing = made(self._types, kind, message)
        with self._lock:
            if topic not in self._writers:
                self._writers[topic] = self._writer(f"{self.topics}{topic}", self._types.find(kind))
        self._writers[topic](thing)

    def call(self, service: str, kind: str, request: Message) -> "Future[Message]":
        thing, future = made(self._types, f"{kind}_Request", request), begun()
        with self._lock:
            if service not in self._clients:
                self._clients[service] = self._client(service, kind)
            number = next(self._numbers)
            self._open[number] = _Call(service, kind, thing, future, monotonic() + _FIND_S)
            self._send_call(number)
        return future

    def serve(self, service: str, kind: str, answer: Answer) -> None:
        self._serve(service, kind, partial(self._response, kind, answer))

    def close(self) -> None:
        """Fail the open calls and forget all readers and writers; a subclass closes its library first."""
        for call in self._open.values():
            call.future.set_exception(
                RosError(f"{call.service} is not answered any more: the node is closed")
            )
        self._readers, self._writers, self._clients, self._open = [], {}, {}, {}

    @abstractmethod
    def _open_reader(self, reader: Reader) -> None:
        """Open a reader; if it is open already, replace it."""

    @abstractmethod
    def _publishers(self, reader: Reader) -> tuple[bool, bool]:
        """Tell whether a topic has publishers, and whether one is best-effort: no reliable reader hears that."""

    @abstractmethod
    def _writer(self, topic: str, kind: Any) -> Callable[[Any], object]:  # noqa: ANN401  # of the library
        """Return a function that publishes on a topic."""

    @abstractmethod
    def _client(self, service: str, kind: str) -> Client:
        """Return a client of a service; it gives `_finish` the number of each request and its answer or error."""

    @abstractmethod
    def _serve(self, service: str, kind: str, respond: Callable[[Any], Any]) -> None:
        """Answer each request of a service with what `respond` returns."""

    def _hear(self, topic: str, kind: Any, take: Callable[[Any], object]) -> Reader:  # noqa: ANN401  # of the library
        reader = Reader(topic, kind, take)
        with self._lock:
            self._open_reader(reader)
            self._readers.append(reader)
        return reader

    def _take(self, reader: Reader, thing: Any) -> None:  # noqa: ANN401  # of the library
        try:
            reader.take(thing)
        except (
            Exception
        ) as error:  # a malformed message, or an error of the hearer; go on with the next
            self.refused.add(error)

    def _look(self) -> None:
        """Look which other nodes are there; send the calls that waited for a service, and fail those nobody answers."""
        with self._lock:
            is_there = False
            for reader in self._readers:
                is_published, is_missed = self._publishers(reader)
                is_there |= is_published
                if reader.is_reliable and is_missed:
                    reader.is_reliable = False
                    self._open_reader(reader)
            for number in list(self._open):
                self._send_call(number)
        if is_there != self.is_connected:
            self._tell(
                is_there,
                f"{self._name}: {'other nodes are there' if is_there else 'all other nodes are gone'}",
            )

    def _send_call(self, number: int) -> None:
        call = self._open[number]
        client = self._clients[call.service]
        try:
            is_there = client.is_served()
        except RosError as error:
            self._finish(number, error)
            return
        if is_there and not call.is_sent:
            call.is_sent = True
            client.send(number, call.request)
        elif not is_there and (call.is_sent or monotonic() > call.until_s):
            why = (
                f"the server of {call.service} is gone"
                if call.is_sent
                else f"nobody serves {call.service}"
            )
            self._finish(number, RosError(why))

    def _finish(self, number: int, answer: Any) -> None:  # noqa: ANN401  # of the library, or what was raised
        with self._lock:
            call = self._open.pop(number, None)
        if call is None:
            return
        if isinstance(answer, BaseException):
            failed = (
                answer
                if isinstance(answer, RosError)
                else RosError(f"{call.service} failed: {answer}")
            )
            call.future.set_exception(failed)
        else:
            call.future.set_result(message_of(self._types, f"{call.kind}_Response", answer))

    def _response(self, kind: str, answer: Answer, request: Any) -> Any:  # noqa: ANN401  # of the library
        """Return the response to a call; if it is refused or fails, an empty one, as ROS 2 has no error response."""
        try:
            return made(
                self._types,
                f"{kind}_Response",
                answer(message_of(self._types, f"{kind}_Request", request)),
            )
        except RosError as error:
            _log.warning("a call of %s is refused: %s", kind, error)
        except Exception as error:  # our own error must not end the node
            _log.warning(
                "a call of %s could not be answered: %s: %s",
                kind,
                type(error).__name__,
                error,
                exc_info=True,
            )
        return self._types.new(f"{kind}_Response", {})
