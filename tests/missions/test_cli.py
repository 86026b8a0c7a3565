"""The command line as a person uses it: what it prints, writes and says of mistakes."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from running import text
from typer.testing import CliRunner

from missions import cli
from missions.baselines import MANAGERS, OURS, POLICIES
from missions.engine.mission import MISSIONS, find_mission
from missions.engine.recording import read_recording


def rosa(*arguments, environment=None):
    """Run the command line in a process of its own."""
    command = [sys.executable, "-m", "missions", *map(str, arguments)]
    settings = {**os.environ, **(environment or {})}
    return subprocess.run(command, capture_output=True, text=True, env=settings, check=False)


@pytest.fixture
def quick(capsys):
    """Run the command line in this process; returns exit status, output and errors."""

    def run(*arguments):
        sys.argv = ["rosa", *map(str, arguments)]
        try:
            cli.main()
            code = 0
        except SystemExit as end:
            code = end.code or 0
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


def test_missions_are_listed_with_what_happens_in_them(quick):
    code, out, _ = quick("list")
    assert code == 0
    assert len(MISSIONS) >= 2
    for mission in map(find_mission, MISSIONS):
        assert mission.name in out
        assert mission.summary in out


def test_settings_are_listed_with_unit_default_and_source(quick):
    code, out, _ = quick("settings", "suave_extended")
    assert code == 0
    rows = out.splitlines()
    row = next(number for number, line in enumerate(rows) if line.startswith("discharge_time_s"))
    assert "200 s " in rows[row]
    assert "ROSA paper" in rows[row + 1]
    assert all(
        name in out for name in ("duration_s", "tick_period_s", "planning_delay_s", "activation_s")
    )


@pytest.mark.parametrize(
    ("mission", "row"),
    [
        ("agv", r"physics_step_s +0\.01 +s +from 0\.001 to 0\.01$"),
        ("agv", r"capacity_j +20000 +J +from 1$"),
        ("agv", r"duration_s +300 +s +from 0\.001$"),
        ("uav", r"samples +7 +\S+ +from 1 to 7$"),
        ("suave", r"activation_s +\S+ +s +from 0$"),
    ],
)
def test_settings_are_listed_with_what_is_allowed(quick, mission, row):
    _, out, _ = quick("settings", mission)
    assert re.search(f"^{row}", out, re.MULTILINE), out


def test_run_tells_each_adaptation_with_its_reason_and_ends_with_a_table(quick):
    code, out, err = quick("run", "suave_extended", "--set", "duration_s=200")
    assert code == 0, err
    for words in (
        "structural adaptation: start recover_thrusters",
        "all_thrusters is unfeasible because component c_thruster_1 has failed",
        "task adaptation: inspect_pipeline -> recharge; stop follow_pipeline; start recharge",
        "battery_level just below 0.25 violates >= 0.25",
        "search time [s]",
        "distance inspected [m]",
        "times real time",
        "time_limit",
    ):
        assert words in " ".join(out.split()), words


def test_why_an_action_is_unfeasible_is_told_once(quick):
    _, out, _ = quick("run", "suave_extended", "--set", "duration_s=152")
    assert "inspect_pipeline is abandoned: inspect_pipeline is unfeasible\n" in out
    assert out.count("battery_level just below 0.25 violates >= 0.25") == 1


def test_run_without_progress_prints_the_result_only(quick):
    code, out, _ = quick("run", "suave", "--no-progress", "--set", "duration_s=150")
    assert code == 0
    assert "is requested" not in out
    assert "time_limit" in out


def test_adaptations_are_told_the_same_meanwhile_and_at_the_end(quick):
    code, out, _ = quick("run", "agv", "--seed", "1", "--no-progress")
    assert code == 0
    assert "why: aruco_camera is unfeasible because light 0.1" in out
    adaptations = [line for line in out.splitlines() if "adaptation:" in line or "why:" in line]
    assert len(adaptations) >= 4
    assert [
        line for line in quick("run", "agv", "--seed", "1")[1].splitlines() if line in adaptations
    ] == adaptations


def test_settings_and_results_are_readable_in_80_columns_and_padded_to_no_width_in_a_pipe(quick):
    rows = quick("settings", "suave")[1].splitlines()
    assert len(rows) > 40
    assert all(len(row) <= 80 for row in rows if not row.startswith("    "))
    assert all(
        row == row.rstrip()
        for row in [*rows, *quick("run", "suave", "--no-progress")[1].splitlines()]
    )


def test_tree_that_plans_tells_its_plans_as_they_are_made(quick):
    _, out, _ = quick(
        "run", "agv", "--seed", "1", "--set", "capacity_j=2500", "--set", "duration_s=20"
    )
    text = " ".join(out.split())
    assert "0.0 s plan (c1: of all ways the best for time" in text
    assert "amcl_kinect fast (the only design that is feasible" in text
    assert "plan (no way keeps within all limits: energy" in text
    assert "): none, unsolvable proven (joint plan)" in text


def test_run_writes_all_files_that_are_asked_for(quick, tmp_path):
    files = {name: tmp_path / f"out.{name}" for name in ("json", "plot", "timing", "record")}
    options = [part for name, path in files.items() for part in (f"--{name}", path)]
    code, _, err = quick(
        "run", "suave_extended", "--task", "pddl", "--set", "duration_s=130", *options
    )
    assert code == 0, err
    data = json.loads(files["json"].read_text())
    assert data["settings"] == {"duration_s": "130"}
    assert data["task"] == "pddl"
    assert files["plot"].read_bytes().startswith(b"\x89PNG")
    timing = json.loads(files["timing"].read_text())
    assert timing["simulated_s"] == 130
    assert sum(timing["compute_s"].values()) <= timing["wall_s"]
    assert len(files["record"].read_text().splitlines()) > 200
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "out.json",
        "out.plot",
        "out.record",
        "out.timing",
    ]


def test_json_is_the_same_to_the_byte_under_another_hash_seed(tmp_path):
    path = tmp_path / "run.json"
    seed = "0" if os.environ.get("PYTHONHASHSEED") == "1234" else "1234"
    done = rosa(
        "run",
        "suave_extended",
        "--task",
        "pddl",
        "--json",
        path,
        environment={"PYTHONHASHSEED": seed},
    )
    assert done.returncode == 0, done.stderr
    assert path.read_text() == text("suave_extended", "pddl")


def test_mission_that_fails_its_goal_exits_with_1(quick):
    code, out, _ = quick("run", "suave", "--set", "duration_s=20", "--no-progress")
    assert code == 1
    assert "not_found" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["run", "suave_extendet"],
            "unknown mission 'suave_extendet'; there are suave, suave_extended",
        ),
        (["settings", "suaf"], "unknown mission 'suaf'"),
        (["run", "suave", "--task", "bd"], "unknown task layer 'bd'; there are bt and pddl"),
        (
            ["run", "suave", "--set", "duratoin_s=3"],
            "unknown setting 'duratoin_s' of mission suave; did you mean",
        ),
        (
            ["run", "suave", "--set", "duration_s=-3"],
            "duration_s is '-3'; allowed is a number of seconds from 0.001",
        ),
        (["run", "suave", "--set", "duration_s=nan"], "duration_s is 'nan'"),
        (["run", "suave", "--set", "duration_s"], "--set takes NAME=VALUE, not 'duration_s'"),
        (["run", "suave", "--set", "mass_kg=heavy"], "mass_kg"),
        (["run", "suave", "--json", "no/such/folder/x.json"], "cannot write no/such/folder/x.json"),
        (["run", "suave", "--plot", "/"], "cannot write /: it is a directory"),
        (["run", "suave", "--json", "n" * 300], ": File name too long"),
        (["run", "suave", "--task", ":x:"], "unknown task layer ':x:'"),
        (
            ["run", "suave", "--set", "tick_period_s=1e-12"],
            "allowed is a number of seconds from 0.001",
        ),
        (
            ["run", "suave", "--set", "drag_surge=1e300", "--no-progress"],
            "the simulation became unstable after",
        ),
        (
            ["run", "nowhere:MISSION"],
            "cannot import mission 'nowhere:MISSION': there is no module nowhere here in",
        ),
        (["run", "missions.suave:MISION"], "did you mean missions.suave:MISSION?"),
        (
            ["run", "json:loads"],
            "'json:loads' is a function, not a missions.engine.mission.Mission",
        ),
        (["run", "suave", "--seed", "-1"], "--seed"),
        (["run", "suave", "--set", "rows", "3"], "--set takes NAME=VALUE, not 'rows'"),
        (["run", "launch"], "unknown mission 'launch'; did you mean launch:MISSION?"),
        (["bridge", "nofile.toml"], "a file of settings is given as --config nofile.toml"),
        (["run", "suave", "--fast"], "--fast"),
        (["fly"], "fly"),
    ],
)
def test_wrong_use_is_one_clear_message_and_exits_with_2(quick, arguments, message):
    code, out, err = quick(*arguments)
    assert code == 2
    assert message in " ".join(err.split())
    assert "Traceback" not in out + err
    assert "adaptation" not in out  # found out before the mission runs


def test_no_file_is_left_behind_when_the_mission_cannot_run(quick, tmp_path):
    code, _, _ = quick("run", "suave", "--json", tmp_path / "x.json", "--set", "mass_kg=-1")
    assert code == 2
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("option", ["json", "plot", "timing", "record"])
def test_full_device_is_one_clear_message(quick, option):
    code, _, err = quick("run", "suave", "--set", "duration_s=5", f"--{option}", "/dev/full")
    assert code == 2
    assert "cannot write /dev/full: No space left on device" in err


def test_full_standard_output_is_one_clear_message():
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-m", "missions", "list"]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.strip() == "rosa: cannot print: No space left on device"


def test_link_is_followed_not_replaced(quick, tmp_path):
    target = tmp_path / "target.json"
    link = tmp_path / "link.json"
    target.write_text("old")
    link.symlink_to(target)
    quick("run", "suave", "--set", "duration_s=5", "--json", link)
    assert link.is_symlink()
    assert json.loads(target.read_text())["mission"] == "suave"


def test_termination_leaves_no_draft_behind(tmp_path):
    command = [
        sys.executable,
        "-m",
        "missions",
        "run",
        "suave",
        "--speed",
        "1",
        "--json",
        str(tmp_path / "x.json"),
    ]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as running:
        assert "suave (task layer" in running.stdout.readline()
        running.terminate()
        running.communicate()
    assert running.returncode == 128 + 15
    assert list(tmp_path.iterdir()) == []


def test_same_fault_in_diagnostics_is_told_once_and_counted(quick):
    _, out, _ = quick("run", "suave", "--set", "battery=true", "--set", "duration_s=30")
    text = " ".join(out.split())
    assert text.count("diagnostics not used") == 1
    assert "30 parts of diagnostics were not used, the first: battery_level='1.0'" in text


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_recording_of_a_program_that_is_killed_holds_what_was_heard_until_then(how, tmp_path):
    path = tmp_path / "run.jsonl"
    command = [
        sys.executable,
        "-m",
        "missions",
        "run",
        "suave_extended",
        "--record",
        str(path),
        "--speed",
        "20",
    ]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as running:
        while running.poll() is None and not (
            path.exists() and len(path.read_text().splitlines()) > 20
        ):
            time.sleep(0.05)
        running.send_signal(how)
        running.wait(30)
    first, *heard = read_recording(path)
    assert first["run"]["mission"] == "suave_extended"
    assert len(heard) >= 20
    assert heard[-1]["time"] < 300.0


def test_recording_carries_the_settings_so_that_its_replay_decides_the_same(quick, tmp_path):
    from missions.testing.decisions import replay

    changed = [
        "tick_period_s=0.7",
        "duration_s=320",
        "activation_s=0.4",
        "deactivation_s=0.2",
        "planning_delay_s=1.3",
    ]
    options = [part for setting in changed for part in ("--set", setting)]
    files = ["--record", tmp_path / "run.jsonl", "--json", tmp_path / "run.json"]
    code, _, err = quick(
        "run", "suave_extended", "--task", "pddl", "--no-progress", *options, *files
    )
    assert code == 0, err
    decisions = replay(tmp_path / "run.jsonl", "suave_extended", task="pddl")
    live = json.loads((tmp_path / "run.json").read_text())["adaptations"]
    assert len(live) > 6
    again = [
        (round(adaptation.at_s, 6), adaptation.change, round(adaptation.reaction_s, 6))
        for adaptation in decisions.adaptations
    ]
    assert again == [(one["at_s"], one["change"], one["reaction_s"]) for one in live]


def test_help_names_every_option():
    shown = (
        CliRunner()
        .invoke(cli.app, ["run", "--help"], env={"COLUMNS": "120", "NO_COLOR": "1"})
        .output
    )
    for option in (
        *("--task", "--seed", "--json", "--plot", "--timing", "--record", "--set", "--speed"),
        *("--speed", "--no-progress"),
    ):
        assert option in shown


STARTS = """
import contextlib, io, sys
from typer.testing import CliRunner
from missions.cli import app
for arguments, unwanted in (
    (["--help"], ["kb", "py_trees", "numpy", "rosa_pddl"]),
    (["list"], ["mujoco", "suave_env", "unified_planning", "matplotlib", "scipy", "ortools"]),
    (["settings", "suave"], ["mujoco", "unified_planning", "matplotlib", "scipy", "ortools"]),
):
    assert CliRunner().invoke(app, arguments).exit_code == 0
    print([name for name in unwanted if name in sys.modules])
"""


def test_help_list_and_settings_start_without_what_they_do_not_need():
    done = subprocess.run(
        [sys.executable, "-c", STARTS], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["[]", "[]", "[]"]


def test_managers_that_the_help_names_are_those_there_are():
    shown = (
        CliRunner()
        .invoke(cli.app, ["run", "--help"], env={"COLUMNS": "200", "NO_COLOR": "1"})
        .output
    )
    assert {OURS, *MANAGERS, *POLICIES} <= set(re.findall(r"\w+", shown))
