"""A node of rclpy, where ROS 2 is installed: it comes with ROS 2, pixi or RoboStack."""

import logging
import re
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from threading import Thread
from typing import Any, Final

from missions.engine.mission import MissionError
from missions.wires.node import TIMEOUT_S, Answer, Call, Clock, Goal, Heard, Message, Node, RosError
from missions.wires.ros import Field, to_message, to_object

_LOOK_S: Final = 0.2
"""The period of looking which other nodes are there [s]."""
_TYPE: Final = re.compile(r"(?:sequence<)?([\w/]+)(?:<\d+>)?(?:, \d+)?>?(?:\[(\d+)\])?")
"""A field's type as rclpy writes it: `sequence<double, 3>`, `string<10>`, `double[36]`."""
_NAMES: Final = {
    "boolean": "bool",
    "octet": "byte",
    "float": "float32",
    "double": "float64",
    "wstring": "string",
}
_log = logging.getLogger(__name__)


class Messages:
    """ROS 2's types as the classes of its message packages."""

    def __init__(self) -> None:
        self._fields: dict[str, Mapping[str, Field]] = {}

    def fields(self, kind: str) -> Mapping[str, Field]:
        if kind not in self._fields:
            types = self.find(kind).get_fields_and_field_types()
            self._fields[kind] = {name: _field(text) for name, text in types.items()}
        return self._fields[kind]

    def new(self, kind: str, values: Message) -> Any:  # noqa: ANN401  # an object of rclpy
        fields = self.fields(kind)
        native = {name: _native(fields[name], value) for name, value in values.items()}
        return self.find(kind)(**native)

    def find(self, kind: str) -> Any:  # noqa: ANN401  # an object of rclpy
        """Return the class of a message, service or action, or of a part, e.g. TYPE_Request."""
        from rosidl_runtime_py import utilities

        part = kind.rpartition("/")[2].partition("_")[2]
        name = kind.removesuffix(f"_{part}")
        try:
            if "/srv/" in kind:
                whole = utilities.get_service(name)
            elif "/action/" in kind:
                whole = utilities.get_action(name)
            else:
                whole = utilities.get_message(kind)
        except (ImportError, AttributeError, ValueError) as error:
            advice = "source the workspace that has it"
            raise RosError(f"the type {kind!r} is not installed ({error}); {advice}") from None
        return getattr(whole, part) if part else whole


def _field(text: str) -> Field:
    match = _TYPE.fullmatch(text)
    if match is None:
        raise RosError(f"the type {text!r} of a field is not known")
    name, size = match.groups()
    length = int(size) if size else None
    if text.startswith("sequence"):
        length = 0
    return Field(name.replace("/", "/msg/") if "/" in name else _NAMES.get(name, name), length)


def _native(field: Field, value: Any) -> Any:  # noqa: ANN401  # of a field
    if field.kind != "byte":
        return value
    return bytes([value]) if field.length is None else [bytes([item]) for item in value]


@dataclass(eq=False)
class _Reader:
    """A subscription; it is opened anew when its publishers ask for another quality of service."""

    topic: str
    kind: str
    hearer: Heard
    opened: Any = None
    quality: tuple[bool, bool] = (True, False)
    """Whether it is reliable, and whether it hears what was published before it was there."""


class RclpyGoal(Goal):
    """A goal of an `ActionClient`."""

    handle: Any = None
    is_unwanted = False

    def __init__(self, node: "RclpyNode", action: str, kind: str) -> None:
        super().__init__(action)
        self._types = node.types
        self._kind = kind

    def cancel(self) -> None:
        self.is_unwanted = True
        if self.handle is not None and not self.is_over:
            self.handle.cancel_goal_async().add_done_callback(self._on_cancel)

    def on_response(self, future: Any) -> None:  # noqa: ANN401  # an object of rclpy
        handle = self._value(future)
        if handle is not None and not handle.accepted:
            self.error = f"{self.action} rejects the goal"
        elif handle is not None:
            self.handle = handle
            self._progress(1)  # the handle's own status is 0 even now
            handle.get_result_async().add_done_callback(self._on_result)
            if self.is_unwanted:
                self.cancel()

    def on_feedback(self, message: Any) -> None:  # noqa: ANN401  # an object of rclpy
        self.feedback = to_message(self._types, f"{self._kind}_Feedback", message.feedback)
        self._progress(2)

    def _on_result(self, future: Any) -> None:  # noqa: ANN401  # an object of rclpy
        answer = self._value(future)
        if answer is not None:
            self.result = to_message(self._types, f"{self._kind}_Result", answer.result)
            self._progress(answer.status)

    def _on_cancel(self, future: Any) -> None:  # noqa: ANN401  # an object of rclpy
        answer = self._value(future)
        if answer is not None:  # its return code is 0 even when the cancel is refused
            self.is_cancel_refused = not answer.goals_canceling

    def _value(self, future: Any) -> Any:  # noqa: ANN401  # an object of rclpy
        if future.exception() is None:
            return future.result()
        self.error = f"{self.action} failed: {future.exception()}"
        return None


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
            source = "it comes with ROS 2 (pixi, RoboStack, a robot), not from PyPI"
            advice = "source its setup file, or use a rosbridge"
            raise MissionError(f"rclpy is not installed ({error}); {source}; {advice}") from None
        self.types = Messages()
        self._readers: list[_Reader] = []
        self._publish: dict[str, Callable[[Any], object]] = {}
        self._clients: dict[str, Any] = {}
        try:
            self._context = Context()
            rclpy.init(context=self._context)
            self._node = rclpy.create_node(name, context=self._context)
            self._node.create_timer(_LOOK_S, self._look)
            self._executor = SingleThreadedExecutor(context=self._context)
            self._executor.add_node(self._node)
        except Exception as error:  # of whatever middleware
            raise MissionError(
                f"rclpy cannot start: {error}; does `ros2 topic list` work?"
            ) from error
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
        for number, call in list(self._calls.items()):
            error = RosError(f"{call.service} is not answered any more: the node is closed")
            self._end_call(number, error)

    def subscribe(self, topic: str, kind: str, hearer: Heard) -> None:
        self.types.find(kind)
        reader = _Reader(topic, kind, hearer)
        with self._lock:
            self._open_reader(reader)
            self._readers.append(reader)

    def publish(self, topic: str, kind: str, message: Message) -> None:
        thing = to_object(self.types, kind, message)
        with self._lock:
            if topic not in self._publish:
                quality = _quality(is_reliable=True, is_latched=False)
                publisher = self._node.create_publisher(self.types.find(kind), topic, quality)
                self._publish[topic] = publisher.publish
        self._publish[topic](thing)

    def call(
        self, service: str, kind: str, request: Message, timeout_s: float = TIMEOUT_S
    ) -> "Future[Message]":
        thing = to_object(self.types, f"{kind}_Request", request)
        with self._lock:
            if service not in self._clients:
                client = self._node.create_client(self.types.find(kind), service)
                self._clients[service] = client
        number, call = self._open_call(service, kind, timeout_s)
        call.details = thing
        self._send_call(number, call)
        return call.future

    def serve(self, service: str, kind: str, answer: Answer) -> None:
        def respond(request: Any, _: Any) -> Any:  # noqa: ANN401  # an object of rclpy
            return self._response(kind, answer, request)

        self._node.create_service(self.types.find(kind), service, respond)

    def send_goal(self, action: str, kind: str, goal: Message) -> RclpyGoal:
        from rclpy.action import ActionClient

        thing = to_object(self.types, f"{kind}_Goal", goal)
        with self._lock:
            if action not in self._clients:
                self._clients[action] = ActionClient(self._node, self.types.find(kind), action)
        sent = RclpyGoal(self, action, kind)
        response = self._clients[action].send_goal_async(thing, feedback_callback=sent.on_feedback)
        response.add_done_callback(sent.on_response)
        return sent

    def publishers(self, topic: str) -> int:
        return len(self._node.get_publishers_info_by_topic(topic))

    def _spin(self) -> None:
        from rclpy.executors import ExternalShutdownException, ShutdownException

        with suppress(ExternalShutdownException, ShutdownException):
            self._executor.spin()

    def _open_reader(self, reader: _Reader) -> None:
        if reader.opened is not None:
            self._node.destroy_subscription(reader.opened)
        is_reliable, is_latched = reader.quality
        quality = _quality(is_reliable=is_reliable, is_latched=is_latched)
        kind, take = self.types.find(reader.kind), partial(self._take, reader)
        reader.opened = self._node.create_subscription(kind, reader.topic, take, quality)

    def _take(self, reader: _Reader, thing: Any) -> None:  # noqa: ANN401  # an object of rclpy
        try:
            reader.hearer(to_message(self.types, reader.kind, thing))
        except Exception as error:  # a malformed message, or an error of the hearer
            self.refused.add(error)

    def _look(self) -> None:
        """Look which other nodes are there, and send the calls that waited for their service."""
        from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

        is_published = False
        with self._lock:
            for reader in self._readers:
                infos = self._node.get_publishers_info_by_topic(reader.topic)
                profiles = [info.qos_profile for info in infos]
                if not profiles:
                    continue
                is_published = True
                best_effort, latched = (
                    ReliabilityPolicy.BEST_EFFORT,
                    DurabilityPolicy.TRANSIENT_LOCAL,
                )
                is_reliable = all(profile.reliability != best_effort for profile in profiles)
                is_latched = all(profile.durability == latched for profile in profiles)
                if reader.quality != (is_reliable, is_latched):
                    reader.quality = (is_reliable, is_latched)
                    self._open_reader(reader)
            waiting = list(self._calls.items())
        for number, call in waiting:
            self._send_call(number, call)
        presence = "other nodes are there" if is_published else "all other nodes are gone"
        if is_published != self.is_connected:
            self._report(is_published, f"rclpy: {presence}")

    def _send_call(self, number: str, call: Call) -> None:
        """Send a call once its service is there; fail it when the service is gone."""
        client = self._clients[call.service]
        is_ready = client.service_is_ready()
        with self._lock:
            request, call.details = call.details, None if is_ready else call.details
        if is_ready and request is not None:
            answered = client.call_async(request)
            answered.add_done_callback(partial(self._on_answer, number, call))
        elif not is_ready and request is None:
            self._end_call(number, RosError(f"the server of {call.service} is gone"))

    def _on_answer(self, number: str, call: Call, future: Any) -> None:  # noqa: ANN401  # an object of rclpy
        if future.exception() is not None:
            self._end_call(number, RosError(f"{call.service} failed: {future.exception()}"))
        else:
            answer = to_message(self.types, f"{call.kind}_Response", future.result())
            self._end_call(number, answer)

    def _expire(self, number: str) -> None:
        call = self._calls.get(number)
        if call is not None and call.details is not None:  # it was never sent
            self._end_call(number, RosError(f"nobody serves {call.service}"))
        super()._expire(number)

    def _response(self, kind: str, answer: Answer, request: Any) -> Any:  # noqa: ANN401  # an object of rclpy
        """Return the response to a call, an empty one if it fails: ROS 2 has no error response."""
        try:
            message = answer(to_message(self.types, f"{kind}_Request", request))
            return to_object(self.types, f"{kind}_Response", message)
        except RosError as error:
            _log.warning("a call of %s is refused: %s", kind, error)
        except Exception:  # our own error must not end the node
            _log.warning("a call of %s could not be answered", kind, exc_info=True)
        return self.types.new(f"{kind}_Response", {})


def _quality(*, is_reliable: bool, is_latched: bool) -> Any:  # noqa: ANN401  # an object of rclpy
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    reliability = ReliabilityPolicy.RELIABLE if is_reliable else ReliabilityPolicy.BEST_EFFORT
    durability = DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE
    return QoSProfile(depth=1000, reliability=reliability, durability=durability)
