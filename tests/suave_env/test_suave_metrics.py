import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from suave_stand_ins import make_env

from suave_env import Settings
from suave_env.monitors import Violations
from suave_env.vehicle import Thrusters, floated

NOTES = st.lists(
    st.tuples(st.floats(0, 10), st.sampled_from("ab"), st.booleans(), st.booleans()), max_size=20
)


@given(NOTES)
def test_violation_time_is_the_length_of_the_union(notes):
    violations = Violations()
    now = 0.0
    expected = 0.0
    open_kinds = set()
    missed = 0
    for gap, kind, holds, corrected in notes:
        expected += gap if open_kinds else 0.0
        now += gap
        if kind in open_kinds and not holds:
            missed += not corrected
        open_kinds = open_kinds | {kind} if holds else open_kinds - {kind}
        violations.note(now, kind, holds, corrected)
        assert violations.seconds(now) == pytest.approx(expected)
        assert violations.uncorrected == missed + len(open_kinds)


def test_violations_last_until_they_are_seen_to():
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


def test_vehicle_floats_up_at_the_published_speed():
    assert floated(Settings(), 30.0) == pytest.approx(0.0615 * 30, rel=0.01)
    assert floated(Settings().replace(displaced_mass_kg=10.012), 30.0) == 0
    assert floated(Settings().replace(mass_kg=10.1), 30.0) < 0
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
