"""The command line as a person uses it: what it prints, writes and says of mistakes."""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from running import called, text
from typer.testing import CliRunner

from missions import cli
from missions.baselines import MANAGERS, OURS, POLICIES
from missions.engine.mission import MISSIONS, find_mission
from missions.engine.recording import read_recording

ROSA = (sys.executable, "-m", "missions")


@pytest.fixture
def rosa(capsys, monkeypatch):
    """Run the command line in this process; returns exit status, output and errors."""

    def run(command, *more):
        return called(capsys, monkeypatch, *shlex.split(command), *more)

    return run


def test_missions_are_listed_with_what_happens_in_them(rosa):
    code, out, _ = rosa("list")
    assert code == 0
    assert len(MISSIONS) >= 2
    for mission in map(find_mission, MISSIONS):
        assert mission.name in out
        assert mission.summary in out


@pytest.mark.parametrize(
    ("mission", "row"),
    [
        ("agv", r"capacity_j +20000 +J +from 1$"),
        ("uav", r"samples +7 +\S+ +from 1 to 7$"),
        ("suave_extended", r"discharge_time_s +200 s .*\n.*ROSA paper"),
    ],
)
def test_settings_are_listed_with_unit_range_and_source(rosa, mission, row):
    _, out, _ = rosa(f"settings {mission}")
    assert re.search(f"^{row}", out, re.MULTILINE), out
    rows = out.splitlines()
    assert all(len(row) <= 80 for row in rows if not row.startswith("    "))
    assert all(row == row.rstrip() for row in rows), "a pipe needs no padding"


def test_run_tells_adaptations_with_reasons_and_a_table(rosa):
    code, out, err = rosa("run suave_extended --set duration_s=200")
    assert code == 0, err
    assert out.count("battery_level just below 0.25 violates >= 0.25") == 1, "told once"
    assert "inspect_pipeline is abandoned: inspect_pipeline is unfeasible\n" in out
    for words in (
        "structural adaptation: start recover_thrusters",
        "all_thrusters is unfeasible because component c_thruster_1 has failed",
        "task adaptation: inspect_pipeline -> recharge; stop follow_pipeline; start recharge",
        "search time [s]",
        "distance inspected [m]",
        "times real time",
        "time_limit",
    ):
        assert words in " ".join(out.split()), words


def test_run_without_progress_tells_adaptations_at_the_end(rosa):
    code, out, _ = rosa("run agv --seed 1 --no-progress")
    assert code == 0
    assert "is requested" not in out
    assert "why: aruco_camera is unfeasible because light 0.1" in out


def test_tree_that_plans_tells_its_plans_as_they_are_made(rosa):
    _, out, _ = rosa("run agv --seed 1 --set capacity_j=2500 --set duration_s=20")
    words = " ".join(out.split())
    assert "0.0 s plan (c1: of all ways the best for time" in words
    assert "amcl_kinect fast (the only design that is feasible" in words
    assert "plan (no way takes at most 1739 J; the best takes 2182 J)" in words
    assert "): none, unsolvable proven (joint plan)" in words


def test_run_writes_all_files_that_are_asked_for(rosa, tmp_path):
    names = ("json", "plot", "record")
    options = " ".join(f"--{name} {tmp_path}/out.{name}" for name in names)
    code, _, err = rosa(f"run suave_extended --task pddl --set duration_s=130 {options}")
    assert code == 0, err
    files = {path.suffix[1:]: path for path in tmp_path.iterdir()}
    assert set(files) == set(names)
    data = json.loads(files["json"].read_text())
    assert data["settings"] == {"duration_s": "130"}
    assert data["task"] == "pddl"
    assert files["plot"].read_bytes().startswith(b"\x89PNG")
    assert len(files["record"].read_text().splitlines()) > 200


def test_json_is_the_same_to_the_byte_under_another_hash_seed(tmp_path):
    path = tmp_path / "run.json"
    seed = "0" if os.environ.get("PYTHONHASHSEED") == "1234" else "1234"
    command = [*ROSA, "run", "suave_extended", "--task", "pddl", "--json", str(path)]
    subprocess.run(command, env={**os.environ, "PYTHONHASHSEED": seed}, check=True)
    assert path.read_text() == text("suave_extended", "pddl")


def test_mission_that_fails_its_goal_exits_1(rosa):
    code, out, _ = rosa("run suave --set duration_s=20 --no-progress")
    assert code == 1
    assert "not_found" in out


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("run suave_extendet", "unknown mission 'suave_extendet'; there are suave, suave_ext"),
        ("settings suaf", "unknown mission 'suaf'"),
        ("run suave --task bd", "unknown task layer 'bd'; there are bt and pddl"),
        ("run suave --set duratoin_s=3", "unknown setting 'duratoin_s' of mission suave; did you"),
        ("run suave --set duration_s=-3", "is '-3'; allowed is a number of seconds from 0.001"),
        ("run suave --set duration_s", "--set takes NAME=VALUE, not 'duration_s'"),
        ("run suave --set drag_surge=1e300 --no-progress", "became unstable after"),
        ("run suave --json no/such/folder/x.json", "cannot write no/such/folder/x.json"),
        (f"run suave --json {'n' * 300}", ": File name too long"),
        ("run nowhere:MISSION", "'nowhere:MISSION': there is no module nowhere here in"),
        ("run missions.suave:MISION", "did you mean missions.suave:MISSION?"),
        ("run json:loads", "'json:loads' is a function, not a missions.engine.mission.Mission"),
        ("run launch", "unknown mission 'launch'; did you mean launch:MISSION?"),
        ("run suave --fast", "--fast"),
        ("bridge nofile.toml", "a file of settings is given as --config nofile.toml"),
        ("fly", "fly"),
    ],
)
def test_wrong_use_is_one_clear_message_and_exits_2(rosa, command, message):
    code, out, err = rosa(command)
    assert code == 2
    assert message in " ".join(err.split())
    assert "adaptation" not in out, "it is found out before the mission runs"


def test_full_device_is_one_clear_message(rosa):
    code, _, err = rosa("run suave --set duration_s=5 --json /dev/full --record /dev/full")
    assert code == 2
    assert "cannot write /dev/full: No space left on device" in err


def test_full_standard_output_is_one_clear_message():
    with Path("/dev/full").open("w") as full:
        command = [*ROSA, "list"]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.strip() == "rosa: cannot print: No space left on device"


def test_termination_leaves_no_draft_behind(tmp_path):
    command = [*ROSA, "run", "suave", "--speed", "1", "--json", str(tmp_path / "x.json")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as running:
        assert "suave (task layer" in running.stdout.readline()
        running.terminate()
        running.communicate()
    assert running.returncode == 128 + 15
    assert list(tmp_path.iterdir()) == []


def test_fault_in_diagnostics_is_told_once_and_counted(rosa):
    _, out, _ = rosa("run suave --set battery=true --set duration_s=30")
    words = " ".join(out.split())
    assert words.count("diagnostics not used") == 1
    assert "30 parts of diagnostics were not used, the first: battery_level='1.0'" in words


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_recording_of_a_killed_program_holds_what_it_heard(how, tmp_path):
    path = tmp_path / "run.jsonl"
    command = [*ROSA, "run", "suave_extended", "--record", str(path), "--speed", "20"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as running:
        while running.poll() is None:
            time.sleep(0.05)
            if path.exists() and len(path.read_text().splitlines()) > 20:
                break
        running.send_signal(how)
        running.wait(30)
    first, *messages = read_recording(path)
    assert first["run"]["mission"] == "suave_extended"
    assert len(messages) >= 20
    assert messages[-1]["time"] < 300.0


def test_help_names_every_manager():
    environment = {"COLUMNS": "200", "NO_COLOR": "1"}
    shown = CliRunner().invoke(cli.app, ["run", "--help"], env=environment).output
    assert {OURS, *MANAGERS, *POLICIES} <= set(re.findall(r"\w+", shown))


STARTS = """
import sys
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


def test_help_list_and_settings_start_without_what_is_slow():
    command = [sys.executable, "-c", STARTS]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["[]", "[]", "[]"]
