"""Plans that look ahead: by forecasts as timed facts, or below a lookahead."""

from dataclasses import replace

from py_trees.decorators import FailureIsRunning
from running import run_mission

from missions.baselines import open_run
from missions.engine.mission import find_mission
from missions.engine.task_layer import mission_domain
from rosa_bt import Detour, Gain, Lookahead, MissionValue, ValueSelector
from rosa_pddl import PlanExecutor


def takes_s(away):
    return 30 + away


def test_plan_executor_below_a_lookahead_recharges_early():
    extended = find_mission("suave_extended")
    detour = Detour("recharge", {"battery_level": 1.0}, takes_s, takes_s)
    inspecting = MissionValue(300.0, [Gain("inspect_pipeline", 0.3, away=0.3)], [detour])

    def tree(kb, percepts):
        def value():
            return inspecting if percepts.holds("pipeline_found") else MissionValue(300.0)

        executor = PlanExecutor(
            "plan",
            kb=kb,
            domain=mission_domain(extended),
            behaviours={
                name: lambda step, make=make: make(kb, percepts)
                for name, make in extended.actions.items()
            },
            sense=lambda: extended.facts(kb, percepts),
            clock=lambda: kb.now,
        )
        lookahead = Lookahead(kb, value, period=5.0)
        return FailureIsRunning("go on", ValueSelector("what next", lookahead, [executor]))

    run = open_run(replace(extended, tree=tree), seed=7, settings={"duration": "160"})
    run.run()
    done = ["search_pipeline", "inspect_pipeline", "recharge", "inspect_pipeline"]
    assert [action.action for action in run.actions] == done
    assert run.actions[2].start < 130, "before the battery is low, which is at 150 s"


def test_plan_ahead_starts_no_inspection_that_it_cannot_finish():
    settings = {"discharge_time": 100, "duration": 110}
    unaware, _, _ = run_mission("suave_extended", "pddl", **settings)
    ahead, _, _ = run_mission("suave_extended", "pddl", plan_ahead="true", **settings)
    done = [(action.action, action.result) for action in unaware.actions]
    assert done[:2] == [("search_pipeline", "completed"), ("inspect_pipeline", "abandoned")]
    done = [(action.action, action.result) for action in ahead.actions]
    assert done[:2] == [("search_pipeline", "completed"), ("recharge", "completed")]
    first, second = ahead.plans[:2]
    assert (first.engine, second.engine) == ("search", "kairos")
    assert "too late" in second.reason
