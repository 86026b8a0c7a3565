import pytest
from suave_stand_ins import make_env

from suave_env import SuaveEnvError


@pytest.fixture
def env():
    return make_env()


def test_parameters_are_in_force_at_once(env):
    assert env.components.parameters("spiral_search") == {"spiral_altitude": 2.0}
    env.components.set_parameters("spiral_search", {"spiral_altitude": 3})
    env.components.parameters("spiral_search")["spiral_altitude"] = 9.0
    assert env.components.parameters("spiral_search") == {"spiral_altitude": 3.0}
    assert env.observe().spiral_altitude == 3.0


@pytest.mark.parametrize("method", ["activate", "deactivate", "is_active", "parameters"])
def test_component_that_is_unknown_is_refused(env, method):
    with pytest.raises(
        SuaveEnvError, match="no component 'spiral_serch'; the nearest are spiral_search"
    ):
        getattr(env.components, method)("spiral_serch")


@pytest.mark.parametrize("value", ["2.0", None, True, float("nan"), -1.0, 0.0, 20.0])
def test_parameter_that_is_no_altitude_is_refused(env, value):
    with pytest.raises(SuaveEnvError, match="spiral_altitude of spiral_search cannot be"):
        env.components.set_parameters("spiral_search", {"spiral_altitude": value})
    assert env.components.parameters("spiral_search") == {"spiral_altitude": 2.0}
