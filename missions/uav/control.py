"""How a quadrotor is flown: from a place to go to, over velocity and attitude, to four thrusts. Pure functions.

The cascade is the usual one: position error to velocity, velocity error to acceleration, its direction to the tilt of
the mast, tilt error to body rates, rate error to torques, which the mixer turns into thrusts.
"""

import math
from collections.abc import Sequence
from typing import Final

__all__ = ["Vector", "attitude_torques", "mast", "mixed", "velocity_wanted", "wanted_force"]

Vector = tuple[float, float, float]

ARM_M: Final = 0.18  # from the centre to a rotor, along x and along y
REACTION_M: Final = 0.016  # torque about the mast for each newton of thrust
INERTIA: Final = (0.021, 0.021, 0.036)  # about x, y, z [kg m2], the arm included

POSITION_GAIN: Final = 1.0  # [1/s]
VELOCITY_GAIN: Final = 3.0  # [1/s]
TILT_GAIN: Final = 8.0  # [1/s]
RATE_GAIN: Final = 25.0  # [1/s]
YAW_GAIN: Final = 2.0  # [1/s]
SIDEWAYS_M_S2: Final = 4.0  # largest horizontal acceleration that is asked for
VERTICAL_M_S2: Final = 4.0  # the same, upwards; downwards it is half of gravity


def velocity_wanted(position: Vector, target: Vector, speed: float, climb: float) -> Vector:
    """Return the velocity at which to approach a target.

    Args:
        position: (x, y, z) [m], world frame.
        target: (x, y, z) [m], world frame.
        speed: horizontal limit [m/s].
        climb: vertical limit [m/s].
    """
    x, y, z = (POSITION_GAIN * (to - at) for at, to in zip(position, target, strict=True))
    scale = min(1.0, speed / max(math.hypot(x, y), 1e-9))
    return x * scale, y * scale, max(-climb, min(climb, z))


def wanted_force(error: Vector, trim: Vector, mass: float, gravity: float) -> Vector:
    """Return the force of the rotors that corrects a velocity.

    Args:
        error: wanted minus actual velocity [m/s], world frame.
        trim: acceleration that was found to be needed in the long run [m/s2], world frame.
        mass: of the vehicle [kg].
        gravity: [m/s2].

    Returns:
        (x, y, z) [N], world frame; always upwards.
    """
    x, y, z = (VELOCITY_GAIN * one + more for one, more in zip(error, trim, strict=True))
    scale = min(1.0, SIDEWAYS_M_S2 / max(math.hypot(x, y), 1e-9))
    lift = max(gravity / 2, gravity + min(VERTICAL_M_S2, z))
    return mass * x * scale, mass * y * scale, mass * lift


def mast(quaternion: Sequence[float]) -> tuple[Vector, Vector, Vector]:
    """Return the axes x, y, z of the body in the world frame, from a unit quaternion (w, x, y, z)."""
    w, x, y, z = quaternion
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )


def attitude_torques(axes: tuple[Vector, Vector, Vector], rates: Vector, force: Vector) -> Vector:
    """Return the torques that turn the mast towards a force, and the nose to the east.

    Args:
        axes: of the body in the world frame.
        rates: angular velocity [rad/s], body frame.
        force: wanted force [N], world frame.

    Returns:
        (x, y, z) [N m], body frame.
    """
    size = math.sqrt(_dot(force, force))
    forward, left, up = (_dot(axis, force) / size for axis in axes)
    # the turn from the mast (0, 0, 1) to the wanted direction, body frame; its sine, or 1 beyond a right angle
    turn_x, turn_y = (-left, forward) if up > 0 else _unit(-left, forward)
    yaw = math.atan2(axes[0][1], axes[0][0])
    wanted = (TILT_GAIN * turn_x, TILT_GAIN * turn_y, -YAW_GAIN * yaw)
    x, y, z = (i * RATE_GAIN * (to - rate) for i, to, rate in zip(INERTIA, wanted, rates, strict=True))
    return x, y, z


def mixed(thrust: float, torques: Vector, limit: float) -> list[float]:
    """Return the thrust of each rotor [N]; (4,), each from 0 to the limit.

    Where a rotor cannot give what is wanted, lift gives way first: a vehicle that keeps upright can be flown on.

    Args:
        thrust: of all together [N].
        torques: (x, y, z) [N m], body frame.
        limit: of one rotor [N].
    """
    x, y, z = torques[0] / (4 * ARM_M), torques[1] / (4 * ARM_M), torques[2] / (4 * REACTION_M)
    z = max(-0.1 * limit, min(0.1 * limit, z))  # heading matters least
    turning = (x - y + z, x + y - z, -x + y + z, -x - y - z)
    even = max(-min(turning), min(limit - max(turning), thrust / 4))
    return [max(0.0, min(limit, even + one)) for one in turning]


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _unit(x: float, y: float) -> tuple[float, float]:
    size = math.hypot(x, y)
    return (x / size, y / size) if size > 0 else (1.0, 0.0)
