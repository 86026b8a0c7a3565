"""The ground vehicle: the Kinect fails, a corridor goes dark, and the robot arrives."""

import math
from dataclasses import replace

import numpy
import pytest
from agv_worlds import generated_building
from hypothesis import given, settings
from hypothesis import strategies as st
from running import result, rosa_run

from kb import KnowledgeBase, UnknownName
from missions.agv import PAPER, WEIGHTS, Incident, Weights, agv_mission
from missions.agv.model import DRAW_W, NAVIGATOR, SPEEDS, Building, Corridor, building_model
from missions.agv.tree import Route
from missions.agv.vehicle import Aim, Vehicle, boxes
from missions.agv.world import BuildingWorld, Settings
from missions.engine.mission import MissionError, Percepts
from missions.engine.percepts import sensed
from missions.engine.settings import RunSettings
from missions.engine.task_layer import TASK_KINDS, mission_domain
from rosa_pddl import Planner, Problem
from rosa_pddl.belief import Belief


def straight(length_m=6.0, obstacles=0.0, light=1.0):
    corridor = Corridor(("a", "b"), obstacles, light)
    return Building({"a": (0.0, 0.0), "b": (length_m, 0.0)}, {"c1": corridor}, "a", "b")


def with_dead_end(obstacles):
    building = straight(obstacles=obstacles)
    corridors = {**building.corridors, "c2": Corridor(("a", "d"))}
    return replace(building, places={**building.places, "d": (0.0, 9.0)}, corridors=corridors)


def run_in(building, task="bt", duration_s=60.0, incidents=(), **values):
    """Run a mission on a map; return verdict and run."""
    mission = agv_mission("small", "drives", building, incidents=incidents)
    texts = {key: str(value) for key, value in values.items()}
    world = mission.world.open(texts, numpy.random.default_rng(0))
    run = rosa_run(mission, task, world, RunSettings(duration_s=duration_s))
    return run.run(), run


@pytest.mark.parametrize("task", TASK_KINDS)
def test_plan_and_architecture_change_together(task):
    data = result("agv", task, 1)
    assert data["outcome"] == "arrived"
    assert data["collisions"] == 0
    assert data["diagnostics_problems"] == []
    crossed = [action["name"] for action in data["actions"] if action["name"] != "switch"]
    assert list(dict.fromkeys(crossed)) == ["cross_c1", "cross_c4", "cross_c3", "cross_c2"]
    failure, dark = data["disturbances"]
    assert (failure["what"], dark["what"]) == ("kinect failed", "light in c3 goes out")
    first, second = data["adaptations"][:2]
    assert (first["kind"], first["trigger"]) == ("task", "kinect has failed")
    assert failure["at_s"] <= first["at_s"] <= failure["at_s"] + 0.3
    assert dark["at_s"] <= second["at_s"] <= dark["at_s"] + 0.2
    routes = [
        [step.split(", ")[1] for step in plan["steps"] if step.startswith("cross")]
        for plan in data["plans"]
    ]
    back = task == "pddl"  # a step of its own there
    assert [len(route) for route in routes] == [1, 3 + back, 2]
    if task == "bt":
        assert second["change"] == "start lamp"
        for plan in data["plans"]:
            assert "the best for time + 0.02 energy + 10 collisions" in plan["reason"]


@pytest.mark.parametrize("task", TASK_KINDS)
@pytest.mark.parametrize(
    ("building", "values", "words"),
    [
        (straight(), {"capacity_j": 20}, "no way takes at most "),
        (
            with_dead_end(1.0),
            {"incidents": [Incident("c1", "kinect")]},
            "cannot be crossed",
        ),
        (
            straight(light=0.0),
            {"incidents": [Incident("c1", name) for name in ("lamp", "lidar", "kinect")]},
            "b cannot be reached from within c1; c1 cannot be crossed",
        ),
    ],
)
def test_robot_without_a_way_says_why_and_stops(task, building, values, words):
    verdict, run = run_in(building, task, **values)
    assert not verdict.success
    assert words in verdict.reason
    assert run.kb.required_actions == ()
    assert not any(plan.outcome.is_solved for plan in run.plans[-1:])
    assert run.world.now < 60.0


@pytest.mark.parametrize("task", TASK_KINDS)
def test_robot_changes_its_mode_where_it_turns_back(task):
    dark = replace(PAPER.corridors["c4"], light=0.0)
    building = replace(PAPER, corridors={**PAPER.corridors, "c4": dark})
    incidents = [Incident("c1", name) for name in ("kinect", "lidar")]
    mission = agv_mission("small", "drives", building, Weights(1.0, 0.2), incidents)
    world = mission.world.open({}, numpy.random.default_rng(0))
    run = rosa_run(mission, task, world, RunSettings(duration_s=300.0))
    assert run.run().outcome == "arrived"
    crossed = [action.action for action in run.actions if action.action != "switch"]
    assert list(dict.fromkeys(crossed)) == ["cross_c1", "cross_c4", "cross_c3", "cross_c2"]
    turned = [action for action in run.actions if action.action == "cross_c1"][-1]
    assert turned.result == "completed"
    lit = next(plan for plan in run.kb.plans if "lamp" in plan.activate)
    assert lit.start >= turned.end


def test_generated_building_is_driven_through_as_planned():
    building = generated_building(numpy.random.default_rng(3), 6, 7)
    verdict, run = run_in(building, duration_s=300.0)
    assert verdict.outcome == "arrived"
    first = run.plans[0]
    assert [action.action for action in run.actions] == [step.action for step in first.steps]
    assert {action.result for action in run.actions} == {"completed"}
    assert run.world.results()["collisions"] == 0


@pytest.mark.parametrize(
    ("values", "error", "words"),
    [
        ({"incidents": [Incident("c9")]}, UnknownName, "unknown corridor 'c9'; known: 'c1'"),
        ({"capacity_j": "much"}, MissionError, "capacity_j is 'much'; allowed is a number from 1"),
    ],
)
def test_world_setting_without_meaning_is_refused(values, error, words):
    with pytest.raises(error, match=words):
        run_in(straight(), **values)


@settings(max_examples=10)
@given(
    st.integers(0, 10_000),
    st.sets(st.sampled_from(sorted(DRAW_W)), max_size=4),
    st.sampled_from([None, "c1", "c2", "c3"]),
    st.floats(0.0, 20.0),
    st.sampled_from([None, 100.0, 2000.0]),
    st.dictionaries(st.sampled_from(["c1", "c2", "c3"]), st.floats(0.0, 1.0), max_size=2),
)
def test_plan_of_steps_costs_what_the_joint_plan_costs(
    seed, failed, inside, driven_m, energy_j, lights
):
    building = generated_building(numpy.random.default_rng(seed), 4, 4)
    kb = KnowledgeBase(building_model(building), clock=lambda: 0.0)
    for name in failed:
        kb.component_failed(name)
    kb.measure("driven", driven_m)
    if energy_j is not None:
        kb.measure("energy", energy_j)
    percepts = Percepts()
    news = {f"light in {name}": light for name, light in lights.items()}
    if inside:
        news |= {f"at {building.corridors[inside].ends[0]}": True, f"in {inside}": True}
    percepts.receive(sensed(0.0, **news))
    mission = agv_mission("small", "drives", building)
    domain = mission_domain(mission)
    belief = Belief(domain, kb, lambda: mission.facts(kb, percepts))
    state = belief.observe()
    plan = Planner().plan(Problem(domain, state, None, belief.numbers))
    answer = Route(building, kb, percepts, WEIGHTS).answer
    assert plan.cost == answer.cost


# ---------------------------------------------------------------- the vehicle by itself


def started(building, components, **values):
    """Return a world in which some components drive the vehicle along c1."""
    texts = {name: str(value) for name, value in values.items()}
    world = BuildingWorld(building, Settings.read(texts), numpy.random.default_rng(0))
    world.managed.set_parameters("base", {"speed": SPEEDS["fast"][0]})
    world.managed.set_parameters(NAVIGATOR, {"corridor": "c1", "origin": "a"})
    for name in (*components, "base", NAVIGATOR):
        world.managed.activate(name)
    return world


def driven_after(world, seconds):
    until = world.now + seconds
    while world.now < until - 1e-6:
        world.advance(until)
    return world.results()["driven_m"]


def driven(vehicle, aim, seconds):
    for _ in range(round(seconds * 10)):
        vehicle.drive(aim)


def test_wheels_drive_straight_turn_and_bump():
    vehicle = Vehicle(straight(20.0), [(6.0, 0.0, 0.0)], (3.0, 0.0, 0.0))
    driven(vehicle, Aim(0.6, 0.0), 2.5)
    assert vehicle.position == pytest.approx((4.4, 0.0), abs=0.15)
    ahead = [x for x, y in vehicle.look("lidar") if abs(y) < 0.1]
    assert min(ahead) == pytest.approx(5.8 - vehicle.position[0], abs=0.05)
    assert vehicle.collisions == 0
    driven(vehicle, Aim(0.6, 0.0), 5.0)
    assert vehicle.collisions >= 1
    turning = Vehicle(straight(20.0), [], (3.0, 0.0, 0.0))
    driven(turning, Aim(0.0, 0.5), 2.0)
    assert 0.6 < turning.yaw < 1.0  # less than an ideal one, for wide wheels scrub


def test_vehicle_drives_round_boxes_as_it_sees_them(monkeypatch):
    building = straight(12.0, obstacles=0.4)
    assert len(boxes(building, numpy.random.default_rng(0))) == 5
    seeing = started(building, ("amcl", "kinect"))
    assert driven_after(seeing, 40) > 12.0
    assert seeing.results()["collisions"] == 0
    monkeypatch.setattr(Vehicle, "look", lambda self, sensor: numpy.zeros((0, 2)))
    blind = started(building, ("amcl", "kinect"))
    driven_after(blind, 40)
    assert blind.results()["collisions"] > 0


@pytest.mark.parametrize(
    ("running", "lost", "light"),
    [
        (("amcl", "kinect"), "amcl", 1.0),
        (("amcl", "kinect"), "base", 1.0),
        (("amcl", "kinect"), NAVIGATOR, 1.0),
        (("aruco", "camera", "lamp"), "lamp", 0.1),
    ],
)
def test_vehicle_stands_without_a_component_it_drives_by(running, lost, light):
    world = started(straight(10.0, light=light), running)
    driven_after(world, 5)
    world.managed.deactivate(lost)
    stood_m = driven_after(world, 1.5)
    assert driven_after(world, 3) == pytest.approx(stood_m, abs=0.01)
    world.managed.activate(lost)
    assert driven_after(world, 4) > stood_m + 1.0


def test_vehicle_without_energy_stands():
    world = started(straight(20.0), ("amcl", "kinect"), capacity_j=300)
    stood_m = driven_after(world, 15)
    assert math.isclose(driven_after(world, 3), stood_m, abs_tol=0.01)
    assert world.results()["energy_used_j"] == 300
