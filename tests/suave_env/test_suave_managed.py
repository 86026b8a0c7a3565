import pytest
from suave_stand_ins import make_env

from suave_env import SuaveEnvError


@pytest.fixture
def env():
    return make_env(activation_s=0.05, deactivation_s=0.1, parameter_s=0.2)


def test_the_components_are_the_four_of_the_mission(env):
    assert env.managed.names == ("spiral_search", "follow_pipeline", "recover_thrusters", "recharge")
    assert env.managed.active == ()


def test_activation_takes_its_time(env):
    env.advance(3.0)
    operation = env.managed.activate("recharge")
    env.advance(3.049)
    assert not operation.done()
    assert not env.managed.is_active("recharge")
    env.advance(3.051)
    assert operation.done()
    assert operation.exception() is None
    assert env.managed.is_active("recharge")
    assert env.observe().active == ("recharge",)


def test_two_changes_of_one_component_are_carried_out_in_the_order_asked_for(env):
    first, second = env.managed.activate("recharge"), env.managed.deactivate("recharge")
    other = env.managed.activate("spiral_search")
    env.advance(0.06)
    assert (first.done(), second.done(), other.done()) == (True, False, True)
    assert env.managed.is_active("recharge")
    env.advance(0.16)
    assert second.done()
    assert not env.managed.is_active("recharge")


def test_a_quick_change_does_not_overtake_a_slow_one(env):
    env.managed.activate("recharge")
    env.advance(1.0)
    slow, quick = env.managed.deactivate("recharge"), env.managed.activate("recharge")
    env.advance(1.11)
    assert (slow.done(), quick.done()) == (True, False)
    env.advance(1.16)
    assert quick.done()
    assert env.managed.is_active("recharge")


def test_activating_what_is_active_takes_its_time_and_changes_nothing(env):
    env.managed.activate("recover_thrusters")
    env.advance(1.0)
    operation = env.managed.activate("recover_thrusters")
    assert not operation.done()
    messages = env.advance(20.0)
    assert operation.done()
    recovered = [m for m in messages if "RECOVERED" in m["status"][0]["values"].values()]
    assert len(recovered) == 6


def test_parameters_are_in_force_when_the_change_is_done(env):
    assert env.managed.parameters("spiral_search") == {"spiral_altitude": 2.0}
    operation = env.managed.set_parameters("spiral_search", {"spiral_altitude": 3})
    env.advance(0.19)
    assert env.managed.parameters("spiral_search") == {"spiral_altitude": 2.0}
    env.advance(0.21)
    assert operation.done()
    assert env.managed.parameters("spiral_search") == {"spiral_altitude": 3.0}
    assert env.observe().spiral_altitude == 3.0


def test_parameters_that_are_returned_are_a_copy(env):
    env.managed.parameters("spiral_search")["spiral_altitude"] = 9.0
    assert env.managed.parameters("spiral_search") == {"spiral_altitude": 2.0}


@pytest.mark.parametrize("method", ["activate", "deactivate", "is_active", "parameters"])
def test_an_unknown_component_is_refused_at_once_with_the_nearest_known(env, method):
    with pytest.raises(SuaveEnvError, match="no component 'spiral_serch'; the nearest are spiral_search"):
        getattr(env.managed, method)("spiral_serch")


def test_an_unknown_parameter_is_refused_at_once_with_those_that_exist(env):
    with pytest.raises(SuaveEnvError, match="no parameter of spiral_search 'speed'; known are spiral_altitude"):
        env.managed.set_parameters("spiral_search", {"speed": 1.0})
    with pytest.raises(SuaveEnvError, match="no parameter of recharge 'speed'; known are none"):
        env.managed.set_parameters("recharge", {"speed": 1.0})


@pytest.mark.parametrize("value", ["2.0", None, True, float("nan"), -1.0, 0.0, 20.0])
def test_a_parameter_that_is_not_an_altitude_is_refused_at_once(env, value):
    with pytest.raises(SuaveEnvError, match="spiral_altitude of spiral_search cannot be"):
        env.managed.set_parameters("spiral_search", {"spiral_altitude": value})
    env.advance(1.0)
    assert env.managed.parameters("spiral_search") == {"spiral_altitude": 2.0}


def test_changes_under_way_fail_when_the_environment_is_closed(env):
    operation = env.managed.activate("recharge")
    env.close()
    assert operation.done()
    assert isinstance(operation.exception(), SuaveEnvError)
    with pytest.raises(SuaveEnvError, match="closed"):
        env.managed.activate("recharge")
