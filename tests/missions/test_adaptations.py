"""What counts as an adaptation, and what is the ordinary course of a mission."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from running import run_mission

from kb import ConfigurationManager, KnowledgeBase, Model
from missions.engine.adaptations import AdaptationLog
from missions.testing import FakeClock, ScriptedManaged


def rover_with_three_actions():
    """A robot that sees by camera or by lidar; only `wait` goes without energy."""
    model = Model("rover")
    energy = model.quality_attribute("energy")
    see = model.function("see", always_improve=True)
    see.design("by_camera", [model.component("camera", kind="lifecycle")], priority=1)
    see.design("by_lidar", [model.component("lidar", kind="lifecycle")], priority=2)
    model.action("search", requires=[see], constraints=[energy >= 0.2])
    model.action("inspect", requires=[see], constraints=[energy >= 0.2])
    model.action("wait", requires=[see])
    return model


RESULTS = {"complete": "completed", "abandon": "abandoned", "fail": "failed"}


class Mission:
    """Plays a script: `hear NEWS` is heard between ticks, all else is done in ticks of 0.1 s."""

    def __init__(self, script=""):
        self.clock = FakeClock()
        self.kb = KnowledgeBase(rover_with_three_actions(), clock=self.clock)
        self.manager = ConfigurationManager(self.kb, ScriptedManaged(self.clock))
        self.log = AdaptationLog(self.kb, lambda entry: None)
        for part in filter(None, script.split("; ")):
            verb, _, rest = part.partition(" ")
            if verb == "hear":
                self.hear(*rest.split(", "))
            else:
                self.tick(*part.split(", "))

    def turn(self):
        self.manager.update()
        self.log.settle()

    def hear(self, *news):
        for text in news:
            self.do(text)
            self.turn()

    def do(self, text):
        subject, _, value = text.partition(" = ")
        verb, _, name = text.partition(" ")
        if value:
            self.kb.measure(subject, float(value))
        elif text.endswith(" fails"):
            self.kb.component_failed(verb)
        elif text.endswith(" recovers"):
            self.kb.component_recovered(verb)
        elif verb == "begin":
            self.kb.request_action(name)
        elif verb in RESULTS:
            self.kb.cancel_action(name, RESULTS[verb], "it is dark" if verb == "fail" else "")
        elif text != "tick":
            self.log.sensed(text)

    def tick(self, *decisions):
        self.clock.advance_to(round(self.clock.now + 0.1, 6))
        self.log.ticking(self.clock.now)
        for text in decisions:
            self.do(text)
        self.turn()

    @property
    def rows(self):
        return [(entry.change, entry.trigger, entry.reason) for entry in self.log.adaptations]


UNFEASIBLE = "{} is unfeasible because energy 0.1 violates >= 0.2 (measured 0.0 s ago)"
STILL = "{} is chosen, though {} is still feasible"


@pytest.mark.parametrize(
    ("script", "rows"),
    [
        ("begin search; complete search, begin inspect", []),
        ("begin search; hear energy = 0.9; complete search, begin inspect", []),
        (
            "begin search; complete search, begin inspect; hear camera fails",
            [("stop camera; start lidar", "camera has failed", None)],
        ),
        (
            "begin search; hear energy = 0.1; abandon search, begin wait",
            [("search -> wait", "energy is 0.1", UNFEASIBLE.format("search"))],
        ),
        (  # the order of beginning and ending in a tick does not matter
            "begin search; hear energy = 0.1; begin wait, abandon search",
            [("search -> wait", "energy is 0.1", UNFEASIBLE.format("search"))],
        ),
        (  # taken up again as soon as it is feasible again
            "begin search; hear energy = 0.1; abandon search, begin wait; tick; "
            "hear energy = 1; complete wait, begin search",
            [
                ("search -> wait", "energy is 0.1", UNFEASIBLE.format("search")),
                ("wait -> search", "energy is 1", "search is feasible again"),
            ],
        ),
        (  # taken up again when something else is over
            "begin search; hear energy = 0.1; abandon search, begin wait; tick; "
            "hear energy = 1; tick; tick; tick; complete wait, begin search",
            [
                ("search -> wait", "energy is 0.1", UNFEASIBLE.format("search")),
                (
                    "wait -> search",
                    "wait is over",
                    "search is feasible again (since 0.3 s: energy is 1)",
                ),
            ],
        ),
        (
            "begin search; hear guest is true; abandon search, begin inspect",
            [("search -> inspect", "guest is true", STILL.format("inspect", "search"))],
        ),
        ("hear guest is true; begin search; tick; abandon search, begin inspect", []),
        (
            "begin search; fail search, begin inspect",
            [("search -> inspect", "search has failed", "it is dark")],
        ),
        ("begin search; hear guest is true; fail search, begin search", []),
        (  # nothing was feasible in between
            "begin search; hear energy = 0.1, camera fails; hear lidar fails; abandon search; "
            "tick; tick; hear lidar recovers; begin wait",
            [
                ("stop camera; start lidar", "camera has failed", None),
                (
                    "search -> wait; stop lidar; start lidar",
                    "lidar is recovered",
                    "wait is feasible again",
                ),
            ],
        ),
        (  # what is stopped before the next action begins belongs to the change
            "begin search; hear energy = 0.1; abandon search; tick; begin wait",
            [
                (
                    "search -> wait; stop camera; start camera",
                    "energy is 0.1",
                    UNFEASIBLE.format("search"),
                )
            ],
        ),
        (  # what is stopped in the ordinary course does not
            "begin search; complete search; begin inspect; hear energy = 0.1; "
            "abandon inspect, begin wait",
            [("inspect -> wait", "energy is 0.1", UNFEASIBLE.format("inspect"))],
        ),
    ],
)
def test_decision_is_an_adaptation_if_news_caused_it(script, rows):
    changes = Mission(script).rows
    assert [row[:2] for row in changes] == [row[:2] for row in rows]
    for (_, _, reason), (_, _, expected) in zip(changes, rows, strict=True):
        assert expected in (None, reason)


def test_adaptation_is_in_force_when_its_plans_have_ended():
    mission = Mission("begin search; hear energy = 0.1; abandon search; tick; begin wait; tick")
    (entry,) = mission.log.adaptations
    assert entry.reaction_s == pytest.approx(0.3)
    assert (entry.news.time, entry.at_s) == (0.1, pytest.approx(0.4))


def test_action_given_up_without_a_next_is_reported_at_the_end():
    mission = Mission("begin search; hear energy = 0.1; abandon search; tick")
    assert mission.rows == []  # another may follow yet
    mission.log.finish()
    change = ("search -> nothing; stop camera", "energy is 0.1", UNFEASIBLE.format("search"))
    assert mission.rows == [change]
    mission.log.finish()
    assert len(mission.rows) == 1


def test_failure_during_a_plan_is_an_adaptation_of_its_own():
    mission = Mission("begin search; hear energy = 0.1; abandon search")
    kb = mission.kb
    mission.log.ticking(1.0)
    kb.request_action("wait")
    kb.select({"see": "by_camera"})
    mission.log.settle()
    kb.component_failed("camera")
    kb.component_active("camera", False)  # an effect of the plan, and no news
    plan = kb.select({"see": "by_lidar"})
    mission.log.settle()
    kb.finish_plan(plan, "completed")
    mission.log.settle()
    task, structural = mission.log.adaptations
    assert (task.kind, task.trigger) == ("task", "energy is 0.1")
    assert (structural.kind, structural.trigger) == ("structural", "camera has failed")
    assert [plan for _, plan in structural.plans] == [plan]


NEWS = st.sampled_from(
    ["energy = 0.1", "energy = 0.9", "camera fails", "camera recovers", "guest is true"]
)
DECISION = st.tuples(st.sampled_from(["search", "inspect", "wait"]), st.sampled_from([*RESULTS]))
SCRIPT = st.lists(st.tuples(st.lists(NEWS, max_size=2), st.none() | DECISION), max_size=12)


@given(SCRIPT)
def test_task_adaptations_follow_the_history_of_actions(script):
    mission = Mission()
    doing = None
    for news, decision in script:
        mission.hear(*news)
        steps = ["tick"]
        if decision and decision[0] != doing and mission.kb.is_feasible(decision[0]):
            steps = [f"{decision[1]} {doing}"] if doing else []
            steps.append(f"begin {decision[0]}")
            doing = decision[0]
        mission.tick(*steps)
    history = mission.kb.history.actions
    follows = {new.start: f"{old.action} -> {new.action}" for old, new in pairwise(history)}
    tasks = {entry.at_s: entry for entry in mission.log.adaptations if entry.kind == "task"}
    for time, entry in tasks.items():
        assert entry.change.split(";")[0] == follows[time]
    for entry in mission.log.adaptations:
        assert all((entry.trigger, entry.reason, entry.change))
        assert entry.news.time <= entry.at_s
    failed = {record.end for record in history if record.result == "failed"}
    assert failed & set(follows) <= set(tasks)


def test_goal_that_changes_in_flight_is_a_task_adaptation():
    _, _, data = run_mission("uav", "pddl", 1, duration_s=65)
    (entry,) = data["adaptations"]
    assert entry["trigger"] == "sample_8_wanted is true and sample_8_found is true"
    assert entry["reason"].startswith("the rest of the plan does not reach (forall")
    steps = "search_for_samples(sample_8, drone), pick_up_and_analyse(sample_8, drone)"
    assert entry["change"] == f"plan anew, with {steps}"
    assert entry["reaction_s"] == pytest.approx(0.2)
