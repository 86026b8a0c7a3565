"""ROS 2's messages without ROS, as dicts like its JSON, with the types of `rosbags`; and a node of rclpy.

rclpy works where ROS 2 is installed: it comes with ROS 2, pixi or RoboStack.
"""

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any, Final

from kb import Event
from missions.engine.mission import MissionError, needs
from missions.wires.node import Client, Field, Message, Reader, RosError, TypedNode, made

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

DIAGNOSTICS: Final = "diagnostic_msgs/msg/DiagnosticArray"
FLOAT: Final = "std_msgs/msg/Float64"
LOG: Final = "rcl_interfaces/msg/Log"
POSE: Final = "geometry_msgs/msg/PoseStamped"
STRING: Final = "std_msgs/msg/String"
TF: Final = "tf2_msgs/msg/TFMessage"
TREE_LOG: Final = "nav2_msgs/msg/BehaviorTreeLog"
INFO, WARN = 20, 30
"""Severity levels of rcl_interfaces/Log."""
FRAME, BODY = "map", "base_link"
"""The world frame (z up) and the robot's frame, named as in REP 105."""
_DEFINITIONS: Final = Path(__file__).with_name("definitions.txt")
"""Definitions of the messages and services that `rosbags` does not have."""
NOTHING: Final = "structure_needs_at_least_one_member"
"""The field that a message without fields has on the wire."""
_UPRIGHT: Final = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


class Types:
    """ROS 2's types as `rosbags` has them; makes messages, and encodes and decodes them as CDR."""

    def __init__(self, store: "Typestore") -> None:
        self.store = store
        self._fields: dict[str, Mapping[str, Field]] = {}

    def fields(self, kind: str) -> Mapping[str, Field]:
        if kind not in self._fields:
            known = self.store.fielddefs
            if kind not in known:
                what = f"the type {kind!r} is not known" if kind else "no type is named"
                raise RosError(f"{what}; name one of ROS 2's, PACKAGE/msg/TYPE")
            self._fields[kind] = {
                name: _field(*one) for name, one in known[kind][1] if name != NOTHING
            }
        return self._fields[kind]

    def find(self, kind: str) -> Any:  # noqa: ANN401  # `rosbags` makes classes
        return self.store.types[kind]

    def new(self, kind: str, values: Message) -> Any:  # noqa: ANN401  # of a class that is made
        fields = self.fields(kind)
        whole = {
            name: values[name] if name in values else self._empty(field)
            for name, field in fields.items()
        }
        return self.find(kind)(**whole or {NOTHING: 0})

    def definition(self, kind: str) -> str:
        """Return the text that defines a type and the types in it, as recordings hold it."""
        return str(self.store.generate_msgdef(kind, ros_version=2)[0])

    def encode(self, kind: str, message: Message) -> bytes:
        return bytes(self.store.serialize_cdr(made(self, kind, message), kind))

    def decode(self, kind: str, data: bytes) -> Any:  # noqa: ANN401  # of a class that is made
        return self.store.deserialize_cdr(data, kind)

    def _empty(self, field: Field) -> Any:  # noqa: ANN401  # of whatever type
        if field.length == 0:
            return []
        one = self.new(field.kind, {}) if "/" in field.kind else "" if field.kind == "string" else 0
        return one if field.length is None else [one] * field.length


def _field(node: Any, what: Any) -> Field:  # noqa: ANN401  # as `rosbags` has it
    if node.name in ("ARRAY", "SEQUENCE"):
        return Field(_field(*what[0]).kind, what[1] if node.name == "ARRAY" else 0)
    return Field(what if node.name == "NAME" else what[0])


@cache
def types() -> Types:
    """Return ROS 2's types; they are made once, in 0.2 s.

    Raises:
        MissionError: the extra `mcap` is missing.
    """
    with needs("mcap", "recordings as MCAP and rosbag2"):
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    store = get_typestore(Stores.ROS2_HUMBLE)
    for line in _DEFINITIONS.read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            continue
        name, text = line.split(":", 1)
        package, base = name.split("/")
        parts = text.split("->")
        for ending, part in zip(
            ("_Request", "_Response") if len(parts) > 1 else ("",), parts, strict=True
        ):
            fields = part.strip().replace(", ", "\n") or f"uint8 {NOTHING}"
            (found,) = get_types_from_msg(fields, f"{package}/msg/{base}").values()
            store.register({f"{package}/{'srv' if ending else 'msg'}/{base}{ending}": found})
    return Types(store)


def nanoseconds(time_s: float) -> int:
    return round(time_s * 1e9)


def stamp(time_s: float) -> Message:
    return dict(zip(("sec", "nanosec"), divmod(nanoseconds(time_s), 10**9), strict=True))


def _header(time_s: float, frame: str) -> Message:
    return {"stamp": stamp(time_s), "frame_id": frame}


def json_text(value: object) -> Message:
    return {"data": json.dumps(value, separators=(",", ":"))}


def diagnostics(time_s: float, statuses: Iterable[Mapping[str, Any]]) -> Message:
    """Return a DiagnosticArray at a time [s]; each status has `name`, `message` and `values`."""
    statuses = [
        {
            "name": str(one.get("name", "")),
            "message": str(one["message"]),
            "values": [
                {"key": str(key), "value": str(value)} for key, value in one["values"].items()
            ],
        }
        for one in statuses
    ]
    return {"header": _header(time_s, ""), "status": statuses}


def log_of(event: Event, more: str = "") -> Message:
    """Return a log message for an event: a plan with its reason, a failed component as a warning."""
    why = f" because {event.plan.reason}" if event.plan is not None and event.plan.reason else ""
    return log(
        event.time, WARN if event.verb == "component_failed" else INFO, f"{event.text}{why}{more}"
    )


def log(time_s: float, level: int, text: str) -> Message:
    entry = {"stamp": stamp(time_s), "level": level, "name": "rosa_kb", "msg": text}
    return {**entry, "file": "", "function": "", "line": 0}


def tree_log(time_s: float, changes: Sequence[tuple[str, int, str, str]]) -> Message:
    """Return Nav2's message of status changes: (node name, uid, previous status, current status) of each."""
    now, names = stamp(time_s), ("node_name", "uid", "previous_status", "current_status")
    changed = [{"timestamp": now, **dict(zip(names, change, strict=True))} for change in changes]
    return {"timestamp": now, "event_log": changed}


def pose(time_s: float, position: Sequence[float]) -> Message:
    """Return a pose at (x, y, z) [m], world frame; upright, as the attitude is not known."""
    where = dict(zip("xyz", position, strict=True))
    return {"header": _header(time_s, FRAME), "pose": {"position": where, "orientation": _UPRIGHT}}


def transform(time_s: float, position: Sequence[float]) -> Message:
    """Return the same pose as a transform from the world frame to the robot's frame."""
    moved = {"translation": dict(zip("xyz", position, strict=True)), "rotation": _UPRIGHT}
    return {
        "transforms": [
            {"header": _header(time_s, FRAME), "child_frame_id": BODY, "transform": moved}
        ]
    }


def statuses_of(data: bytes) -> list[dict[str, Any]]:
    """Return the statuses in the CDR bytes of a DiagnosticArray, each with `name`, `message` and `values`."""
    return [
        {
            "name": one.name,
            "message": one.message,
            "values": {pair.key: pair.value for pair in one.values},
        }
        for one in types().decode(DIAGNOSTICS, data).status
    ]


# ------------------------------------------------------------ ROS 2 itself, where it is installed

_LOOK_S: Final = 0.2
"""The period of looking which other nodes are there [s]."""
_TYPE: Final = re.compile(r"(?:sequence<)?([\w/]+)(?:<\d+>)?(?:, \d+)?>?(?:\[(\d+)\])?")
"""A field's type as rclpy writes it: `sequence<double, 3>`, `std_msgs/Header`, `string<10>`, `double[36]`."""
_NAMES: Final = {
    "boolean": "bool",
    "octet": "byte",
    "float": "float32",
    "double": "float64",
    "wstring": "string",
}


class Messages:
    """ROS 2's types as the classes of its message packages."""

    def __init__(self) -> None:
        self._fields: dict[str, Mapping[str, Field]] = {}

    def fields(self, kind: str) -> Mapping[str, Field]:
        if kind not in self._fields:
            written = self.find(kind).get_fields_and_field_types()
            self._fields[kind] = {name: _written(text) for name, text in written.items()}
        return self._fields[kind]

    def new(self, kind: str, values: Message) -> Any:  # noqa: ANN401  # of a message package
        fields = self.fields(kind)
        return self.find(kind)(
            **{name: _native(fields[name], value) for name, value in values.items()}
        )

    def find(self, kind: str) -> Any:  # noqa: ANN401  # of a message package
        """Return the class of a message, or of a service."""
        from rosidl_runtime_py.utilities import get_message, get_service

        name, _, part = kind.partition("_Re") if "/srv/" in kind else (kind, "", "")
        try:
            found = get_service(name) if "/srv/" in name else get_message(name)
        except (ImportError, AttributeError, ValueError) as error:
            raise RosError(
                f"the type {kind!r} is not installed ({error}); source the workspace that has it"
            ) from None
        return getattr(found, f"Re{part}") if part else found


def _written(text: str) -> Field:
    found = _TYPE.fullmatch(text)
    if found is None:
        raise RosError(f"the type {text!r} of a field is not known")
    name, length = (
        found[1],
        0 if text.startswith("sequence") else int(found[2]) if found[2] else None,
    )
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
        return bool(found), any(
            one.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT for one in found
        )

    def _writer(self, topic: str, kind: Any) -> Callable[[Any], object]:  # noqa: ANN401  # of a message package
        publish: Callable[[Any], object] = self._node.create_publisher(
            kind, topic, _quality()
        ).publish
        return publish

    def _client(self, service: str, kind: str) -> Client:
        client = self._node.create_client(self._types.find(kind), service)

        def send(number: int, request: Any) -> None:  # noqa: ANN401  # of a message package
            answered = client.call_async(request)
            answered.add_done_callback(
                lambda one: self._finish(number, one.exception() or one.result())
            )

        return Client(client.service_is_ready, send)

    def _serve(self, service: str, kind: str, respond: Callable[[Any], Any]) -> None:
        self._node.create_service(
            self._types.find(kind), service, lambda request, _: respond(request)
        )


def _quality(*, is_reliable: bool = True) -> Any:  # noqa: ANN401  # an object of rclpy
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    sure = ReliabilityPolicy.RELIABLE if is_reliable else ReliabilityPolicy.BEST_EFFORT
    return QoSProfile(depth=1000, reliability=sure)
