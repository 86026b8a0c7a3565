"""How long it takes to find, and to prove, the best configuration.

And that it is the best of 1,000 small robots.
"""

import sys
import time
from pathlib import Path
from random import Random
from statistics import quantiles
from typing import NamedTuple

import pytest
from estimated import robot, small_robot
from figures import table

from kb.optimal import OptimalPlanner, Problem

sys.path.append(str(Path(__file__).parents[1] / "kb"))  # the twin is the oracle of the tests there

from best_by_trying import best_by_trying

pytestmark = pytest.mark.benchmark

SEEDS = range(100)


def state_of(kb):
    """The facts and statuses of a base."""
    with kb.reading() as state:
        return state


class Asked(NamedTuple):
    wall_s: float
    processor_s: float
    is_proven: bool


def asked(planner, kb):
    """Choose once, from the facts to the proof."""
    wall = time.perf_counter()
    processor = time.process_time()
    found = planner.optimum(kb)
    return Asked(time.perf_counter() - wall, time.process_time() - processor, found.is_proven)


def carry_out(kb, planner):
    plan = planner.plan(kb)
    for name in plan.deactivate:
        kb.component_active(name, False)
    for name in plan.activate:
        kb.component_active(name, True)
    kb.finish_plan(plan, "completed")


def free(seed):
    return OptimalPlanner(), robot(seed)


def switching(seed):
    """Return a robot that did well before everything was estimated anew."""
    kb = robot(seed)
    other = robot(seed + len(SEEDS))
    carry_out(kb, OptimalPlanner())
    for old, new in zip(kb.model.estimations, other.model.estimations, strict=True):
        kb.model.change(old, value=(old.value + new.value) / 2)
    return OptimalPlanner(switching_cost=0.2), kb


KINDS = {"robot at rest": free, "switching cost, robot at work": switching}


def test_best_configuration_of_100_robots_is_proven(tables):
    found = {kind: [asked(*make(seed)) for seed in SEEDS] for kind, make in KINDS.items()}
    tables["5"] = lambda: written(found)
    for times in found.values():
        assert all(time_s.is_proven for time_s in times)


def test_best_configuration_of_small_robots_is_found():
    for seed in range(1000):
        kb = small_robot(seed)
        draw = Random(seed)
        weights = {name: draw.choice((1.0, 0.5, -0.5, -1.0)) for name in ("accuracy", "wear")}
        cost = draw.choice((0.0, 0.1, 0.5))
        optimum = Problem(state_of(kb), weights, cost).solve()
        worth, choices = best_by_trying(state_of(kb), weights, cost)
        assert optimum.is_proven
        assert optimum.value == pytest.approx(float(worth), abs=1e-12)
        designs, configurations, _ = optimum.choice
        assert (designs, configurations) in choices


def written(found):
    head = (
        "20 functions, 30 components, 100 robots",
        "p50",
        "p95",
        "most",
        "processor, p50",
        "p95",
        "most",
    )
    rows = []
    for kind, times in found.items():
        row = [kind]
        for field in ("wall_s", "processor_s"):
            taken = [getattr(time_s, field) for time_s in times]
            cuts = quantiles(taken, n=100, method="inclusive")
            row += [f"{1e3 * one:.0f} ms" for one in (cuts[49], cuts[94], max(taken))]
        rows.append(row)
    return table("Finding and proving the best configuration", head, rows)
