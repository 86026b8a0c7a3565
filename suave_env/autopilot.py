"""The loop that flies the vehicle: setpoint, wanted force, thrusts, physics, at the control period."""

import math

from suave_env.exceptions import SuaveEnvError
from suave_env.guidance import Guidance, Vector
from suave_env.settings import Settings
from suave_env.thrusters import Thrusters
from suave_env.vehicle import Vehicle, yaw_of

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
        self._settings = settings
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
        x, y, z = self._vehicle.position
        vx, vy, vz = self._vehicle.velocity
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
        period, settings = self._period, self._settings
        self._until, last = until, math.floor(until / period + 1e-9)
        if last <= self._periods:
            return
        vehicle, thrusters, force = self._vehicle, self._thrusters, self._guidance.force
        heading_gain, heading_damping = settings.heading_gain, settings.heading_damping
        roll_damping = settings.roll_damping
        surge_drag, sway_drag, heave_drag = settings.drag_surge, settings.drag_sway, settings.drag_heave
        for count in range(self._periods, last):
            pose, motion = vehicle.pose, vehicle.motion
            if not math.isfinite(pose[0] + motion[0]):
                raise SuaveEnvError(
                    f"the simulation became unstable after {count * period:.3f} s; a setting is far from its default"
                )
            east, north, up = force(pose, motion, (count + 0.5) * period, period)
            yaw = yaw_of(pose[3:])
            cosine, sine = math.cos(yaw), math.sin(yaw)
            turn = -heading_gain * yaw - heading_damping * motion[5]
            surge, sway, heave = cosine * motion[0] + sine * motion[1], cosine * motion[1] - sine * motion[0], motion[2]
            forward = cosine * east + sine * north + surge_drag * abs(surge) * surge
            left = cosine * north - sine * east + sway_drag * abs(sway) * sway
            up += heave_drag * abs(heave) * heave
            vehicle.push(thrusters.allocate(forward, left, up, -roll_damping * motion[3], turn))
            thrusters.work(period)
        self._periods = last
