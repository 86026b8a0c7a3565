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
    """Return kinetic and potential energy [J]: of the moving bodies, of their weight and of their buoyancy."""
    model, data = vehicle.model, vehicle.data
    mujoco.mj_forward(model, data)
    mujoco.mj_energyVel(model, data)
    pull = -model.opt.gravity[2] * model.body_mass * (1 - model.body_gravcomp)
    return float(data.energy[1] + pull @ data.xipos[:, 2])


def body_velocity(vehicle):
    return vehicle.data.body("vehicle").xmat.reshape(3, 3).T @ vehicle.data.qvel[:3]


def test_neutral_vehicle_without_thrust_stays_put():
    vehicle = vehicle_of(NEUTRAL)
    before = vehicle.state[0]()
    for _ in range(2000):
        vehicle.push(IDLE)
    assert vehicle.state[0]() == pytest.approx(before, abs=1e-9)


@settings(max_examples=25, deadline=None)
@given(SPEEDS)
def test_energy_never_grows_without_thrust(motion):
    vehicle = vehicle_of(Settings().replace(**FINE), motion)
    energies = [energy_of(vehicle)]
    for _ in range(200):
        vehicle.push(IDLE)
        energies.append(energy_of(vehicle))
    # the integrator's own error: energy swings between tilt and rotation within each step
    assert max(np.diff(energies)) < 0.01


@settings(max_examples=25, deadline=None)
@given(SPEEDS)
def test_drag_alone_only_takes_motion_out_even_at_the_coarse_default_step(motion):
    vehicle = vehicle_of(Settings().replace(gravity_m_s2=0), motion)
    energies = [energy_of(vehicle)]
    for _ in range(200):
        vehicle.push(IDLE)
        energies.append(energy_of(vehicle))
    assert max(np.diff(energies)) < 1e-2 * max(energies[0], 1e-3)
    assert energies[-1] <= energies[0]


@settings(max_examples=20, deadline=None)
@given(st.floats(1, 25), st.sampled_from(["surge", "sway", "heave"]))
def test_terminal_speed_under_constant_thrust_is_that_of_the_drag_law(thrust, axis):
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


def test_speed_decays_as_quadratic_drag_says():
    # m dv/dt = -D v^2 has the solution v0 / (1 + D v0 t / m)
    vehicle = vehicle_of(NEUTRAL.replace(**FINE, gravity_m_s2=0), (1, 0, 0, 0, 0, 0))
    vehicle.data.qvel[:3] = (1, 0, 0)
    for _ in range(200):
        vehicle.push(IDLE)
    assert body_velocity(vehicle)[0] == pytest.approx(1 / (1 + 33.732 * 2 / 10.012), rel=0.01)


def test_idle_vehicle_rises_as_fast_as_the_published_buoyancy_and_drag_say():
    vehicle = vehicle_of(Settings())
    for _ in range(4000):
        vehicle.push(IDLE)
    assert vehicle.velocity[2] == pytest.approx(0.0615, abs=0.001)


def test_tilted_vehicle_rights_itself():
    vehicle = vehicle_of(Settings())
    vehicle.data.qpos[3:] = (math.cos(0.3), math.sin(0.3), 0, 0)
    tilts = []
    for _ in range(1600):
        vehicle.push(IDLE)
        tilts.append(abs(2 * math.asin(vehicle.state[0]()[4])))
    assert min(tilts[:100]) < 0.05
    assert max(tilts[-80:]) < 0.3 * tilts[0]


def test_the_packaged_model_holds_the_default_settings_and_the_pipeline():
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


def test_settings_reach_the_model():
    chosen = Settings().replace(
        mass_kg=12, drag_sway=60, thrust_limit_n=30, centre_of_buoyancy_z_m=0.1, gravity_m_s2=9.0
    )
    model = Vehicle(chosen, 0.0, 0.0, -10.0).model
    assert model.body_mass.sum() == pytest.approx(12)
    assert model.actuator("drag_sway").gainprm[2] == -60
    assert model.actuator("thruster_3").ctrlrange.tolist() == [-30, 30]
    assert model.body("buoyancy").pos[2] == 0.1
    assert model.opt.gravity[2] == -9.0


def test_a_body_that_cannot_be_is_refused():
    with pytest.raises(SuaveEnvError, match="MuJoCo refuses"):
        Vehicle(Settings().replace(inertia_yaw_kg_m2=50.0), 0.0, 0.0, -10.0)
