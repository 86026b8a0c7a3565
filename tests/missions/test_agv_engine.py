"""The joint plan within limits: the general engine finds, step by step in PDDL, what the joint planner finds."""

from itertools import product

from agv_worlds import domain_of_task, generated_building
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng

from kb import KnowledgeBase
from missions.agv.joint import JointPlanner, Question
from missions.agv.model import agv_model
from missions.agv.tree import left_of
from rosa_pddl import Outcome, Planner, Problem, initial_state

MODEL = agv_model()
LIMITED = ("energy", "collisions")
SHARES = (-0.01, 0.0, 0.4, 1.0)
"""Of the way from the least that any plan takes to what the quickest takes."""


def takes(answer):
    amounts = answer.takes
    return amounts.in_units


def limits_of(planner, quickest):
    """Yield limits from hardly any to what the quickest plan takes."""
    least = {name: takes(planner.plan(Question(weights={name: 1.0})))[name] for name in LIMITED}
    room = {name: max(takes(quickest)[name] - amount, 1e-3) for name, amount in least.items()}
    for shares in product(SHARES, repeat=len(LIMITED)):
        given = dict(zip(LIMITED, shares, strict=True))
        yield {name: max(least[name] + share * room[name], 0.0) for name, share in given.items()}


@settings(max_examples=2)
@given(seed=st.integers(0, 10_000), failed=st.sampled_from(["kinect", "lidar", "camera"]))
def test_it_finds_what_the_joint_planner_finds_within_limits(seed, failed):
    kb = KnowledgeBase(MODEL, clock=lambda: 0.0)
    kb.component_failed(failed)
    planner = JointPlanner(generated_building(default_rng(seed), 6, 7), kb)
    quickest = planner.plan(Question(weights={"time": 1.0}))
    if not quickest.is_solved:
        return
    told, engine = None, Planner(timeout_s=60.0, moves=1_000_000)
    for limits in limits_of(planner, quickest):
        task = planner.task(Question(weights={"time": 1.0}, limits=limits))
        told = told or domain_of_task(task)
        left = {
            f"({left_of(name)})": amount
            for name, amount in zip(task.limited, task.limits, strict=True)
        }
        result = engine.plan(Problem(told, initial_state(told), costs=left))
        answer = planner.plan(task.question)
        expected = Outcome.SOLVED_OPTIMALLY if answer.is_solved else Outcome.UNSOLVABLE_PROVEN
        assert (result.outcome, result.cost) == (
            expected,
            answer.cost if answer.is_solved else None,
        ), (result, answer)
        assert [attempt.strategy for attempt in result.attempts] == ["search"]
