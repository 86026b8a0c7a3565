"""What goes wrong while a plan is made or done passes: it is tried again, ever less often, and never taken as proof."""

from collections import Counter
from concurrent.futures import Future
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pddl_world import World, load_text
from py_trees.common import Status

from rosa_pddl import (
    GoalError,
    Outcome,
    PddlError,
    Planner,
    PlannerSettingError,
    PlanningResult,
    Problem,
    ReplanningPolicy,
    SensingError,
    UnknownNameError,
    initial_state,
    parse_domain,
)

WAYS = """(define (domain ways) (:requirements :typing :action-costs) (:types action place)
  (:predicates (action_feasible ?a - action) (swim_action ?a - action) (at ?p - place) (there) (key) (damp) (noise)
               (safe))
  (:functions (total-cost) - number (near) - number (far) - number)
  (:action near :parameters () :precondition (not (damp)) :effect (and (there) (increase (total-cost) (near))))
  (:action far :parameters () :precondition (not (damp)) :effect (and (there) (increase (total-cost) (far))))
  (:action swim :parameters (?a - action)
    :precondition (and (damp) (key) (swim_action ?a) (action_feasible ?a)) :effect (there))
  (:action surface :parameters () :precondition (not (safe)) :effect (safe)))
"""
PROBLEM = """(define (problem go) (:domain ways) (:objects swim other - action pool - place)
  (:init (swim_action swim) (damp) (= (near) 1) (= (far) 4) (= (total-cost) 0)) (:goal (there))
  (:metric minimize (total-cost)))
"""


@pytest.fixture(scope="module")
def ways(tmp_path_factory):
    return load_text(tmp_path_factory.mktemp("ways"), WAYS, PROBLEM)


def begun(world):
    return Counter(name for _, name, what in world.log if what == "begins")


def ticks(world, seconds, each=lambda: None):
    """Tick for so many simulated seconds; return the statuses."""
    statuses = []
    for _ in range(round(seconds * 10)):
        each()
        statuses.append(world.tick())
    return statuses


# ------------------------------------------------------------------ facts that matter, and facts that do not


# ------------------------------------------------------------------ trouble is no proof


class PlanningFailedd:
    """Has so many troubles before it plans."""

    timeout_s = 120.0

    def __init__(self, troubles, outcome=Outcome.ENGINE_CRASHED):
        self.left = troubles
        self.outcome = outcome
        self.planner = Planner()

    def start(self, problem):
        future = Future()
        trouble = PlanningResult(self.outcome, engine="odd", message=f"{self.outcome}")
        future.set_result(trouble if self.left else self.planner.plan(problem))
        self.left -= self.left > 0
        return future


@pytest.mark.parametrize("outcome", [one for one in Outcome if one.is_passing])
def test_one_trouble_of_a_planner_is_not_remembered_as_no_plan(ways, outcome):
    world = World(ways, PlanningFailedd(1, outcome), delay_s=None)
    world.facts = {"(damp)": False}
    assert world.run() is Status.SUCCESS
    assert [str(record.outcome) for record in world.executor.plans] == [
        str(outcome),
        "solved optimally",
    ]
    assert world.executor.plans[1].reason == f"{outcome} after start: retry 1 of 3"


def test_trouble_that_lasts_is_asked_ever_less_often_told_and_never_for_good(ways):
    world = World(ways, PlanningFailedd(6))
    world.facts = {"(damp)": False}
    statuses = ticks(world, 40.0)
    assert statuses.count(Status.SUCCESS) > 1
    first = statuses.index(Status.FAILURE)
    assert statuses.index(Status.SUCCESS) > first
    asked = [record.at_s for record in world.executor.plans[:7]]
    pauses = [later - sooner for sooner, later in pairwise(asked)]
    assert pauses == sorted(pauses)
    assert pauses[0] < 0.6
    assert 6.0 < pauses[-1] < 7.0


def test_the_failure_says_how_often_it_was_tried_and_when_it_is_again(ways):
    world = World(ways, PlanningFailedd(100))
    assert world.run() is Status.FAILURE
    assert (
        world.executor.feedback_message
        == "no plan: engine crashed; tried 4 times, again in 1.6 s at the earliest"
    )
    assert world.tick() is Status.FAILURE
    assert len(world.executor.plans) == 4


# ------------------------------------------------------------------ steps that fail


def test_a_step_that_always_fails_is_planned_a_few_times_a_minute_and_told(ways):
    world = World(ways)
    world.facts = {"(damp)": False}
    world.executor.goals.replace("(safe)")
    ticks(world, 60.0, lambda: world.events.setdefault("surface", Status.FAILURE))
    assert 4 <= len(world.executor.plans) <= 15
    assert 4 <= begun(world)["surface"] <= 12
    assert world.executor.status is Status.FAILURE
    assert "surface() has failed" in world.executor.feedback_message
    world.events.clear()
    assert Status.SUCCESS in ticks(world, 61.0)


def test_a_step_that_keeps_failing_gives_way_to_a_dearer_one(ways):
    world = World(ways)
    world.facts = {"(damp)": False}

    def fail():
        world.events["near"] = Status.FAILURE

    statuses = ticks(world, 10.0, fail)
    assert Status.SUCCESS in statuses
    assert begun(world)["far"] >= 1
    assert 2 <= begun(world)["near"] <= 4


def test_a_step_that_failed_once_waits_a_moment_and_is_begun_again(ways):
    world = World(ways)
    world.facts = {"(damp)": False, "(far)": 100.0}
    world.events = {"near": Status.FAILURE}
    assert world.run() is Status.SUCCESS
    assert begun(world) == {"near": 2}
    assert world.executor._backoff.weights == {}


@settings(max_examples=15, deadline=None)
@given(tries=st.integers(0, 6))
def test_a_step_counts_as_often_as_it_has_to_be_tried(tries):
    domain = parse_domain(WAYS, PROBLEM)
    problem = Problem(
        domain,
        initial_state(domain) - {"(damp)"},
        costs={"(far)": 3.5},
        weights={domain.step("near", []): tries},
    )
    for planner in (Planner(), Planner(moves=0)):
        steps = [step.schema for step in planner.plan(problem).steps]
        assert steps == (["near"] if 0 < tries < 3.5 else ["far"])


# ------------------------------------------------------------------ costs that change


# ------------------------------------------------------------------ costs are exact, or the answer says within what


# ------------------------------------------------------------------ what is sensed and handed in


def test_what_is_sensed_of_an_unknown_object_is_passed_over_and_told(ways):
    world = World(ways)
    world.facts = {"(at volcano)": True, "(damp)": False}
    assert world.run() is Status.SUCCESS
    assert (
        "(at volcano) is sensed, but ignored: 'volcano' is no object; known: other, pool, swim"
        in world.executor.findings[-1]
    )
    world.facts = {"(att pool)": True}
    with pytest.raises(UnknownNameError, match="nearest: at"):
        world.tick()


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_what_is_no_finite_number_is_refused_by_its_name(ways, bad):
    with pytest.raises(PlannerSettingError, match="timeout_s is"):
        Planner(timeout_s=bad)
    with pytest.raises(PlannerSettingError, match="delay_s is"):
        World(ways, delay_s=bad)
    with pytest.raises(PlannerSettingError, match="at_most_every_s is"):
        ReplanningPolicy(at_most_every_s=bad)
    with pytest.raises(GoalError, match=r"\(safe\) is worth (nan|inf)"):
        World(ways).executor.goals.add("(safe)", worth=bad)
    with pytest.raises(SensingError, match=r"\(near\) is"):
        Problem(ways, initial_state(ways) - {"(damp)"}, costs={"(near)": bad})


@pytest.mark.parametrize("amount", ["nan", "inf", "1e400"])
def test_a_file_with_what_is_no_number_to_reckon_with_is_refused_with_its_place(amount):
    with pytest.raises(PddlError, match=r"problem\.pddl:2:\d+: .*number"):
        parse_domain(WAYS, PROBLEM.replace("(= (far) 4)", f"(= (far) {amount})"))
