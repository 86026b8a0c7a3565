"""What if: a situation answers as if its assumptions were facts, which stay as they are."""

import copy

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from models import NUMBERS, RANDOMS, Clock, Twins, events, some_of, stories

from kb import InvalidValue, KnowledgeBase, Model, UnknownName

SLOW = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much]


@pytest.fixture
def clock():
    return Clock(1.0)


@pytest.fixture
def kb(clock):
    model = Model("rover")
    light = model.environmental_attribute("light")
    energy = model.quality_attribute("energy left")
    camera = model.component("camera")
    camera.configuration("day", priority=1, constraints=[light >= 0.5])
    camera.configuration("night", priority=2, constraints=[light >= 0.1])
    lidar = model.component("lidar", constraints=[energy >= 0.3])
    see = model.function("see")
    see.design("by camera", [camera], priority=1)
    see.design("by lidar", [lidar], priority=2)
    model.action("explore", requires=[see])
    model.action("rest")
    return KnowledgeBase(model, clock=clock)


def assumptions(model):
    return RANDOMS.map(
        lambda chance: {
            "measured": {
                name: chance.choice((None, *NUMBERS))
                for name in some_of(chance, model.attributes, 0, 2)
            },
            "failed": some_of(chance, model.components, 0, 2),
            "recovered": some_of(chance, model.components, 0, 2),
            "requested": some_of(chance, model.actions, 0, 2),
        }
    )


def supposed(naive, assumed):
    """The naive twin after what is assumed really happened."""
    twin = copy.copy(naive)
    for facts in (
        "value",
        "time",
        "failed",
        "asserted",
        "open_actions",
        "designs",
        "configurations",
        "active",
        "asserted_required",
    ):
        setattr(twin, facts, copy.copy(getattr(naive, facts)))
    for name, value in assumed["measured"].items():
        twin.value.pop(name, None)
        if value is not None:
            twin.value[name] = value
            twin.time[name] = naive.now
    twin.failed |= set(assumed["failed"])
    twin.failed -= set(assumed["recovered"])
    for name in assumed["recovered"]:
        if twin.asserted.get(("component", name)) == "failure":
            del twin.asserted["component", name]
    twin.open_actions |= set(assumed["requested"])
    return twin


def suppose(asked, assumed):
    rest = {key: value for key, value in assumed.items() if key != "measured"}
    return asked.situation(assumed["measured"], **rest)


@settings(suppress_health_check=SLOW)
@given(stories(aging=True), st.data())
def test_a_situation_answers_as_if_its_assumptions_were_facts(story, data):
    model, happenings = story
    twins = Twins(model, happenings)
    before = twins.statuses()
    first = data.draw(assumptions(model))
    second = data.draw(assumptions(model))
    situation = suppose(twins.kb, first)
    twins.agree(situation, supposed(twins.naive, first))
    nested = suppose(situation, second)
    twins.agree(nested, supposed(supposed(twins.naive, first), second))
    assert twins.statuses() == before
    twins.agree()


@settings(suppress_health_check=SLOW, max_examples=60)
@given(stories(max_size=8), st.data())
def test_situation_stays_what_it_was_when_its_base_learns(story, data):
    model, happenings = story
    twins = Twins(model, happenings)
    assumed = data.draw(assumptions(model))
    situation = suppose(twins.kb, assumed)
    naive = supposed(twins.naive, assumed)
    for event in data.draw(st.lists(events(model), max_size=5)):
        twins.happen(event)
        twins.agree(situation, naive)


def test_situation_is_of_the_model_as_it_was():
    model = Model("rover")
    light = model.quality_attribute("light")
    model.action("look", constraints=[light >= 0.5])
    situation = KnowledgeBase(model, clock=Clock()).situation(light=0.3)
    model.action("film", constraints=[light >= 0.2])
    assert situation.selectable_actions() == ()
    assert not situation.is_feasible("look")


def test_situation_answers_feasibility_and_configuration(kb):
    kb.measure("light", 0.8)
    dark = kb.situation(light=0.3)
    assert kb.best_configuration("explore")[:2] == ({"see": "by camera"}, {"camera": "day"})
    assert dark.best_configuration("explore")[:2] == ({"see": "by camera"}, {"camera": "night"})
    assert dark.situation(failed=["camera"]).best_configuration("explore")[:2] == (
        {"see": "by lidar"},
        {},
    )
    night = dark.situation({"energy left": 0.1}, light=0.0)
    assert night.selectable_actions() == ("rest",)
    assert night.best_configuration("explore") is None
    assert kb.attributes["light"].value == 0.8
    assert dark.attributes["light"].value == 0.3
    assert "light 0 violates >= 0.1" in str(night.explain("explore"))


@pytest.mark.parametrize(
    ("wrong", "error", "words"),
    [
        ({"lihgt": 0.3}, UnknownName, "did you mean 'light'"),
        ({"light": "dark"}, InvalidValue, "light cannot be supposed to be 'dark'"),
        ({"light": float("nan")}, InvalidValue, "finite"),
        ({"failed": ["camrea"]}, UnknownName, "did you mean 'camera'"),
        ({"requested": ["sleep"]}, UnknownName, "unknown action 'sleep'"),
    ],
)
def test_what_cannot_be_supposed_is_refused(kb, wrong, error, words):
    with pytest.raises(error, match=words):
        kb.situation(**wrong)
