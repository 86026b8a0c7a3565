import math
from importlib.resources import files
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from suave_env import Settings, SuaveEnvError
from suave_env.sea import SEABED_Z_M, VERTICES_M
from suave_env.vehicle import Vehicle

IDLE = [0.0] * 6
NEUTRAL = Settings().replace(displaced_mass_kg=10.012)
FINE = {"physics_step_s": 0.001, "control_period_s": 0.01}
SPEEDS = st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6)


def vehicle_of(chosen, motion=(0, 0, 0, 0, 0, 0)):
    vehicle = Vehicle(chosen, -17.0, 2.0, -10.0)
    vehicle.data.qvel[:] = motion
    mujoco.mj_forward(vehicle.model, vehicle.data)
    return vehicle


def energy_of(vehicle):
    """Return kinetic and potential energy [J].

    Of the moving bodies, of their weight and of their buoyancy.
    """
    model = vehicle.model
    data = vehicle.data
    mujoco.mj_forward(model, data)
    mujoco.mj_energyVel(model, data)
    pull = -model.opt.gravity[2] * model.body_mass * (1 - model.body_gravcomp)
    return float(data.energy[1] + pull @ data.xipos[:, 2])


def body_velocity(vehicle):
    return vehicle.data.body("vehicle").xmat.reshape(3, 3).T @ vehicle.data.qvel[:3]


def test_vehicle_neutral_without_thrust_stays_put():
    vehicle = vehicle_of(NEUTRAL)
    before = vehicle.state[0]()
    for _ in range(2000):
        vehicle.push(IDLE)
    assert vehicle.state[0]() == pytest.approx(before, abs=1e-9)


@settings(max_examples=25, deadline=None)
@given(SPEEDS)
def test_energy_without_thrust_never_grows(motion):
    vehicle = vehicle_of(Settings().replace(**FINE), motion)
    energies = [energy_of(vehicle)]
    for _ in range(200):
        vehicle.push(IDLE)
        energies.append(energy_of(vehicle))
    # the integrator's own error: energy swings between tilt and rotation within each step
    assert max(np.diff(energies)) < 0.01


@settings(max_examples=20, deadline=None)
@given(st.floats(1, 25), st.sampled_from(["surge", "sway", "heave"]))
def test_terminal_speed_is_that_of_the_drag_law(thrust, axis):
    signs, share, row = {
        "surge": ((-1, -1, 1, 1, 0, 0), 4 * math.sqrt(0.5), 0),
        "sway": ((-1, 1, -1, 1, 0, 0), 4 * math.sqrt(0.5), 1),
        "heave": ((0, 0, 0, 0, -1, -1), 2, 2),
    }[axis]
    # the unequal arms of the thrusters turn the vehicle, which is not what is tried here
    chosen = NEUTRAL.replace(drag_yaw=1e6)
    vehicle = vehicle_of(chosen)
    for _ in range(1200):
        vehicle.push([sign * thrust for sign in signs])
        if vehicle.position[2] > -1:
            break
    drag = getattr(chosen, f"drag_{axis}")
    assert body_velocity(vehicle)[row] == pytest.approx(math.sqrt(share * thrust / drag), rel=2e-3)


def test_packaged_model_has_the_default_settings():
    plain = mujoco.MjModel.from_xml_string(
        (files("suave_env") / "assets" / "sea.xml").read_text(encoding="utf-8")
    )
    filled = Vehicle(Settings(), -17.0, 2.0, -18.5).model
    for name in (
        "body_mass",
        "body_inertia",
        "body_ipos",
        "body_gravcomp",
        "actuator_gainprm",
        "actuator_ctrlrange",
    ):
        np.testing.assert_allclose(
            getattr(filled, name), getattr(plain, name), rtol=1e-12, err_msg=name
        )
    assert plain.geom("seabed").pos[2] == SEABED_Z_M
    middles = [plain.geom(f"pipe_{number}").pos[:2] for number in range(1, 6)]
    expected = [np.add(a, b) / 2 for a, b in pairwise(VERTICES_M)]
    np.testing.assert_allclose(middles, expected)


def test_vehicle_that_cannot_be_is_refused():
    with pytest.raises(SuaveEnvError, match="MuJoCo refuses"):
        Vehicle(Settings().replace(inertia_yaw_kg_m2=50.0), 0.0, 0.0, -10.0)
