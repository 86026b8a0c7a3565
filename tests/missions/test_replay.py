"""Replays: a recording is decided on again, and a test says what has to be decided."""

import math
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from py_trees.composites import Sequence
from running import run_mission
from small_rover import ENERGY_DROP, Sensing, rover_model, rover_tree

from kb import UnknownName
from missions.engine.mission import MissionError, Percepts
from missions.engine.percepts import failed, measured, recovered, sensed
from missions.engine.recording import (
    header,
    line_of,
    read_recording,
)
from missions.engine.runner import Listener
from missions.suave.tree import suave_tree
from missions.suave_extended.model import suave_extended_model
from missions.testing import FakeClock, ScriptedManaged, replay
from missions.wires.mcap import Bag
from rosa_bt import replay_trace

BATTERY_DROP = Path(__file__).with_name("battery_drop.jsonl")
BLOCKED = """
import sys
sys.modules["mujoco"] = None  # importing it raises from here on
from missions.testing.decisions import replay
print(*[name for name, *_ in replay(sys.argv[1], "suave_extended").actions])
assert not any(name.startswith("suave_env") for name in sys.modules)
"""


@cache
def rover():
    return replay(ENERGY_DROP, rover_model(), rover_tree)


def failure_of(assertion, *names, **expected):
    with pytest.raises(AssertionError) as caught:
        assertion(*names, **expected)
    return str(caught.value)


def test_assertions_about_an_energy_drop_hold():
    decisions = rover()
    drop = decisions.assert_adapts(at=20.0, from_="explore", to="charge", within=0.2)
    assert drop.reason.startswith("explore is unfeasible because energy 0.1 violates >= 0.2")
    decisions.assert_adapts(at=20.0, within=0.2)
    night = decisions.assert_reconfigures(at=10.0, configure="night", within=0.1)
    assert night.reason.startswith("day is unfeasible because light 0.3 violates >= 0.5")
    decisions.assert_reconfigures(at=15.0, deactivate="camera", activate=["radar"], within=0.15)
    decisions.assert_actions("explore", "charge", "explore")
    decisions.assert_never(action="charge", until=19.9)
    decisions.assert_never(activate="dock", configure="day", since=20.2)


@pytest.mark.parametrize(
    ("claim", "words"),
    [
        (
            lambda d: d.assert_adapts(at=20.0, to="charge", within=0.05),
            "but explore -> charge is decided at 20.00 s, in force at 20.10 s (because explore",
        ),
        (
            lambda d: d.assert_adapts(at=20.05, from_="explore", to="charge", within=5.0),
            "expected between 20.05 s and 25.05 s: explore -> charge",
        ),
        (lambda d: d.assert_actions("explore", "explore"), "  explore\n+ charge\n  explore"),
        (
            lambda d: d.assert_reconfigures(at=20.0, configure="night", within=0.1),
            "but the plan of 10.00 s is completed at 10.05 s",
        ),
        (lambda d: d.assert_reconfigures(at=0.0, activate=["camera", "radar"]), "it never does"),
        (
            lambda d: d.assert_never(activate=["radar", "dock"], action="charge"),
            "never activate dock, activate radar, begin charge\n  but activate radar at 15.00",
        ),
    ],
)
def test_assertion_that_fails_says_what_happened_instead(claim, words):
    assert words in failure_of(lambda: claim(rover()))


def test_assertion_that_fails_shows_the_events_around_its_time():
    message = failure_of(rover().assert_adapts, at=15.0, from_="explore", to="charge", within=0.5)
    lines = message.splitlines()
    assert lines[0] == "expected between 15.00 s and 15.50 s: explore -> charge"
    assert lines[3:7] == [
        "what happened:",
        "     0.50 s  heard     energy is 1",
        "    10.00 s  heard     light is 0.3",
        "    10.00 s  plan      configure night: completed at 10.05 s",
    ]
    assert "    15.00 s  EXPECTED  explore -> charge" in lines


@pytest.mark.parametrize(
    ("claim", "error", "words"),
    [
        (lambda d: d.assert_adapts(at=20.0, from_="explor"), UnknownName, "did you mean"),
        (lambda d: d.assert_actions("explore", "charg"), UnknownName, "did you mean"),
        (lambda d: d.assert_reconfigures(at=20.0, activate="dok"), UnknownName, "did you mean"),
        (lambda d: d.assert_never(deactivate="cammera"), UnknownName, "did you mean"),
        (lambda d: d.assert_never(action="charge", since=1e3), ValueError, "is no time of this"),
        (lambda d: d.assert_never(), ValueError, "say what to look for"),
        (lambda d: d.assert_reconfigures(at=1.0), ValueError, "say what to look for"),
    ],
)
def test_assertion_without_meaning_is_an_error(claim, error, words):
    with pytest.raises(error, match=words):
        claim(rover())


def test_next_action_after_a_completed_one_is_no_adaptation():
    def tree(kb, percepts):
        steps = [("explore", "explored"), ("charge", "charged")]
        children = [Sensing(name, kb, percepts, until) for name, until in steps]
        return Sequence("both", memory=True, children=children)

    stream = [measured(0.0, energy=1.0), sensed(5.0, explored=True)]
    decisions = replay(stream, rover_model(), tree)
    decisions.assert_actions("explore", "charge")
    assert "it never does" in failure_of(decisions.assert_adapts, at=5.0, to="charge")


def test_mission_that_ends_before_its_recording_says_so():
    drop = [measured(20.0, energy=0.1), sensed(30.0)]
    stream = [measured(0.0, light=0.9, energy=1.0), sensed(5.0, explored=True), *drop]
    decisions = replay(stream, rover_model(), rover_tree)
    ending = "the mission ended (replayed) before 2 messages"
    assert ending in failure_of(decisions.assert_adapts, at=20.0, to="charge")
    assert str(decisions).endswith(ending)
    assert not any(moment.what == "end" for moment in rover().timeline)


NEWS = st.one_of(
    st.builds(lambda value: {"energy": value}, st.sampled_from([0.1, 0.5, 1.0])),
    st.builds(lambda value: {"light": value}, st.sampled_from([0.1, 1.0])),
    st.sampled_from([failed, recovered]),
)


@settings(max_examples=15)
@given(st.lists(NEWS, max_size=8))
def test_replay_is_repeatable_and_its_own_claims_hold(news):
    stream = []
    for time, entry in enumerate(news, start=1):
        make = entry if callable(entry) else None
        stream.append(make(time, "camera") if make else measured(time, **entry))
    decisions = replay(stream, rover_model(), rover_tree)
    again = replay(stream, rover_model(), rover_tree)
    assert (decisions.trace, str(decisions)) == (again.trace, str(again))
    decisions.assert_actions(*(name for name, *_ in decisions.actions))
    for change in decisions.changes:
        within = change.in_force_s - change.at_s
        if math.isfinite(within):
            decisions.assert_adapts(at=change.at_s, to=change.action, within=within)


@pytest.mark.parametrize("task", ["bt", "pddl"])
def test_battery_drop_is_answered_by_task_and_architecture(task):
    decisions = replay(BATTERY_DROP, "suave_extended", task=task)
    decisions.assert_actions("search_pipeline", "inspect_pipeline", "recharge", "inspect_pipeline")
    drop, *back = (entry for entry in decisions.adaptations if entry.kind == "task")
    assert drop.change == "inspect_pipeline -> recharge; stop follow_pipeline; start recharge"
    assert len(back) == (task == "bt")  # the next step of a plan is no adaptation
    thrusters = tuple(f"c_thruster_{number}" for number in range(1, 7))
    plans = [(round(plan.start), plan.deactivate, plan.activate) for plan in decisions.plans]
    assert (36, thrusters, ("recover_thrusters",)) in plans
    assert (46, ("recover_thrusters",), thrusters) in plans


@pytest.mark.parametrize("task", ["bt", "pddl"])
def test_replay_of_a_live_run_decides_the_same(task, tmp_path):
    class Hearing(Listener):
        def message(self, message):
            lines.append(line_of(message))

    lines = []
    run, _, _ = run_mission("suave_extended", task, 7, listeners=[Hearing()], duration_s=160)
    path = tmp_path / "run.jsonl"
    path.write_text(line_of(header(run, 7)) + "".join(lines))
    decisions = replay(path, "suave_extended", task=task)
    assert len(run.adaptations) >= 5
    rows = [
        [(e.at_s, e.kind, e.change, e.reason, e.reaction_s) for e in entries]
        for entries in (decisions.adaptations, run.adaptations)
    ]
    assert rows[0] == rows[1]
    begun = [(action.action, action.start) for action in run.actions]
    assert [(name, start) for name, start, _, _ in decisions.actions] == begun


def test_lines_that_were_read_already_keep_how_the_robot_was_run():
    lines = [*read_recording(BATTERY_DROP)]
    lines[0] = {**lines[0], "run": {"settings": {"duration_s": 5.0}}}
    assert replay(Bag(lines), "suave_extended").kb.now == pytest.approx(5.0)


def test_tree_replaces_the_task_layer_and_its_trace_is_replayed():
    def tree(kb, percepts=None):
        return suave_tree(kb, Percepts())

    decisions = replay(BATTERY_DROP, "suave_extended", tree, task="pddl")
    decisions.assert_never(action="recharge")
    again = replay_trace(decisions.trace, suave_extended_model(), tree)
    texts = [repr(trace).replace("suave_extended", "") for trace in (again, decisions.trace)]
    assert texts[0] == texts[1]


def test_replay_needs_no_simulator():
    command = [sys.executable, "-c", BLOCKED, str(BATTERY_DROP)]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert out.split() == ["search_pipeline", "inspect_pipeline", "recharge", "inspect_pipeline"]


@pytest.mark.parametrize(
    ("source", "model", "tree", "words"),
    [
        ([measured(2.0), measured(1.0)], "suave", None, "message 2: time 1.0 comes after 2.0"),
        (ENERGY_DROP, "suaf", None, "unknown mission 'suaf'; there are suave, suave_extended"),
        (ENERGY_DROP, rover_model(), "rover_tree", "give a function of these parameters"),
        (ENERGY_DROP, rover_model(), lambda kb, percepts: None, "is None, not a py_trees"),
        (ENERGY_DROP, rover_model, None, "nothing here decides"),
        (ENERGY_DROP, 3, rover_tree, "nothing here decides; write replay"),
        ([failed(1.0, "camra")], rover_model(), rover_tree, "unknown component 'camra'"),
        ([measured(1.0, energy=math.nan)], rover_model(), rover_tree, "a finite number is needed"),
    ],
)
def test_replay_of_what_makes_no_sense_is_refused(source, model, tree, words):
    with pytest.raises(MissionError, match=words):
        replay(source, model, tree)


@pytest.mark.parametrize(
    ("run", "words"),
    [
        ({"switching_s": {"activate": -1}}, "cannot be used: ValueError: activate takes -1"),
        ({"commands": [1]}, "how it was run cannot be used: TypeError"),
        ({"settings": {"duration_s": "x"}}, "duration_s is 'x'"),
        ({"settings": {"import": "os"}}, "unknown setting 'import'"),
    ],
)
def test_recording_of_an_impossible_run_is_refused(tmp_path, run, words):
    path = tmp_path / "bad.jsonl"
    path.write_text(line_of({"time": 0, "status": [], "run": run}))
    with pytest.raises(MissionError, match=words):
        replay(path, "suave_extended")


def test_failure_shows_what_of_a_recording_could_not_be_used(tmp_path):
    path = tmp_path / "run.jsonl"
    slips = [failed(float(time), "camra") for time in range(1, 4)]
    path.write_text("".join(map(line_of, [measured(0.0, light=0.9, energy=1.0), *slips])))
    decisions = replay(path, rover_model(), rover_tree)
    unused = "could not be used: camra='failure': unknown component 'camra'; did you mean 'camera'?"
    assert failure_of(decisions.assert_actions, "charge").splitlines()[-1] == unused


def test_scripted_system_shapes_what_a_replay_decides():
    managed = ScriptedManaged(FakeClock()).script("dock", hangs=True)
    stream = [measured(0.0, light=1.0, energy=1.0), failed(2.0, "camera"), failed(8.0, "radar")]
    decisions = replay([*stream, sensed(9.0)], rover_model(), rover_tree, managed=managed)
    (change,) = decisions.changes
    assert change.action == "charge"
    message = failure_of(decisions.assert_adapts, at=1.0, to="charge", within=0.1)
    assert "in force at inf s" in message


@pytest.mark.parametrize(
    ("managed", "error", "words"),
    [
        (ScriptedManaged(FakeClock()).script("cammera", takes=1.0), UnknownName, "mean 'camera'"),
        (ScriptedManaged(FakeClock(1.5)), MissionError, "a replay begins at 0 s, not at 1.5 s"),
    ],
)
def test_managed_system_that_does_not_fit_is_refused(managed, error, words):
    with pytest.raises(error, match=words):
        replay(ENERGY_DROP, rover_model(), rover_tree, managed=managed)
