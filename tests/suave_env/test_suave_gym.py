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


def test_it_passes_the_judge_of_gymnasium():
    check_env(suave_env.gym.SuaveGym(), skip_render_check=True)


@pytest.mark.parametrize("rules", ["2024", "2025"])
def test_an_adaptive_policy_finds_inspects_and_recharges(rules):
    env = made(settings={"rules": rules})
    seen, _ = env.reset(seed=1)
    rewards, levels, truncated = [], [], False
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


def test_the_same_seed_gives_the_same_episode_and_another_does_not():
    episodes = []
    for seed in (1, 1, 2):
        env = made(duration_s=20)
        seen = [env.reset(seed=seed)[0]]
        seen += [env.step(act(search=1))[0] for _ in range(20)]
        episodes.append([*np.array(seen).tolist(), env.unwrapped._env.observe().x])
        env.close()
    assert episodes[0] == episodes[1] != episodes[2]


def test_doing_nothing_earns_nothing_and_a_failed_thruster_is_seen():
    env = made(settings={"thruster_events": "4 failure 2"})
    env.reset(seed=0)
    for _ in range(5):
        seen, reward, *_ = env.step(act())
        assert reward == 0
    assert seen[2:8].tolist() == [1, 1, 1, 0, 1, 1]
    env.close()


def test_misuse_is_told():
    with pytest.raises(SuaveEnvError, match="there is no setting 'rule'; the nearest are rules"):
        suave_env.gym.SuaveGym(settings={"rule": "2025"})
    with pytest.raises(gymnasium.error.ResetNeeded):
        suave_env.gym.SuaveGym().step(act())
