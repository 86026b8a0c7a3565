"""Why a fact is so and until when: in explanations, in plans and in the store."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from models import Clock, carry_out

from kb import (
    InvalidValue,
    KnowledgeBase,
    Model,
    PriorityPlanner,
    Status,
)


def rover():
    model = Model("rover")
    light = model.environmental_attribute("light")
    camera = model.component("camera", kind="lifecycle", always_improve=True)
    camera.configuration("day", {"exposure": 0.01}, priority=1, constraints=[light >= 0.5])
    camera.configuration("night", {"exposure": 0.2}, priority=2)
    model.component("lidar", kind="process")
    see = model.function("see", always_improve=True)
    see.design("by camera", [camera], priority=1)
    see.design("by lidar", ["lidar"], priority=2)
    model.action("explore", requires=[see])
    return model


class Lives:
    """A knowledge base, and the same one later: with its store, or going on in memory."""

    def __init__(self, store):
        self.clock = Clock(300.0)
        self.store = store
        self.kb = None
        self.begin()

    def begin(self):
        if self.kb is None or self.store is not None:
            self.kb = KnowledgeBase(rover(), clock=self.clock, store=self.store)
        return self.kb

    def again(self):
        if self.store is not None:
            self.kb.close()
        return self.begin()


@pytest.fixture(params=["in memory", "in a store"])
def lives(request, tmp_path):
    found = Lives(None if request.param == "in memory" else tmp_path / "mission.sqlite3")
    yield found
    found.kb.close()


# asserted statuses

steps = st.lists(
    st.tuples(
        st.sampled_from((0.5, 1.0, 4.0)),
        st.sampled_from((None, "retract", 0.5, 1.0, 3.0, math.inf)),
    ),
    max_size=20,
)


@given(steps)
def test_an_asserted_status_holds_until_its_time_and_no_longer(story):
    clock = Clock(0.0)
    kb = KnowledgeBase(rover(), clock=clock)
    until = -math.inf
    for pause, what in story:
        if what == "retract":
            kb.retract_status(kb.configurations["night"])
            until = -math.inf
        elif what is not None:
            until = clock.now + what
            kb.assert_status(kb.configurations["night"], "unfeasible", until=until)
        for _ in range(round(pause / 0.25)):
            clock.now += 0.25
            assert (kb.configurations["night"].status is Status.UNFEASIBLE) == (clock.now < until)


@pytest.mark.parametrize("until", [math.nan, -math.inf, 300.0, 299.0, "soon", True])
def test_time_that_is_over_is_refused(until):
    kb = KnowledgeBase(rover(), clock=Clock(300.0))
    with pytest.raises(InvalidValue):
        kb.assert_status("camera", "unfeasible", until=until)
    assert kb.components["camera"].status is Status.FEASIBLE


def test_why_a_status_is_asserted_and_until_when_is_explained(lives):
    lives.kb.assert_status("night", "unfeasible", "its parameters could not be set", until=312.0)
    kb = lives.again()
    explanation = kb.explain("night")
    assert explanation.sentence == (
        "night is unfeasible because it is asserted so until 312 s "
        "(its parameters could not be set)"
    )
    assert explanation.reason == "its parameters could not be set"
    constraint = kb.configurations["day"].constraints[0]
    kb.assert_status(constraint, "violated", "fog")
    assert kb.explain(constraint).fact == "light >= 0.5 is asserted violated (fog)"


@pytest.mark.parametrize("reopened", [305.0, 312.0, 400.0])
def test_a_status_lapses_also_while_nobody_is_there(lives, reopened):
    lives.kb.assert_status("night", "unfeasible", "it failed", until=312.0)
    lives.clock.now = reopened
    kb = lives.again()
    assert (kb.configurations["night"].status is Status.UNFEASIBLE) == (reopened < 312.0)
    lives.clock.now = 500.0
    assert kb.configurations["night"].status is Status.FEASIBLE


# failures


def test_why_a_component_is_inactive_is_the_plans_reason():
    kb = KnowledgeBase(rover())
    kb.request_action("explore")
    kb.component_failed("camera")
    carry_out(kb, PriorityPlanner().plan(kb))
    kb.component_active("lidar", False, "its process ended by itself (exit status 3)")
    assert "it is required and not active (its process ended by itself (exit status 3))" in str(
        kb.explain("lidar")
    )
    plan = PriorityPlanner().plan(kb)
    assert plan.activate == ("lidar",)
    assert plan.reason == "its process ended by itself (exit status 3); lidar is needed by explore"
    carry_out(kb, plan)
    kb.component_active("lidar", False)
    assert PriorityPlanner().plan(kb).reason == "lidar is not active, and is needed by explore"


# selections


def test_reason_of_a_choice_is_kept_with_choice_and_plan(lives):
    lives.kb.request_action("explore")
    carry_out(
        lives.kb, lives.kb.select({"see": "by camera"}, {"camera": "day"}, "the least energy")
    )
    kb = lives.again()
    (plan,) = kb.plans
    assert plan.reason.endswith("; the least energy")
    assert kb.designs["by camera"].reason == kb.configurations["day"].reason == "the least energy"
    chosen = "?s a :Selection ; :about ?x ; :reason ?why . ?x :name ?name"
    assert set(kb.query(f"SELECT ?name ?why {{ {chosen} }}")) == {
        ("by camera", "the least energy"),
        ("day", "the least energy"),
    }
    plan = kb.select({}, {"camera": "night"}, "the sharpest picture")
    assert plan.reason == "the sharpest picture"
    assert (kb.configurations["day"].reason, kb.configurations["night"].reason) == (
        "",
        "the sharpest picture",
    )
    assert kb.select({}, {"camera": "day"}).reason == "day is feasible and preferred to night"
    assert kb.configurations["day"].reason == ""


# attempts and answers


def test_attempts_and_answers_are_on_record_and_can_be_asked_for(lives):
    kb = lives.kb
    kb.request_action("explore")
    plan = kb.select({"see": "by camera"}, {"camera": "night"})
    first = kb.record_attempt(plan, "camera", "activate")
    second = kb.record_attempt(
        plan, "camera", "configure", configuration="night", parameters={"exposure": 0.2}, number=2
    )
    lives.clock.now = 301.0
    assert kb.finish_attempt(first, "failed", "too slow")
    assert not kb.finish_attempt(first, "completed")
    assert kb.finish_attempt(second, "completed")
    kb.record_answer(plan, is_vetoed=True, reason="not at night")
    kb.finish_plan(plan, "abandoned")
    assert [str(one) for one in kb.history.attempts] == [
        "activate camera, attempt 1: failed: too slow",
        "configure camera, attempt 2: completed",
    ]
    described = (
        [attempt(one) for one in kb.history.attempts],
        [answer(one) for one in kb.history.answers],
    )
    kb = lives.again()
    assert (
        [attempt(one) for one in kb.history.attempts],
        [answer(one) for one in kb.history.answers],
    ) == described
    assert kb.history.attempts[0].plan is kb.history.answers[0].plan is kb.plans[0]


def attempt(one):
    told = (one.component, one.operation, one.configuration, dict(one.parameters), one.number)
    return (*told, one.start, one.end, one.result, one.reason, one.plan.reason)


def answer(one):
    return one.plan.reason, one.time, one.is_vetoed, one.reason


# the end


# in short


def test_a_base_and_a_situation_say_in_short_what_they_are():
    kb = KnowledgeBase(rover())
    assert repr(kb) == "<KnowledgeBase 'rover': 1 of 1 actions feasible>"
    kb.request_action("explore")
    situation = kb.situation(light=0.3, failed=["camera", "lidar"])
    assert repr(situation) == "<Situation of 'rover': 0 of 1 actions feasible, required: explore>"


def test_the_time_is_that_of_the_clock(lives):
    assert lives.kb.now == lives.kb.situation().now == 300.0
