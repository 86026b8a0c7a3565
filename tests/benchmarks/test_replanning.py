"""How long a new plan takes: warm, cold and by unified-planning, in turn in one run; and what 10,000 leave behind."""

import gc
import os
import subprocess
import sys
import threading
from pathlib import Path
from time import perf_counter

import pytest
from figures import percentiles, shown, table
from numpy.random import default_rng

from rosa_pddl import Outcome, Planner, Problem, initial_state, load_domain
from rosa_pddl.engines import fast_downward_program
from rosa_pddl.validate import flaw

sys.path.append(
    str(Path(__file__).parents[1] / "rosa_pddl")
)  # the generated worlds are those of the tests there

from waypoints import Waypoints

pytestmark = pytest.mark.benchmark

MISSION = Path(__file__).parents[2] / "missions" / "suave_extended"
SIZES = (30, 100, 300, 1000)
SOAK = 10_000


def timed(act, *arguments):
    began = perf_counter()
    result = act(*arguments)
    return perf_counter() - began, result


def extended():
    return load_domain(MISSION / "domain.pddl", MISSION / "problem.pddl")


def dropped(domain):
    """The battery has dropped: only recharging is feasible; the pipeline has been found."""
    facts = {"(action_feasible recharge)", "(pipeline_found pipeline)"}
    return Problem(domain, initial_state(domain) | facts)


def by_unified_planning(up_problem):
    with up_problem.environment.factory.OneshotPlanner(name="fast-downward") as planner:
        return planner.solve(up_problem)


def bare_start():
    """Start the search program and let it end at once."""
    subprocess.run([str(fast_downward_program()), "--help"], capture_output=True, check=True)


def test_replanning_after_the_battery_drop(tables, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    problem = dropped(extended())
    warm, cold = Planner(cached=0), Planner(warm=False, cached=0)
    up_problem = problem.build()
    by_unified_planning(up_problem)
    first = warm.plan(problem)
    assert [step.schema for step in first.steps] == ["recharge", "inspect_pipeline"]
    times = {
        "warm": [],
        "cold": [],
        "unified-planning": [],
        "judging the plan": [],
        "the search's start alone": [],
    }
    for number in range(200):
        took, result = timed(warm.plan, problem)
        assert (result.attempts[0].way, result.steps) == ("warm", first.steps)
        times["warm"].append(took)
        times["judging the plan"].append(timed(flaw, problem.domain, first.steps, problem.state)[0])
        times["the search's start alone"].append(timed(bare_start)[0])
        if number % 10 == 0:
            times["cold"].append(timed(cold.plan, problem)[0])
            took, answer = timed(by_unified_planning, up_problem)
            assert len(answer.plan.actions) == 2
            times["unified-planning"].append(took)
    found = {way: percentiles(some) for way, some in times.items()}
    tables["replanning 1"] = lambda: table(
        "Extended SUAVE, replan after the battery drop",
        ["", "median", "90 %", "99 %"],
        [[way, *map(shown, some)] for way, some in found.items()],
    )
    # 1 ms, or on a machine that is busy with other things, what starting a program takes there
    assert found["warm"][0] <= max(0.001, found["the search's start alone"][0])
    assert found["unified-planning"][0] >= 15 * found["warm"][0]
    assert found["judging the plan"][0] <= 0.001


def test_replanning_among_waypoints(tables, tmp_path):
    rows, median = [], {}
    for size in SIZES:
        folder = tmp_path / str(size)
        folder.mkdir()
        world = Waypoints(folder, size, default_rng(size))
        warm, cold = (
            Planner(cached=0, timeout_s=120.0),
            Planner(warm=False, cached=0, timeout_s=120.0),
        )
        state, costs = world.situation()
        warm.prepare(Problem(world.domain, state, costs=costs), world.changing)
        prepared, _ = timed(warm.plan, Problem(world.domain, state, costs=costs))
        times = {"warm": [], "cold": []}
        for _ in range(10):
            state, costs = world.situation(f"w{world.rng.integers(size)}")
            problem = Problem(world.domain, state, costs=costs)
            took, result = timed(warm.plan, problem)
            times["warm"].append(took)
            took, anew = timed(cold.plan, problem)
            times["cold"].append(took)
            assert result.attempts[0].way == "warm"
            assert result.outcome is anew.outcome is Outcome.SOLVED_OPTIMALLY
            assert result.cost == anew.cost
        median[size] = {way: percentiles(some)[0] for way, some in times.items()}
        rows.append(
            [size, *(shown(median[size][way]) for way in ("warm", "cold")), shown(prepared)]
        )
    tables["replanning 2"] = lambda: table(
        "Waypoints with six configurations, optimal, all costs and passages new each time",
        ["waypoints", "warm (median)", "cold (median)", "translated once"],
        rows,
    )
    # 0.25 s, or on a machine that is busy with other things, an eighth of what the cold way takes there
    assert median[1000]["warm"] <= max(0.25, median[1000]["cold"] / 8)
    assert median[1000]["cold"] >= 4 * median[1000]["warm"]


def held_kb():
    gc.collect()
    words = Path("/proc/self/status").read_text().split()
    return int(words[words.index("VmRSS:") + 1])


def open_files():
    return sorted(
        str(link.readlink()) for link in Path("/proc/self/fd").iterdir() if link.is_symlink()
    )


def test_ten_thousand_replans_leave_nothing_behind(tables, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    domain, rng = extended(), default_rng(1)
    atoms = sorted(
        {f"(action_feasible {action})" for action in domain.rosa_actions}
        | {"(pipeline_found pipeline)"}
    )
    planner, static = Planner(cached=0), initial_state(domain)
    outcomes = {}
    for number in range(SOAK):
        if number == SOAK // 10:
            before = (open_files(), threading.active_count(), held_kb())
        facts = {atom for atom in atoms if rng.random() < 0.5}
        result = planner.start(Problem(domain, static | facts)).result(60.0)
        assert [attempt.way for attempt in result.attempts] == ["warm"]
        outcomes[str(result.outcome)] = outcomes.get(str(result.outcome), 0) + 1
    assert len(outcomes) == 2
    while threading.active_count() > before[1]:
        threading.Event().wait(0.01)
    grown = held_kb() - before[2]
    assert open_files() == before[0]
    assert list(tmp_path.iterdir()) == []
    pids = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split()
    assert [pid for pid in pids if "downward" in str(Path(f"/proc/{pid}/exe").readlink())] == []
    tables["replanning 3"] = lambda: table(
        f"{SOAK} replans of random states",
        ["outcome", "number"],
        [*outcomes.items(), ["memory grown [kB]", grown]],
    )
    assert grown < 4096
