"""Which choices the planners make, and what a choice changes."""

import pytest

from kb import KnowledgeBase, Model, OptimalPlanner, PriorityPlanner

PLANNERS = [PriorityPlanner(), OptimalPlanner()]


def switching_rover():
    """Return a rover that sees by a camera, which is asserted required and can be improved."""
    model = Model("rover")
    light = model.quality_attribute("light")
    model.quality_attribute("power")
    camera = model.component("camera", kind="lifecycle", always_improve=True)
    camera.configuration("fine", {"width": 9}, priority=1)
    camera.configuration("coarse", {"width": 3}, priority=2)
    lidar = model.component("lidar", kind="lifecycle")
    see = model.function("see")
    see.design("by camera", [camera], priority=1, constraints=[light >= 0.5])
    see.design("by lidar", [lidar], priority=2)
    model.action("explore", requires=[see])
    kb = KnowledgeBase(model, clock=lambda: 0.0)
    kb.request_action("explore")
    plan = kb.select({"see": "by camera"}, {"camera": "coarse"})
    kb.component_active("camera", True)
    kb.finish_plan(plan, "completed")
    kb.assert_required("camera", True)
    return kb


@pytest.mark.parametrize("planner", PLANNERS, ids=["priority", "optimal"])
def test_no_configuration_is_chosen_for_what_is_given_up(planner):
    kb = switching_rover()
    kb.measure("light", 0.1)
    choice = planner.choose(kb)
    plan = kb.select(*choice)
    assert plan.deactivate == ("camera",)
    assert dict(choice.designs) == {"see": "by lidar"}
    assert dict(choice.configurations) == {}
    assert plan.parameters == ()


def test_decision_changes_nothing_and_names_all_that_follows():
    kb = switching_rover()
    before = kb.log.last
    with kb.reading() as state:
        chosen = [state.network.designs["by lidar"]]
        flips, plan = state.decide(chosen)
        assert [node.name for node in flips] == ["by camera", "by lidar"]
    assert (plan.activate, plan.deactivate) == (("lidar",), ("camera",))
    assert kb.log.last == before
    assert kb.designs["by camera"].is_selected


def test_choice_of_what_nothing_requires_is_not_selected():
    kb = switching_rover()
    kb.cancel_action("explore")
    plan = kb.select({"see": "by lidar"}, {"camera": "fine"})
    assert (plan.activate, plan.deactivate, plan.parameters) == ((), ("camera",), ())
    assert not any(view.is_selected for view in (*kb.designs.values(), *kb.configurations.values()))
