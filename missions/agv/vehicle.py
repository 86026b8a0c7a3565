"""The vehicle in its building, simulated by MuJoCo, and its steering past what it sees."""

import math
from collections import deque
from collections.abc import Iterator
from importlib.resources import files
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from missions.agv.model import Building, Corridor

Array = NDArray[np.float64]
Pose = tuple[float, float, float]  # x, y [m] and yaw [rad]

RADIUS_M: Final = 0.2
"""Radius of the vehicle [m]; like all sizes here own choice, of the order of a small research
robot."""
WHEEL_M: Final = 0.07
HALF_TRACK_M: Final = 0.17
_HALF_WIDTH_M: Final = 1.2  # of a corridor
_BOX_M: Final = 0.2  # half the edge of an obstacle
_FREE_M: Final = 2.5  # without boxes, from either end
_APART_M: Final = (
    1.25  # from one box to the next; if they are closer, the vehicle cannot drive round them
)

_GEOM: Final = '<geom type="box" size="{} {} {}" pos="{:.4f} {:.4f} {}" euler="0 0 {}" group="1"/>'


def scene_xml(building: Building, placed: list[Pose], pose: Pose, step_s: float) -> str:
    """Return the scene; see `Vehicle`."""
    walls = "\n".join(
        wall for corridor in building.corridors.values() for wall in _walls(building, corridor)
    )
    blocks = "\n".join(
        _GEOM.format(_BOX_M, _BOX_M, 0.3, bx, by, 0.3, f"{turn:.4f}") for bx, by, turn in placed
    )
    sizes = {
        "radius": RADIUS_M,
        "wheel": WHEEL_M,
        "half_track": HALF_TRACK_M,
        "caster": round(0.032 - WHEEL_M, 4),
    }
    scene = (files("missions.agv") / "building.xml").read_text(encoding="utf-8")
    x, y, yaw = pose
    return scene.format(walls=walls, blocks=blocks, x=x, y=y, yaw=yaw, step_s=step_s, **sizes)


def boxes(building: Building, rng: Generator) -> list[Pose]:
    """Put boxes into the corridors: as the map says, but no more than it can drive round."""
    placed = []
    for corridor in building.corridors.values():
        (x, y), ux, uy, length_m = _line(building, corridor)
        room_m = length_m - 2 * _FREE_M
        most = max(1, int(room_m / _APART_M)) if room_m > 0 else 0
        count = round(min(corridor.obstacles * length_m, most))
        for number in range(count):
            along = _FREE_M + room_m * (number + 0.5 + rng.uniform(-0.15, 0.15)) / count
            aside = (1 if number % 2 else -1) * rng.uniform(0.2, 0.45)
            placed.append(
                (x + along * ux - aside * uy, y + along * uy + aside * ux, math.atan2(uy, ux))
            )
    return placed


def _line(
    building: Building, corridor: Corridor
) -> tuple[tuple[float, float], float, float, float]:
    start, end = (building.places[place] for place in corridor.ends)
    length_m = math.dist(start, end)
    return start, (end[0] - start[0]) / length_m, (end[1] - start[1]) / length_m, length_m


def _walls(building: Building, corridor: Corridor) -> Iterator[str]:
    (x, y), ux, uy, length_m = _line(building, corridor)
    half_m = length_m / 2 - 1.2 * _HALF_WIDTH_M
    if half_m <= 0:
        return
    for side in (-1, 1):
        wx = x + length_m / 2 * ux - side * (_HALF_WIDTH_M + 0.05) * uy
        wy = y + length_m / 2 * uy + side * (_HALF_WIDTH_M + 0.05) * ux
        yield _GEOM.format(f"{half_m:.4f}", 0.05, 0.4, wx, wy, 0.4, f"{math.atan2(uy, ux):.6f}")


_AHEAD_M: Final = 1.0  # how far ahead on the line it aims
_CLEAR_M: Final = 1.1  # how far a free heading is free
_ROOMS_M: Final = (
    0.34,
    0.24,
)  # free to either side of a heading; the second where the first is not possible
_STOP_M: Final = 0.28  # how near the vehicle may get to what is in front
_SLOW_M: Final = 0.7  # it slows down so far before that
_BACK_M_S: Final = 0.1  # backwards, where no heading is free
_OFFSETS: Final = np.radians(
    [0, 10, -10, 20, -20, 30, -30, 40, -40, 50, -50, 60, -60, 75, -75, 90, -90]
)
_TURN_GAIN: Final = 2.0
_TURN_RAD_S: Final = 1.2


class Aim(NamedTuple):
    """What to do next: forward speed [m/s] and turning rate [rad/s], left positive."""

    forward: float
    turn: float


def aim_along(position: Array, start: Array, end: Array) -> Array:
    """Return the point (2,) of the line from start to end to aim at, world frame [m]."""
    line = end - start
    length = float(np.hypot(*line))
    unit = line / max(length, 1e-9)
    along = min(
        max(float((position - start) @ unit), 0.0), length
    )  # a tenth of the time that numpy takes for one
    point: Array = start + unit * min(along + _AHEAD_M, length)
    return point


def steer(bearing: float, hits: Array, speed: float) -> Aim:
    """Choose the free heading that is nearest to the wanted one.

    Args:
        bearing: where to, from straight ahead [rad].
        hits: (n, 2) what is seen in the way [m].
        speed: to drive at [m/s].
    """
    if not len(hits):
        return _turned_to(bearing, speed)
    ahead = hits[(hits[:, 0] > 0.0) & (np.abs(hits[:, 1]) < _ROOMS_M[0]), 0]
    room_m = float(ahead.min(initial=math.inf))
    speed *= min(max((room_m - _STOP_M) / _SLOW_M, 0.0), 1.0)
    headings = bearing + _OFFSETS
    rooms = list[float]()
    x = hits[:, 0]
    y = hits[:, 1]
    for heading, cos, sin in zip(
        headings.tolist(), np.cos(headings), np.sin(headings), strict=True
    ):
        along = cos * x + sin * y
        aside = np.abs(cos * y - sin * x)
        rooms.append(float(aside[(along > 0.0) & (along < _CLEAR_M)].min(initial=math.inf)))
        if rooms[-1] >= _ROOMS_M[0]:  # mostly the first heading is free
            return _turned_to(heading, speed)
    for heading, room in zip(headings.tolist(), rooms, strict=True):
        if room >= _ROOMS_M[1]:
            return _turned_to(heading, speed)
    return Aim(-_BACK_M_S, 0.0)


def _turned_to(heading: float, speed: float) -> Aim:
    error = math.remainder(heading, math.tau)
    turn = min(max(_TURN_GAIN * error, -_TURN_RAD_S), _TURN_RAD_S)
    return Aim(speed * max(0.0, math.cos(error)) ** 3, turn)


SENSORS: Final = {
    "lidar": (math.radians(120), 8.0),
    "kinect": (math.radians(28.5), 4.0),
    "camera": (0.5, 2.0),
}
"""Half of the angle of view [rad] and the range [m] of each sensor; Kinect: its data sheet, else
own choice."""
_RAY_STEP: Final = math.radians(4)
_RAYS: Final = {
    name: (np.linspace(-half, half, 2 * int(half / _RAY_STEP) + 1), reach_m)
    for name, (half, reach_m) in SENSORS.items()
}
_TOUCHING: Final = (1, 2), (2, 1)  # groups of geoms: the surroundings, and the vehicle
_MEMORY: Final = 30  # scans that it remembers; what it has passed is out of sight, but still there


class Vehicle:
    """A differential drive with a range finder.

    Args:
        building: where it is; corridors are straight, between their places.
        placed: x, y [m] and yaw [rad] of each box in the way.
        pose: x, y [m] and yaw [rad] at the start.
        step_s: of the physics [s].

    Attributes:
        position: X and y (2,) [m], world frame.
        yaw: Heading [rad], from x to y.
    """

    def __init__(self, building: Building, placed: list[Pose], pose: Pose, step_s: float) -> None:
        import mujoco  # takes long, so not before a mission is run

        self._mujoco: Any = mujoco
        self._model: Any = mujoco.MjModel.from_xml_string(scene_xml(building, placed, pose, step_s))
        self._data: Any = mujoco.MjData(self._model)
        self._qpos = self._data.qpos
        self._body = int(self._model.body("vehicle").id)
        self._group_of: list[int] = self._model.geom_group.tolist()
        self._groups = np.array([0, 1, 0, 0, 0, 0], dtype=np.uint8)
        self._seen: deque[Array] = deque(maxlen=_MEMORY)
        self._touched = False
        self.collisions = 0
        mujoco.mj_forward(self._model, self._data)
        self._stand()

    def drive(self, aim: Aim, steps: int) -> None:
        """Advance the physics by a number of steps, with the wheel speeds of an aim."""
        aside = aim.turn * HALF_TRACK_M
        self._data.ctrl[:] = (aim.forward - aside) / WHEEL_M, (aim.forward + aside) / WHEEL_M
        self._mujoco.mj_step(self._model, self._data, steps)
        self._stand()
        touches = self._touches()
        self.collisions += touches and not self._touched
        self._touched = touches

    def look(self, sensor: str) -> Array:
        """Cast the rays of a sensor.

        Return what it sees or has seen lately near by, (n, 2) [m], vehicle's frame.
        """
        yaw = self.yaw
        here = self.position
        offsets, reach_m = _RAYS[sensor]
        angles = yaw + offsets
        count = len(offsets)
        rays = np.zeros((count, 3))
        rays[:, 0] = np.cos(angles)
        rays[:, 1] = np.sin(angles)
        origin = np.array([*here.tolist(), 0.2])
        hit = np.zeros(count, dtype=np.int32)
        far = np.zeros(count)
        past = self._groups, True, self._body
        self._mujoco.mj_multiRay(
            self._model, self._data, origin, rays.ravel(), *past, hit, far, None, count, reach_m
        )
        is_hit = (hit >= 0) & (far > 0.0)
        self._seen.append(origin[:2] + rays[is_hit, :2] * far[is_hit, None])
        apart = np.concatenate(self._seen) - here
        near = apart[np.hypot(apart[:, 0], apart[:, 1]) < 2.0]
        cos = math.cos(yaw)
        sin = math.sin(yaw)
        local: Array = near @ np.array([[cos, -sin], [sin, cos]])
        return local

    def forget(self) -> None:
        """Forget what was seen, because another sensor takes over."""
        self._seen.clear()

    def _stand(self) -> None:
        x, y, _, *turned = self._qpos.tolist()[:7]
        w, i, j, k = turned
        self.position: Array = np.array((x, y))
        self.yaw = math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))

    def _touches(self) -> bool:
        contacts = self._data.contact
        pairs = contacts.geom[: self._data.ncon].tolist()
        group = self._group_of
        return any((group[first], group[second]) in _TOUCHING for first, second in pairs)
