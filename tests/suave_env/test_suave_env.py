import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from suave_stand_ins import Script, make_env, values_of

QUIET = {"thruster_events": "", "battery": False}


def test_env_same_seed_gives_the_same_floats():
    runs = [Script(make_env(seed)).run(60) for seed in (7, 7, 8)]
    assert len(runs[0].messages) > 100
    assert runs[0].messages == runs[1].messages
    assert runs[0].env.observe() == runs[1].env.observe()
    assert runs[0].messages != runs[2].messages
    assert runs[0].env.observe() != runs[2].env.observe()


@settings(max_examples=10, deadline=None)
@given(st.lists(st.floats(0, 40), max_size=30))
def test_env_sliced_time_changes_nothing(stops):
    whole = make_env(3)
    sliced = make_env(3)
    for env in (whole, sliced):
        env.components.activate("spiral_search")
    expected = whole.advance(40.0)
    heard = [message for stop in [*sorted(stops), 40.0] for message in sliced.advance(stop)]
    assert heard == expected
    assert sliced.observe() == whole.observe()


def test_messages_are_plain_data_in_order_of_time():
    env = make_env(0)
    before = 0.0
    count = 0
    for until in np.arange(0.5, 50, 0.5):
        heard = env.advance(float(until))
        times = [message["time"] for message in heard]
        assert times == sorted(times)
        assert all(before < time <= until for time in times)
        for message in heard:
            assert set(message) == {"time", "status"}
            for status in message["status"]:
                assert set(status) == {"name", "message", "values"}
                assert all(isinstance(value, str) for value in status["values"].values())
        before = until
        count = count + len(heard)
    assert count > 90
    assert env.now == 49.5


def test_disturbances_have_the_crossings_of_visibility():
    env = make_env(0, **QUIET)
    assert env.disturbances == []
    env.advance(80.0)
    told = [(round(time, 2), text) for time, text in env.disturbances]
    assert told == [
        (11.81, "water visibility fell below 3.25 m"),
        (22.56, "water visibility fell below 2.25 m"),
        (57.44, "water visibility rose to 2.25 m"),
        (68.19, "water visibility rose to 3.25 m"),
    ]
    env.disturbances.clear()
    assert len(env.disturbances) == 4


@pytest.mark.parametrize("seed", [0, 3, 11])
def test_mission_searches_finds_recharges_and_goes_on(seed):
    env = make_env(seed)
    script = Script(env).run(300)
    recharged = values_of(script.messages, "battery_recharged")
    assert len(recharged) == 1 == env.observe().recharged
    levels = values_of(script.messages, "battery_level")
    index = levels.index((recharged[0][0], "1.0"))
    assert float(levels[index - 1][1]) < 0.25
    order = [
        list(message["status"][0]["values"])
        for message in script.messages
        if message["time"] == recharged[0][0]
    ]
    assert order.index(["battery_level"]) < order.index(["battery_recharged"])
    metrics = env.metrics
    assert values_of(script.messages, "pipeline_found") == [(metrics.found_s, "true")]
    assert 0 < metrics.distance_inspected_m <= metrics.total_inspected_m
    published = [float(value) for _, value in values_of(script.messages, "distance_inspected")]
    assert published[-1] == metrics.distance_inspected_m
    if metrics.search_time_s < 145:
        assert metrics.distance_inspected_m < metrics.total_inspected_m
        assert max(np.diff(published)) < 3
        assert min(np.diff(published)) < 0
    assert env.observe().thrusters_failed == ()
