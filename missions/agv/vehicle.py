"""The vehicle in its building, simulated by MuJoCo, and its steering past what it sees."""

import math
from collections import deque
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from missions.agv.model import Building, Corridor

Array = NDArray[np.float64]
Pose = tuple[float, float, float]  # x, y [m] and yaw [rad]

# As in building.xml; like all sizes here own choice, of the order of a small research robot.
WHEEL_M: Final = 0.07
HALF_TRACK_M: Final = 0.17
_HALF_WIDTH_M: Final = 1.2  # of a corridor
_BOX_M: Final = 0.2  # half the edge of an obstacle
_FREE_M: Final = 2.5  # without boxes, from either end
_APART_M: Final = 1.25  # from one box to the next; nearer, the vehicle cannot drive round them

STEPS: Final = 10  # of the physics in a period, each 0.01 s
PERIOD_S: Final = 0.1  # of sensing and steering


def scene_xml(building: Building, placed: list[Pose], pose: Pose) -> str:
    """Return the scene; see `Vehicle`."""
    blocks = [_block(box, _BOX_M, _BOX_M, 0.3) for box in placed]
    for corridor in building.corridors.values():
        half_m = corridor.length_m / 2
        for side in (-1, 1):
            wall = _pose(building, corridor, half_m, side * (_HALF_WIDTH_M + 0.05))
            if half_m > 1.2 * _HALF_WIDTH_M:
                blocks.append(_block(wall, half_m - 1.2 * _HALF_WIDTH_M, 0.05, 0.4))
    scene = Path(__file__).with_name("building.xml").read_text(encoding="utf-8")
    x, y, yaw = pose
    return scene.format(blocks="\n".join(blocks), x=x, y=y, yaw=yaw)


def boxes(building: Building, rng: Generator) -> list[Pose]:
    """Put boxes into the corridors: as the map says, but no more than it can drive round."""
    placed = []
    for corridor in building.corridors.values():
        room_m = corridor.length_m - 2 * _FREE_M
        most = max(1, int(room_m / _APART_M)) if room_m > 0 else 0
        count = round(min(corridor.obstacles * corridor.length_m, most))
        for number in range(count):
            along = _FREE_M + room_m * (number + 0.5 + rng.uniform(-0.15, 0.15)) / count
            aside = (1 if number % 2 else -1) * rng.uniform(0.2, 0.45)
            placed.append(_pose(building, corridor, along, aside))
    return placed


def _pose(building: Building, corridor: Corridor, along: float, aside: float) -> Pose:
    """Return where something stands, so far [m] along a corridor and to its left."""
    (x, y), (end_x, end_y) = (building.places[place] for place in corridor.ends)
    ux = (end_x - x) / corridor.length_m
    uy = (end_y - y) / corridor.length_m
    return x + along * ux - aside * uy, y + along * uy + aside * ux, math.atan2(uy, ux)


def _block(pose: Pose, half_x: float, half_y: float, half_z: float) -> str:
    x, y, yaw = pose
    size = f"{half_x:.4f} {half_y} {half_z}"
    place = f'pos="{x:.4f} {y:.4f} {half_z}" euler="0 0 {yaw:.6f}"'
    return f'<geom type="box" size="{size}" {place} group="1"/>'


_AHEAD_M: Final = 1.0  # how far ahead on the line it aims
_CLEAR_M: Final = 1.1  # how far a free heading is free
_ROOMS_M: Final = (0.34, 0.24)  # free to either side of a heading; the second if it must be
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
    along = max(float((position - start) @ unit), 0.0)
    point: Array = start + unit * min(along + _AHEAD_M, length)
    return point


def steer(bearing: float, hits: Array, speed: float) -> Aim:
    """Choose the free heading that is nearest to the wanted one.

    Args:
        bearing: where to, from straight ahead [rad].
        hits: (n, 2) what is seen in the way [m].
        speed: to drive at [m/s].
    """
    x, y = hits.T
    room_m = float(x[(x > 0.0) & (np.abs(y) < _ROOMS_M[0])].min(initial=math.inf))
    speed *= min(max((room_m - _STOP_M) / _SLOW_M, 0.0), 1.0)
    for room in _ROOMS_M:
        for heading in (bearing + _OFFSETS).tolist():
            cos = math.cos(heading)
            sin = math.sin(heading)
            along = cos * x + sin * y
            in_way = (along > 0.0) & (along < _CLEAR_M) & (np.abs(cos * y - sin * x) < room)
            if not in_way.any():
                return _turned_to(heading, speed)
    return Aim(-_BACK_M_S, 0.0)


def _turned_to(heading: float, speed: float) -> Aim:
    error = math.remainder(heading, math.tau)
    turn = min(max(_TURN_GAIN * error, -_TURN_RAD_S), _TURN_RAD_S)
    return Aim(speed * max(0.0, math.cos(error)) ** 3, turn)


SENSORS: Final = {
    "lidar": (math.radians(120), 59, 8.0),
    "kinect": (math.radians(28.5), 15, 4.0),
    "camera": (0.5, 15, 2.0),
}
"""Half of the angle of view [rad], the rays, and the range [m] of each sensor; Kinect: its data
sheet, else own choice."""
_MEMORY: Final = 30  # scans that it remembers; what it has passed is out of sight, but still there


class Vehicle:
    """A differential drive with a range finder.

    Args:
        building: where it is; corridors are straight, between their places.
        placed: x, y [m] and yaw [rad] of each box in the way.
        pose: x, y [m] and yaw [rad] at the start.
    """

    def __init__(self, building: Building, placed: list[Pose], pose: Pose) -> None:
        import mujoco  # takes long, so not before a mission is run

        self._mujoco: Any = mujoco
        self._model: Any = mujoco.MjModel.from_xml_string(scene_xml(building, placed, pose))
        self._data: Any = mujoco.MjData(self._model)
        self._sensor = ""
        self._seen: deque[Array] = deque(maxlen=_MEMORY)
        self._touched = False
        self.collisions = 0
        mujoco.mj_forward(self._model, self._data)

    @property
    def position(self) -> Array:
        """X and y (2,) [m], world frame."""
        position: Array = self._data.qpos[:2].copy()
        return position

    @property
    def yaw(self) -> float:
        """The heading [rad], from x to y."""
        w, i, j, k = self._data.qpos[3:7].tolist()
        return math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))

    def drive(self, aim: Aim) -> None:
        """Advance the physics by a period, with the wheel speeds of an aim."""
        aside = aim.turn * HALF_TRACK_M
        self._data.ctrl[:] = (aim.forward - aside) / WHEEL_M, (aim.forward + aside) / WHEEL_M
        self._mujoco.mj_step(self._model, self._data, STEPS)
        pairs = self._model.geom_group[self._data.contact.geom].tolist()
        touches = [1, 2] in pairs or [2, 1] in pairs  # the surroundings, and the vehicle
        self.collisions += touches and not self._touched
        self._touched = touches

    def look(self, sensor: str) -> Array:
        """Cast the rays of a sensor.

        Return what it sees or has seen lately near by, (n, 2) [m], vehicle's frame.
        """
        if sensor != self._sensor:  # it knows only what this one has seen
            self._sensor = sensor
            self._seen.clear()
        half, count, reach_m = SENSORS[sensor]
        yaw = self.yaw
        angles = yaw + np.linspace(-half, half, count)
        rays = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(count)])
        origin = np.array([*self.position.tolist(), 0.2])
        hit = np.zeros(count, dtype=np.int32)
        far = np.zeros(count)
        groups = np.array([0, 1, 0, 0, 0, 0], dtype=np.uint8)  # only the surroundings
        past = groups, True, int(self._model.body("vehicle").id)
        self._mujoco.mj_multiRay(
            self._model, self._data, origin, rays.ravel(), *past, hit, far, None, count, reach_m
        )
        is_hit = (hit >= 0) & (far > 0.0)
        self._seen.append(origin[:2] + rays[is_hit, :2] * far[is_hit, None])
        apart = np.concatenate(self._seen) - self.position
        near = apart[np.hypot(apart[:, 0], apart[:, 1]) < 2.0]
        cos = math.cos(yaw)
        sin = math.sin(yaw)
        local: Array = near @ np.array([[cos, -sin], [sin, cos]])
        return local
