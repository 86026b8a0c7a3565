"""The quadrotor, simulated by MuJoCo, its controller, and the constants with sources.

The controller is the usual cascade: position error to velocity, velocity error to acceleration, its
direction to the tilt of the mast, tilt error to body rates, rate error to torques; the mixer turns
torques into thrusts.
"""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Final

from missions.engine.settings import Constants, setting
from missions.uav.model import MOST_SAMPLES

_OWN: Final = "own choice"
_SHORT: Final = "own choice: small, so that a mission takes minutes"
_CONTROL: Final = "own choice: common for a vehicle of this size"
_SCENARIO: Final = "own choice, so that the paper's three scenarios occur"


@dataclass(frozen=True, slots=True)
class Settings(Constants):
    """The constants; frozen. World frame ENU, z up, ground at z = 0, base at the origin.

    Times since the start.
    """

    # What happens
    samples: float = setting(
        7, "-", "number of samples that are wanted from the start", _OWN, 1, MOST_SAMPLES - 1
    )
    added_s: float = setting(
        60.0, "s", "when an operator reports one more sample; 0: never", _SCENARIO
    )
    gripper_worn_s: float = setting(120.0, "s", "time after which a grip jams; 0: never", _SCENARIO)
    jam_delay_s: float = setting(
        3.0, "s", "longest time from such a grip to its jam", _SCENARIO, 0.1, 5
    )

    # The field
    field_x_m: float = setting(
        36.0, "m", "length of the field, eastward from the base", _OWN, 10, 90
    )
    lane_m: float = setting(6.0, "m", "distance between the lanes of the search", _OWN, 2, 10)
    lanes: float = setting(
        6, "-", "number of lanes; the middle third has no samples", _SCENARIO, 3, 9
    )
    sample_kg: float = setting(0.2, "kg", "mass of a sample", _OWN, 0, 0.5)

    # Flight
    physics_step_s: float = setting(
        0.01, "s", "step of the physics; thrust is constant for two", _OWN, 0.001, 0.01
    )
    cruise_m: float = setting(5.0, "m", "height of search and travel", _OWN, 2, 20)
    speed_m_s: float = setting(3.0, "m/s", "horizontal speed limit", _CONTROL, 0.5, 5)
    climb_m_s: float = setting(1.5, "m/s", "vertical speed limit", _CONTROL, 0.2, 3)
    rotor_limit_n: float = setting(8.0, "N", "largest thrust of one rotor", _CONTROL, 5.5, 20)
    rotor_radius_m: float = setting(
        0.127, "m", "radius of a propeller, for its power", "10 inch propeller", 0.05, 0.5
    )
    figure_of_merit: float = setting(
        0.6, "-", "ideal divided by actual power of a hovering rotor", _CONTROL, 0.1, 1
    )
    drag: float = setting(0.3, "N s/m", "linear drag of the air", _CONTROL, 0, 1.1)
    wind_m_s: float = setting(1.0, "m/s", "steady wind, from a random direction", _OWN, 0, 4)
    gravity_m_s2: float = setting(9.81, "m/s2", "gravity", "standard gravity", 7, 12)
    air_kg_m3: float = setting(
        1.225, "kg/m3", "density of the air", "standard atmosphere at sea level", 0.5, 2
    )

    # Battery
    capacity_j: float = setting(28000.0, "J", "energy of a full battery", _SHORT, 1000)
    charge_s: float = setting(10.0, "s", "time to charge an empty battery", _SHORT, 0.1)
    avionics_w: float = setting(5.0, "W", "power of the electronics that always run", _OWN)
    pick_up_w: float = setting(40.0, "W", "power of gripper and analyser together", _OWN)
    infrared_w: float = setting(5.0, "W", "power of the infra-red camera", _OWN)
    battery_period_s: float = setting(0.5, "s", "period of the battery monitor", _OWN, 0.05, 5)

    # Work
    half_view_rad: float = setting(
        0.66, "rad", "half of the sample camera's field of view", _OWN, 0.1, 1.4
    )
    grip_s: float = setting(1.0, "s", "time to grip a sample", _OWN, 0.1)
    analysis_s: float = setting(6.0, "s", "time to analyse a held sample", _OWN, 0.1)
    infrared_s: float = setting(4.0, "s", "time to analyse a sample in the infra-red", _OWN, 0.1)
    infrared_quality: float = setting(
        0.6, "-", "worth of an infra-red analysis; of a held sample it is 1", _OWN
    )
    fold_s: float = setting(1.5, "s", "time to fold or unfold the gripper", _OWN, 0.2)

    # Switching
    activation_s: float = setting(0.03, "s", "time to activate a component", "typical of ROS 2")
    deactivation_s: float = setting(0.03, "s", "time to deactivate a component", "typical of ROS 2")


Vector = tuple[float, float, float]

ARM_M: Final = 0.18  # from the centre to a rotor, along x and along y
REACTION_M: Final = 0.016  # torque about the mast for each newton of thrust
_ARMS_M, _REACTIONS_M = 4 * ARM_M, 4 * REACTION_M  # of all rotors
INERTIA: Final = (0.021, 0.021, 0.036)  # about x, y, z [kg m2], the arm included

POSITION_GAIN: Final = 1.0  # [1/s]
VELOCITY_GAIN: Final = 3.0  # [1/s]
TILT_GAIN: Final = 8.0  # [1/s]
RATE_GAIN: Final = 25.0  # [1/s]
_STIFFNESS: Final = tuple(inertia * RATE_GAIN for inertia in INERTIA)
YAW_GAIN: Final = 2.0  # [1/s]
SIDEWAYS_M_S2: Final = 4.0  # largest horizontal acceleration that the controller wants
VERTICAL_M_S2: Final = 4.0  # the same, upwards; downwards it is half of gravity


def velocity_wanted(position: Vector, target: Vector, speed: float, climb: float) -> Vector:
    """Return the velocity [m/s] at which to approach a target [m], world frame.

    Limits: `speed` is horizontal, `climb` vertical [m/s].
    """
    x = POSITION_GAIN * (target[0] - position[0])
    y = POSITION_GAIN * (target[1] - position[1])
    z = POSITION_GAIN * (target[2] - position[2])
    far = math.hypot(x, y)
    scale = speed / far if far > speed else 1.0
    return x * scale, y * scale, _within(z, climb)


def wanted_force(error: Vector, trim: Vector, mass: float, gravity: float) -> Vector:
    """Return the force of the rotors that corrects a velocity [N], world frame; always upwards.

    Args:
        error: wanted minus actual velocity [m/s], world frame.
        trim: integral part of the controller, an acceleration [m/s2], world frame.
        mass: of the vehicle [kg].
        gravity: [m/s2].
    """
    x = VELOCITY_GAIN * error[0] + trim[0]
    y = VELOCITY_GAIN * error[1] + trim[1]
    z = VELOCITY_GAIN * error[2] + trim[2]
    push = math.hypot(x, y)
    scale = SIDEWAYS_M_S2 / push if push > SIDEWAYS_M_S2 else 1.0
    lift = max(gravity / 2, gravity + (z if z < VERTICAL_M_S2 else VERTICAL_M_S2))
    return mass * x * scale, mass * y * scale, mass * lift


def attitude(quaternion: Sequence[float], rates: Vector, force: Vector) -> tuple[float, Vector]:
    """Return thrust [N] and torques [N m], body frame, that turn the mast towards a force.

    The torques also turn the nose to the east.

    Args:
        quaternion: attitude of the body, a unit quaternion (w, x, y, z).
        rates: angular velocity [rad/s], body frame.
        force: wanted force [N], world frame.
    """
    w, i, j, k = quaternion
    east, north, up = force
    size = math.sqrt(east * east + north * north + up * up)
    # the body's x axis, to the east and to the north
    nose = 1 - 2 * (j * j + k * k)
    aside = 2 * (i * j + w * k)
    thrust = (
        2 * (i * k + w * j) * east + 2 * (j * k - w * i) * north + (1 - 2 * (i * i + j * j)) * up
    )
    forward = (nose * east + aside * north + 2 * (i * k - w * j) * up) / size
    left = (
        2 * (i * j - w * k) * east + (1 - 2 * (i * i + k * k)) * north + 2 * (j * k + w * i) * up
    ) / size
    # the turn from the mast (0, 0, 1) to the wanted direction, body frame; its sine, or 1 beyond a
    # right angle
    turn_x = -left
    turn_y = forward
    if thrust <= 0.0:
        sine = math.hypot(left, forward)
        turn_x, turn_y = (-left / sine, forward / sine) if sine > 0 else (1.0, 0.0)
    return thrust, (
        _STIFFNESS[0] * (TILT_GAIN * turn_x - rates[0]),
        _STIFFNESS[1] * (TILT_GAIN * turn_y - rates[1]),
        _STIFFNESS[2] * (-YAW_GAIN * math.atan2(aside, nose) - rates[2]),
    )


def mixed(thrust: float, torques: Vector, limit: float) -> list[float]:
    """Return each rotor's thrust (4,) [N] for a whole thrust [N] and torques [N m], body frame.

    If a rotor cannot give its thrust, lift is reduced before tilt: a vehicle that stays upright can
    fly on.
    """
    x = torques[0] / _ARMS_M
    y = torques[1] / _ARMS_M
    z = torques[2] / _REACTIONS_M
    z = _within(z, 0.1 * limit)  # heading matters least
    turning = (x - y + z, x + y - z, -x + y + z, -x - y - z)
    even = max(-min(turning), min(limit - max(turning), thrust / 4))
    wanted = [even + share for share in turning]
    return (
        wanted
        if min(wanted) >= 0.0 and max(wanted) <= limit
        else [max(0.0, min(limit, thrust)) for thrust in wanted]
    )


def _within(value: float, limit: float) -> float:
    return (
        -limit if value < -limit else limit if value > limit else value
    )  # three times as fast as min and max


_log = logging.getLogger(__name__)
ON_GROUND_M: Final = 0.35
"""Height of the vehicle's origin when it stands [m]."""
SUBSTEPS: Final = 2
"""Number of physics steps for which the thrust is constant."""
STRAIGHT_M: Final = 0.6  # nearer than this it flies straight to a place, not at travelling height
TRIM_GAIN: Final = 1.0  # [1/s2]
TRIM_LIMIT: Final = 3.0  # [m/s2]; more than the strongest drag and wind of the settings take
TOUCH_M, TOUCH_M_S = 0.03, 0.2  # lower and slower than this, it stands


class Quadrotor:
    """A rigid body with four rotors, an arm that folds, and a load.

    Drag is linear in the speed through the air.

    Args:
        wind: (x, y) [m/s], world frame.

    Attributes:
        position: (x, y, z) [m], world frame, z is 0.35 m on the ground.
        velocity: (x, y, z) [m/s], world frame.
        is_landed: whether it stands on the ground with its rotors off.
        rotor_w: power of the rotors [W].
        has_power: whether there is power for the rotors.
    """

    def __init__(self, settings: Settings, wind: tuple[float, float]) -> None:
        import mujoco  # takes long, and listing missions does not need it

        mujoco.set_mju_user_warning(
            _log.debug
        )  # its own handler prints, and writes a file into the working directory
        self._settings = settings
        self._step_s = SUBSTEPS * settings.physics_step_s
        self._advance = mujoco.mj_step
        self.model: Any = _compiled(mujoco, settings)
        self.data: Any = mujoco.MjData(self.model)
        self._qpos = self.data.qpos
        self._qvel = self.data.qvel
        self._ctrl = self.data.ctrl
        self._mass = float(self.model.body_subtreemass[0])
        self.data.qfrc_applied[:2] = settings.drag * wind[0], settings.drag * wind[1]
        area = math.pi * settings.rotor_radius_m**2
        self._watts = 1 / (settings.figure_of_merit * math.sqrt(2 * settings.air_kg_m3 * area))
        self._target: Vector | None = None
        self._lands = False
        self._trim = (0.0, 0.0, 0.0)
        self._arm = 0.0
        self._arm_wanted = 0.0
        self.position: Vector = (0.0, 0.0, ON_GROUND_M)
        self.velocity: Vector = (0.0, 0.0, 0.0)
        self._turned = self._qpos[3:7].tolist()
        self._rates = self.velocity
        self.is_landed = True
        self.rotor_w = 0.0
        self.has_power = True

    def go_to(self, target: Vector) -> None:
        """Fly to a place [m], world frame; at travelling height unless the place is near."""
        self._target = target
        self._lands = False

    def hold(self) -> None:
        """Hover at the present position; on the ground, stay there."""
        self._target = None if self.is_landed else self.position
        self._lands = False

    def land(self, at: tuple[float, float] | None = None) -> None:
        """Land at (x, y) [m], world frame, or right below; rotors stop on the ground."""
        if self.is_landed and at is None:
            return
        x, y = at or self.position[:2]
        self._target = (x, y, 0.0)
        self._lands = True

    def fold(self, is_folded: bool) -> None:
        self._arm_wanted = 0.0 if is_folded else math.pi / 2

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
        return self.position[2] - ON_GROUND_M

    @property
    def arm_rad(self) -> float:
        """Angle of the arm, 0 when folded, half pi when unfolded [rad]."""
        return float(self.data.qpos[7])

    def is_near(self, target: Vector, within: float) -> bool:
        """Tell whether the vehicle is slow, and within a distance [m] of a place [m]."""
        return math.dist(self.position, target) <= within and math.hypot(*self.velocity) < 0.4

    def step(self) -> None:
        """Compute the thrusts and advance by one control period."""
        thrusts = (
            self._thrusts(self._step_s)
            if self._target is not None and self.has_power
            else [0.0] * 4
        )
        if self._arm != self._arm_wanted:
            turn = math.pi / 2 / self._settings.fold_s * self._step_s
            self._arm += max(-turn, min(turn, self._arm_wanted - self._arm))
        self._ctrl[:4] = thrusts
        self._ctrl[4] = self._arm
        self._advance(self.model, self.data, SUBSTEPS)
        a, b, c, d = thrusts
        self.rotor_w = self._watts * (
            a * math.sqrt(a) + b * math.sqrt(b) + c * math.sqrt(c) + d * math.sqrt(d)
        )
        x, y, z, a, b, c, d, *_ = self._qpos.tolist()
        u, v, w, roll, pitch, yaw, *_ = self._qvel.tolist()
        self.position = (x, y, z)
        self.velocity = (u, v, w)
        self._turned = (a, b, c, d)
        self._rates = (roll, pitch, yaw)
        self.is_landed = z - ON_GROUND_M < TOUCH_M and self._touches_down(thrusts)

    def _touches_down(self, thrusts: list[float]) -> bool:
        here = self.position[:2]
        is_above = math.dist(here, (self._target or here)[:2]) < STRAIGHT_M
        if self._lands and is_above and math.hypot(*self.velocity) < TOUCH_M_S:
            self._target = None
            self._lands = False
            self._trim = (0.0, 0.0, 0.0)
        return self._target is None and not any(thrusts)

    def _thrusts(self, step_s: float) -> list[float]:
        settings = self._settings
        u, v, w = self.velocity
        east, north, up = velocity_wanted(
            self.position, self._aim(), settings.speed_m_s, settings.climb_m_s
        )
        error = (east - u, north - v, up - w)
        moved = [
            trim + TRIM_GAIN * _within(off, 1.0) * step_s
            for trim, off in zip(self._trim, error, strict=True)
        ]
        x, y, z = [_within(trim, TRIM_LIMIT) for trim in moved]
        self._trim = trim = (x, y, z)
        force = wanted_force(error, trim, self._mass, settings.gravity_m_s2)
        return mixed(*attitude(self._turned, self._rates, force), settings.rotor_limit_n)

    def _aim(self) -> Vector:
        """Return the point to fly to now: first up, then along, then down."""
        assert self._target is not None
        x, y, z = self.position
        to_x, to_y, _ = self._target
        cruise = self._settings.cruise_m
        if math.hypot(to_x - x, to_y - y) <= STRAIGHT_M:
            return self._target
        is_low = z - ON_GROUND_M < cruise - 2.0
        return x if is_low else to_x, y if is_low else to_y, cruise + ON_GROUND_M


def _compiled(mujoco: Any, settings: Settings) -> Any:  # noqa: ANN401  # MuJoCo ships no types
    spec = mujoco.MjSpec.from_string(
        (files("missions.uav") / "quadrotor.xml").read_text(encoding="utf-8")
    )
    spec.option.timestep = settings.physics_step_s
    spec.option.gravity = (0, 0, -settings.gravity_m_s2)
    for number in range(1, 5):
        spec.actuator(f"rotor_{number}").ctrlrange = (0, settings.rotor_limit_n)
    model = spec.compile()
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # what is lost stays lost
    model.dof_damping[:3] = settings.drag
    model.dof_damping[3:6] = 0.005
    return model
