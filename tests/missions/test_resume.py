"""What the missions' actions keep over an interruption, in trees and in plans, by the words of the sea."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from py_trees.common import Status
from running import run_mission

from kb import KnowledgeBase
from missions.engine.mission import Percepts
from missions.engine.runner import Listener
from missions.suave.tree import InspectPipeline, SearchPipeline
from missions.suave_extended.model import suave_extended_model
from missions.suave_extended.tree import suave_extended_tree
from rosa_bt import TreeRunner


class Dive:
    """The extended mission's tree, told by hand what the sea would say, one tick a second."""

    def __init__(self):
        self.now = 0.0
        self.kb = KnowledgeBase(suave_extended_model(), clock=lambda: self.now)
        self.percepts = Percepts()
        self.runner = TreeRunner(
            suave_extended_tree(self.kb, self.percepts), clock=lambda: self.now
        )

    def leaf(self, kind):
        return next(one for one in self.runner.tree.root.iterate() if isinstance(one, kind))

    def tick(self, battery=1.0, **said):
        self.kb.measure("battery_level", battery)
        if said:
            values = {key: str(value) for key, value in said.items()}
            self.percepts.receive({"status": [{"message": "mission status", "values": values}]})
        self.now += 1.0
        self.runner.tick()
        return [one.action for one in self.kb.required_actions]


def test_search_that_the_battery_interrupts_goes_on_and_counts_both_goes_but_not_the_recharge():
    dive = Dive()
    assert [dive.tick(level) for level in (0.9, 0.8, 0.2, 0.2)] == [["search_pipeline"]] * 2 + [
        ["recharge"]
    ] * 2
    assert dive.tick(1.0, battery_recharged="true") == ["search_pipeline"]
    search = dive.leaf(SearchPipeline)
    assert search.searched_s == pytest.approx(2.0), (
        "from the first tick to the third, and from now on"
    )
    assert dive.tick(1.0, pipeline_found="true") == ["inspect_pipeline"]
    assert search.feedback_message == "found after 3 s of searching"


@given(st.lists(st.lists(st.floats(0.0, 9.0), min_size=1, max_size=4), min_size=1, max_size=4))
def test_metres_of_all_goes_of_an_inspection_add_up_although_the_follower_counts_from_nought_each_time(
    goes,
):
    dive = Dive()
    dive.tick(pipeline_found="true")
    total = 0.0
    for steps in goes:
        told = 0.0
        dive.tick(distance_inspected=told)
        for step in steps:
            told += step
            total += step
            assert dive.tick(distance_inspected=told) == ["inspect_pipeline"]
        assert dive.leaf(InspectPipeline).inspected_m == pytest.approx(total)
        assert dive.tick(battery=0.1) == ["recharge"]
        assert dive.tick(battery=1.0, battery_recharged="true") == ["inspect_pipeline"]
        assert dive.leaf(InspectPipeline).inspected_m == pytest.approx(total), (
            "the last word is not counted twice"
        )


def test_new_mission_begins_with_nothing_searched_or_inspected():
    dive = Dive()
    for _ in range(3):
        dive.tick(pipeline_found="true", distance_inspected=5.0)
    inspect = dive.leaf(InspectPipeline)
    assert inspect.inspected_m == 5.0
    dive.runner.shutdown()
    dive.runner = TreeRunner(suave_extended_tree(dive.kb, Percepts()), clock=lambda: dive.now)
    dive.percepts = Percepts()
    dive.tick()
    assert dive.leaf(InspectPipeline).inspected_m == 0.0


class Watch(Listener):
    """Notes how much every inspection that is ticked has inspected, by its own account."""

    def __init__(self):
        self.told_m = []

    def tick(self, run):
        now = [one for one in run.tree.root.iterate() if isinstance(one, InspectPipeline)]
        self.told_m += [one.inspected_m for one in now if one.status is Status.RUNNING]


@pytest.mark.parametrize("task", ["bt", "pddl"])
def test_inspection_goes_on_after_the_recharge_in_the_simulated_sea(task):
    watch = Watch()
    data = run_mission("suave_extended", task, listeners=[watch])[2]
    assert 0 < data["distance_inspected_m"] < data["total_inspected_m"], (
        "the follower has begun to count again"
    )
    assert watch.told_m == sorted(watch.told_m)
    assert watch.told_m[-1] == pytest.approx(data["total_inspected_m"], abs=1.0)
