"""The quadrotor, simulated by MuJoCo, and its controller.

World frame ENU, z up, ground at z = 0. The controller is the usual cascade: position error to
velocity, velocity error to acceleration, its direction to the tilt of the mast, tilt error to body
rates, rate error to torques; the mixer turns torques into thrusts.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# The vehicle, as in quadrotor.xml; own choice: common for a vehicle of this size
ON_GROUND_M: Final = 0.35  # height of the vehicle's origin when it stands
ARM_M: Final = 0.18  # from the centre to a rotor, along x and along y
REACTION_M: Final = 0.016  # torque about the mast for each newton of thrust
ROTOR_LIMIT_N: Final = 8.0  # largest thrust of one rotor
ROTOR_RADIUS_M: Final = 0.127  # 10 inch propeller
FIGURE_OF_MERIT: Final = 0.6  # ideal divided by actual power of a hovering rotor
INERTIA: Final = (0.021, 0.021, 0.036)  # about x, y, z [kg m2], the arm included
FOLD_RAD_S: Final = math.pi / 3  # speed of the arm

# The air
GRAVITY_M_S2: Final = 9.81
AIR_KG_M3: Final = 1.225  # standard atmosphere at sea level
DRAG: Final = 0.3  # linear [N s/m]
DAMPING: Final = (DRAG, DRAG, DRAG, 0.005, 0.005, 0.005)  # the last three: [N m s]

# The controller; own choice: common for a vehicle of this size
STEP_S: Final = 0.02  # its period: two steps of the physics
CRUISE_M: Final = 5.0  # height of search and travel
SPEED_M_S: Final = 3.0  # horizontal limit
CLIMB_M_S: Final = 1.5  # vertical limit
POSITION_GAIN: Final = 1.0  # [1/s]
VELOCITY_GAIN: Final = 3.0  # [1/s]
TRIM_GAIN: Final = 1.0  # of the integral part [1/s2]
TRIM_LIMIT: Final = 3.0  # [m/s2]; more than the strongest wind takes
TURN_GAINS: Final = (8.0, 8.0, 2.0)  # of tilt and heading [1/s]
RATE_GAIN: Final = 25.0  # [1/s]
STIFFNESS: Final = RATE_GAIN * np.array(INERTIA)
SIDEWAYS_M_S2: Final = 4.0  # largest horizontal acceleration that the controller wants
UPWARDS_M_S2: Final = 4.0  # the same, upwards; downwards it is half of gravity
STRAIGHT_M: Final = 0.6  # nearer than this it flies straight to a place, not at travelling height
TOUCH_M: Final = 0.03  # lower than this, and slower than the next, it stands
TOUCH_M_S: Final = 0.2

_TURNING: Final = np.array([(1, -1, 1), (1, 1, -1), (-1, 1, 1), (-1, -1, -1)])  # of each rotor


def limited(vector: Array, sideways: float, down: float, up: float) -> Array:
    """Return a vector (3,), its horizontal length and its height limited."""
    x, y, z = vector.tolist()
    scale = min(1.0, sideways / max(math.hypot(x, y), 1e-9))
    return np.array((scale * x, scale * y, max(-down, min(up, z))))


def mixed(thrust: float, torques: Array) -> Array:
    """Return each rotor's thrust (4,) [N] for thrust [N] and torques (3,) [N m], body frame.

    If a rotor cannot give its thrust, lift is reduced before tilt: a vehicle that stays upright can
    fly on.
    """
    x, y, z = torques.tolist()
    heading = max(-0.1 * ROTOR_LIMIT_N, min(0.1 * ROTOR_LIMIT_N, z / 4 / REACTION_M))
    turning = _TURNING @ (x / 4 / ARM_M, y / 4 / ARM_M, heading)
    even = max(-turning.min(), min(ROTOR_LIMIT_N - turning.max(), thrust / 4))
    thrusts: Array = (even + turning).clip(0.0, ROTOR_LIMIT_N)
    return thrusts


class Quadrotor:
    """A rigid body with four rotors, an arm that folds, and a load.

    Drag is linear in the speed through the air.

    Args:
        wind: (x, y) [m/s], world frame.

    Attributes:
        position: (x, y, z) [m], world frame, z is 0.35 m on the ground.
        velocity: (x, y, z) [m/s], world frame.
        is_landed: whether it stands on the ground with its rotors off.
        is_folding: whether the arm is to be folded.
        rotor_w: power of the rotors [W].
        has_power: whether there is power for the rotors.
    """

    def __init__(self, wind: tuple[float, float]) -> None:
        import mujoco  # takes long, and listing missions does not need it

        path = Path(__file__).with_name("quadrotor.xml")
        self._mujoco: Any = mujoco
        self.model: Any = mujoco.MjModel.from_xml_path(str(path))
        self.model.dof_damping[:6] = DAMPING
        self._mass = float(self.model.body_subtreemass[0])  # without load
        self.data: Any = mujoco.MjData(self.model)
        self.data.qfrc_applied[:2] = DRAG * wind[0], DRAG * wind[1]
        self._target: Array | None = None
        self._trim = np.zeros(3)
        self._turn = np.zeros(9)
        self.position: Array = np.array(self.data.qpos[:3])
        self.velocity: Array = np.zeros(3)
        self.is_landed = True
        self.is_folding = True
        self.rotor_w = 0.0
        self.has_power = True

    def go_to(self, target: Sequence[float]) -> None:
        """Fly to a place [m], world frame; at travelling height unless it is near.

        The vehicle lands on a place below its height on the ground.
        """
        self._target = np.array(target)

    def hold(self) -> None:
        """Hover at the present position; on the ground, stay there."""
        self._target = None if self.is_landed else self.position

    def land(self, at: tuple[float, float] | None = None) -> None:
        """Land at (x, y) [m], world frame, or right below; rotors stop on the ground."""
        if self.is_landed and at is None:
            return
        self.go_to((*(at or self.position[:2]), 0.0))

    def carry(self, mass: float) -> None:
        """Set the mass of the load in the gripper [kg]; 0 for none."""
        load = self.model.body("load").id
        change = max(mass, 1e-6) - self.model.body_mass[load]
        self.model.body_mass[load] += change
        for body in (0, self.model.body("vehicle").id, load):
            self.model.body_subtreemass[body] += change

    @property
    def altitude(self) -> float:
        """Height of the legs above the ground [m]."""
        return float(self.position[2]) - ON_GROUND_M

    @property
    def arm_rad(self) -> float:
        """Angle of the arm, 0 when folded, half pi when unfolded [rad]."""
        return float(self.data.qpos[7])

    def is_near(self, target: Sequence[float], within: float) -> bool:
        """Tell whether the vehicle is slow, and within a distance [m] of a place [m]."""
        return math.dist(self.position, target) <= within and math.hypot(*self.velocity) < 0.4

    def step(self) -> None:
        """Compute the thrusts and advance by one control period."""
        is_flying = self._target is not None and self.has_power
        thrusts = self._thrusts() if is_flying else np.zeros(4)
        arm = self.data.ctrl[4] + FOLD_RAD_S * STEP_S * (-1 if self.is_folding else 1)
        self.data.ctrl[:] = (*thrusts, max(0.0, min(math.pi / 2, arm)))
        self._mujoco.mj_step(self.model, self.data, 2)
        area = math.pi * ROTOR_RADIUS_M**2
        ideal_w = (thrusts**1.5).sum() / math.sqrt(2 * AIR_KG_M3 * area)
        self.rotor_w = float(ideal_w) / FIGURE_OF_MERIT
        self.position = np.array(self.data.qpos[:3])
        self.velocity = np.array(self.data.qvel[:3])
        self.is_landed = self.altitude < TOUCH_M and self._touches_down(thrusts)

    def _touches_down(self, thrusts: Array) -> bool:
        if self._target is not None and self._target[2] < ON_GROUND_M:
            is_above = math.dist(self.position[:2], self._target[:2]) < STRAIGHT_M
            if is_above and math.hypot(*self.velocity) < TOUCH_M_S:
                self._target = None
                self._trim = np.zeros(3)
        return self._target is None and not thrusts.any()

    def _thrusts(self) -> Array:
        way = POSITION_GAIN * (self._aim() - self.position)
        error = limited(way, SPEED_M_S, CLIMB_M_S, CLIMB_M_S) - self.velocity
        trim = self._trim + TRIM_GAIN * STEP_S * error.clip(-1.0, 1.0)
        self._trim = trim.clip(-TRIM_LIMIT, TRIM_LIMIT)
        wanted = VELOCITY_GAIN * error + self._trim
        push = limited(wanted, SIDEWAYS_M_S2, GRAVITY_M_S2 / 2, UPWARDS_M_S2)
        push[2] += GRAVITY_M_S2
        self._mujoco.mju_quat2Mat(self._turn, self.data.qpos[3:7])
        axes = self._turn.reshape(3, 3)  # of the body, as columns
        forward, left, up = push @ axes
        size = math.hypot(*push)
        heading = math.atan2(axes[1, 0], axes[0, 0])
        turns = np.array((-left / size, forward / size, -heading))
        return mixed(self._mass * up, STIFFNESS * (TURN_GAINS * turns - self.data.qvel[3:6]))

    def _aim(self) -> Array:
        """Return the point to fly to now: first up, then along, then down."""
        assert self._target is not None
        if math.dist(self.position[:2], self._target[:2]) <= STRAIGHT_M:
            return self._target
        x, y, _ = self.position if self.altitude < CRUISE_M - 2 else self._target
        return np.array((x, y, CRUISE_M + ON_GROUND_M))
