"""When the executor plans anew, what runs meanwhile, and what it says when nothing helps."""

import gc
import tracemalloc
from concurrent.futures import Future

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pddl_world import World, load_text
from py_trees.common import Status

from kb import KnowledgeBase, Model
from rosa_pddl import (
    Outcome,
    Planner,
    PlannerSettingError,
    PlanningResult,
    PlanRecord,
    ReplanningPolicy,
    SensingError,
)
from rosa_pddl.replanning import MEMORY, decide

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


def test_a_long_mission_keeps_the_last_plannings_with_their_numbers_and_does_not_grow(ways):
    world = World(ways, memory=20)
    world.kb.unfeasible = {"right"}
    world.ticks = {"start": 1_000_000}
    held = []
    tracemalloc.start()
    for count in (300, 300):
        for _ in range(count):
            world.kb.unfeasible = {"left", "right"} - world.kb.unfeasible
            for _ in range(4):
                world.tick()
        gc.collect()
        held.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    numbers = [record.number for record in world.executor.plans]
    assert len(numbers) == 20
    assert numbers == list(range(numbers[0], numbers[0] + 20))
    assert numbers[0] > 500
    assert held[1] - held[0] < 20_000


def test_of_many_plannings_the_oldest_are_forgotten_unless_asked_otherwise(ways):
    plans = ()
    for number in range(MEMORY + 50):
        plans = PlanRecord(float(number), "why", Outcome.SOLVED, (), "engine").added_to(plans)
    assert (len(plans), plans[0].number, plans[0].at_s, plans[-1].number) == (
        MEMORY,
        51,
        50.0,
        MEMORY + 50,
    )
    with pytest.raises(PlannerSettingError, match="memory is 0, expected a whole number"):
        World(ways, memory=0)


def test_when_there_is_no_way_on_what_runs_is_stopped_and_it_fails(ways):
    world = world_of(ways)
    world.ticks = {"start": 1000}
    world.run(until="start")
    world.kb.unfeasible = {"left", "right"}
    assert world.run() is Status.FAILURE
    assert world.log[-1][1:] == ("start", "INVALID")
    assert world.now_s < 1.0


def test_a_policy_that_holds_stops_it_and_starts_it_again(ways):
    world = world_of(ways, while_planning="hold")
    world.run(until="start")
    world.kb.unfeasible = {"left"}
    assert world.run() is Status.SUCCESS
    assert [what for _, name, what in world.log if name == "start"] == [
        "begins",
        "INVALID",
        "begins",
        "SUCCESS",
    ]


def test_a_step_that_ends_while_the_plan_is_made_is_not_done_again(ways):
    world = world_of(ways)
    world.ticks = {"start": 3}
    world.run(until="start")
    world.kb.unfeasible = {"left"}
    assert world.run() is Status.SUCCESS
    assert begun(world) == ["start", "right"]
    assert world.plans()[1] == ["start", "right"]


def test_something_better_is_looked_for_only_if_the_policy_says_so(ways):
    patient, eager = world_of(ways), world_of(ways, eager=True)
    for world in (patient, eager):
        world.run(until="start")
        world.facts = {"(open)": True}
        assert world.run() is Status.SUCCESS
    assert begun(patient) == ["start", "left"]
    assert begun(eager) == ["start", "shortcut"]
    assert eager.executor.plans[1].reason == "something better may be possible: (open)"
    assert ("start", "INVALID") in [(name, what) for _, name, what in eager.log]


def test_a_plan_that_is_not_better_changes_nothing(ways):
    world = world_of(ways, eager=True)
    world.run(until="start")
    world.kb.unfeasible = set()
    assert world.run() is Status.SUCCESS
    assert [record.reason for record in world.executor.plans] == [
        "start",
        "something better may be possible: (action_feasible right)",
    ]
    assert begun(world) == ["start", "left"]


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


class Safe:
    """A planner that finds nothing until told otherwise, and knows what to do meanwhile."""

    timeout_s = 120.0

    def __init__(self, domain):
        self.planner = Planner(safe_step="(start)")
        self.domain = domain

    def start(self, problem):
        return self.planner.start(problem)


def test_while_there_is_no_plan_the_safe_step_is_done(ways):
    world = World(ways, Safe(ways))
    world.ticks = {"start": 5}
    world.kb.unfeasible = {"left", "right"}
    world.run(until="start")
    assert world.executor.plans[0].outcome is Outcome.UNSOLVABLE_PROVEN
    world.tick()
    world.kb.unfeasible = {"right"}
    assert world.run() is Status.SUCCESS
    assert begun(world) == ["start", "left"]


def test_when_the_safe_step_is_done_and_nothing_has_changed_it_fails_by_name(ways):
    world = World(ways, Safe(ways))
    world.facts = {"(half)": True}
    world.kb.unfeasible = {"left", "right"}
    assert world.run() is Status.FAILURE
    assert begun(world) == ["start"]
    assert "unsolvable proven" in world.executor.feedback_message


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
    cheap, dear = World(roads), World(roads)
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


@pytest.mark.parametrize("eager", [True, False])
def test_a_number_that_changed_is_news_to_an_eager_executor_only(roads, eager):
    world = World(roads, policy=ReplanningPolicy(eager=eager))
    world.ticks = {"pay": 20}
    world.run(until="pay")
    world.facts = {"(toll)": 9.0}
    assert world.run() is Status.SUCCESS
    assert begun(world) == (["pay", "around", "back"] if eager else ["pay"])
    if eager:
        assert world.executor.plans[1].reason == "something better may be possible: (toll) is 9"


LOADS = """(define (domain loads) (:predicates (picked) (open) (there))
  (:functions (total-cost) (load) (speed))
  (:action pick :effect (and (picked) (increase (load) 5) (increase (total-cost) 1)))
  (:action carry :precondition (picked) :effect (and (there) (increase (total-cost) (/ (load) (speed)))))
  (:action crane :precondition (and (picked) (open)) :effect (and (there) (increase (total-cost) 3))))
"""
LOADS_PROBLEM = """(define (problem p) (:domain loads) (:init (= (load) 0) (= (speed) 1)) (:goal (there))
  (:metric minimize (total-cost)))
"""


@pytest.fixture(scope="module")
def loads(tmp_path_factory):
    return load_text(tmp_path_factory.mktemp("loads"), LOADS, LOADS_PROBLEM)


def carrying(loads):
    world = World(loads, policy=ReplanningPolicy(eager=True))
    world.ticks = {"carry": 9}
    world.run(until="carry")
    world.facts = {"(open)": True}
    return world


def test_plans_are_compared_by_what_steps_cost_with_the_numbers_that_have_changed_by_now(loads):
    world = carrying(loads)
    assert world.run() is Status.SUCCESS
    assert begun(world) == ["pick", "carry", "crane"]


def test_where_it_is_not_known_what_a_step_costs_the_plan_stays(loads):
    world = carrying(loads)
    world.tick()
    world.facts = {"(open)": True, "(speed)": 0.0}  # while the answer is on its way
    assert world.run() is Status.SUCCESS
    assert begun(world) == ["pick", "carry"]
    assert Outcome.SOLVED_OPTIMALLY in [record.outcome for record in world.executor.plans[1:]]


@pytest.mark.parametrize(
    ("sensed", "message"),
    [
        ({"(toll)": True}, r"sense returned True for \(toll\), expected a number"),
        ({"(toll)": float("nan")}, r"nan for \(toll\), expected a finite number"),
        ({"(toll)": "9"}, r"'9' for \(toll\), expected a number"),
        ({"(closed)": 1}, r"1 for \(closed\), expected True or False"),
        ({"(closed)": None}, r"None for \(closed\), expected True or False"),
        ({3: True}, r"sense returned 3: True, expected a text"),
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

REASONS = st.sampled_from([None, "late", "blocked"])
POLICIES = st.builds(
    ReplanningPolicy, st.booleans(), st.floats(0.0, 9.0), st.sampled_from(["hold", "continue"])
)


@given(policy=POLICIES, flaw=REASONS, changed=st.booleans(), news=REASONS)
def test_a_plan_is_given_up_exactly_when_it_has_a_flaw(policy, flaw, changed, news):
    decision = decide(policy, flaw=flaw, goals_changed=changed, news=news)
    assert (decision is not None and decision.is_needed) == (flaw is not None)
    assert (decision is None) == (
        flaw is None and not changed and not (policy.eager and news is not None)
    )


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"at_most_every_s": -1.0}, "at_most_every_s is -1"),
        ({"while_planning": "wait"}, "'continue' or 'hold'"),
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


def test_in_real_time_a_planner_that_never_answers_is_out_of_time(ways):
    class Silent(Answering):
        def start(self, problem):
            self.future = Future()
            return self.future

    planner = Silent(None)
    world = World(ways, planner, delay_s=None)
    assert world.run() is Status.FAILURE
    assert world.executor.feedback_message.startswith(
        "no plan, out of time: Silent gave no answer in 3.1 s"
    )
    assert planner.future.cancelled()


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


def test_what_a_planner_answers_at_once_is_begun_in_the_same_tick_unless_there_is_a_delay(extended):
    planner = Planner()
    World(extended, planner).run(until="search_pipeline")  # now the task is translated
    world = World(extended, planner, delay_s=None)
    world.tick()
    assert world.executor.current_steps[0].schema == "search_pipeline"
    world = World(extended, planner)
    world.tick()
    assert not world.executor.current_steps
