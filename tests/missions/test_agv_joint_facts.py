"""What the joint planner was told before does not stick: it answers by the facts and the model as they are now."""

from itertools import product

from hypothesis import given, settings
from hypothesis import strategies as st

from kb import KnowledgeBase
from missions.agv import PAPER, WEIGHTS
from missions.agv.joint import JointPlanner, Modes, Question
from missions.agv.model import agv_model


class Robot:
    """A robot whose facts and model change; the Kinect's designs also need a cool head, measured now and then."""

    def __init__(self):
        self.model, self.now = agv_model(), 0.0
        heat = self.model.environmental_attribute("heat", max_age=20.0, when_stale="violated")
        for name in ("amcl_kinect", "mrpt_kinect"):
            self.model.designs[name].constrain((heat <= 50.0).steady(hysteresis=10.0))
        light = self.model.attributes["light"]
        self.model.designs["aruco_camera_lamp"].constrain((light <= 0.8).steady(hysteresis=0.4))
        self.model.components["lamp"].constrain((heat <= 70.0).steady(dwell=5.0))
        self.kb = KnowledgeBase(self.model, clock=lambda: self.now)

    def undergo(self, what, name, value):
        self.now += 3.0
        if what == "fails":
            self.kb.component_failed(name)
        elif what == "recovers":
            self.kb.component_recovered(name)
        elif what == "measured":
            self.kb.measure(name, value)
        elif what == "runs":
            self.kb.component_active(name, value > 40.0)
        elif what == "constrained":
            self.model.components[name].constrain(self.model.attributes["heat"] <= value)
        elif what == "estimated":
            one = next(each for each in self.model.estimations if each.attribute == "energy")
            self.model.change(one, value=value)
        else:
            self.model.change(
                self.model.configurations["fast"], parameters={"speed": 0.1 + value / 100.0}
            )


parts = st.sampled_from(["kinect", "lidar", "camera", "amcl", "mrpt", "lamp"])
values = st.sampled_from([0.0, 0.2, 0.5, 1.0, 45.0, 55.0, 75.0])
events = st.one_of(
    st.tuples(st.sampled_from(["fails", "recovers", "runs", "constrained"]), parts, values),
    st.tuples(st.just("measured"), st.sampled_from(["heat", "heat", "obstacles"]), values),
    st.tuples(st.just("measured"), st.just("light"), st.sampled_from([0.0, 0.2, 0.5, 1.0])),
    st.tuples(st.sampled_from(["estimated", "faster"]), st.just(""), values),
)


@settings(max_examples=50)
@given(
    st.lists(events, min_size=1, max_size=8),
    st.sampled_from([{}, {"energy": 1500.0}, {"collisions": 0.05}]),
)
def test_planner_answers_like_a_new_one_whatever_it_was_asked_before(told, limits):
    robot = Robot()
    building = PAPER
    old = JointPlanner(building, robot.kb)
    question = Question(weights=WEIGHTS, limits=limits)
    old.plan(question)
    for event in told:
        robot.undergo(*event)
        answer, anew = old.plan(question), JointPlanner(building, robot.kb).plan(question)
        assert answer.reason == anew.reason
        assert (answer.cost, answer.takes) == (anew.cost, anew.takes)
        assert list(map(str, answer.legs)) == list(map(str, anew.legs))


@settings(max_examples=40)
@given(st.lists(events, max_size=4))
def test_situations_that_are_taken_for_the_same_allow_the_same_modes(told):
    robot = Robot()
    robot.undergo("measured", "heat", 20.0)
    for event in told:
        robot.undergo(*event)
    asked = Modes(robot.kb, "navigate")
    for light, obstacles in product((1.0, 0.6, 0.35, 0.25, 0.1), (0.0, 0.1, 0.2)):
        conditions = {"light": light, "obstacles": obstacles}
        assert [mode.name for mode in asked.under(conditions)] == [
            mode.name for mode in Modes(robot.kb, "navigate").under(conditions)
        ]


def test_what_is_measured_beside_the_demands_counts_from_then_on():
    robot = Robot()
    planner = JointPlanner(PAPER, robot.kb)
    ways = []
    for heat in (20.0, 55.0, 45.0, 39.0):  # it has to cool to 40 before the Kinect is used again
        robot.undergo("measured", "heat", heat)
        ways.append(planner.plan(Question()).legs[0].corridor)
    robot.now += 30.0
    ways.append(planner.plan(Question()).legs[0].corridor)
    assert ways == ["c1", "c4", "c4", "c1", "c4"]


def test_amended_speed_and_estimation_count_from_then_on():
    robot = Robot()
    robot.kb.measure("heat", 20.0)
    planner = JointPlanner(PAPER, robot.kb)
    before = planner.plan(Question()).takes
    robot.model.change(robot.model.configurations["fast"], parameters={"speed": 6.8})
    assert planner.plan(Question()).takes.in_units["time"] < before.in_units["time"] / 3
    for one in robot.model.estimations:
        if one.attribute == "energy":
            robot.model.change(one, value=0.0)
    after = planner.plan(Question()).takes
    assert (
        after.in_units["energy"] < before.in_units["energy"] / 50
    )  # what is left is what it takes to stand while the first are switched on


def test_conditions_that_violate_the_same_constraints_are_asked_about_once(monkeypatch):
    kb = KnowledgeBase(agv_model(), clock=lambda: 0.0)
    asked, situation = [], kb.situation
    monkeypatch.setattr(
        kb, "situation", lambda conditions: asked.append(conditions) or situation(conditions)
    )
    modes = Modes(kb, "navigate")
    for light in (1.0, 0.9, 0.8, 0.1, 0.0):
        modes.under({"light": light, "obstacles": 0.0})
    assert [one["light"] for one in asked] == [1.0, 0.1]
