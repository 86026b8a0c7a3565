from dataclasses import FrozenInstanceError, fields

import pytest
from hypothesis import given
from hypothesis import strategies as st

from suave_env import Settings, SuaveEnvError
from suave_env.settings import RULES, ThrusterEvent, parse_thruster_events

NAMES = {info.name for info in fields(Settings)}


def test_every_setting_says_its_unit_meaning_and_source():
    assert len(fields(Settings)) > 50
    for info in fields(Settings):
        assert all(info.metadata[what] for what in ("unit", "meaning", "source"))
        assert "\n" not in info.metadata["meaning"]
        assert info.default == getattr(Settings(), info.name)


def test_replacing_leaves_the_original_as_it_was():
    settings = Settings()
    changed = settings.replace(
        discharge_time_s=150, battery=False, spiral_patience=3, thruster_events=""
    )
    assert (changed.discharge_time_s, changed.battery, changed.spiral_patience) == (150.0, False, 3)
    assert settings == Settings()
    with pytest.raises(FrozenInstanceError):
        settings.battery = False


def test_a_whole_number_is_read_as_a_number_with_fraction_where_one_is_meant():
    assert type(Settings().replace(discharge_time_s=150).discharge_time_s) is float


def test_an_unknown_setting_is_refused_with_the_nearest_known_ones():
    with pytest.raises(
        SuaveEnvError, match=r"no setting 'discharge_time'; the nearest are discharge_time_s"
    ):
        Settings().replace(discharge_time=100.0)


@given(st.text(min_size=1).filter(lambda name: name not in NAMES))
def test_any_unknown_setting_is_named_in_the_refusal(name):
    with pytest.raises(SuaveEnvError) as refusal:
        Settings().replace(**{name: 1.0})
    assert repr(name) in str(refusal.value)


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("discharge_time_s", float("nan"), "a number from 1"),
        ("discharge_time_s", float("inf"), "a number from 1"),
        ("discharge_time_s", -3.0, "a number from 1"),
        ("discharge_time_s", "100", "a number from 1"),
        ("discharge_time_s", True, "a number from 1"),
        ("battery", 1, "true or false"),
        ("battery", "yes", "true or false"),
        ("spiral_patience", 2.5, "a whole number from 0"),
        ("thruster_events", 35.0, "text"),
        ("spiral_altitude_m", 25.0, "a number from 0.1 to 19"),
    ],
)
def test_a_value_that_is_not_allowed_is_refused_with_what_is_allowed(name, value, allowed):
    with pytest.raises(SuaveEnvError) as refusal:
        Settings().replace(**{name: value})
    assert name in str(refusal.value)
    assert repr(value) in str(refusal.value)
    assert allowed in str(refusal.value)


def test_settings_at_odds_with_each_other_are_refused():
    with pytest.raises(SuaveEnvError, match=r"visibility_min_m 5\.0 is above visibility_max_m"):
        Settings(visibility_min_m=5.0)
    with pytest.raises(SuaveEnvError, match="not a whole multiple of physics_step_s"):
        Settings(control_period_s=0.025, physics_step_s=0.01)
    with pytest.raises(SuaveEnvError, match="not a whole multiple of physics_step_s"):
        Settings(control_period_s=0.01, physics_step_s=0.02)


def test_thruster_events_are_read_in_order_of_time():
    events = parse_thruster_events("3 recovery 90.5, 3 failure 20")
    assert events == (ThrusterEvent(3, True, 20.0), ThrusterEvent(3, False, 90.5))
    assert parse_thruster_events("") == ()


@pytest.mark.parametrize(
    "text",
    ["7 failure 3", "0 failure 3", "1 breaks 3", "1 failure", "1 failure -2", "1 failure nan"],
)
def test_thruster_events_that_cannot_be_read_are_refused_with_an_example(text):
    with pytest.raises(SuaveEnvError, match="1 failure 35, 1 recovery 90"):
        Settings().replace(thruster_events=text)


def test_rules_of_2025_change_what_they_differ_in_and_nothing_else():
    first, later = Settings(), Settings().replace(rules="2025")
    assert set(RULES) == {"2024", "2025"}
    assert len(RULES["2025"]) > 10
    for name in NAMES - {"rules"}:
        assert getattr(later, name) == RULES["2025"].get(name, getattr(first, name)), name
    assert all(getattr(first, name) != value for name, value in RULES["2025"].items())
    assert later.replace(rules="2024") == first


def test_what_is_set_stands_whatever_the_rules_say_of_it():
    settings = Settings().replace(visibility_period_s=80, rules="2025", bias_m=0.3)
    assert (settings.visibility_period_s, settings.bias_m, settings.pipe_point_offset_m) == (
        80.0,
        0.3,
        0.0,
    )
    with pytest.raises(SuaveEnvError, match="there are no rules '2030'; known are 2024, 2025"):
        Settings().replace(rules="2030")


@pytest.mark.parametrize("name", ["start_x_m", "start_y_m", "bias_m"])
def test_a_start_or_bias_that_is_set_is_the_same_in_every_run_unless_its_spread_is_set_too(name):
    spread = name.replace("_m", "_sd_m")
    assert getattr(Settings(), spread) > 0
    assert getattr(Settings().replace(**{name: 0.5}), spread) == 0
    assert getattr(Settings().replace(**{name: 0.5, spread: 0.2}), spread) == 0.2


def test_times_of_chained_thruster_events_add_up():
    events = parse_thruster_events("1 failure 35, 1 recovery 20", chained=True)
    assert [event.time for event in events] == [35.0, 55.0]
