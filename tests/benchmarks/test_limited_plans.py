"""How long plans within limits take in generated buildings: warm, cold, and without limits by Fast Downward."""

from dataclasses import replace
from time import perf_counter

import pytest
from agv_worlds import declarations_of_task, generated_building
from figures import percentiles, shown, table
from numpy.random import default_rng

from kb import KnowledgeBase
from missions.agv.joint import JointPlanner, Place, Question
from missions.agv.model import agv_model
from rosa_pddl import Declarations, Outcome, Planner, Problem, initial_state

pytestmark = pytest.mark.benchmark

SIZES = ((20, 26), (58, 70))
QUESTIONS = 20
LIMITED = ("energy", "collisions")


def timed(act, *arguments):
    began = perf_counter()
    result = act(*arguments)
    return perf_counter() - began, result


def limits_between(planner, ends):
    """Return limits in the middle between what the quickest plan takes and the least that any does."""
    plans = [
        planner.plan(Question(weights={name: 1.0}, **ends)).takes for name in ("time", *LIMITED)
    ]
    amounts = [one.in_units for one in plans]
    return {name: (amounts[0][name] + min(one[name] for one in amounts)) / 2 for name in LIMITED}


def questions(planner, building, rng):
    """Yield random ends with limits."""
    names = sorted(building.places)
    for _ in range(QUESTIONS):
        start, goal = (str(name) for name in rng.choice(names, 2, replace=False))
        ends = {"start": Place(start), "goal": goal}
        yield Question(weights={"time": 1.0}, limits=limits_between(planner, ends), **ends)


class Asked:
    """A building as a domain; what is so, and what it takes, is handed in with each question."""

    def __init__(self, planner, question):
        self._planner = planner
        declared = declarations_of_task(planner.task(question))
        self.domain = Declarations(
            "joint", declared.schemas, replace(declared.problem, facts=(), numbers={})
        ).load()

    def problem(self, question):
        told = declarations_of_task(self._planner.task(question)).problem
        state = initial_state(self.domain) | frozenset(told.facts)
        return Problem(self.domain, state, (self.domain.expression(told.goal[0]),), told.numbers)


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]} places")
def test_plans_within_limits(size, tables):
    building = generated_building(default_rng(1), *size)
    planner = JointPlanner(building, KnowledgeBase(agv_model(), clock=lambda: 0.0))
    asked = list(questions(planner, building, default_rng(2)))
    limited, free = (Asked(planner, one) for one in (asked[0], replace(asked[0], limits={})))
    engines = {
        "within limits, warm": (Planner("label-setting", cached=0, timeout_s=120.0), limited),
        "within limits, cold": (
            Planner("label-setting", cached=0, timeout_s=120.0, warm=False),
            limited,
        ),
        "no limits, warm": (Planner("label-setting", cached=0, timeout_s=120.0), free),
        "no limits, Fast Downward warm": (Planner(cached=0, timeout_s=120.0), free),
    }
    times = {name: [] for name in (*engines, "within limits, the joint planner")}
    outcomes = set()
    for number, question in enumerate(asked):
        took, answer = timed(planner.plan, question)
        times["within limits, the joint planner"].append(took)
        for name, (engine, domain) in engines.items():
            if name.endswith("cold") and number % 5:
                continue
            problem = domain.problem(
                question if domain is limited else replace(question, limits={})
            )
            if number == 0:
                engine.plan(problem)
            took, result = timed(engine.plan, problem)
            times[name].append(took)
            assert [attempt.way for attempt in result.attempts] == [
                "cold" if name.endswith("cold") else "warm"
            ]
            if domain is limited:
                outcomes.add(result.outcome)
                assert result.outcome.is_solved == answer.is_solved
                assert result.cost == (answer.cost if answer.is_solved else None)
    assert outcomes >= {Outcome.SOLVED_OPTIMALLY}
    tables[f"limited {size[0]}"] = lambda: table(
        f"A building of {size[0]} places: plans within limits of energy and collisions",
        ["", "median", "90 %", "99 %"],
        [[name, *map(shown, percentiles(some))] for name, some in times.items()],
    )
