"""ROS 2's messages without ROS: their types, and what we say in them."""

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from struct import Struct
from typing import TYPE_CHECKING, Any, Final

from missions.extras import needs

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

Ros = Any
"""A message of ROS 2, as `rosbags` makes and reads it."""

DIAGNOSTICS: Final = "diagnostic_msgs/msg/DiagnosticArray"
FLOAT: Final = "std_msgs/msg/Float64"
LOG: Final = "rcl_interfaces/msg/Log"
POSE: Final = "geometry_msgs/msg/PoseStamped"
STRING: Final = "std_msgs/msg/String"
TF: Final = "tf2_msgs/msg/TFMessage"
TREE_LOG: Final = "nav2_msgs/msg/BehaviorTreeLog"
INFO, WARN = 20, 30
"""Levels of rcl_interfaces/Log."""
FRAME, BODY = "map", "base_link"
"""The world frame, z up, and the robot's, by REP 105."""
_DEFINITIONS: Final = Path(__file__).with_name("definitions.txt")
"""Messages and services that ROS 2's core, as `rosbags` has it, lacks."""


class Types:
    """Makes, writes and reads messages as the CDR of ROS 2."""

    def __init__(self) -> None:
        with needs("mcap", "recordings as MCAP and rosbag2"):
            from rosbags.typesys import Stores, get_types_from_msg, get_typestore
        self.store: Typestore = get_typestore(Stores.ROS2_HUMBLE)
        for line in _DEFINITIONS.read_text(encoding="utf-8").splitlines():
            if line.startswith("#"):
                continue
            name, text = line.split(":", 1)
            package, base = name.split("/")
            parts = text.split("->")
            for ending, part in zip(("_Request", "_Response") if len(parts) > 1 else ("",), parts, strict=True):
                fields = part.strip().replace(", ", "\n") or "uint8 structure_needs_at_least_one_member"
                (made,) = get_types_from_msg(fields, f"{package}/msg/{base}").values()
                self.store.register({f"{package}/{'srv' if ending else 'msg'}/{base}{ending}": made})

    def definition(self, kind: str) -> str:
        """Return the definition of a type with those that it is made of, as files of recordings hold it."""
        return str(self.store.generate_msgdef(kind, ros_version=2)[0])

    def encode(self, kind: str, message: Ros) -> bytes:
        return bytes(self.store.serialize_cdr(message, kind))

    def decode(self, kind: str, data: bytes) -> Ros:
        return self.store.deserialize_cdr(data, kind)

    def time(self, time_s: float) -> Ros:
        return self.make("builtin_interfaces/msg/Time", *divmod(nanoseconds(time_s), 10**9))

    def diagnostics(self, time_s: float, statuses: Iterable[Mapping[str, Any]]) -> Ros:
        """Return an array of what a message of ours says; each status has `name`, `message` and `values`."""
        kinds = "diagnostic_msgs/msg/DiagnosticStatus", "diagnostic_msgs/msg/KeyValue"
        made = []
        for one in statuses:
            values = [self.make(kinds[1], str(key), str(value)) for key, value in one["values"].items()]
            made.append(self.make(kinds[0], 0, str(one.get("name", "")), str(one["message"]), "", values))
        return self.make(DIAGNOSTICS, self._header(time_s, ""), made)

    def log(self, time_s: float, level: int, text: str) -> Ros:
        return self.make(LOG, self.time(time_s), level, "rosa", text, "", "", 0)

    def tree_log(self, time_s: float, changes: Sequence[tuple[str, int, str, str]]) -> Ros:
        """Return Nav2's message of status changes: (node name, uid, previous status, current status) of each."""
        now = self.time(time_s)
        kind = "nav2_msgs/msg/BehaviorTreeStatusChange"
        return self.make(TREE_LOG, now, [self.make(kind, now, *change) for change in changes])

    def pose(self, time_s: float, position: Sequence[float]) -> Ros:
        """Return where the robot is, (x, y, z) [m] in the world frame; upright, as its attitude is not told."""
        pose = self.make("geometry_msgs/msg/Pose", self.make("geometry_msgs/msg/Point", *position), self._upright())
        return self.make(POSE, self._header(time_s, FRAME), pose)

    def transform(self, time_s: float, position: Sequence[float]) -> Ros:
        """Return the same as a transform from the world frame to the robot's."""
        moved = self.make("geometry_msgs/msg/Vector3", *position)
        turned = self.make("geometry_msgs/msg/Transform", moved, self._upright())
        stamped = self.make("geometry_msgs/msg/TransformStamped", self._header(time_s, FRAME), BODY, turned)
        return self.make(TF, [stamped])

    def _upright(self) -> Ros:
        return self.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)

    def _header(self, time_s: float, frame: str) -> Ros:
        return self.make("std_msgs/msg/Header", self.time(time_s), frame)

    def make(self, kind: str, *values: Any) -> Ros:  # noqa: ANN401  # the fields of a message
        return self.store.types[kind](*values)


@cache
def types() -> Types:
    """Return the types; made once, as that takes a fifth of a second.

    Raises:
        MissionError: the extra `mcap` is missing.
    """
    return Types()


def nanoseconds(time_s: float) -> int:
    return round(time_s * 1e9)


def statuses_of(data: bytes) -> list[dict[str, Any]]:
    """Return what the bytes of a DiagnosticArray say, as a message of ours says it; an hour of them is many.

    Raises:
        ValueError, struct.error: these are no such bytes.
    """
    number, place = Struct("<I" if data[1:2] == b"\x01" else ">I").unpack_from, 12  # after the encoding and the stamp

    def count() -> int:
        nonlocal place
        place = (place + 3 & -4) + 4
        found: int = number(data, place - 4)[0]
        return found

    def text() -> str:
        nonlocal place
        start = place + 3 & -4
        place = start + 4 + number(data, start)[0]
        if place > len(data):
            raise ValueError(f"a DiagnosticArray is cut off after {len(data)} bytes")
        return data[start + 4 : place - 1].decode()

    found = []
    text()
    for _ in range(count()):
        place += 1  # the level
        name, message, _ = text(), text(), text()
        found.append({"name": name, "message": message, "values": {text(): text() for _ in range(count())}})
    return found
