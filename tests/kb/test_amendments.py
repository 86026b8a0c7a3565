"""A model may be amended while a knowledge base is at work on it: the next question sees it."""

import copy
import gc
import json
import weakref

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from interrupting import interrupted_at
from kept import answers
from models import (
    NUMBERS,
    OPERATORS,
    RANDOMS,
    Clock,
    Twins,
    compare,
    events,
    models,
    mostly_some,
)

from kb import Event, KnowledgeBase, Model, ModelError

SLOW = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much]


def rover():
    model = Model("rover")
    light = model.environmental_attribute("light")
    camera = model.component("camera")
    camera.configuration("day", {"exposure": 0.01}, priority=1, constraints=[light >= 0.5])
    camera.configuration("night", {"exposure": 0.2}, priority=2)
    see = model.function("see")
    see.design("by camera", [camera], priority=1)
    model.action("explore", requires=[see], constraints=[light >= 0.1])
    return model


@pytest.fixture
def kb():
    return KnowledgeBase(rover(), clock=Clock(1.0))


def growth(chance, model):
    """Return a function that declares one more element, of a new name."""
    name = f"new {chance.random()}"
    attribute = chance.choice(list(model.attributes.values()))
    own = [compare(attribute, chance.choice(OPERATORS), chance.choice(NUMBERS))]
    functions = list(model.functions.values())
    components = list(model.components.values())
    parts = mostly_some(chance, model.components)
    options = [
        lambda: model.action(name, requires=mostly_some(chance, model.functions), constraints=own),
        lambda: model.component(name, constraints=own),
    ]
    if functions:
        options.append(lambda: chance.choice(functions).design(name, parts, constraints=own))
    if components:
        options.append(lambda: chance.choice(components).configuration(name, constraints=own))
        options.append(lambda: model.constrain([chance.choice(components)], own[0]))
    return chance.choice(options)


def change(chance, model):
    """Return a function that changes an element that is there."""
    choices = {
        **dict.fromkeys(model.attributes.values(), ("max_age", (1.0, 3.0, float("inf")))),
        **dict.fromkeys(model.constraints, ("value", NUMBERS)),
        **dict.fromkeys(model.components.values(), ("always_improve", (False, True))),
        **dict.fromkeys(model.designs.values(), ("priority", (None, 0, 3))),
    }
    element, (field, values) = chance.choice(list(choices.items()))
    return lambda: model.change(element, **{field: chance.choice(values)})


def amend(twins, data):
    chance = data.draw(RANDOMS)
    kind = chance.choice((growth, change))
    amendment = kind(chance, twins.model)
    try:
        amendment()
    except ModelError:
        assert kind is not change


@settings(suppress_health_check=SLOW)
@given(models(aging=True), st.data())
def test_amended_base_answers_as_its_twin_and_its_replay(model, data):
    clock = Clock(0.0)
    again = KnowledgeBase(copy.deepcopy(model), clock=clock)
    twins = Twins(model)
    for _ in range(data.draw(st.integers(1, 10))):
        if data.draw(st.booleans()):
            amend(twins, data)
        else:
            twins.happen(data.draw(events(model)))
        twins.agree()
    for event in twins.kb.log:
        clock.now = event.time
        again.replay(Event.from_json(json.loads(json.dumps(event.to_json()))))
    clock.now = twins.clock.now
    assert again.model == model
    assert answers(again) == answers(twins.kb)


@pytest.mark.parametrize("place", range(1, 640, 9))
def test_interrupted_amendment_is_in_or_out(kb, place):
    kb.measure("light", 0.05)
    bright = kb.model.attributes["light"] >= 0.2
    interrupted_at(place, lambda: kb.model.action("film", constraints=[bright]))
    _ = kb.revision  # completes what was interrupted
    is_in = "film" in kb.model.actions
    assert [event.verb for event in kb.log] == ["measure", *["amend"] * is_in]
    assert {name: view.status for name, view in kb.actions.items()} == dict.fromkeys(
        kb.model.actions, "unfeasible"
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"priority": "high"}, "the priority of 'day' is a finite number"),
        (
            {"component": "lidar"},
            "'component' of configuration 'day' cannot change; what can: parameters, priority",
        ),
        ({"priority": 3, "parameters": {"exposure": object()}}, "allowed are a boolean"),
    ],
)
def test_a_change_that_is_refused_changes_nothing(kb, change, words):
    before = KnowledgeBase(kb.model).configurations["day"]
    kept = (before.priority, dict(before.parameters), before.component)
    with pytest.raises(ModelError, match=words):
        kb.model.change(kb.model.configurations["day"], **change)
    view = kb.configurations["day"]
    assert (view.priority, dict(view.parameters), view.component) == kept


def test_a_model_holds_no_knowledge_base_alive():
    model = rover()
    base = KnowledgeBase(model)
    gone = weakref.ref(base)
    del base
    gc.collect()
    assert gone() is None
    model.action("rest")
