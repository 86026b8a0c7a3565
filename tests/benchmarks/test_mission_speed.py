"""How long a whole mission takes, and questions and events with its model, beside the naive twin on the same."""

import copy
from collections.abc import Callable
from itertools import cycle
from time import perf_counter, process_time, thread_time
from typing import NamedTuple

import numpy
import pytest
from figures import percentiles, shown, table
from generated import Happening
from naive_peers import NaivePeer, facts

from kb import KnowledgeBase, PriorityPlanner
from missions.baselines import open_run
from missions.engine.mission import find_mission
from missions.suave_extended.model import suave_extended_model

pytestmark = pytest.mark.benchmark(group="extended SUAVE")

ROUNDS, NAIVE_ROUNDS = 2000, 50
MISSION_ROUNDS, MISSION_S = 7, 300.0
SEARCH = "search_pipeline"


class Operation(NamedTuple):
    """What is timed on our side and on the twin's, with a new value each time."""

    ours: Callable[[KnowledgeBase, object], object]
    naive: Callable[[NaivePeer, object], object] | None
    values: tuple[object, ...]
    calls: int = 1


def searching() -> KnowledgeBase:
    """Return a knowledge base of a vehicle that searches, in clear water with a full battery."""
    kb = KnowledgeBase(suave_extended_model())
    kb.measure("water_visibility", 3.5)
    kb.measure("battery_level", 1.0)
    assert kb.request_action(SEARCH)
    carry_out(kb, PriorityPlanner().plan(kb))
    return kb


def carry_out(kb, plan):
    if plan is None:
        return
    for name in plan.deactivate:
        kb.component_active(name, False)
    for name in plan.activate:
        kb.component_active(name, True)
    kb.finish_plan(plan, "completed")


def adapt(kb, value):
    kb.measure("water_visibility", value)
    return PriorityPlanner().plan(kb)


def repair(kb, failed):
    (kb.component_failed if failed else kb.component_recovered)("c_thruster_1")
    return PriorityPlanner().plan(kb)


def suppose_naively(twin, _):
    supposed = copy.copy(twin)
    supposed.value = {**twin.value, "water_visibility": 1.5, "battery_level": 0.1}
    return supposed.selectable_actions()


OPERATIONS = {
    "measure, no status changes": Operation(
        lambda kb, value: kb.measure("water_visibility", value),
        lambda twin, value: twin.tell(Happening("measured", "water_visibility", value)),
        (3.6, 3.7),
    ),
    "measure across a threshold, selection, plan": Operation(adapt, None, (2.5, 3.5)),
    "component fails or recovers, selection, plan": Operation(repair, None, (True, False)),
    "is_feasible": Operation(
        lambda kb, _: kb.is_feasible(SEARCH),
        lambda twin, _: twin.status("action", SEARCH) != "unfeasible",
        (0,),
        100,
    ),
    "situation of two values, selectable_actions": Operation(
        lambda kb, _: set(
            kb.situation(water_visibility=1.5, battery_level=0.1).selectable_actions()
        ),
        suppose_naively,
        (0,),
    ),
    "explain what is feasible": Operation(lambda kb, _: kb.explain(SEARCH), None, (0,)),
    "explain what is not": Operation(lambda kb, _: kb.explain(SEARCH), None, (0,)),
}


@pytest.fixture(scope="module")
def rows(tables):
    found = {}
    head = ("extended SUAVE, in memory", "p50", "p90", "p99", "naive twin, p50", "ratio")
    tables["1"] = lambda: table(
        "A mission", head, [found[name] for name in OPERATIONS if name in found]
    )
    return found


@pytest.mark.parametrize("name", OPERATIONS)
def test_speed_with_the_model_of_a_mission(name, benchmark, rows):
    operation, kb = OPERATIONS[name], searching()
    twin = NaivePeer(kb.model, list(facts(kb)))
    if name == "explain what is not":
        kb.measure("battery_level", 0.1)
    plans = "plan" in name
    times, answers = timed(benchmark, operation, kb, plans)
    assert all(plan is not None for plan in answers) or not plans
    naive = naively(operation, kb, twin)
    ratio = f"{naive / percentiles(times)[0]:.0f}x" if naive else None
    rows[name] = (name, *map(shown, percentiles(times)), naive and shown(naive), ratio)


def timed(benchmark, operation, kb, plans):
    """Return the time of each call, and what was answered; a plan is carried out before the next call, untimed."""
    answers, values = [], cycle(operation.values)

    def prepare():
        if plans and answers:
            carry_out(kb, answers[-1])
        return (next(values),), {}

    def call(value):
        answers.append(operation.ours(kb, value))

    def many(value):
        for _ in range(operation.calls):
            operation.ours(kb, value)

    if operation.calls > 1:
        benchmark.pedantic(many, setup=prepare, rounds=ROUNDS // 10)
    else:
        benchmark.pedantic(call, setup=prepare, rounds=ROUNDS, warmup_rounds=20)
    return [time / operation.calls for time in benchmark.stats.stats.data], answers


def naively(operation, kb, twin):
    """Return the median time of the twin, whose answers are the same."""
    if operation.naive is None:
        return None
    times, values = [], cycle(operation.values)
    for _ in range(NAIVE_ROUNDS):
        value = next(values)
        start = perf_counter()
        answer = operation.naive(twin, value)
        times.append(perf_counter() - start)
        assert answer == operation.ours(kb, value)
    return percentiles(times)[0]


WHOLE = {
    "ours, tree": {"manager": "ours"},
    "ours, PDDL": {"manager": "ours", "task": "pddl"},
    "bt": {"manager": "bt"},
    "none": {"manager": "none"},
}


@pytest.fixture(scope="module")
def wholes(tables):
    found = {}
    head = (
        "extended SUAVE, 300 s",
        "processor time",
        "times real time",
        "of it the sea",
        "where the rest goes",
    )
    tables["0"] = lambda: table("A whole mission", head, found.values())
    return found


@pytest.mark.parametrize("label", ["physics alone", "the sea alone", *WHOLE])
def test_speed_of_a_whole_mission(label, wholes):
    runs = [whole(label, seed) for seed in range(MISSION_ROUNDS)]
    took, parts = min(runs, key=lambda run: run[0])
    sea = parts.pop("world", None)
    total = sum(parts.values()) + (sea or 0.0)
    rest = ", ".join(
        f"{name} {part / total:.0%}" for name, part in parts.items() if part > 0.01 * total
    )
    share = f"{sea / total:.0%}" if sea else None
    wholes[label] = (label, shown(took), f"{MISSION_S / took:,.0f}", share, rest or None)


def whole(label, seed):
    """Return the processor time of a mission without set-up [s], and the shares of its parts."""
    if label in WHOLE:
        run = open_run(find_mission("suave_extended"), seed=seed, **WHOLE[label])
        start = process_time()
        verdict = run.run()
        took = process_time() - start
        assert verdict.success or label == "none", verdict  # which never recharges
        return took, dict(run.compute_s)
    sea = find_mission("suave_extended").world.open({}, numpy.random.default_rng(seed))
    if label == "the sea alone":
        sea.managed.activate("spiral_search")
        start = process_time()
        while sea.now < MISSION_S:
            sea.advance(MISSION_S)
        return process_time() - start, {}
    vehicle, settings = sea._env._vehicle, sea.settings
    start = process_time()
    for _ in range(round(MISSION_S / settings.control_period_s)):
        vehicle.push([0.0] * 6)
    return process_time() - start, {}


PLACES = ("suave_extended", "agv", "uav")


@pytest.fixture(scope="module")
def in_place(tables):
    found = {}
    head = ("a whole run, processor time", "all of it", "its own calls of mj_step", "ratio")
    tables["0b"] = lambda: table("Beside its own physics", head, found.values())
    return found


@pytest.mark.parametrize("mission", PLACES)
def test_a_run_beside_its_own_calls_of_the_physics(mission, in_place, monkeypatch):
    """Time runs, and the physics within as many more, in turn: both suffer from the same neighbours on the machine."""
    mujoco = pytest.importorskip("mujoco")
    step, spent, calls = mujoco.mj_step, [0.0], [0]

    def timed(*arguments):
        start = thread_time()
        step(*arguments)
        spent[0] += thread_time() - start
        calls[0] += 1

    def took():
        run = open_run(find_mission(mission), seed=0)
        start = thread_time()
        assert run.run().success
        return thread_time() - start

    start = thread_time()
    for _ in range(100_000):
        thread_time()
    clock_s = (thread_time() - start) / 100_000
    wholes, physics = [], []
    for _ in range(MISSION_ROUNDS + 1):
        wholes.append(took())
        spent[0], calls[0] = 0.0, 0
        with monkeypatch.context() as patched:
            patched.setattr(mujoco, "mj_step", timed)
            took()
        physics.append(spent[0] - calls[0] * clock_s)
    all_s, physics_s = min(wholes[1:]), min(physics[1:])
    in_place[mission] = (mission, shown(all_s), shown(physics_s), f"{all_s / physics_s:.1f}")
