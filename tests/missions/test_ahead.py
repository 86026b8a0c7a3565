"""Manager `ahead`: it recharges when that is worth most, knows no more than is published, and plans with it too."""

from dataclasses import replace

import pytest
from py_trees.decorators import FailureIsRunning
from running import run_mission

from missions.baselines import open_run
from missions.engine.mission import find_mission
from missions.engine.task_layer import mission_domain
from rosa_bt import Detour, Gain, Lookahead, MissionValue, ValueSelector
from rosa_pddl import PlanExecutor

EXTENDED = find_mission("suave_extended")


def test_it_recharges_in_time_and_inspects_more_than_the_tree():
    results, actions = {}, {}
    for manager in ("bt", "ahead"):
        run = open_run(EXTENDED, manager=manager, seed=7)
        run.run()
        results[manager], actions[manager] = run.results(), run.actions
    for figure in ("total_inspected_m", "distance_inspected_m"):
        assert results["ahead"][figure] > results["bt"][figure] + 5
    assert results["ahead"]["energy_j"] < results["bt"]["energy_j"]
    left = next(one for one in actions["ahead"] if one.action == "inspect_pipeline")
    assert left.result == "abandoned"
    assert "recharge now: leaving at " in left.reason
    assert next(one for one in actions["bt"] if one.action == "recharge").start > left.end + 10


@pytest.mark.xfail(
    reason="since the lookahead was rewritten, a plan executor below it does not recharge early"
)
def test_the_plan_executor_plans_for_what_is_worth_doing():
    detour = Detour(
        "recharge", {"battery_level": 1.0}, lambda away: 30 + away, lambda away: 30 + away
    )
    inspecting = MissionValue(300.0, [Gain("inspect_pipeline", 0.3, away=0.3)], [detour])

    def tree(kb, percepts):
        executor = PlanExecutor(
            "plan",
            kb=kb,
            domain=mission_domain(EXTENDED),
            behaviours={
                name: lambda step, make=make: make(kb, percepts)
                for name, make in EXTENDED.actions.items()
            },
            sense=lambda: EXTENDED.facts(kb, percepts),
            clock=lambda: kb.now,
        )
        lookahead = Lookahead(
            kb,
            lambda: inspecting if percepts.holds("pipeline_found") else MissionValue(300.0),
            period=5.0,
        )
        return FailureIsRunning("go on", ValueSelector("what next", lookahead, [executor]))

    run = open_run(replace(EXTENDED, tree=tree), seed=7, settings={"duration": "160"})
    run.run()
    done = [(one.action, one.start) for one in run.actions]
    assert [action for action, _ in done][:3] == ["search_pipeline", "inspect_pipeline", "recharge"]
    assert done[2][1] < 130, "before the battery is low, which is at 150 s"


def test_any_manager_of_the_extended_mission_can_be_asked_how_long_inspecting_stays_feasible():
    kb = run_mission("suave_extended", duration_s=120)[0].kb
    until = kb.feasible_until("inspect_pipeline")
    assert until.at == pytest.approx(150.5, abs=1.0)
    assert "battery_level falls by 0.005/s" in until.reason
    assert kb.forecast("water_visibility", 10.0).value is not None
