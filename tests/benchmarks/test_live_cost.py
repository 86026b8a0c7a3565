"""What pages that look cost the robot: each tick, and the memory of a day."""

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest
from figures import table

from missions.baselines import open_run
from missions.engine.mission import find_mission
from missions.views.live import LiveView, Steering
from missions.views.recorder import RunRecorder

pytestmark = pytest.mark.benchmark

HERE = Path(__file__).parent
PAGES, ROUNDS, SIMULATED_S, SPEED = 20, 5, 60, 20


def flown(pages):
    """Fly a mission that so many pages look at.

    Returns its processor time for a tick [s], its rows and the pages'.
    """
    run = open_run(find_mission("suave_extended"), settings={"duration": str(SIMULATED_S)})
    steering = Steering(run, SPEED)
    run.listen(steering)
    recorder = RunRecorder(run, 0, {}, 100_000, what_if=False)
    view = LiveView(run.kb, port=0, recorder=recorder.recorder, steering=steering)
    looking = None
    if pages:
        url = view.url.replace("http", "ws") + "ws"
        looking = subprocess.Popen(
            [sys.executable, HERE / "pages.py", url], stdout=subprocess.PIPE, text=True
        )
        assert [looking.stdout.readline() for _ in range(pages)] == ["looking\n"] * pages
    started = time.thread_time()
    begun = time.perf_counter()
    run.run()
    wall_s = time.perf_counter() - begun
    took_s = time.thread_time() - started
    view.close()
    found = json.loads(looking.communicate(timeout=30)[0]) if looking else []
    return (
        took_s / (SIMULATED_S * 10),
        wall_s,
        recorder.recorder.rows.next,
        found,
    )


def test_twenty_pages_cost_a_tick_five_percent_at_most():
    flown(0)
    alone_s = []
    watched_s = []
    rows = []
    for _ in range(ROUNDS):
        alone, alone_wall, _, _ = flown(0)
        watched, watched_wall, count, found = flown(PAGES)
        assert found == [[count, 0]] * (PAGES - 1)
        alone_s.append(alone)
        watched_s.append(watched)
        ratios = f"{watched / alone:.3f}", f"{watched_wall / alone_wall:.3f}"
        rows.append((f"{alone * 1e6:.0f}", f"{watched * 1e6:.0f}", *ratios))
    head = ("alone [us]", "watched [us]", "ratio", "ratio by the wall clock")
    print(table("A tick, while twenty pages look", head, rows))
    assert min(watched_s) <= 1.05 * min(alone_s)
