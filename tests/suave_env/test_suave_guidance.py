import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from suave_env import Settings
from suave_env.vehicle import Guidance, SCurve, Thrusters, Vehicle

MOVES = st.tuples(st.floats(1e-3, 60), st.floats(0.1, 3), st.floats(0.1, 3), st.floats(0.1, 3))


@given(MOVES)
def test_a_move_starts_and_ends_at_rest_and_keeps_its_limits(move):
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


@given(MOVES, st.floats(1.1, 3))
def test_a_move_takes_no_longer_when_a_limit_is_relaxed(move, factor):
    length, speed, acceleration, jerk = move
    slow = SCurve(length, speed, acceleration, jerk).duration * (1 + 1e-9)
    assert SCurve(length, speed * factor, acceleration, jerk).duration <= slow
    assert SCurve(length, speed, acceleration * factor, jerk).duration <= slow
    assert SCurve(length, speed, acceleration, jerk * factor).duration <= slow


def test_a_long_move_takes_as_long_as_computed_by_hand():
    # peak 1 m/s at jerk 0.5: ramps of sqrt(2) s, speed-up 2 sqrt(2) s; 10 m at 1 m/s plus half of each of the two
    assert SCurve(10, 1, 2.5, 0.5).duration == pytest.approx(10 + 2 * math.sqrt(2))


def test_a_move_of_no_length_is_over_at_once():
    curve = SCurve(0.0, 1, 1, 1)
    assert curve.duration == 0
    assert curve.at(0.5) == (0.0, 0.0)


def test_at_rest_at_the_setpoint_no_force_is_wanted():
    guidance = Guidance(Settings(), (1.0, 2.0, -18.0))
    assert guidance.force([1.0, 2.0, -18.0], [0.0, 0.0, 0.0], 5.0, 0.025) == (0, 0, 0)


def test_a_new_setpoint_does_not_jerk_the_wanted_velocity():
    # v_wanted = k (p + v / k - p) = v, hence no force, whatever the new setpoint
    guidance = Guidance(Settings(), (0.0, 0.0, -18.0))
    position, velocity = (0.3, -0.2, -18.1), (0.4, 0.1, 0.2)
    guidance.go_to((5.0, 5.0, -17.0), position, velocity, 3.0)
    assert guidance.force(list(position), list(velocity), 3.0, 0.025) == pytest.approx(
        (0, 0, 0), abs=1e-9
    )


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_lasting_error_is_worked_against_ever_harder_up_to_a_limit(axis):
    settings = Settings().replace(integral_gain=5, integral_limit_n=20)
    guidance = Guidance(settings, (0.0, 0.0, -18.0))
    position = [0.0, 0.0, -18.0]
    position[axis] -= 0.1
    forces = [guidance.force(position, [0.0, 0.0, 0.0], 1.0, 0.5)[axis] for _ in range(200)]
    wanted = 0.1 * (settings.height_gain if axis == 2 else settings.position_gain)
    assert forces[1] - forces[0] == pytest.approx(5 * wanted * 0.5)
    assert forces[-1] - forces[0] == pytest.approx(20 - 5 * wanted * 0.5)


def test_climbing_and_diving_have_limits_of_their_own():
    settings = Settings().replace(
        climb_limit_m_s=0.5, descent_limit_m_s=0.2, jerk_limit_m_s3=10, integral_gain=0
    )
    speeds = []
    for height in (-8.0, -18.0):
        guidance = Guidance(settings, (0.0, 0.0, -13.0))
        guidance.go_to((0.0, 0.0, height), (0.0, 0.0, -13.0), (0.0, 0.0, 0.0), 0.0)
        ahead = [guidance._move.at(time)[1] for time in np.linspace(0, 5, 100)]
        speeds.append(max(ahead))
    assert speeds == pytest.approx([0.5, 0.2])


@given(st.lists(st.floats(-8, 8), min_size=5, max_size=5))
def test_thrusters_in_the_model_make_the_force_that_was_wanted(wanted):
    forward, left, up, roll, turn = wanted[0], wanted[1], wanted[2], wanted[3] / 8, wanted[4] / 8
    outputs = Thrusters(Settings()).allocate(forward, left, up, roll, turn)
    model = Vehicle(Settings(), 0.0, 0.0, -10.0).model
    force, torque = np.zeros(3), np.zeros(3)
    for number, output in enumerate(outputs, start=1):
        push = model.actuator(f"thruster_{number}").gear[:3] * output
        force += push
        torque += np.cross(model.site(f"thruster_{number}").pos, push)
    np.testing.assert_allclose(force, (forward, left, up), atol=1e-6)
    # the front and rear arms differ by 4 %, which the mixer of ArduPilot does not know
    np.testing.assert_allclose(
        torque[[0, 2]], (roll, turn), atol=1e-6 + 0.006 * abs(left) + 0.01 * abs(turn)
    )


@given(st.lists(st.floats(-500, 500), min_size=5, max_size=5))
def test_no_output_exceeds_the_limit(wanted):
    outputs = Thrusters(Settings()).allocate(*wanted)
    assert len(outputs) == 6
    assert max(abs(output) for output in outputs) <= 50 * (1 + 1e-12)


def test_beyond_the_limit_the_direction_stays():
    outputs = Thrusters(Settings()).allocate(300.0, 150.0, 0.0, 0.0, 0.0)
    weak = Thrusters(Settings()).allocate(30.0, 15.0, 0.0, 0.0, 0.0)
    assert max(map(abs, outputs)) == pytest.approx(50)
    np.testing.assert_allclose(np.array(outputs) / 50, np.array(weak) / max(map(abs, weak)))


def test_a_failed_thruster_is_frozen_at_its_last_output_until_it_recovers():
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


def test_failing_twice_changes_nothing():
    thrusters = Thrusters(Settings())
    frozen = thrusters.allocate(10.0, 0.0, 0.0, 0.0, 0.0)[2]
    thrusters.fail(3)
    thrusters.allocate(-10.0, 0.0, 0.0, 0.0, 0.0)
    thrusters.fail(3)
    assert thrusters.allocate(0.0, 0.0, 0.0, 0.0, 0.0)[2] == frozen
