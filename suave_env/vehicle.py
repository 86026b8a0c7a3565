"""The BlueROV2 in the water, simulated by MuJoCo. This is the only file of the package that uses MuJoCo."""

import logging
import math
from collections.abc import Callable
from importlib.resources import files
from struct import Struct
from typing import Any

import numpy as np

from suave_env.settings import Settings, SuaveEnvError
from suave_env.thrusters import COUNT

_log = logging.getLogger(__name__)
_UNUSED = ("EQUALITY", "FRICTIONLOSS", "LIMIT", "SENSOR", "ISLAND", "AUTORESET")  # the last: what is lost stays lost
_WRITE_THRUSTS = Struct(f"{COUNT}d").pack_into  # a third of the time that a slice of the array takes
_FLOAT_MASS_KG = 0.001  # of the body that carries the buoyancy, see assets/sea.xml


class Vehicle:
    """A rigid body with six thrusters, buoyancy at the centre of buoyancy and quadratic drag along and about its axes.

    Drag along each body axis is `-D |v| v` without added mass or linear damping, as in clydemcqueen/bluerov2_ignition.
    It is an actuator whose force is `-D v ctrl`, with `ctrl = |v|` at the start of a control period: MuJoCo treats `v`
    implicitly, so drag can only take energy out.

    Args:
        settings: Mass, inertia, buoyancy, drag, thrust limit and the physics step.
        x, y, z: Start position [m], world frame ENU, z up.

    Attributes:
        state: Two functions: of position [m] and quaternion (w, x, y, z), (7,), and of velocity [m/s] and angular
            velocity [rad/s], (6,), the last in the body frame, x forward, y left, all others in the world frame ENU, z
            up; for loops in which an attribute costs too much.
    """

    def __init__(self, settings: Settings, x: float, y: float, z: float) -> None:
        import mujoco  # takes long, and settings do not need it

        # MuJoCo's own handler prints, and writes a file into the working directory; the autopilot raises what matters
        mujoco.set_mju_user_warning(_log.debug)
        self.model: Any = _compiled(mujoco, settings)
        for name in _UNUSED:
            self.model.opt.disableflags |= getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}")
        self.data: Any = mujoco.MjData(self.model)
        self._substeps = round(settings.control_period_s / settings.physics_step_s)
        self._step = mujoco.mj_step
        self._qpos, self._qvel = self.data.qpos, self.data.qvel
        self._ctrl, self._flow = self.data.ctrl, self.data.ctrl[COUNT:]
        self._body_velocity = self.data.actuator_velocity[COUNT:]
        self.state: tuple[Callable[[], list[float]], Callable[[], list[float]]] = self._qpos.tolist, self._qvel.tolist
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
        _WRITE_THRUSTS(self._ctrl, 0, *thrusts)
        np.abs(self._body_velocity, self._flow)
        self._step(self.model, self.data, self._substeps)


def floated(settings: Settings) -> float:
    """Return how far the vehicle, which is lighter than water, rises by itself before GUIDED [m].

    It rises at the speed at which drag equals the surplus of buoyancy, which it reaches within a second.
    """
    surplus = (settings.displaced_mass_kg - settings.mass_kg) * settings.gravity_m_s2
    speed = math.copysign(math.sqrt(abs(surplus) / settings.drag_heave), surplus) if settings.drag_heave else 0.0
    return speed * settings.boot_s


def _compiled(mujoco: Any, settings: Settings) -> Any:  # noqa: ANN401 - MuJoCo ships no types
    """Compile the packaged model with the figures of the settings in it."""
    spec = mujoco.MjSpec.from_string((files("suave_env") / "assets" / "sea.xml").read_text(encoding="utf-8"))
    spec.option.timestep = settings.physics_step_s
    spec.option.gravity = (0, 0, -settings.gravity_m_s2)
    hull, buoyancy = spec.body("vehicle"), spec.body("buoyancy")
    hull.mass = settings.mass_kg - _FLOAT_MASS_KG
    hull.inertia = (settings.inertia_roll_kg_m2, settings.inertia_pitch_kg_m2, settings.inertia_yaw_kg_m2)
    hull.ipos = (0, 0, settings.centre_of_mass_z_m)
    spec.site("centre_of_mass").pos = (0, 0, settings.centre_of_mass_z_m)
    buoyancy.gravcomp = settings.displaced_mass_kg / _FLOAT_MASS_KG
    buoyancy.pos = (0, 0, settings.centre_of_buoyancy_z_m)
    for number in range(1, COUNT + 1):
        spec.actuator(f"thruster_{number}").ctrlrange = (-settings.thrust_limit_n, settings.thrust_limit_n)
    for axis in ("surge", "sway", "heave", "roll", "pitch", "yaw"):
        spec.actuator(f"drag_{axis}").gainprm[2] = -getattr(settings, f"drag_{axis}")
    try:
        return spec.compile()
    except ValueError as error:
        raise SuaveEnvError(f"MuJoCo refuses the vehicle of these settings: {error}") from error
