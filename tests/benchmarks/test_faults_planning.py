"""Faults while plans are made and done: 10,000 replans in random worlds, and interrupts.

`pytest -n 0 -m benchmark tests/benchmarks/test_faults_planning.py -s` prints the counts.
"""

import gc
import sys
import threading
from pathlib import Path

import pytest
from numpy.random import default_rng

sys.path.append(
    str(Path(__file__).parents[1] / "rosa_pddl")
)  # the worlds are those of the tests there

import whole_worlds
from faulty_worlds import Ground, episode
from interrupts import check, instructions, stop, tick, world_of
from pddl_world import load_mission
from test_pddl_certificate import agv_and_other_plannings

from rosa_pddl import Planner, Problem, initial_state


def open_files():
    return len(list(Path("/proc/self/fd").iterdir()))


pytestmark = pytest.mark.benchmark

REPLANS = 10_000
EVERY = 4  # of so many instructions one is interrupted before


def test_replans_reach_exactly_what_can_be_reached():
    plans = 0
    episodes = 0
    reached = 0
    seed = 0
    ground = Ground(0)
    episode(ground, 10**6)
    gc.collect()
    before = threading.active_count(), open_files()
    while plans < REPLANS:
        if seed % 40 == 0:
            ground.planner.close()
            ground = Ground(seed // 40)
        made, can = episode(ground, seed)
        plans = plans + made
        episodes = episodes + 1
        reached = reached + can
        seed = seed + 1
    gc.collect()
    print(f"\n{plans} replans in {episodes} episodes; the goal in reach in {reached} and reached")
    assert 0 < reached < episodes
    assert (threading.active_count(), open_files()) == before


def test_interrupts_leave_nothing_owned():
    extended = load_mission("suave_extended")
    planner = Planner()
    tried = 0
    planner.plan(Problem(extended, initial_state(extended)))

    def make():
        return world_of(extended, planner)

    for act, ticks in [*((tick, number) for number in range(6)), (stop, 1), (stop, 3)]:
        for instruction in range(1, instructions(make, ticks, act) + 1, EVERY):
            check(make, ticks, act, instruction)
            tried += 2
    print(f"\n{tried} interrupts, each followed by an end or by going on to the goal")
    assert tried > 10_000


def test_a_thousand_worlds_that_grow_end_where_brute_force_says():
    planner = Planner()
    ended = [whole_worlds.episode(default_rng(seed), planner) for seed in range(1000)]
    missed = [seed for seed, (reached, could) in enumerate(ended) if reached != could]
    print(f"\n{sum(reached for reached, _ in ended)} of 1000 goals reached")
    assert missed == []


def test_entry_of_a_certificate_is_what_planning_says():
    found, others = agv_and_other_plannings(every=1)
    assert len(others) == 16  # none, one and two of five actions fail
    assert [
        out
        for out, one in others.items()
        if (one.outcome, one.cost) != (found.entries[out].outcome, found.entries[out].cost)
    ] == []
