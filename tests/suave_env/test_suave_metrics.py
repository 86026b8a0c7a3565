import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from suave_stand_ins import Script, make_env

from suave_env import Settings
from suave_env.monitors import Violations
from suave_env.vehicle import Thrusters, floated

NOTES = st.lists(
    st.tuples(st.floats(0, 10), st.sampled_from("ab"), st.booleans(), st.booleans()), max_size=20
)


@given(NOTES)
def test_time_in_violation_is_the_length_of_the_union(notes):
    violations, now, expected = Violations(), 0.0, 0.0
    held, missed = set(), 0
    for gap, kind, holds, corrected in notes:
        expected += gap if held else 0.0
        now += gap
        if kind in held and not holds:
            missed += not corrected
        held = held | {kind} if holds else held - {kind}
        violations.note(now, kind, holds, corrected)
        assert violations.seconds(now) == pytest.approx(expected)
        assert violations.uncorrected == missed + len(held)


def test_an_adaptive_search_is_in_violation_for_a_moment_and_a_steady_one_for_long():
    changed = {"battery": False, "thruster_events": "", "start_y_m": 4.0}
    adaptive, steady = (
        Script(make_env(1, **changed), adaptive=kind).run(100).env.metrics for kind in (True, False)
    )
    assert 0 < adaptive.violation_s < 8
    assert adaptive.uncorrected == 0
    # at 2 m all the time, which is right from 12 to 22 s, 58 to 68 s and 92 to 102 s
    assert steady.violation_s == pytest.approx(100 - 10.75 - 10.75 - 8.2, abs=0.5)
    assert steady.uncorrected > 2


def test_a_stuck_thruster_and_an_empty_battery_are_violations_until_they_are_seen_to():
    env = make_env(2, discharge_time_s=40, thruster_events="2 failure 5")
    env.advance(10.0)
    assert env.metrics.violation_s == pytest.approx(5.0)
    env.components.activate("recover_thrusters")
    env.advance(29.0)
    stuck_s = env.metrics.violation_s
    assert stuck_s == pytest.approx(15.0 + 0.25)
    assert env.metrics.uncorrected == 0
    env.advance(60.0)
    assert env.metrics.uncorrected == 1
    env.components.activate("recharge")
    env.advance(61.0)
    assert env.metrics.uncorrected == 0
    assert env.metrics.violation_s - stuck_s == pytest.approx(60.0 - 30.5, abs=0.6)


def test_only_what_changes_something_counts_as_a_switch():
    env = make_env(0)
    for _ in range(3):
        env.components.activate("spiral_search")
        env.components.set_parameters("spiral_search", {"spiral_altitude": 3.0})
    env.advance(1.0)
    assert env.metrics.switches == 2
    assert [(change.component, change.active) for change in env.components.history] == [
        ("spiral_search", True)
    ] * 2
    assert [change.parameters["spiral_altitude"] for change in env.components.history] == [2.0, 3.0]


@given(
    st.lists(st.floats(-50, 50), min_size=5, max_size=5),
    st.floats(0, 10),
    st.sampled_from([(), (1, 3)]),
)
def test_energy_is_what_an_ideal_propeller_takes(wanted, duration, stuck):
    thrusters = Thrusters(Settings())
    thrusters.allocate(30.0, -10.0, 4.0, 1.0, 0.5)
    for number in stuck:
        thrusters.fail(number)
    thrusts = thrusters.allocate(*wanted, duration)
    area = math.pi / 4 * 0.076**2
    expected = sum(abs(thrust) ** 1.5 for thrust in thrusts) / math.sqrt(2 * 1000 * area) * duration
    assert thrusters.energy_j == pytest.approx(expected)


def test_search_time_is_in_whole_seconds_of_a_clock_that_starts_up_to_a_second_late():
    lags = set()
    for seed in range(5):
        metrics = Script(make_env(seed, battery=False)).run(200).env.metrics
        assert isinstance(metrics.search_time_s, int)
        assert -1e-9 <= metrics.found_s - metrics.search_time_s < 2
        lags.add(round(metrics.found_s - metrics.search_time_s, 3))
    assert len(lags) == 5


def test_the_vehicle_floats_up_at_the_published_speed_until_it_obeys():
    assert floated(Settings()) == pytest.approx(0.0615 * 30, rel=0.01)
    assert floated(Settings().replace(displaced_mass_kg=10.012)) == 0
    assert floated(Settings().replace(mass_kg=10.1)) < 0
    assert make_env(0).observe().z == pytest.approx(-18.5 + 0.0615 * 30, abs=0.02)


@pytest.mark.parametrize("rules", ["2024", "2025"])
def test_thruster_words_are_those_of_the_rules(rules):
    env = make_env(0, rules=rules, thruster_events="3 failure 2")
    env.components.activate("recover_thrusters")
    heard = env.advance(12.0)
    words = [
        v["c_thruster_3"]
        for m in heard
        for s in m["status"]
        if "c_thruster_3" in (v := s["values"])
    ]
    assert words == (
        ["FALSE", "RECOVERED"] if rules == "2024" else ["FALSE", "ERROR", "RECOVERED", "OK"]
    )
