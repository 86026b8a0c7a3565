"""The BlueROV2 in the water.

Its six thrusters, its hull, which MuJoCo simulates, and the autopilot that flies it.

A setpoint becomes a jerk-limited move, a wanted force and six thrusts, every control period.
"""

import logging
import math
from collections.abc import Callable
from importlib.resources import files
from math import atan2, cos, isfinite, sin
from typing import Any

import numpy as np

from suave_env.settings import Settings, SuaveEnvError

Vector = tuple[float, float, float]
"""East, north, up: world frame ENU, z up."""

COUNT = 6
"""Number of thrusters: 1 front right, 2 front left, 3 rear right, 4 rear left, 5 right and 6 left
vertical."""

_COSINE = 0.7071067811865476
_YAW_ARM_M = 0.1676  # mean of the arms of the front pair (0.164 m) and the rear pair (0.171 m)
_ROLL_ARM_M = 0.109
_DENSITY_KG_M3 = 1000.0  # of the water, as the buoyancy of SUAVE's world has it
_UNUSED = (
    "EQUALITY",
    "FRICTIONLOSS",
    "LIMIT",
    "SENSOR",
    "ISLAND",
    "AUTORESET",
)  # the last: what is lost stays lost
_FLOAT_MASS_KG = 0.001  # of the body that carries the buoyancy, see assets/sea.xml
_log = logging.getLogger(__name__)


class Thrusters:
    """Shares a wanted force among the thrusters; the mixer knows nothing of failures.

    A failed thruster is frozen at its last output: with its servo function set to 0, ArduPilot
    stops writing the channel, and the simulated motor keeps pushing (kas-lab/suave v1.3.0).

    Attributes:
        outputs: Thrusts [N] of thrusters 1 to 6, positive along the direction of each in the model.
        energy_j: Energy that they have put into the water [J], with ideal propellers.
    """

    def __init__(self, settings: Settings) -> None:
        self.outputs = [0.0] * COUNT
        self.energy_j = 0.0
        # an actuator disc of area A takes |T|^1.5 / sqrt(2 rho A) to push still water of density
        # rho
        self._power = 1 / math.sqrt(2 * _DENSITY_KG_M3 * math.pi / 4 * settings.propeller_m**2)
        self._limit = settings.thrust_limit_n
        self._stuck: dict[int, float] = {}

    @property
    def failed(self) -> tuple[int, ...]:
        return tuple(sorted(self._stuck))

    def fail(self, number: int) -> None:
        """Freeze a thruster, 1 to 6, at its last output."""
        self._stuck.setdefault(number, self.outputs[number - 1])

    def recover(self, number: int) -> None:
        """Restore a thruster, 1 to 6: it obeys again."""
        self._stuck.pop(number, None)

    def allocate(
        self,
        forward: float,
        left: float,
        up: float,
        roll: float,
        turn: float,
        duration: float = 0.0,
    ) -> list[float]:
        """Share a wanted force and torque among the thrusters, and count the energy.

        The shares are those of the "vectored" frame of ArduPilot's Sub, for thrusts along the
        directions of the model. Forces along x, y and z of the body frame [N]; torques about its x
        and z [N m], a turn positive to the left.

        Returns:
            The six outputs [N]. Beyond the limit, the thrusts of a group are scaled together: the
            direction stays.
        """
        forward = forward / (4 * _COSINE)
        left = left / (4 * _COSINE)
        turn = turn / (4 * _YAW_ARM_M)
        first = -forward - left - turn
        second = -forward + left + turn
        third = forward - left + turn
        fourth = forward + left - turn
        fifth = roll / (2 * _ROLL_ARM_M) - up / 2
        sixth = -roll / (2 * _ROLL_ARM_M) - up / 2
        limit = self._limit
        level = max(abs(first), abs(second), abs(third), abs(fourth))
        if level > limit:
            scale = limit / level
            first = first * scale
            second = second * scale
            third = third * scale
            fourth = fourth * scale
        upright = max(abs(fifth), abs(sixth))
        if upright > limit:
            fifth = fifth * limit / upright
            sixth = sixth * limit / upright
        self.outputs = outputs = [first, second, third, fourth, fifth, sixth]
        if self._stuck:
            for number, frozen in self._stuck.items():
                outputs[number - 1] = frozen
            first, second, third, fourth, fifth, sixth = outputs
        thrusts = abs(first) ** 1.5 + abs(second) ** 1.5 + abs(third) ** 1.5 + abs(fourth) ** 1.5
        self.energy_j += (thrusts + abs(fifth) ** 1.5 + abs(sixth) ** 1.5) * self._power * duration
        return outputs


class Vehicle:
    """A rigid body with six thrusters, buoyancy and quadratic drag.

    Drag along each body axis is `-D |v| v` without added mass or linear damping, as in
    clydemcqueen/bluerov2_ignition. It is an actuator whose force is `-D v ctrl`, with `ctrl = |v|`
    at the start of a control period: MuJoCo treats `v` implicitly, so drag can only take energy
    out.

    Args:
        settings: Mass, inertia, buoyancy, drag, thrust limit and the physics step.
        x, y, z: Start position [m], world frame ENU, z up.

    Attributes:
        state: Two functions: of position [m] and quaternion (w, x, y, z), (7,), and of velocity
            [m/s] and angular velocity [rad/s], (6,), the last in the body frame, x forward, y left,
            all others in the world frame ENU, z up; for loops in which an attribute costs too much.
    """

    def __init__(self, settings: Settings, x: float, y: float, z: float) -> None:
        import mujoco  # takes long, and settings do not need it

        # MuJoCo's own handler prints, and writes a file into the working directory; the autopilot
        # raises what matters
        mujoco.set_mju_user_warning(_log.debug)
        self.model: Any = _compiled(mujoco, settings)
        for name in _UNUSED:
            self.model.opt.disableflags |= getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}")
        self.data: Any = mujoco.MjData(self.model)
        self._substeps = round(settings.control_period_s / settings.physics_step_s)
        self._step = mujoco.mj_step
        self._qpos = self.data.qpos
        self._qvel = self.data.qvel
        self._ctrl = self.data.ctrl
        self._flow = self.data.ctrl[COUNT:]
        self._body_velocity = self.data.actuator_velocity[COUNT:]
        self.state: tuple[Callable[[], list[float]], Callable[[], list[float]]] = (
            self._qpos.tolist,
            self._qvel.tolist,
        )
        self._qpos[:] = (x, y, z, 1, 0, 0, 0)
        mujoco.mj_forward(self.model, self.data)

    @property
    def position(self) -> tuple[float, float, float]:
        """Position [m], world frame ENU, z up."""
        x, y, z, *_ = self._qpos.tolist()
        return x, y, z

    @property
    def velocity(self) -> tuple[float, float, float]:
        """Velocity [m/s], world frame ENU, z up."""
        x, y, z, *_ = self._qvel.tolist()
        return x, y, z

    def push(self, thrusts: list[float]) -> None:
        """Advance by one control period under constant thrusts [N]; (6,)."""
        self._ctrl[:COUNT] = thrusts
        np.abs(self._body_velocity, self._flow)
        self._step(self.model, self.data, self._substeps)


def floated(settings: Settings, time_s: float) -> float:
    """Return how far the vehicle, which is lighter than water, rises by itself in a time [m].

    It rises at the speed at which drag equals the surplus of buoyancy, which it reaches within a
    second.
    """
    surplus = (settings.displaced_mass_kg - settings.mass_kg) * settings.gravity_m_s2
    if not settings.drag_heave:
        return 0.0
    speed = math.copysign(math.sqrt(abs(surplus) / settings.drag_heave), surplus)
    return speed * time_s


def _compiled(mujoco: Any, settings: Settings) -> Any:  # noqa: ANN401 - MuJoCo ships no types
    """Compile the packaged model with the figures of the settings in it."""
    spec = mujoco.MjSpec.from_string(
        (files("suave_env") / "assets" / "sea.xml").read_text(encoding="utf-8")
    )
    spec.option.timestep = settings.physics_step_s
    spec.option.gravity = (0, 0, -settings.gravity_m_s2)
    hull = spec.body("vehicle")
    buoyancy = spec.body("buoyancy")
    hull.mass = settings.mass_kg - _FLOAT_MASS_KG
    hull.inertia = (
        settings.inertia_roll_kg_m2,
        settings.inertia_pitch_kg_m2,
        settings.inertia_yaw_kg_m2,
    )
    hull.ipos = (0, 0, settings.centre_of_mass_z_m)
    spec.site("centre_of_mass").pos = (0, 0, settings.centre_of_mass_z_m)
    buoyancy.gravcomp = settings.displaced_mass_kg / _FLOAT_MASS_KG
    buoyancy.pos = (0, 0, settings.centre_of_buoyancy_z_m)
    for number in range(1, COUNT + 1):
        spec.actuator(f"thruster_{number}").ctrlrange = (
            -settings.thrust_limit_n,
            settings.thrust_limit_n,
        )
    for axis in ("surge", "sway", "heave", "roll", "pitch", "yaw"):
        spec.actuator(f"drag_{axis}").gainprm[2] = -getattr(settings, f"drag_{axis}")
    try:
        return spec.compile()
    except ValueError as error:
        raise SuaveEnvError(f"MuJoCo refuses the vehicle of these settings: {error}") from error


class SCurve:
    """A move from rest to rest, within limits on speed, acceleration and jerk.

    The speed-up has three phases of constant jerk: `+J` for `tj`, 0 for `ta`, `-J` for `tj`. It
    reaches the peak speed `J tj (tj + ta)`; its length is half of the peak speed times `2 tj + ta`.
    After cruising, the slow-down mirrors it. `tj`, then `ta`, are the longest that the limits and
    the length allow.

    Args:
        length: Length [m], from 0.
        speed: Speed limit [m/s].
        acceleration: Acceleration limit [m/s2].
        jerk: Jerk limit [m/s3].

    Attributes:
        duration: Time of the whole move [s].
    """

    def __init__(self, length: float, speed: float, acceleration: float, jerk: float) -> None:
        ramp = min(math.cbrt(length / (2 * jerk)), math.sqrt(speed / jerk), acceleration / jerk)
        plateau = 0.0
        if ramp == acceleration / jerk:
            # length = a (tj + ta) (2 tj + ta), solved for ta; and peak speed = a (tj + ta)
            by_length = (-3 * ramp + math.sqrt(ramp * ramp + 4 * length / acceleration)) / 2
            plateau = max(0.0, min(by_length, speed / acceleration - ramp))
        self._jerk = jerk
        self._length = length
        self._ramp = ramp
        self._plateau = plateau
        self._rise = 2 * ramp + plateau
        self._peak = jerk * ramp * (ramp + plateau)
        cruise = max(0.0, length / self._peak - self._rise) if self._peak > 0 else 0.0
        self.duration = 2 * self._rise + cruise

    def at(self, time: float) -> tuple[float, float]:
        """Return the distance [m] and the speed [m/s] of the move at a time since its start [s]."""
        left = self.duration - time
        rise = self._rise
        if left <= 0:
            return self._length, 0.0
        if left < rise:
            distance, speed = self._speeding_up(left)
            return self._length - distance, speed
        if time < rise:
            return self._speeding_up(time)
        return self._peak * (time - self._rise / 2), self._peak

    def _speeding_up(self, time: float) -> tuple[float, float]:
        ramp = self._ramp
        jerk = self._jerk
        if time <= ramp:
            return jerk * time**3 / 6, jerk * time * time / 2
        top = jerk * ramp
        if time <= ramp + self._plateau:
            since = time - ramp
            return top * (ramp * ramp / 6 + ramp * since / 2 + since * since / 2), top * (
                ramp / 2 + since
            )
        # by symmetry about the middle of the speed-up: speed(t) = peak - speed(rise - t)
        left = self._rise - time
        speed = self._peak - jerk * left * left / 2
        return self._peak * (self._rise / 2 - left) + jerk * left**3 / 6, speed


class Guidance:
    """Flies to setpoints, our own simplification of the GUIDED mode of ArduPilot's Sub.

    A new setpoint begins a jerk-limited move from rest to rest, in a straight line from the
    stopping point `p + v / k` to the setpoint. Position gain `k` and a first-order velocity loop of
    time constant `tau` follow it:

        `v_wanted = v_move + k (p_move - p)`,  `F = m / tau (v_wanted - v) + integral`

    Whoever applies the force adds the vehicle's drag, so that the loop has the lag `tau` at every
    speed.
    """

    def __init__(self, settings: Settings, position: Vector) -> None:
        self._settings = settings
        self._gains = (settings.position_gain, settings.position_gain, settings.height_gain)
        self._stiffness = (
            settings.mass_kg / settings.velocity_lag_s,
            settings.mass_kg / settings.height_lag_s,
        )
        self._integral_gain = settings.integral_gain
        self._integral_limit = settings.integral_limit_n
        self._integral: Vector = (0.0, 0.0, 0.0)
        self.go_to(position, position, (0.0, 0.0, 0.0), 0.0)

    def go_to(self, target: Vector, position: Vector, velocity: Vector, time: float) -> None:
        """Begin a move to a setpoint [m] from a position [m] and velocity [m/s], now [s]."""
        origin = self.stopping_point(position, velocity)
        dx, dy, dz = (end - start for end, start in zip(target, origin, strict=True))
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        self._origin = origin
        self._start = time
        self._direction = (dx / length, dy / length, dz / length) if length > 0 else (0.0, 0.0, 0.0)
        speed, acceleration = self._limits()
        self._move = SCurve(length, speed, acceleration, self._settings.jerk_limit_m_s3)

    def stopping_point(self, position: Vector, velocity: Vector) -> Vector:
        """Return where the vehicle would come to rest [m]: `p + v / k`."""
        px, py, pz = position
        vx, vy, vz = velocity
        kx, ky, kz = self._gains
        return px + vx / max(kx, 1e-3), py + vy / max(ky, 1e-3), pz + vz / max(kz, 1e-3)

    def force(
        self, position: list[float], velocity: list[float], time: float, duration: float
    ) -> Vector:
        """Return the wanted force [N], world frame ENU, z up, for a duration [s] from now [s].

        It reads the first three numbers of position [m] and velocity [m/s].
        """
        along, speed = self._move.at(time - self._start)
        ox, oy, oz = self._origin
        ex, ey, ez = self._direction
        kx, ky, kz = self._gains
        level, upright = self._stiffness
        wx = ex * speed + kx * (ox + ex * along - position[0]) - velocity[0]
        wy = ey * speed + ky * (oy + ey * along - position[1]) - velocity[1]
        wz = ez * speed + kz * (oz + ez * along - position[2]) - velocity[2]
        gain = self._integral_gain * duration
        limit = self._integral_limit
        ix, iy, iz = self._integral
        ix = ix + gain * wx
        iy = iy + gain * wy
        iz = iz + gain * wz
        if not (-limit <= ix <= limit and -limit <= iy <= limit and -limit <= iz <= limit):
            ix, iy, iz = (min(limit, max(-limit, part)) for part in (ix, iy, iz))
        self._integral = (ix, iy, iz)
        return level * wx + ix, level * wy + iy, upright * wz + iz

    def _limits(self) -> tuple[float, float]:
        """Return the limits on speed [m/s] and acceleration [m/s2] along the move's direction."""
        settings = self._settings
        ex, ey, ez = self._direction
        level = math.hypot(ex, ey)
        upright = abs(ez)
        vertical = settings.climb_limit_m_s if ez > 0 else settings.descent_limit_m_s
        speed = math.inf
        acceleration = math.inf
        if level > 0:
            speed = settings.speed_limit_m_s / level
            acceleration = settings.acceleration_limit_m_s2 / level
        if upright > 0:
            speed = min(speed, vertical / upright)
            acceleration = min(acceleration, settings.climb_acceleration_limit_m_s2 / upright)
        return speed, acceleration


class Autopilot:
    """Holds a heading of east and flies to setpoints."""

    def __init__(
        self, settings: Settings, vehicle: Vehicle, thrusters: Thrusters, bias: float
    ) -> None:
        self._gains = (
            *(settings.heading_gain, settings.heading_damping, settings.roll_damping),
            *(settings.drag_surge, settings.drag_sway, settings.drag_heave),
        )
        self._vehicle = vehicle
        self._thrusters = thrusters
        self._bias = bias
        self._period = settings.control_period_s
        self._periods = 0
        self._until = 0.0
        self._guidance = Guidance(settings, vehicle.position)

    @property
    def position(self) -> Vector:
        """Position [m], world frame ENU, z up.

        Extrapolated at constant velocity between two control periods.
        """
        pose_of, motion_of = self._vehicle.state
        x, y, z, *_ = pose_of()
        vx, vy, vz, *_ = motion_of()
        since = self._until - self._periods * self._period
        return x + since * vx, y + since * vy, z + since * vz

    def go_to(self, target: Vector, time: float) -> None:
        """Fly to a setpoint [m], world frame ENU, z up, from now [s] on."""
        x, y, z = target
        self._guidance.go_to((x, y, z + self._bias), self.position, self._vehicle.velocity, time)

    def hold(self, time: float) -> None:
        """Stop as soon as possible, from now [s] on."""
        position = self.position
        velocity = self._vehicle.velocity
        self._guidance.go_to(
            self._guidance.stopping_point(position, velocity), position, velocity, time
        )

    def fly(self, until: float) -> None:
        """Simulate all control periods that end by a time [s]."""
        self._until = until
        last = math.floor(until / self._period + 1e-9)
        if last > self._periods:
            self._fly_periods(last)
            self._periods = last

    def _fly_periods(self, last: int) -> None:
        period = self._period
        guide = self._guidance.force
        push = self._vehicle.push
        allocate = self._thrusters.allocate
        pose_of, motion_of = self._vehicle.state
        heading_gain, heading_damping, roll_damping, surge_drag, sway_drag, heave_drag = self._gains
        for count in range(self._periods, last):
            pose = pose_of()
            motion = motion_of()
            x, _, _, qw, qx, qy, qz = pose
            vx, vy, vz, roll_rate, _, yaw_rate = motion
            if not isfinite(x + vx):
                when = f"{count * period:.3f} s"
                raise SuaveEnvError(
                    f"the simulation became unstable after {when}; a setting is too far off"
                )
            east, north, up = guide(pose, motion, (count + 0.5) * period, period)
            yaw = atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
            cosine = cos(yaw)
            sine = sin(yaw)
            surge = cosine * vx + sine * vy
            sway = cosine * vy - sine * vx
            push(
                allocate(
                    cosine * east + sine * north + surge_drag * abs(surge) * surge,
                    cosine * north - sine * east + sway_drag * abs(sway) * sway,
                    up + heave_drag * abs(vz) * vz,
                    -roll_damping * roll_rate,
                    -heading_gain * yaw - heading_damping * yaw_rate,
                    period,
                )
            )
