"""The same campaign on a cluster: a real scheduler and real workers on this machine, one of which is killed."""

import json
import os
import shutil
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from running import called

from missions.engine.mission import MissionError
from missions.experiments.campaign import PACKAGES, read_store

ROOT = Path(__file__).parents[2]
SMALL = """
missions = ["suave"]
managers = ["none", "bt", "ours"]
runs = 4
[settings]
duration_s = 20
"""
RUNS = 3 * 4
FATAL = """
import os

from missions.baselines import Manager


class Fatal(Manager):
    def update(self):
        os._exit(1)
"""
TABLES = ("runs.csv", "reactions.csv")
IGNORED = shutil.ignore_patterns(
    "*.pyc.*", "node_modules"
)  # what is compiled is copied, half-written files are not


class Machines:
    """A scheduler, workers and command lines as processes of their own."""

    def __init__(self, folder):
        self.folder, self.path, self.workers = folder, [str(ROOT), str(folder)], []
        self.foreign = False
        (folder / "fatal.py").write_text(FATAL)
        (folder / "small.toml").write_text(SMALL)
        options = [
            "--host",
            "127.0.0.1",
            "--port",
            "0",
            "--no-dashboard",
            "--scheduler-file",
            "scheduler.json",
        ]
        self.scheduler = self.start("distributed.cli.dask_scheduler", *options, path=self.path)
        self.wait_for(self.is_found)

    def start(self, module, *arguments, path):
        settings = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(path),
            "DASK_LOGGING__DISTRIBUTED": "error",
        }
        settings["DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES"] = (
            "0"  # so that a fatal run kills two workers only
        )
        command = [sys.executable, "-m", module, *map(str, arguments)]
        with (self.folder / "log.txt").open("a") as log:
            return subprocess.Popen(command, stdout=log, stderr=log, env=settings, cwd=self.folder)

    def have_workers(self, count, path=None):
        """Have so many workers that see some code; those that live and see the same stay."""
        options = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1"]
        living = [one for one in self.workers if one.poll() is None]
        stay = living[:count] if path is None and not self.foreign else []
        for one in living:
            if one not in stay:
                one.kill()
                one.wait()
        more = [
            self.start(
                "distributed.cli.dask_worker", self.address, *options, path=path or self.path
            )
            for _ in range(count - len(stay))
        ]
        self.workers, self.foreign = [*stay, *more], path is not None
        self.wait_for(lambda: self.count() == count)

    def count(self):
        from distributed import Client

        with Client(self.address, set_as_default=False) as client:
            return len(client.scheduler_info(n_workers=-1)["workers"])

    def rosa(self, *arguments):
        command = [sys.executable, "-m", "missions", *map(str, arguments)]
        settings = {**os.environ, "PYTHONPATH": os.pathsep.join(self.path)}
        return subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=settings,
            cwd=self.folder,
        )

    def is_found(self):
        with suppress(OSError, ValueError):  # not yet there, or half-written
            self.address = json.loads((self.folder / "scheduler.json").read_text())["address"]
            return True
        return False

    def wait_for(self, holds):
        end = time.monotonic() + 180
        while not holds():
            assert time.monotonic() < end, (self.folder / "log.txt").read_text()
            time.sleep(0.05)

    def lines(self, name):
        with suppress(MissionError):  # not yet there
            return list(read_store(self.folder / name).records)
        return []

    def end(self):
        for one in (*self.workers, self.scheduler):
            one.kill()
            one.wait()
        self.workers.clear()


@pytest.fixture(scope="module")
def machines(tmp_path_factory):
    found = Machines(tmp_path_factory.mktemp("machines"))
    yield found
    found.end()


@pytest.fixture
def quick(machines, capsys, monkeypatch):
    """Run the command line in this process; returns exit status, output and errors."""
    monkeypatch.chdir(machines.folder)
    return lambda *arguments: called(capsys, monkeypatch, *arguments)


def test_killed_worker_costs_nothing_and_results_are_those_of_local_processes(machines, quick):
    machines.have_workers(2)
    running = machines.rosa("campaign", "small.toml", "--cluster", machines.address, "--out", "far")
    machines.wait_for(lambda: running.poll() is not None or len(machines.lines("far")) > 2)
    machines.workers[0].kill()
    out, err = running.communicate()
    assert running.returncode == 0, out + err
    assert f"{RUNS} of {RUNS} runs done, {RUNS} of them now" in out
    names = [record["run"] for record in machines.lines("far")]
    assert len(names) == len(set(names)) == RUNS
    assert quick("campaign", "small.toml", "--workers", "1", "--out", "near")[0] == 0
    for name in TABLES:
        assert (machines.folder / "far" / name).read_bytes() == (
            machines.folder / "near" / name
        ).read_bytes()


def test_run_that_kills_its_workers_is_recorded_and_the_others_go_on(machines):
    machines.have_workers(3)
    (machines.folder / "c.toml").write_text(
        'missions = ["suave"]\nmanagers = ["none", "fatal:Fatal"]\nruns = 1\n[settings]\nduration_s = 5\n'
    )
    running = machines.rosa("campaign", "c.toml", "--cluster", machines.address, "--out", "c")
    out, err = running.communicate()
    assert running.returncode == 1, out + err
    found = {one["run"]: one.get("error") for one in machines.lines("c")}
    assert found == {
        "suave/none/duration_s=5/0": None,
        "suave/fatal:Fatal/duration_s=5/0": "the process that ran it died",
    }


def test_cluster_that_cannot_do_it_is_refused_at_once(machines, quick):
    def refused():
        code, _, err = quick(
            "campaign", "small.toml", "--out", "refused", "--cluster", machines.address
        )
        assert code == 2, err
        shutil.rmtree(machines.folder / "refused")
        return " ".join(err.split())

    machines.have_workers(0)
    assert f"the scheduler at {machines.address} has no workers" in refused()

    other = machines.folder / "other"
    for package in PACKAGES:
        other_package = shutil.copytree(ROOT / package, other / package, ignore=IGNORED)
    (other_package / "changed.py").touch()
    machines.have_workers(1, path=[str(other)])
    assert "has code" in refused()

    bare = machines.folder / "bare" / "missions"
    bare.mkdir(parents=True)
    (bare / "__init__.py").touch()
    machines.have_workers(1, path=[str(bare.parent)])
    assert (
        "cannot do missions: ModuleNotFoundError: No module named 'missions.experiments'"
        in refused()
    )


def test_scheduler_that_is_not_there_is_told_with_what_starts_one(tmp_path, monkeypatch):
    from missions.engine.mission import MissionError
    from missions.experiments import workers

    monkeypatch.setattr(workers, "TIMEOUT_S", 0.5)
    with pytest.raises(
        MissionError, match=r"no scheduler at 127\.0\.0\.1:9: .*start one with `dask scheduler`"
    ):
        workers.Cluster("127.0.0.1:9")
