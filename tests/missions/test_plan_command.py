"""`rosa plan` as a person uses it: the plan, why not, its files, and what is wrong."""

import dataclasses
import json
import subprocess
import sys
from functools import partial
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
EXTENDED = [f"{FOLDERS['suave_extended']}/{file}.pddl" for file in ("domain", "problem")]


@pytest.fixture
def rosa(capsys, monkeypatch, tmp_path):
    """Run `rosa plan` in an empty folder; returns exit status, output and errors."""
    monkeypatch.chdir(tmp_path)

    return partial(called, capsys, monkeypatch, "plan")


def plans_of(domain):
    """Return the plan for each set of feasible actions; None where there is none."""
    planner = Planner()
    actions = domain.rosa_actions
    found = {}
    for feasible in chain.from_iterable(
        combinations(actions, size) for size in range(len(actions) + 1)
    ):
        state = initial_state(domain) | {domain.feasible_atom(action) for action in feasible}
        result = planner.plan(Problem(domain, state))
        found[feasible] = result.steps if result.outcome.is_solved else None
    return found


@pytest.mark.parametrize("name", FOLDERS)
def test_domain_made_of_the_declarations_gives_the_plans_of_the_one_written_by_hand(name):
    folder = FOLDERS[name]
    written = load_domain(f"{folder}/domain.pddl", f"{folder}/problem.pddl")
    declared = mission_domain(find_mission(name))
    assert declared.rosa_actions == written.rosa_actions
    assert declared.schemas == written.schemas
    plans = plans_of(declared)
    assert any(plans.values())
    assert None in plans.values()
    assert plans == plans_of(written)


def test_plan_is_shown_with_what_each_step_needs(rosa):
    code, out, err = rosa("--mission", "suave")
    assert (code, err) == (0, "")
    assert out.splitlines() == [
        "solved optimally by search: 2 steps, cost 2",
        "  1  search_pipeline(search_pipeline, pipeline, bluerov)",
        "  2  inspect_pipeline(inspect_pipeline, pipeline, bluerov)  "
        "needs (pipeline_found pipeline) by 1",
    ]


def test_json_is_outcome_engine_cost_and_steps(rosa, tmp_path):
    code, _, _ = rosa(*EXTENDED, "--feasible", "Recharge", "--json", "plan.json")
    assert code == 0
    assert json.loads((tmp_path / "plan.json").read_text()) == {
        "outcome": "solved optimally",
        "engine": "search",
        "cost": 3.0,
        "steps": [
            {
                "action": "recharge",
                "arguments": ["recharge", "search_pipeline", "inspect_pipeline", "bluerov"],
            },
            {"action": "search_pipeline", "arguments": ["search_pipeline", "pipeline", "bluerov"]},
            {
                "action": "inspect_pipeline",
                "arguments": ["inspect_pipeline", "pipeline", "bluerov"],
            },
        ],
        "assumptions": [],
    }


def test_situation_says_with_the_model_why_each_unfeasible_action_is_out(rosa, tmp_path):
    find_mission("suave_extended").model().save(tmp_path / "robot.owl")
    for given in (["--mission", "suave_extended"], [*EXTENDED, "--model", "robot.owl"]):
        code, out, _ = rosa(*given, "--situation", "battery_level=0.2")
        assert code == 0
        assert [line.split("(")[0].split()[-1] for line in out.splitlines()[1:4]] == [
            "recharge",
            "search_pipeline",
            "inspect_pipeline",
        ]
        reason = "is unfeasible because battery_level 0.2 violates >= 0.25 (measured 0.0 s ago)"
        assert out.splitlines()[4:] == [
            f"out: {action}_pipeline {reason}" for action in ("search", "inspect")
        ]


def test_action_of_the_model_that_is_never_planned_is_noted(rosa, tmp_path):
    find_mission("suave_extended").model().save(tmp_path / "robot.owl")
    files = [f"{FOLDERS['suave']}/{file}.pddl" for file in ("domain", "problem")]
    code, out, _ = rosa(*files, "--model", "robot.owl")
    assert code == 0
    assert "note: the action 'recharge' of the knowledge base is never planned" in out


def test_goal_may_be_another_one_and_several(rosa):
    code, out, _ = rosa(
        "--mission",
        "suave_extended",
        "--goal",
        "(recharged bluerov)(not (pipeline_found pipeline))",
    )
    assert code == 0
    assert out.splitlines()[1:] == [
        "  1  recharge(recharge, search_pipeline, inspect_pipeline, bluerov)"
    ]
    code, out, _ = rosa("--mission", "suave", "--goal", "(not (pipeline_found pipeline))")
    assert (code, out.splitlines()[0].split(": ")[1]) == (0, "0 steps, cost 0")


ALL_BROKEN = "battery_level=0.2,c_thruster_1=failed,recover_thrusters=failed"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (
            ["--mission", "suave", "--feasible", "search_pipeline"],
            [
                "out of reach: (pipeline_inspected pipeline)",
                "unfeasible now: inspect_pipeline; there would be a plan if they were feasible",
            ],
        ),
        (
            ["--mission", "suave", "--feasible", "", "--goal", "(pipeline_inspected pipeline)"],
            [
                "out of reach: (pipeline_inspected pipeline)",
                "unfeasible now: search_pipeline, inspect_pipeline; "
                "there would be a plan if they were feasible",
            ],
        ),
        (
            ["--mission", "suave_extended", "--situation", ALL_BROKEN],
            [
                "out of reach: (pipeline_inspected pipeline)",
                "unfeasible now: search_pipeline, inspect_pipeline, recharge; "
                "there would be a plan if they were feasible",
            ],
        ),
        (
            [*EXTENDED, "--goal", "(pipeline_found pipeline) (search_pipeline_action recharge)"],
            ["out of reach: (search_pipeline_action recharge)"],
        ),
        (
            [*EXTENDED, "--feasible", "recharge", "--goal", "(search_pipeline_action recharge)"],
            [
                "out of reach: (search_pipeline_action recharge)",
                "there would be no plan even if every action were feasible",
            ],
        ),
    ],
)
def test_unsolvable_says_which_goal_and_whether_it_is_for_want_of_feasible_actions(
    rosa, arguments, told
):
    code, out, _ = rosa(*arguments)
    lines = [line.strip() for line in out.splitlines() if not line.startswith("out: ")]
    assert (code, lines) == (1, ["no plan: search: unsolvable proven", *told])


def test_goals_that_exclude_one_another_are_told_so(rosa, tmp_path):
    (tmp_path / "d.pddl").write_text(
        "(define (domain lamp) (:predicates (on) (off) (left)) "
        "(:action go :precondition (not (left))"
        " :effect (and (left) (on))) "
        "(:action stay :precondition (not (left)) :effect (and (left) (off))))"
    )
    (tmp_path / "p.pddl").write_text(
        "(define (problem p) (:domain lamp) (:init) (:goal (and (on) (off))))"
    )
    code, out, _ = rosa("d.pddl", "p.pddl")
    assert code == 1
    assert "out of reach: (off)" in out


def test_files_with_a_limit_are_planned_within_it_and_told_when_no_plan_keeps_it(rosa, tmp_path):
    (tmp_path / "d.pddl").write_text(
        "(define (domain lamp) (:predicates (on)) (:functions (used) (total-cost) (left))"
        " (:action blaze :parameters () :precondition () :effect (and (on) (increase (used) 2)))"
        " (:action glow :parameters () :precondition () :effect (and (on) (increase (used) 1)"
        " (increase (total-cost) 5))))"
    )
    for left, code, told in [
        (2, 0, "  1  blaze()"),
        (1, 0, "  1  glow()"),
        (0.5, 1, "no plan: search: "),
    ]:
        (tmp_path / "p.pddl").write_text(
            "(define (problem p) (:domain lamp) "
            f"(:init (= (used) 0) (= (total-cost) 0) (= (left) {left}))"
            " (:goal (and (on) (<= (used) (left)))) (:metric minimize (total-cost)))"
        )
        told_code, out, _ = rosa("d.pddl", "p.pddl")
        assert told_code == code
        assert any(line.startswith(told) for line in out.splitlines())


def test_problem_file_that_states_feasibility_is_believed_without_a_model(rosa, tmp_path):
    written = Path(EXTENDED[1]).read_text().replace("(:init", "(:init (action_feasible recharge)")
    (tmp_path / "p.pddl").write_text(written)
    code, out, _ = rosa(EXTENDED[0], "p.pddl")
    assert code == 0
    assert out.splitlines()[1].split("(")[0].split()[-1] == "recharge"
    assert "the problem file does not state that it is feasible" in out


def test_picture_has_a_box_for_each_step_and_the_goal_and_an_arrow_for_each_need(rosa, tmp_path):
    assert (
        rosa("--mission", "suave_extended", "--feasible", "recharge", "--svg", "plan.svg")[0] == 0
    )
    root = ElementTree.parse(tmp_path / "plan.svg").getroot()
    tags = [element.tag.rpartition("}")[2] for element in root]
    assert tags.count("rect") - 1 == 3 + 1
    assert (
        tags.count("path") == 4
    )  # recharge -> search, recharge -> inspect, search -> inspect, inspect -> goal
    texts = [element.text for element in root if element.tag.endswith("text")]
    assert "(pipeline_found pipeline)" in texts


def test_without_a_plan_only_the_json_is_written_and_the_rest_is_told(rosa, tmp_path):
    files = ["--json", "plan.json", "--svg", "plan.svg"]
    code, out, _ = rosa("--mission", "suave", "--feasible", "", *files)
    assert code == 1
    assert [path.name for path in tmp_path.iterdir()] == ["plan.json"]
    data = json.loads((tmp_path / "plan.json").read_text())
    assert (data["outcome"], data["cost"], data["steps"]) == ("unsolvable proven", None, [])
    assert "plan.svg is not written, as there is no plan" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "nothing to plan; give a domain and a problem file, or a mission with --mission NAME"),
        (EXTENDED[:1], "nothing to plan; give a domain and a problem file"),
        ([*EXTENDED, "more.pddl"], "give either a domain and a problem file, or a mission"),
        (
            ["nowhere.pddl", EXTENDED[1]],
            "nowhere.pddl: cannot read this PDDL file: No such file or directory",
        ),
        (EXTENDED[::-1], "expected 'domain', found name 'problem'"),
        (
            [*EXTENDED, "--mission", "suave"],
            "give either a domain and a problem file, or a mission",
        ),
        (["--mission", "suaf"], "unknown mission 'suaf'"),
        ([*EXTENDED, "--model", "nowhere.tql"], "nowhere.tql: there is no such file"),
        (
            [*EXTENDED, "--feasible", "serch_pipeline"],
            "--feasible names 'serch_pipeline', which is no ROSA action",
        ),
        (
            [*EXTENDED, "--situation", "battery_level=0.2"],
            "a situation is about a model; name its file with --model",
        ),
        (
            ["--mission", "suave", "--situation", "water"],
            "--situation takes ATTRIBUTE=NUMBER or COMPONENT=failed",
        ),
        (
            ["--mission", "suave", "--situation", "water_visibility=murky"],
            "or water_visibility=failed for a component",
        ),
        (["--mission", "suave", "--situation", "visibility=3"], "unknown attribute 'visibility'"),
        (
            ["--mission", "suave", "--situation", "c_thruster_9=failed"],
            "unknown component 'c_thruster_9'; did you",
        ),
        (
            ["--mission", "suave", "--situation", "water_visibility=nan"],
            "a finite number is needed, not nan",
        ),
        (
            [
                "--mission",
                "suave",
                "--situation",
                "water_visibility=3",
                "--feasible",
                "search_pipeline",
            ],
            "give --feasible or --situation, not both",
        ),
        (
            ["--mission", "suave", "--goal", "(pipeline_lost pipeline)"],
            "no declared predicate; nearest: pipeline_found",
        ),
        (
            ["--mission", "suave", "--goal", "(pipeline_found bluerov)"],
            "of other types than (pipeline_found ?p - pipeline)",
        ),
        (
            ["--mission", "suave", "--goal", "pipeline_found"],
            "found 'pipeline_found', expected a list",
        ),
        (["--mission", "suave", "--goal", "(pipeline_found pipeline"], "unbalanced parentheses"),
        (
            ["--mission", "suave", "--goal", " "],
            "--goal is empty; give a condition such as '(found it)'",
        ),
        (["--mission", "suave", "--timeout", "0"], "timeout_s is 0, expected more than 0"),
        (["--mission", "suave", "--json", "nowhere/plan.json"], "cannot write nowhere/plan.json"),
        (["--mission", "suave", "--svg", "."], "it is a directory; name a file in it"),
        (["--mission", "suave", "--plan"], "No such option: --plan"),
    ],
)
def test_wrong_use_is_one_clear_message_and_exits_with_2(rosa, tmp_path, arguments, message):
    code, out, err = rosa(*arguments)
    assert code == 2
    assert message in " ".join(err.split())
    assert out == ""
    assert list(tmp_path.iterdir()) == []


def test_files_may_go_to_a_pipe():
    command = [sys.executable, "-m", "missions", "plan", "--mission", "suave"]
    command += ["--json", "/dev/stdout", "--svg", "/dev/stdout"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert '"outcome": "solved optimally"' in done.stdout
    assert "<svg" in done.stdout


def test_mission_without_a_problem_says_what_to_give():
    bare = dataclasses.replace(find_mission("suave"), problem=None)
    with pytest.raises(MissionError, match="has no PDDL problem"):
        mission_domain(bare)


def test_a_certificate_is_a_table_and_json_of_what_every_combination_leaves_to_do(rosa):
    code, out, err = rosa(
        "--mission", "suave_extended", "--certificate", "--json", "certificate.json"
    )
    assert (code, err) == (0, "")
    written = json.loads(Path("certificate.json").read_text())
    plans = plans_of(load_domain(*EXTENDED))
    assert len(written["entries"]) == len(plans) == 8
    for entry in written["entries"]:
        feasible = tuple(
            action
            for action in ("search_pipeline", "inspect_pipeline", "recharge")
            if action not in entry["unfeasible"]
        )
        steps = plans[next(plan for plan in plans if set(plan) == set(feasible))]
        assert [step["action"] for step in entry["steps"]] == [step.schema for step in steps or ()]
    lines = out.splitlines()
    assert len(lines) == 10
    assert lines[0].split() == ["unfeasible", "cost", "plan"]
    fatal = ["spiral_search fails", "follow_pipeline fails"]  # recharging does not mend them
    assert lines[-1] == f"single failures that end the mission: {', '.join(fatal)}"
    assert written["fatal"] == fatal


def test_a_failure_that_ends_the_mission_is_named(rosa):
    code, out, _ = rosa("--mission", "suave", "--certificate", "--failures", "1")
    assert code == 0
    assert (
        out.splitlines()[-1]
        == "single failures that end the mission: search_pipeline, inspect_pipeline, "
        "spiral_search fails, follow_pipeline fails"
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--certificate", "--svg", "x.svg"), "--svg draws one"),
        (("--failures", "1"), "add --certificate"),
        (("--certificate", "--failures", "9"), "failures is 9, expected 0 to"),
    ],
)
def test_what_cannot_be_certified_is_said(rosa, options, message):
    code, _, err = rosa("--mission", "suave", *options)
    assert code != 0
    assert message in err
