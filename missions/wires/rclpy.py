"""A node of rclpy, where ROS 2 is installed: it comes with ROS 2, pixi or RoboStack."""

import re
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from threading import Thread
from typing import Any, Final

from missions.engine.mission import MissionError
from missions.wires.node import (
    TIMEOUT_S,
    Answer,
    Call,
    Clock,
    Goal,
    Heard,
    Message,
    Node,
    Reply,
    RosError,
)
from missions.wires.ros import Field, Library, to_message

_DEPTH: Final = 1000
"""How many messages of a topic may wait."""
_LOOK_S: Final = 0.2
"""The period of looking which other nodes are there [s]."""
_TYPE: Final = re.compile(r"(?:sequence<)?([\w/]+)")
"""Begins a field's type as rclpy writes it: `sequence<double, 3>`, `string<10>`, `double[36]`."""
_NAMES: Final = {
    "boolean": "bool",
    "octet": "byte",
    "float": "float32",
    "double": "float64",
    "wstring": "string",
}


class Messages(Library):
    """ROS 2's types as the classes of its message packages."""

    byte = staticmethod(lambda value: bytes([value]))

    def fields(self, kind: str) -> dict[str, Field]:
        types = self.find(kind).get_fields_and_field_types()
        return {name: _field(text) for name, text in types.items()}

    def new(self, kind: str, values: Message) -> Any:  # noqa: ANN401  # an object of rclpy
        return self.find(kind)(**values)

    def find(self, kind: str) -> Any:  # noqa: ANN401  # an object of rclpy
        """Return the class of a message, service or action, or of a part, e.g. TYPE_Request."""
        try:
            package, folder, name = kind.split("/")
            named = import_module(f"{package}.{folder}")
            for part in name.split("_"):
                named = getattr(named, part)
        except (ImportError, AttributeError, ValueError) as error:
            raise RosError(
                f"the type {kind!r} is not installed ({error}); source the workspace that has it"
            ) from None
        return named


def _field(text: str) -> Field:
    name = _TYPE.match(text)[1]  # type: ignore[index]  # it always matches
    kind = name.replace("/", "/msg/") if "/" in name else _NAMES.get(name, name)
    return Field(kind, is_list=text.startswith("sequence<") or text.endswith("]"))


@dataclass(eq=False)
class _Reader:
    """A subscription; it is opened anew when its publishers ask for another quality of service."""

    topic: str
    kind: Any
    take: Callable[[Any], None]
    quality: Any
    opened: Any = None


class RclpyGoal(Goal):
    """A goal of an `ActionClient`."""

    handle: Any = None
    is_unwanted = False

    def cancel(self) -> None:
        self.is_unwanted = True
        if self.handle is not None and not self.is_over:
            self.handle.cancel_goal_async()

    def on_response(self, handle: Any) -> None:  # noqa: ANN401  # an object of rclpy
        if not handle.accepted:
            self.error = f"{self.action} rejects the goal"
            return
        self.handle = handle
        self._progress(1)  # the handle's own status is 0 even now
        self.when(handle.get_result_async(), self._on_result)
        if self.is_unwanted:
            self.cancel()

    def on_feedback(self, message: Any) -> None:  # noqa: ANN401  # an object of rclpy
        self.feedback = to_message(message.feedback)
        self._progress(2)

    def _on_result(self, answer: Any) -> None:  # noqa: ANN401  # an object of rclpy
        self.result = to_message(answer.result)
        self._progress(answer.status)

    def when(self, future: Any, act: Callable[[Any], None]) -> None:  # noqa: ANN401  # a future of rclpy
        """Call a function with the result of a future when it is there."""

        def end(future: Any) -> None:  # noqa: ANN401  # a future of rclpy
            if future.exception() is None:
                act(future.result())
            else:
                self.error = f"{self.action} failed: {future.exception()}"

        future.add_done_callback(end)


class RclpyNode(Node):
    """A node of rclpy that spins in a context and a thread of its own.

    Raises:
        MissionError: rclpy is not installed, or cannot start.
    """

    def __init__(self, name: str = "rosa_kb", *, clock: Clock = time.monotonic) -> None:
        super().__init__(clock)
        try:
            import rclpy
            from rclpy.context import Context
            from rclpy.executors import SingleThreadedExecutor
        except ImportError as error:
            raise MissionError(
                f"rclpy is not installed ({error}); it comes with ROS 2 (pixi, RoboStack, a robot),"
                " not from PyPI; source its setup file, or use a rosbridge"
            ) from None
        self.types = Messages()
        self._readers: list[_Reader] = []
        self._partners: dict[tuple[str, str], Any] = {}
        """Publishers and clients by name and type."""
        try:
            self._context = Context()
            rclpy.init(context=self._context)
            self._node = rclpy.create_node(name, context=self._context)
            self._node.create_timer(_LOOK_S, self._look)
            self._executor = SingleThreadedExecutor(context=self._context)
            self._executor.add_node(self._node)
        except Exception as error:  # of whatever middleware
            problem = f"rclpy cannot start: {error}; does `ros2 topic list` work?"
            raise MissionError(problem) from error
        self._report(False, "rclpy: no other node is there")
        self._thread = Thread(target=self._spin, name="rclpy", daemon=True)
        self._thread.start()

    def close(self) -> None:
        import rclpy

        if not self._thread.is_alive():
            return
        self._executor.shutdown(timeout_sec=1.0)
        rclpy.shutdown(context=self._context)
        self._thread.join()
        self._node.destroy_node()
        for call in list(self._calls.values()):
            error = RosError(f"{call.service} is not answered any more: the node is closed")
            self._end_call(call, error)

    def subscribe(self, topic: str, kind: str, hearer: Heard) -> None:
        def take(thing: Any) -> None:  # noqa: ANN401  # an object of rclpy
            self._hand_on(topic, thing, lambda thing: hearer(to_message(thing)))

        from rclpy.qos import QoSProfile

        reader = _Reader(topic, self.types.find(kind), take, QoSProfile(depth=_DEPTH))
        with self._lock:
            self._open_reader(reader)
            self._readers.append(reader)

    def publish(self, topic: str, kind: str, message: Message) -> None:
        thing = self.types.to_object(kind, message)
        self._partner(topic, kind, self._node.create_publisher, _DEPTH).publish(thing)

    def call(
        self, service: str, kind: str, request: Message, timeout_s: float = TIMEOUT_S
    ) -> Reply:
        thing = self.types.to_object(f"{kind}_Request", request)
        client = self._partner(service, kind, self._node.create_client)
        call = self._open_call(service, timeout_s, (client, thing))
        call.overdue = f"nobody serves {service}"  # until it is sent
        self._send_call(call)
        return call.reply

    def serve(self, service: str, kind: str, answer: Answer) -> None:
        def respond(request: Any, response: Any) -> Any:  # noqa: ANN401  # an object of rclpy
            try:
                return self.types.to_object(f"{kind}_Response", answer(to_message(request)))
            except Exception as error:  # it must not end the node
                self.refused.add(error)
                return response

        self._node.create_service(self.types.find(kind), service, respond)

    def send_goal(self, action: str, kind: str, goal: Message) -> RclpyGoal:
        from rclpy.action import ActionClient

        thing = self.types.to_object(f"{kind}_Goal", goal)
        sent = RclpyGoal(action)
        client = self._partner(action, kind, partial(ActionClient, self._node))
        response = client.send_goal_async(thing, feedback_callback=sent.on_feedback)
        sent.when(response, sent.on_response)
        return sent

    def publishers(self, topic: str) -> int:
        return len(self._node.get_publishers_info_by_topic(topic))

    def _partner(self, place: str, kind: str, create: Callable[..., Any], *more: object) -> Any:  # noqa: ANN401  # an object of rclpy
        """Return a publisher or a client; it is made when it is first needed."""
        with self._lock:
            if (place, kind) not in self._partners:
                self._partners[place, kind] = create(self.types.find(kind), place, *more)
        return self._partners[place, kind]

    def _spin(self) -> None:
        from rclpy.executors import ExternalShutdownException, ShutdownException

        with suppress(ExternalShutdownException, ShutdownException):
            self._executor.spin()

    def _open_reader(self, reader: _Reader) -> None:
        if reader.opened is not None:
            self._node.destroy_subscription(reader.opened)
        create = self._node.create_subscription
        reader.opened = create(reader.kind, reader.topic, reader.take, reader.quality)

    def _look(self) -> None:
        """Look which other nodes are there, and send the calls that waited for their service."""
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        is_published = False
        with self._lock:
            for reader in self._readers:
                infos = self._node.get_publishers_info_by_topic(reader.topic)
                qualities = [info.qos_profile for info in infos]
                if not qualities:
                    continue
                is_published = True
                best_effort = ReliabilityPolicy.BEST_EFFORT
                latched = DurabilityPolicy.TRANSIENT_LOCAL
                quality = QoSProfile(depth=_DEPTH)
                if any(other.reliability == best_effort for other in qualities):
                    quality.reliability = best_effort
                if all(other.durability == latched for other in qualities):
                    quality.durability = latched  # so it hears what was published before
                if quality != reader.quality:
                    reader.quality = quality
                    self._open_reader(reader)
        for call in list(self._calls.values()):
            self._send_call(call)
        if is_published != self.is_connected:
            presence = "other nodes are there" if is_published else "no other node is there"
            self._report(is_published, f"rclpy: {presence}")

    def _send_call(self, call: Call) -> None:
        """Send a call, once, when its service is there."""
        with self._lock:
            client, request = call.details
            if request is None or not client.service_is_ready():
                return
            call.details = client, None
        call.overdue = f"{call.service} has not answered in time"
        client.call_async(request).add_done_callback(partial(self._on_answer, call))

    def _on_answer(self, call: Call, future: Any) -> None:  # noqa: ANN401  # an object of rclpy
        if future.exception() is not None:
            self._end_call(call, RosError(f"{call.service} failed: {future.exception()}"))
        else:
            self._end_call(call, to_message(future.result()))
