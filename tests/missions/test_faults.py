"""Injected faults and breakpoints: of any mission, in its recording, and replayed."""

import json

import pytest
from running import called

from kb import UnknownName
from missions.baselines import open_run
from missions.engine.faults import Fault, read_fault
from missions.engine.mission import MissionError, find_mission
from missions.experiments.campaign import check_campaign, from_data
from missions.views.breakpoints import Breakpoint

BATTERY = ("--measure", "battery_level=0.1@30", "--set", "duration=40", "--no-progress")


@pytest.mark.parametrize(
    "text", ["fail boom@60", "recover boom@0.5", "measure light=-0.1@30", "release light@3"]
)
def test_fault_text_is_read_back(text):
    assert str(read_fault(text)) == text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("fail boom", "--fail takes COMPONENT@SECONDS, not 'boom'"),
        ("fail boom@-1", "--fail takes"),
        ("fail boom@inf", "--fail takes"),
        ("fail a=1@3", "--fail takes"),
        ("measure light@30", "--measure takes ATTRIBUTE=VALUE@SECONDS, not 'light@30'"),
        ("measure light=low@30", "--measure takes"),
        ("break boom@3", "a fault begins with fail, recover, measure, release"),
    ],
)
def test_fault_malformed_is_refused(text, words):
    with pytest.raises(MissionError, match=words):
        read_fault(text)


@pytest.mark.parametrize(
    ("mission", "component", "attribute"),
    [
        ("suave_extended", "c_thruster_2", "battery_level"),
        ("agv", "kinect", "energy"),
        ("uav", "gripper", "battery_level"),
    ],
)
def test_fault_is_received_from_its_time_to_its_release(mission, component, attribute):
    run = open_run(find_mission(mission), settings={"duration": "12"})
    release = Fault("release", attribute, 8.0)
    run.faults.add(Fault("fail", component, 3.0), Fault("measure", attribute, 5.0, 0.97), release)
    run.run()
    times = [e.time for e in run.kb.log if (e.verb, e.subject) == ("component_failed", component)]
    assert times[0] == pytest.approx(3.0, abs=0.2)
    history = run.kb.attributes[attribute].history
    assert {value for time, value in history if 5.2 < time < 7.9} == {0.97}
    assert 0.97 not in {value for time, value in history if not 4.9 < time < 8.1}
    assert f"{component} fails (injected)" in [words for _, words in run.disturbances()]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("fail thruster@1", "unknown component 'thruster'"),
        ("measure battery=1@1", "unknown attribute 'battery'"),
        ("fail c_thruster_1@900", "would never happen: the mission ends at 300 s"),
    ],
)
def test_fault_that_cannot_happen_is_refused(capsys, monkeypatch, text, words):
    verb, _, rest = text.partition(" ")
    code, _, errors = called(capsys, monkeypatch, "run", "suave_extended", f"--{verb}", rest)
    assert code == 2
    assert words in errors


@pytest.mark.parametrize("suffix", ["jsonl", "mcap"])
def test_recorded_faults_are_replayed(capsys, monkeypatch, tmp_path, suffix):
    recording = tmp_path / f"run.{suffix}"
    data = tmp_path / "run.json"
    faults = ("--fail", "c_thruster_2@20", "--recover", "c_thruster_2@26", *BATTERY)
    files = ("--record", recording, "--json", data)
    called(capsys, monkeypatch, "run", "suave_extended", *faults, *files)
    code, out, _ = called(capsys, monkeypatch, "replay", recording)
    assert code == 0
    assert "c_thruster_2 has failed" in out
    begun = [action["name"] for action in json.loads(data.read_text())["actions"]]
    assert begun == ["search_pipeline", "recharge"]
    assert [line.split()[3] for line in out.splitlines() if line.endswith("is requested")] == begun
    if suffix == "jsonl":
        stop = ("--break", "battery_level < 0.2")
        _, out, _ = called(capsys, monkeypatch, "replay", recording, *stop)
        assert "stopped at breakpoint 'battery_level < 0.2' after 30.0 s" in out
        assert "decided as recorded" not in out


def test_faults_of_a_campaign_are_a_column():
    sweep = {"faults": ["", "fail c_thruster_2@3; measure battery_level=0.1@5"]}
    data = {"name": "f", "missions": ["suave_extended"], "runs": 1, "sweep": sweep}
    _, faulty = from_data({**data, "settings": {"duration": 8}}, "f.toml").planned()
    assert faulty.command.endswith("--fail c_thruster_2@3 --measure battery_level=0.1@5")
    run = faulty.open()
    run.run()
    assert [action.action for action in run.actions] == ["search_pipeline", "recharge"]
    broken = {**data, "settings": {"faults": "break boom@3"}, "sweep": {}}
    with pytest.raises(MissionError, match="unknown fault 'break boom@3'"):
        check_campaign(from_data(broken, "f"))


def test_run_ends_at_a_breakpoint(capsys, monkeypatch):
    stop = (*BATTERY, "--break", "inspect_pipeline unfeasible")
    code, out, _ = called(capsys, monkeypatch, "run", "suave_extended", *stop)
    assert code == 1
    assert "stopped at breakpoint 'inspect_pipeline unfeasible' after 30.0 s" in out
    assert "because battery_level 0.1 violates >= 0.25" in out


@pytest.mark.parametrize(
    ("text", "rows", "met"),
    [
        ("a unfeasible", [("status", "feasible"), ("status", "unfeasible")], [1]),
        ("a < 0.25", [("value", 0.2), ("value", 0.1), ("value", 0.3), ("value", 0.2)], [0, 3]),
        ("'a' success", [("node", ["R", ""]), ("node", ["S", ""])], [1]),
        ("a implicit configuration error", [("status", "configuration error")], []),
    ],
)
def test_breakpoint_is_met_when_it_begins_to_hold(text, rows, met):
    breakpoint = Breakpoint(text)
    hits = [breakpoint.is_met(track, 0, "a", value) for track, value in rows]
    assert [number for number, is_hit in enumerate(hits) if is_hit] == met


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("boom", "is no breakpoint; write ELEMENT STATUS"),
        ("battery_level < low", "'low' in breakpoint 'battery_level < low' is no number"),
        ("inspect_pipelin unfeasible", "behaviour 'inspect_pipelin'; did you mean 'inspect_pipel"),
        ("inspect_pipeline < 3", "unknown attribute 'inspect_pipeline'; known"),
    ],
)
def test_breakpoint_without_meaning_is_refused(text, words):
    with pytest.raises((MissionError, UnknownName), match=words):
        Breakpoint(text).check(find_mission("suave_extended").model(), [])
