"""Missions that are interrupted, beset or cut short: what is told after that is what their twins tell."""

import os
import signal
import time
from random import Random

import pytest
from faulty_runs import CAMPAIGN, beset, campaign, gone_on_with, interrupted, kept, opened, tables, told

from missions.engine.controller import TASK_KINDS


# a signal that comes while a finalizer or the callback of a weak reference runs is lost by Python, with a warning
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("task", TASK_KINDS)
def test_mission_that_is_interrupted_leaves_nothing_open_and_has_told_what_its_twin_tells(task):
    run = opened("suave_extended", task)
    started = time.process_time()
    run.run()
    took, chance, count = time.process_time() - started, Random(task), 0
    while count < 3:
        lies, was = interrupted("suave_extended", task, chance.uniform(0.01, 0.9) * took, told(run))
        assert lies == []
        count += was
        took *= 0.9  # a run that was done before may be quicker


@pytest.mark.parametrize("task", TASK_KINDS)
def test_mission_among_hostile_subscribers_and_threads_decides_as_ever(task, caplog):
    assert beset("suave_extended", task, 0) == []
    assert "Hostile.beset.<locals>.fail" in caplog.text


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A campaign that nothing has stopped: its file and its tables."""
    folder = tmp_path_factory.mktemp("whole")
    file = folder / "small.toml"
    file.write_text(CAMPAIGN)
    running = campaign(folder / "c", file, "--workers", 1)
    assert running.wait(300) == 0
    running.stdout.close()
    return file, tables(folder / "c")


def test_campaign_on_a_full_disk_says_so_and_goes_on_when_there_is_room(whole, tmp_path):
    file, tables_of_whole = whole
    running = campaign(tmp_path / "c", file, "--workers", 1, most_bytes=33_000)
    said, _ = running.communicate(timeout=300)
    assert running.returncode == 2
    assert "make room, then go on with --resume" in said
    assert "Traceback" not in said
    assert gone_on_with(tmp_path / "c", file, tables_of_whole) == []


def test_campaign_that_is_killed_is_gone_on_with(whole, tmp_path):
    file, tables_of_whole = whole
    running = campaign(tmp_path / "c", file, "--workers", 2)
    while running.poll() is None and len(kept(tmp_path / "c")) <= 2:
        time.sleep(0.02)
    os.killpg(running.pid, signal.SIGKILL)
    running.communicate()
    assert gone_on_with(tmp_path / "c", file, tables_of_whole) == []
