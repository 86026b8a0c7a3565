import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from suave_stand_ins import altitude_for

from suave_env import Settings
from suave_env.components import Agenda
from suave_env.sea import Pipeline, Water

# From which integer second on which altitude [m] is expected: the published schedule for the period
# of 80 s
SCHEDULE = {0: 3, 12: 2, 23: 1, 58: 2, 69: 3, 92: 2, 103: 1, 138: 2, 149: 3, 172: 2, 183: 1}


def test_visibility_follows_the_published_schedule():
    water = Water(Settings())
    expected = [
        SCHEDULE[max(start for start in SCHEDULE if start <= second)] for second in range(218)
    ]
    assert [altitude_for(water.visibility(second)) for second in range(218)] == expected


@given(st.floats(1.3, 3.7), st.floats(0, 400), st.floats(-100, 100), st.floats(20, 200))
def test_crossing_is_where_the_threshold_is_passed_next(threshold, after, shift, period):
    water = Water(Settings().replace(visibility_shift_s=shift, visibility_period_s=period))
    time, falls = water.next_crossing(threshold, after)
    assert after < time <= after + period * (1 + 1e-6)
    assert water.visibility(time) == pytest.approx(threshold, abs=1e-6)
    assert (water.visibility(time + 1e-3 * period) < threshold) == falls
    between = np.linspace(after + 1e-4, time - 1e-4, 50) if time - after > 1e-3 else []
    assert len({water.visibility(moment) < threshold for moment in between}) <= 1


def test_water_that_is_constant_never_crosses():
    water = Water(Settings().replace(visibility_min_m=2.5, visibility_max_m=2.5))
    assert water.visibility(33.0) == 2.5
    assert water.next_crossing(2.25, 0.0) is None
    assert water.next_crossing(2.5, 0.0) is None


def test_pipeline_has_the_published_points():
    points = np.array(Pipeline(Settings()).points)
    assert points.shape == (100, 2)
    published = {
        0: (-15.5, 0),
        39: (-35, 0),
        40: (-35.1205, -0.05),
        59: (-37.41, -1),
        79: (-44.49, -8.07),
        99: (-51.56, -15.14),
    }
    for index, point in published.items():
        assert points[index] == pytest.approx(point), index
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).sum() == pytest.approx(42.113, abs=1e-3)


@given(st.floats(-55, -12), st.floats(-17, 3), st.floats(-19.2, -14), st.floats(0.1, 5))
def test_camera_sees_the_point_of_a_plain_reading(x, y, z, visibility):
    pipeline = Pipeline(Settings())
    height = abs(z + 19.25)
    half = height * math.tan(math.radians(30))
    near = np.abs(np.array(pipeline.points) - (x, y)).max(axis=1) <= half
    expected = int(np.flatnonzero(near)[0]) if near.any() and height <= visibility else None
    assert pipeline.first_visible(x, y, z, visibility) == expected


def test_agenda_is_in_order_of_time_then_of_entry():
    agenda = Agenda()
    happened = []
    for time, name in ((2.0, "b"), (1.0, "a"), (2.0, "c")):
        agenda.at(time, lambda time, name=name: happened.append((time, name)))
    while agenda.next_time < math.inf:
        agenda.happen()
    assert happened == [(1.0, "a"), (2.0, "b"), (2.0, "c")]
