"""ROS 2's messages as dicts like its JSON, and those that we publish and record.

Recordings take the types from `rosbags`, so they need no ROS.
"""

import json
import math
import re
from abc import ABC, abstractmethod
from base64 import b64decode
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from kb import Event
from missions.engine.mission import MissionError, needs
from missions.engine.settings import near
from missions.views.output import plain
from missions.wires.node import Message, RosError

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

DIAGNOSTICS: Final = "diagnostic_msgs/msg/DiagnosticArray"
FLOAT: Final = "std_msgs/msg/Float64"
LOG: Final = "rcl_interfaces/msg/Log"
POSE: Final = "geometry_msgs/msg/PoseStamped"
STRING: Final = "std_msgs/msg/String"
TREE_LOG: Final = "nav2_msgs/msg/BehaviorTreeLog"
INFO, WARN = 20, 30  # of rcl_interfaces/Log
_DEFINITIONS: Final = Path(__file__).with_name("definitions.txt")
"""Definitions of the messages and services that `rosbags` does not have."""
NOTHING: Final = "structure_needs_at_least_one_member"
"""The field that a message without fields has on the wire."""
_KIND: Final = re.compile(r"\w+/msg/\w+")
_UPRIGHT: Final = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}

# ------------------------------------------------------------ messages and the objects of a library


class Field(NamedTuple):
    """A field's type, and whether it holds a list of it."""

    kind: str
    is_list: bool = False


class Library(ABC):
    """A library that has ROS 2's message types as classes."""

    byte: Callable[[int], Any] = int
    """Makes the value of a field of type byte."""

    @abstractmethod
    def fields(self, kind: str) -> dict[str, Field]:
        """Return the fields of a message type; `RosError` if it is not known."""

    @abstractmethod
    def new(self, kind: str, values: Message) -> Any:  # noqa: ANN401  # an object of the library
        """Return a message with these values."""

    def to_object(self, kind: str, message: Message) -> Any:  # noqa: ANN401  # of the library
        """Return the library's object for a message that is written as a dict.

        Raises:
            RosError: the type or a field is not known, or a value cannot be of its field's type.
        """
        fields = self.fields(kind)
        values = {}
        try:
            for name, value in message.items():
                values[name] = self._to_value(*fields[name], value)
            return self.new(kind, values)
        except (AssertionError, ValueError, LookupError, TypeError, AttributeError) as error:
            names = ", ".join(fields)
            raise RosError(f"{message!r:.60} is no {kind} of {names}: {error}") from None

    def _to_value(self, kind: str, is_list: bool, value: Any) -> Any:  # noqa: ANN401  # of a field
        if is_list:
            items = b64decode(value) if isinstance(value, str) else value
            return [self._to_value(kind, False, item) for item in items]
        if "/" in kind:
            return self.to_object(kind, value)
        if kind in ("float32", "float64"):
            return math.nan if value is None else float(value)
        return self.byte(value) if kind == "byte" else value


def to_message(value: Any) -> Any:  # noqa: ANN401  # an object of a library, or a part of it
    """Return a message of a library as a dict, and the values in it as JSON has them."""
    if hasattr(value, "get_fields_and_field_types"):  # rclpy's
        names: Iterable[str] = value.get_fields_and_field_types()
    elif is_dataclass(value):  # that of `rosbags`; its constants have defaults
        names = [field.name for field in fields(value) if field.default is MISSING]
    elif isinstance(value, bytes):  # rclpy's byte
        return value[0]
    elif hasattr(value, "tolist"):  # numpy's, or an array
        return to_message(value.tolist())
    elif isinstance(value, list):
        return [to_message(item) for item in value]
    else:
        return plain(value)
    return {name: to_message(getattr(value, name)) for name in names if name != NOTHING}


class Types(Library):
    """ROS 2's types as `rosbags` has them, which also encodes and decodes them as CDR."""

    def __init__(self, store: "Typestore") -> None:
        self.store = store

    def fields(self, kind: str) -> dict[str, Field]:
        if kind not in self.store.fielddefs:
            problem = f"the type {kind!r} is not known" if kind else "no type is named"
            raise RosError(f"{problem}; name one of ROS 2's, PACKAGE/msg/TYPE")
        fields = self.store.fielddefs[kind][1]
        return {name: _field(*field) for name, field in fields if name != NOTHING}

    def new(self, kind: str, values: Message) -> Any:  # noqa: ANN401  # of a class that is made
        return self.store.types[kind](**values or {NOTHING: 0})

    def definition(self, kind: str) -> str:
        """Return the text that defines a type and the types in it, as recordings hold it."""
        return str(self.store.generate_msgdef(kind, ros_version=2)[0])

    def encode(self, kind: str, message: Message) -> bytes:
        return bytes(self.store.serialize_cdr(self.to_object(kind, message), kind))

    def decode(self, kind: str, data: bytes) -> Message:
        message: Message = to_message(self.store.deserialize_cdr(data, kind))
        return message


def _field(node: Any, what: Any) -> Field:  # noqa: ANN401  # as `rosbags` has it
    if node.name in ("ARRAY", "SEQUENCE"):
        return Field(_field(*what[0]).kind, is_list=True)
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
    definitions = get_types_from_msg(_DEFINITIONS.read_text(encoding="utf-8"), "x/msg/Nothing")
    for name, definition in definitions.items():
        store.register({name.replace("/srv/msg/", "/srv/"): definition})
    return Types(store)


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
        kinds = types().store.fielddefs
    except MissionError:  # without the extra `mcap`
        return
    names = [name for name in kinds if name.startswith(f"{kind.split('/')[0]}/msg/")]
    if names and kind not in names:
        nearest = " or ".join(near(kind, names) or names)
        raise RosError(f"there is no message type {kind!r}; did you mean {nearest}?")


# ------------------------------------------------------------ messages that we publish and record


def nanoseconds(time_s: float) -> int:
    return round(time_s * 1e9)


def stamp(time_s: float) -> Message:
    sec, nanosec = divmod(nanoseconds(time_s), 10**9)
    return {"sec": sec, "nanosec": nanosec}


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
    elif not isinstance(array, Mapping):
        array = to_message(array)
    statuses = []
    for status in array["status"]:
        values = status["values"]
        if isinstance(values, Mapping):
            values = [{"key": str(key), "value": str(values[key])} for key in values]
        defaults = {"level": 0, "name": "", "hardware_id": ""}
        statuses.append({**defaults, **status, "values": values})
    return {"header": _header(time_s, ""), "status": statuses}


def plain_statuses(array: Message) -> list[Message]:
    """Return the statuses of a DiagnosticArray with their values as a mapping."""
    statuses = []
    for status in array["status"]:
        values = {pair["key"]: pair["value"] for pair in status["values"]}
        statuses.append({**status, "values": values})
    return statuses


def log_of(event: Event, more: str = "") -> Message:
    """Return an event's log message: a plan with its reason, a failure as a warning."""
    why = f" because {event.plan.reason}" if event.plan is not None and event.plan.reason else ""
    level = WARN if event.verb == "component_failed" else INFO
    return log(event.time, level, f"{event.text}{why}{more}")


def log(time_s: float, level: int, text: str) -> Message:
    entry = {"stamp": stamp(time_s), "level": level, "name": "rosa_kb", "msg": text}
    return {**entry, "file": "", "function": "", "line": 0}


def tree_log(time_s: float, changes: Sequence[tuple[str, int, str, str]]) -> Message:
    """Return Nav2's message of status changes: (node name, uid, previous, current)."""
    now = stamp(time_s)
    names = ("node_name", "uid", "previous_status", "current_status")
    changed = [{"timestamp": now, **dict(zip(names, change, strict=True))} for change in changes]
    return {"timestamp": now, "event_log": changed}


def pose(time_s: float, position: Sequence[float]) -> Message:
    """Return a pose at (x, y, z) [m], world frame; upright, as the attitude is not known."""
    place = dict(zip("xyz", position, strict=True))
    header = _header(time_s, "map")  # the world frame as in REP 105
    return {"header": header, "pose": {"position": place, "orientation": _UPRIGHT}}
