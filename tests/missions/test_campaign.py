"""Campaigns: the same results on any number of workers, nothing lost however they end."""

import csv
import json
import os
import resource
import subprocess
import sys
import time
from functools import cache
from pathlib import Path

import pytest
from running import called

from missions.engine.mission import MissionError
from missions.experiments.campaign import Campaign, PlannedRun, from_data
from missions.experiments.results import Outcome, Results, Store
from missions.experiments.workers import do

ROOT = Path(__file__).parents[2]
SMALL = """
name = "small"
missions = ["suave"]
managers = ["none", "bt", "ours"]
runs = 2
rules = "2024"

[settings]
duration_s = 10

[sweep]
bias = [0, 1.0]
"""
RUNS = 3 * 2 * 2


@pytest.fixture
def quick(capsys, monkeypatch, tmp_path):
    """Run the command line in this process and folder; returns exit status, output and errors."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    Path("c.toml").write_text(SMALL)

    def run(*arguments):
        code, out, err = called(capsys, monkeypatch, *arguments)
        return code, out, " ".join(err.split())

    return run


def start(*arguments, cwd, most_bytes=resource.RLIM_INFINITY):
    """Start the command line in a process of its own, perhaps on a disk with little room."""

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, resource.RLIM_INFINITY))

    command = [sys.executable, "-m", "missions", *map(str, arguments)]
    settings = {**os.environ, "PYTHONPATH": str(ROOT)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    return subprocess.Popen(command, preexec_fn=limit, env=settings, cwd=cwd, **pipes)


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """Return the folder of the small campaign, as two workers made it."""
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "c.toml").write_text(SMALL)
    running = start("campaign", "c.toml", "--workers", 2, "--out", "two", cwd=folder)
    out, _ = running.communicate()
    assert running.returncode == 0, out
    return folder / "two"


def tables(folder):
    return {name: (folder / name).read_bytes() for name in ("runs.csv", "runs.json")}


def test_every_run_has_its_name_and_managers_the_same_seeds():
    data = {"missions": ["a", "b"], "managers": ["ours", "none"], "tasks": ["bt", "pddl"]}
    data |= {"runs": 2, "cases": [{"c": 1}, {"c": 2}], "sweep": {"d": [1, 2], "e": [True]}}
    planned = list(from_data({"name": "any", **data}, "here").planned())
    assert len({run.name for run in planned}) == len(planned) == 2 * 3 * 2 * 4
    assert [run.place for run in planned] == list(range(len(planned)))
    for manager in ("ours", "none"):
        assert {run.seed for run in planned if run.manager == manager} == {0, 1}


def test_planned_run_has_a_command_that_repeats_it():
    settings = (("bias", "0"), ("faults", "fail boom@60; recover boom@90"))
    run = PlannedRun("suave", "ours", "pddl", 7, settings)
    assert run.name == "suave/ours/pddl/bias=0,faults=fail boom@60; recover boom@90/7"
    words = "--manager ours --task pddl --seed 7 --set bias=0 --fail boom@60 --recover boom@90"
    assert run.command == f"rosa run suave {words}"


def test_results_are_the_same_to_the_byte_on_one_worker(quick, whole):
    assert quick("campaign", "c.toml", "--workers", 1, "--out", "one")[0] == 0
    assert tables(Path("one")) == tables(whole)


def test_tables_hold_what_the_runs_gave(whole):
    results = Results(whole)
    names = [run.name for run in results.campaign.planned()]
    with (whole / "runs.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["run"] for row in rows] == names
    assert json.loads((whole / "runs.json").read_text()) == results.records
    for row, record in zip(rows, results.records, strict=True):
        assert row["set_bias"] == record["settings"]["bias"]
        assert float(row["violation_s"]) == record["violation_s"]


def assert_resumed(quick, folder, whole, *words):
    """Go on with a campaign that something has stopped; nothing is lost, repeated or different."""
    before = Results(folder).outcomes
    code, out, err = quick("campaign", *words, "--resume", "--workers", 1, "--out", folder)
    assert (code, f"{RUNS - len(before)} of them now" in out) == (0, True), out + err
    after = Results(folder).outcomes
    assert {place: after[place] for place in before} == before
    assert tables(folder) == tables(whole)
    return len(before)


def test_killed_campaign_resumes_without_losing_a_run(quick, whole, tmp_path):
    running = start("campaign", "c.toml", "--workers", 2, "--out", "killed", cwd=tmp_path)
    runs = tmp_path / "killed" / "runs.jsonl"
    while running.poll() is None and not (runs.exists() and runs.read_bytes().count(b"\n") > 2):
        time.sleep(0.02)
    running.kill()
    running.communicate()  # returns when its workers have ended, too
    with runs.open("a") as file:
        file.write('{"place": 11, "rec')  # cut short, as by a power cut
    assert assert_resumed(quick, tmp_path / "killed", whole) > 2
    assert assert_resumed(quick, tmp_path / "killed", whole) == RUNS


def test_campaign_on_a_full_disk_says_so_and_resumes(quick, whole, tmp_path):
    words = ("campaign", "c.toml", "--workers", 1, "--out", "full")
    text, _ = start(*words, cwd=tmp_path, most_bytes=3_000).communicate()
    assert "make room, then go on with --resume" in " ".join(text.split())
    assert "Traceback" not in text
    assert 0 < assert_resumed(quick, tmp_path / "full", whole, "c.toml") < RUNS


CLUMSY = """
import os, sys

from missions.baselines import Manager


class Clumsy(Manager):
    def update(self):
        if self.now > 1:
            {trouble}
"""
TROUBLE = """[lambda: None, lambda: 1 / 0, lambda: os._exit(9), lambda: sys.exit("enough")][
                int(self.constants.start_y_m)
            ]()"""
CRASHING = """
missions = ["suave"]
managers = ["clumsy:Clumsy"]
runs = 1
settings = { duration_s = 5 }
sweep = { start_y = [0, 1, 2, 3] }
"""


def test_run_that_crashes_is_recorded_and_the_others_go_on(quick, tmp_path, monkeypatch):
    monkeypatch.delitem(sys.modules, "clumsy", raising=False)
    (tmp_path / "clumsy.py").write_text(CLUMSY.format(trouble=TROUBLE))
    (tmp_path / "c.toml").write_text(CRASHING)
    running = start("campaign", "c.toml", "--workers", 1, "--out", "c", cwd=tmp_path)
    out, _ = running.communicate()
    assert running.returncode == 1, out
    assert "4 of 4 runs done" in out
    errors = [record["error"] for record in Results(tmp_path / "c").crashed]
    assert "ZeroDivisionError: division by zero; clumsy.py, line 10" in errors[0]
    assert errors[1:] == ["the process that ran it died", "SystemExit: enough"]
    repeat = "rosa run suave --manager clumsy:Clumsy --seed 0 --set duration_s=5 --set start_y=2"
    assert repeat in out
    assert "ZeroDivisionError" in Results(tmp_path / "c").outcomes[1].traceback

    (tmp_path / "clumsy.py").write_text(CLUMSY.format(trouble="pass"))
    again = ("campaign", "c.toml", "--resume", "--workers", 1, "--out", "c")
    assert "4 of 4 runs done, 0 of them now" in quick(*again)[1]  # a run that crashed is done
    code, out, err = quick(*again, "--retry")
    assert (code, "4 of 4 runs done, 3 of them now" in out) == (0, True), out + err


def test_folder_of_results_imports_nothing_by_itself(quick, tmp_path):
    (tmp_path / "theirs.py").write_text("open('imported', 'w').close()\nMANAGER = object\n")
    with Store(tmp_path / "c", Campaign("theirs", ("suave",), ("theirs:MANAGER",))):
        pass
    code, _, err = quick("campaign", "--resume", "--out", "c")
    assert code == 2
    assert "would import theirs, because a file of results says so" in err
    assert not (tmp_path / "imported").exists()


MISSION = 'missions = ["suave"]\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('mission = ["suave"]', "unknown key 'mission'; did you mean missions?"),
        ("runs = 3", "says nothing to run; give missions"),
        ('missions = "suave"', "missions is 'suave'; expected is a list"),
        ('missions = ["suaf"]', "unknown mission 'suaf'; there are suave"),
        (MISSION + 'managers = ["bd"]', "unknown manager 'bd'; there are ours"),
        (MISSION + 'tasks = ["xml"]', "unknown task layer 'xml'"),
        (MISSION + "runs = 1.5", "runs is 1.5; expected is a whole number"),
        (MISSION + "first_seed = -1", "first_seed is -1; expected is 0 or more"),
        ('missions = ["suave", "suave"]', "lists suave/ours/bt/0 2 times"),
        (MISSION + "sweep = { bias = 1 }", "sweep is {'bias': 1}; expected is a list"),
        (MISSION + "settings = { bais = 1 }", "unknown setting 'bais'"),
        (MISSION + "sweep = { mass_kg = [1, -1] }", "mass_kg"),
        (MISSION + 'name = "../up"', "name is '../up'"),
        ('missions = ["suave"', "cannot read c.toml"),
    ],
)
def test_wrong_file_is_refused_before_anything_runs(quick, tmp_path, text, message):
    (tmp_path / "c.toml").write_text(text)
    code, out, err = quick("campaign", "c.toml")
    assert (code, out) == (2, "")
    assert message in err
    assert not (tmp_path / "campaigns").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("none.toml", "cannot read none.toml: No such file"),
        ("", "say what to run: FILE.toml or --paper-table, or --resume --out DIR"),
        ("--runs 3", "--runs goes with FILE.toml or --paper-table"),
        ("c.toml --paper-table", "give either FILE.toml or --paper-table"),
        ("c.toml --workers 2 --cluster x:1", "not both"),
        ("c.toml --retry", "--retry goes with --resume"),
        ("--resume --out nowhere", "nowhere holds no campaign: there is no campaign.json in it"),
        ("c.toml --out c.toml/in", "cannot make c.toml/in: Not a directory"),
    ],
)
def test_wrong_use_is_one_clear_message(quick, words, message):
    code, _, err = quick("campaign", *words.split())
    assert code == 2
    assert message in err


BEGUN = Campaign("small", ("suave",), ("none",), runs=2, settings={"duration_s": "1"})


@cache
def first():
    return do(next(BEGUN.planned()))


@pytest.fixture
def begun(tmp_path):
    """Return the folder of a campaign of which one run is done."""
    with Store(tmp_path / "c", BEGUN) as store:
        store.keep(first())
    return tmp_path / "c"


def test_folder_with_another_campaign_is_left_alone(begun, quick):
    before = (begun / "runs.jsonl").read_bytes()
    code, _, err = quick("campaign", "c.toml", "--out", begun)
    assert (code, "holds a campaign already; go on with it by --resume" in err) == (2, True)
    code, _, err = quick("campaign", "c.toml", "--resume", "--out", begun)
    assert code == 2
    assert "holds another campaign: its managers is ('none',), not ('none', 'bt', 'ours')" in err
    assert (begun / "runs.jsonl").read_bytes() == before


def test_folder_is_locked_by_one_program_at_a_time(begun, quick):
    with Store(begun, None, resume=True):
        code, _, err = quick("campaign", "--resume", "--out", begun)
    assert (code, "another program is running the campaign" in err) == (2, True)


def test_results_of_different_code_are_never_mixed(begun, quick):
    with (
        Store(begun, None, resume=True) as store,
        pytest.raises(MissionError, match=r"was run by other code \(other\) than the campaign"),
    ):
        store.keep(Outcome(1, "other", {"run": "x", "outcome": "y"}))
    about = json.loads((begun / "campaign.json").read_text())
    about["provenance"]["code"] = "older"
    (begun / "campaign.json").write_text(json.dumps(about))
    code, _, err = quick("campaign", "--resume", "--out", begun)
    assert (code, "was begun with code older, here is" in err) == (2, True)
