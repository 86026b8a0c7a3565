"""A measurement can grow too old; what it counts as then is the model's to say."""

import math

import pytest
from hypothesis import HealthCheck, given, settings
from models import Clock, Twins, stories

from kb import Event, KnowledgeBase, Model, ModelError, Status, UnknownName

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


@settings(suppress_health_check=SLOW)
@given(stories(aging=True))
def test_as_time_passes_the_quick_engine_answers_as_the_naive_twin_does(story):
    model, happenings = story
    twins = Twins(model)
    for event in happenings:
        twins.happen(event)
        twins.agree()
        twins.pass_time(0.5)
        twins.agree()
    twins.pass_time(10.0)
    twins.agree()


def test_a_stale_measurement_counts_as_not_measured(kb, clock):
    kb.measure("light", 0.1)
    clock.now += 5.0
    assert not kb.is_feasible("look")
    clock.now += 0.1
    assert kb.is_feasible("look")
    assert kb.actions["look"].constraints[0].status is Status.NOT_EVALUATED
    light = kb.attributes["light"]
    assert (light.value, light.time, light.is_stale, light.max_age) == (0.1, 100.0, True, 5.0)


def test_a_stale_measurement_counts_as_violated_where_the_model_says_so(kb, clock):
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
    assert [(one.name, one.new) for one in event.changes] == [
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


def test_a_situation_supposes_a_fresh_measurement(kb, clock):
    kb.measure("gas", 0.0)
    clock.now += 3.0
    assert kb.situation(gas=0.05).is_feasible("enter")
    assert not kb.is_feasible("enter")


@pytest.mark.parametrize("age", [0, -1.0, float("nan"), "long", True, None])
def test_a_maximum_age_is_a_time_above_zero(age):
    with pytest.raises(ModelError, match="max_age of 'light' is a time in seconds above 0"):
        Model("rover").quality_attribute("light", max_age=age)


def test_an_unknown_policy_is_refused():
    with pytest.raises(UnknownName, match="did you mean 'violated'"):
        Model("rover").quality_attribute("light", max_age=1.0, when_stale="violatd")


def test_what_is_measured_no_more_can_be_told_to_be_stale_and_replay_knows_it():
    def outlived(max_age):
        model = Model("m")
        light = model.environmental_attribute("light", max_age=max_age)
        model.action("look", constraints=[light >= 0.5])
        now = [0.0]
        kb = KnowledgeBase(model, clock=lambda: now[0])
        kb.replay(Event(0, 0.0, "stale", ("light",)))
        assert not kb.attributes["light"].is_stale, "it was never measured"
        return kb, now

    for max_age in (math.inf, 5.0):
        kb, now = outlived(max_age)
        kb.measure("light", 0.1)
        now[0] = 2.0
        for _ in range(2):
            kb.replay(Event(0, 2.0, "stale", ("light",)))
        (stale,) = [one for one in kb.log if one.verb == "stale"]
        assert (stale.time, stale.text) == (2.0, "light is stale: measured 2.0 s ago, and no more")
        (enough,) = kb.actions["look"].constraints
        assert enough.status == "not evaluated"
        assert "light 0.1 is stale: measured 2.0 s ago, and no more" in str(kb.explain(enough))
        now[0] = 9.0
        again, shown = outlived(max_age)
        for event in kb.log:
            shown[0] = max(shown[0], event.time)
            again.replay(event)
        assert [one.text for one in again.log] == [one.text for one in kb.log]
        kb.measure("light", 0.9)
        assert enough.status == "satisfied"
    with pytest.raises(UnknownName, match="light"):
        kb.replay(Event(0, 9.0, "stale", ("lihgt",)))
