"""How long a whole mission takes, beside its physics alone."""

from time import process_time, thread_time

import numpy
import pytest
from figures import shown, table

from missions.baselines import open_run
from missions.engine.mission import find_mission

pytestmark = pytest.mark.benchmark(group="extended SUAVE")

MISSION_ROUNDS = 7
MISSION_S = 300.0

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
    )
    tables["0"] = lambda: table("A whole mission", head, found.values())
    return found


@pytest.mark.parametrize("label", ["physics alone", "the sea alone", *WHOLE])
def test_speed_of_a_whole_mission(label, wholes):
    runs = [whole(label, seed) for seed in range(MISSION_ROUNDS)]
    took = min(runs)
    wholes[label] = (label, shown(took), f"{MISSION_S / took:,.0f}")


def whole(label, seed):
    """Return the processor time of a mission without set-up [s]."""
    if label in WHOLE:
        run = open_run(find_mission("suave_extended"), seed=seed, **WHOLE[label])
        start = process_time()
        verdict = run.run()
        took = process_time() - start
        assert verdict.success or label == "none", verdict  # which never recharges
        return took
    sea = find_mission("suave_extended").world.open({}, numpy.random.default_rng(seed))
    if label == "the sea alone":
        sea.managed.activate("spiral_search")
        start = process_time()
        while sea.now < MISSION_S:
            sea.advance(MISSION_S)
        return process_time() - start
    vehicle = sea._env._vehicle
    settings = sea.settings
    start = process_time()
    for _ in range(round(MISSION_S / settings.control_period_s)):
        vehicle.push([0.0] * 6)
    return process_time() - start


PLACES = ("suave_extended", "agv", "uav")


@pytest.fixture(scope="module")
def in_place(tables):
    found = {}
    head = ("a whole run, processor time", "all of it", "its own calls of mj_step", "ratio")
    tables["0b"] = lambda: table("Beside its own physics", head, found.values())
    return found


@pytest.mark.parametrize("mission", PLACES)
def test_a_run_beside_its_own_calls_of_the_physics(mission, in_place, monkeypatch):
    """Time runs, and the physics within as many more, in turn, on the same machine."""
    mujoco = pytest.importorskip("mujoco")
    step = mujoco.mj_step
    spent = [0.0]
    calls = [0]

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
    wholes = []
    physics = []
    for _ in range(MISSION_ROUNDS + 1):
        wholes.append(took())
        spent[0] = 0.0
        calls[0] = 0
        with monkeypatch.context() as patched:
            patched.setattr(mujoco, "mj_step", timed)
            took()
        physics.append(spent[0] - calls[0] * clock_s)
    all_s = min(wholes[1:])
    physics_s = min(physics[1:])
    in_place[mission] = (mission, shown(all_s), shown(physics_s), f"{all_s / physics_s:.1f}")
