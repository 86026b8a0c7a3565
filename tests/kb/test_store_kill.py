"""A process is killed at any instant; its store is opened again and goes on with all that was acknowledged."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from kept import Life, answers

KILLS = int(os.environ.get("KILLS", "12"))
HERE = Path(__file__).parent


def killed(path, seed, delay):
    """Start a life in a process of its own and kill it; returns the last number that it knew to be on disk."""
    command = [sys.executable, str(HERE / "kept.py"), str(path), str(seed)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(HERE.parents[1]), str(HERE)))}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout.readline() == "begun\n"
        time.sleep(delay)
        process.send_signal(signal.SIGKILL)
        told = [int(line) for line in process.stdout.read().split("\n")[:-1]]
    assert process.returncode == -signal.SIGKILL
    return told[-1] if told else 0


def lived(path, seed, until):
    """Live the same life to the end of the call that told a certain fact."""
    life = Life(path, seed)
    moves = life.moves()
    while life.kb.log.last < until:
        next(moves)
    assert life.kb.log.last == until, "what one call told was torn apart"
    return life


@pytest.mark.parametrize("number", range(KILLS))
def test_all_that_was_acknowledged_is_there_after_a_kill(number, tmp_path):
    path = tmp_path / "mission.sqlite3"
    acknowledged = killed(path, number, random.Random(number).uniform(0.0, 0.6))
    again = Life(path, number)
    abandoned = sum(one.end == 0.0 for one in (*again.kb.plans, *again.kb.history.attempts))  # as it was opened
    saved = again.kb.log.last - abandoned
    assert saved >= acknowledged
    expected = lived(tmp_path / "expected.sqlite3", number, saved)
    again.clock.now = expected.clock.now
    assert answers(again.kb) == answers(expected.kb, ended=True)
    again.kb.measure("load", 0.5)
    assert again.kb.flush(10.0)
    assert again.kb.saved == again.kb.log.last > saved
    again.kb.close()
    expected.kb.close()
