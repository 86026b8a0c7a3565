"""What a mission hands to the plan executor: behaviours that know their step, facts that know the knowledge base."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from agv_worlds import generated_building
from py_trees.common import Status

from kb import KnowledgeBase, Model
from missions.agv import agv_mission
from missions.commands.check import planned_names
from missions.engine.mission import Mission, Percepts, find_mission
from missions.engine.question import answer, ask
from missions.engine.task_layer import build_task
from missions.uav.world import SKY
from missions.views.plan import lines_of
from rosa_bt import RosaAction
from rosa_pddl import Outcome


def shelf_model():
    model = Model("shelf")
    stock = model.quality_attribute("stock")
    model.action("fetch", constraints=[stock >= 0.0])
    return model


class Fetch(RosaAction):
    """Fetches what its step says, at once."""

    def __init__(self, kb, percepts, step):
        super().__init__(str(step), kb, "fetch")
        self.thing = step.arguments[-1]

    def update(self):
        DONE.append(self.thing)
        return Status.SUCCESS


def shelf_problem(*goals):
    return f"""(define (problem shelf) (:domain shelf)
      (:objects fetch - action {" ".join(THINGS)} - thing)
      (:init (fetch_action fetch) (= (far cup) 2) (= (far book) 2) (= (far lamp) 1))
      (:goal (and {" ".join(goals)})) (:metric minimize (total-cost)))"""


DONE = []
THINGS = ("cup", "book", "lamp")


def seen(kb, percepts):
    """Return that what is in stock needs no fetching, and that the lamp is far."""
    return {
        "(fetched cup)": (kb.attributes["stock"].value or 0.0) >= 1.0 or "cup" in DONE,
        "(far lamp)": 9.0,
    }


SHELF = Mission(
    name="shelf",
    summary="fetch things",
    model=shelf_model,
    world=SKY,
    domain=Path(__file__).with_name("data") / "shelf.pddl",
    problem=lambda: shelf_problem("(fetched cup)", "(or (fetched book) (fetched lamp))"),
    actions={"fetch": Fetch},
    facts=seen,
)


def run(mission, kb):
    """Tick the planned task layer until it is done; returns what was fetched."""
    DONE.clear()
    task = build_task("pddl", mission, kb, Percepts())
    try:
        for _ in range(30):
            task.catch_up()
            task.root.tick_once()
            if task.root.status is Status.SUCCESS:
                return list(DONE)
    finally:
        task.close()
    raise AssertionError(task.plans())


def test_action_is_told_its_step_and_what_is_sensed_decides_which_is_cheapest():
    assert sorted(run(SHELF, KnowledgeBase(shelf_model(), clock=lambda: 0.0))) == ["book", "cup"]


def test_facts_see_the_knowledge_base():
    kb = KnowledgeBase(shelf_model(), clock=lambda: 0.0)
    kb.measure("stock", 2.0)
    assert run(SHELF, kb) == ["book"]


def test_engines_of_a_mission_plan_it_also_by_hand():
    both = partial(shelf_problem, "(fetched cup)", "(fetched book)")
    mission = replace(SHELF, engines=("kairos",), problem=both)
    assert sorted(run(mission, KnowledgeBase(shelf_model(), clock=lambda: 0.0))) == ["book", "cup"]
    DONE.clear()
    found = answer(ask(mission=mission), 30.0)
    assert (found.result.engine, found.result.cost) == ("kairos", 4.0)


def test_question_by_hand_knows_what_is_possible_in_its_situation():
    agv = find_mission("agv")
    found = {}
    for situation in ("", "kinect=failed", "energy=500"):
        question = ask(mission=agv, situation=[situation] if situation else [])
        found[situation] = answer(question, 60.0)
    crossed = {
        key: [step.action for step in one.result.steps if step.schema == "cross"]
        for key, one in found.items()
    }
    assert crossed == {
        "": ["cross_c1"],
        "kinect=failed": ["cross_c4", "cross_c3", "cross_c2"],
        "energy=500": [],
    }
    assert found["energy=500"].result.outcome is Outcome.UNSOLVABLE_PROVEN
    assert "out of reach: (at b)" in "\n".join(lines_of(found["energy=500"]))


@pytest.mark.parametrize(
    ("situation", "told"),
    [
        (
            "energy=100",
            [
                [],
                "no way keeps within all limits: energy 90 (alone ",
            ],
        ),
        (
            "kinect=failed,lidar=failed,camera=failed",
            [
                [
                    "there would be no plan even if every action were feasible",
                ],
                "no corridor can be crossed in any configuration; in c1, navigate is unfeasible because",
            ],
        ),
    ],
)
def test_limits_are_told_as_the_reason_only_when_they_are_and_the_mission_adds_its_own(
    situation, told
):
    lines = list(lines_of(answer(ask(mission=find_mission("agv"), situation=[situation]), 60.0)))
    obstacles = [line.strip() for line in lines[1 : 2 + len(told[0])]]
    assert obstacles == ["out of reach: (at b)", *told[0]]
    assert told[1] in lines[2 + len(told[0])]


def test_reason_of_a_mission_is_about_its_own_goal_only():
    question = ask(mission=find_mission("agv"), situation=["energy=100"], goals=["(at d) (<= (energy_used_mj) (energy_left_mj))"])
    assert question.why_not() == ""
    found = answer(question, 60.0)
    assert found.obstacles[0] == "out of reach: (at d)"
    assert "at least" not in " ".join(found.obstacles)


def test_large_building_without_a_way_says_which_corridors_are_in_the_way():
    building = generated_building(np.random.default_rng(1))
    mission = agv_mission("generated", "drive through a generated building", building)
    told = answer(ask(mission=mission, situation=["kinect=failed"]), 60.0).obstacles
    assert told[0] == "out of reach: (at p57)"
    assert told[1].startswith(
        "p57 cannot be reached from p0; c7, c10, c17, c18, c26 cannot be crossed: navigate is"
    )


def test_actions_that_are_objects_of_the_problem_are_known_to_the_judge():
    names = planned_names(find_mission("agv"))
    assert {name for name, _ in names} == {"switch", "cross_c1", "cross_c2", "cross_c3", "cross_c4"}
