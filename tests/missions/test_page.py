"""The rows of a page, the chain of each adaptation, and the file that holds them."""

import html
import math
import re
import threading
from functools import cache

import pytest
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.trees import BehaviourTree
from running import read_report
from small_rover import rover_model, rover_tree

from kb import ConfigurationManager, KnowledgeBase
from missions.baselines import open_run
from missions.engine.mission import MissionError, Percepts, find_mission
from missions.engine.percepts import sensed
from missions.testing.scripted import FakeClock, ScriptedManaged
from missions.views import recorder as recorder_module
from missions.views.facts import key_of
from missions.views.recorder import Recorder, RunRecorder
from missions.views.report import Rows, report, write_report
from rosa_bt import TreeRunner


@cache
def recorded(mission="suave_extended", task="bt", manager="ours", seed=0, **settings):
    given = {name: str(value) for name, value in settings.items()}
    run = open_run(find_mission(mission), manager=manager, task=task, seed=seed, settings=given)
    recorder = RunRecorder(run, seed, given)
    recorder.end(run.run())
    return recorder.recorder.recorded, run


FACTS = {
    **{"status": "status", "value": "value", "required": "is_required"},
    **{"selected": "is_selected", "active": "is_active", "stale": "is_stale"},
}


def at(run, time):
    """Return what there is to see at a time [s]: the last value of each track and key."""
    return {(track, key): value for when, track, key, value in run.rows if when <= time}


def names(run):
    return {
        value["name"]: key
        for key, value in run.last("element").items()
        if value["kind"] != "constraint"
    }


def views_of(kb):
    """Return all views of a knowledge base, each with the key of its rows."""
    tables = (kb.actions, kb.functions, kb.designs, kb.components, kb.configurations, kb.attributes)
    return [(key_of(view.node), view) for table in tables for view in table.values()]


def test_rows_say_at_each_instant_what_the_knowledge_base_says():
    """The fold of the rows is compared with the knowledge base itself, at every tick of a run."""
    compared = []

    class Compare(RunRecorder):
        def tick(self, run):
            super().tick(run)
            seen = {
                (track, key): value
                for track, key, value in (row[1:] for row in self.recorder.rows.snapshot()[0])
            }
            for key, view in views_of(run.kb):
                for track, fact in FACTS.items():
                    known = getattr(view, fact, None)
                    assert (seen.get((track, key)) or None) == (known or None)
                compared.append(key)
            for number, one in enumerate(run.adaptations, start=1):
                assert ("adaptation", number) in seen or one.reaction_s is None

    run = open_run(find_mission("suave_extended"), seed=3, settings={"duration": "200"})
    Compare(run, 3, {}, what_if=False)
    run.run()
    assert len(compared) > 30_000


def test_tree_is_shown_as_it_was_after_each_tick():
    run, _ = recorded()
    before = at(run, 150.9)
    after = at(run, 151.05)
    nodes = {node[3]: node[0] for node in before["tree", 0]["nodes"]}
    assert len(nodes) == len(before["tree", 0]["nodes"]) == 14
    assert before["node", nodes["inspect"]][0] == "R"
    assert after["node", nodes["inspect"]][0] == ""
    assert after["node", nodes["inspect feasible?"]][0] == "F"
    assert "unfeasible" in after["node", nodes["inspect feasible?"]][1]
    assert after["node", nodes["recharge"]][0] == "R"
    about = {node[3]: node[5] for node in after["tree", 0]["nodes"]}
    assert about["recharge"] == ["action recharge"]


def test_adaptations_are_those_of_the_run_each_with_its_chain():
    run, made = recorded()
    shown = list(run.last("adaptation").values())
    assert [(one["t"], one["cause"], one["changed"]) for one in shown] == [
        (adaptation.at_s, adaptation.trigger, adaptation.change) for adaptation in made.adaptations
    ]
    battery = next(one for one in shown if one["kind"] == "task")
    found = names(run)
    assert [(link["what"], link["words"]) for link in battery["chain"]] == [
        ("news", "battery_level is just below 0.25"),
        ("status", "search_pipeline unfeasible, inspect_pipeline unfeasible"),
        ("end", "inspect_pipeline stopped"),
        ("request", "recharge requested"),
        ("plan", "stop follow_pipeline; start recharge"),
        ("force", "in force 0.12 s after the news"),
    ]
    assert battery["chain"][0]["elements"][0] == found["battery_level"]
    known = run.last("element")
    for link in battery["chain"][:-1]:
        assert known.keys() >= set(link["elements"]) > set()
    assert all(one["chain"] == sorted(one["chain"], key=lambda link: link["t"]) for one in shown)


def test_chain_of_a_planned_mission_says_that_it_was_planned_anew():
    run, _ = recorded(task="pddl")
    words = [link["words"] for one in run.last("adaptation").values() for link in one["chain"]]
    assert "replanned: recharge, then inspect_pipeline" in words
    assert run.last("taskplan")


def test_task_plans_of_long_ago_are_forgotten_and_nothing_is_shown_otherwise(monkeypatch):
    shown = []
    for most in (recorder_module.PLANS, 1):
        monkeypatch.setattr(recorder_module, "PLANS", most)
        run = open_run(find_mission("suave_extended"), task="pddl", seed=0, settings={})
        recorder = Recorder(run.kb, run.tree, what_if=False)
        run.run()
        recorder.close()
        shown.append(recorder.recorded)
    planned = max(shown[0].last("taskplan"))
    assert len(recorder._task_plans) < planned
    assert len(recorder._own.adaptations) < len(shown[0].last("adaptation"))
    assert any(
        "replanned" in link["words"]
        for one in shown[0].last("adaptation").values()
        for link in one["chain"]
    )
    assert shown[1].rows == shown[0].rows


def test_what_if_cases_are_what_the_knowledge_base_would_have_answered():
    run, made = recorded()
    found = names(run)
    first = next(cases for time, _, cases in run.track("whatif") if time > 12)
    cases = [one for one in first if one.get("attribute") == found["water_visibility"]]
    assert [(case["low"], case["high"], case["now"]) for case in cases] == [
        *((None, 1.25, False), (1.25, 2.25, False), (2.25, 3.25, True), (3.25, None, False))
    ]
    chosen = [case["chosen"][str(found["spiral_search"])] for case in cases]
    assert chosen == [
        None,
        *(found[name] for name in ("low_altitude", "medium_altitude", "high_altitude")),
    ]
    low = made.kb.situation(battery_level=0.2)
    last = run.last("whatif")[0]
    cases = [one for one in last if one.get("attribute") == found["battery_level"]]
    assert len(cases) == 2
    broken = made.kb.situation(failed=["c_thruster_2"])
    case = next(one for one in last if one.get("component") == found["c_thruster_2"])
    assert case["verb"] == "failed"
    assert case["feasible"] == [found[name] for name in broken.selectable_actions()]
    assert cases[0]["feasible"] == [found[name] for name in low.selectable_actions()]


@pytest.mark.parametrize("mission", ["agv", "uav"])
def test_page_of_every_mission_is_small_and_ends_as_the_run_did(mission):
    run, _ = recorded(mission)
    page = report(run)
    assert len(page) < 1_500_000
    assert run.last("now") == {0: "end"}
    assert run.last("adaptation")
    assert run.last("pose")
    assert run.last("scene")
    times = [row[0] for row in run.rows]
    assert times == sorted(times)


def test_manager_without_a_knowledge_base_has_a_page_too():
    run, _ = recorded("suave", manager="none", duration=60)
    assert run.last("status")
    assert run.last("action")
    assert not run.last("adaptation")


def test_same_run_gives_the_same_page_to_the_byte():
    first, _ = recorded(duration=40)
    recorded.cache_clear()
    again, _ = recorded(duration=40)
    assert report(first) == report(again)


def test_recording_a_run_changes_nothing_of_it():
    bare = open_run(find_mission("suave_extended"), seed=1, settings={"duration": "200"})
    bare.run()
    _, made = recorded(seed=1, duration=200)
    assert str(bare.adaptations) == str(made.adaptations)
    assert [one.to_json() for one in bare.kb.log] == [one.to_json() for one in made.kb.log]


class Rover:
    """A robot of a user's own: a knowledge base, a manager and a tree, in its own program."""

    def __init__(self):
        self.clock = FakeClock()
        self.kb = KnowledgeBase(rover_model(), clock=lambda: self.clock.now)
        self.percepts = Percepts()
        self.manager = ConfigurationManager(self.kb, ScriptedManaged(self.clock))
        self.runner = TreeRunner(rover_tree(self.kb, self.percepts), clock=lambda: self.clock.now)

    def work(self, until):
        while self.clock.now < until - 1e-9:
            self.clock.advance(0.1)
            self.manager.update()
            self.runner.update()


def test_robot_of_ones_own_is_recorded_in_three_lines(tmp_path):
    rover = Rover()
    recorder = Recorder(rover.kb, rover.runner, pose=lambda: (rover.clock.now, 0.0, 0.0))
    rover.kb.measure("light", 0.9)
    rover.kb.measure("energy", 0.9)
    rover.work(2.0)
    rover.kb.measure("light", 0.2)
    rover.work(4.0)
    rover.kb.measure("energy", 0.1)
    rover.work(6.0)
    recorder.report(tmp_path / "run.html")
    run = read_report(tmp_path / "run.html")
    shown = list(run.last("adaptation").values())
    assert [one["kind"] for one in shown] == ["parameter", "task"]
    assert [link["what"] for link in shown[1]["chain"]] == [
        "news",
        "status",
        "end",
        "request",
        "plan",
        "force",
    ]
    assert shown[1]["chain"][0]["words"] == "energy is 0.1"
    assert run.last("pose")[0][0] >= 5.0
    recorder.close()
    rover.percepts.receive(sensed(7.0, charged=True))
    count = recorder.rows.next
    rover.work(8.0)
    assert recorder.rows.next == count


def test_model_that_is_amended_is_followed():
    rover = Rover()
    recorder = Recorder(rover.kb, rover.runner)
    rover.kb.measure("light", 0.4)
    rover.kb.model.components["camera"].configuration("dusk", {"exposure_s": 0.1}, priority=0)
    rover.kb.measure("energy", 0.9)
    run = recorder.recorded
    assert run.last("element")[names(run)["dusk"]]["parameters"] == {"exposure_s": 0.1}
    assert run.last("status")[names(run)["dusk"]] == "feasible"


def test_tree_that_changes_is_followed_and_what_is_gone_is_gone():
    rover = Rover()
    recorder = Recorder(rover.kb, rover.runner)
    rover.work(0.5)
    first = recorder.recorded.last("tree")[0]["nodes"]
    root = rover.runner.tree.root
    removed = root.children[-1]
    uids = {node[3]: node[0] for node in first}
    root.remove_child(removed)
    rover.work(1.0)
    after = recorder.recorded
    assert len(after.last("tree")[0]["nodes"]) < len(first)
    assert after.last("node")[uids[removed.name]] is None


def test_text_that_would_end_the_page_is_shown_and_ends_nothing(tmp_path):
    evil = "</script><script>alert(1)</script><!-- \u2028 & ' \""
    rover = Rover()
    recorder = Recorder(rover.kb, rover.runner, title=evil)
    rover.kb.component_failed("camera", evil)
    write_report(tmp_path / "run.html", recorder.recorded)
    page = (tmp_path / "run.html").read_text()
    assert evil not in page
    assert html.escape(evil) in page
    run = read_report(tmp_path / "run.html")
    assert run.header["title"] == evil
    assert any(evil in event["words"] for event in run.last("event").values())


@pytest.mark.parametrize(
    ("odd", "shown"),
    [({"a set"}, "{'a set'}"), (math.nan, None), ("\ud800", "?"), (3.5, 3.5), (None, None)],
)
def test_feedback_that_is_not_text_does_not_cost_the_whole_report(tmp_path, odd, shown):
    class Odd(Behaviour):
        def update(self):
            self.feedback_message = odd
            return Status.RUNNING

    tree = BehaviourTree(Odd("odd"))
    recorder = Recorder(KnowledgeBase(rover_model(), clock=lambda: 0.0), tree)
    tree.tick()
    recorder.report(str(tmp_path / "run.html"))
    assert list(read_report(tmp_path / "run.html").last("node").values()) == [["R", shown]]


def test_page_asks_nothing_of_any_network():
    page = report(recorded(duration=40)[0])
    assert re.search(r"default-src 'none'", page)
    for kind in ("src=", "@import", "url(http", "fetch("):
        assert kind not in page.split('id="rosa-data"')[0], kind


def test_rows_beyond_what_is_kept_are_let_go_and_the_present_stays():
    rows = Rows(keep=100)
    rows.put(0.0, "status", 1, "solved")
    for number in range(1000):
        rows.put(number, "value", 2, float(number))
        rows.put(number, "event", number, {"words": str(number)})
    assert len(rows.since(0)[1]) <= 125
    assert rows.since(0)[0] == rows.first == rows.next - len(rows.since(0)[1])
    latest, following = rows.snapshot()
    assert following == rows.next
    assert (0.0, "status", 1, "solved") in latest
    assert len(latest) <= 125


def test_notebook_shows_the_page_in_a_frame():
    rover = Rover()
    shown = Recorder(rover.kb, rover.runner)._repr_html_()
    assert shown.startswith("<iframe srcdoc=")
    assert "<script" not in shown


def test_behaviour_is_no_tree_that_ticks_and_an_open_action_is_there_from_the_start():
    rover = Rover()
    with pytest.raises(MissionError, match="give the TreeRunner or py_trees tree that ticks it"):
        Recorder(rover.kb, rover.runner.tree.root)
    rover.kb.measure("light", 0.9)
    rover.work(1.0)
    late = Recorder(rover.kb, rover.runner).recorded
    (action,) = late.last("action").values()
    assert (action["action"], action["end"]) == (names(late)["explore"], None)


def test_robot_goes_on_when_what_its_recorder_asks_fails(caplog):
    rover = Rover()
    recorder = Recorder(rover.kb, rover.runner, pose=lambda: 1 / 0)
    rover.kb.measure("light", 0.9)
    rover.work(1.0)
    assert [action.action for action in rover.kb.required_actions] == ["explore"]
    assert "a tick is not shown in full" in caplog.text
    assert recorder.recorded.last("node")


def test_facts_told_by_other_threads_while_the_robot_ticks_are_all_shown(caplog):
    rover = Rover()
    recorder = Recorder(rover.kb, rover.runner, what_if=False)
    count = 400
    threads = []

    def tell(name, low, high):
        for number in range(count):
            rover.kb.measure(name, low if number % 2 else high)

    for name in ("light", "energy"):
        threads += [threading.Thread(target=tell, args=(name, 0.1, 0.9))]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        rover.work(rover.clock.now + 0.5)
    rover.work(rover.clock.now + 1.0)
    run = recorder.recorded
    found = {}
    for _, key, _value in run.track("value"):
        found[key] = found.get(key, 0) + 1
    assert found == {names(run)[name]: count for name in ("light", "energy")}
    for key, view in views_of(rover.kb):
        assert run.last("status").get(key) == getattr(view, "status", None)
    assert caplog.text == ""
