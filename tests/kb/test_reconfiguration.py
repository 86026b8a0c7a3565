"""Laws of selecting and of reconfiguration plans, against the naive twin."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from models import Clock, Twins, carry_out, choices, stories

from kb import KnowledgeBase, Model, Status

slow_to_generate = settings(
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large], max_examples=60
)


def lived(story):
    model, happenings = story
    return Twins(model, happenings)


def check_selected(kb, designs, configurations):
    """Assert that what is chosen is the only one selected of its function or component."""
    for function, chosen in designs.items():
        of_it = [
            design.name
            for design in kb.designs.values()
            if design.function == function and design.is_selected
        ]
        assert of_it == ([chosen] if kb.functions[function].is_required else [])
    for component, chosen in configurations.items():
        of_it = [
            configuration.name
            for configuration in kb.configurations.values()
            if configuration.component == component and configuration.is_selected
        ]
        assert of_it in ([chosen], [])


def check_sound(model, plan):
    """Assert that a plan is not empty and contradicts itself in nothing."""
    assert plan.activate or plan.deactivate or plan.parameters
    assert not set(plan.activate) & set(plan.deactivate)
    components = [model.configurations[name].component for name in plan.parameters]
    assert len(set(components)) == len(components)


def check_reached(twins):
    """Assert that the components are in the state that is selected."""
    needed = twins.naive.needed_components()
    for name in needed:
        assert twins.kb.components[name].is_active, name
    assert not twins.kb.obsolete().components
    assert not twins.kb.obsolete().designs
    assert not twins.kb.obsolete().configurations


@slow_to_generate
@given(stories(), st.data())
def test_executed_plan_leads_to_the_selected_state(story, data):
    twins = lived(story)
    designs, configurations = twins.possible(data.draw(choices(twins.model)))
    replaced = {
        part
        for name, design in twins.model.designs.items()
        if name in twins.naive.designs and designs.get(design.function, name) != name
        for part in design.components
    }
    plan = twins.kb.select(designs, configurations)
    twins.naive.select(designs, configurations)
    check_selected(twins.kb, designs, configurations)
    for one in twins.kb.plans:
        check_sound(twins.model, one)
    if plan is not None:
        twins.carry_out(plan)
        assert twins.kb.finish_plan(plan, "completed")
    check_reached(twins)
    for name in replaced - twins.naive.needed_components():
        assert not twins.kb.components[name].is_active
    assert twins.kb.select(designs, configurations) is None
    assert twins.kb.select() is None
    twins.agree()


@slow_to_generate
@given(stories(max_size=25))
def test_a_plan_that_completes_leaves_no_older_plan_open(story):
    twins = lived(story)
    for event in story[1]:
        before = [plan for plan in twins.kb.plans if plan.end is None]
        assert twins.kb.pending_plan is (before[-1] if before else None)
        twins.happen(event)
        completed = [plan for plan in before if plan.result == "completed"]
        if completed:
            assert {plan.result for plan in before} <= {"completed", "abandoned"}
        for plan in twins.kb.plans:
            assert (plan.end is None) is (plan.result is None)
            assert plan.end is None or plan.start <= plan.end <= twins.clock.now


@pytest.fixture
def clock():
    return Clock(10.0)


@pytest.fixture
def rover():
    """Two ways to see that share a driver; one has a configurable camera."""
    model = Model("rover")
    light = model.environmental_attribute("light")
    camera = model.component("camera", kind="lifecycle")
    camera.configuration("day", {"exposure": 0.01}, priority=1, constraints=[light >= 0.5])
    camera.configuration("night", {"exposure": 0.2}, priority=2)
    model.component("lidar", kind="process")
    model.component("driver", kind="process")
    see = model.function("see")
    see.design("by camera", ["camera", "driver"], priority=1)
    see.design("by lidar", ["lidar", "driver"], priority=2)
    model.action("explore", requires=[see])
    return model


@pytest.fixture
def kb(rover, clock):
    return KnowledgeBase(rover, clock=clock)


def test_component_of_both_designs_is_kept(kb):
    kb.request_action("explore")
    carry_out(kb, kb.select({"see": "by camera"}, {"camera": "day"}))
    plan = kb.select({"see": "by lidar"})
    assert (plan.activate, plan.deactivate, plan.parameters) == (("lidar",), ("camera",), ())
    carry_out(kb, plan)
    assert [component.name for component in kb.components.values() if component.is_active] == [
        "lidar",
        "driver",
    ]
    assert kb.actions["explore"].status is Status.SOLVED


def test_a_plan_that_fails_leaves_the_older_ones_open(kb):
    kb.request_action("explore")
    first = kb.select({"see": "by lidar"})
    second = kb.select({"see": "by camera"})
    kb.finish_plan(second, "failed")
    assert first.result is None
    assert kb.pending_plan is first


def test_a_plan_ends_once(kb, clock):
    kb.request_action("explore")
    plan = kb.select({"see": "by lidar"})
    assert kb.finish_plan(plan, "completed") is True
    clock.now += 5
    assert kb.finish_plan(plan, "failed") is False
    assert (plan.result, plan.end) == ("completed", clock.now - 5)
