"""A measurement can grow too old; what it counts as then is the model's to say."""

import pytest
from hypothesis import HealthCheck
from models import Clock

from kb import Event, KnowledgeBase, Model

SLOW = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much]


@pytest.fixture
def clock():
    return Clock(100.0)


@pytest.fixture
def kb(clock):
    model = Model("rover")
    light = model.environmental_attribute("light", max_age=5.0)
    gas = model.environmental_attribute("gas", max_age=2.0, when_stale="violated")
    model.action("look", constraints=[light >= 0.5])
    model.action("enter", constraints=[gas <= 0.1])
    return KnowledgeBase(model, clock=clock)


def test_stale_measurement_violates_by_the_models_policy(kb, clock):
    assert kb.is_feasible("enter")  # never measured is not stale
    kb.measure("gas", 0.0)
    clock.now += 3.0
    assert not kb.is_feasible("enter")
    kb.measure("gas", 0.0)
    assert kb.is_feasible("enter")


def test_one_who_listens_hears_that_a_measurement_is_stale(kb, clock):
    kb.measure("light", 0.1)
    heard = []
    kb.subscribe(heard.append)
    before = kb.revision
    clock.now += 6.0
    assert kb.revision == before + 1
    (event,) = heard
    assert (event.subject, event.text) == (
        "light",
        "light is stale: measured 5.0 s ago, at most 5 s",
    )
    assert [(change.name, change.new) for change in event.changes] == [
        ("light >= 0.5", "not evaluated"),
        ("look", "feasible"),
    ]


def test_a_maximum_age_may_change_while_the_base_is_at_work(kb, clock):
    kb.measure("light", 0.1)
    clock.now += 6.0
    assert kb.is_feasible("look")
    light = kb.model.attributes["light"]
    kb.model.change(light, max_age=60.0)
    assert not kb.is_feasible("look")
    kb.model.change(light, max_age=1.0)
    assert kb.is_feasible("look")
    kb.model.change(light, when_stale="violated")
    assert not kb.is_feasible("look")


def test_stale_can_be_recorded_early():
    model = Model("m")
    light = model.environmental_attribute("light", max_age=5.0)
    model.action("look", constraints=[light >= 0.5])
    clock = Clock(0.0)
    kb = KnowledgeBase(model, clock=clock)
    kb.replay(Event(0, 0.0, "stale", ("light",)))
    assert not kb.attributes["light"].is_stale  # it was never measured
    kb.measure("light", 0.1)
    clock.now = 2.0
    for _ in range(2):
        kb.replay(Event(0, 2.0, "stale", ("light",)))
    assert [event.text for event in kb.log][1:] == [
        "light is stale: measured 2.0 s ago, and no more"
    ]
    assert kb.is_feasible("look")
    clock.now = 9.0
    kb.measure("light", 0.1)
    assert not kb.is_feasible("look")
