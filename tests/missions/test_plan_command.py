"""`rosa plan` as a person uses it: the plan, why not, its files, and what is wrong."""

import json
import shlex
from dataclasses import replace
from itertools import chain, combinations
from pathlib import Path
from xml.etree import ElementTree

import pytest
from running import called

from missions import suave, suave_extended
from missions.engine.mission import MissionError, find_mission
from missions.engine.task_layer import mission_domain
from rosa_pddl import Planner, Problem, initial_state, load_domain

FOLDERS = {module.MISSION.name: module.__path__[0] for module in (suave, suave_extended)}
DOMAIN, FILE = (f"{FOLDERS['suave_extended']}/{name}.pddl" for name in ("domain", "problem"))
EXTENDED = f"{DOMAIN} {FILE}"
NO_MISSION = "give a domain and a problem file, or a mission"


@pytest.fixture
def rosa(capsys, monkeypatch, tmp_path):
    """Run `rosa plan` in an empty folder; returns exit status, lines of output, and errors."""
    monkeypatch.chdir(tmp_path)

    def run(text):
        code, out, err = called(capsys, monkeypatch, "plan", *shlex.split(text))
        return code, out.splitlines(), err

    return run


def plans_of(domain):
    """Return the plan for each set of feasible actions; None where there is none."""
    planner = Planner()
    actions = domain.rosa_actions
    plans = {}
    sizes = range(len(actions) + 1)
    for feasible in chain.from_iterable(combinations(actions, size) for size in sizes):
        state = initial_state(domain) | {domain.feasible_atom(action) for action in feasible}
        result = planner.plan(Problem(domain, state))
        plans[feasible] = result.steps if result.outcome.is_solved else None
    return plans


def test_plan_is_shown_with_what_each_step_needs(rosa):
    code, lines, err = rosa("--mission suave")
    assert (code, err) == (0, "")
    assert lines == [
        "solved optimally by search: 2 steps, cost 2",
        "  1  search_pipeline(search_pipeline, pipeline, bluerov)",
        "  2  inspect_pipeline(inspect_pipeline, pipeline, bluerov)  "
        "needs (pipeline_found pipeline) by 1",
    ]


def test_files_hold_outcome_steps_and_a_picture(rosa, tmp_path):
    low = "--mission suave_extended --situation battery_level=0.2"
    assert rosa(f"{low} --json plan.json --svg plan.svg")[0] == 0
    data = json.loads((tmp_path / "plan.json").read_text())
    steps = [step["action"] for step in data.pop("steps")]
    assert steps == ["recharge", "search_pipeline", "inspect_pipeline"]
    outcome = {"outcome": "solved optimally", "engine": "search", "cost": 3.0}
    assert data == {**outcome, "assumptions": []}
    elements = list(ElementTree.parse(tmp_path / "plan.svg").getroot())
    tags = [element.tag.rpartition("}")[2] for element in elements]
    assert tags.count("rect") - 1 == len(steps) + 1
    assert tags.count("path") == 4, "recharge needs two, search one, inspect the goal"
    assert "(pipeline_found pipeline)" in [element.text for element in elements]


def test_situation_says_why_each_unfeasible_action_is_out(rosa, tmp_path):
    find_mission("suave_extended").model().save(tmp_path / "robot.owl")
    for question in ("--mission suave_extended", f"{EXTENDED} --model robot.owl"):
        code, lines, _ = rosa(f"{question} --situation battery_level=0.2")
        assert code == 0
        steps = [line.split("(")[0].split()[-1] for line in lines[1:4]]
        assert steps == ["recharge", "search_pipeline", "inspect_pipeline"]
        reason = "is unfeasible because battery_level 0.2 violates >= 0.25 (measured 0.0 s ago)"
        assert lines[4:] == [f"out: {name}_pipeline {reason}" for name in ("search", "inspect")]


def test_action_of_the_model_that_is_never_planned_is_noted(rosa, tmp_path):
    find_mission("suave_extended").model().save(tmp_path / "robot.owl")
    folder = FOLDERS["suave"]
    code, lines, _ = rosa(f"{folder}/domain.pddl {folder}/problem.pddl --model robot.owl")
    assert code == 0
    note = "note: the action 'recharge' of the knowledge base is never planned"
    assert any(note in line for line in lines)


@pytest.mark.parametrize(
    ("question", "lines"),
    [
        (
            "--mission suave_extended --goal '(recharged bluerov)(not (pipeline_found pipeline))'",
            ["  1  recharge(recharge, search_pipeline, inspect_pipeline, bluerov)"],
        ),
        ("--mission suave --goal '(not (pipeline_found pipeline))'", []),
    ],
)
def test_goal_may_be_another_one_and_several(rosa, question, lines):
    code, (_, *steps), _ = rosa(question)
    assert (code, steps) == (0, lines)


ALL_BROKEN = "battery_level=0.2,c_thruster_1=failed,recover_thrusters=failed"
NOT_INSPECTED = "out of reach: (pipeline_inspected pipeline)"
WOULD_BE = "there would be a plan if they were feasible"
NOT_ACTION = "(search_pipeline_action recharge)"


@pytest.mark.parametrize(
    ("question", "lines"),
    [
        (
            "--mission suave --situation follow_pipeline=failed",
            [NOT_INSPECTED, f"unfeasible now: inspect_pipeline; {WOULD_BE}"],
        ),
        (
            f"--mission suave_extended --situation {ALL_BROKEN}",
            [
                NOT_INSPECTED,
                f"unfeasible now: search_pipeline, inspect_pipeline, recharge; {WOULD_BE}",
            ],
        ),
        (
            f"{EXTENDED} --goal '(pipeline_found pipeline) {NOT_ACTION}'",
            [f"out of reach: {NOT_ACTION}"],
        ),
        (
            f"--mission suave_extended --situation battery_level=0.2 --goal '{NOT_ACTION}'",
            [
                f"out of reach: {NOT_ACTION}",
                "there would be no plan even if every action were feasible",
            ],
        ),
    ],
)
def test_unsolvable_says_which_goal_and_whether_actions_lack(rosa, question, lines):
    code, out, _ = rosa(question)
    shown = [line.strip() for line in out if not line.startswith("out: ")]
    assert (code, shown) == (1, ["no plan: search: unsolvable proven", *lines])


def test_problem_file_that_states_feasibility_is_believed(rosa, tmp_path):
    text = Path(FILE).read_text().replace("(:init", "(:init (action_feasible recharge)")
    (tmp_path / "p.pddl").write_text(text)
    code, lines, _ = rosa(f"{DOMAIN} p.pddl")
    assert code == 0
    assert lines[1].split("(")[0].split()[-1] == "recharge"
    reason = "the problem file does not state that it is feasible"
    assert any(reason in line for line in lines)


def test_without_a_plan_only_the_json_is_written(rosa, tmp_path):
    failed = "--mission suave --situation spiral_search=failed"
    code, lines, _ = rosa(f"{failed} --json plan.json --svg plan.svg")
    assert code == 1
    assert [path.name for path in tmp_path.iterdir()] == ["plan.json"]
    data = json.loads((tmp_path / "plan.json").read_text())
    assert (data["outcome"], data["cost"], data["steps"]) == ("unsolvable proven", None, [])
    assert "plan.svg is not written, as there is no plan" in lines


@pytest.mark.parametrize(
    ("question", "message"),
    [
        ("", "give a domain and a problem file, or a mission with --mission NAME, not nothing"),
        (f"{EXTENDED} more.pddl", NO_MISSION),
        (f"nowhere.pddl {FILE}", "nowhere.pddl: cannot read this PDDL file: No such file"),
        (f"{EXTENDED} --situation battery_level=0.2", "name its file with --model"),
        ("--mission suave --situation water", "takes ATTRIBUTE=NUMBER or COMPONENT=failed"),
        ("--mission suave --situation visibility=3", "unknown attribute 'visibility'"),
        (
            "--mission suave --goal '(pipeline_lost p)'",
            "no declared predicate; nearest: pipeline_found",
        ),
        (
            "--mission suave --goal '(pipeline_found bluerov)'",
            "of other types than (pipeline_found",
        ),
        ("--mission suave --goal ' '", "--goal is empty; give a condition such as '(found it)'"),
        ("--mission suave --timeout 0", "timeout_s is 0.0, expected seconds: more than 0"),
        ("--mission suave --svg .", "it is a directory; name a file in it"),
        ("--mission suave --certificate --svg x.svg", "--svg draws one"),
        ("--mission suave --failures 1", "add --certificate"),
        ("--mission suave --engine kayros", "no planning engine 'kayros'"),
    ],
)
def test_wrong_use_is_one_clear_message_and_exits_2(rosa, tmp_path, question, message):
    code, lines, err = rosa(question)
    assert code == 2
    assert message in " ".join(err.split())
    assert lines == []
    assert list(tmp_path.iterdir()) == []


def test_mission_without_a_problem_says_what_to_give():
    with pytest.raises(MissionError, match="has no PDDL problem"):
        mission_domain(replace(find_mission("suave"), problem=None))


def test_certificate_has_a_plan_for_every_combination(rosa):
    code, lines, err = rosa("--mission suave_extended --certificate --json certificate.json")
    assert (code, err) == (0, "")
    certificate = json.loads(Path("certificate.json").read_text())
    plans = {frozenset(plan): steps for plan, steps in plans_of(load_domain(DOMAIN, FILE)).items()}
    actions = {"search_pipeline", "inspect_pipeline", "recharge"}
    assert len(certificate["entries"]) == len(plans) == 8
    for entry in certificate["entries"]:
        steps = plans[frozenset(actions.difference(entry["unfeasible"]))] or ()
        assert [step["action"] for step in entry["steps"]] == [step.schema for step in steps]
    assert lines[0].split() == ["unfeasible", "cost", "plan"]
    fatal = ["spiral_search fails", "follow_pipeline fails"]  # recharging does not mend them
    found = f"{', '.join(fatal)}; no others, if what is assumed above holds"
    assert lines[-1] == f"single failures that end the mission: {found}"
    assert certificate["fatal"] == fatal
    (assumed,) = certificate["entries"][1]["assumptions"]
    assert assumed == "assumes that recharge cures: search_pipeline is unfeasible"
    assert f"search_pipeline: {assumed}" in lines[9:]


def test_engine_is_the_one_that_is_named(rosa):
    code, lines, _ = rosa("--mission suave --engine kairos")
    assert (code, lines[0]) == (0, "solved optimally by kairos: 2 steps, cost 2")


def test_failures_may_not_be_less_than_none(rosa):
    code, _, err = rosa("--mission suave --certificate --failures -1")
    assert (code, "greater than or equal to 0" in err) == (2, True)


def test_failure_that_ends_the_mission_is_named(rosa):
    code, lines, _ = rosa("--mission suave --certificate --failures 1")
    assert code == 0
    fatal = "search_pipeline, inspect_pipeline, spiral_search fails, follow_pipeline fails"
    assert lines[-1] == f"single failures that end the mission: {fatal}"
