"""What a model states from the start is what a knowledge base made of it begins with."""

import math

import pytest
from models import Clock

from kb import (
    InvalidValue,
    KnowledgeBase,
    KnowledgeBaseError,
    Model,
    Status,
)
from kb.elements import (
    ActiveFact,
    MeasurementFact,
    RequiredActionFact,
    RequiredFact,
    SelectedFact,
    StatusFact,
)


@pytest.fixture
def model():
    model = Model("rover")
    light = model.environmental_attribute("light", max_age=10.0)
    model.quality_attribute("energy")
    camera = model.component("camera", kind="process")
    camera.configuration("day", {"exposure": 0.01}, priority=1, constraints=[light >= 0.5])
    see = model.function("see")
    see.design("by camera", [camera])
    model.action("explore", requires=[see])
    return model


def begun(model, *facts, now=100.0):
    for fact in facts:
        model.add_fact(fact)
    return KnowledgeBase(model, clock=Clock(now))


def test_stated_measurements_are_facts_and_history(model):
    kb = begun(
        model,
        MeasurementFact("light", 0.4, 95.0),
        MeasurementFact("light", 0.9, 90.0, latest=False),
        MeasurementFact("energy", 1.0),
    )
    light = kb.attributes["light"]
    assert (light.value, light.time, light.is_stale) == (0.4, 95.0, False)
    assert light.history == ((90.0, 0.9), (95.0, 0.4))
    assert (kb.attributes["energy"].value, kb.attributes["energy"].time) == (1.0, 100.0)
    assert kb.components["camera"].status is Status.UNFEASIBLE


def test_a_configured_robot_at_work_may_be_stated(model):
    kb = begun(
        model,
        RequiredActionFact("explore", {"energy": 1.0}),
        SelectedFact(model.designs["by camera"]),
        SelectedFact(model.configurations["day"]),
        ActiveFact("camera"),
    )
    assert kb.actions["explore"].status is Status.SOLVED
    (required,) = kb.required_actions
    assert (required.action, required.preference, required.start) == (
        "explore",
        {"energy": 1.0},
        100.0,
    )
    kb.cancel_action("explore", "completed")
    assert kb.obsolete() == (("camera",), ("by camera",), ("day",))


def test_stated_statuses_stand_until_retracted(model):
    kb = begun(
        model,
        StatusFact(model.functions["see"], Status.UNFEASIBLE),
        RequiredFact(model.components["camera"]),
    )
    assert not kb.is_feasible("explore")
    assert kb.components["camera"].status is Status.UNSOLVED
    kb.retract_status(kb.functions["see"])
    kb.assert_required(kb.components["camera"], None)
    assert kb.is_feasible("explore")
    assert kb.components["camera"].status is Status.FEASIBLE


def test_stated_records_that_ended_are_not_open(model):
    kb = begun(
        model,
        RequiredActionFact("explore", None, 10.0, 20.0, "completed"),
        RequiredActionFact("explore", {"energy": 2.0, "light": 1.0}, 30.0),
    )
    past, present = kb.history.actions
    assert (past.start, past.end, past.result) == (10.0, 20.0, "completed")
    assert dict(present.preference) == {"energy": 2.0, "light": 1.0}
    assert kb.required_actions == (present,)
    assert kb.actions["explore"].is_required


@pytest.mark.parametrize(
    "state",
    [
        lambda model: SelectedFact(model.actions["explore"]),
        lambda model: RequiredFact(model.designs["by camera"]),
        lambda model: StatusFact(model.actions["explore"], "odd"),
        lambda model: RequiredActionFact("explore", {"light": float("nan")}),
        lambda model: RequiredActionFact("explore", ["light"]),
        lambda model: RequiredActionFact("explore", result="done"),
        lambda model: MeasurementFact("light", 1.0, latest="yes"),
    ],
)
def test_facts_that_make_no_sense_are_refused(model, state):
    with pytest.raises(KnowledgeBaseError):
        model.add_fact(state(model))
    assert model.facts == ()


def test_facts_keep_their_order_while_a_clock_is_a_little_behind(model):
    clock = Clock(5.0)
    kb = KnowledgeBase(model, clock=clock)
    kb.measure("light", 0.5)
    clock.now = 4.5
    kb.measure("light", 0.3)
    assert kb.now == 5.0
    assert kb.attributes["light"].history == ((5.0, 0.5), (5.0, 0.3))
    assert kb.attributes["light"].value == 0.3


@pytest.mark.parametrize("shown", [3.0, -math.inf, math.nan, math.inf, "noon", None, True, [5.0]])
def test_clock_that_goes_back_is_refused(model, shown):
    clock = Clock(5.0)
    kb = KnowledgeBase(model, clock=clock)
    kb.measure("light", 0.5)
    before = kb.attributes["light"].history, len(kb.log)
    clock.now = shown
    with pytest.raises(InvalidValue, match=r"the clock (went back, from 5\.0 s to 3\.0 s|gives )"):
        kb.measure("light", 0.3)
    with pytest.raises(InvalidValue, match="the clock"):
        kb.component_failed("camera")
    clock.now = 6.0
    assert (kb.attributes["light"].history, len(kb.log)) == before
    kb.measure("light", 0.3)
    assert kb.attributes["light"].history == ((5.0, 0.5), (6.0, 0.3))
