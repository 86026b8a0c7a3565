"""ROS 2 by rclpy, where that is installed: it comes with ROS 2, pixi or RoboStack."""

import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from threading import Thread
from typing import Any, Final

from missions.engine.mission import MissionError
from missions.wires.node import Client, Field, Message, Reader, RosError, TypedNode

_LOOK_S: Final = 0.2
"""The period of looking which other nodes are there [s]."""
_TYPE: Final = re.compile(r"(?:sequence<)?([\w/]+)(?:<\d+>)?(?:, \d+)?>?(?:\[(\d+)\])?")
"""A field's type as rclpy writes it: `sequence<double, 3>`, `std_msgs/Header`, `string<10>`, `double[36]`."""
_NAMES: Final = {"boolean": "bool", "octet": "byte", "float": "float32", "double": "float64", "wstring": "string"}


class Messages:
    """ROS 2's types as the classes of its message packages."""

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


class RclpyNode(TypedNode):
    """A node of rclpy that spins in a context and a thread of its own.

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
        super().__init__("rclpy", Messages())
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node(name, context=self._context)
        self._node.create_timer(_LOOK_S, self._look)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = Thread(target=self._spin, name="rclpy", daemon=True)
        self._thread.start()

    def close(self) -> None:
        import rclpy

        self._executor.shutdown(timeout_sec=1.0)
        rclpy.shutdown(context=self._context)
        self._thread.join()
        self._node.destroy_node()
        super().close()

    def _spin(self) -> None:
        from rclpy.executors import ExternalShutdownException, ShutdownException

        with suppress(ExternalShutdownException, ShutdownException):
            self._executor.spin()

    def _open_reader(self, reader: Reader) -> None:
        if reader.opened is not None:
            self._node.destroy_subscription(reader.opened)
        quality, take = _quality(is_reliable=reader.is_reliable), partial(self._take, reader)
        reader.opened = self._node.create_subscription(reader.kind, reader.topic, take, quality)

    def _publishers(self, reader: Reader) -> tuple[bool, bool]:
        from rclpy.qos import ReliabilityPolicy

        found = self._node.get_publishers_info_by_topic(reader.topic)
        return bool(found), any(one.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT for one in found)

    def _writer(self, topic: str, kind: Any) -> Callable[[Any], object]:  # noqa: ANN401  # of a message package
        publish: Callable[[Any], object] = self._node.create_publisher(kind, topic, _quality()).publish
        return publish

    def _client(self, service: str, kind: str) -> Client:
        client = self._node.create_client(self._types.find(kind), service)

        def send(number: int, request: Any) -> None:  # noqa: ANN401  # of a message package
            answered = client.call_async(request)
            answered.add_done_callback(lambda one: self._finish(number, one.exception() or one.result()))

        return Client(client.service_is_ready, send)

    def _serve(self, service: str, kind: str, respond: Callable[[Any], Any]) -> None:
        self._node.create_service(self._types.find(kind), service, lambda request, _: respond(request))


def _quality(*, is_reliable: bool = True) -> Any:  # noqa: ANN401  # an object of rclpy
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    sure = ReliabilityPolicy.RELIABLE if is_reliable else ReliabilityPolicy.BEST_EFFORT
    return QoSProfile(depth=1000, reliability=sure)
