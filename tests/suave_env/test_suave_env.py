import math
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from suave_stand_ins import Script, make_env, values_of

from suave_env import Settings, SuaveEnv, SuaveEnvError

QUIET = {"thruster_events": "", "battery": False}


def test_the_same_seed_gives_the_same_floats_and_another_seed_others():
    runs = [Script(make_env(seed)).run(60) for seed in (7, 7, 8)]
    assert len(runs[0].messages) > 100
    assert runs[0].messages == runs[1].messages
    assert runs[0].env.observe() == runs[1].env.observe()
    assert runs[0].messages != runs[2].messages
    assert runs[0].env.observe() != runs[2].env.observe()


@settings(max_examples=10, deadline=None)
@given(st.lists(st.floats(0, 40), max_size=30))
def test_how_time_is_sliced_changes_nothing(stops):
    whole, sliced = make_env(3), make_env(3)
    for env in (whole, sliced):
        env.components.activate("spiral_search")
    expected = whole.advance(40.0)
    heard = [message for stop in [*sorted(stops), 40.0] for message in sliced.advance(stop)]
    assert heard == expected
    assert sliced.observe() == whole.observe()


def test_messages_are_plain_data_within_the_time_asked_for_and_in_order():
    env = make_env(0)
    before, count = 0.0, 0
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
        before, count = until, count + len(heard)
    assert count > 90
    assert env.now == 49.5


def test_visibility_is_published_every_second_at_whole_seconds_of_its_formula():
    env = make_env(1)
    heard = values_of(env.advance(41.0), "water_visibility")
    assert len(heard) == 41
    assert np.diff([time for time, _ in heard]) == pytest.approx(1.0)
    expected = [1.25 * math.cos(2 * math.pi * second / 80) + 2.5 for second in range(41)]
    assert [float(value) for _, value in heard] == pytest.approx(expected)


def test_battery_falls_below_a_quarter_after_150_steps_and_never_below_empty():
    env = make_env(2)
    heard = values_of(env.advance(210.0), "battery_level")
    assert float(heard[0][1]) == 1.0
    low = [(time, value) for time, value in heard if float(value) < 0.25]
    assert low[0] == (heard[150][0], "0.24999999999999933")
    assert 150 <= low[0][0] < 151
    assert (low[0][0], "battery level fell below 0.25") in env.disturbances
    assert {float(value) for _, value in heard[201:]} == {0.0}


def test_without_a_battery_nothing_is_published_of_it():
    env = make_env(2, battery=False)
    assert values_of(env.advance(200.0), "battery_level") == []
    assert env.observe().battery_level == 1.0
    assert not any(text.startswith("battery") for _, text in env.disturbances)


def test_the_thruster_fails_when_told_and_is_reported_once_within_a_second():
    env = make_env(3)
    heard = values_of(env.advance(100.0), "c_thruster_1")
    assert [value for _, value in heard] == ["FALSE"]
    assert 35 <= heard[0][0] <= 36
    assert env.observe().thrusters_failed == (1,)
    assert [one for one in env.disturbances if one[1].startswith("thruster")] == [
        (35.0, "thruster 1 failed")
    ]


def test_a_thruster_that_recovers_by_itself_is_reported_too():
    env = make_env(3, thruster_events="2 failure 5, 2 recovery 9")
    heard = values_of(env.advance(20.0), "c_thruster_2")
    assert [value for _, value in heard] == ["FALSE", "RECOVERED"]
    assert env.observe().thrusters_failed == ()


def test_recovery_makes_the_thruster_work_again():
    env = make_env(3)
    env.advance(37.0)
    env.components.activate("recover_thrusters")
    heard = env.advance(50.0)
    assert [time for time, _ in values_of(heard, "c_thruster_1")] == [pytest.approx(47.0)]
    assert [time for time, _ in values_of(heard, "c_thruster_6")] == [pytest.approx(48.25)]
    assert env.observe().thrusters_failed == ()


def test_disturbances_tell_the_crossings_of_visibility_up_to_now():
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


def test_with_no_component_active_the_vehicle_holds_its_position():
    env = make_env(4)
    start = env.observe()
    env.advance(120.0)
    after = env.observe()
    assert math.dist((start.x, start.y, start.z), (after.x, after.y, after.z)) < 0.05
    assert after.speed < 0.01


def test_a_deactivated_search_comes_to_rest():
    env = make_env(4, **QUIET)
    env.components.activate("spiral_search")
    env.advance(60.0)
    assert env.observe().speed > 0.05
    env.components.deactivate("spiral_search")
    env.advance(75.0)
    rest = env.observe()
    env.advance(100.0)
    after = env.observe()
    assert after.speed < 0.01
    assert math.dist((rest.x, rest.y, rest.z), (after.x, after.y, after.z)) < 0.1


def test_a_vehicle_on_its_way_stops_when_the_last_component_that_moves_it_is_deactivated():
    env = make_env(4, **QUIET)
    env.components.activate("recharge")
    env.components.activate("recover_thrusters")
    env.advance(15.0)
    on_the_way = env.observe()
    assert on_the_way.speed > 0.5
    env.components.deactivate("recharge")
    env.advance(40.0)
    after = env.observe()
    assert after.active == ("recover_thrusters",)
    assert after.speed < 0.02
    assert math.dist((on_the_way.x, on_the_way.y), (after.x, after.y)) < 3


@pytest.mark.parametrize(
    ("component", "period"),
    [("_spiral", 1.0), ("_follower", 2.0), ("_recharge", 5.0), ("_visibility", 1.0)],
)
def test_the_phases_of_the_timers_differ_from_run_to_run(component, period):
    phases = set()
    for seed in range(6):
        env = make_env(seed, **QUIET, start_delay_s=0, start_x_m=-3.0, start_y_m=-2.0)
        if component == "_visibility":
            phases.add(values_of(env.advance(5.0), "water_visibility")[0][0])
            continue
        name = {
            "_spiral": "spiral_search",
            "_follower": "follow_pipeline",
            "_recharge": "recharge",
        }[component]
        sent = []
        env._autopilot.go_to = lambda target, time, sent=sent: sent.append(time)
        env._follower.take_path(((20.0, 0.0),))
        env.components.activate(name)
        env.advance(6.0)
        phases.add(sent[0])
    assert len(phases) == 6
    assert max(phases) - min(phases) > 0.2 * period
    assert max(phases) < period + 0.1


def test_the_search_takes_about_a_step_per_second_at_1_m():
    env = make_env(5, **QUIET, spiral_altitude_m=1.0, start_y_m=40.0, bias_m=0.0)
    env.components.activate("spiral_search")
    env.advance(130.0)
    # radius after n steps is 0.01838 n; the first setpoint comes after 4 s
    here = env.observe()
    steps = math.dist((here.x, here.y), (env._spiral._centre)) / 0.01838
    assert 126 / steps == pytest.approx(1.05, abs=0.1)
    assert here.altitude == pytest.approx(1.0, abs=0.05)


def test_a_vertical_bias_stalls_the_search_until_it_is_corrected():
    heights = {}
    for bias in (0.0, 0.8):
        env = make_env(5, **QUIET, bias_m=bias, start_y_m=40.0)
        env.components.activate("spiral_search")
        env.advance(15.0)
        early = env.observe().altitude
        env.advance(90.0)
        heights[bias] = (early, env.observe().altitude, env._spiral._count)
    assert heights[0.0][0] == pytest.approx(2.0, abs=0.15)
    assert heights[0.8][0] == pytest.approx(2.8, abs=0.1)
    assert heights[0.8][1] == pytest.approx(2.3, abs=0.1)
    assert heights[0.8][2] < heights[0.0][2] - 15


def test_the_pipeline_is_followed_at_a_quarter_metre_per_second():
    env = make_env(6, **QUIET, start_y_m=0.0, start_y_sd_m=0.0)
    messages = env.advance(5.0)
    assert values_of(messages, "pipeline_found") == [(env.metrics.found_s, "true")]
    env.components.activate("follow_pipeline")
    env.advance(30.0)
    before = env.metrics.distance_inspected_m
    env.advance(70.0)
    assert (env.metrics.distance_inspected_m - before) / 40 == pytest.approx(0.25, abs=0.02)


def test_a_frozen_thruster_slows_but_does_not_stop_the_search():
    counts = []
    for events in ("", "1 failure 20", "1 failure 20, 3 failure 20"):
        env = make_env(
            5, battery=False, spiral_altitude_m=1.0, start_y_m=40.0, thruster_events=events
        )
        env.components.activate("spiral_search")
        env.advance(130.0)
        counts.append(env._spiral._count)
    assert counts[0] >= counts[1] >= counts[2] > 60
    assert counts[0] > counts[2]


def test_the_way_to_the_station_is_nearly_as_fast_as_allowed_and_ends_there():
    env = make_env(6, **QUIET)
    env.components.activate("recharge")
    speeds = []
    for time in range(6, 60):
        env.advance(float(time))
        speeds.append(env.observe().speed)
        if env.observe().recharged:
            break
    assert env.observe().recharged == 1
    assert 0.8 < max(speeds) < 1.4
    here = env.observe()
    assert max(abs(here.x - env.station[0]), abs(here.y - env.station[1])) < 0.6


def test_the_sea_must_not_be_entered():
    env = make_env(6, **QUIET, bias_m=-3.0)
    env.components.activate("spiral_search")
    env.components.set_parameters("spiral_search", {"spiral_altitude": 1.0})
    env.advance(60.0)
    assert env.observe().altitude > -0.05


@pytest.mark.parametrize("seed", [0, 3, 11])
def test_a_scripted_mission_searches_finds_recharges_and_goes_on(seed):
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


@pytest.mark.parametrize("seed", range(20))
def test_the_adaptive_search_finds_the_pipeline(seed):
    script = Script(make_env(seed, battery=False))
    while not script.found and script.env.now < 250:
        script.run(script.env.now + 10)
    assert 0 < script.env.metrics.found_s < 250


def test_time_moves_forward_only():
    env = make_env(0)
    env.advance(2.0)
    assert env.advance(2.0) == []
    for until in (1.9, math.nan, math.inf):
        with pytest.raises(SuaveEnvError, match="allowed is a finite time from now"):
            env.advance(until)
    assert env.now == 2.0


def test_what_is_returned_shares_no_memory_with_the_environment():
    env = make_env(0)
    heard = env.advance(5.0)
    assert len(heard) > 0
    heard.clear()
    observation = env.observe()
    with pytest.raises(FrozenInstanceError):
        observation.x = 3.0
    twin = make_env(0)
    twin.advance(5.0)
    assert env.advance(10.0) == twin.advance(10.0)


def test_two_environments_do_not_meet():
    alone, first, second = make_env(1), make_env(1), make_env(2)
    expected = [message for until in range(1, 20) for message in alone.advance(float(until))]
    heard = []
    for until in range(1, 20):
        heard += first.advance(float(until))
        second.advance(float(until))
    assert heard == expected


def test_positions_stay_finite_when_every_thruster_is_stuck():
    env = make_env(0, thruster_events=", ".join(f"{number} failure 20" for number in range(1, 7)))
    env.components.activate("spiral_search")
    env.advance(120.0)
    here = env.observe()
    assert all(math.isfinite(value) for value in (here.x, here.y, here.z, here.speed))
    assert here.thrusters_failed == (1, 2, 3, 4, 5, 6)


def test_late_boot_adds_height_and_bias_in_its_share_of_runs():
    def start_z(share, seed):
        settings = Settings().replace(late_boot_share=share)
        return SuaveEnv(settings, np.random.default_rng(seed)).observe().z

    usual = [start_z(0.0, seed) for seed in range(30)]
    assert [start_z(1.0, seed) - z for seed, z in enumerate(usual)] == pytest.approx(
        [0.92] * 30, abs=0.01
    )
    late = sum(start_z(0.3, seed) > z for seed, z in enumerate(usual))
    assert 3 <= late <= 15
