"""Temporal plans: steps overlap as the causal order of the plan allows, whatever they really take."""

from itertools import permutations

import pytest
from pddl_world import World, load_text
from py_trees.common import Status

from rosa_pddl import (
    Outcome,
    Planner,
    PlanningResult,
    Problem,
    TimedStep,
    flaw,
    initial_state,
    parse_domain,
)
from rosa_pddl.plan_monitor import PlanExecution
from rosa_pddl.validate import StepEvent

DOMAIN = """(define (domain rig) (:requirements :durative-actions)
  (:types action tool)
  (:predicates (action_feasible ?a - action) (light_action ?a - action) (mend_action ?a - action)
    (lit) (dark) (mended) (free ?t - tool) (washed ?t - tool) (packed))
  (:durative-action light :parameters (?a - action) :duration (= ?duration 8)
    :condition (and (over all (light_action ?a)) (over all (action_feasible ?a)) (at start (dark)))
    :effect (and (at start (not (dark))) (at start (lit)) (at end (not (lit))) (at end (dark))))
  (:durative-action mend :parameters (?a - action) :duration (= ?duration 5)
    :condition (and (over all (lit)) (over all (mend_action ?a)) (over all (action_feasible ?a)))
    :effect (at end (mended)))
  (:durative-action wash :parameters (?t - tool) :duration (= ?duration 3)
    :condition (at start (free ?t))
    :effect (and (at start (not (free ?t))) (at end (free ?t)) (at end (washed ?t))))
  (:durative-action pack :parameters (?s ?t - tool) :duration (= ?duration 1)
    :condition (and (at start (washed ?s)) (at start (washed ?t)) (at start (not (= ?s ?t))) (at start (mended)))
    :effect (at end (packed))))
"""
PROBLEM = """(define (problem p) (:domain rig) (:objects light mend - action saw drill - tool)
  (:init (light_action light) (mend_action mend) (dark) (free saw) (free drill))
  (:goal (packed)) (:metric minimize (total-time)))
"""


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    return load_text(tmp_path_factory.mktemp("rig"), DOMAIN, PROBLEM)


@pytest.fixture(scope="module")
def aries():
    """It remembers what it has answered, as all these worlds begin alike."""
    return Planner("kairos", 300.0, overlapping=True)


@pytest.fixture
def world(rig, aries):
    return World(rig, aries)


def times(world, what):
    return {name: at_s for at_s, name, happened in world.log if happened == what}


@pytest.mark.parametrize(
    "ticks", [{"light": 20, "mend": 10, "wash": 5}, {"light": 9, "mend": 2, "wash": 30}]
)
def test_what_must_overlap_does_and_what_waits_for_others_waits_however_long_they_take(
    world, ticks
):
    world.ticks = ticks
    assert world.run() is Status.SUCCESS
    begins = times(world, "begins")
    ends = times(world, "SUCCESS")
    assert begins["light"] <= begins["mend"] < ends["mend"] <= ends["light"]
    assert begins["wash"] < ends["light"]
    assert begins["pack"] >= max(ends["wash"], ends["mend"])
    assert len(world.executor.plans) == 1


def test_two_runs_with_overlapping_steps_are_the_same(rig, aries):
    def run(planner):
        world = World(rig, planner)
        world.ticks = {"light": 20, "mend": 10, "wash": 5}
        world.run()
        return world.log

    assert run(aries) == run(Planner("kairos", 300.0, overlapping=True))


# ------------------------------------------------------------------ what is provided only for a while

CELLAR = """(define (domain cellar) (:requirements :durative-actions) (:types fuse match)
  (:predicates (lit ?m - match) (unused ?m - match) (mended ?f - fuse) (free))
  (:durative-action light :parameters (?m - match) :duration (= ?duration 8)
    :condition (at start (unused ?m))
    :effect (and (at start (not (unused ?m))) (at start (lit ?m)) (at end (not (lit ?m)))))
  (:durative-action mend :parameters (?f - fuse ?m - match) :duration (= ?duration 5)
    :condition (and (over all (lit ?m)) (at start (free)))
    :effect (and (at start (not (free))) (at end (mended ?f)) (at end (free)))))
"""
FUSES = """(define (problem p) (:domain cellar) (:objects one two - fuse red blue - match)
  (:init (unused red) (unused blue) (free)) (:goal (and (mended one) (mended two))))
"""


@pytest.fixture(scope="module")
def cellar():
    return parse_domain(CELLAR, FUSES)


@pytest.mark.parametrize("ticks", [{"light": 8, "mend": 5}, {"light": 12, "mend": 10}])
def test_a_match_is_not_lit_before_the_fuse_box_is_free(cellar, aries, ticks):
    world = World(cellar, aries)
    world.ticks = ticks
    assert world.run() is Status.SUCCESS
    assert len(world.executor.plans) == 1


# The match goes out as the first fuse is mended; the second is begun as the next match is lit.
SCHEDULE = (("light", "red", 0.0, 8.0), ("mend", "one red", 3.0, 5.0), ("light", "blue", 8.1, 8.0))
SCHEDULE += (("mend", "two blue", 8.1, 5.0),)


@pytest.mark.parametrize("order", list(permutations(range(4))))
def test_a_schedule_that_the_judge_accepts_can_be_executed_in_whatever_order_it_is_written(
    cellar, order
):
    listed = [SCHEDULE[number] for number in order]
    schedule = [
        TimedStep(cellar.step(name, words.split()), at_s, took_s)
        for name, words, at_s, took_s in listed
    ]
    state = initial_state(cellar)
    assert flaw(cellar, schedule, state) is None
    steps = tuple(timed.step for timed in schedule)
    plan = PlanExecution.of(
        cellar, PlanningResult(Outcome.SOLVED, steps, schedule=tuple(schedule)), ()
    )
    assert plan.prediction(cellar, state).flaw is None
    number = {str(step): number for number, step in enumerate(plan.steps)}
    second_match = number["light(blue)"]
    second_fuse = number["mend(two, blue)"]
    assert StepEvent(second_match, False) in plan.after[second_fuse], (
        "it needs the light from the beginning"
    )
    assert StepEvent(number["mend(one, red)"], True) in plan.after[second_match], (
        "it would be out too early"
    )


SWITCHED = """(define (domain d) (:requirements :durative-actions) (:predicates (lit) (mended))
  (:action switch_on :parameters () :precondition () :effect (lit))
  (:durative-action mend :parameters () :duration (= ?duration DURATION)
    :condition (over all (lit)) :effect (at end (mended))))
"""


@pytest.mark.parametrize("duration", [5.0])
@pytest.mark.parametrize("names", [("switch_on", "mend"), ("mend", "switch_on")])
def test_a_step_waits_for_what_is_over_at_once_and_provides_what_it_needs_all_the_time(
    duration, names
):
    lamp = parse_domain(
        SWITCHED.replace("DURATION", f"{duration:.7f}"),
        "(define (problem p) (:domain d) (:init) (:goal (mended)))",
    )
    took_s = {"switch_on": 0.0, "mend": duration}
    schedule = tuple(TimedStep(lamp.step(name, ()), 0.0, took_s[name]) for name in names)
    state = initial_state(lamp)
    assert flaw(lamp, schedule, state) is None
    steps = tuple(timed.step for timed in schedule)
    plan = PlanExecution.of(lamp, PlanningResult(Outcome.SOLVED, steps, schedule=schedule), ())
    assert plan.prediction(lamp, state).flaw is None
    switch_on = names.index("switch_on")
    mend = names.index("mend")
    assert StepEvent(switch_on, True) in plan.after[mend]
    assert plan.startable == (switch_on,)


def test_a_step_may_need_what_a_cure_at_its_start_makes_last():
    lamp = parse_domain(
        SWITCHED.replace("DURATION", "5"),
        "(define (problem p) (:domain d) (:init (lit)) (:goal (mended)))",
    )
    state = initial_state(lamp)
    switch = TimedStep(lamp.step("switch_on", ()), 2.0, 0.0)
    mend = TimedStep(lamp.step("mend", ()), 2.0, 5.0)
    assert flaw(lamp, [switch, mend], state, until={"(lit)": 1.0}) is None
    assert "too late by 6 s" in flaw(lamp, [mend], state, until={"(lit)": 1.0})
    later = switch._replace(start_s=3.0)
    assert "too late by 6 s" in flaw(lamp, [mend, later], state, until={"(lit)": 1.0})


def test_that_there_is_no_plan_without_overlapping_is_no_proof_and_says_what_would_do(cellar):
    result = Planner().plan(Problem(cellar, initial_state(cellar)))
    assert result.outcome is Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN
    assert "Planner(overlapping=True)" in result.message
