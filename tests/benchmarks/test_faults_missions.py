"""Whole missions interrupted, beset by subscribers and threads, campaigns killed and out of room, for long.

`MISSIONS` says how many missions are interrupted, `KILLS` how many campaigns are killed, `FULL` how many lack room.
"""

import os
import signal
import sys
import time
from pathlib import Path
from random import Random

import pytest
from figures import table

sys.path.append(
    str(Path(__file__).parents[1] / "missions")
)  # what is run, and its twins, are those of the tests there

from faulty_runs import CAMPAIGN, beset, campaign, gone_on_with, interrupted, opened, tables, told

pytestmark = [
    pytest.mark.benchmark(group="faults"),
    # a signal that comes while a finalizer or the callback of a weak reference runs is lost by Python, with a warning
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]

MISSIONS, KILLS, FULL = (
    int(os.environ.get(name, most))
    for name, most in (("MISSIONS", 400), ("KILLS", 30), ("FULL", 10))
)


@pytest.fixture(scope="module")
def rows(tables):
    found = []
    tables["faults of missions"] = lambda: table(
        "Faults of missions", ("what", "tried", "faults", "lies"), found
    )
    return found


@pytest.mark.parametrize("task", ["bt", "pddl"])
@pytest.mark.parametrize("name", ["suave_extended", "agv", "uav"])
def test_missions_are_interrupted_at_random(rows, name, task):
    run = opened(name, task)
    started = time.process_time()
    run.run()
    took, whole, chance = time.process_time() - started, told(run), Random(f"{name} {task}")
    found = [
        interrupted(name, task, chance.uniform(0.002, took), whole) for _ in range(MISSIONS // 6)
    ]
    lies = [lie for told_lies, _ in found for lie in told_lies]
    rows.append(
        (f"{name} ({task}) interrupted", len(found), sum(was for _, was in found), len(lies))
    )
    assert lies == []


@pytest.mark.parametrize("task", ["bt", "pddl"])
def test_missions_are_beset(rows, task):
    lies = [lie for seed in range(5) for lie in beset("suave_extended", task, seed)]
    rows.append((f"suave_extended ({task}) beset", 5, 5, len(lies)))
    assert lies == []


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    file = folder / "small.toml"
    file.write_text(CAMPAIGN)
    running = campaign(folder / "c", file, "--workers", 2)
    running.communicate(timeout=300)
    return file, tables(folder / "c")


def test_campaigns_are_killed_at_random_and_gone_on_with(rows, whole, tmp_path):
    file, of_whole = whole
    chance, lies = Random(1), []
    for number in range(KILLS):
        running = campaign(tmp_path / str(number), file, "--workers", 2)
        time.sleep(chance.uniform(1.0, 8.0))
        os.killpg(running.pid, signal.SIGKILL)
        running.communicate()
        lies += gone_on_with(tmp_path / str(number), file, of_whole)
    rows.append(("campaign killed", KILLS, KILLS, len(lies)))
    assert lies == []


def test_campaigns_run_out_of_room_and_are_gone_on_with(rows, whole, tmp_path):
    file, of_whole = whole
    chance, lies, full = Random(2), [], 0
    for number in range(FULL):
        running = campaign(
            tmp_path / str(number), file, "--workers", 2, most_bytes=chance.randint(700, 12_000)
        )
        said, _ = running.communicate(timeout=300)
        full += running.returncode == 2
        lies += [said] if "Traceback" in said else []
        lies += gone_on_with(tmp_path / str(number), file, of_whole)
    rows.append(("campaign without room", FULL, full, len(lies)))
    assert lies == []
