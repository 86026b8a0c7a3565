"""A recorded battery drop, decided once more without the simulator: every decision of task and architecture."""

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest
from py_trees.decorators import FailureIsRunning
from running import run_mission
from small_rover import rover_model, rover_tree

from missions import suave_extended
from missions.engine.mission import MissionError, Percepts
from missions.engine.recording import failed, header, line_of, measured, recovered, sensed
from missions.engine.runner import Listener
from missions.engine.task_layer import mission_domain
from missions.suave.tree import suave_tree
from missions.suave_extended.model import suave_extended_model
from missions.suave_extended.tree import suave_extended_tree
from missions.testing.decisions import replay
from rosa_bt import replay_trace
from rosa_pddl import PlanExecutor

BATTERY_DROP = Path(__file__).with_name("battery_drop.jsonl")

BLOCKED = """
import sys
sys.modules["mujoco"] = None  # importing it raises from here on
from missions.testing.decisions import replay
for task in ("bt", "pddl"):
    decisions = replay(sys.argv[1], "suave_extended", task=task)
    print([name for name, *_ in decisions.actions])
assert not any(name.startswith("suave_env") for name in sys.modules)
"""


class Hearing(Listener):
    def __init__(self):
        self.messages = []

    def message(self, message):
        self.messages.append(message)


def switched(decisions):
    return [
        (round(plan.start, 2), plan.deactivate, plan.activate, plan.parameters)
        for plan in decisions.plans
    ]


@pytest.mark.parametrize("task", ["bt", "pddl"])
def test_battery_drop_is_answered_by_task_and_architecture(task):
    decisions = replay(BATTERY_DROP, "suave_extended", task=task)
    assert [name for name, _, _, _ in decisions.actions] == [
        *("search_pipeline", "inspect_pipeline", "recharge", "inspect_pipeline")
    ]
    drop, *back = (one for one in decisions.adaptations if one.kind == "task")
    planning_s = 0.2 if task == "pddl" else 0.0
    assert drop.change == "inspect_pipeline -> recharge; stop follow_pipeline; start recharge"
    assert drop.at_s == pytest.approx(150.0 + planning_s, abs=0.11)
    there_and_back = ["recharge -> inspect_pipeline; stop recharge; start follow_pipeline"]
    assert [one.change for one in back] == (there_and_back if task == "bt" else []), (
        "the next step of a plan is none"
    )


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
    assert [
        (one.at_s, one.kind, one.change, one.reason, one.reaction_s)
        for one in decisions.adaptations
    ] == live
    begun = [(one.action, one.start) for one in run.kb.history.actions]
    assert [(name, start) for name, start, _, _ in decisions.actions] == begun


def planned(kb, percepts):
    """Return the planned task layer of the mission, put together by hand."""
    mission = suave_extended.MISSION
    executor = PlanExecutor(
        "plan",
        kb=kb,
        domain=mission_domain(mission),
        behaviours={
            name: (lambda step, action=action: action(kb, percepts))
            for name, action in mission.actions.items()
        },
        sense=lambda: mission.facts(kb, percepts),
        clock=lambda: kb.now,
    )
    return FailureIsRunning("until the goal holds", executor)


@pytest.mark.parametrize(("task", "behaviour"), [("bt", suave_extended_tree), ("pddl", planned)])
def test_model_with_a_behaviour_of_ones_own_decides_as_the_mission_does(task, behaviour):
    mission = replay(BATTERY_DROP, "suave_extended", task=task)
    own = replay(BATTERY_DROP, suave_extended_model(), behaviour)
    assert str(own) == str(mission)
    assert own.actions == mission.actions
    assert [plan.steps for plan in own.task_plans] == [plan.steps for plan in mission.task_plans]
    assert bool(own.task_plans) == (task == "pddl")
    own.assert_adapts(
        at=150.0, from_="inspect_pipeline", to="recharge", within=0.2 if task == "bt" else 0.4
    )


def test_behaviour_takes_the_place_of_the_task_layer_of_a_mission():
    decisions = replay(BATTERY_DROP, "suave_extended", suave_tree, task="pddl")
    decisions.assert_actions("search_pipeline", "inspect_pipeline", "inspect_pipeline")
    decisions.assert_never(action="recharge")


def test_trace_of_a_replay_can_be_decided_once_more():
    trace = replay(
        BATTERY_DROP, "suave_extended", lambda kb, percepts: suave_tree(kb, Percepts())
    ).trace
    again = replay_trace(trace, suave_extended_model(), lambda kb: suave_tree(kb, Percepts()))
    assert str(again).replace("suave_extended", "") == str(trace).replace("suave_extended", "")
    assert len(trace.ticks) > 2000


def test_stream_written_by_hand_is_heard_as_the_file_is():
    stream = [
        measured(0.0, water_visibility=3.75, battery_level=1.0),
        failed(10.0, "c_thruster_1", "c_thruster_2"),
        recovered(20.0, "c_thruster_1", "c_thruster_2"),
        sensed(30.0, pipeline_found=True),
        measured(40.0, battery_level=0.1),
    ]
    decisions = replay(stream, "suave_extended")
    decisions.assert_reconfigures(at=10.0, activate="recover_thrusters", within=0.1)
    decisions.assert_reconfigures(at=20.0, deactivate="recover_thrusters", within=0.1)
    decisions.assert_begins("inspect_pipeline", at=30.0, within=0.1)
    decisions.assert_adapts(at=40.0, to="recharge", within=0.2)
    assert not decisions.problems


def test_recording_is_replayed_to_its_end_however_long_it_is():
    decisions = replay(
        [measured(0.0, battery_level=1.0), measured(500.0, battery_level=0.1)], "suave_extended"
    )
    decisions.assert_adapts(at=500.0, to="recharge", within=0.2)


@pytest.mark.parametrize(
    ("messages", "message"),
    [
        ([{"time": -1.0, "status": []}], 'message 1: a message is an object with a number "time"'),
        (
            [measured(0.0), {"time": 1.0, "status": [{"message": "x"}]}],
            'message 2: each "status" is an object',
        ),
        ([measured(2.0), measured(1.0)], "message 2: time 1.0 comes after 2.0"),
    ],
)
def test_bad_message_is_refused_with_its_number(messages, message):
    with pytest.raises(MissionError, match=message):
        replay(messages, "suave_extended")


def test_replay_needs_no_simulator():
    done = subprocess.run(
        [sys.executable, "-c", BLOCKED, str(BATTERY_DROP)],
        capture_output=True,
        text=True,
        check=False,
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
        (
            ['{"time": 1, "status": [{"message": "x"}]}'],
            ':1: each "status" is an object with a text "message"',
        ),
        (['{"time": 0, "status": [], "run": [1]}'], ':1: "run" says how it was run'),
        (['{"time": 0, "status": [], "run": {"settings": [1]}}'], ':1: "run" says how it was run'),
        (
            ['{"time": 0, "status": [], "run": {"switching_s": {"activate": -1}}}'],
            "used: ValueError: activate takes -1",
        ),
        (
            ['{"time": 0, "status": [], "run": {"switching_s": {"activate": "x"}}}'],
            "activate takes 'x'; allowed is",
        ),
        (
            ['{"time": 0, "status": [], "run": {"commands": [1]}}'],
            "how it was run cannot be used: TypeError",
        ),
        (
            ['{"time": 0, "status": [], "run": {"settings": {"duration_s": "x"}}}'],
            "duration_s is 'x'",
        ),
        (
            ['{"time": 0, "status": [], "run": {"settings": {"import": "os"}}}'],
            "unknown setting 'import'",
        ),
        (
            ['{"time": 2, "status": []}', "", '{"time": 1, "status": []}'],
            ":3: time 1 comes after 2",
        ),
    ],
)
def test_bad_recording_is_refused_with_its_line(tmp_path, lines, message):
    path = tmp_path / "bad.jsonl"
    path.write_text("\n".join(lines))
    with pytest.raises(MissionError, match=message):
        replay(path, "suave_extended")


def test_missing_recording_and_unknown_mission_are_named(tmp_path):
    with pytest.raises(
        MissionError,
        match=r"cannot read the recording .*nothing\.jsonl: No such file or directory$",
    ) as missing:
        replay(tmp_path / "nothing.jsonl", "suave_extended")
    assert missing.value.__suppress_context__, "one traceback is enough"
    with pytest.raises(
        MissionError, match="unknown mission 'suaf'; there are suave, suave_extended"
    ):
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


@pytest.mark.parametrize(
    ("slip", "message"),
    [
        (
            failed(1.0, "camra"),
            "at 1.00 s: camra='failure': unknown component 'camra'; did you mean 'camera'",
        ),
        (
            measured(1.0, enrgy=0.1),
            "at 1.00 s: enrgy='0.1': unknown attribute 'enrgy'; did you mean 'energy'",
        ),
        (
            measured(1.0, energy=math.nan),
            "at 1.00 s: energy='nan': a measurement is a finite number",
        ),
    ],
)
def test_slip_in_a_stream_written_in_python_is_an_error(slip, message):
    stream = [measured(0.0, light=0.9, energy=1.0), slip, sensed(2.0, explored=True)]
    with pytest.raises(MissionError, match=message):
        replay(stream, rover_model(), rover_tree)


def test_failure_shows_what_of_a_recording_could_not_be_used(tmp_path):
    path = tmp_path / "run.jsonl"
    slips = [failed(float(time), "camra") for time in range(1, 4)]
    path.write_text(
        "".join(line_of(message) for message in [measured(0.0, light=0.9, energy=1.0), *slips])
    )
    decisions = replay(path, rover_model(), rover_tree)
    claims = [
        lambda: decisions.assert_never(activate="camera"),
        lambda: decisions.assert_actions("charge"),
        lambda: decisions.assert_begins("charge", at=1.0),
    ]
    for claim in claims:
        with pytest.raises(AssertionError) as failure:
            claim()
        assert str(failure.value).splitlines()[-2:] == [
            "what could not be used, the first time:",
            "     1.00 s  camra='failure': unknown component 'camra'; did you mean 'camera'?",
        ]
