"""ROS 2's messages as dicts like its JSON, and those that we publish and record.

Recordings take the types from `rosbags`, so they need no ROS.
"""

import json
import math
import re
from base64 import b64decode
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol

from kb import Event
from missions.engine.mission import MissionError, needs
from missions.views.output import plain
from missions.wires.node import Message, RosError

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
_KIND: Final = re.compile(r"\w+/msg/\w+")
_FLOATS: Final = ("float32", "float64")
_UPRIGHT: Final = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


class Types:
    """ROS 2's types as `rosbags` has them; makes messages, and encodes and decodes them as CDR."""

    def __init__(self, store: "Typestore") -> None:
        self.store = store
        self._fields: dict[str, Mapping[str, Field]] = {}

    def fields(self, kind: str) -> Mapping[str, "Field"]:
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
        return bytes(self.store.serialize_cdr(to_object(self, kind, message), kind))

    def decode(self, kind: str, data: bytes) -> Any:  # noqa: ANN401  # of a class that is made
        return self.store.deserialize_cdr(data, kind)

    def _empty(self, field: "Field") -> Any:  # noqa: ANN401  # of whatever type
        if field.length == 0:
            return []
        one = self.new(field.kind, {}) if "/" in field.kind else "" if field.kind == "string" else 0
        return one if field.length is None else [one] * field.length


def _field(node: Any, what: Any) -> "Field":  # noqa: ANN401  # as `rosbags` has it
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


def diagnostics(time_s: float, array: Any) -> Message:  # noqa: ANN401  # in any form
    """Return a DiagnosticArray at a time [s] from rclpy's object, a dict or CDR bytes.

    The values of a status are pairs or a mapping; level, name and hardware_id may be missing.
    """
    if isinstance(array, bytes):
        array = types().decode(DIAGNOSTICS, array)
    statuses = []
    for status in _fields(array)["status"]:
        fields = _fields(status)
        level, pairs = fields.get("level", 0), fields["values"]
        if isinstance(pairs, Mapping):
            pairs = [{"key": key, "value": value} for key, value in pairs.items()]
        values = [{key: str(_fields(pair)[key]) for key in ("key", "value")} for pair in pairs]
        texts = {key: str(fields.get(key, "")) for key in ("name", "hardware_id")}
        level = level[0] if isinstance(level, bytes) else level
        message = str(fields["message"])
        statuses.append({"level": level, **texts, "message": message, "values": values})
    return {"header": _header(time_s, ""), "status": statuses}


def _fields(thing: Any) -> Mapping[str, Any]:  # noqa: ANN401  # a dict, or an object of a library
    if isinstance(thing, Mapping):
        return thing
    return {name: getattr(thing, name) for name in dir(thing) if not name.startswith("_")}


def log_of(event: Event, more: str = "") -> Message:
    """Return an event's log message: a plan with its reason, a failure as a warning."""
    why = f" because {event.plan.reason}" if event.plan is not None and event.plan.reason else ""
    return log(
        event.time, WARN if event.verb == "component_failed" else INFO, f"{event.text}{why}{more}"
    )


def log(time_s: float, level: int, text: str) -> Message:
    entry = {"stamp": stamp(time_s), "level": level, "name": "rosa_kb", "msg": text}
    return {**entry, "file": "", "function": "", "line": 0}


def tree_log(time_s: float, changes: Sequence[tuple[str, int, str, str]]) -> Message:
    """Return Nav2's message of status changes: (node name, uid, previous, current)."""
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
    """Return a DiagnosticArray's statuses: name, message, values; level unless it is 0."""
    statuses = []
    for status in types().decode(DIAGNOSTICS, data).status:
        values = {pair.key: pair.value for pair in status.values}
        fields = {"name": status.name, "message": status.message, "values": values}
        statuses.append(fields | ({"level": int(status.level)} if status.level else {}))
    return statuses


def check_kind(kind: str) -> None:
    """Refuse what cannot be a message type; a rosbridge says nothing about those.

    Raises:
        RosError: it is not written as one, or its package is known and has no such type.
    """
    if not kind:
        return
    if _KIND.fullmatch(kind) is None:
        raise RosError(f"{kind!r} is no type of a message; write PACKAGE/msg/TYPE")
    try:
        known = types().store.fielddefs
    except MissionError:  # without the extra `mcap`
        return
    package = f"{kind.split('/')[0]}/msg/"
    names = [name for name in known if name.startswith(package)]
    if names and kind not in names:
        nearest = get_close_matches(kind, names, 1)
        advice = f"; did you mean {nearest[0]}?" if nearest else ""
        raise RosError(f"there is no message type {kind!r}{advice}")


# ------------------------------------------------------------ messages and the objects of a library


class Field(NamedTuple):
    """A field's type; `length` is None for one value, 0 for a sequence, else the size."""

    kind: str
    length: int | None = None


class Library(Protocol):
    """A library that has ROS 2's message types."""

    def fields(self, kind: str) -> Mapping[str, Field]:
        """Return the fields of a message type; `RosError` if it is not known."""

    def new(self, kind: str, values: Message) -> Any:  # noqa: ANN401  # an object of the library
        """Return a message with these values; all other fields are zero or empty."""


def to_object(library: Library, kind: str, message: Message) -> Any:  # noqa: ANN401  # a message of the library
    """Return the library's object for a message that is written as a dict.

    Raises:
        RosError: the type or a field is not known, or a value cannot be of its field's type.
    """
    fields = library.fields(kind)
    values = {}
    try:
        for name, value in message.items():
            if name not in fields:
                known = ", ".join(fields) or "none"
                raise RosError(f"{kind} has no field {name!r}; it has {known}")
            values[name] = _to_value(library, fields[name], value)
        return library.new(kind, values)
    except (AssertionError, AttributeError, TypeError, ValueError) as error:
        raise RosError(f"{message!r:.60} is no {kind}: {error}") from None


def _to_value(library: Library, field: Field, value: Any) -> Any:  # noqa: ANN401  # of a field
    kind, length = field
    if length is not None:
        if isinstance(value, str) and kind in ("uint8", "byte"):
            value = b64decode(value)
        return [_to_value(library, Field(kind), item) for item in value]
    if "/" in kind:
        return to_object(library, kind, value)
    if kind in _FLOATS:
        return math.nan if value is None else float(value)
    return value


def to_message(library: Library, kind: str, thing: Any) -> Message:  # noqa: ANN401  # a message of the library
    fields = library.fields(kind).items()
    return {name: _from_value(library, field, getattr(thing, name)) for name, field in fields}


def _from_value(library: Library, field: Field, value: Any) -> object:  # noqa: ANN401  # of a field
    kind, length = field
    if length is not None:
        return [_from_value(library, Field(kind), item) for item in value]
    if "/" in kind:
        return to_message(library, kind, value)
    if isinstance(value, bytes):  # rclpy's byte
        return value[0]
    return plain(float(value)) if kind in _FLOATS else value
