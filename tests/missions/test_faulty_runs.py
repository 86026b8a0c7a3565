"""Missions that are interrupted or beset: what is told after that is what their twins tell."""

import time
from random import Random

import pytest
from faulty_runs import beset, interrupted, opened, told

from missions.engine.task_layer import TASK_KINDS


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
