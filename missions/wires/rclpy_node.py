"""ROS 2 by rclpy, where it is installed: with ROS 2 itself, from pixi or RoboStack, or on a robot."""

import logging
import re
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from threading import RLock, Thread
from time import monotonic
from typing import Any, Final

from missions.engine.mission import MissionError
from missions.wires.node import Answer, Heard, Message, Refusals, RosError
from missions.wires.typed import Field, made, response, told

_LOOK_S: Final = 0.2
"""How often it is looked who is there [s]."""
_FIND_S: Final = 3.0
"""How long a service is sought before a call fails [s]."""
_TYPE: Final = re.compile(r"(?:sequence<)?([\w/]+)(?:<\d+>)?(?:, \d+)?>?(?:\[(\d+)\])?")
"""A type as messages of rclpy write it: `sequence<double, 3>`, `std_msgs/Header`, `string<10>`, `double[36]`."""
_NAMES: Final = {"boolean": "bool", "octet": "byte", "float": "float32", "double": "float64", "wstring": "string"}
_log = logging.getLogger(__name__)


class _Messages:
    """Types of ROS 2 as the classes of its message packages."""

    def __init__(self) -> None:
        self._fields: dict[str, Mapping[str, Field]] = {}

    def fields(self, kind: str) -> Mapping[str, Field]:
        if kind not in self._fields:
            written = self.find(kind).get_fields_and_field_types()
            self._fields[kind] = {name: _field(text) for name, text in written.items()}
        return self._fields[kind]

    def new(self, kind: str, values: Message) -> Any:  # noqa: ANN401  # of a message package
        fields = self.fields(kind)
        return self.find(kind)(**{name: _native(fields[name], value) for name, value in values.items()})

    def find(self, kind: str) -> Any:  # noqa: ANN401  # of a message package
        """Return the class of a message, or of a service."""
        from rosidl_runtime_py.utilities import get_message, get_service

        name, _, part = kind.partition("_Re") if "/srv/" in kind else (kind, "", "")
        try:
            found = get_service(name) if "/srv/" in name else get_message(name)
        except (ImportError, AttributeError, ValueError) as error:
            raise RosError(f"the type {kind!r} is not installed ({error}); source the workspace that has it") from None
        return getattr(found, f"Re{part}") if part else found


def _field(text: str) -> Field:
    found = _TYPE.fullmatch(text)
    if found is None:
        raise RosError(f"the type {text!r} of a field is not known")
    name, length = found[1], 0 if text.startswith("sequence") else int(found[2]) if found[2] else None
    return Field(name.replace("/", "/msg/") if "/" in name else _NAMES.get(name, name), length)


def _native(field: Field, value: Any) -> Any:  # noqa: ANN401  # of a field
    if field.kind != "byte":
        return value
    return bytes([value]) if field.length is None else [bytes([one]) for one in value]


@dataclass(eq=False)
class _Ear:
    """A subscription, made anew if somebody publishes who does not repeat what is lost."""

    topic: str
    kind: str
    heard: Heard
    subscription: Any = None
    is_reliable: bool = True


@dataclass(eq=False)
class _Call:
    """A call that is to be answered, and sent when its service is there."""

    service: str
    kind: str
    client: Any
    request: Any
    future: "Future[Message]"
    until_s: float
    is_sent: bool = False


class RclpyNode:
    """A node of rclpy, in a context and a thread of its own.

    Args:
        name: of the node.

    Attributes:
        refused: how many messages made no sense, by what was wrong.

    Raises:
        MissionError: rclpy is not installed.
    """

    def __init__(self, name: str = "rosa_kb") -> None:
        try:
            import rclpy
            from rclpy.context import Context
            from rclpy.executors import SingleThreadedExecutor
        except ImportError as error:
            where = "it comes with ROS 2 (pixi, RoboStack, a robot), not from PyPI; source its setup file, or use --dds"
            raise MissionError(f"rclpy is not installed ({error}); {where}, or rosbridge") from None
        self.refused = Refusals()
        self._types, self._lock = _Messages(), RLock()
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node(name, context=self._context)
        self._ears: list[_Ear] = []
        self._publishers: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}
        self._open: list[_Call] = []
        self._watching: list[Callable[[bool, str], object]] = []
        self._is_there = False
        self._node.create_timer(_LOOK_S, self._look)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = Thread(target=self._spin, name="rclpy", daemon=True)
        self._thread.start()

    def subscribe(self, topic: str, kind: str, heard: Heard) -> None:
        self._types.find(kind)
        ear = _Ear(topic, kind, heard)
        with self._lock:
            self._listen(ear)
            self._ears.append(ear)

    def publish(self, topic: str, kind: str, message: Message) -> None:
        thing = made(self._types, kind, message)
        with self._lock:
            if topic not in self._publishers:
                self._publishers[topic] = self._node.create_publisher(self._types.find(kind), topic, _quality())
        self._publishers[topic].publish(thing)

    def call(self, service: str, kind: str, request: Message) -> "Future[Message]":
        thing, future = made(self._types, f"{kind}_Request", request), Future[Message]()
        with self._lock:
            if service not in self._clients:
                self._clients[service] = self._node.create_client(self._types.find(kind), service)
            call = _Call(service, kind, self._clients[service], thing, future, monotonic() + _FIND_S)
            self._open.append(call)
            self._send_call(call)
        return future

    def serve(self, service: str, kind: str, answer: Answer) -> None:
        def respond(request: Any, _: Any) -> Any:  # noqa: ANN401  # of a message package
            return response(self._types, kind, answer, request, _log.warning)

        self._node.create_service(self._types.find(kind), service, respond)

    def watch(self, changed: Callable[[bool, str], object]) -> None:
        self._watching.append(changed)
        changed(self._is_there, f"rclpy: {'others are' if self._is_there else 'nobody else is'} there")

    def close(self) -> None:
        import rclpy

        self._executor.shutdown(timeout_sec=1.0)
        rclpy.shutdown(context=self._context)
        self._thread.join()
        self._node.destroy_node()
        for call in self._open:
            call.future.set_exception(RosError(f"{call.service} is not answered any more: the node is closed"))
        self._open = []

    def _spin(self) -> None:
        from rclpy.executors import ExternalShutdownException, ShutdownException

        with suppress(ExternalShutdownException, ShutdownException):
            self._executor.spin()

    def _listen(self, ear: _Ear) -> None:
        quality = _quality(is_reliable=ear.is_reliable)
        take = partial(self._take, ear)
        ear.subscription = self._node.create_subscription(self._types.find(ear.kind), ear.topic, take, quality)

    def _take(self, ear: _Ear, thing: Any) -> None:  # noqa: ANN401  # of a message package
        try:
            ear.heard(told(self._types, ear.kind, thing))
        except Exception as error:  # of who hears it; rclpy would stop
            self.refused.add(error)

    def _look(self) -> None:
        """See who is there; send calls that waited for that, and end those that nobody answers."""
        from rclpy.qos import ReliabilityPolicy

        with self._lock:
            publishers = [(ear, self._node.get_publishers_info_by_topic(ear.topic)) for ear in self._ears]
            for ear, found in publishers:
                if ear.is_reliable and any(
                    one.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT for one in found
                ):
                    ear.is_reliable = False
                    self._node.destroy_subscription(ear.subscription)
                    self._listen(ear)
            for call in list(self._open):
                self._send_call(call)
        is_there = any(found for _, found in publishers)
        if is_there != self._is_there:
            self._is_there = is_there
            for changed in self._watching:
                changed(is_there, f"rclpy: {'others are there' if is_there else 'everybody else is gone'}")

    def _send_call(self, call: _Call) -> None:
        is_there = call.client.service_is_ready()
        if is_there and not call.is_sent:
            call.is_sent = True
            call.client.call_async(call.request).add_done_callback(partial(self._finish, call))
        elif not is_there and (call.is_sent or monotonic() > call.until_s):
            self._open.remove(call)
            why = f"who served {call.service} is gone" if call.is_sent else f"nobody serves {call.service}"
            call.future.set_exception(RosError(why))

    def _finish(self, call: _Call, answered: Any) -> None:  # noqa: ANN401  # a future of rclpy
        with self._lock:
            if call not in self._open:
                return
            self._open.remove(call)
        if answered.exception() is not None:
            call.future.set_exception(RosError(f"{call.service} failed: {answered.exception()}"))
        else:
            call.future.set_result(told(self._types, f"{call.kind}_Response", answered.result()))


def _quality(*, is_reliable: bool = True) -> Any:  # noqa: ANN401  # an object of rclpy
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    sure = ReliabilityPolicy.RELIABLE if is_reliable else ReliabilityPolicy.BEST_EFFORT
    return QoSProfile(depth=1000, reliability=sure)
