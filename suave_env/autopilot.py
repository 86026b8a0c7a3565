"""The loop that flies the vehicle: setpoint, wanted force, thrusts, physics, at the control period."""

import math
from math import atan2, cos, isfinite, sin

from suave_env.exceptions import SuaveEnvError
from suave_env.guidance import Guidance, Vector
from suave_env.settings import Settings
from suave_env.thrusters import Thrusters
from suave_env.vehicle import Vehicle

__all__ = ["Autopilot"]


class Autopilot:
    """Holds a heading of east and flies to setpoints.

    Args:
        settings: Gains and the control period.
        vehicle: What is flown.
        thrusters: What it is flown with.
        bias: True minus commanded height [m].
    """

    def __init__(self, settings: Settings, vehicle: Vehicle, thrusters: Thrusters, bias: float) -> None:
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
        """Where the vehicle is [m], world frame ENU, z up; between two control periods it goes on as it was going."""
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
        """Come to rest where that is soonest, from now [s] on."""
        position, velocity = self.position, self._vehicle.velocity
        self._guidance.go_to(self._guidance.stopping_point(position, velocity), position, velocity, time)

    def fly(self, until: float) -> None:
        """Simulate all control periods that end by a time [s]."""
        self._until, last = until, math.floor(until / self._period + 1e-9)
        if last > self._periods:
            self._fly_periods(last)
            self._periods = last

    def _fly_periods(self, last: int) -> None:
        period, guide, push = self._period, self._guidance.force, self._vehicle.push
        allocate, work = self._thrusters.allocate, self._thrusters.work
        pose_of, motion_of = self._vehicle.state
        heading_gain, heading_damping, roll_damping, surge_drag, sway_drag, heave_drag = self._gains
        for count in range(self._periods, last):
            pose, motion = pose_of(), motion_of()
            x, _, _, qw, qx, qy, qz = pose
            vx, vy, vz, roll_rate, _, yaw_rate = motion
            if not isfinite(x + vx):
                raise SuaveEnvError(
                    f"the simulation became unstable after {count * period:.3f} s; a setting is far from its default"
                )
            east, north, up = guide(pose, motion, (count + 0.5) * period, period)
            yaw = atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
            cosine, sine = cos(yaw), sin(yaw)
            surge, sway = cosine * vx + sine * vy, cosine * vy - sine * vx
            push(
                allocate(
                    cosine * east + sine * north + surge_drag * abs(surge) * surge,
                    cosine * north - sine * east + sway_drag * abs(sway) * sway,
                    up + heave_drag * abs(vz) * vz,
                    -roll_damping * roll_rate,
                    -heading_gain * yaw - heading_damping * yaw_rate,
                )
            )
            work(period)
