"""The aerial vehicle: every scenario is answered, switching is safe, and it flies as told."""

import math

import numpy
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from running import Watcher, rosa_run, run_mission

from kb import KnowledgeBase
from missions.engine.mission import MissionError, Percepts, find_mission
from missions.engine.percepts import failed, recovered, sensed
from missions.engine.settings import RunSettings
from missions.engine.task_layer import TASK_KINDS
from missions.uav.model import uav_model
from missions.uav.tree import facts, is_all_analysed
from missions.uav.vehicle import (
    AIR_KG_M3,
    ARM_M,
    FIGURE_OF_MERIT,
    GRAVITY_M_S2,
    REACTION_M,
    ROTOR_RADIUS_M,
    STEP_S,
    Quadrotor,
    mixed,
)
from missions.uav.world import Settings, UavWorld

SEARCH, PICK_UP, LOOK = "search_for_samples", "pick_up_and_analyse", "analyse_on_site"
RETURN, FOLD = "return_and_recharge", "land_and_fold_gripper"
FOLDED_DEG = 10
SMALL = st.floats(-0.05, 0.05)


class Guard(Watcher):
    """Watches the rules of the transition and of the safe state at each tick."""

    def __init__(self):
        super().__init__()
        self.breaches = []

    def tick(self, run):
        seen = run.world.sample()
        is_active = run.world.managed.is_active
        is_unfolded = seen.signals["gripper [deg]"] > FOLDED_DEG or is_active("gripper")
        if is_unfolded and is_active("infrared_camera"):
            self.breaches.append(f"{seen.time} s: it looks with an unfolded gripper")
        if seen.position[2] < 0.3:
            self.breaches.append(f"{seen.time} s: it is in the ground")

    def check(self, run):
        assert self.breaches == []
        assert run.kb.required_actions == ()
        last = None
        for action in run.actions:
            assert (last, action.action) != (PICK_UP, LOOK)
            if action.action == PICK_UP or (action.action == FOLD and action.result == "completed"):
                last = action.action


@pytest.mark.parametrize("task", TASK_KINDS)
def test_each_scenario_occurs_and_is_answered(task):
    guard = Guard()
    run, _, data = run_mission("uav", task, 1, listeners=[guard])
    guard.check(run)
    assert data["outcome"] == "analysed_all"
    assert data["analysed_samples"] == data["wanted_samples"] == 8
    changes = [(row["change"].split(";")[0], row["reason"]) for row in data["adaptations"]]
    for change, cause in (
        (f"{SEARCH} -> {RETURN}", "battery_level"),
        (f"{PICK_UP} -> {FOLD}", "battery_level"),
        (f"{PICK_UP} -> {FOLD}", "gripper has failed"),
    ):
        assert any(change == row and cause in why for row, why in changes)
    happened = {row["what"]: row["at_s"] for row in data["disturbances"]}
    assert happened["an operator reports sample_8"] == pytest.approx(60, abs=0.2)
    early = [step for plan in data["plans"] if plan["at_s"] < 59.9 for step in plan["steps"]]
    late = [step for plan in data["plans"] if plan["at_s"] >= 59.9 for step in plan["steps"]]
    assert not any("sample_8" in step for step in early)
    assert task == "bt" or any("sample_8" in step for step in late)


class Mishaps(UavWorld):
    """A field in which things happen at set times: (time [s], what, value)."""

    script: tuple[tuple[float, str, float], ...] = ()

    def advance(self, until):
        due = [entry for entry in self.script if entry[0] <= self.now]
        self.script = tuple(entry for entry in self.script if entry not in due)
        for _, what, value in due:
            getattr(self, what)(value)
        return super().advance(min([until, *(entry[0] for entry in self.script)]))

    def drop(self, level):
        self.level = min(level, self.level)

    def jam(self, lasts_s):
        self.is_jammed = True
        self.let_go()
        self.messages.append(failed(self.now, "gripper"))
        self.script += ((self.now + lasts_s, "recover", 0.0),)

    def recover(self, _):
        self.is_jammed = False
        self.messages.append(recovered(self.now, "gripper"))

    def report(self, x):
        self.want((x, 3.0), is_reported=True)


MOMENTS = st.floats(0, 60)
MISHAPS = st.one_of(
    st.tuples(MOMENTS, st.just("drop"), st.sampled_from([0.54, 0.4, 0.29])),
    st.tuples(MOMENTS, st.just("jam"), st.sampled_from([0.1, 1.0, 10.0, 60.0])),
)


@settings(max_examples=3, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(MISHAPS, max_size=4), st.sampled_from([0.0, 0.5, 3.0]), st.sampled_from(TASK_KINDS))
def test_any_mishap_leaves_the_switch_safe_and_all_analysed(script, switching_s, task):
    values = {"samples": 1, "added_s": 0, "gripper_worn_s": 0, "switching_s": switching_s}
    world = Mishaps(Settings(**values), numpy.random.default_rng(0))
    world.script = (*script, (20.0, "report", 6.0))
    guard = Guard()
    run = rosa_run(find_mission("uav"), task, world, RunSettings(duration_s=900.0), (guard,))
    verdict = run.run()
    guard.check(run)
    assert verdict.success, verdict


def test_tree_without_the_transition_breaks_the_rule(monkeypatch):
    monkeypatch.setattr("missions.uav.tree.switch_safely", lambda root, transitions: root)
    guard = Guard()
    _, verdict, _ = run_mission("uav", duration_s=110, listeners=[guard])
    assert any("unfolded gripper" in breach for breach in guard.breaches)
    assert not verdict.success


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"capacity_j": 1000, "duration_s": 40}, "the battery ran empty, 0 of "),
        ({"duration_s": 40}, "time ran out, 1 of 7 samples were analysed"),
    ],
)
def test_flight_that_ends_early_says_why(values, reason):
    _, verdict, _ = run_mission("uav", **values)
    assert verdict.outcome == "aborted"
    assert verdict.reason.startswith(reason)


def test_healthy_vehicle_needs_no_adaptation():
    values = {"gripper_worn_s": 0, "capacity_j": 200000, "samples": 2, "added_s": 0}
    _, verdict, data = run_mission("uav", **values)
    assert verdict.success
    assert data["adaptations"] == []
    assert [action["name"] for action in data["actions"]] == [SEARCH, PICK_UP] * 2


@pytest.mark.parametrize(
    ("level", "failed", "actions"),
    [
        (1.0, None, {SEARCH, PICK_UP, LOOK, RETURN, FOLD}),
        (0.5, None, {SEARCH, LOOK, RETURN, FOLD}),
        (0.1, None, {RETURN, FOLD}),
        (1.0, "gripper", {SEARCH, LOOK, RETURN, FOLD}),
    ],
)
def test_knowledge_base_decides_as_the_paper_says(level, failed, actions):
    kb = KnowledgeBase(uav_model(), clock=lambda: 0.0)
    kb.measure("battery_level", level)
    if failed:
        kb.component_failed(failed)
    assert set(kb.selectable_actions()) == actions


def test_all_is_analysed_once_all_that_is_wanted_is():
    percepts = Percepts()
    assert not is_all_analysed(percepts)
    percepts.receive(sensed(0.0, sample_2_wanted=True))
    assert not is_all_analysed(percepts)
    percepts.receive(sensed(0.0, sample_2_analysed=True))
    assert is_all_analysed(percepts)


def test_gripper_that_a_plan_will_unfold_is_not_folded():
    kb = KnowledgeBase(uav_model(), clock=lambda: 0.0)
    percepts = Percepts()
    percepts.receive(sensed(0.0, gripper_folded=True))
    kb.request_action(PICK_UP)
    plan = kb.select({"grip_sample": "by_gripper"})
    assert not facts(kb, percepts)["(gripper_folded drone)"]
    kb.component_failed("gripper")
    kb.cancel_action(PICK_UP)
    kb.finish_plan(plan, "failed")
    assert facts(kb, percepts)["(gripper_folded drone)"]


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("samples", "8", "allowed is a whole number from 1 to 7"),
        ("samples", "2.5", "allowed is a whole number from 1 to 7"),
        ("wind_m_s", "abc", "allowed is a number from 0 to 4"),
        ("capacity_j", "nan", "allowed is a number from 1000"),
    ],
)
def test_world_setting_out_of_bounds_is_refused(name, value, words):
    with pytest.raises(MissionError, match=words):
        run_mission("uav", **{name: value})


# ---------------------------------------------------------------- the vehicle by itself


def flown(vehicle, seconds):
    for _ in range(round(seconds / STEP_S)):
        vehicle.step()
    return vehicle


@settings(max_examples=4)
@given(
    st.tuples(st.floats(-10, 10), st.floats(-10, 10), st.floats(0.5, 6)),
    st.floats(0, 2 * math.pi),
    st.floats(0, 0.5),
)
def test_vehicle_arrives_in_any_wind_with_any_load_and_lands(place, bearing, load):
    vehicle = Quadrotor((4 * math.cos(bearing), 4 * math.sin(bearing)))
    vehicle.carry(load)
    vehicle.go_to(place)
    assert flown(vehicle, 25).is_near(place, 0.15)
    vehicle.land()
    flown(vehicle, 12)
    assert vehicle.is_landed
    assert vehicle.rotor_w == 0


def test_hovering_takes_the_power_of_momentum_theory():
    vehicle = Quadrotor((0.0, 0.0))
    vehicle.go_to((0.0, 0.0, 3.0))
    weight = 1.5 * GRAVITY_M_S2
    area = 4 * math.pi * ROTOR_RADIUS_M**2
    ideal_w = weight**1.5 / math.sqrt(2 * AIR_KG_M3 * area)
    expected_w = ideal_w / FIGURE_OF_MERIT
    assert flown(vehicle, 15).rotor_w == pytest.approx(expected_w, rel=0.01)
    vehicle.carry(0.3)
    loaded_w = expected_w * (1.8 / 1.5) ** 1.5
    assert flown(vehicle, 15).rotor_w == pytest.approx(loaded_w, rel=0.01)
    vehicle.has_power = False
    assert flown(vehicle, 5).position[2] < 0.5


@given(st.floats(-100, 100), st.tuples(SMALL, SMALL, SMALL))
def test_rotors_balance_before_they_lift(thrust, torques):
    one, two, three, four = mixed(thrust, numpy.array(torques))
    assert all(0 <= rotor <= 8.0 for rotor in (one, two, three, four))
    assert ARM_M * (one + two - three - four) == pytest.approx(torques[0], abs=1e-9)
    assert ARM_M * (-one + two + three - four) == pytest.approx(torques[1], abs=1e-9)
    if 8 <= thrust <= 20:
        assert one + two + three + four == pytest.approx(thrust)
        yaw = REACTION_M * (one - two + three - four)
        assert yaw == pytest.approx(torques[2], abs=1e-9)


def test_command_to_the_vehicle_takes_its_time_or_is_refused():
    world = UavWorld(Settings(switching_s=0.5), numpy.random.default_rng(0))
    operation = world.managed.activate("search_planner")
    while world.now < 0.49:
        world.advance(0.49)
    assert not operation.done()
    while world.now < 0.5:
        world.advance(0.5)
    assert operation.done()
    assert world.managed.is_active("search_planner")
    with pytest.raises(MissionError, match=r"'griper' with .* is unknown; there are .*, gripper, "):
        world.managed.activate("griper")
    with pytest.raises(MissionError, match=r"'gripper' with .*force.* have no parameters"):
        world.managed.set_parameters("gripper", {"force": 1.0})
