"""Verification: what is wrong is found with a story, what is right is silent, and runs keep what it promises."""

import json
import subprocess
import sys

import pytest
from proof_mutants import CORRECT, FULL, MUTANTS, Act, either, rover_model
from proof_twin import agree
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Selector, Sequence
from py_trees.decorators import Timeout
from py_trees.timers import Timer
from typer.testing import CliRunner

from kb import Model, UnknownName
from missions import cli
from missions.baselines import open_run
from missions.engine.mission import Condition, MissionError, find_mission
from missions.proof import Leaf, eventually, verify
from missions.proof.verification import as_test, prove, setup_of
from rosa_bt import IsActionFeasible, Measurement, UntilSuccess, do_until_unfeasible, first_feasible

ENDS = "the mission ends with its goal only"
DEAD = "it never stands still for good while an action of it is feasible"
CHARGES = {"charge": Leaf(effects={"S": {"energy": 1.0}})}


def drone(facts=1, needed=0.3):
    def make():
        model = Model("drone")
        energy = model.quality_attribute("energy", low=0.0, high=1.0)
        camera = model.component("camera", kind="lifecycle")
        see = model.function("see").design("by_camera", [camera]).function
        inspect = model.action("inspect", requires=[see], constraints=[energy >= needed])
        for number in range(1, facts):
            inspect.constrain(model.environmental_attribute(f"fact_{number}") >= 0.5)
        model.action("charge")
        return model

    return make


def broken(proof):
    return {finding.name: finding for finding in proof.broken}


@pytest.mark.parametrize("case", MUTANTS, ids=lambda case: case.name)
def test_seeded_bug_is_found_with_its_story(case):
    proof = verify(case.build, case.model, wanted=case.wanted, **{**FULL, **case.given})
    finding = next(each for each in proof.broken if case.broken in each.name)
    assert finding.what
    assert finding.trail is None or proof.story(finding).trace == proof.story(finding).trace


@pytest.mark.parametrize("case", CORRECT, ids=lambda case: case.name)
def test_correct_mission_is_silent(case):
    proof = verify(case.build, case.model, wanted=case.wanted, **{**FULL, **case.given})
    assert proof.explored.is_finished
    assert not proof.broken, proof


@pytest.mark.parametrize("seed", [5, 8])
def test_brute_force_finds_the_same(seed):
    assert agree(seed, rounds=2) > 20


def test_fallback_that_succeeds_is_not_the_goal_and_advice_mends_it():
    def tree(kb):
        return first_feasible("mission", [Act("look", kb, "inspect"), Act("go", kb, "charge")])

    for leaves in ({}, {"go": CHARGES["charge"]}):
        finding = broken(verify(tree, drone(), leaves=leaves, suggest=True))[ENDS]
        assert "the success of charge ends the mission" in finding.what
        assert finding.advice == "write do_until_unfeasible(look, go) in place of mission"


def test_dead_zone_between_two_thresholds_is_found_with_its_story():
    def tree(kb):
        able = IsActionFeasible("able?", kb, "inspect")
        patrol = Sequence("patrol", memory=False, children=[able, Act("look", kb, "inspect")])
        low = Measurement("low?", kb, "energy", "<", 0.2)
        dock = Sequence("dock", memory=False, children=[low, Act("charge", kb, "charge")])
        both = Selector("both", memory=False, children=[patrol, dock])
        return UntilSuccess("for ever", both)

    proof = verify(tree, drone(), leaves={"charge": Leaf("RF")})
    finding = broken(proof)[DEAD]
    assert "charge could be done" in finding.what
    assert proof.story(finding).rig.measured("energy") == 0.25
    assert DEAD not in broken(verify(tree, drone(needed=0.2), leaves={"charge": Leaf("RF")}))


def test_timeouts_of_py_trees_are_free_answers():
    def tree(kb):
        steps = [Act("look", kb, "inspect"), Timer("wait", 3.0), Act("charge", kb, "charge")]
        return Timeout("in time", Sequence("steps", memory=True, children=steps), 10.0)

    proof = verify(tree, drone())
    assert proof.explored.is_finished
    assert len(proof.explored.situations) <= 31
    assert not proof.broken, proof
    late = [step for each in proof.explored.rounds for step in each if step.step.answers]
    assert any(("in time", "S") in each.step.answers for each in late)


def test_facts_under_one_and_are_explored_as_one_bit():
    def tree(kb):
        return do_until_unfeasible(Act("look", kb, "inspect"), Act("charge", kb, "charge"))

    sizes = [len(verify(tree, drone(facts)).explored.situations) for facts in (2, 12)]
    assert sizes[0] == sizes[1] <= 200
    assert len(verify(tree, drone(4), symmetric=False).explored.situations) > sizes[0]


def test_leaf_that_requests_by_itself_is_followed():
    class Own(Behaviour):
        def __init__(self, kb):
            super().__init__("own")
            self.kb = kb

        def update(self):
            self.kb.request_action("inspect")
            return Status.RUNNING

        def terminate(self, new_status):
            self.kb.cancel_action("inspect")

    proof = verify(Own, drone())
    assert list(broken(proof)) == ["nothing is requested while unfeasible for longer than a tick"]
    assert "own requests actions by itself: its requests are followed" in proof.notes


def test_action_that_the_tree_does_not_do_is_a_note():
    proof = verify(lambda kb: Act("look", kb, "inspect"), drone())
    assert not proof.broken
    assert proof.notes == ("charge is not done by this tree",)


def test_percept_succeeds_only_after_the_deed_that_it_is_declared_after():
    def tree(kb):
        seen = Condition("seen?", lambda: False)
        find = Selector("find", memory=False, children=[seen, Act("look", kb, "inspect")])
        return Sequence("all", memory=False, children=[find, Act("charge", kb, "charge")])

    def reached(**leaves):
        proof = verify(tree, drone(), leaves=leaves)
        return {each.facts[0]: each.reaches for each in proof.consequences}["camera fails"]

    assert reached() == "the goal"
    assert reached(**{"seen?": Leaf("FS", after=("inspect",))}) == "the goal if it happens later"


def test_wrong_use_is_refused():
    with pytest.raises(UnknownName, match="lok"):
        verify(lambda kb: Act("look", kb, "inspect"), drone(), leaves={"lok": Leaf()})
    with pytest.raises(ValueError, match="'X'"):
        Leaf("RX")
    model = drone()()
    model.change(model.constraints[0], hysteresis=0.1)
    with pytest.raises(MissionError, match="function that makes the model"):
        verify(lambda kb: Act("look", kb, "inspect"), model)


def test_state_that_cannot_be_restored_is_refused():
    class Counting(Act):
        def stop(self, new_status):
            super().stop(new_status)
            self.later = (number for number in range(3))

    with pytest.raises(MissionError, match="generator"):
        verify(lambda kb: Counting("look", kb, "inspect"), drone())


def test_eventually_asks_for_what_deeds_bring_about():
    wanted = (eventually("it charges", lambda rig: rig.is_required("charge")),)
    assert not verify(lambda kb: either(kb), rover_model(), wanted=wanted, **FULL).broken[1:]


# ------------------------------------------------------------- the table, beside simulated runs

ALONE = {  # no second failure, and time enough
    "suave": {"thruster_events": ""},
    "suave_extended": {"thruster_events": ""},
    "uav": {"gripper_worn": "0", "duration": "900"},
}


def succeeds(mission, name, value):
    """Run a mission while one fact stays bad from the beginning, whatever is published."""
    run = open_run(mission, seed=1, settings=ALONE[mission.name])
    what = "component status" if value is True else "qa status"

    def alter(messages, now):
        kept = []
        for message in messages:
            statuses = []
            for status in message["status"]:
                values = {key: one for key, one in status["values"].items() if key != name}
                statuses.append({**status, "values": values})
            kept.append({**message, "status": statuses})
        bad = {
            "name": "test",
            "message": what,
            "values": {name: "FALSE" if value is True else value},
        }
        return [*kept, {"time": now, "status": [bad]}]

    run.alter = alter
    return run.run().success


@pytest.mark.parametrize("name", ALONE)
def test_table_of_single_failures_agrees_with_simulated_runs(name):
    mission = find_mission(name)
    proof = prove(setup_of(mission))
    assert proof.explored.is_finished
    assert not proof.broken, proof
    environment = proof.explored.rig.environment
    facts = [(group[0], True) for group in environment.alike]
    facts += environment.worst.items()
    told = {}
    for (fact, value), consequence in zip(facts, proof.consequences, strict=False):
        if "as long as" not in consequence.reaches:  # whether the battery lasts, a run shows
            told[fact] = consequence.reaches == "the goal", succeeds(mission, fact, value)
    assert all(promised == happened for promised, happened in told.values()), told
    assert {promised for promised, _ in told.values()} == {True, False}


# ------------------------------------------------------------- the command


def rosa(*words):
    return CliRunner().invoke(cli.app, ["verify", *words])


def test_verify_command_prints_findings_and_table(tmp_path):
    target = tmp_path / "proof.json"
    page = tmp_path / "page.html"
    result = rosa("suave", "--json", str(target), "--report", str(page))
    assert result.exit_code == 0, result.output
    assert "spiral_search fails                 the goal if it happens later" in result.output
    data = json.loads(target.read_text())
    assert data["finished"]
    assert all(finding["holds"] for finding in data["findings"])
    assert "pipeline" in page.read_text()


def test_verify_command_exits_by_what_was_found(tmp_path, monkeypatch):
    assert rosa("suave", "--most", "5").exit_code == 3
    (tmp_path / "careless.py").write_text(
        "from dataclasses import replace\n"
        "from missions.suave import MISSION as SUAVE\n"
        "from missions.suave.tree import InspectPipeline\n"
        "def tree(kb, percepts):\n"
        "    leaf = InspectPipeline(kb, percepts)\n"
        "    leaf.even_if_unfeasible = True\n"
        "    return leaf\n"
        "MISSION = replace(SUAVE, tree=tree)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    test = tmp_path / "test_story.py"
    result = rosa("careless:MISSION", "--test", str(test), "--suggest")
    assert result.exit_code == 1, result.output
    assert "nothing is requested while unfeasible" in result.output
    assert "note search_pipeline is not done by this tree" in result.output
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(test)]
    story = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert story.returncode == 1, story.stdout + story.stderr
    assert "is requested while it is unfeasible" in story.stdout


def test_story_as_test_names_the_property():
    proof = verify(lambda kb: Act("look", kb, "inspect", even_if_unfeasible=True), drone())
    text = as_test("SETUP_OF_MINE", proof.broken[0])
    assert "def test_nothing_is_requested_while_unfeasible" in text
    assert "SETUP = SETUP_OF_MINE" in text
