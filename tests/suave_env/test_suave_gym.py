import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import suave_env.gym
from suave_env import SuaveEnvError


def made(**options):
    return gymnasium.make("rosa/SUAVE-v0", **options)


def act(**changes):
    action = np.zeros(5, dtype=np.int64)
    for name, value in changes.items():
        action[{"search": 0, "follow": 1, "recover": 2, "recharge": 3, "altitude": 4}[name]] = value
    return action


def adaptive(seen):
    """What a manager would do that follows the visibility, recovers thrusters and recharges."""
    visibility, battery, *thrusters, found = seen
    low = battery < 0.25
    return act(
        search=not found and not low,
        follow=bool(found) and not low,
        recharge=low,
        recover=min(thrusters) == 0,
        altitude=2 if visibility >= 3.25 else 1 if visibility >= 2.25 else 0,
    )


def test_gym_passes_gymnasiums_checker():
    check_env(suave_env.gym.SuaveGym(), skip_render_check=True)


@pytest.mark.parametrize("rules", ["2024", "2025"])
def test_gym_adaptive_policy_finds_and_recharges(rules):
    env = made(settings={"rules": rules})
    seen, _ = env.reset(seed=1)
    rewards = []
    levels = []
    truncated = False
    while not truncated:
        seen, reward, terminated, truncated, info = env.step(adaptive(seen))
        assert not terminated
        rewards.append(reward)
        levels.append(seen[1])
    assert len(rewards) == 300
    assert info["time_s"] == 300
    assert 0 < info["search_time_s"] < 200
    assert sum(rewards) == pytest.approx(env.unwrapped._env.metrics.total_inspected_m)
    assert sum(rewards) > 5
    assert min(rewards) >= 0
    assert max(np.diff(levels)) > 0.7
    env.close()


def test_gym_in_wrong_use_raises():
    with pytest.raises(SuaveEnvError, match="there is no setting 'rule'; the nearest are rules"):
        suave_env.gym.SuaveGym(settings={"rule": "2025"})
    with pytest.raises(gymnasium.error.ResetNeeded):
        suave_env.gym.SuaveGym().step(act())
