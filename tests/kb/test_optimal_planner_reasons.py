"""What the planner of the best configuration says of its choices, and what the knowledge base says of them then."""

import logging

import pytest
from hypothesis import HealthCheck, assume, given, settings
from managed_stand_ins import Scripted
from models import Clock
from test_optimal_planner import COSTS, at_work, carried_out, criteria, robots

from kb import ConfigurationManager, KnowledgeBase, Model
from kb.optimal import OptimalPlanner

SLOW = settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
BEST = "of all choices this is the best for accuracy"
"""How the reason of a choice begins."""


@pytest.fixture
def model():
    model = Model("rover")
    model.quality_attribute("accuracy")
    model.quality_attribute("power")
    camera = model.component("camera", kind="lifecycle", always_improve=True)
    fine = camera.configuration("fine", priority=2)
    coarse = camera.configuration("coarse", priority=1)
    lidar = model.component("lidar", kind="process")
    see = model.function("see", always_improve=True)
    by_camera = see.design("by camera", [camera], priority=1)
    by_both = see.design("by both", [camera, lidar], priority=2)
    model.action("explore", requires=[see])
    by_camera.estimate("accuracy", 1.0)
    by_both.estimate("accuracy", 2.0)
    fine.estimate("accuracy", 0.5)
    coarse.estimate("accuracy", 0.2)
    fine.estimate("power", 30.0)
    coarse.estimate("power", 10.0)
    lidar.estimate("power", 25.0)
    return model


@SLOW
@given(robots(), criteria(), COSTS)
def test_optimal_choice_is_explained_by_its_reason(kb, criterion, cost):
    kb.cancel_action("x0")
    kb.cancel_action("x1")
    assume(kb.request_action("x0", criterion.weights))
    planner = OptimalPlanner(budgets=criterion.budgets, switching_cost=cost)
    adaptable = kb.adaptable_functions() or kb.adaptable_components()
    before = {
        one.name for one in (*kb.designs.values(), *kb.configurations.values()) if one.is_selected
    }
    planner.plan(kb)
    assume(adaptable and planner.latest)
    if planner.latest.choice is None:
        told = [
            str(kb.explain_choice(kb.functions[name])) for name in kb.model.actions["x0"].functions
        ]
        assert all(planner.latest.reason in one or "unfeasible" in one for one in told)
        assert not any(
            "priority number" in one or "it is to be selected next" in one for one in told
        )
        return
    designs, configurations, _ = planner.latest.choice
    assume(
        not before.issuperset([*designs.values(), *configurations.values()])
    )  # else nobody has selected anything
    for one in [*map(kb.functions.get, designs), *map(kb.components.get, configurations)]:
        explained = kb.explain_choice(one)
        assert explained.reason == planner.latest.reason
        assert "priority number" not in str(explained)
        for other in explained.alternatives:
            assert other.reason == "it is not part of that choice" or other.reason.startswith(
                "it is unfeasible"
            )


def test_plan_says_what_was_maximised_and_what_it_is_worth(model):
    kb, plan = at_work(model, OptimalPlanner())
    assert plan.reason == (
        f"function see is needed by explore; component camera is needed by explore; {BEST}, worth 2.5"
    )
    assert str(kb.explain_choice("see")) == (
        f"by both is selected for function see because {BEST}, worth 2.5; not by camera: it is not part of that choice"
    )


def test_too_small_budget_is_explained_everywhere(model, caplog):
    kb = KnowledgeBase(model, clock=Clock())
    planner = OptimalPlanner(budgets={"power": 5.0})
    manager = ConfigurationManager(kb, Scripted(kb._clock), planner=planner)
    kb.request_action("explore", "accuracy")
    with caplog.at_level(logging.WARNING):
        assert manager.update() is None
        kb.component_active("camera", True)
        assert manager.update() is None
    reason = "power would be 10 at least, more than 5"
    assert caplog.messages == [f"nothing can be selected: {reason}"]
    assert planner.latest.reason == reason
    told = kb.explain_choice("see")
    assert (told.chosen, told.is_selected) == (None, False)
    assert str(told).startswith(
        f"nothing can be selected for function see because {reason}; not by camera: "
    )
    assert "priority" not in str(kb.explain_choice("camera"))
    kb.cancel_action("explore")
    manager.update()
    assert str(kb.explain_choice("see")).startswith(
        "by camera would be selected for function see because priority"
    )


def test_plan_that_restarts_a_component_says_what_stopped(model):
    kb, _ = at_work(model, planner := OptimalPlanner())
    kb.component_active("lidar", False, "the process of lidar ended by itself")
    plan = carried_out(kb, planner)
    assert plan.activate == ("lidar",)
    assert plan.reason == "the process of lidar ended by itself; lidar is needed by explore"
    assert kb.designs["by both"].reason.startswith(BEST)
