"""Verification: bugs are found with a story, correct missions are silent, runs agree."""

import json
from math import inf

import pytest
from proof_mutants import CORRECT, MUTANTS, Act
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
from missions.proof import Leaf, verify
from missions.proof.setup import setup_of
from missions.proof.verification import prove
from rosa_bt import IsActionFeasible, Measurement, UntilSuccess, do_until_unfeasible, first_feasible

ENDS = "the mission ends with its goal only"
DEAD = "it never stands still for good while an action of it is feasible"


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


def look(kb):
    return Act("look", kb, "inspect")


def broken(proof):
    return {finding.name: finding for finding in proof.broken}


@pytest.mark.parametrize("case", MUTANTS, ids=lambda case: case.name)
def test_seeded_bug_is_found_with_its_story(case):
    proof = verify(case.tree, case.model, **case.arguments)
    finding = next(each for each in proof.broken if case.broken in each.name)
    assert finding.what
    assert finding.trail is None or proof.story(finding.trail) == proof.story(finding.trail)


@pytest.mark.parametrize("case", CORRECT, ids=lambda case: case.name)
def test_correct_mission_is_silent(case):
    proof = verify(case.tree, case.model, **case.arguments)
    assert not proof.explored.unexplored
    assert not proof.broken, proof


@pytest.mark.parametrize("seed", [5, 8])
def test_brute_force_finds_the_same(seed):
    assert agree(seed, rounds=2) > 20


@pytest.mark.parametrize("leaf", [Leaf(), Leaf(effects={"S": {"energy": 1.0}})])
def test_fallback_that_succeeds_is_not_the_goal(leaf):
    def tree(kb):
        return first_feasible("mission", [look(kb), Act("go", kb, "charge")])

    finding = broken(verify(tree, drone(), leaves={"go": leaf}, suggest=True))[ENDS]
    assert "the success of charge ends the mission" in finding.what
    assert finding.advice == "write do_until_unfeasible(look, go) in place of mission"


@pytest.mark.parametrize(("needed", "is_dead"), [(0.3, True), (0.2, False)])
def test_dead_zone_between_two_thresholds_is_found(needed, is_dead):
    def tree(kb):
        able = IsActionFeasible("able?", kb, "inspect")
        patrol = Sequence("patrol", memory=False, children=[able, look(kb)])
        low = Measurement("low?", kb, "energy", "<", 0.2)
        dock = Sequence("dock", memory=False, children=[low, Act("charge", kb, "charge")])
        return UntilSuccess("for ever", Selector("both", memory=False, children=[patrol, dock]))

    proof = verify(tree, drone(needed=needed), leaves={"charge": Leaf("RF")})
    assert (DEAD in broken(proof)) is is_dead
    if is_dead:
        assert "charge could be done" in broken(proof)[DEAD].what
        assert "  1. energy is measured 0.25; no leaf is asked" in str(proof)


def test_timeouts_of_py_trees_are_free_answers():
    def tree(kb):
        steps = [look(kb), Timer("wait", 3.0), Act("charge", kb, "charge")]
        return Timeout("in time", Sequence("steps", memory=True, children=steps), 10.0)

    proof = verify(tree, drone())
    assert not proof.explored.unexplored
    assert len(proof.explored.situations) <= 31
    assert not proof.broken, proof
    rounds = [each for situation in proof.explored.situations for each in situation.rounds]
    answers = [each.step.answers for each in rounds]
    assert any(("in time", "S") in each for each in answers)


def test_facts_under_one_and_are_explored_as_one_bit():
    def size(facts, **options):
        return len(verify(tree, drone(facts), **options).explored.situations)

    def tree(kb):
        return do_until_unfeasible(look(kb), Act("charge", kb, "charge"))

    assert size(2) == size(12) <= 200 < 10 * size(4, symmetric=False)


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
    assert [*broken(proof)] == ["nothing is requested while unfeasible for longer than a tick"]
    assert proof.notes == ["own requests actions by itself: its requests are followed"]


def test_action_that_the_tree_does_not_do_is_a_note():
    proof = verify(look, drone())
    assert not proof.broken
    assert proof.notes == ["charge is not done by this tree"]


@pytest.mark.parametrize(
    ("leaves", "reaches"),
    [
        ({}, "the goal"),
        ({"seen?": Leaf("FS", after=("inspect",))}, "the goal if it happens later"),
    ],
)
def test_percept_succeeds_only_after_its_deed(leaves, reaches):
    def tree(kb):
        seen = Condition("seen?", lambda: False)
        find = Selector("find", memory=False, children=[seen, look(kb)])
        return Sequence("all", memory=False, children=[find, Act("charge", kb, "charge")])

    consequence = verify(tree, drone(), leaves=leaves).consequences[0]
    assert (consequence.fact, consequence.reaches) == ("camera fails", reaches)


def test_wrong_use_is_refused():
    class Counting(Act):
        def stop(self, new_status):
            super().stop(new_status)
            self.later = (number for number in range(3))

    with pytest.raises(UnknownName, match="lok"):
        verify(look, drone(), leaves={"lok": Leaf()})
    with pytest.raises(ValueError, match="'X'"):
        Leaf("RX")
    with pytest.raises(MissionError, match="generator"):
        verify(lambda kb: Counting("look", kb, "inspect"), drone())


# ------------------------------------------------------------- the table, beside simulated runs

ALONE = {  # no second failure, and time enough
    "suave": {"thruster_events": "", "duration": "120"},
    "suave_extended": {"thruster_events": "", "duration": "120"},
    "uav": {"gripper_worn": "0", "samples": "2", "added_s": "0", "duration": "180"},
}


def succeeds(mission, fact):
    """Run a mission while one fact stays bad from the beginning, whatever is published."""
    run = open_run(mission, seed=1, settings=ALONE[mission.name])
    is_part = fact.kind == "component"
    bad = {
        "name": "test",
        "message": "component status" if is_part else "qa status",
        "values": {fact.name: "FALSE" if is_part else fact.value},
    }

    def alter(messages, now):
        for message in messages:
            for status in message["status"]:
                status["values"] = {
                    key: each for key, each in status["values"].items() if key != fact.name
                }
        return [*messages, {"time": now, "status": [bad]}]

    run.faults.alter = alter
    return run.run().success


LONG = pytest.param("uav", marks=pytest.mark.benchmark)


@pytest.mark.parametrize("name", ["suave", "suave_extended", LONG])
def test_table_of_single_failures_agrees_with_runs(name):
    mission = find_mission(name)
    proof = prove(setup_of(mission, seconds=inf))
    assert not proof.broken, proof
    promised = {}
    happened = {}
    bad = proof.explored.rig.environment.bad
    for fact, consequence in zip(bad, proof.consequences, strict=True):
        if "as long as" not in consequence.reaches:  # whether the battery lasts, a run shows
            promised[fact] = consequence.reaches == "the goal"
            happened[fact] = succeeds(mission, fact)
    assert promised == happened
    assert {*promised.values()} == {True, False}


# ------------------------------------------------------------- the command


def rosa(*words):
    return CliRunner().invoke(cli.app, ["verify", *words])


def test_verify_command_prints_findings_and_table(tmp_path):
    target = tmp_path / "proof.json"
    page = tmp_path / "page.html"
    result = rosa("suave", "--json", str(target), "--report", str(page))
    assert result.exit_code == 0, result.output
    assert "spiral_search fails                 the goal if it happens later" in result.output
    assert all(finding["holds"] for finding in json.loads(target.read_text())["findings"])
    assert "search_pipeline" in page.read_text()


def test_tree_that_plans_by_itself_is_finished():
    proof = prove(setup_of(find_mission("agv"), seconds=inf))
    assert not proof.explored.unexplored
    assert not proof.broken, proof
    reaches = {each.fact: each.reaches for each in proof.consequences}
    assert reaches["amcl fails"] == "the goal"
    assert reaches["base fails"] == "the goal if it happens later"


def test_verify_command_exits_by_what_was_found(tmp_path, monkeypatch):
    assert rosa("suave", "--seconds", "0").exit_code == 3
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
    result = rosa("careless:MISSION", "--suggest")
    assert result.exit_code == 1, result.output
    assert "NO   nothing is requested while unfeasible" in result.output
    assert "note search_pipeline is not done by this tree" in result.output
