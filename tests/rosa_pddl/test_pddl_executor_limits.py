"""Limited resources while a plan runs: what is used up is believed or sensed; a plan that is too much is replaced."""

from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pddl_world import World, load_text
from py_trees.common import Status

from rosa_pddl import Outcome, Planner, Problem, ReplanningPolicy, initial_state, parse_domain
from rosa_pddl.resource_usage import ResourceUsage, usage_of

# Each leg can be driven, quickly and with much energy, or crept.
DOMAIN = """(define (domain legs) (:requirements :typing :action-costs :numeric-fluents)
  (:types place)
  (:predicates (at ?p - place) (next ?p ?q - place) (closed ?p - place))
  (:functions (total-cost) - number (used) - number (left) - number (need ?p - place) - number)
  (:action drive :parameters (?p ?q - place) :precondition (and (at ?p) (next ?p ?q) (not (closed ?q)))
    :effect (and (not (at ?p)) (at ?q) (increase (total-cost) 1) (increase (used) (need ?p))))
  (:action creep :parameters (?p ?q - place) :precondition (and (at ?p) (next ?p ?q) (not (closed ?q)))
    :effect (and (not (at ?p)) (at ?q) (increase (total-cost) 5) (increase (used) 0.1))))
"""
PROBLEM = """(define (problem p) (:domain legs) (:objects a b c d - place)
  (:init (at a) (next a b) (next b c) (next c d) (= (total-cost) 0) (= (used) 0) (= (left) {left})
         (= (need a) 0.2) (= (need b) 0.2) (= (need c) 0.2))
  (:goal (and (at d) (<= (used) (left)))) (:metric minimize (total-cost)))
"""


@pytest.fixture(scope="module")
def legs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("legs")
    return {
        left: load_text(folder, DOMAIN, PROBLEM.format(left=left)) for left in ("0.2", "0.4", "0.6")
    }


def world_of(domain, **policy):
    return World(domain, Planner("label-setting"), policy=ReplanningPolicy(**policy))


def begun(world):
    return [name for _, name, what in world.log if what == "begins"]


@pytest.mark.parametrize(("left", "drives"), [("0.6", 3), ("0.4", 1)])
def test_the_plan_keeps_to_the_limit_exactly(legs, left, drives):
    world = world_of(legs[left])
    assert world.run() is Status.SUCCESS
    assert begun(world).count("drive") == drives
    assert len(world.executor.plans) == 1
    assert world.executor._belief.numbers["(used)"] == (0.6 if drives == 3 else 0.4)


def test_what_was_used_before_counts_when_it_is_planned_anew(legs):
    world = world_of(legs["0.4"])
    world.run()
    world.executor.goals.replace("(at b)")
    world.facts = {"(next d b)": True, "(need d)": 0.1}
    assert world.run() is Status.FAILURE
    assert "unsolvable proven" in world.executor.feedback_message
    world.facts = {"(next d b)": True, "(left)": 0.5}
    assert world.run() is Status.SUCCESS


def test_a_step_that_was_given_up_counts_too(legs):
    world = world_of(legs["0.6"])
    world.events = {"drive": Status.FAILURE}
    assert world.run() is Status.SUCCESS
    assert begun(world).count("creep") == 2
    assert world.executor._belief.numbers["(used)"] == 0.6


def test_when_less_is_left_than_the_rest_of_the_plan_uses_it_is_planned_anew(legs):
    world = world_of(legs["0.6"])
    world.facts = {"(used)": 0.0, "(left)": 0.6}
    world.run(until="drive")
    world.facts = {"(used)": 0.2, "(left)": 0.5}
    assert world.run() is Status.SUCCESS
    assert world.executor.plans[1].reason == (
        "the rest of the plan is too much: it uses 0.4 of used, 0.3 are left"
    )
    assert sorted(begun(world)) == ["creep", "drive", "drive"]


def test_what_a_running_step_has_used_of_what_is_sensed_is_no_reason(legs):
    world = world_of(legs["0.6"])
    world.ticks = {"drive": 5}
    world.facts = {"(left)": 0.6, "(used)": 0.0}
    world.run(until="drive")
    world.facts = {"(left)": 0.6, "(used)": 0.15}
    for _ in range(3):
        world.tick()
    assert len(world.executor.plans) == 1


def test_there_is_a_plan_again_once_more_is_left(legs):
    world = world_of(legs["0.2"])
    assert world.run() is Status.FAILURE
    assert [world.tick() for _ in range(3)] == [Status.FAILURE] * 3
    assert len(world.executor.plans) == 1
    assert world.executor.feedback_message.endswith(
        "there would be a plan without the limits of used"
    )
    for left in (0.15, 0.1, 0.2):  # that there is still less changes nothing
        world.facts = {"(left)": left}
        assert world.tick() is Status.FAILURE
    assert len(world.executor.plans) == 1
    world.facts = {"(left)": 0.3}
    assert world.run() is Status.SUCCESS
    assert begun(world) == ["creep"] * 3


def test_limits_that_are_not_in_the_way_are_said_not_to_be(legs):
    world = world_of(legs["0.2"])
    world.facts = {"(next c d)": False}
    assert world.run() is Status.FAILURE
    assert "without the limits" not in world.executor.feedback_message


@pytest.mark.parametrize("ticks", [1, 2, 3])
def test_more_that_is_left_while_it_is_planned_is_a_reason_to_ask_again(legs, ticks):
    world = world_of(legs["0.2"])
    for _ in range(ticks):
        assert world.tick() is Status.RUNNING
    world.facts = {"(left)": 0.3}
    assert world.run() is Status.SUCCESS
    assert begun(world) == ["creep"] * 3


@pytest.mark.parametrize("better", [{"(need b)": 0.1}, {"(used)": -0.2}, {"(left)": 0.21}])
def test_what_could_leave_more_is_a_reason_to_look_for_a_plan_again(legs, better):
    world = world_of(legs["0.2"])
    world.facts = {"(used)": 0.0, "(need b)": 0.2}
    world.run()
    world.facts |= better
    assert world.tick() is Status.RUNNING


NUMBERS = st.fixed_dictionaries(
    {f"({key})": st.integers(0, 5).map(float) for key in ("left", "used", "need a", "need b")}
)


@given(then=NUMBERS, now=NUMBERS)
def test_numbers_that_leave_no_more_break_a_limit_whenever_the_others_did(legs, then, now):
    domain = legs["0.6"]
    usage = ResourceUsage(domain)
    if usage.leave_no_more(now, then):
        for steps in product(("drive", "creep"), repeat=2):
            plan = [
                domain.step(one, words)
                for one, words in zip(steps, (("a", "b"), ("b", "c")), strict=True)
            ]
            assert usage.overspent(then, plan) is None or usage.overspent(now, plan) is not None


def test_a_plan_within_a_limit_that_a_state_gives_is_believed():
    domain = parse_domain(
        """(define (domain d) (:predicates (done)) (:functions (used) (room))
          (:action work :parameters () :precondition (> (room) 1) :effect (and (done) (increase (used) 5))))""",
        "(define (problem p) (:domain d) (:init (= (used) 0) (= (room) 4)) (:goal (and (done) (<= (used) (room)))))",
    )
    roomy = initial_state(domain) - {"(= (room) 4)"} | {"(= (room) 50)"}
    planner = Planner("label-setting", cached=0)
    assert planner.plan(Problem(domain, roomy)).outcome is Outcome.SOLVED_OPTIMALLY
    assert planner.plan(Problem(domain, initial_state(domain))).outcome is Outcome.UNSOLVABLE_PROVEN


def test_what_every_action_denies_may_be_looked_at_by_an_effect():
    domain = parse_domain(
        """(define (domain d) (:requirements :conditional-effects) (:predicates (done) (wet) (odd))
          (:action work :parameters () :precondition (not (wet)) :effect (and (done) (when (wet) (odd)))))""",
        "(define (problem p) (:domain d) (:init) (:goal (done)))",
    )
    wet = frozenset({"(wet)"})
    for state, outcome in (
        (frozenset(), Outcome.SOLVED_OPTIMALLY),
        (wet, Outcome.UNSOLVABLE_PROVEN),
    ):
        assert Planner("label-setting", cached=0).plan(Problem(domain, state)).outcome is outcome


def test_what_steps_use_is_worked_out_once_for_each_of_many_robots():
    domains = [parse_domain(DOMAIN, PROBLEM.format(left=number)) for number in range(20)]
    usages = [usage_of(domain) for domain in domains]
    assert all(usage_of(domain) is usage for domain, usage in zip(domains, usages, strict=True))
