"""What counts as an adaptation, and what is the ordinary course of a mission."""

import pytest

from kb import ConfigurationManager, KnowledgeBase, Model
from missions.adaptations import AdaptationLog


class Robot:
    def activate(self, component):
        pass

    deactivate = activate

    def set_parameters(self, component, parameters):
        pass


@pytest.fixture
def mission():
    """A robot that sees by camera or by lidar, for two actions that need no more than that, and one that needs none."""
    model = Model("rover")
    energy = model.quality_attribute("energy")
    see = model.function("see", always_improve=True)
    see.design("by_camera", [model.component("camera", kind="lifecycle")], priority=1)
    see.design("by_lidar", [model.component("lidar", kind="lifecycle")], priority=2)
    model.action("search", requires=[see], constraints=[energy >= 0.2])
    model.action("inspect", requires=[see], constraints=[energy >= 0.2])
    model.action("wait", requires=[see])
    return Mission(model)


class Mission:
    def __init__(self, model):
        self.now = 0.0
        self.kb = KnowledgeBase(model, clock=lambda: self.now)
        self.manager = ConfigurationManager(self.kb, Robot())
        self.log = AdaptationLog(self.kb)

    def turn(self):
        self.manager.update()
        self.log.settle()

    def hear(self, tell):
        self.log.news(self.now)
        tell()
        self.log.news(None)
        self.turn()

    def kinds(self):
        return [(one.kind, one.trigger) for one in self.log.adaptations]


def test_first_action_and_the_next_one_are_the_ordinary_course(mission):
    mission.kb.request_action("search")
    mission.turn()
    mission.kb.cancel_action("search", "completed")
    mission.kb.request_action("inspect")
    mission.turn()
    assert mission.log.adaptations == []


def test_failure_after_a_change_of_action_without_a_plan_is_a_structural_adaptation(mission):
    mission.kb.request_action("search")
    mission.turn()
    mission.kb.cancel_action("search", "completed")
    mission.kb.request_action("inspect")  # needs what search needed: nothing to reconfigure
    mission.turn()
    mission.hear(lambda: mission.kb.component_failed("camera"))
    assert mission.kinds() == [("structural", "camera has failed")]
    assert mission.log.adaptations[0].change == "stop camera; start lidar"


def test_news_that_calls_for_nothing_is_no_trigger_of_what_comes_later(mission):
    mission.kb.request_action("search")
    mission.turn()
    mission.hear(lambda: mission.kb.measure("energy", 0.9))  # a constraint is evaluated: a status changes, no plan
    mission.hear(lambda: mission.kb.component_failed("camera"))
    assert mission.kinds() == [("structural", "camera has failed")]


def test_action_given_up_for_another_and_taken_up_again_are_task_adaptations_even_without_a_plan(mission):
    mission.kb.request_action("inspect")
    mission.turn()
    mission.now = 5.0
    mission.hear(lambda: mission.kb.measure("energy", 0.1))
    mission.now = 5.1
    mission.log.ticking(5.1)
    mission.kb.cancel_action("inspect", "abandoned")
    mission.kb.request_action("wait")
    mission.turn()
    mission.now = 9.0
    mission.hear(lambda: mission.kb.measure("energy", 1.0))
    mission.now = 9.1
    mission.log.ticking(9.1)
    mission.kb.cancel_action("wait", "completed")
    mission.kb.request_action("inspect")
    mission.turn()
    assert mission.kinds() == [("task", "energy is 0.1"), ("task", "energy is 1")]
    assert [one.change for one in mission.log.adaptations] == ["inspect -> wait", "wait -> inspect"]
    assert [one.reaction_s for one in mission.log.adaptations] == pytest.approx([0.1, 0.1])


def test_return_is_not_put_down_to_news_of_long_ago(mission):
    mission.kb.measure("energy", 0.1)
    mission.kb.request_action("wait")
    mission.turn()
    mission.hear(lambda: mission.kb.measure("energy", 0.9))
    mission.kb.request_action("inspect")
    mission.hear(lambda: mission.kb.measure("energy", 0.1))
    mission.kb.cancel_action("inspect", "abandoned")
    mission.hear(lambda: mission.kb.measure("energy", 0.9))
    for tick in (1.0, 2.0, 3.0):
        mission.now = tick
        mission.log.ticking(tick)
    mission.kb.cancel_action("wait", "completed")
    mission.kb.request_action("inspect")
    mission.turn()
    last = mission.log.adaptations[-1]
    assert (last.kind, last.trigger, last.reason) == ("task", "wait is over", "inspect is feasible again")
    assert last.reaction_s == 0.0
