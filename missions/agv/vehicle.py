"""The vehicle in the building, as MuJoCo simulates it. This is the only file of the mission that touches MuJoCo."""

import math
from collections import deque
from typing import Any, Final

import mujoco
import numpy as np

from missions.agv.building import Building
from missions.agv.scene import HALF_TRACK_M, WHEEL_M, scene_xml
from missions.agv.steering import Aim, Array, wheel_speeds

__all__ = ["SENSORS", "Vehicle"]

SENSORS: Final = {"lidar": (math.radians(120), 8.0), "kinect": (math.radians(28.5), 4.0), "camera": (0.5, 2.0)}
"""Half of the angle that each sees [rad], and how far it sees [m]; Kinect: its data sheet, else own choice."""
_RAY_STEP: Final = math.radians(4)
_MEMORY: Final = 30  # scans that are remembered; what was passed is out of sight, but not away


class Vehicle:
    """A differential drive with a range finder.

    Args:
        building: where it is.
        placed: boxes in the way, see `scene.boxes`.
        pose: x, y [m] and yaw [rad] at the start.
        step_s: of the physics [s].
    """

    def __init__(
        self,
        building: Building,
        placed: list[tuple[float, float, float]],
        pose: tuple[float, float, float],
        step_s: float,
    ) -> None:
        self._model: Any = mujoco.MjModel.from_xml_string(scene_xml(building, placed, pose, step_s))
        self._data: Any = mujoco.MjData(self._model)
        self._body = int(self._model.body("vehicle").id)
        self._groups = np.array([0, 1, 0, 0, 0, 0], dtype=np.uint8)
        self._seen: deque[Array] = deque(maxlen=_MEMORY)
        self._touched = False
        self.collisions = 0
        mujoco.mj_forward(self._model, self._data)

    @property
    def position(self) -> Array:
        """X and y (2,) [m], world frame."""
        where: Array = self._data.qpos[:2].copy()
        return where

    @property
    def yaw(self) -> float:
        """Heading [rad], from x to y."""
        w, x, y, z = self._data.qpos[3:7]
        return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))

    def drive(self, aim: Aim, steps: int) -> None:
        """Let time pass with wheels turning as is wanted."""
        self._data.ctrl[:] = wheel_speeds(aim, WHEEL_M, HALF_TRACK_M)
        mujoco.mj_step(self._model, self._data, steps)
        touches = self._touches()
        self.collisions += touches and not self._touched
        self._touched = touches

    def look(self, sensor: str) -> Array:
        """Cast the rays of a sensor; returns what it sees, and saw lately, near by: (n, 2) [m], vehicle's frame."""
        half_angle, reach_m = SENSORS[sensor]
        count = 2 * int(half_angle / _RAY_STEP) + 1
        angles = self.yaw + np.linspace(-half_angle, half_angle, count)
        rays = np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1)
        origin = np.array([*self.position, 0.2])
        hit, far = np.zeros(count, dtype=np.int32), np.zeros(count)
        mujoco.mj_multiRay(
            self._model,
            self._data,
            origin,
            rays.ravel(),
            self._groups,
            True,
            self._body,
            hit,
            far,
            None,
            count,
            reach_m,
        )
        found = (hit >= 0) & (far > 0.0)
        self._seen.append(origin[:2] + rays[found, :2] * far[found, None])
        apart = np.concatenate(self._seen) - self.position
        near = apart[np.hypot(*apart.T) < 2.0]
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        local: Array = near @ np.array([[cos, -sin], [sin, cos]])
        return local

    def forget(self) -> None:
        """Forget what was seen, as another sensor looks on."""
        self._seen.clear()

    def _touches(self) -> bool:
        contacts = self._data.contact
        pairs = contacts.geom[: self._data.ncon]
        groups = self._model.geom_group[pairs] if len(pairs) else np.zeros((0, 2))
        return bool(np.any((groups.min(axis=1, initial=9) == 1) & (groups.max(axis=1, initial=0) == 2)))
