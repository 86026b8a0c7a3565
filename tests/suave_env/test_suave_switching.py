import pytest
from suave_stand_ins import make_env

from suave_env import SuaveEnvError


@pytest.fixture
def env():
    return make_env()


def test_the_components_are_the_four_of_the_mission(env):
    assert env.components.active == ()
    for name in ("spiral_search", "follow_pipeline", "recover_thrusters", "recharge"):
        assert not env.components.is_active(name)


def test_activating_what_is_active_changes_nothing(env):
    env.components.activate("recover_thrusters")
    env.advance(1.0)
    env.components.activate("recover_thrusters")
    recovered = [
        one for one in env.advance(20.0) if "RECOVERED" in one["status"][0]["values"].values()
    ]
    assert len(recovered) == 6
    assert len(env.components.history) == 1


def test_parameters_are_in_force_at_once_and_returned_as_a_copy(env):
    assert env.components.parameters("spiral_search") == {"spiral_altitude": 2.0}
    env.components.set_parameters("spiral_search", {"spiral_altitude": 3})
    env.components.parameters("spiral_search")["spiral_altitude"] = 9.0
    assert env.components.parameters("spiral_search") == {"spiral_altitude": 3.0}
    assert env.observe().spiral_altitude == 3.0


@pytest.mark.parametrize("method", ["activate", "deactivate", "is_active", "parameters"])
def test_an_unknown_component_is_refused_with_the_nearest_known(env, method):
    with pytest.raises(
        SuaveEnvError, match="no component 'spiral_serch'; the nearest are spiral_search"
    ):
        getattr(env.components, method)("spiral_serch")


def test_an_unknown_parameter_is_refused_with_those_that_exist(env):
    with pytest.raises(
        SuaveEnvError, match="no parameter of spiral_search 'speed'; known are spiral_altitude"
    ):
        env.components.check("spiral_search", {"speed": 1.0})
    with pytest.raises(SuaveEnvError, match="no parameter of recharge 'speed'; known are none"):
        env.components.set_parameters("recharge", {"speed": 1.0})


@pytest.mark.parametrize("value", ["2.0", None, True, float("nan"), -1.0, 0.0, 20.0])
def test_a_parameter_that_is_not_an_altitude_is_refused(env, value):
    with pytest.raises(SuaveEnvError, match="spiral_altitude of spiral_search cannot be"):
        env.components.set_parameters("spiral_search", {"spiral_altitude": value})
    assert env.components.parameters("spiral_search") == {"spiral_altitude": 2.0}
