import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from suave_env import Settings
from suave_env.vehicle import SCurve, Thrusters, Vehicle

MOVES = st.tuples(st.floats(1e-3, 60), st.floats(0.1, 3), st.floats(0.1, 3), st.floats(0.1, 3))


@given(MOVES)
def test_move_ends_at_rest_and_keeps_its_limits(move):
    length, speed, acceleration, jerk = move
    curve = SCurve(length, speed, acceleration, jerk)
    times = np.linspace(0, curve.duration, 4001)
    step = times[1]
    along, fast = np.array([curve.at(time) for time in times]).T
    assert (along[0], fast[0]) == (0, 0)
    assert along[-1] == pytest.approx(length)
    assert fast[-1] == 0
    assert np.diff(along).min() >= -1e-9 * length
    assert fast.max() <= speed * (1 + 1e-9)
    gain = np.diff(fast) / step
    assert np.abs(gain).max() <= acceleration * (1 + 1e-6) + 1e-9
    assert np.abs(np.diff(gain) / step).max() <= jerk * (1 + 1e-3) + 1e-6
    np.testing.assert_allclose(
        np.cumsum((fast[1:] + fast[:-1]) / 2 * step), along[1:], atol=1e-4 * length
    )


@given(st.lists(st.floats(-8, 8), min_size=5, max_size=5))
def test_thrusters_make_the_wanted_force(wanted):
    forward = wanted[0]
    left = wanted[1]
    up = wanted[2]
    roll = wanted[3] / 8
    turn = wanted[4] / 8
    outputs = Thrusters(Settings()).allocate(forward, left, up, roll, turn)
    model = Vehicle(Settings(), 0.0, 0.0, -10.0).model
    force = np.zeros(3)
    torque = np.zeros(3)
    for number, output in enumerate(outputs, start=1):
        push = model.actuator(f"thruster_{number}").gear[:3] * output
        force += push
        torque += np.cross(model.site(f"thruster_{number}").pos, push)
    np.testing.assert_allclose(force, (forward, left, up), atol=1e-6)
    # the front and rear arms differ by 4 %, which the mixer of ArduPilot does not know
    np.testing.assert_allclose(
        torque[[0, 2]], (roll, turn), atol=1e-6 + 0.006 * abs(left) + 0.01 * abs(turn)
    )


def test_thruster_that_failed_is_frozen_until_it_recovers():
    thrusters = Thrusters(Settings())
    before = thrusters.allocate(10.0, 4.0, -6.0, 0.1, 0.2)[0]
    thrusters.fail(1)
    after = thrusters.allocate(-20.0, 0.0, 5.0, 0.0, 0.0)
    assert before != 0
    assert after[0] == before
    assert after[1] == Thrusters(Settings()).allocate(-20.0, 0.0, 5.0, 0.0, 0.0)[1]
    assert thrusters.failed == (1,)
    thrusters.recover(1)
    assert thrusters.allocate(-20.0, 0.0, 5.0, 0.0, 0.0)[0] != before
    assert thrusters.failed == ()
