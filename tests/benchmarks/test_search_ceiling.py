"""How much of the pipeline could be inspected at most, by searches that know everything."""

from random import Random
from statistics import fmean

import numpy as np
import pytest

from suave_env import Settings, SuaveEnv
from suave_env.sea import expected_altitude

pytestmark = pytest.mark.benchmark

SEEDS = range(100)
BUILDING = range(1000, 1012)
TRIALS = {"tuned": 120, "omniscient": 150}
END_S, TICK_S = 300.0, 0.1
HIGHEST = [3.0] * 300


def inspected(seed, altitudes, *, obeys_water=True, until=END_S, follows=True, **settings):
    """Return when the pipeline is found [s] and how much is inspected [m].

    Altitudes are those of each second, 0 for standing still; the water is known without delay, and
    lowers them to what it allows. A stuck thruster is recovered at once.
    """
    env = SuaveEnv(Settings().replace(battery=False, **settings), np.random.default_rng(seed))
    nodes = env.components
    tick = 0
    while env.now < until:
        seen = env.observe()
        found = env.metrics.found_s
        if found is not None:
            if not follows:
                return found, 0.0
            nodes.deactivate("spiral_search")
            nodes.activate("follow_pipeline")
        elif wanted := altitudes[int(env.now + 1e-6)]:
            allowed = (
                min(wanted, expected_altitude(seen.water_visibility)) if obeys_water else wanted
            )
            nodes.set_parameters("spiral_search", {"spiral_altitude": allowed})
            nodes.activate("spiral_search")
        else:
            nodes.deactivate("spiral_search")
        (nodes.activate if seen.thrusters_failed else nodes.deactivate)("recover_thrusters")
        tick += 1
        env.advance(min(until, round(tick * TICK_S, 6)))
    return env.metrics.found_s, env.metrics.total_inspected_m


def climbed(seeds, trials):
    """Return the altitudes by which the pipeline is found soonest in these seas."""

    def takes(altitudes, most):
        total = 0.0
        for seed in seeds:
            until = min(200.0, most * len(seeds) - total + TICK_S)
            total += inspected(seed, altitudes, until=until, follows=False)[0] or END_S
            if total > most * len(seeds):
                return END_S
        return total / len(seeds)

    chance = Random(seeds[0])
    best = HIGHEST
    least = takes(best, END_S)
    for _ in range(trials):
        tried = list(best)
        for _ in range(chance.choice((1, 1, 2, 3))):
            first = chance.randrange(140)
            length = chance.choice((1, 2, 3, 5, 8, 13, 20, 30))
            tried[first : first + length] = [chance.choice((0.0, 1.0, 2.0, 3.0))] * length
        if (took := takes(tried, least)) <= least:
            best = tried
            least = took
    return best


def row(name, seeds, altitudes, **how):
    runs = [inspected(seed, altitudes(seed), **how) for seed in seeds]
    found = [one for one, _ in runs if one is not None]
    mean = fmean(metres for _, metres in runs)
    return mean, f"| {name} | {len(found)} of {len(runs)} | {fmean(found):.1f} | {mean:.1f} |"


def test_what_the_search_may_gain_at_most(tables):
    """The last of these break the rules: they look at no constraint of the water."""
    tuned = climbed(BUILDING, TRIALS["tuned"])
    known = {seed: climbed([seed], TRIALS["omniscient"]) for seed in SEEDS}
    turned = {"pipe_turn_rad": 1.0}, {"pipe_turn_rad": 2.5}, {"pipe_turn_rad": 4.0}
    rows = {
        "highest": row("as high as the water allows, without delay", SEEDS, lambda seed: HIGHEST),
        "tuned": row("tuned to this place and water", SEEDS, lambda seed: tuned),
        **{
            f"{name} {how}": row(f"{name}, {how}", SEEDS[:40], lambda seed, one=one: one, **how)
            for how in turned
            for name, one in (
                ("as high as the water allows", HIGHEST),
                ("tuned to this place", tuned),
            )
        },
        "omniscient": row("the best that was found for each seed", SEEDS, known.__getitem__),
        "blind": row("always at 3 m", SEEDS, lambda seed: HIGHEST, obeys_water=False),
    }
    tables["search"] = lambda: "\n".join(line for _, line in rows.values())
    assert rows["highest"][0] < rows["tuned"][0] < rows["omniscient"][0] < 66.0 < rows["blind"][0]
