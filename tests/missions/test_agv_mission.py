"""The ground vehicle driving: whatever the seed, the Kinect fails, a corridor goes dark, and the robot arrives."""

from collections import Counter
from dataclasses import replace

import numpy
import pytest
from agv_worlds import building_from, generated_building
from hypothesis import given, settings
from hypothesis import strategies as st
from running import result, rosa_run, run_mission, text

from kb import KnowledgeBase
from missions.agv import PAPER, WEIGHTS, agv_mission
from missions.agv.joint import JointPlanner, Modes, Question
from missions.agv.model import DRAW_W, agv_model, building_model
from missions.agv.tree import Route, Switch
from missions.agv.world import Settings
from missions.engine.mission import MissionError, Percepts
from missions.engine.settings import RunSettings
from missions.engine.task_layer import TASK_KINDS, mission_domain
from missions.views.output import as_json
from rosa_pddl import Planner, Problem
from rosa_pddl.belief import Belief

AGV = "missions.agv:MISSION"


def driven(building, task="bt", **settings):
    """Run a mission on a map; returns verdict and run."""
    mission = agv_mission("small", "drives", building_from(building))
    values = {"incidents": "", **{key: str(value) for key, value in settings.items()}}
    world = mission.world.open(values, numpy.random.default_rng(0))
    run = rosa_run(mission, task, world, RunSettings(duration_s=60.0))
    return run.run(), run


def straight(**corridor):
    return {
        "start": "a",
        "goal": "b",
        "places": {"a": [0, 0], "b": [6, 0]},
        "corridors": {"c1": {"from": "a", "to": "b", **corridor}},
    }


@pytest.mark.parametrize("seed", range(4))
def test_kinect_fails_and_plan_and_architecture_change_together(seed):
    data = result(AGV, "bt", seed)
    assert data["outcome"] == "arrived"
    assert data["collisions"] == 0
    assert data["diagnostics_problems"] == []
    assert [(one["name"], one["result"]) for one in data["actions"]] == [
        ("cross_c1", "abandoned"),
        ("cross_c4", "completed"),
        ("cross_c3", "completed"),
        ("cross_c2", "completed"),
    ]
    assert [one["what"] for one in data["disturbances"]] == [
        "kinect failed",
        "light in c3 goes out",
    ]
    failure, dark = data["disturbances"]
    task, structural = data["adaptations"]
    assert task["kind"] == "task"
    assert task["trigger"] == "kinect has failed"
    assert task["change"].startswith(
        "cross_c1 -> cross_c4; stop amcl; start aruco, camera; set navigator to c4_from_a"
    )
    assert failure["at_s"] <= task["at_s"] <= failure["at_s"] + 0.2
    assert (structural["kind"], structural["change"]) == ("structural", "start lamp")
    assert dark["at_s"] <= structural["at_s"] <= dark["at_s"] + 0.2


def ways_and_modes(steps):
    """Return what is crossed and in which mode, as far as it is said in the steps of a plan."""
    words = [step.removesuffix(")").split("(") for step in steps]
    return [tuple(told.split(", ")[0::4]) for name, told in words if name == "cross"]


@pytest.mark.parametrize("seed", range(2))
def test_planned_step_by_step_it_answers_in_the_same_way(seed):
    data = result(AGV, "pddl", seed)
    assert data["outcome"] == "arrived"
    assert data["collisions"] == 0
    assert data["diagnostics_problems"] == []
    assert [one["what"] for one in data["disturbances"]] == [
        "kinect failed",
        "light in c3 goes out",
    ]
    driven = [(one["name"], one["result"]) for one in data["actions"] if one["name"] != "switch"]
    assert driven == [
        ("cross_c1", "abandoned"),
        ("cross_c4", "completed"),
        ("cross_c3", "abandoned"),
        ("cross_c3", "completed"),
        ("cross_c2", "completed"),
    ]
    first, turned, lit = (ways_and_modes(plan["steps"]) for plan in data["plans"])
    assert first == [("cross_c1", "amcl_kinect_fast")]
    assert turned == [(f"cross_{name}", "aruco_camera_fast") for name in ("c4", "c3", "c2")]
    assert lit == [("cross_c3", "aruco_camera_lamp_fast"), ("cross_c2", "aruco_camera_fast")]


@pytest.mark.parametrize("task", TASK_KINDS)
def test_same_seed_gives_the_same_bytes_and_another_does_not(task):
    assert as_json(run_mission(AGV, task, 0)[2]) == text(AGV, task, 0)
    assert text(AGV, task, 1) != text(AGV, task, 0)


def test_without_incidents_it_drives_straight_past_the_boxes():
    data = run_mission(AGV, incidents="")[2]
    assert [one["name"] for one in data["actions"]] == ["cross_c1"]
    assert data["collisions"] == 0
    assert data["adaptations"] == []
    assert data["driven_m"] > 20.0  # round the boxes


@pytest.mark.parametrize("task", TASK_KINDS)
def test_first_plan_for_a_corridor_is_caused_by_its_request(task):
    run, *_ = run_mission(AGV, task, duration_s=5)
    asked = {one.action: one.number for one in run.actions}
    assert asked["cross_c1"] in [plan.cause for plan in run.kb.plans]


def test_energy_that_was_used_is_what_the_components_drew():
    data = run_mission(AGV, incidents="")[2]
    moving_s = data["duration_s"] - 1.0
    assert (
        25.0 * moving_s < data["energy_used_j"] < 38.0 * data["duration_s"]
    )  # AMCL, Kinect and driving: 38 W
    assert agv_model().attributes["energy"].unit == "J"


def test_robot_that_loses_lamp_lidar_and_kinect_in_the_dark_says_why_it_stands():
    verdict, run = driven(
        straight(light=0.0), incidents="lamp fails in c1, lidar fails in c1, kinect fails in c1"
    )
    assert not verdict.success
    assert verdict.reason.startswith(
        "there is no way from within c1: no corridor can be crossed in any configuration"
    )
    assert run.kb.required_actions == ()


def test_robot_without_a_way_says_why_and_requests_nothing():
    blocked = straight(obstacles=1.0)
    blocked["places"]["d"] = [0, 9]
    blocked["corridors"]["c2"] = {"from": "a", "to": "d"}
    verdict, run = driven(blocked, incidents="kinect fails in c1")
    assert not verdict.success
    assert "cannot be crossed" in verdict.reason
    assert Counter(one.result for one in run.kb.history.actions) == {"abandoned": 1}


def test_battery_that_cannot_last_is_no_reason_to_set_out():
    verdict, run = driven(straight(), capacity_j=20.0)
    assert not verdict.success
    assert "within all limits: energy " in verdict.reason
    assert run.world.results()["driven_m"] < 3.0


def test_generated_building_is_driven_through_as_planned():
    building = generated_building(numpy.random.default_rng(3), 6, 7)
    mission = agv_mission("generated", "drives", building)
    planned = JointPlanner(building, KnowledgeBase(agv_model(), clock=lambda: 0.0)).plan(
        Question(weights=WEIGHTS)
    )
    run = rosa_run(
        mission, "bt", mission.world.open({"incidents": ""}, numpy.random.default_rng(0))
    )
    assert run.run().outcome == "arrived"
    assert [one.action for one in run.kb.history.actions] == [
        f"cross_{leg.corridor}" for leg in planned.legs
    ]
    assert {one.result for one in run.kb.history.actions} == {"completed"}
    assert run.world.results()["collisions"] == 0
    assert run.world.now == pytest.approx(planned.takes.in_units["time"], rel=0.25)


def test_dark_corridor_is_entered_with_the_lamp_on():
    _, run = driven(straight(light=0.1))
    assert run.kb.history.actions[0].result == "completed"
    designs = [one.name for one in run.kb.designs.values() if one.status.value != "unfeasible"]
    assert "aruco_camera_lamp" in designs


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"incidents": "kinect breaks in c1"}, "allowed is text such as"),
        (
            {"incidents": "radar fails in c1"},
            "incidents cannot be 'radar fails in c1': there are amcl",
        ),
        (
            {"incidents": "dark in c9"},
            "incidents cannot be 'dark in c9': there are .*; c1; .* none with --set incidents=",
        ),
        ({"capacity_j": "much"}, "capacity_j is 'much'; allowed is a number from 1"),
        ({"reech": "1"}, "unknown setting 'reech'; did you mean reach_m"),
        ({"control_period_s": "0.015"}, "not a whole multiple"),
    ],
)
def test_bad_setting_is_refused(values, words):
    mission = agv_mission("small", "drives", building_from(straight()))
    with pytest.raises(MissionError, match=words):
        mission.world.open(values, numpy.random.default_rng(0))


def test_defaults_of_the_settings_are_allowed():
    assert Settings.read({}).capacity_j == 20_000.0


def told(*messages, **values):
    """Return percepts that have heard what is so, and what has which value."""
    percepts = Percepts()
    heard = dict.fromkeys(messages, "true") | {
        name.replace("_in_", " in "): value for name, value in values.items()
    }
    percepts.receive({"status": [{"message": "mission status", "values": heard}]})
    return percepts


def planned_and_joint(building, kb, percepts, planner):
    """Return what the mission's planner answers now, and the joint planner to the same question."""
    mission = agv_mission("small", "drives", building)
    domain = mission_domain(mission)
    belief = Belief(domain, kb, lambda: mission.facts(kb, percepts))
    state = belief.observe()
    result = planner.plan(Problem(domain, state, None, belief.numbers))
    return result, Route(building, kb, percepts, WEIGHTS).answer


@settings(max_examples=12, deadline=None)
@given(
    st.integers(0, 10_000),
    st.integers(2, 6),
    st.sets(st.sampled_from(sorted(DRAW_W)), max_size=4),
    st.data(),
)
def test_plan_of_steps_costs_what_the_joint_plan_costs(seed, places, failed, data):
    corridors = data.draw(st.integers(places - 1, {2: 1, 3: 2, 4: 4, 5: 5, 6: 7}[places]))
    building = generated_building(numpy.random.default_rng(seed), places, corridors)
    kb = KnowledgeBase(building_model(building), clock=lambda: 0.0)
    for name in failed:
        kb.component_failed(name)
    where = data.draw(st.sampled_from([None, *building.corridors.values()]))
    heard = (
        []
        if where is None
        else [f"at {data.draw(st.sampled_from(where.ends))}", f"in {where.name}"]
    )
    changed = data.draw(
        st.dictionaries(
            st.sampled_from(sorted(building.corridors)), st.floats(0.0, 1.0), max_size=2
        )
    )
    lights = {f"light_in_{name}": light for name, light in changed.items()}
    kb.measure("driven", data.draw(st.floats(0.0, 20.0)))
    if data.draw(st.booleans()):
        kb.measure("energy", data.draw(st.floats(0.0, 6000.0)))
    result, answer = planned_and_joint(
        building, kb, told(*heard, **lights), Planner()
    )
    assert result.outcome.is_solved == answer.is_solved
    if answer.is_solved:
        assert result.cost == answer.cost


def test_light_that_comes_on_in_a_corridor_dark_on_the_map_is_planned_with():
    building = building_from(straight(light=0.1))
    kb = KnowledgeBase(building_model(building), clock=lambda: 0.0)
    dark, lit = (
        Route(building, kb, percepts, {"energy": 1.0}).answer
        for percepts in (told(), told(light_in_c1=1.0))
    )
    assert [answer.legs[0].mode.name.split()[0] for answer in (dark, lit)] == [
        "aruco_camera_lamp",
        "aruco_camera",
    ]
    assert lit.cost < dark.cost


def test_names_of_a_map_never_clash_with_those_of_the_plan():
    names = [
        "here",
        "now",
        "switch",
        "cross_c",
        "aruco_camera_fast",
        "c_here_now",
        "at",
        "action",
        "leads",
    ]
    places = {name: [float(number), 0.0] for number, name in enumerate(names)}
    corridors = {"c": {"from": "here", "to": "now"}, "c_here": {"from": "now", "to": "switch"}}
    corridors |= {f"d{n}": {"from": names[n], "to": names[n + 1]} for n in range(2, len(names) - 1)}
    building = building_from(
        {"start": "here", "goal": "leads", "places": places, "corridors": corridors}
    )
    kb = KnowledgeBase(building_model(building), clock=lambda: 0.0)
    result, answer = planned_and_joint(
        building, kb, told("at now", "in c"), Planner()
    )
    assert (result.outcome.is_solved, result.cost) == (True, answer.cost)
    assert [step.action for step in result.steps if step.schema == "cross"] == [
        f"cross_{leg.corridor}" for leg in answer.legs
    ]


def test_switch_selects_the_mode_and_ends_when_the_robot_is_configured_so_or_cannot_be():
    building = building_from(straight())
    kb = KnowledgeBase(building_model(building), clock=lambda: 0.0)
    route = Route(building, kb, Percepts(), WEIGHTS)
    mode = next(one for one in Modes(kb, "navigate").under({}) if one.name == "amcl_lidar fast")
    for active, how, status in ((False, "failed", "FAILURE"), (True, "completed", "SUCCESS")):
        switch = Switch(route, mode)
        switch.tick_once()
        plan = kb.pending_plan
        assert (set(plan.activate), plan.parameters) == ({"amcl", "lidar", "base"}, ("fast",))
        assert kb.designs["amcl_lidar"].is_selected
        switch.tick_once()
        assert switch.status.name == "RUNNING"
        for name in plan.activate:
            kb.component_active(name, active)
        kb.finish_plan(plan, how)
        switch.tick_once()
        assert switch.status.name == status
        assert kb.required_actions == ()
        kb.select({}, {})


def test_tree_tells_its_joint_plans_with_reasons_once_for_each_that_is_new():
    plans = result("agv", "bt", 1)["plans"]
    assert [[step.split("(")[1].split(",")[0] for step in plan["steps"]] for plan in plans] == [
        ["c1"],
        ["c4", "c3", "c2"],
        ["c3", "c2"],  # with the lamp
    ]
    assert plans[0]["at_s"] == 0.0
    for plan in plans:
        assert "of all ways the best for time + 0.02 energy + 10 collisions" in plan["reason"]
        assert plan["steps"][0].split(", ")[-1][:-1] in plan["reason"]
        assert plan["outcome"] == "solved optimally"


def test_tree_without_a_way_left_tells_once_that_there_is_no_plan_and_why():
    blocked = straight(obstacles=1.0)
    verdict, run = driven(blocked, "bt", incidents="kinect fails in c1")
    first, last = run.plans
    assert first.outcome.is_solved
    assert (last.outcome.is_solved, last.steps) == (False, ())
    assert last.reason in verdict.reason


def test_map_without_a_way_has_no_plan_of_steps_and_is_asked_no_more_than_things_change():
    blocked = straight(obstacles=1.0)
    blocked["places"]["d"] = [0, 9]
    blocked["corridors"]["c2"] = {"from": "a", "to": "d"}
    verdict, run = driven(blocked, "pddl", incidents="kinect fails in c1")
    assert not verdict.success
    assert "cannot be crossed" in verdict.reason
    assert "there was no plan: unsolvable proven" in verdict.reason
    assert [plan.outcome.is_solved for plan in run.plans] == [True] + [False] * (len(run.plans) - 1)
    assert len(run.plans) <= 4
    assert run.kb.required_actions == ()


def test_energy_that_cannot_last_is_no_reason_for_a_plan_of_steps():
    verdict, run = driven(straight(), "pddl", capacity_j=20.0)
    assert "within all limits: energy " in verdict.reason
    assert not any(plan.outcome.is_solved for plan in run.plans)
    assert run.world.results()["driven_m"] < 1.0


def test_each_plan_made_while_driving_costs_what_the_joint_plan_costs(monkeypatch):
    asked, heard = [], []

    class Compared(Planner):
        def start(self, problem):
            answer = Route(building, *heard[-1], WEIGHTS).answer
            asked.append((super().start(problem), answer.cost))
            return asked[-1][0]

    def facts(kb, percepts):
        heard[:] = [(kb, percepts)]
        return mission.facts(kb, percepts)

    monkeypatch.setattr("missions.engine.task_layer.Planner", Compared)
    building = PAPER
    mission = agv_mission("paper", "drives", building)
    run = rosa_run(
        replace(mission, facts=facts), "pddl", mission.world.open({}, numpy.random.default_rng(3))
    )
    assert run.run().outcome == "arrived"
    answered = [(future.result(), cost) for future, cost in asked if not future.cancelled()]
    assert len(answered) == 3
    assert [one.cost for one, _ in answered] == [cost for _, cost in answered]
    assert {one.strategy for result, _ in answered for one in result.attempts} == {"search"}
