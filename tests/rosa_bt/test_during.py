"""Actions that have to stay feasible for as long as they take, as far as is known."""

import pytest
from acting import Act, Clock
from py_trees.common import Status

from kb import KnowledgeBase, Model
from rosa_bt import (
    IsActionFeasible,
    feasible_then_act,
)


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def kb(clock):
    model = Model("drone")
    energy = model.quality_attribute("energy", low=0.0, high=1.0)
    for action in ("inspect", "search"):
        model.action(action, constraints=[energy >= 0.25])
        energy.changes(-0.01, while_=action)
    model.action("charge")
    energy.changes(0.05, while_="charge")
    return KnowledgeBase(model, clock=clock)


def live(kb, clock, tree, seconds):
    """Tick once a second while the battery does as its model says."""
    for _ in range(seconds):
        clock.now += 1.0
        doing = [action.action for action in kb.required_actions]
        slopes = {rate.while_: rate.per_s for rate in kb.model.attributes["energy"].rates}
        change = sum(slopes.get(one, 0.0) for one in doing)
        kb.measure("energy", min(1.0, max(0.0, kb.attributes["energy"].value + change)))
        tree.tick_once()


def doing(kb):
    return [action.action for action in kb.required_actions]


def test_action_that_would_be_cut_off_is_not_begun(kb):
    kb.measure("energy", 0.4)
    condition = IsActionFeasible("can?", kb, "inspect", during=20.0)
    condition.tick_once()
    assert condition.status is Status.FAILURE
    assert condition.feedback_message.startswith(
        "inspect takes 20 s and is unfeasible in 15 s (how exactly is not known): energy falls"
    )
    assert kb.is_feasible("inspect")
    shorter = IsActionFeasible("can?", kb, "inspect", during=14.0)
    shorter.tick_once()
    assert shorter.status is Status.SUCCESS
    assert shorter.feedback_message == ""


def test_running_action_needs_what_is_left_of_its_time(kb, clock):
    kb.measure("energy", 0.5)
    tree = feasible_then_act(Act(kb, "inspect"), during=20.0)
    tree.tick_once()
    for _ in range(24):
        live(kb, clock, tree, 1)
        assert doing(kb) == ["inspect"]  # it is not given up for a second 20 s that nobody needs
    live(kb, clock, tree, 3)
    assert not kb.is_feasible("inspect")
    assert doing(kb) == []
