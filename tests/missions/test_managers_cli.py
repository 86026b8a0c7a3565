"""Managers on the command line: what can be set of them, what the result and the timing file hold of reactions."""

import json

from typer.testing import CliRunner

from missions.cli import app

SHORT = ("--set", "duration_s=40", "--set", "start_y=0", "--set", "start_x=-20", "--no-progress")


def invoke(*arguments):
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert done.exit_code == 0, done.output
    return done.output


def test_options_of_a_manager_are_listed_and_set_and_an_input_from_the_paper_is_marked(tmp_path):
    assert "service_s" in invoke("settings", "suave", "--manager", "rosa")
    assert "service_s" not in invoke("settings", "suave")
    path = tmp_path / "rosa.json"
    invoke("run", "suave", "--manager", "rosa", "--set", "service=0.1", "--json", path, *SHORT)
    result = json.loads(path.read_text())
    assert result["input_from_paper_service_s"] == 0.1
    assert "compute_charged_s" not in result


def test_reactions_are_told_and_what_was_computed_for_them_stands_in_the_timing_file(tmp_path):
    result, timing = tmp_path / "result.json", tmp_path / "timing.json"
    invoke("run", "suave", "--manager", "bt", "--json", result, "--timing", timing, *SHORT)
    told, measured = json.loads(result.read_text()), json.loads(timing.read_text())
    assert told["reactions"]
    assert [one["start_s"] for one in told["reactions"]] == [
        round(one["start_s"], 6) for one in measured["reactions"]
    ]
    assert all(one["compute_s"] > 0 for one in measured["reactions"])
    assert not any("compute" in key for one in told["reactions"] for key in one)
