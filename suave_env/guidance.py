"""From setpoints to the force that the vehicle should be pushed with."""

import math

from suave_env.scurve import SCurve
from suave_env.settings import Settings

__all__ = ["Guidance", "Vector"]

Vector = tuple[float, float, float]
"""East, north, up: world frame ENU, z up."""


class Guidance:
    """Flies to setpoints as GUIDED mode of ArduPilot's Sub does in essence; of our own making.

    A new setpoint begins a jerk-limited move from rest to rest, in a straight line from the stopping point `p + v / k`
    to the setpoint. Position gain `k` and a first-order velocity loop of time constant `tau` follow it:

        `v_wanted = v_move + k (p_move - p)`,  `F = m / tau (v_wanted - v) + integral`

    Whoever applies the force adds the vehicle's drag, so that the loop has the lag `tau` at every speed.

    Args:
        settings: Limits, gains and the vehicle's mass.
        position: Where the vehicle is and stays until the first setpoint [m], world frame ENU, z up.
    """

    def __init__(self, settings: Settings, position: Vector) -> None:
        self._settings = settings
        self._gains = (settings.position_gain, settings.position_gain, settings.height_gain)
        self._stiffness = (settings.mass_kg / settings.velocity_lag_s, settings.mass_kg / settings.height_lag_s)
        self._integral_gain, self._integral_limit = settings.integral_gain, settings.integral_limit_n
        self._integral: Vector = (0.0, 0.0, 0.0)
        self.go_to(position, position, (0.0, 0.0, 0.0), 0.0)

    def go_to(self, target: Vector, position: Vector, velocity: Vector, time: float) -> None:
        """Begin a move to a setpoint.

        Args:
            target: The setpoint [m], world frame ENU, z up.
            position: Where the vehicle is [m].
            velocity: How fast it moves [m/s].
            time: Now [s].
        """
        origin = self.stopping_point(position, velocity)
        dx, dy, dz = (end - start for end, start in zip(target, origin, strict=True))
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        self._origin, self._start = origin, time
        self._direction = (dx / length, dy / length, dz / length) if length > 0 else (0.0, 0.0, 0.0)
        speed, acceleration = self._limits()
        self._move = SCurve(length, speed, acceleration, self._settings.jerk_limit_m_s3)

    def stopping_point(self, position: Vector, velocity: Vector) -> Vector:
        """Return where the vehicle would come to rest [m]: `p + v / k`."""
        (px, py, pz), (vx, vy, vz), (kx, ky, kz) = position, velocity, self._gains
        return px + vx / max(kx, 1e-3), py + vy / max(ky, 1e-3), pz + vz / max(kz, 1e-3)

    def force(self, position: list[float], velocity: list[float], time: float, duration: float) -> Vector:
        """Return the wanted force [N], world frame ENU, z up.

        Args:
            position: Where the vehicle is [m]; the first three numbers are read.
            velocity: How fast it moves [m/s]; the first three numbers are read.
            time: Now [s].
            duration: For how long the force will be held [s].
        """
        along, speed = self._move.at(time - self._start)
        ox, oy, oz = self._origin
        ex, ey, ez = self._direction
        kx, ky, kz = self._gains
        level, upright = self._stiffness
        wx = ex * speed + kx * (ox + ex * along - position[0]) - velocity[0]
        wy = ey * speed + ky * (oy + ey * along - position[1]) - velocity[1]
        wz = ez * speed + kz * (oz + ez * along - position[2]) - velocity[2]
        gain, limit = self._integral_gain * duration, self._integral_limit
        ix, iy, iz = self._integral
        ix, iy, iz = ix + gain * wx, iy + gain * wy, iz + gain * wz
        if not (-limit <= ix <= limit and -limit <= iy <= limit and -limit <= iz <= limit):
            ix, iy, iz = (min(limit, max(-limit, part)) for part in (ix, iy, iz))
        self._integral = (ix, iy, iz)
        return level * wx + ix, level * wy + iy, upright * wz + iz

    def _limits(self) -> tuple[float, float]:
        """Return the limits on speed [m/s] and acceleration [m/s2] along the move's direction."""
        settings = self._settings
        ex, ey, ez = self._direction
        level, upright = math.hypot(ex, ey), abs(ez)
        vertical = settings.climb_limit_m_s if ez > 0 else settings.descent_limit_m_s
        speed, acceleration = math.inf, math.inf
        if level > 0:
            speed, acceleration = settings.speed_limit_m_s / level, settings.acceleration_limit_m_s2 / level
        if upright > 0:
            speed = min(speed, vertical / upright)
            acceleration = min(acceleration, settings.climb_acceleration_limit_m_s2 / upright)
        if level == upright == 0:
            return settings.speed_limit_m_s, settings.acceleration_limit_m_s2
        return speed, acceleration
