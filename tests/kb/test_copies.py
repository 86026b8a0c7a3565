"""What can be pickled and deep-copied, and that a knowledge base says why it cannot."""

import copy
import pickle

import pytest
from clocks import Clock
from kept import robot

from kb import KnowledgeBase, KnowledgeBaseError, PriorityPlanner


def again_by_pickle(value):
    return pickle.loads(pickle.dumps(value))  # its own


COPIES = pytest.mark.parametrize("again", [again_by_pickle, copy.deepcopy])


@pytest.fixture
def kb():
    base = KnowledgeBase(robot(), clock=Clock(1.0))
    base.measure("light", 0.8)
    base.measure("energy", 0.9)
    base.request_action("explore", {"energy": 2.0})
    base.request_action("rest")
    PriorityPlanner().plan(base)
    return base


@COPIES
def test_copied_model_is_equal_and_works(kb, again):
    model = again(kb.model)
    assert [str(bound) for bound in model.constraints] == list(map(str, kb.model.constraints))
    base = KnowledgeBase(model, clock=Clock(1.0))
    base.measure("light", 0.3)
    assert base.selectable_configurations("camera") == ("night",)
    model.action("film", requires=["see"])
    assert "film" not in kb.model.actions


@COPIES
def test_copied_situation_answers_the_same_alone(kb, again):
    situation = kb.situation(light=0.3)
    other = again(situation)
    kb.component_failed("camera")
    for question in ("selectable_actions", "adaptable_functions", "obsolete"):
        assert getattr(other, question)() == getattr(situation, question)()
    assert other.why("explore") == situation.why("explore")
    assert other.best_configuration("explore") == situation.best_configuration("explore")
    assert other.configurations["day"].status == "unfeasible"


@COPIES
def test_copied_view_shows_what_was_known_then(kb, again):
    views = (kb.actions["explore"], kb.components["camera"], kb.attributes["light"])
    action, component, attribute = again(views)
    kb.measure("light", 0.0)
    kb.component_failed("camera")
    assert (action.status, component.status, attribute.value) == ("unsolved", "unsolved", 0.8)


@COPIES
def test_copied_events_and_plans_say_the_same(kb, again):
    events = again(list(kb.log))
    assert [event.to_json() for event in events] == [event.to_json() for event in kb.log]
    assert [event.text for event in events] == [event.text for event in kb.log]
    assert str(again(kb.latest_plan)) == str(kb.latest_plan)
    assert again(kb.required_actions)[0].preference == {"energy": 2.0}


@COPIES
def test_knowledge_base_says_why_it_is_not_copied(kb, again):
    with pytest.raises(KnowledgeBaseError, match=r"kb\.situation\(\)"):
        again(kb)
