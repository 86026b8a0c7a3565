"""What joint planners are asked in the benchmarks: random starts, goals, preferences and failures."""

from collections.abc import Callable
from time import perf_counter
from typing import TypeVar

from numpy.random import Generator

from kb import KnowledgeBase, Model
from missions.agv.joint import Answer, JointPlanner, Place, Question
from missions.agv.model import Building, agv_model

MODEL = agv_model()
PREFERENCES = (
    {"time": 1.0},
    {"energy": 1.0},
    {"collisions": 1.0, "time": 1e-4},
    {"time": 1.0, "energy": 0.02, "collisions": 10.0},
)
FAILURES = ((), ("kinect",), ("lidar",), ("camera",), ("amcl",))
T = TypeVar("T")


def timed(act: Callable[..., T], *arguments: object) -> tuple[float, T]:
    began = perf_counter()
    result = act(*arguments)
    return perf_counter() - began, result


def known(*failed: str) -> KnowledgeBase:
    kb = KnowledgeBase(MODEL, clock=lambda: 0.0)
    for name in failed:
        kb.component_failed(name)
    return kb


def asked(rng: Generator, building: Building) -> Question:
    start, goal = rng.choice(list(building.places), 2, replace=False)
    return Question(Place(str(start)), str(goal), PREFERENCES[rng.integers(len(PREFERENCES))])


def cold(building: Building, question: Question, failed: tuple[str, ...]) -> Answer:
    return JointPlanner(building, known(*failed)).plan(question)


def on_the_way(
    rng: Generator, building: Building, model: Model
) -> tuple[KnowledgeBase | None, JointPlanner | None, Question | None]:
    """Put a robot into the first corridor of its plan, localising by the Kinect; None if that cannot be there."""
    kb = KnowledgeBase(model, clock=lambda: 0.0)
    planner, question = JointPlanner(building, kb), asked(rng, building)
    answer = planner.plan(question)
    if not answer.is_solved:
        return None, None, None
    leg = answer.legs[0]
    kb.measure("driven", 0.0)
    for attribute, value in leg.conditions.items():
        kb.measure(attribute, value)
    kb.request_action(f"cross_{leg.corridor}")
    plan = kb.select({"navigate": "amcl_kinect"}, {"base": "fast"}, "to be lost")
    assert plan is not None
    for part in plan.activate:
        kb.component_active(part, True)
    kb.finish_plan(plan, "completed")
    driven_m = float(rng.uniform(0.0, building.corridors[leg.corridor].length_m))
    kb.measure("driven", driven_m)
    where = Question(Place(leg.origin, leg.corridor, driven_m), question.goal, question.weights)
    planner.plan(where)
    return kb, planner, where
