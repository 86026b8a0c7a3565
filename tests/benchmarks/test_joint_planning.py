"""How long a joint plan takes in a building as large as the published one, by kind of limits."""

from time import perf_counter

import pytest
from agv_worlds import generated_building
from figures import percentiles, table
from numpy.random import default_rng

from kb import KnowledgeBase
from missions.agv.joint import JointPlanner, Place, Question
from missions.agv.model import agv_model

pytestmark = pytest.mark.benchmark

QUESTIONS = 100
WEIGHTS = {"time": 1.0, "energy": 0.02, "collisions": 10.0}
FAILURES = ((), ("kinect",), ("lidar",), ("kinect", "lamp"))


def asked(rng, planner, building):
    """Return a question with random start and goal, without limits."""
    places = list(building.places)
    start, goal = rng.choice(places, 2, replace=False)
    return Question(Place(str(start)), str(goal), WEIGHTS)


def limits_of(kind, planner, question, answer):
    """Return ample limits, or an energy halfway between the least and what the best plan takes."""
    if kind == "none" or not answer.is_solved:
        return {}
    best = answer.takes.in_units["energy"]
    if kind == "ample":
        return {"energy": 2 * best, "collisions": 10.0}
    least = planner.plan(Question(question.start, question.goal, {"energy": 1.0}))
    return {"energy": (best + least.takes.in_units["energy"]) / 2}


@pytest.mark.parametrize("kind", ["none", "ample", "hard"])
def test_joint_plan_takes_milliseconds(kind):
    rng = default_rng(0)
    building = generated_building(rng)
    times_ms = []
    for number in range(QUESTIONS):
        kb = KnowledgeBase(agv_model(), clock=lambda: 0.0)
        for name in FAILURES[number % len(FAILURES)]:
            kb.component_failed(name)
        planner = JointPlanner(building, kb)
        free = asked(rng, planner, building)
        limits = limits_of(kind, planner, free, planner.plan(free))
        question = Question(free.start, free.goal, WEIGHTS, limits)
        started = perf_counter()
        planner.plan(question)
        times_ms.append((perf_counter() - started) * 1e3)
    median, ninety = percentiles(times_ms)[:2]
    head = ("limits", "median [ms]", "90 of 100 [ms]")
    print(table("Joint plans, 58 places", head, [(kind, f"{median:.1f}", f"{ninety:.1f}")]))
    assert median < 1000
