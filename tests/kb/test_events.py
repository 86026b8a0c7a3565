"""The log: every event is data, can be written as JSON, and replayed in another base."""

import json
from types import MappingProxyType

import pytest
from models import Clock

from kb import Event, EventKind, KnowledgeBase, Model


def through_json(event):
    return Event.from_json(json.loads(json.dumps(event.to_json())))


def said(events):
    return [(event.verb, event.arguments) for event in events]


@pytest.fixture
def model():
    model = Model("rover")
    light = model.environmental_attribute("light", max_age=10.0)
    camera = model.component("camera", kind="process")
    camera.configuration("day", {"exposure": 0.01}, priority=1, constraints=[light >= 0.5])
    camera.configuration("night", {"exposure": 0.2}, priority=2)
    see = model.function("see")
    see.design("by camera", [camera])
    model.action("explore", requires=[see])
    return model


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def kb(model, clock):
    return KnowledgeBase(model, clock=clock)


ODD = "it said: (no) until 3 s\n\u2028 is asserted failure"


@pytest.mark.parametrize(
    ("verb", "arguments"),
    [
        ("measure", ("light", 0.1 + 0.2)),
        ("component_failed", ("camera", ODD)),
        ("component_active", ("camera", True, ODD)),
        ("request_action", ("explore", None)),
        ("request_action", ("explore", MappingProxyType({"light": 0.1 + 0.2}))),
        ("select", ({"see": "by camera"}, {"camera": "day"}, ODD)),
    ],
)
def test_event_carries_the_arguments_exactly(kb, verb, arguments):
    heard = []
    if verb == "select":
        kb.assert_required("explore", True)
        kb.assert_selected("by camera", True)
    kb.subscribe(heard.append)
    getattr(kb, verb)(*arguments)
    assert said(heard) == [(verb, arguments)]
    assert said(map(through_json, heard)) == [(verb, arguments)]


def test_records_are_events_that_refer_by_number(kb):
    kb.request_action("explore")
    plan = kb.select({"see": "by camera"}, {"camera": "day"})
    kb.record_answer(plan, is_vetoed=False)
    attempt = kb.record_attempt(plan, "camera", "activate")
    kb.finish_attempt(attempt, "failed", ODD)
    kb.finish_plan(plan, "failed")
    kb.component_started("camera", 7)
    kb.component_ended("camera", 7)
    assert said(kb.log)[2:] == [
        ("record_answer", (1, False, "")),
        ("record_attempt", (1, "camera", "activate", None, {}, 1)),
        ("finish_attempt", (attempt.serial, "failed", ODD)),
        ("finish_plan", (1, "failed")),
        ("component_started", ("camera", 7)),
        ("component_ended", ("camera", 7)),
    ]
    assert {one.kind for one in list(kb.log)[2:]} == {EventKind.RECORD}


def test_event_of_several_choices_that_need_no_plan_is_one_event(kb):
    kb.request_action("explore")
    kb.finish_plan(kb.select({"see": "by camera"}, {"camera": "day"}), "completed")
    kb.cancel_action("explore", "failed", ODD)
    heard = []
    kb.subscribe(heard.append)
    assert kb.select(reason=ODD) is None
    (event,) = heard
    assert event.text == "day is not selected, by camera is not selected"
    assert event.effects == (
        ("configuration", "day", False),
        ("function design", "by camera", False),
    )
    assert said([event]) == [("select", ({}, {}, ODD))]
    assert kb.select(reason=ODD) is None
    assert len(heard) == 1


def test_what_time_does_is_an_event_at_its_own_instant(kb, model, clock):
    kb.measure("light", 0.9)
    kb.assert_status("camera", "failure", until=5.0)
    heard = []
    kb.subscribe(heard.append)
    clock.now = 30.0
    assert kb.revision
    model.change("night", priority=0)
    assert [one.text for one in heard] == [
        "camera is no longer asserted failure: its time is over",
        "light is stale: measured 10.0 s ago, at most 10 s",
        "night changed in the model",
    ]
    assert [one.verb for one in heard] == ["lapse", "stale", "amend"]
    assert [one.time for one in heard] == [5.0, pytest.approx(10.0), 30.0]


def test_what_is_carried_cannot_be_changed(kb):
    given = {"see": "by camera"}
    kb.request_action("explore")
    kb.select(given)
    given["see"] = "other"
    designs = list(kb.log)[1].arguments[0]
    assert designs == {"see": "by camera"}
    with pytest.raises(TypeError):
        designs["see"] = "other"


class TestCauses:
    def test_plan_is_caused_by_what_changed_its_subject(self, kb):
        kb.measure("light", 0.9)
        kb.request_action("explore")
        assert kb.select({"see": "by camera"}, {"camera": "day"}).cause == 2
        kb.finish_plan(1, "completed")
        kb.component_active("camera", True)
        kb.measure("light", 0.8)
        kb.measure("light", 0.3)
        crossing = kb.log.last
        plan = kb.select({}, {"camera": "night"})
        assert plan.cause == crossing
        assert [one.cause for one in kb.log][-1] == crossing

    def test_plan_for_better_is_caused_by_what_made_it_possible(self, kb):
        kb.measure("light", 0.3)
        kb.request_action("explore")
        kb.select({"see": "by camera"}, {"camera": "night"})
        kb.measure("light", 0.9)
        brighter = kb.log.last
        kb.component_active("camera", True)  # which the plan has brought about
        kb.finish_plan(1, "completed")
        assert kb.select({}, {"camera": "day"}).cause == brighter

    def test_plan_after_a_crash_is_caused_by_the_crash(self, kb):
        kb.measure("light", 0.9)
        kb.request_action("explore")
        kb.select({"see": "by camera"}, {"camera": "day"})
        kb.component_active("camera", True)
        kb.component_active("camera", False, "the process of camera ended by itself")
        crash = kb.log.last
        kb.finish_plan(1, "completed")
        assert kb.select({}, {"camera": "day"}).cause == crash

    def test_cancel_and_next_request_have_their_causes(self, kb):
        kb.model.action("rest")
        kb.request_action("explore")
        kb.component_failed("camera")
        failure = kb.log.last
        kb.cancel_action("explore", "abandoned", "it cannot be done")
        assert list(kb.log)[-1].cause == failure
        kb.request_action("rest")
        assert kb.required_actions[0].cause == kb.log.last - 1

    def test_cause_can_be_given(self, kb):
        kb.measure("light", 0.9)
        kb.request_action("explore", cause=1)
        assert kb.select({"see": "by camera"}, cause=1).cause == 1
        kb.cancel_action("explore", cause=1)
        assert [one.cause for one in kb.log] == [None, 1, 1, 1]
