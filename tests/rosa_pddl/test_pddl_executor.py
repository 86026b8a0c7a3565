from concurrent.futures import Future

import py_trees
import pytest
from pddl_world import Task, World
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Selector, Sequence
from py_trees.trees import BehaviourTree

from rosa_pddl import (
    Outcome,
    Planner,
    PlanningBudgetError,
    ReplanningPolicy,
    UnknownNameError,
)

BOTH = {"search_pipeline", "inspect_pipeline"}


class CountingPlanner(Planner):
    def __init__(self):
        super().__init__()
        self.count = 0

    def start(self, problem):
        self.count += 1
        return super().start(problem)


@pytest.fixture
def world(extended):
    return World(extended, CountingPlanner())


def happened(world):
    return [(name, what) for _, name, what in world.log]


def test_the_plan_is_executed_step_by_step_to_success(world):
    assert world.run() is Status.SUCCESS
    assert world.log == [
        (0.2, "search_pipeline", "begins"),
        (0.4, "search_pipeline", "SUCCESS"),
        (0.4, "inspect_pipeline", "begins"),
        (0.6, "inspect_pipeline", "SUCCESS"),
    ]
    (record,) = world.executor.plans
    assert (record.at_s, record.reason, record.outcome) == (0.0, "start", Outcome.SOLVED_OPTIMALLY)
    assert [str(step) for step in record.steps] == [
        "search_pipeline(search_pipeline, pipeline, bluerov)",
        "inspect_pipeline(inspect_pipeline, pipeline, bluerov)",
    ]
    assert (record.engine, record.steps[0].action) == ("search", "search_pipeline")
    assert not world.executor.current_steps


def test_a_goal_that_holds_already_needs_no_planning(world):
    world.facts = {"(pipeline_inspected pipeline)": True}
    assert world.tick() is Status.SUCCESS
    assert (world.executor._planner.count, world.executor.plans, world.log) == (0, (), [])


@pytest.mark.parametrize("during", ["search_pipeline", "inspect_pipeline"])
def test_what_becomes_unfeasible_stops_in_the_same_tick_and_the_new_plan_starts_after_the_delay(
    world, during
):
    world.run(until=during)
    world.kb.unfeasible = set(BOTH)
    dropped_s = world.now_s
    assert world.tick() is Status.RUNNING
    assert world.log[-1] == (dropped_s, during, "INVALID")
    assert not world.executor.current_steps
    world.run(until="recharge")
    assert world.log[-1] == (pytest.approx(dropped_s + 0.2), "recharge", "begins")
    world.kb.unfeasible = set()
    assert world.run() is Status.SUCCESS
    rest = {
        "search_pipeline": ["search_pipeline", "inspect_pipeline"],
        "inspect_pipeline": ["inspect_pipeline"],
    }[during]
    assert world.plans()[1] == ["recharge", *rest]
    second = world.executor.plans[1]
    assert (second.at_s, second.reason) == (dropped_s, f"{during} became unfeasible")


def test_an_expected_effect_never_overrides_the_kb(world):
    world.kb.unfeasible = set(BOTH)
    world.run(until="recharge")
    for _ in range(10):
        world.tick()
    assert ("search_pipeline", "begins") not in happened(world)
    assert [record.reason.partition(":")[0] for record in world.executor.plans] == [
        "start",
        "recharge(recharge, search_pipeline, inspect_pipeline, bluerov) did not make inspect_pipeline feasible",
    ]
    world.kb.unfeasible = set()
    assert world.run() is Status.SUCCESS


def test_a_later_step_that_becomes_unfeasible_leads_to_a_new_plan_at_once(extended):
    world = World(extended)
    world.ticks = {"search_pipeline": 20}
    world.run(until="search_pipeline")
    world.kb.unfeasible = {"inspect_pipeline"}
    world.tick()
    assert happened(world)[-1] == ("search_pipeline", "begins")
    assert world.executor.feedback_message == "planning: inspect_pipeline is unfeasible"
    world.tick()
    world.tick()
    assert world.executor.current_steps
    assert world.executor.plans[1].reason == "inspect_pipeline is unfeasible"
    assert sorted(world.plans()[1]) == ["inspect_pipeline", "recharge", "search_pipeline"]


def test_a_later_step_that_the_plan_itself_will_make_feasible_is_no_reason(world):
    world.kb.unfeasible = {"inspect_pipeline"}
    world.run(until="recharge")
    world.kb.unfeasible = set(BOTH)
    world.tick()
    assert world.executor.current_steps[0].schema == "recharge"
    assert len(world.executor.plans) == 1


@pytest.mark.parametrize("event", [Status.FAILURE, RuntimeError("propeller lost")])
def test_a_step_that_fails_or_raises_is_planned_anew_with_its_reason(world, event):
    world.events = {"search_pipeline": event}
    assert world.run() is Status.SUCCESS
    assert world.plans() == [["search_pipeline", "inspect_pipeline"]] * 2
    reason = world.executor.plans[1].reason
    assert reason.startswith("search_pipeline(search_pipeline, pipeline, bluerov) failed")
    assert ("RuntimeError: propeller lost" in reason) == isinstance(event, RuntimeError)
    expected = "FAILURE" if event is Status.FAILURE else "INVALID"
    assert happened(world)[:2] == [("search_pipeline", "begins"), ("search_pipeline", expected)]


def test_a_behaviour_that_raises_even_when_stopped_is_not_left_running(world):
    class Stubborn(Task):
        def terminate(self, new_status):
            raise RuntimeError("no")

    made = []
    world.executor._factories["search_pipeline"] = lambda step: (
        made.append(Stubborn(step, world)) or made[-1]
    )
    world.run(until="search_pipeline")
    world.kb.unfeasible = set(BOTH)
    assert world.tick() is Status.RUNNING
    assert [behaviour.status for behaviour in made] == [Status.INVALID]


def test_an_over_all_condition_on_a_sensed_fact_is_watched(rooms):
    world = World(rooms)
    world.ticks = {"scan": 5}
    world.run(until="scan")
    world.facts = {"(lit hall)": False}
    world.tick()
    assert happened(world)[-1] == ("scan", "INVALID")
    world.facts = {}
    assert world.run() is Status.SUCCESS
    assert (
        world.executor.plans[1].reason
        == "scan(look, robby, hall) needs (lit hall), which does not hold"
    )


def test_effects_at_start_are_taken_back_when_a_step_is_abandoned(rooms):
    world = World(rooms)
    world.run(until="move")
    world.kb.unfeasible = {"go"}
    world.tick()
    world.kb.unfeasible = set()
    # had the robot stayed believed not free and nowhere, there would be no plan
    assert world.run() is Status.SUCCESS
    assert world.executor.plans[1].reason == "go became unfeasible"
    assert world.plans()[-1] == ["move", "clean", "scan"]


def test_a_step_that_ends_although_its_condition_at_the_end_does_not_hold_has_failed(rooms):
    world = World(rooms)
    world.run(until="scan")
    world.facts = {"(broken hall)": True}
    for _ in range(2):
        assert world.tick() is Status.RUNNING
    assert happened(world) == [("scan", "begins"), ("scan", "SUCCESS")]
    assert not world.executor.current_steps
    world.facts = {}
    assert world.run() is Status.SUCCESS
    assert (
        world.executor.plans[1].reason
        == "scan(look, robby, hall) ended although (not (broken hall)) does not hold"
    )
    assert world.plans()[1][:2] == ["clean", "scan"]


def test_what_is_sensed_replaces_what_was_assumed(world):
    world.facts = {"(pipeline_found pipeline)": False}
    world.run(until="search_pipeline")
    for _ in range(3):
        world.tick()
    assert ("inspect_pipeline", "begins") not in happened(world)
    world.run(until="search_pipeline")
    assert "needs (pipeline_found pipeline), which does not hold" in world.executor.plans[1].reason
    world.facts = {}  # not mentioned any more: the effect of the finished step is assumed
    assert world.run() is Status.SUCCESS
    assert happened(world)[-1] == ("inspect_pipeline", "SUCCESS")


def test_a_goal_that_is_reached_while_planning_ends_the_planning(world):
    world.tick()
    world.facts = {"(pipeline_inspected pipeline)": True}
    assert world.tick() is Status.SUCCESS
    assert world.log == []


def test_an_unknown_sensed_atom_is_an_error_and_leaves_nothing_running(world):
    world.run(until="search_pipeline")
    world.facts = {"(pipeline_fund pipeline)": True}
    with pytest.raises(UnknownNameError, match="nearest: pipeline_found"):
        world.tick()
    assert happened(world)[-1] == ("search_pipeline", "INVALID")
    assert not world.executor.current_steps


def test_without_a_plan_it_fails_by_name_and_plans_again_only_when_something_changed(world):
    world.kb.unfeasible = {*BOTH, "recharge"}
    assert world.run() is Status.FAILURE
    said = world.executor.feedback_message
    assert "unsolvable proven" in said
    assert said.endswith(
        "unfeasible now: search_pipeline, inspect_pipeline, recharge; there would be a plan if they were feasible"
    )
    count = world.executor._planner.count
    for _ in range(5):
        assert world.tick() is Status.FAILURE
        assert world.executor.feedback_message == said
    assert world.executor._planner.count == count == 2
    world.kb.unfeasible = set(BOTH)
    assert world.tick() is Status.RUNNING
    world.kb.unfeasible = set()
    assert world.run() is Status.SUCCESS
    assert [record.reason for record in world.executor.plans[:2]] == ["start", "the state changed"]
    assert world.executor.plans[0].outcome is Outcome.UNSOLVABLE_PROVEN


def test_no_plan_for_a_state_that_is_gone_is_no_failure(world):
    world.kb.unfeasible = {*BOTH, "recharge"}
    world.tick()
    world.kb.unfeasible = set()
    assert world.run() is Status.SUCCESS
    assert [record.outcome.is_solved for record in world.executor.plans] == [False, True]


def test_trouble_with_the_planner_is_a_failure_that_says_what_to_do(extended):
    world = World(extended, Planner("tamer"))
    assert world.run() is Status.FAILURE
    assert "engine missing" in world.executor.feedback_message
    assert "pip install up-tamer" in world.executor.feedback_message


class HeldPlanner:
    """Answers when the test says so."""

    timeout_s = -1.99  # the executor waits 2 s longer than this

    def __init__(self):
        self.futures = []

    def start(self, problem):
        self.problem = problem
        self.futures.append(Future())
        return self.futures[-1]

    def answer(self):
        self.futures[-1].set_result(Planner().plan(self.problem))


def test_a_tick_never_waits_for_a_late_planner(extended):
    world = World(extended, HeldPlanner())
    for _ in range(10):
        world.root.tick_once()
        world.tick_number += 1
    assert (world.root.status, world.executor.plans) == (Status.RUNNING, ())
    world.executor._planner.answer()
    assert world.run() is Status.SUCCESS


def test_in_lock_step_a_planner_later_than_its_own_limit_ends_the_run_by_name(extended):
    world = World(extended, HeldPlanner())
    with pytest.raises(
        PlanningBudgetError, match=r"no plan after 0\.01 s of waiting.*allow more time"
    ):
        world.run()
    assert world.executor._planner.futures[0].cancelled()


def test_an_answer_that_comes_early_is_held_until_it_is_due(extended):
    world = World(extended, HeldPlanner(), delay_s=0.5)
    world.tick()
    world.executor._planner.answer()
    world.run(until="search_pipeline")
    assert world.log == [(0.5, "search_pipeline", "begins")]


def test_without_a_delay_the_answer_is_taken_as_soon_as_it_is_there(extended):
    world = World(extended, HeldPlanner(), delay_s=None)
    world.executor._planner.timeout_s = 120.0
    for _ in range(3):
        world.tick()
    world.executor._planner.answer()
    world.tick()
    assert world.log == [(0.3, "search_pipeline", "begins")]


def test_a_planner_of_the_users_own_that_raises_is_a_named_outcome(extended):
    world = World(extended, HeldPlanner(), policy=ReplanningPolicy(retries=0))
    world.tick()
    world.executor._planner.futures[0].set_exception(ValueError("nonsense"))
    assert world.run() is Status.FAILURE
    assert "engine crashed: ValueError: nonsense" in world.executor.feedback_message


def test_two_runs_with_the_same_events_are_the_same(extended):
    def run():
        world = World(extended)
        world.ticks = {"search_pipeline": 7, "recharge": 4}
        world.run(until="search_pipeline")
        world.tick()
        world.kb.unfeasible = set(BOTH)
        world.run(until="recharge")
        world.kb.unfeasible = set()
        world.run()
        return world.log, world.executor.plans

    first = run()
    second = run()
    assert first == second
    assert len(first[1]) == 2


# ------------------------------------------------------------------ inside a tree


class Alarm(Behaviour):
    on = False

    def update(self):
        return Status.RUNNING if self.on else Status.FAILURE


def test_inside_a_tree_it_is_interrupted_and_carries_on(world):
    alarm = Alarm("alarm")
    after = py_trees.behaviours.Success("after")
    part = Sequence("part", memory=True, children=[world.executor, after])
    world.root = Selector("root", memory=False, children=[alarm, part])
    world.run(until="inspect_pipeline")
    alarm.on = True
    world.tick()
    assert happened(world)[-1] == ("inspect_pipeline", "INVALID")
    assert (world.executor.status, world.executor.current_steps) == (Status.INVALID, ())
    alarm.on = False
    assert world.run() is Status.SUCCESS
    assert after.status is Status.SUCCESS
    assert world.plans() == [["search_pipeline", "inspect_pipeline"], ["inspect_pipeline"]]
    assert [record.reason for record in world.executor.plans] == ["start", "start"]


def test_an_interruption_discards_the_planning_that_is_under_way(extended):
    world = World(extended, HeldPlanner())
    world.tick()
    world.executor.stop(Status.INVALID)
    assert world.executor._planner.futures[0].cancelled()
    assert world.executor.plans == ()


def test_visitors_see_the_behaviour_of_the_running_step(world):
    class Names(py_trees.visitors.VisitorBase):
        def __init__(self):
            super().__init__(full=False)
            self.names = []

        def run(self, behaviour):
            self.names.append(behaviour.name)

    tree = BehaviourTree(world.executor)
    names = Names()
    tree.visitors.append(names)
    world.run(until="search_pipeline")
    names.names.clear()
    tree.tick()
    step = "search_pipeline(search_pipeline, pipeline, bluerov)"
    assert names.names == [step, "plan"]
    assert tree.root.tip().name == step
    assert tree.root.children[0].parent is tree.root


def test_the_shutdown_of_the_tree_stops_the_step(world):
    world.run(until="search_pipeline")
    BehaviourTree(world.executor).shutdown()
    assert happened(world)[-1] == ("search_pipeline", "INVALID")
    assert world.executor.status is Status.INVALID
    assert happened(world).count(("search_pipeline", "INVALID")) == 1


def test_setup_and_shutdown_reach_the_behaviour_of_a_step(world):
    seen = []

    class Careful(Task):
        def setup(self, **kwargs):
            seen.append(kwargs)

        def shutdown(self):
            seen.append("shutdown")

    world.executor._factories["search_pipeline"] = lambda step: Careful(step, world)
    BehaviourTree(world.executor).setup(node="here")
    world.run(until="inspect_pipeline")
    assert seen == [{"node": "here"}, "shutdown"]
