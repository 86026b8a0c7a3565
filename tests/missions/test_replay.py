"""A recorded battery drop, decided once more without the simulator: every decision of task and architecture."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from running import run_mission

from missions.mission import MissionError
from missions.recording import header, line_of
from missions.replay import replay
from missions.runner import Listener

BATTERY_DROP = Path(__file__).with_name("battery_drop.jsonl")

BLOCKED = """
import sys
sys.modules["mujoco"] = None  # importing it raises from here on
from missions.replay import replay
for task in ("bt", "pddl"):
    decisions = replay(sys.argv[1], "suave_extended", task=task)
    print([name for _, name in decisions.requested])
assert not any(name.startswith("suave_env") for name in sys.modules)
"""


class Hearing(Listener):
    def __init__(self):
        self.messages = []

    def message(self, message):
        self.messages.append(message)


def switched(decisions):
    return [(round(plan.start, 2), plan.deactivate, plan.activate, plan.parameters) for plan in decisions.plans]


@pytest.mark.parametrize("task", ["bt", "pddl"])
def test_battery_drop_is_answered_by_task_and_architecture(task):
    decisions = replay(BATTERY_DROP, "suave_extended", task=task)
    assert [name for name, _, _, _ in decisions.actions] == [
        *("search_pipeline", "inspect_pipeline", "recharge", "inspect_pipeline")
    ]
    (_, drop_s, _), (_, back_s, _) = [
        (one.kind, one.at_s, one.trigger) for one in decisions.adaptations if one.kind == "task"
    ]
    drop, back = (one for one in decisions.adaptations if one.kind == "task")
    planning_s = 0.2 if task == "pddl" else 0.0
    assert drop.change == "inspect_pipeline -> recharge; stop follow_pipeline; start recharge"
    assert back.change == "recharge -> inspect_pipeline; stop recharge; start follow_pipeline"
    assert drop_s == pytest.approx(150.0 + planning_s, abs=0.11)
    assert drop_s < back_s


def test_decisions_of_the_tree_are_exactly_these():
    decisions = replay(BATTERY_DROP, "suave_extended")
    thrusters = tuple(f"c_thruster_{number}" for number in range(1, 7))
    assert switched(decisions) == [
        (0.0, (), ("spiral_search", *thrusters), ("high_altitude",)),
        (12.0, (), (), ("medium_altitude",)),
        (23.0, (), (), ("low_altitude",)),
        (35.5, thrusters, ("recover_thrusters",), ()),
        (46.0, ("recover_thrusters",), thrusters, ()),
        (100.0, ("spiral_search",), ("follow_pipeline",), ()),
        (150.0, ("follow_pipeline",), ("recharge",), ()),
        (185.0, ("recharge",), ("follow_pipeline",), ()),
    ]


@pytest.mark.parametrize("task", ["bt", "pddl"])
def test_replay_of_a_live_run_decides_the_same_at_the_same_times(task, tmp_path):
    path, heard = tmp_path / "run.jsonl", Hearing()
    run, _, _ = run_mission("suave_extended", task, 7, listeners=[heard])
    path.write_text("".join(line_of(message) for message in [header(run, 7), *heard.messages]))
    decisions = replay(path, "suave_extended", task=task)
    live = [(one.at_s, one.kind, one.change, one.reason, one.reaction_s) for one in run.adaptations]
    assert len(live) >= 6
    assert [(one.at_s, one.kind, one.change, one.reason, one.reaction_s) for one in decisions.adaptations] == live
    begun = [(one.action, one.start) for one in run.kb.action_history]
    assert [(name, start) for name, start, _, _ in decisions.actions] == begun


def test_replay_needs_no_simulator():
    done = subprocess.run(
        [sys.executable, "-c", BLOCKED, str(BATTERY_DROP)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "['search_pipeline', 'inspect_pipeline', 'recharge', 'inspect_pipeline']",
        "['search_pipeline', 'inspect_pipeline', 'recharge', 'inspect_pipeline']",
    ]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["{"], ":1:2: not JSON"),
        (["[]"], r':1: a message is an object with a number "time"'),
        (['{"time": true, "status": []}'], ':1: a message is an object with a number "time"'),
        (['{"time": 1, "status": [{"message": "x"}]}'], ':1: each "status" is an object with a text "message"'),
        (['{"time": 2, "status": []}', "", '{"time": 1, "status": []}'], ":3: time 1 comes after 2"),
    ],
)
def test_bad_recording_is_refused_with_its_line(tmp_path, lines, message):
    path = tmp_path / "bad.jsonl"
    path.write_text("\n".join(lines))
    with pytest.raises(MissionError, match=message):
        replay(path, "suave_extended")


def test_missing_recording_and_unknown_mission_are_named(tmp_path):
    with pytest.raises(MissionError, match=r"cannot read the recording .*nothing\.jsonl"):
        replay(tmp_path / "nothing.jsonl", "suave_extended")
    with pytest.raises(MissionError, match="unknown mission 'suaf'; there are suave, suave_extended"):
        replay(BATTERY_DROP, "suaf")


def test_faults_in_a_stream_are_reported_and_stop_nothing(tmp_path):
    lines = BATTERY_DROP.read_text().splitlines()
    fault = {"message": "QA status", "values": {"battery_level": "nan", "batery_level": "0.1"}}
    broken = tmp_path / "broken.jsonl"
    broken.write_text("\n".join([json.dumps({"time": 0.0, "status": [fault]}), *lines]))
    whole, with_fault = (replay(path, "suave_extended") for path in (BATTERY_DROP, broken))
    assert with_fault.actions == whole.actions
    assert [str(problem) for _, problem in with_fault.problems] == [
        "battery_level='nan': a measurement is a finite number",
        "batery_level='0.1': unknown attribute 'batery_level'; did you mean 'battery_level'?",
    ]
