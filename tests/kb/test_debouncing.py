"""Constraints that do not flap: hysteresis, dwell, and n of the last k measurements."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from models import Clock, compare

from kb import EventKind, KnowledgeBase, Model, PriorityPlanner, Status


def rover(*, operator=">=", hysteresis=0.0, dwell=0.0, agreement=(1, 1)):
    model = Model("rover")
    light = model.environmental_attribute("light", agreement=agreement)
    bound = compare(light, operator, 0.5).steady(hysteresis=hysteresis, dwell=dwell)
    camera = model.component("camera", always_improve=True)
    camera.configuration("day", priority=1, constraints=[bound])
    camera.configuration("night", priority=2)
    see = model.function("see")
    see.design("by camera", [camera])
    model.action("explore", requires=[see])
    return model


def status(kb):
    return kb.configurations["day"].constraints[0].status


def test_measurements_that_vote_are_kept_though_fewer_are_to_be():
    kb = KnowledgeBase(rover(agreement=(2, 3)), clock=Clock(0.0), keep=1)
    kb.measure("light", 0.1)
    kb.measure("light", 0.1)
    assert status(kb) is Status.VIOLATED


@given(
    st.lists(st.tuples(st.floats(0.0, 2.0), st.floats(0.0, 1.0)), min_size=2, max_size=60),
    st.floats(0.5, 5.0),
)
def test_noise_switches_at_most_once_a_dwell(noise, dwell):
    clock = Clock(0.0)
    kb = KnowledgeBase(rover(dwell=dwell), clock=clock)
    changes = []
    plans = []
    kb.subscribe(
        lambda event: changes.extend(
            change for change in event.changes if change.kind == "constraint"
        )
    )
    kb.subscribe(
        lambda event: plans.append(event) if event.kind is EventKind.RECONFIGURATION_PLAN else None
    )
    planner = PriorityPlanner()

    def adapt():
        plan = planner.plan(kb)
        if plan is not None:
            for name in plan.activate:
                kb.component_active(name, True)
            kb.finish_plan(plan, "completed")

    kb.request_action("explore")
    kb.measure("light", 1.0)
    adapt()
    first_changes = len(changes)
    first_plans = len(plans)
    for pause, value in noise:
        clock.now += pause
        kb.measure("light", value)
        adapt()
    assert len(changes) - first_changes <= clock.now / dwell
    assert len(plans) - first_plans <= clock.now / dwell


def test_dwell_ends_by_itself():
    clock = Clock(0.0)
    kb = KnowledgeBase(rover(dwell=5.0), clock=clock)
    heard = []
    kb.measure("light", 0.4)
    clock.now = 2.0
    kb.measure("light", 0.9)
    kb.subscribe(heard.append)
    clock.now = 4.9
    assert status(kb) is Status.VIOLATED
    assert str(kb.explain(kb.configurations["day"])) == (
        "day is unfeasible because light 0.9 satisfies >= 0.5 (measured 2.9 s ago), but it is "
        "debounced, and violated so far; it would be feasible with light >= 0.5"
    )
    clock.now = 5.0
    assert status(kb) is Status.SATISFIED
    assert [event.text for event in heard] == ["light >= 0.5 is satisfied, after its dwell"]


def test_threshold_and_hysteresis_add_up_as_on_paper():
    model = Model("rover")
    light = model.environmental_attribute("light")
    model.action("go", constraints=[(light >= 0.1).steady(hysteresis=0.2)])
    kb = KnowledgeBase(model, clock=Clock(0.0))
    kb.measure("light", 0.0)
    assert str(kb.explain("go")).endswith("it would be feasible with light >= 0.3")
    kb.measure("light", 0.3)
    assert kb.is_feasible("go")


def test_debouncing_can_be_changed_while_the_base_is_at_work():
    kb = KnowledgeBase(rover(), clock=Clock(0.0))
    kb.measure("light", 0.4)
    (bound,) = kb.model.constraints
    kb.model.change(bound, hysteresis=0.2)
    kb.measure("light", 0.6)
    assert status(kb) is Status.VIOLATED
    kb.model.change(bound, hysteresis=0.0)
    assert status(kb) is Status.SATISFIED
    kb.model.change(kb.model.attributes["light"], agreement=(2, 2))
    assert status(kb) is Status.NOT_EVALUATED
    kb.measure("light", 0.1)
    assert status(kb) is Status.NOT_EVALUATED
    kb.measure("light", 0.1)
    assert status(kb) is Status.VIOLATED
    steady = (kb.model.attributes["light"] <= 0.3).steady(dwell=1.0)
    kb.model.components["camera"].constrain(steady)
    kb.model.change(kb.model.attributes["light"], agreement=(1, 1))
    assert kb.components["camera"].constraints[0].status is Status.SATISFIED


@pytest.mark.parametrize(
    ("agreement", "steady"),
    [((2, 3), {}), ((1, 1), {"dwell": 10.0}), ((1, 1), {"hysteresis": 0.2})],
)
def test_violation_after_silence_never_satisfies(agreement, steady):
    clock = Clock(0.0)
    model = Model("lamp")
    light = model.quality_attribute(
        "light", max_age=2.0, when_stale="violated", agreement=agreement
    )
    model.action("go", constraints=[(light >= 0.5).steady(**steady)])
    kb = KnowledgeBase(model, clock=clock)
    for clock.now in (0.0, 0.5):
        kb.measure("light", 0.9)
    clock.now = 4.0
    assert not kb.is_feasible("go")
    for clock.now in (5.0, 6.0, 7.0):
        kb.measure("light", 0.1)
        assert not kb.is_feasible("go")
