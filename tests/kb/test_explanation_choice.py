"""Why this design or configuration and not that one."""

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from models import Clock, Twins, state_of, stories

from kb import KnowledgeBase, Model, PriorityPlanner, Status
from kb.explanation import explain_choice
from kb.planning import by_priority
from kb.views import FunctionView

SLOW = settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])


def choice_of(kb, node):
    return explain_choice(state_of(kb), node, kb._clock())


@SLOW
@given(stories(max_size=20))
def test_every_choice_is_the_one_selected_or_else_the_first_by_priority(story):
    model, happenings = story
    twins = Twins(model)
    for event in happenings:
        twins.happen(event)
    state, network = state_of(twins.kb), state_of(twins.kb).network
    choices = [*network.functions.values(), *network.components.values()]
    assume(choices)
    for node in choices:
        explained = explain_choice(state, node, 0.0)
        possible = [part for part in node.requires if state.status[part] is not Status.UNFEASIBLE]
        selected = [part.name for part in node.requires if part in state.selected]
        first = min((part.element for part in possible), key=by_priority, default=None)
        assert explained.is_selected is bool(selected)
        assert explained.chosen in (selected or [first and first.name])
        names = [alternative.name for alternative in explained.alternatives]
        assert sorted(names) == sorted({part.name for part in node.requires} - {explained.chosen})
        for alternative in explained.alternatives:
            part = next(part for part in node.requires if part.name == alternative.name)
            assert alternative.status is state.status[part]
            assert alternative.priority == part.element.priority
            told = alternative.reason.startswith("it is unfeasible because ")
            assert told is (part not in possible)
        text = str(explained)
        assert "  " not in text
        assert all(name in text for name in names)


@SLOW
@given(stories(max_size=20, asserting=False))
def test_what_is_said_to_be_selected_next_is_what_the_planner_selects(story):
    model, happenings = story
    twins = Twins(model)
    for event in happenings:
        twins.happen(event)
    kb = twins.kb
    whole = [*kb.functions.values(), *kb.components.values()]
    said = {(one.element.__class__, one.name): kb.explain_choice(one) for one in whole}
    PriorityPlanner().plan(kb)
    for one in whole:
        is_function = isinstance(one, FunctionView)
        options = kb.designs if is_function else kb.configurations
        names = [
            option
            for option in (one.designs if is_function else one.configurations)
            if options[option].is_selected
        ]
        promised = [
            part.name
            for part in said[one.element.__class__, one.name].alternatives
            if part.reason == "it is to be selected next"
        ]
        assert all(name in names for name in promised)


def test_a_component_is_chosen_for_after_the_designs_are():
    model = Model("two ways")
    charge = model.quality_attribute("charge")
    arm, tool, hook = model.component("arm"), model.component("tool"), model.component("hook")
    arm.configuration("fine", priority=1, constraints=[charge >= 1])
    arm.configuration("coarse", priority=2)
    grasp = model.function("grasp")
    grasp.design("by arm", [arm, tool], priority=1)
    grasp.design("by hook", [hook], priority=2)
    model.action("fetch", requires=[grasp])
    kb = KnowledgeBase(model, clock=Clock())
    before = kb.request_action("fetch") and kb.explain_choice(kb.components["arm"])
    assert str(before).startswith(
        "fine would be selected for component arm because priority number 1 is the lowest"
    )
    plan = PriorityPlanner().plan(kb)
    assert plan.parameters == ("fine",)
    kb.component_failed("tool")
    kb.measure("charge", 0)
    told = kb.explain_choice(kb.components["arm"])
    assert "it was possible before" in told.reason
    assert reasons(told) == {
        "coarse": "nothing new is selected for the component, whose status is configuration error"
    }
    PriorityPlanner().plan(kb)
    assert kb.components["arm"].selected_configuration != "coarse"


@pytest.fixture
def model():
    model = Model("rover")
    light = model.environmental_attribute("light")
    camera = model.component("camera")
    camera.configuration("day", priority=1, constraints=[light >= 0.5])
    camera.configuration("dusk", priority=2)
    camera.configuration("night", priority=2)
    camera.configuration("any")
    see = model.function("see")
    see.design("by camera", [camera], priority=1)
    see.design("by touch", [], priority=3)
    model.action("look", requires=[see])
    return model


@pytest.fixture
def kb(model):
    return KnowledgeBase(model, clock=Clock())


@pytest.fixture
def see(kb):
    return state_of(kb).network.functions["see"]


@pytest.fixture
def camera(kb):
    return state_of(kb).network.components["camera"]


def reasons(explained):
    return {one.name: one.reason for one in explained.alternatives}


def test_what_nothing_requires_is_told_as_what_would_be_selected(kb, see):
    assert str(choice_of(kb, see)) == (
        "by camera would be selected for function see because priority number 1 is the lowest of those that are "
        "feasible; nothing requires the function now; not by touch: it has priority number 3, which comes "
        "after 1"
    )


def test_a_rival_is_unfeasible_or_comes_later_by_priority_or_by_name(kb, camera):
    kb.measure("light", 0.3)
    explained = choice_of(kb, camera)
    assert (explained.chosen, explained.is_selected) == ("dusk", False)
    assert explained.reason.startswith("of those with priority number 2 it comes first by name")
    assert reasons(explained) == {
        "day": "it is unfeasible because light 0.3 violates >= 0.5 (measured 0.0 s ago)",
        "night": "it has priority number 2 too, and comes after dusk by name",
        "any": "it has no priority number, which comes after 2",
    }


def works_at_night(kb):
    kb.measure("light", 0.3)
    kb.request_action("look")
    kb.select({"see": "by camera"}, {"camera": "dusk"})
    kb.component_active("camera", True)
    kb.measure("light", 0.7)


def test_what_works_is_kept_unless_it_is_to_be_improved(kb, camera, model):
    works_at_night(kb)
    explained = choice_of(kb, camera)
    assert (explained.chosen, explained.is_selected) == ("dusk", True)
    assert explained.reason == "it was preferred before"
    assert (
        reasons(explained)["day"]
        == "nothing new is selected for the component, whose status is solved"
    )
    model.change(model.components["camera"], always_improve=True)
    assert reasons(choice_of(kb, camera))["day"] == "it is to be selected next"


def test_what_was_selected_and_became_unfeasible_is_replaced_next(kb, camera):
    works_at_night(kb)
    kb.select({}, {"camera": "day"})
    kb.measure("light", 0.1)
    explained = choice_of(kb, camera)
    assert explained.chosen == "day"
    assert explained.reason == (
        "it was possible before; now day is unfeasible because light 0.1 violates >= 0.5 (measured 0.0 s ago)"
    )
    assert reasons(explained)["dusk"] == "it is to be selected next"


def test_the_only_one_is_told_to_be_that(kb, see, camera):
    kb.component_failed("camera")
    kb.request_action("look")
    explained = choice_of(kb, see)
    assert str(explained) == (
        "by touch would be selected for function see because no other design is feasible; not by camera: it is "
        "unfeasible because component camera has failed"
    )
    kb.select({"see": "by touch"})
    assert str(choice_of(kb, see)).startswith("by touch is selected for function see because")


def test_where_nothing_can_be_chosen_the_reason_is_told():
    model = Model("none")
    light = model.environmental_attribute("light")
    camera = model.component("camera")
    camera.configuration("day", constraints=[light >= 0.5])
    model.component("lamp")
    model.function("dream")
    kb = KnowledgeBase(model, clock=Clock())
    kb.measure("light", 0.0)
    network = state_of(kb).network
    assert str(choice_of(kb, network.functions["dream"])) == (
        "nothing can be selected for function dream because it has no design"
    )
    assert str(choice_of(kb, network.components["lamp"])) == (
        "nothing can be selected for component lamp because it has no configuration"
    )
    assert str(choice_of(kb, network.components["camera"])) == (
        "nothing can be selected for component camera because each configuration of it is unfeasible; not day: "
        "it is unfeasible because light 0 violates >= 0.5 (measured 0.0 s ago)"
    )


@SLOW
@given(st.lists(st.none() | st.sampled_from((0, 1, 2, 0.5, -1.25, 1.0)), min_size=1, max_size=4))
def test_who_comes_first_follows_from_the_reasons_alone(priorities):
    model = Model("one")
    see = model.function("see")
    for number, priority in enumerate(priorities):
        see.design(f"d{number}", [], priority=priority)
    kb = KnowledgeBase(model)
    explained = choice_of(kb, state_of(kb).network.functions["see"])
    best = model.designs[explained.chosen].priority
    for one in explained.alternatives:
        if one.priority == best:
            assert one.reason.endswith(f"too, and comes after {explained.chosen} by name")
            assert one.name > explained.chosen
        else:
            assert one.reason.endswith(f"which comes after {best}")
            assert best is not None
            assert one.priority is None or one.priority > best
