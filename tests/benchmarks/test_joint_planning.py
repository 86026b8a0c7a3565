"""How long a joint plan takes in a building as large as the published one, by kind of limit."""

from dataclasses import replace
from math import inf
from time import perf_counter

import pytest
from agv_worlds import generated_building
from figures import percentiles, table
from numpy.random import default_rng

from kb import KnowledgeBase
from missions.agv import WEIGHTS, Weights
from missions.agv.joint import Modes, Place, Task
from missions.agv.model import agv_model

pytestmark = pytest.mark.benchmark

QUESTIONS = 100
FAILURES = ((), ("kinect",), ("lidar",), ("kinect", "lamp"))


def energy_of(answer):
    """Return the energy of a plan, without the switching [J]."""
    return sum(leg.takes.energy for leg in answer.legs) / 1e3


@pytest.mark.parametrize("kind", ["none", "ample", "hard"])
def test_joint_plan_takes_milliseconds(kind):
    rng = default_rng(0)
    building = generated_building(rng)
    times_ms = []
    for number in range(QUESTIONS):
        kb = KnowledgeBase(agv_model(), clock=lambda: 0.0)
        for name in FAILURES[number % len(FAILURES)]:
            kb.component_failed(name)
        modes = Modes(kb)
        start, goal = map(str, rng.choice(list(building.places), 2, replace=False))
        there = replace(building, goal=goal)
        best_j = energy_of(Task(there, modes, WEIGHTS, Place(start)).plan())
        least_j = energy_of(Task(there, modes, Weights(energy=1.0), Place(start)).plan())
        limit_j = {"none": inf, "ample": 2 * best_j, "hard": (best_j + least_j) / 2}[kind]
        started = perf_counter()
        Task(there, modes, WEIGHTS, Place(start), limit_j).plan()
        times_ms.append((perf_counter() - started) * 1e3)
    median, ninety = percentiles(times_ms)[:2]
    head = ("limit", "median [ms]", "90 of 100 [ms]")
    print(table("Joint plans, 58 places", head, [(kind, f"{median:.1f}", f"{ninety:.1f}")]))
    assert median < 1000
