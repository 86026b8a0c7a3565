"""`rosa check`: a model is judged together with the trees and PDDL files that use it."""

import json
import shlex
import shutil
import sys
from dataclasses import replace

import pytest
from running import called, register

from kb import Model
from kb.checks import rules
from kb.ontology import ROSA
from missions.commands.check import judge
from missions.engine.mission import MISSIONS, find_mission
from rosa_bt import IsActionFeasible

DOMAIN = """
(define (domain cave) (:requirements :strips :typing)
  (:types task - action place action)
  (:constants look - task here - place)
  (:predicates (action_feasible ?a - action) (lit ?p - place))
)
"""
PROBLEM = """
(define (problem p) (:domain cave)
  (:objects explore charge - action
            there - place)
  (:init) (:goal (and)))
"""
TREES = """
from py_trees.composites import Sequence
from py_trees.trees import BehaviourTree
from rosa_bt import IsActionFeasible, RosaAction

class Explore(RosaAction):
    def update(self):
        raise AssertionError("nothing is run")

def of_both(kb, percepts):
    assert not percepts.holds("anything")
    return Sequence("all", memory=False, children=[IsActionFeasible("can it?", kb, "expolre"),
                                                   Explore("do it", kb, "explore")])

def of_kb(kb, period=1.0):
    return BehaviourTree(IsActionFeasible("can it?", kb, "explore"))

def of_nothing():
    return Sequence("empty", memory=False)

def of_a_mistake(kb, percepts):
    return percepts.wings

def of_a_component(kb):
    return kb.components["wing"]

TREE = Sequence("empty", memory=False)
"""


EXPLORER = """insert
$camera isa Component, has component-name "camera";
$see isa Function, has function-name "see";
(function: $see, required-component: $camera) isa function-design,
    has function-design-name "by camera", has priority 1;
$explore isa Action, has action-name "explore";
(action: $explore, required-function: $see) isa functional-requirement;
"""


def explorer():
    model = Model("explorer")
    see = model.function("see")
    see.design("by camera", [model.component("camera")], priority=1)
    model.action("explore", requires=[see])
    return model


@pytest.fixture
def rosa(capsys, monkeypatch, tmp_path):
    """Run `rosa check` beside a module of trees; returns exit status, output and errors."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "trees", raising=False)
    (tmp_path / "trees.py").write_text(TREES)
    (tmp_path / "domain.pddl").write_text(DOMAIN)
    (tmp_path / "problem.pddl").write_text(PROBLEM)
    (tmp_path / "explorer.tql").write_text(EXPLORER)
    return lambda text: called(capsys, monkeypatch, "check", *shlex.split(text))


@pytest.mark.parametrize("name", MISSIONS)
def test_own_missions_have_nothing_to_find(rosa, name):
    assert rosa(f"--mission {name} --strict") == (0, f"model {name}: nothing found\n", "")


def test_sound_files_exit_0(rosa):
    expected = (0, "model explorer: nothing found\n", "")
    assert rosa("explorer.tql --tree trees:of_kb") == expected


def test_findings_are_grouped_with_advice_and_counted(rosa):
    model = explorer()
    for name in ("fog", "wind"):
        model.quality_attribute(name)
    model.save("foggy.owl")
    assert rosa("foggy.owl")[0] == 0
    assert rosa("foggy.owl --strict")[0] == 1
    model.action("dive", requires=[model.function("sink")])
    model.save("slips.owl")
    code, out, err = rosa("slips.owl")
    assert (code, err) == (1, "")
    *lines, last = out.splitlines()
    assert lines == [
        "error function-without-designs",
        "  function sink has no design, so action dive can never be feasible",
        f"  -> {rules()['function-without-designs'].advice}",
        "warning unused-attribute",
        "  nothing depends on attribute fog",
        "  nothing depends on attribute wind",
        f"  -> {rules()['unused-attribute'].advice}",
    ]
    assert last.endswith(": 1 error and 2 warnings")


def test_json_carries_every_part_of_a_finding(rosa):
    code, out, _ = rosa("explorer.tql --tree trees:of_both --json")
    assert code == 1
    data = json.loads(out)
    assert (data["model"], data["errors"], data["warnings"]) == ("explorer", 1, 0)
    assert data["findings"] == [
        {
            "code": "unknown-action",
            "severity": "error",
            "element": "expolre",
            "message": "unknown action 'expolre'; did you mean 'explore'?",
            "advice": rules()["unknown-action"].advice,
            "place": "behaviour 'can it?' of tree trees:of_both",
        }
    ]


def test_trees_and_domains_are_taken_together(rosa):
    unmentioned = "action explore is mentioned nowhere"
    assert unmentioned in rosa("explorer.tql --tree trees:of_nothing")[1]
    two = "explorer.tql --tree trees:of_nothing --tree trees:of_kb"
    assert unmentioned not in rosa(two)[1]
    files = "--pddl domain.pddl --pddl problem.pddl"
    code, out, _ = rosa(f"explorer.tql --tree trees:of_both {files}")
    assert code == 1
    assert "problem.pddl:3: unknown action 'charge'" in out
    assert "domain.pddl:4: unknown action 'look'" in out
    assert "3 errors" in out


def test_name_that_a_tree_gets_while_it_runs_is_no_finding():
    def tree(kb, percepts):
        return IsActionFeasible("later", kb)

    mission = replace(find_mission("suave"), tree=tree, domain=None, problem=None)
    assert judge(explorer(), mission, [], []) == []


def test_files_are_judged_with_the_tree_of_a_mission(rosa):
    code, out, _ = rosa("explorer.tql --mission suave")
    assert code == 1
    place = "behaviour 'search feasible?' of the tree of suave"
    assert f"{place}: unknown action 'search_pipeline'" in out
    assert "action explore is mentioned nowhere" in out


def test_own_mission_with_a_misspelt_action_is_judged(rosa, monkeypatch):
    def tree(kb, percepts):
        return IsActionFeasible("search?", kb, "serch_pipeline")

    register(monkeypatch, "broken", replace(find_mission("suave"), name="broken", tree=tree))
    code, out, _ = rosa("--mission broken")
    assert code == 1
    assert "did you mean 'search_pipeline'" in out


def test_action_that_planning_passes_over_is_told_once(rosa, monkeypatch):
    suave = find_mission("suave")

    def larger():
        model = suave.model()
        model.action("surface", requires=[model.functions["maintain_motion"]])
        return model

    def tree(kb, percepts):
        return IsActionFeasible("up?", kb, "surface")

    named = replace(suave, name="ascending", model=larger)
    register(monkeypatch, "ascending", replace(named, tree=tree))
    code, out, _ = rosa("--mission ascending")
    assert (code, "warning file-note" in out) == (0, True)
    assert "the action 'surface' of the knowledge base is never planned" in out
    register(monkeypatch, "planned", replace(named, tree=None))
    _, out, _ = rosa("--mission planned")
    assert "action surface is mentioned nowhere" in out
    assert "never planned" not in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("", "no model is named; name its files, or a mission with --mission NAME"),
        ("--mission :MISSION", "unknown mission ':MISSION'; there are suave"),
        ("broken.tql", "broken.tql:2:"),
        ("rover:MISSION", "the name of a model's file ends in .tql or .owl, not in ''"),
        ("explorer.tql --tree trees", "there are none by name, a tree is given as module:call"),
        ("explorer.tql --tree trees:wood", "import tree 'trees:wood': trees has no 'wood'"),
        ("explorer.tql --tree trees:TREE", "is a Sequence, not a function that builds a tree"),
        ("explorer.tql --tree trees:of_a_mistake", "trees:of_a_mistake: AttributeError"),
        ("explorer.tql --tree trees:of_a_component", "unknown component 'wing'"),
        ("explorer.tql --pddl nowhere.pddl", "nowhere.pddl: cannot read this PDDL file"),
        ("explorer.tql --pddl a --pddl b --pddl c", "and once more for its problem"),
    ],
)
def test_wrong_use_is_one_clear_message_and_exits_2(rosa, tmp_path, arguments, message):
    (tmp_path / "broken.tql").write_text('insert\n$a isa Action has action-name "a";\n')
    code, out, err = rosa(arguments)
    assert code == 2
    assert message in " ".join(err.split())
    assert out == ""


needs_java = pytest.mark.skipif(shutil.which("java") is None, reason="HermiT needs Java")


@needs_java
def test_consistent_model_passes_hermit(rosa):
    code, out, _ = rosa("explorer.tql --tree trees:of_kb --reason")
    assert code == 0
    assert "HermiT finds no contradiction" in out


@needs_java
def test_contradiction_that_another_editor_left_fails(rosa, tmp_path):
    explorer().save("rover.owl")
    subclass = f'<rdfs:subClassOf rdf:resource="{ROSA}Component"/>'
    wrong = f'<owl:Class rdf:about="{ROSA}Function">{subclass}</owl:Class>'
    file = tmp_path / "rover.owl"
    file.write_text(file.read_text().replace("</rdf:RDF>", f"{wrong}</rdf:RDF>"))
    code, _, err = rosa("rover.owl --reason")
    assert code == 1
    assert "rover.owl: HermiT finds the ontology inconsistent" in " ".join(err.split())


def test_reasoning_without_java_says_what_to_install(rosa, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    code, _, err = rosa("explorer.tql --reason")
    assert code == 2
    assert "needs a Java runtime" in err


CURES = """(define (domain spraying) (:requirements :typing) (:types action)
  (:predicates (action_feasible ?a - action) (spray_action ?a - action) (sprayed)
    (refill_action ?a - action) (swap_action ?a - action))
  (:action spray :parameters (?a - action)
    :precondition (and (spray_action ?a) (action_feasible ?a)) :effect (sprayed))
  (:action refill :parameters (?a ?b - action)
    :precondition (and (refill_action ?a) (spray_action ?b)) :effect (action_feasible ?b))
  (:action swap :parameters (?a ?b - action)
    :precondition (and (swap_action ?a) (spray_action ?b)) :effect (action_feasible ?b)))"""
SPRAY = """(define (problem p) (:domain spraying) (:objects spray refill swap - action)
  (:init (spray_action spray) (refill_action refill) (swap_action swap)) (:goal (sprayed)))"""


@pytest.mark.parametrize(
    ("said", "silent"), [("", "refill and swap"), ("refill", "swap"), ("refill swap", "")]
)
def test_two_actions_that_promise_the_same_are_named_unless_the_model_says_what_they_cure(
    rosa, tmp_path, said, silent
):
    model = Model("orchard")
    cured = {"refill": model.quality_attribute("tank"), "swap": model.component("boom")}
    model.action("spray", constraints=[cured["refill"] >= 0.2])
    for name, what in cured.items():
        model.action(name, restores=[what] if name in said.split() else [])
    model.save("orchard.owl")
    (tmp_path / "cures.pddl").write_text(CURES)
    (tmp_path / "spray.pddl").write_text(SPRAY)
    code, out, err = rosa("orchard.owl --pddl cures.pddl --pddl spray.pddl")
    assert (code, err) == (0, "")
    found = [line.strip() for line in out.splitlines() if "action spray is made" in line]
    words = f"the model does not say what {silent} can restore"
    expected = f"action spray is made feasible by refill and swap; {words}"
    assert found == ([expected] if silent else [])
