"""The same campaign on a cluster.

A real scheduler and real workers on this machine, one of which is killed.
"""

import json
import os
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from missions.engine.mission import MissionError
from missions.experiments import workers

ROOT = Path(__file__).parents[2]
SMALL = """
missions = ["suave"]
managers = ["none", "bt"]
runs = 4
settings = { duration_s = 5 }
"""


class Machines:
    """A scheduler, workers and command lines as processes of their own."""

    def __init__(self, folder):
        self.folder = folder
        self.running = []
        (folder / "c.toml").write_text(SMALL)
        file = folder / "scheduler.json"
        options = ("--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        self.start("distributed.cli.dask_scheduler", *options, "--scheduler-file", file)
        end = time.monotonic() + 60
        while not hasattr(self, "address"):
            assert time.monotonic() < end
            with suppress(OSError, ValueError):  # not yet there, or half-written
                self.address = json.loads(file.read_text())["address"]
            time.sleep(0.05)

    def start(self, module, *words):
        settings = {
            **os.environ,
            "PYTHONPATH": f"{ROOT}{os.pathsep}{self.folder}",
            "DASK_LOGGING__DISTRIBUTED": "error",
        }
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        command = [sys.executable, "-m", module, *map(str, words)]
        running = subprocess.Popen(command, env=settings, cwd=self.folder, **pipes)
        self.running.append(running)
        return running

    def workers(self, count):
        from distributed import Client

        options = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1")
        module = "distributed.cli.dask_worker"
        started = [self.start(module, self.address, *options) for _ in range(count)]
        with Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(count, timeout=60)
        return started


@pytest.fixture(scope="module")
def machines(tmp_path_factory):
    machines = Machines(tmp_path_factory.mktemp("machines"))
    yield machines
    for running in machines.running:
        running.kill()
        running.wait()
        running.stdout.close()


def test_scheduler_that_is_not_there_is_refused(monkeypatch):
    monkeypatch.setattr(workers, "TIMEOUT_S", 0.5)
    start = r"no scheduler at 127\.0\.0\.1:9: .*start one with `dask scheduler`"
    with pytest.raises(MissionError, match=start):
        workers.cluster("127.0.0.1:9")


def test_killed_worker_costs_nothing_and_results_are_the_same(machines):
    with pytest.raises(MissionError, match="has no workers; start some"):
        workers.cluster(machines.address)
    first, *_ = machines.workers(2)
    running = machines.start(
        "missions", "campaign", "c.toml", "--cluster", machines.address, "--out", "far"
    )
    runs = machines.folder / "far" / "runs.jsonl"
    while running.poll() is None and not (runs.exists() and runs.read_bytes()):
        time.sleep(0.02)
    first.kill()
    out, _ = running.communicate()
    assert running.returncode == 0, out
    assert "8 of 8 runs done, 8 of them now" in out
    near = machines.start("missions", "campaign", "c.toml", "--workers", 1, "--out", "near")
    out, _ = near.communicate()
    assert near.returncode == 0, out
    far, near = (machines.folder / name / "runs.json" for name in ("far", "near"))
    assert far.read_bytes() == near.read_bytes()
