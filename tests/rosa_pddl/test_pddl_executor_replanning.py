"""When the executor plans anew, what runs meanwhile, and what it says when nothing helps."""

from concurrent.futures import Future

import numpy as np
import pytest
from pddl_world import World, load_text
from py_trees.common import Status

from kb import KnowledgeBase, Model
from rosa_pddl import (
    Outcome,
    PlannerSettingError,
    PlanningResult,
    ReplanningPolicy,
    SensingError,
)

WAYS = """(define (domain ways) (:requirements :typing)
  (:types action)
  (:predicates (action_feasible ?a - action) (left_action ?a - action) (right_action ?a - action) (open) (half) (there))
  (:action start :parameters () :effect (half))
  (:action left :parameters (?a - action)
    :precondition (and (half) (left_action ?a) (action_feasible ?a)) :effect (there))
  (:action right :parameters (?a - action)
    :precondition (and (half) (right_action ?a) (action_feasible ?a)) :effect (and (not (half)) (there)))
  (:action shortcut :parameters () :precondition (open) :effect (there)))
"""
PROBLEM = """(define (problem go) (:domain ways) (:objects left right - action)
  (:init (left_action left) (right_action right)) (:goal (there)))
"""


@pytest.fixture(scope="module")
def ways(tmp_path_factory):
    return load_text(tmp_path_factory.mktemp("ways"), WAYS, PROBLEM)


def world_of(ways, **policy):
    world = World(ways, policy=ReplanningPolicy(**policy))
    world.kb.unfeasible = {"right"}
    world.ticks = {"start": 12}
    return world


def begun(world):
    return [name for _, name, what in world.log if what == "begins"]


def test_a_running_step_that_the_new_plan_starts_with_runs_on(ways):
    world = world_of(ways)
    world.run(until="start")
    world.kb.unfeasible = {"left"}
    assert world.run() is Status.SUCCESS
    assert world.plans() == [["start", "left"], ["start", "right"]]
    assert world.executor.plans[1].reason == "left is unfeasible"
    assert [entry for entry in world.log if entry[1] == "start"] == [
        (0.2, "start", "begins"),
        (1.3, "start", "SUCCESS"),
    ]


def test_when_there_is_no_way_on_what_runs_is_stopped_and_it_fails(ways):
    world = world_of(ways)
    world.ticks = {"start": 1000}
    world.run(until="start")
    world.kb.unfeasible = {"left", "right"}
    assert world.run() is Status.FAILURE
    assert world.log[-1][1:] == ("start", "INVALID")
    assert world.now_s < 1.0


def test_a_step_that_ends_while_the_plan_is_made_is_not_done_again(ways):
    world = world_of(ways)
    world.ticks = {"start": 3}
    world.run(until="start")
    world.kb.unfeasible = {"left"}
    assert world.run() is Status.SUCCESS
    assert begun(world) == ["start", "right"]
    assert world.plans()[1] == ["start", "right"]


def test_plans_are_asked_for_no_more_often_than_the_policy_allows(ways):
    world = world_of(ways, at_most_every_s=2.0)
    world.ticks = {"start": 1}
    world.events = {"left": Status.FAILURE}
    world.run(until="left")
    world.kb.unfeasible = {"right"}
    while world.executor.current_steps:
        world.tick()
    assert world.executor.feedback_message.startswith("planning in 1.")
    assert "left(left) failed" in world.executor.feedback_message
    assert world.run() is Status.SUCCESS
    assert [record.at_s for record in world.executor.plans] == [0.0, pytest.approx(2.0)]


def test_a_goal_that_no_situation_allows_is_said_to_be_out_of_reach_whatever_is_feasible(ways):
    world = World(ways)
    world.kb.unfeasible = {"left", "right"}
    world.executor.goals.replace("(open)")
    assert world.run() is Status.FAILURE
    assert world.executor.feedback_message.endswith(
        "there would be no plan even if every action were feasible"
    )


ROADS = """(define (domain roads) (:requirements :action-costs) (:predicates (there) (half) (closed))
  (:functions (total-cost) - number (toll) - number)
  (:action pay :parameters () :effect (and (there) (increase (total-cost) (toll))))
  (:action around :parameters () :effect (and (half) (increase (total-cost) 2)))
  (:action back :parameters () :precondition (half) :effect (and (there) (increase (total-cost) 2))))
"""
ROADS_PROBLEM = """(define (problem p) (:domain roads) (:init (= (toll) 1) (= (total-cost) 0)) (:goal (there))
  (:metric minimize (total-cost)))
"""


@pytest.fixture(scope="module")
def roads(tmp_path_factory):
    return load_text(tmp_path_factory.mktemp("roads"), ROADS, ROADS_PROBLEM)


@pytest.mark.parametrize("toll", [9, 9.0, np.float32(9.0), np.int64(9)])
def test_with_the_numbers_that_are_sensed_another_plan_is_the_best(roads, toll):
    cheap = World(roads)
    dear = World(roads)
    dear.facts = {"(TOLL)": toll, "(closed)": np.bool_(True)}
    assert (cheap.run(), dear.run()) == (Status.SUCCESS, Status.SUCCESS)
    assert (cheap.plans(), dear.plans()) == ([["pay"]], [["around", "back"]])


def test_a_number_that_is_not_mentioned_any_more_stays_what_it_was(roads):
    world = World(roads)
    world.facts = {"(toll)": 9.0}
    world.tick()
    world.facts = {}
    world.executor.stop(Status.INVALID)
    assert world.run() is Status.SUCCESS
    assert begun(world) == ["around", "back"]


@pytest.mark.parametrize(
    ("sensed", "message"),
    [
        ({"(toll)": True}, r"sense returned True for \(toll\), expected a finite number"),
        ({"(toll)": float("nan")}, r"nan for \(toll\), expected a finite number"),
        ({"(toll)": "9"}, r"'9' for \(toll\), expected a finite number"),
        ({"(closed)": 1}, r"1 for \(closed\), expected True or False"),
        ({"(closed)": None}, r"None for \(closed\), expected True or False"),
        (None, r"sense returned None, expected a mapping"),
    ],
)
def test_what_is_sensed_and_makes_no_sense_is_an_error_that_says_what_was_expected(
    roads, sensed, message
):
    world = World(roads)
    world.run(until="pay")
    world.facts = sensed
    with pytest.raises(SensingError, match=message):
        world.tick()
    assert world.log[-1][1:] == ("pay", "INVALID")


# ------------------------------------------------------------------ the decision, which is pure


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"at_most_every_s": -1.0}, "at_most_every_s is -1"),
        ({"overrun": 1.0}, "overrun is 1"),
    ],
)
def test_a_policy_that_makes_no_sense_is_refused(setting, message):
    with pytest.raises(PlannerSettingError, match=message):
        ReplanningPolicy(**setting)


# ------------------------------------------------------------------ engines that misbehave


class Answering:
    """Gives the same answer to everything, at once."""

    timeout_s = 1.0

    def __init__(self, result):
        self.result = result

    def start(self, problem):
        future = Future()
        future.set_result(self.result)
        return future


@pytest.mark.parametrize("outcome", [outcome for outcome in Outcome if outcome.is_trouble])
def test_trouble_of_any_kind_fails_by_name_and_ticks_go_on(ways, outcome):
    world = World(ways, Answering(PlanningResult(outcome, engine="odd", message="it said nothing")))
    for _ in range(40):
        world.executor.tick_once()
        world.tick_number += 1
        if world.executor.status is Status.FAILURE:
            break
    assert world.executor.status is Status.FAILURE
    tried = "; tried 4 times, again in 1.6 s at the earliest" if outcome.is_passing else ""
    assert world.executor.feedback_message == f"no plan, {outcome}: it said nothing{tried}"


def test_a_plan_of_a_planner_of_ones_own_that_does_not_work_is_not_executed_nor_asked_for_again(
    ways,
):
    nonsense = PlanningResult(Outcome.SOLVED, (ways.step("left", ["left"]),))
    world = World(ways, Answering(nonsense))
    assert [world.tick() for _ in range(6)][-1] is Status.FAILURE
    assert world.log == []
    assert len(world.executor.plans) == 1
    assert (
        "cannot be done event by event: left(left) needs (half)" in world.executor.feedback_message
    )


class Raising(Answering):
    def start(self, problem):
        raise RuntimeError("no process could be started")


def test_a_planner_that_cannot_even_begin_is_a_failure_by_name(ways):
    world = World(ways, Raising(None), delay_s=None)
    assert world.run() is Status.FAILURE
    said = "no plan, engine crashed: RuntimeError: no process could be started; tried 4 times"
    assert world.executor.feedback_message.startswith(said)


# ------------------------------------------------------------------ what led to a plan, and answers that come at once


def test_a_plan_names_the_event_of_the_log_that_took_or_gave_feasibility(extended):
    model = Model("small")
    energy = model.quality_attribute("energy")
    for name in extended.rosa_actions:
        model.action(name, constraints=[] if name == "recharge" else [energy >= 0.2])
    kb = KnowledgeBase(model, clock=lambda: 0.0)
    world = World(extended, kb=lambda _: kb)
    world.run(until="search_pipeline")
    kb.measure("energy", 0.5)
    world.tick()
    kb.measure("energy", 0.1)
    lost = kb.log.last
    world.tick()
    world.run(until="recharge")
    first, second = world.executor.plans
    assert (first.cause, second.cause) == (None, lost)
    assert second.reason == "search_pipeline became unfeasible"
