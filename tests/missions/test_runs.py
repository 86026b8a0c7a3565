"""The missions as a stranger runs them: every seed finds, adapts, recharges, carries on."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy
import pytest
from py_trees.behaviours import Running
from py_trees.common import ParallelPolicy
from py_trees.composites import Parallel
from running import result, rosa_run, run_mission, text

from kb import KnowledgeBase, Status
from missions.baselines import open_run
from missions.engine.mission import MISSIONS, Percepts, find_mission
from missions.engine.runner import Listener
from missions.engine.settings import RunSettings
from missions.engine.task_layer import TASK_KINDS, build_task
from missions.views.output import as_json, summary
from rosa_pddl import Outcome, PlanExecutor, PlanRecord

SEEDS = range(3)


@pytest.mark.parametrize("task", TASK_KINDS)
@pytest.mark.parametrize("seed", SEEDS)
def test_extended_mission_finds_recharges_resumes_and_answers_every_disturbance(task, seed):
    data = result("suave_extended", task, seed)
    assert data["outcome"] == "time_limit"
    assert 0 < data["search_time_s"] < 300
    assert data["distance_inspected_m"] > 0
    # it inspected before the drop too, and did not begin again
    assert data["total_inspected_m"] > data["distance_inspected_m"]
    names = [one["name"] for one in data["actions"]]
    assert names == ["search_pipeline", "inspect_pipeline", "recharge", "inspect_pipeline"]
    assert [one["result"] for one in data["actions"]] == [
        "completed",
        "abandoned",
        "completed",
        "abandoned",
    ]
    triggers = {one["kind"]: [] for one in data["adaptations"]}
    for one in data["adaptations"]:
        triggers[one["kind"]].append(one["trigger"])
    assert any("water_visibility" in trigger for trigger in triggers["parameter"])
    assert triggers["structural"][0] == "c_thruster_1 has failed"
    # that a plan goes back to inspecting once it has recharged is its next step; a tree does so by what it measures
    assert [trigger.split(" ")[0] for trigger in triggers["task"]] == ["battery_level"] * (
        2 if task == "bt" else 1
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_tree_and_plans_of_the_extended_mission_begin_the_same_actions(seed):
    tree, planned = (result("suave_extended", task, seed) for task in TASK_KINDS)
    assert [one["name"] for one in tree["actions"]] == [one["name"] for one in planned["actions"]]
    assert tree["plans"] == []
    assert [[step.split("(")[0] for step in plan["steps"]] for plan in planned["plans"]] == [
        ["search_pipeline", "inspect_pipeline"],
        ["recharge", "inspect_pipeline"],
    ]


class Heard(Listener):
    def __init__(self):
        self.plans = []

    def plan(self, plan, time_s):
        self.plans.append(plan)


class Plans(Running):
    """A behaviour that plans by itself; told what comes of it by appending."""

    def __init__(self, name):
        super().__init__(name)
        self.plans = ()

    def find(self, reason, outcome=Outcome.SOLVED):
        self.plans = (*self.plans, PlanRecord(0.0, reason, outcome, (), self.name))


def test_plans_of_all_behaviours_of_a_tree_are_told_in_the_order_in_which_they_come():
    first, second = Plans("first"), Plans("second")
    root = Parallel("both", ParallelPolicy.SuccessOnAll(), [first, Running("works"), second])
    mission = replace(find_mission("suave"), tree=lambda kb, percepts: root)
    kb = KnowledgeBase(mission.model(), clock=lambda: 0.0)
    told = build_task("bt", mission, kb, Percepts(), 0.2).plans
    assert told() == ()
    for one, reason in ((second, "a"), (first, "b"), (second, "c")):
        one.find(reason)
        before = told()
        assert before[-1].reason == reason
        assert told() is before
    assert [plan.reason for plan in told()] == ["a", "b", "c"]


def test_run_that_forgets_its_oldest_task_plans_is_the_same_and_says_where_what_it_shows_begins(
    monkeypatch,
):
    shown, told = [], []
    for most in (100, 1):
        monkeypatch.setattr(PlanRecord.added_to, "__defaults__", (most,))
        monkeypatch.setitem(PlanExecutor.__init__.__kwdefaults__, "memory", most)
        run = open_run(find_mission("suave_extended"), task="pddl", seed=0, settings={})
        heard = Heard()
        run.listen(heard)
        shown.append(summary(run, run.run(), 0, {}))
        told.append([replace(plan, number=0) for plan in heard.plans])
    whole, short = shown
    count = len(whole["plans"])
    assert count > 1
    assert "plans_from" not in whole
    assert short.pop("plans_from") == count
    assert short["plans"] == whole["plans"][-1:]
    assert {**short, "plans": None} == {**whole, "plans": None}
    assert len(told[0]) == count
    assert told[0] == told[1]


def test_tree_whose_planner_is_in_trouble_goes_on_and_the_trouble_is_told():
    planner = Plans("planner")
    planner.find("start", Outcome.OUT_OF_TIME)
    mission = replace(find_mission("suave"), tree=lambda kb, percepts: planner)
    world = mission.world.open({}, numpy.random.default_rng(0))
    run = rosa_run(mission, "bt", world, RunSettings(duration_s=2.0))
    verdict = run.run()
    assert run.world.now == 2.0
    assert "planner" not in verdict.reason
    assert [plan["outcome"] for plan in summary(run, verdict, 0, {})["plans"]] == ["out of time"]


@pytest.mark.parametrize("task", TASK_KINDS)
def test_base_mission_knows_no_battery_and_never_recharges(task):
    data = result("suave", task)
    assert data["outcome"] == "time_limit"
    assert [one["name"] for one in data["actions"]] == ["search_pipeline", "inspect_pipeline"]
    assert {one["kind"] for one in data["adaptations"]} == {"parameter", "structural"}
    assert data["diagnostics_problems"] == []


def test_every_adaptation_says_when_what_why_and_how_fast():
    adaptations = result("suave_extended")["adaptations"]
    assert len(adaptations) >= 6
    for one in adaptations:
        assert set(one) == {"at_s", "kind", "trigger", "reason", "change", "reaction_s"}
        assert all(one[key] for key in ("trigger", "reason", "change"))
        assert 0 < one["reaction_s"] < 1
    drop = next(one for one in adaptations if one["kind"] == "task")
    assert drop["change"] == "inspect_pipeline -> recharge; stop follow_pipeline; start recharge"
    assert drop["reason"].startswith(
        "inspect_pipeline is unfeasible because battery_level just below 0.25 violates"
    )


def test_reactions_follow_the_disturbances_that_truly_happened():
    data = result("suave_extended")
    failure = next(
        one["at_s"] for one in data["disturbances"] if one["what"] == "thruster 1 failed"
    )
    answer = next(one["at_s"] for one in data["adaptations"] if one["kind"] == "structural")
    assert failure <= answer <= failure + 1.1  # the monitor looks once a second
    drop = next(one["at_s"] for one in data["disturbances"] if "battery" in one["what"])
    answer = next(one["at_s"] for one in data["adaptations"] if one["kind"] == "task")
    assert drop <= answer <= drop + 0.2


@pytest.mark.parametrize("task", TASK_KINDS)
def test_same_seed_gives_the_same_bytes_and_another_does_not(task):
    again = run_mission("suave_extended", task, 0)[2]

    assert as_json(again) == text("suave_extended", task, 0)
    assert text("suave_extended", task, 1) != text("suave_extended", task, 0)


def test_result_is_plain_json_without_what_depends_on_the_machine():
    data = json.loads(text("suave_extended", "pddl"))
    for key in (
        *(
            "mission",
            "task",
            "manager",
            "seed",
            "outcome",
            "search_time_s",
            "distance_inspected_m",
            "duration_s",
        ),
        *("adaptations", "actions", "plans"),
    ):
        assert key in data
    assert "wall" not in text("suave_extended", "pddl")


@pytest.mark.parametrize("name", MISSIONS)
@pytest.mark.parametrize("task", TASK_KINDS)
def test_contract_of_every_mission(name, task):
    """Whatever mission is in the registry: it ends, leaves nothing open, and its model knows what it speaks of."""
    run, verdict, data = run_mission(name, task, seed=4, duration_s=40)
    assert run.kb.required_actions == ()
    assert all(one.result is not None for one in run.kb.history.actions)
    assert len(run.kb.history.actions) > 0
    assert verdict.outcome in ("inspected_all", "time_limit", "not_found", "aborted")
    assert data["duration_s"] == 40
    assert {step.action for plan in run.plans for step in plan.steps} <= {None, *run.kb.actions}
    assert all(view.status is not Status.FAILURE for view in run.kb.actions.values())
    times = [sample.time for sample in run.listeners[0].samples]
    assert times
    assert times == sorted(set(times))


def test_mission_that_does_not_find_the_pipeline_is_no_success():
    _, verdict, data = run_mission("suave_extended", duration_s=30)
    assert verdict.outcome == "not_found"
    assert not verdict.success
    assert data["search_time_s"] is None


def test_mission_that_ends_before_a_needed_recharge_is_no_success():
    _, verdict, _ = run_mission("suave_extended", duration_s=155)
    assert verdict.outcome == "aborted"
    assert "recharge" in verdict.reason


def test_battery_that_lasts_needs_no_recharge():
    _, verdict, data = run_mission("suave_extended", discharge_time_s=1000)
    assert verdict.outcome == "time_limit"
    assert [one["name"] for one in data["actions"]] == ["search_pipeline", "inspect_pipeline"]


def test_battery_that_drops_while_searching_resumes_the_search():
    _, _, data = run_mission("suave_extended", discharge_time_s=50, duration_s=150)
    names = [one["name"] for one in data["actions"]]
    assert names[:3] == ["search_pipeline", "recharge", "search_pipeline"]
    resumed = [one for one in data["adaptations"] if one["kind"] == "task"]
    assert [one["change"].split(";")[0] for one in resumed[:2]] == [
        "search_pipeline -> recharge",
        "recharge -> search_pipeline",
    ]


@pytest.mark.parametrize("task", TASK_KINDS)
@pytest.mark.parametrize(("name", "action"), [("agv", "cross_c4"), ("uav", "pick_up_and_analyse")])
def test_mission_that_runs_out_of_time_says_what_was_under_way_since_when(name, action, task):
    _, verdict, data = run_mission(name, task, seed=1, duration_s=30)
    last = data["actions"][-1]
    assert verdict.outcome == "aborted"
    assert verdict.reason.startswith("time ran out")
    assert last["name"] == action
    assert verdict.reason.endswith(f"; under way: {action} since {last['start_s']:.1f} s")


@pytest.mark.parametrize(
    ("name", "others"), [("suave", "agv uav"), ("agv", "suave uav"), ("uav", "agv suave")]
)
def test_mission_is_opened_without_the_others_and_imported_without_a_simulator_or_a_model(
    name, others
):
    script = (
        "import sys, kb; from missions.baselines import open_run; from missions.engine.mission import find_mission; "
        f"make, kb.Model.__init__ = kb.Model.__init__, None; mission = find_mission({name!r}); "
        "kb.Model.__init__ = make; assert 'mujoco' not in sys.modules; open_run(mission).world.close(); "
        f"assert not [one for one in {others.split()!r} if f'missions.{{one}}' in sys.modules]"
    )
    subprocess.run([sys.executable, "-c", script], check=True)
