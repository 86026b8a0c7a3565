"""A certificate says for every combination of feasible actions what planning from there says."""

from itertools import chain, combinations

import pytest
from faulty_worlds import Ground
from pddl_world import load_mission

from missions.engine.mission import find_mission
from missions.engine.question import ask, certified
from rosa_pddl import (
    Outcome,
    Planner,
    Problem,
    certificate,
    initial_state,
)
from rosa_pddl.domain import without_feasibility
from rosa_pddl.validate import flaw


def supposing_of(domain):
    def supposing(unfeasible):
        feasible = {
            domain.feasible_atom(action)
            for action in domain.rosa_actions
            if action not in set(unfeasible)
        }
        return Problem(domain, without_feasibility(domain, initial_state(domain)) | feasible)

    return supposing


@pytest.mark.parametrize("which", ["suave_extended", 5, 6])
def test_each_entry_is_what_planning_from_there_says_and_its_plan_works(which):
    domain = load_mission(which) if isinstance(which, str) else Ground(which).domain
    supposing = supposing_of(domain)
    cold = Planner()
    found = certificate(domain, supposing, Planner())
    actions = domain.rosa_actions
    assert list(found.entries) == list(
        chain.from_iterable(combinations(actions, n) for n in range(len(actions) + 1))
    )
    for out, result in found.entries.items():
        other = cold.plan(supposing(out))
        assert (result.outcome, result.cost) == (other.outcome, other.cost)
        assert (
            not result.outcome.is_solved or flaw(domain, result.steps, supposing(out).state) is None
        )
    ends = [
        action for action in actions if found.entries[action,].outcome is Outcome.UNSOLVABLE_PROVEN
    ]
    assert found.fatal == (tuple(ends) if found.entries[()].outcome.is_solved else ())
    assert {result.outcome.is_solved for result in found.entries.values()} == {True, False}


def agv_and_other_plannings(every):
    """The ground vehicle's certificate with two failures at once, and plannings from the beginning for some of it."""
    question = ask(mission=find_mission("agv"))
    found = certified(question, 300.0, 2)
    cold = Planner(timeout_s=300.0)
    return found, {
        out: cold.plan(question.problem_without(out)) for out in list(found.entries)[::every]
    }


def test_entries_of_the_ground_vehicle_are_what_planning_from_there_says():
    found, others = agv_and_other_plannings(every=5)
    assert len(others) > 3
    for out, other in others.items():
        assert (found.entries[out].outcome, found.entries[out].cost) == (
            other.outcome,
            other.cost,
        ), out


def test_what_it_takes_is_limited_by_how_much_fails_at_once():
    domain = load_mission("suave_extended")
    supposing = supposing_of(domain)
    assert len(certificate(domain, supposing, Planner(), failures=1).entries) == 4


def test_trouble_with_a_planner_is_no_proof_that_a_failure_ends_the_mission():
    domain = load_mission("suave_extended")
    found = certificate(domain, supposing_of(domain), Planner("tamer"))
    assert {result.outcome for result in found.entries.values()} == {Outcome.ENGINE_MISSING}
    assert found.fatal == ()
