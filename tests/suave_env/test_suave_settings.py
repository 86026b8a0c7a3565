from dataclasses import fields

import pytest

from suave_env import Settings, SuaveEnvError
from suave_env.settings import RULES

NAMES = {info.name for info in fields(Settings)}


def test_setting_has_unit_meaning_and_source():
    assert len(fields(Settings)) > 50
    for info in fields(Settings):
        assert all(info.metadata[what] for what in ("unit", "meaning", "source"))
        assert "\n" not in info.metadata["meaning"]
        assert info.default == getattr(Settings(), info.name)


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
def test_setting_with_a_wrong_value_is_refused(name, value, allowed):
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


@pytest.mark.parametrize(
    "text",
    ["7 failure 3", "0 failure 3", "1 breaks 3", "1 failure", "1 failure -2", "1 failure nan"],
)
def test_thruster_events_that_are_wrong_are_refused(text):
    with pytest.raises(SuaveEnvError, match="1 failure 35, 1 recovery 90"):
        Settings().replace(thruster_events=text)


def test_rules_of_2025_change_what_they_differ_in():
    first = Settings()
    later = Settings().replace(rules="2025")
    assert set(RULES) == {"2024", "2025"}
    assert len(RULES["2025"]) > 10
    for name in NAMES - {"rules"}:
        assert getattr(later, name) == RULES["2025"].get(name, getattr(first, name)), name
    assert all(getattr(first, name) != value for name, value in RULES["2025"].items())
    assert later.replace(rules="2024") == first


def test_setting_that_is_given_stands_against_the_rules():
    settings = Settings().replace(visibility_period_s=80, rules="2025", bias_m=0.3)
    assert (settings.visibility_period_s, settings.bias_m, settings.pipe_point_offset_m) == (
        80.0,
        0.3,
        0.0,
    )
    with pytest.raises(SuaveEnvError, match="there are no rules '2030'; known are 2024, 2025"):
        Settings().replace(rules="2030")


@pytest.mark.parametrize("name", ["start_x_m", "start_y_m", "bias_m"])
def test_start_that_is_given_has_no_spread(name):
    spread = name.replace("_m", "_sd_m")
    assert getattr(Settings(), spread) > 0
    assert getattr(Settings().replace(**{name: 0.5}), spread) == 0
    assert getattr(Settings().replace(**{name: 0.5, spread: 0.2}), spread) == 0.2
