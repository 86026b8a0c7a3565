"""An event carries what was told as data, so that it can be told to another base, which then knows the same."""

import math
from types import MappingProxyType

import pytest
from hypothesis import given
from models import Clock, Twins, stories

from kb import KnowledgeBase, Model, Told


def known(kb):
    """The facts and what is inferred from them; what was asked for, and planned."""
    requests = [(one.action, one.preference, one.start, one.end, one.result, one.reason) for one in kb.action_history]
    plans = [(one.activate, one.deactivate, one.parameters, one.start) for one in kb.plans]
    return [list(column) for column, _ in kb._state._columns], requests, plans


@given(stories(aging=True))
def test_what_events_carry_told_to_another_base_makes_it_equal(story):
    model, happenings = story
    twins, heard = Twins(model), []
    twins.kb.subscribe(heard.append)
    for happening in happenings:
        twins.happen(happening)
    clock = Clock()
    again = KnowledgeBase(model, clock=clock)
    for event in heard:
        clock.now = event.time
        if event.told is not None:
            getattr(again, event.told.verb)(*event.told.arguments)
    clock.now = twins.clock.now
    assert known(again) == known(twins.kb)


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
        ("measure", ("light", 1 / 3)),
        ("component_failed", ("camera", ODD)),
        ("component_active", ("camera", True, ODD)),
        ("request_action", ("explore", None)),
        ("request_action", ("explore", "light")),
        ("request_action", ("explore", MappingProxyType({"light": 0.1 + 0.2}))),
        ("select", ({"see": "by camera"}, {"camera": "day"}, ODD)),
        ("select", ({}, {"camera": "night"}, "")),
    ],
)
def test_event_carries_the_arguments_exactly(kb, verb, arguments):
    told = []
    if verb == "select":
        kb.assert_required("explore", True)
        kb.assert_selected("by camera", True)
    kb.subscribe(told.append)
    getattr(kb, verb)(*arguments)
    assert told[0].told == Told(verb, arguments)


def test_event_of_an_assertion_carries_the_element_and_what_was_left_out(kb, model):
    told = []
    kb.subscribe(told.append)
    (bright,) = kb.configurations["day"].constraints
    kb.assert_status("camera", "failure", until=1 / 3)
    kb.assert_status(kb.components["camera"], "failure", ODD, math.inf)
    kb.component_recovered("camera")
    kb.assert_status(bright, "violated")
    kb.retract_status(bright)
    kb.assert_required(model.components["camera"], False)
    kb.assert_selected("day", None, ODD)
    camera = model.components["camera"]
    assert [one.told for one in told] == [
        ("assert_status", (camera, "failure", "", 1 / 3)),
        ("assert_status", (camera, "failure", ODD, None)),
        ("component_recovered", ("camera",)),
        ("assert_status", (bright.element, "violated", "", None)),
        ("retract_status", (bright.element,)),
        ("assert_required", (camera, False)),
        ("assert_selected", (model.configurations["day"], None, ODD)),
    ]


def test_event_of_several_choices_that_need_no_plan_is_one_telling(kb):
    kb.request_action("explore")
    kb.finish_plan(kb.select({"see": "by camera"}, {"camera": "day"}), "completed")
    kb.cancel_action("explore", "failed", ODD)
    told = []
    kb.subscribe(told.append)
    assert kb.select(reason=ODD) is None
    (event,) = told
    assert event.text == "day is not selected, by camera is not selected"
    assert event.told == ("select", ({}, {}, ODD))


def test_diagnostics_are_told_as_what_they_say(kb):
    told = []
    kb.subscribe(told.append)
    status = [{"message": "QA status", "values": [{"key": "light", "value": "0.3"}]}]
    status += [
        {"message": "component status", "values": [{"key": "camera", "value": word}]} for word in ("error", "ok")
    ]
    assert kb.receive({"status": status}) == ()
    assert [one.told for one in told] == [
        ("measure", ("light", 0.3)),
        ("component_failed", ("camera", "")),
        ("component_recovered", ("camera",)),
    ]


def test_what_nobody_told_carries_nothing(kb, model, clock):
    kb.measure("light", 0.9)
    kb.assert_status("camera", "failure", until=5.0)
    told = []
    kb.subscribe(told.append)
    clock.now = 5.0
    assert kb.revision
    clock.now = 11.0
    assert kb.revision
    model.change("night", priority=0)
    assert [one.text for one in told] == [
        "camera is no longer asserted failure: its time is over",
        "light is stale: measured 11.0 s ago, at most 10 s",
        "night changed in the model",
    ]
    assert [one.told for one in told] == [None] * 3


def test_what_is_carried_cannot_be_changed(kb):
    told = []
    kb.subscribe(told.append)
    given = {"see": "by camera"}
    kb.request_action("explore")
    kb.select(given)
    given["see"] = "other"
    designs = told[1].told.arguments[0]
    assert designs == {"see": "by camera"}
    with pytest.raises(TypeError):
        designs["see"] = "other"
