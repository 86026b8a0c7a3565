"""Actions that have to stay feasible for as long as they take, as far as is known."""

import pytest
from acting import Act, Clock
from py_trees.behaviours import Success
from py_trees.common import Status
from xml_leaves import wrapped

from kb import KnowledgeBase, Model
from rosa_bt import (
    BehaviourRegistry,
    IsActionFeasible,
    TreeChangeError,
    export_xml,
    feasible_then_act,
    first_feasible,
    load_xml,
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
        doing = [one.action for one in kb.required_actions]
        slopes = {one.while_: one.per_s for one in kb.model.attributes["energy"].rates}
        change = sum(slopes.get(one, 0.0) for one in doing)
        kb.measure("energy", min(1.0, max(0.0, kb.attributes["energy"].value + change)))
        tree.tick_once()


def doing(kb):
    return [one.action for one in kb.required_actions]


def test_action_that_would_not_stay_feasible_as_long_as_it_takes_is_not_begun(kb):
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


def test_what_is_begun_needs_only_what_is_left_of_its_time(kb, clock):
    kb.measure("energy", 0.5)
    tree = feasible_then_act(Act(kb, "inspect"), during=20.0)
    tree.tick_once()
    for _ in range(24):
        live(kb, clock, tree, 1)
        assert doing(kb) == ["inspect"]  # it is not given up for a second 20 s that nobody needs
    live(kb, clock, tree, 3)
    assert not kb.is_feasible("inspect")
    assert doing(kb) == []


def test_first_task_that_can_be_finished_is_done(kb):
    kb.measure("energy", 0.4)
    tree = first_feasible("one", [Act(kb, "inspect"), Act(kb, "charge")], during=20.0)
    tree.tick_once()
    assert doing(kb) == ["charge"]
    with pytest.raises(TreeChangeError, match="not a RosaAction"):
        first_feasible("one", [Success("work")], during=20.0)


def test_a_file_says_how_long_an_action_takes(kb):
    kb.measure("energy", 0.4)
    text = wrapped(
        '<Fallback><IsActionFeasible action="inspect" during="20"/><IsActionFeasible action="search" during="10"/>'
        "</Fallback>"
    )
    root = load_xml(text, BehaviourRegistry(kb=kb))
    root.tick_once()
    found = [one.status for one in root.iterate() if isinstance(one, IsActionFeasible)]
    assert found == [Status.FAILURE, Status.SUCCESS]
    again = load_xml(export_xml(root), BehaviourRegistry(kb=kb))
    assert [one.during for one in again.iterate() if isinstance(one, IsActionFeasible)] == [
        20.0,
        10.0,
    ]
    written = export_xml(IsActionFeasible("can?", kb, "inspect", during=2.5))
    alone = load_xml(written, BehaviourRegistry(kb=kb))
    assert [one.during for one in alone.iterate() if isinstance(one, IsActionFeasible)] == [2.5]
