"""Goals that change while the plan is executed, soft goals, and which of several is out of reach."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pddl_world import World, load_text
from py_trees.common import Status

from rosa_pddl import (
    GoalError,
    Goals,
    PddlError,
    UnknownNameError,
    UnsupportedPddlError,
)

SITES = ("north", "south", "east")
DOMAIN = """(define (domain survey) (:requirements :typing :action-costs)
  (:types site)
  (:predicates (visited ?s - site) (photographed ?s - site) (open ?s - site) (home))
  (:functions (total-cost) - number (way ?s - site) - number)
  (:action visit :parameters (?s - site) :precondition (open ?s)
    :effect (and (visited ?s) (not (home)) (increase (total-cost) (way ?s))))
  (:action photograph :parameters (?s - site) :precondition (visited ?s)
    :effect (and (photographed ?s) (increase (total-cost) 1)))
  (:action return :parameters () :effect (and (home) (increase (total-cost) 2))))
"""
PROBLEM = """(define (problem p) (:domain survey) (:objects north south east - site)
  (:init (open north) (open south) (open east) (home)
    (= (total-cost) 0) (= (way north) 3) (= (way south) 4) (= (way east) 5))
  (:goal (and (visited north) (home)))
  (:metric minimize (total-cost)))
"""
WAY = {"north": 3, "south": 4, "east": 5}


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    return load_text(tmp_path_factory.mktemp("survey"), DOMAIN, PROBLEM)


@pytest.fixture
def world(survey):
    return World(survey)


def done(world):
    return [name for _, name, what in world.log if what == "SUCCESS"]


def test_the_goals_begin_as_the_problem_file_has_them(world):
    assert [str(goal) for goal in world.executor.goals] == ["(visited north)", "(home)"]


def test_a_goal_that_is_added_is_planned_for_and_what_runs_runs_on(world):
    world.ticks = {"visit": 9}
    world.run(until="visit")
    world.executor.goals.add("(photographed north)")
    assert world.run() is Status.SUCCESS
    assert done(world) == ["visit", "photograph", "return"]
    assert world.executor.plans[1].reason == (
        "the goals changed: the rest of the plan does not reach (photographed north)"
    )


def test_a_goal_that_is_dropped_is_not_pursued_any_more(world):
    world.executor.goals.add("(and (visited south) (visited east))")
    world.ticks = {"visit": 9}
    world.run(until="visit")
    world.executor.goals.drop("(visited east)")
    assert world.run() is Status.SUCCESS
    assert done(world) == ["visit", "visit", "return"]
    assert [record.reason for record in world.executor.plans] == ["start", "the goals changed"]


def test_other_goals_in_place_of_all_stop_what_serves_the_old_ones(world):
    world.ticks = {"visit": 9}
    world.run(until="visit")
    world.executor.goals.replace("(home)")
    assert world.run() is Status.SUCCESS
    assert [what for _, name, what in world.log if name == "visit"] in (
        ["begins", "INVALID"],
        ["begins", "SUCCESS"],
    )


def test_a_goal_added_after_success_is_pursued_in_the_next_round(world):
    assert world.run() is Status.SUCCESS
    world.executor.goals.add("(visited east)")
    assert world.run() is Status.SUCCESS
    assert done(world) == ["visit", "return", "visit", "return"]


def test_a_goal_without_a_plan_can_be_dropped_and_the_mission_goes_on(world):
    world.facts = {"(open east)": False}
    world.executor.goals.add("(visited east)")
    assert world.run() is Status.FAILURE
    message = world.executor.feedback_message
    assert message.endswith("; out of reach: (visited east)")
    world.executor.goals.drop("(visited east)")
    assert world.run() is Status.SUCCESS


def test_goals_that_exclude_one_another_are_said_to(world):
    world.facts = {"(open east)": False}
    world.executor.goals.replace("(photographed north)", "(not (visited north))")
    assert world.run() is Status.FAILURE
    assert "out of reach: (photographed north)" in world.executor.feedback_message


def test_a_goal_may_be_any_condition(world):
    world.executor.goals.replace(
        "(and (forall (?s - site) (imply (= ?s north) (visited ?s))) (exists (?s - site) (photographed ?s)))",
        "(or (visited south) (not (home)))",
    )
    assert world.run() is Status.SUCCESS
    assert done(world) == ["visit", "photograph"]


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("(visted north)", UnknownNameError, "no declared predicate; nearest: visited"),
        ("(visited nort)", UnknownNameError, "no declared object; nearest: north"),
        ("(visited ?s)", UnknownNameError, r"\?s"),
        ("(forall (?s - sit) (visited ?s))", UnknownNameError, "no declared type; nearest: site"),
        (
            "(forall (?s) (visited ?s))",
            UnknownNameError,
            r"are of other types than \(visited \?s - site\)",
        ),
        ("(not (home) (home))", PddlError, "it cannot be read"),
        ("visited north", PddlError, "expected"),
        ("(visited north", PddlError, "balanced"),
        ("()", PddlError, "expected a list"),
        ("", PddlError, "expected"),
        (42, GoalError, "42 is no goal, expected a condition as text such as"),
        (None, GoalError, "None is no goal, expected a condition as text such as"),
        (["(home)"], GoalError, "is no goal, expected a condition as text such as"),
        (
            "(> (way north) 3)",
            UnsupportedPddlError,
            "compares way, which no condition of the files does",
        ),
    ],
)
def test_a_goal_that_means_nothing_is_refused_and_the_goals_stay_as_they_were(
    world, text, error, message
):
    goals = world.executor.goals
    before = list(goals)
    version = goals.version
    for change in (goals.add, goals.drop, goals.replace):
        with pytest.raises(error, match=message):
            change(text)
    assert (list(goals), goals.version) == (before, version)


def test_dropping_what_is_no_goal_and_a_worth_of_nothing_are_refused(world):
    with pytest.raises(
        GoalError, match=r"\(visited east\) is not among the goals; nearest: \(visited north\)"
    ):
        world.executor.goals.drop("(visited east)")
    for worth in (0.0, -1, float("nan"), "5"):
        with pytest.raises(GoalError, match=f"worth {worth}, expected more than 0"):
            world.executor.goals.add("(visited east)", worth=worth)


# ------------------------------------------------------------------ soft goals


def test_a_soft_goal_is_pursued_if_it_is_worth_it_and_left_if_not(survey):
    cheap = World(survey)
    dear = World(survey)
    cheap.executor.goals.add("(photographed south)", worth=4.5)
    dear.executor.goals.add("(photographed south)", worth=5.5)
    assert (cheap.run(), dear.run()) == (Status.SUCCESS, Status.SUCCESS)
    assert done(cheap) == ["visit", "return"]
    assert sorted(done(dear)) == ["photograph", "return", "visit", "visit"]
    assert dear.executor.plans[0].steps == tuple(
        step for step in dear.executor.plans[0].steps if step.schema != "forgo"
    )


def test_a_soft_goal_that_cannot_be_reached_any_more_is_given_up_without_a_failure(world):
    world.executor.goals.add("(photographed south)", worth=50)
    world.run(until="visit")
    world.facts = {"(open south)": False, "(visited south)": False}
    assert world.run() is Status.SUCCESS
    assert "photograph" not in done(world)


def test_a_soft_goal_alone_is_planned_for_although_all_that_must_be_holds(world):
    world.executor.goals.replace("(home)")
    world.executor.goals.add("(visited north)", worth=9)
    assert world.run() is Status.SUCCESS
    assert done(world) == ["visit", "return"]


def test_a_goal_becomes_soft_and_hard_again(world):
    goals = world.executor.goals
    goals.add("(visited north)", worth=1)
    assert [str(goal) for goal in goals.soft] == ["(visited north) worth 1"]
    goals.add("(visited north)")
    assert goals.soft == ()
    assert [str(goal) for goal in goals] == ["(visited north)", "(home)"]


@given(numbers=st.lists(st.sampled_from(range(6)), max_size=8))
def test_adding_and_dropping_leaves_the_goals_that_were_added_last(survey, numbers):
    goals = Goals(survey)
    goals.replace()
    kept: dict[str, None] = {}
    for number in numbers:
        text = f"(visited {SITES[number % 3]})"
        if text in kept:
            goals.drop(text)
            del kept[text]
        else:
            goals.add(text)
            kept[text] = None
    assert [goal.text for goal in goals] == list(kept)
