"""Injected faults and breakpoints: of any mission, in its recording, and replayed."""

import json

import pytest
from running import called

from missions.baselines import open_run
from missions.engine.faults import Fault, inject, read_fault
from missions.engine.mission import MissionError, find_mission
from missions.experiments.campaign import check_campaign, from_data
from missions.views.breakpoints import Breakpoint

FAULTS = {
    "suave": ("c_thruster_2", "water_visibility"),
    "suave_extended": ("c_thruster_2", "battery_level"),
    "agv": ("kinect", "energy"),
    "uav": ("gripper", "battery_level"),
}


@pytest.mark.parametrize("text", ["fail boom@60", "recover boom@0.5", "measure light=-0.1@30"])
def test_fault_text_is_read_back(text):
    assert str(read_fault(text)) == text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("fail boom", "--fail takes COMPONENT@S, not 'boom'"),
        ("fail boom@-1", "--fail takes"),
        ("fail boom@inf", "--fail takes"),
        ("fail a=1@3", "--fail takes"),
        ("measure light@30", "--measure takes ATTRIBUTE=VALUE@S, not 'light@30'"),
        ("measure light=low@30", "--measure takes"),
        ("break boom@3", "a fault begins with fail, recover, measure, release"),
    ],
)
def test_fault_malformed_is_refused(text, words):
    with pytest.raises(MissionError, match=words):
        read_fault(text)


@pytest.mark.parametrize("mission", FAULTS)
def test_fault_is_heard_at_its_time_in_any_mission(mission):
    run = open_run(find_mission(mission), seed=0, settings={"duration": "20"})
    component = FAULTS[mission][0] if FAULTS[mission][0] in run.model.components else None
    component = component or next(iter(run.model.components))
    attribute = FAULTS[mission][1]
    inject(run, Fault("fail", component, 3.0), Fault("measure", attribute, 5.0, 0.5))
    run.run()
    heard = {event.subject: event for event in run.kb.log if event.verb == "component_failed"}
    assert heard[component].time == pytest.approx(3.0, abs=0.2)
    history = run.kb.attributes[attribute].history
    assert {value for time, value in history if time > 5.2} <= {0.5}
    words = [text for _, text in run.disturbances()]
    assert f"{component} fails (injected)" in words


def test_release_ends_the_injected_measurement():
    run = open_run(find_mission("suave_extended"), settings={"duration": "20"})
    inject(
        run, read_fault("measure water_visibility=9@3"), read_fault("release water_visibility@6")
    )
    run.run()
    values = {round(time): value for time, value in run.kb.attributes["water_visibility"].history}
    assert values[5] == 9.0
    assert values[8] < 9.0


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("fail thruster@1", "unknown component 'thruster'"),
        ("measure battery=1@1", "unknown attribute 'battery'"),
        ("fail c_thruster_1@900", "would never happen: the mission ends at 300 s"),
    ],
)
def test_fault_that_cannot_happen_is_refused(capsys, monkeypatch, fault, words):
    verb, _, rest = fault.partition(" ")
    arguments = ("run", "suave_extended", f"--{verb}", rest)
    code, _, errors = called(capsys, monkeypatch, *arguments)
    assert code == 2
    assert words in errors


@pytest.mark.parametrize("suffix", ["jsonl", "mcap"])
def test_recorded_faults_are_replayed(capsys, monkeypatch, tmp_path, suffix):
    recording, data = tmp_path / f"run.{suffix}", tmp_path / "run.json"
    faults = ("--fail", "c_thruster_2@20", "--recover", "c_thruster_2@26")
    faults += ("--measure", "battery_level=0.1@30")
    files = ("--record", recording, "--json", data)
    asked = ("--set", "duration=40", "--no-progress")
    called(capsys, monkeypatch, "run", "suave_extended", *faults, *files, *asked)
    code, out, _ = called(capsys, monkeypatch, "replay", recording, "--heard")
    assert code == 0
    assert "c_thruster_2 has failed" in out
    result = json.loads(data.read_text())
    begun = [action["name"] for action in result["actions"]]
    assert begun == ["search_pipeline", "recharge"]
    assert [line.split()[3] for line in out.splitlines() if line.endswith("is requested")] == begun


def test_faults_of_a_campaign_are_a_column():
    sweep = {"faults": ["", "fail c_thruster_2@3; measure battery_level=0.1@5"]}
    data = {"name": "f", "missions": ["suave_extended"], "runs": 1, "sweep": sweep}
    campaign = from_data({**data, "settings": {"duration": 8}}, "f.toml")
    check_campaign(campaign)
    bare, faulty = campaign.planned()
    assert faulty.command.endswith("--fail c_thruster_2@3 --measure battery_level=0.1@5")
    begun = []
    for planned in (bare, faulty):
        run = planned.open()
        run.run()
        begun.append([action.action for action in run.actions])
    assert begun == [["search_pipeline"], ["search_pipeline", "recharge"]]
    with pytest.raises(MissionError, match="unknown fault 'break boom@3'"):
        check_campaign(
            from_data({**data, "settings": {"faults": "break boom@3"}, "sweep": {}}, "f")
        )


def test_run_ends_at_a_breakpoint(capsys, monkeypatch):
    faults = ("--measure", "battery_level=0.1@30", "--break", "inspect_pipeline unfeasible")
    code, out, _ = called(capsys, monkeypatch, "run", "suave_extended", *faults, "--no-progress")
    assert code == 1
    assert "stopped at breakpoint 'inspect_pipeline unfeasible' after 30.0 s" in out
    assert "because battery_level 0.1 violates >= 0.25" in out


def test_replay_stops_at_a_breakpoint(capsys, monkeypatch, tmp_path):
    recording = tmp_path / "run.jsonl"
    fault = ("--measure", "battery_level=0.1@30", "--set", "duration=40", "--no-progress")
    called(capsys, monkeypatch, "run", "suave_extended", *fault, "--record", recording)
    code, out, _ = called(
        capsys, monkeypatch, "replay", recording, "--break", "battery_level < 0.2"
    )
    assert code == 0
    assert "stopped at breakpoint 'battery_level < 0.2' after 30.0 s" in out
    assert "decided as recorded" not in out
    assert all(float(line.split()[0]) <= 30.0 for line in out.splitlines() if " s  " in line[:16])


@pytest.mark.parametrize(
    ("text", "rows", "met"),
    [
        ("a unfeasible", [("status", "feasible"), ("status", "unfeasible")], [1]),
        ("a has failed", [("status", "feasible"), ("status", "failure")], [1]),
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
        ("inspect_pipelin unfeasible", "did you mean inspect_pipeline"),
        ("inspect_pipeline < 3", "nothing is named 'inspect_pipeline'"),
    ],
)
def test_breakpoint_without_meaning_is_refused(text, words):
    run = open_run(find_mission("suave_extended"))
    with pytest.raises(MissionError, match=words):
        Breakpoint(text).check(run.model, [])
