"""What counts as an adaptation, and what is the ordinary course of a mission."""

from itertools import pairwise
from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st
from running import run_mission

from kb import ConfigurationManager, KnowledgeBase, Model
from kb.planning import PriorityPlanner
from missions.engine.adaptations import AdaptationLog


class Robot:
    def activate(self, component):
        pass

    deactivate = activate

    def set_parameters(self, component, parameters):
        pass


def robot():
    """A robot that sees by camera or by lidar, for two actions that need no more than that, and one that needs none."""
    model = Model("rover")
    energy = model.quality_attribute("energy")
    see = model.function("see", always_improve=True)
    see.design("by_camera", [model.component("camera", kind="lifecycle")], priority=1)
    see.design("by_lidar", [model.component("lidar", kind="lifecycle")], priority=2)
    model.action("search", requires=[see], constraints=[energy >= 0.2])
    model.action("inspect", requires=[see], constraints=[energy >= 0.2])
    model.action("wait", requires=[see])
    return Mission(model)


@pytest.fixture
def mission():
    return robot()


class Mission:
    def __init__(self, model):
        self.now = 0.0
        self.kb = KnowledgeBase(model, clock=lambda: self.now)
        self.manager = ConfigurationManager(self.kb, Robot())
        self.log = AdaptationLog(self.kb)

    def turn(self):
        self.manager.update()
        self.log.settle()

    def hear(self, tell):
        self.log.news(self.now)
        tell()
        self.log.news(None)
        self.turn()

    def tick(self, *decisions):
        """Let a tenth of a second pass, and the task layer decide."""
        self.now = round(self.now + 0.1, 6)
        self.log.ticking(self.now)
        for decide in decisions:
            decide()
        self.turn()

    def begin(self, action):
        return lambda: self.kb.request_action(action)

    def end(self, action, result="abandoned", reason=""):
        return lambda: self.kb.cancel_action(action, result, reason)

    def told(self):
        return [(one.change, one.trigger, one.reason) for one in self.log.adaptations]

    def kinds(self):
        return [(one.kind, one.trigger) for one in self.log.adaptations]


def test_first_action_and_the_next_one_are_the_ordinary_course(mission):
    mission.kb.request_action("search")
    mission.turn()
    mission.kb.cancel_action("search", "completed")
    mission.kb.request_action("inspect")
    mission.turn()
    assert mission.log.adaptations == []


def test_failure_after_a_change_of_action_without_a_plan_is_a_structural_adaptation(mission):
    mission.kb.request_action("search")
    mission.turn()
    mission.kb.cancel_action("search", "completed")
    mission.kb.request_action("inspect")  # needs what search needed: nothing to reconfigure
    mission.turn()
    mission.hear(lambda: mission.kb.component_failed("camera"))
    assert mission.kinds() == [("structural", "camera has failed")]
    assert mission.log.adaptations[0].change == "stop camera; start lidar"


def test_news_that_calls_for_nothing_is_no_trigger_of_what_comes_later(mission):
    mission.kb.request_action("search")
    mission.turn()
    mission.hear(
        lambda: mission.kb.measure("energy", 0.9)
    )  # a constraint is evaluated: a status changes, no plan
    mission.hear(lambda: mission.kb.component_failed("camera"))
    assert mission.kinds() == [("structural", "camera has failed")]


def test_action_given_up_for_another_and_taken_up_again_are_task_adaptations_even_without_a_plan(
    mission,
):
    mission.kb.request_action("inspect")
    mission.turn()
    mission.now = 5.0
    mission.hear(lambda: mission.kb.measure("energy", 0.1))
    mission.now = 5.1
    mission.log.ticking(5.1)
    mission.kb.cancel_action("inspect", "abandoned")
    mission.kb.request_action("wait")
    mission.turn()
    mission.now = 9.0
    mission.hear(lambda: mission.kb.measure("energy", 1.0))
    mission.now = 9.1
    mission.log.ticking(9.1)
    mission.kb.cancel_action("wait", "completed")
    mission.kb.request_action("inspect")
    mission.turn()
    assert mission.kinds() == [("task", "energy is 0.1"), ("task", "energy is 1")]
    assert [one.change for one in mission.log.adaptations] == ["inspect -> wait", "wait -> inspect"]
    assert [one.reaction_s for one in mission.log.adaptations] == pytest.approx([0.1, 0.1])


def test_return_is_not_put_down_to_news_of_long_ago(mission):
    mission.kb.measure("energy", 0.1)
    mission.kb.request_action("wait")
    mission.turn()
    mission.hear(lambda: mission.kb.measure("energy", 0.9))
    mission.kb.request_action("inspect")
    mission.hear(lambda: mission.kb.measure("energy", 0.1))
    mission.kb.cancel_action("inspect", "abandoned")
    mission.hear(lambda: mission.kb.measure("energy", 0.9))
    for tick in (1.0, 2.0, 3.0):
        mission.now = tick
        mission.log.ticking(tick)
    mission.kb.cancel_action("wait", "completed")
    mission.kb.request_action("inspect")
    mission.turn()
    last = mission.log.adaptations[-1]
    assert (last.kind, last.trigger, last.reason) == (
        "task",
        "wait is over",
        "inspect is feasible again (since 0.0 s: energy is 0.9)",
    )
    assert last.reaction_s == 0.0


def test_action_left_while_it_is_feasible_is_put_down_to_the_news_before_the_tick(mission):
    mission.tick(mission.begin("search"))
    mission.hear(lambda: mission.kb.measure("energy", 0.5))
    mission.tick(mission.end("search"), mission.begin("inspect"))
    assert mission.told() == [
        ("search -> inspect", "energy is 0.5", "inspect is chosen, though search is still feasible")
    ]
    assert mission.log.adaptations[0].reaction_s == pytest.approx(0.1)


def test_what_the_task_layer_alone_is_told_leads_to_another_action_too(mission):
    mission.hear(lambda: mission.kb.measure("energy", 0.7))
    mission.tick(mission.begin("search"))
    mission.hear(
        lambda: mission.kb.measure("energy", 0.6)
    )  # no status changes by that, so it is the lesser news
    mission.hear(lambda: mission.log.sensed("guest is true"))
    mission.tick(mission.begin("inspect"), mission.end("search"))
    assert mission.told() == [
        ("search -> inspect", "guest is true", "inspect is chosen, though search is still feasible")
    ]


def test_action_left_without_any_news_is_the_ordinary_course(mission):
    mission.hear(lambda: mission.kb.measure("energy", 0.5))
    mission.tick(mission.begin("search"))
    mission.tick()
    mission.tick(mission.end("search"), mission.begin("inspect"))
    assert mission.log.adaptations == []


def test_action_left_once_as_unfeasible_is_not_left_for_the_same_reason_again(mission):
    mission.tick(mission.begin("search"))
    mission.hear(lambda: mission.kb.measure("energy", 0.1))
    mission.tick(mission.end("search"), mission.begin("wait"))
    mission.tick(lambda: mission.kb.measure("energy", 0.9))  # the task layer's own word
    mission.tick(mission.end("wait", "completed"), mission.begin("search"))
    mission.hear(lambda: mission.log.sensed("guest is true"))
    mission.tick(mission.end("search"), mission.begin("inspect"))
    assert [one.trigger for one in mission.log.adaptations] == ["energy is 0.1", "guest is true"]
    assert mission.log.adaptations[1].reason == "inspect is chosen, though search is still feasible"


def test_what_a_behaviour_says_as_it_ends_does_not_hide_why_it_was_left(mission):
    mission.tick(mission.begin("search"))
    mission.hear(lambda: mission.kb.measure("energy", 0.1))
    mission.tick(
        lambda: mission.kb.measure("energy", 0.9), mission.end("search"), mission.begin("wait")
    )
    assert mission.told()[0][1:] == ("energy is 0.1", mission.log.adaptations[0].reason)
    assert "energy 0.1 violates >= 0.2" in mission.log.adaptations[0].reason


def test_action_that_fails_for_another_is_a_task_adaptation_with_its_own_reason(mission):
    mission.tick(mission.begin("search"))
    mission.tick(mission.end("search", "failed", "the sea is empty"), mission.begin("inspect"))
    assert mission.told() == [("search -> inspect", "search has failed", "the sea is empty")]


def test_same_action_again_is_no_task_adaptation(mission):
    mission.tick(mission.begin("search"))
    mission.hear(lambda: mission.kb.measure("energy", 0.5))
    mission.tick(mission.end("search", "failed"), mission.begin("search"))
    mission.hear(lambda: mission.kb.measure("energy", 0.4))
    mission.tick(mission.end("search"))
    mission.tick(mission.begin("search"))
    assert mission.log.adaptations == []


def test_nothing_to_be_done_until_news_makes_it_feasible_is_put_down_to_that_news(mission):
    mission.tick(mission.begin("search"))
    mission.hear(lambda: (mission.kb.measure("energy", 0.1), mission.kb.component_failed("camera")))
    mission.hear(lambda: mission.kb.component_failed("lidar"))
    mission.tick(mission.end("search"))
    for _ in range(50):
        mission.tick()
    mission.hear(lambda: mission.kb.component_recovered("lidar"))
    mission.tick(mission.begin("wait"))
    task = [one for one in mission.log.adaptations if one.kind == "task"]
    assert [(one.trigger, one.reason) for one in task] == [
        ("lidar is recovered", "wait is feasible again")
    ]
    assert task[0].reaction_s == pytest.approx(0.1)


def test_what_is_stopped_before_the_next_action_begins_belongs_to_the_change(mission):
    mission.tick(mission.begin("search"))
    mission.hear(lambda: mission.kb.measure("energy", 0.1))
    mission.tick(mission.end("search"))
    mission.tick()
    mission.tick(mission.begin("wait"))
    mission.tick(mission.end("wait", "completed"))
    mission.tick(mission.begin("wait"))
    assert [one.change for one in mission.log.adaptations] == [
        "search -> wait; stop camera; start camera"
    ]
    assert mission.log.adaptations[0].reaction_s == pytest.approx(0.3)


def test_what_is_stopped_in_the_ordinary_course_is_told_of_no_later_change(mission):
    mission.tick(mission.begin("search"))
    mission.tick(mission.end("search", "completed"))
    mission.tick(mission.begin("inspect"))
    mission.hear(lambda: mission.kb.measure("energy", 0.1))
    mission.tick(mission.end("inspect"), mission.begin("wait"))
    assert [one.change for one in mission.log.adaptations] == ["inspect -> wait"]


def test_what_fails_while_the_robot_is_configured_for_a_change_is_an_adaptation_of_its_own(mission):
    kb, log = mission.kb, mission.log
    mission.tick(mission.begin("search"))
    mission.hear(lambda: kb.measure("energy", 0.1))
    mission.tick(mission.end("search"))  # the camera is stopped, for nothing needs it
    log.ticking(1.0)
    kb.request_action("wait")
    kb.select({"see": "by_camera"})
    log.settle()  # it is being started again
    log.news(1.1)
    kb.component_failed("camera")
    log.news(None)
    answer = kb.select({"see": "by_lidar"})
    log.settle()
    kb.finish_plan(answer, "completed")
    log.settle()
    assert mission.kinds() == [("task", "energy is 0.1"), ("structural", "camera has failed")]
    change, structural = log.adaptations
    assert [plan for _, plan in structural.plans] == [answer]
    assert answer not in [plan for _, plan in change.plans]


def test_what_fails_while_a_plan_is_carried_out_is_an_adaptation_when_the_manager_answers_it(
    mission,
):
    kb, log = mission.kb, mission.log
    mission.tick(mission.begin("search"))
    log.news(1.0)
    kb.component_failed("camera")
    log.news(None)
    answer = kb.select({"see": "by_lidar"})
    log.settle()  # the lidar is being started
    kb.component_active("camera", False)
    kb.component_active("lidar", True)
    log.news(1.5)
    kb.component_recovered("camera")
    kb.component_failed("lidar")
    log.news(None)
    kb.finish_plan(answer, "completed")
    log.settle()  # the plan has ended in this turn of the manager, which plans in the next one
    mission.turn()
    assert mission.kinds() == [
        ("structural", "camera has failed"),
        ("structural", "lidar has failed"),
    ]


def test_what_a_planner_that_waits_answers_later_is_an_adaptation_all_the_same(mission):
    class Slow(PriorityPlanner):
        is_waiting = True

        def plan(self, kb):
            return super().plan(kb) if mission.now > 1.0 else None

    mission.tick(mission.begin("search"))
    mission.manager = ConfigurationManager(mission.kb, Robot(), planner=Slow())
    mission.hear(lambda: mission.kb.component_failed("camera"))
    for _ in range(12):
        mission.tick()
    ((kind, trigger),), (told,) = mission.kinds(), mission.log.adaptations
    assert (kind, trigger, told.at_s) == ("structural", "camera has failed", 1.1)


def test_what_ends_by_itself_while_a_plan_is_carried_out_is_news_where_nobody_says_what_is(mission):
    kb, log = mission.kb, mission.log
    log.news(inf)
    mission.tick(mission.begin("search"))
    kb.component_failed("camera")
    answer = kb.select({"see": "by_lidar"})
    log.settle()
    kb.component_active("camera", False)
    kb.component_active("lidar", True)
    kb.component_active("lidar", False, "its process has ended by itself")
    kb.finish_plan(answer, "completed")
    log.settle()
    mission.turn()
    ended = "lidar is inactive (its process has ended by itself)"
    assert mission.kinds() == [("structural", "camera has failed"), ("structural", ended)]


def test_action_given_up_because_of_news_that_none_follows_is_told_when_the_run_ends(mission):
    mission.tick(mission.begin("search"))
    mission.hear(lambda: mission.kb.measure("energy", 0.1))
    mission.tick(mission.end("search"))
    mission.tick()
    assert mission.log.adaptations == []  # another one may follow yet
    mission.log.finish()
    (told,) = mission.log.adaptations
    assert (told.kind, told.change, told.trigger) == (
        "task",
        "search -> nothing; stop camera",
        "energy is 0.1",
    )
    assert told.reason.startswith("search is unfeasible because energy 0.1 violates >= 0.2")
    assert (told.at_s, told.reaction_s) == (0.2, pytest.approx(0.1))


def test_end_of_a_run_tells_nothing_of_what_was_completed_followed_or_left_without_news(mission):
    mission.tick(mission.begin("search"))
    mission.log.finish()  # under way
    mission.tick(mission.end("search"))
    mission.log.finish()  # left without news
    mission.tick(mission.begin("search"))
    mission.hear(lambda: mission.kb.measure("energy", 0.1))
    mission.tick(mission.end("search"), mission.begin("wait"))
    mission.tick(mission.end("wait", "completed"))
    mission.log.finish()
    assert [one.change for one in mission.log.adaptations] == ["search -> wait"]


NEWS = st.one_of(
    st.builds(
        lambda value: lambda one: one.kb.measure("energy", value), st.sampled_from([0.1, 0.3, 0.9])
    ),
    st.just(lambda one: one.kb.component_failed("camera")),
    st.just(lambda one: one.kb.component_recovered("camera")),
    st.just(lambda one: one.log.sensed("guest is true")),
)
DECISION = st.tuples(
    st.sampled_from(["search", "inspect", "wait"]),
    st.sampled_from(["completed", "failed", "abandoned"]),
)
SCRIPT = st.lists(st.tuples(st.lists(NEWS, max_size=2), st.none() | DECISION), max_size=12)


def played(script, begins_first=False, hears=True):
    """Play turns: what is heard, then what the task layer decides to do, and how it ends what it did."""
    one, doing = robot(), None
    for news, decision in script:
        for tell in news if hears else []:
            one.hear(lambda tell=tell: tell(one))
        steps = []
        if decision is not None and decision[0] != doing and one.kb.is_feasible(decision[0]):
            steps = [one.begin(decision[0])]
            if doing is not None:
                steps.insert(1 if begins_first else 0, one.end(doing, decision[1]))
            doing = decision[0]
        one.tick(*steps)
    return one


@given(SCRIPT)
def test_task_adaptations_are_what_the_history_of_actions_says(script):
    one = played(script)
    history = [
        (record.action, record.start, record.end, record.result)
        for record in one.kb.history.actions
    ]
    follow = {start: (before, name) for (before, _, _, _), (name, start, _, _) in pairwise(history)}
    tasks = [told for told in one.log.adaptations if told.kind == "task"]
    assert [told.change.split(";")[0] for told in tasks] == [
        " -> ".join(follow[told.at_s]) for told in tasks
    ]
    for told in one.log.adaptations:
        assert all((told.trigger, told.reason, told.change))
        assert told.news_s <= told.at_s
        assert told.reaction_s is None or told.reaction_s >= told.at_s - told.news_s - 1e-9
    given_up = {end for _, _, end, result in history if result == "failed"}
    assert given_up & set(follow) <= {told.at_s for told in tasks}


@given(SCRIPT)
def test_it_does_not_matter_whether_a_tree_begins_or_ends_first(script):
    begun, ended = (played(script, begins_first=order) for order in (True, False))
    assert [(one.at_s, one.kind, one.trigger, one.reason) for one in begun.log.adaptations] == [
        (one.at_s, one.kind, one.trigger, one.reason) for one in ended.log.adaptations
    ]


@given(SCRIPT)
def test_without_news_only_a_failure_is_an_adaptation(script):
    one = played(script, hears=False)
    assert all(told.trigger.endswith(" has failed") for told in one.log.adaptations)


@given(SCRIPT)
def test_end_of_a_run_adds_at_most_the_last_action_and_only_if_none_is_under_way(script):
    one = played(script)
    before = list(one.log.adaptations)
    one.log.finish()
    assert (
        one.log.adaptations == before
    )  # each action that ends here is followed by another, or none has ended
    one.hear(lambda: one.kb.component_failed("camera"))
    one.hear(lambda: one.kb.component_failed("lidar"))
    doing = [required.action for required in one.kb.required_actions]
    one.tick(*(one.end(action) for action in doing))
    before = [told.change for told in one.log.adaptations]
    one.log.finish()
    one.log.finish()
    added = [told for told in one.log.adaptations if "nothing" in told.change]
    assert [told.change.split(";")[0] for told in added] == [
        f"{action} -> nothing" for action in doing
    ]
    assert len(one.log.adaptations) == len(before) + len(added)
    assert [told.at_s for told in one.log.adaptations] == sorted(
        told.at_s for told in one.log.adaptations
    )


@pytest.mark.parametrize("task", ["bt", "pddl"])
def test_corridor_that_is_given_up_with_no_way_left_is_told_with_its_reason(task):
    _, verdict, data = run_mission("agv", task, seed=1, capacity_j=2500, duration_s=40)
    assert not verdict.success
    last = data["adaptations"][-1]
    assert last["change"].startswith("cross_c1 -> nothing")
    assert last["trigger"] == "kinect has failed"
    assert last["reason"].startswith("cross_c1 is unfeasible because")
    assert last["at_s"] == data["actions"][-1]["end_s"]


def test_tree_that_gives_up_a_corridor_says_why_in_the_history_of_actions():
    _, _, data = run_mission("agv", seed=1, capacity_j=2500, duration_s=40)
    assert data["actions"][-1]["result"] == "abandoned"
    assert data["actions"][-1]["reason"].startswith(
        "cross_c1 is unfeasible because function navigate is unfeasible"
    )


def test_goal_that_changes_in_flight_is_a_task_adaptation_of_the_plans():
    _, _, data = run_mission("uav", "pddl", 1, duration_s=65)
    (told,) = data["adaptations"]
    assert (told["kind"], told["trigger"]) == (
        "task",
        "sample_8_wanted is true and sample_8_found is true",
    )
    assert told["reason"].startswith("the rest of the plan does not reach (forall")
    assert (
        told["change"]
        == "plan anew, with search_for_samples(sample_8, drone), pick_up_and_analyse(sample_8, drone)"
    )
    assert told["reaction_s"] == pytest.approx(0.2)


def test_action_that_a_changed_goal_takes_up_again_is_put_down_to_the_goal_and_not_to_old_news():
    _, _, data = run_mission("uav", "pddl", 5, duration_s=152, added_s=150)
    told = data["adaptations"][-1]
    assert told["change"].startswith("search_for_samples -> pick_up_and_analyse")
    assert told["trigger"].startswith("sample_8_wanted is true")
    assert told["reason"].startswith("the rest of the plan does not reach (forall")
    assert told["reaction_s"] == pytest.approx(0.24)
