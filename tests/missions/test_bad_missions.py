"""What an author gets wrong in a mission is said in one message that names it, what exists and what to do."""

import dataclasses
from pathlib import Path

import numpy
import pytest
from py_trees.behaviours import Running
from py_trees.common import Status
from running import register, rosa_run, run_mission

from missions import cli, suave_extended
from missions.engine import runner
from missions.engine.mission import MissionError, World, find_mission
from rosa_bt import IsActionFeasible, RosaAction
from rosa_pddl import Planner

WRITTEN = Path(suave_extended.__file__).parent
DOMAIN, PROBLEM = WRITTEN / "domain.pddl", WRITTEN / "problem.pddl"


@pytest.fixture
def altered(monkeypatch):
    """Put a mission into the registry that differs from the extended one; returns how to run it by command line."""

    def alter(**changes):
        files = {"domain": DOMAIN, "problem": PROBLEM}
        mission = dataclasses.replace(
            find_mission("suave_extended"), name="altered", **(files | changes)
        )
        register(monkeypatch, "altered", mission)

    return alter


def run_altered(monkeypatch, capsys, *options):
    monkeypatch.setattr("sys.argv", ["rosa", "run", "altered", "--no-progress", *options])
    with pytest.raises(SystemExit) as end:
        cli.main()
    captured = capsys.readouterr()
    assert "Traceback" not in captured.out + captured.err
    return end.value.code, " ".join(captured.out.split()), " ".join(captured.err.split())


def test_action_in_the_tree_that_the_model_does_not_know_names_the_nearest(
    altered, monkeypatch, capsys
):
    altered(tree=lambda kb, percepts: IsActionFeasible("search?", kb, "serch_pipeline"))
    code, _, err = run_altered(monkeypatch, capsys)
    assert code == 2
    assert "unknown action 'serch_pipeline'; did you mean 'search_pipeline'" in err


def test_action_in_the_domain_that_the_model_does_not_know_names_the_nearest(
    altered, monkeypatch, capsys, tmp_path
):
    problem = tmp_path / "problem.pddl"
    problem.write_text(
        PROBLEM.read_text()
        .replace("search_pipeline inspect", "serch_pipeline inspect")
        .replace("action search_pipeline)", "action serch_pipeline)")
    )
    altered(problem=problem)
    code, _, err = run_altered(monkeypatch, capsys, "--task", "pddl")
    assert code == 2
    assert "serch_pipeline" in err
    assert "search_pipeline" in err
    assert "problem.pddl:" in err


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        (lambda text: text.rstrip()[:-1], "domain.pddl:"),
        (lambda text: text.replace("(pipeline_found ?p - pipeline)", ""), "pipeline_found"),
        (lambda text: text.replace(":types", ":tipes"), ":tipes"),
        (
            lambda text: text.replace("action_feasible", "act_feas"),
            "no predicate (action_feasible ?a - action)",
        ),
    ],
)
def test_malformed_domain_names_file_and_what_was_expected(
    altered, monkeypatch, capsys, tmp_path, broken, message
):
    domain = tmp_path / "domain.pddl"
    domain.write_text(broken(DOMAIN.read_text()))
    altered(domain=domain)
    code, _, err = run_altered(monkeypatch, capsys, "--task", "pddl")
    assert code == 2
    assert f"{domain}:" in err
    assert message in err


def test_problem_of_another_domain_is_refused(altered, monkeypatch, capsys, tmp_path):
    problem = tmp_path / "problem.pddl"
    text = PROBLEM.read_text()
    problem.write_text(text.replace("(:domain suave_extended)", "(:domain sea)"))
    altered(problem=problem)
    code, _, err = run_altered(monkeypatch, capsys, "--task", "pddl")
    assert code == 2
    assert f"{problem}:3:3: found '(:domain sea)', expected '(:domain suave_extended)'" in err


def test_missing_domain_file_is_named(altered, monkeypatch, capsys, tmp_path):
    altered(domain=tmp_path / "nowhere.pddl")
    code, _, err = run_altered(monkeypatch, capsys, "--task", "pddl")
    assert code == 2
    assert "nowhere.pddl" in err


def test_misspelt_requirement_stops_nothing(monkeypatch, capsys, altered, tmp_path):
    domain = tmp_path / "domain.pddl"
    domain.write_text(DOMAIN.read_text().replace(":durative-actions", ":durativ-actions"))
    altered(domain=domain)
    monkeypatch.setattr("sys.argv", ["rosa", "plan", "--mission", "altered"])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert not end.value.code
    assert "solved optimally" in capsys.readouterr().out


def planning_with(monkeypatch, planner):
    """Give missions that are planned another planner than Fast Downward."""
    monkeypatch.setattr("missions.engine.task_layer.Planner", planner)


def test_planner_that_is_gone_when_it_is_needed_ends_the_mission_and_says_what_to_install(
    monkeypatch, capsys, altered
):
    class Gone(Planner):
        """Was there when it was looked for, and is not any more."""

        def missing(self, domain):
            return None

    altered()
    planning_with(monkeypatch, lambda: Gone("tamer"))
    code, out, _ = run_altered(monkeypatch, capsys, "--task", "pddl")
    assert code == 1
    assert "aborted" in out
    assert "engine missing" in out
    assert "try 'pip install up-tamer'" in out


def test_planner_that_is_not_installed_is_found_out_before_the_mission(
    monkeypatch, capsys, altered
):
    altered()
    planning_with(monkeypatch, lambda: Planner("tamer"))
    code, out, err = run_altered(monkeypatch, capsys, "--task", "pddl")
    assert code == 2
    assert "the planning engine 'tamer' is not installed; try 'pip install up-tamer'" in err
    assert "adaptation" not in out


def test_planner_that_runs_out_of_wall_clock_time_ends_the_mission_by_name_instead_of_deciding(
    monkeypatch, capsys, altered
):
    altered()
    planning_with(monkeypatch, lambda: Planner(timeout_s=1e-6, moves=0))
    code, out, err = run_altered(monkeypatch, capsys, "--task", "pddl")
    assert code == 2
    assert (
        "planning ran out of wall-clock time, and going on would make the run depend on the machine"
        in err
    )
    assert "adaptation" not in out


def test_exception_in_an_action_is_told_with_the_verdict(monkeypatch, capsys, altered):
    class Rash(RosaAction):
        def update(self):
            raise ValueError("no such camera")

    altered(tree=lambda kb, percepts: Rash("search", kb, "search_pipeline"))
    code, out, _ = run_altered(monkeypatch, capsys, "--set", "duration_s=3")
    assert code == 1
    assert "search_pipeline failed last: ValueError: no such camera" in out


def test_mission_without_a_plan_says_so(monkeypatch, capsys, altered, tmp_path):
    problem = tmp_path / "problem.pddl"
    text = PROBLEM.read_text()
    problem.write_text(text.replace("(inspect_pipeline_action inspect_pipeline)", ""))
    altered(problem=problem)
    code, out, _ = run_altered(monkeypatch, capsys, "--task", "pddl", "--set", "duration_s=5")
    assert code == 1
    assert "there was no plan: unsolvable proven" in out


def test_fact_of_an_object_that_there_is_not_is_told_once(altered, monkeypatch, capsys):
    altered(facts=lambda kb, percepts: {"(pipeline_found pipelin)": True})
    _, out, _ = run_altered(monkeypatch, capsys, "--task", "pddl", "--set", "duration_s=3")
    assert out.count("what is sensed is ignored") == 1
    assert "pipelin" in out


def test_tree_that_is_none_is_refused_and_the_world_let_go_of(monkeypatch, capsys, altered):
    closed = []
    monkeypatch.setattr(World, "close", lambda world: closed.append(world))
    altered(tree=lambda kb, percepts: None)
    code, _, err = run_altered(monkeypatch, capsys)
    assert code == 2
    assert "the tree of mission altered is None, not a py_trees behaviour" in err
    assert len(closed) == 1


def test_tree_that_cannot_be_built_is_refused_with_the_line(monkeypatch, capsys, altered):
    altered(tree=lambda kb, percepts: percepts.nothing)
    code, _, err = run_altered(monkeypatch, capsys)
    assert code == 2
    said = "cannot build the tree of mission altered: AttributeError: 'Percepts' object has no attribute 'nothing'"
    assert f"{said}; test_bad_missions.py, line" in err


def test_unknown_names_and_nan_in_diagnostics_are_reported_and_the_mission_goes_on(monkeypatch):
    original = runner.MissionRun._turn

    def disturbed(self):
        if not self.problems:
            bad = {"battery_level": "nan", "batterie": "0.1", "water_visibility": "clear"}
            self._take_in(
                {"time": self.world.now, "status": [{"message": "QA status", "values": bad}]}
            )
        original(self)

    monkeypatch.setattr(runner.MissionRun, "_turn", disturbed)
    _, verdict, data = run_mission("suave_extended", duration_s=130)
    assert verdict.success
    assert [one["problem"].split(":")[0] for one in data["diagnostics_problems"]] == [
        "battery_level='nan'",
        "batterie='0.1'",
        "water_visibility='clear'",
    ]


def test_exception_in_a_plain_behaviour_is_its_failure_and_leaves_nothing_open(altered):
    class Rash(Running):
        def update(self):
            raise RuntimeError("boom")

    mission = dataclasses.replace(
        find_mission("suave_extended"), tree=lambda kb, percepts: Rash("rash")
    )
    world = mission.world.open({}, numpy.random.default_rng(0))
    run = rosa_run(mission, "bt", world)
    assert not run.run().success
    assert run.tree.root.status is Status.FAILURE
    line = Rash.update.__code__.co_firstlineno + 1
    assert (
        run.tree.root.feedback_message == f"RuntimeError: boom; test_bad_missions.py, line {line}"
    )
    assert run.kb.required_actions == ()


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (
            lambda kb, percepts, steps: Running(),
            "PDDL action .* is given .*: missing a required argument: 'steps'",
        ),
        (
            lambda kb, percepts: None,
            "what does the PDDL action .* is None, not a py_trees behaviour",
        ),
        (lambda kb, percepts: percepts.nothing, "no attribute 'nothing'"),
    ],
)
def test_what_cannot_make_a_step_ends_the_run_and_is_not_tried_for_ever(action, message):
    mission = find_mission("suave_extended")
    actions = dict.fromkeys(mission.actions, action)
    mission = dataclasses.replace(mission, actions=actions, domain=DOMAIN, problem=PROBLEM)
    world = mission.world.open({}, numpy.random.default_rng(0))
    with pytest.raises((MissionError, AttributeError), match=message):
        rosa_run(mission, "pddl", world).run()
