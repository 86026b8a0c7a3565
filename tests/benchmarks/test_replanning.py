"""How long a new plan takes: by the search, by Kairos's warm worker and by unified-planning."""

from pathlib import Path
from time import perf_counter

import pytest
from figures import percentiles, shown, table
from numpy.random import default_rng

from rosa_pddl import Outcome, Planner, Problem, flaw, initial_state, load_domain
from rosa_pddl.worker import up_problem_of

pytestmark = pytest.mark.benchmark

MISSION = Path(__file__).parents[2] / "missions" / "suave_extended"
STATES = 500


def extended():
    return load_domain(MISSION / "domain.pddl", MISSION / "problem.pddl")


def states_of(domain, count):
    """Return states of the mission, drawn by chance from all that the facts may be."""
    rng = default_rng(1)
    atoms = [*domain.feasibility, "(pipeline_found pipeline)", "(recharged bluerov)"]
    fixed = initial_state(domain)
    return [fixed.union(atom for atom in atoms if rng.random() < 0.5) for _ in range(count)]


def timed(act, *arguments):
    began = perf_counter()
    result = act(*arguments)
    return perf_counter() - began, result


def by_unified_planning(problem):
    up_problem = up_problem_of(*problem.write("costs")[:2])
    factory = up_problem.environment.factory
    up_problem.environment.credits_stream = None
    with factory.OneshotPlanner(name="fast-downward") as planner:
        return planner.solve(up_problem)


def test_replanning_strategies_side_by_side(tables):
    domain = extended()
    problems = [Problem(domain, state) for state in states_of(domain, STATES)]
    planners = {"search": Planner(), "kairos": Planner("kairos")}
    times = dict[str, list[float]]()
    wrong = 0
    for name, planner in planners.items():
        planner.plan(problems[0])
        times[name] = []
        for problem in problems:
            took_s, result = timed(planner.plan, problem)
            times[name].append(took_s)
            other = planners["search"].plan(problem)
            assert result.outcome.is_solved == other.outcome.is_solved
            if result.outcome.is_solved:
                wrong += flaw(domain, result.steps, problem.state) is not None
                assert result.cost == other.cost
            else:
                assert result.outcome is Outcome.UNSOLVABLE_PROVEN
        planner.close()
    by_unified_planning(problems[0])
    times["unified-planning, one-shot"] = [
        timed(by_unified_planning, problem)[0] for problem in problems[:20]
    ]
    rows = [(name, *map(shown, percentiles(values))) for name, values in times.items()]
    title = "replanning on extended SUAVE"
    tables[title] = lambda: table(title, ("strategy", "p50", "p90", "p99"), rows)
    assert wrong == 0
