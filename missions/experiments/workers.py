"""Run a campaign on processes of this machine or on workers of a cluster; both are executors."""

import json
import os
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from missions.engine.mission import MissionError, needs
from missions.experiments.campaign import PlannedRun
from missions.experiments.results import CRASHED, Outcome, Results, Store, provenance
from missions.views.output import as_json, summary

if TYPE_CHECKING:
    from missions.views.console import CampaignProgress

TIMEOUT_S = 10.0
WATCH_S = 0.5
_ALONE = threading.Lock()


def do(run: PlannedRun) -> Outcome:
    """Do a run and return its outcome, times in [s].

    An exception of the run is part of the outcome.

    A process does one run at a time, because the blackboard of py_trees belongs to the process.
    """
    with _ALONE:
        started = time.perf_counter()
        try:
            opened = run.open()
            verdict = opened.run()
        except (Exception, SystemExit) as error:
            return crash(run, f"{type(error).__name__}: {error}", traceback.format_exc())
        data = json.loads(as_json(summary(opened, verdict, run.seed, dict(run.settings))))
        record = {name: value for name, value in data.items() if not isinstance(value, dict | list)}
        record |= {**_head(run), "adaptations": len(data["adaptations"])}
        record["reactions"] = [[*reaction.values()] for reaction in data["reactions"]]
        timing = {"wall_s": time.perf_counter() - started}
        return Outcome(run.place, provenance()["code"], {**_head(run), **record}, timing)


def crash(run: PlannedRun, error: str, trace: str = "") -> Outcome:
    """Return the outcome of a run that crashed, with the command that repeats it."""
    record = {**_head(run), "outcome": CRASHED, "error": error, "rerun": run.command}
    return Outcome(run.place, provenance()["code"], record, {}, trace)


def _head(run: PlannedRun) -> dict[str, Any]:
    same = {name: getattr(run, name) for name in ("mission", "manager", "task", "seed")}
    return {"run": run.name, **same, "settings": dict(run.settings)}


class Workers(NamedTuple):
    """How many runs are done at once, what opens an executor, and what a dead process raises."""

    size: int
    open: Callable[[], Executor]
    killed: type[Exception]


def processes(count: int | None = None) -> Workers:
    """Return processes of this machine, by default as many as it has processors."""
    count = count or len(os.sched_getaffinity(0))

    def executor() -> Executor:
        return ProcessPoolExecutor(count, get_context("spawn"), end_with, (os.getpid(),))

    return Workers(count, executor, BrokenExecutor)


def cluster(address: str) -> Workers:
    """Return the workers of a dask cluster; a run whose worker dies is repeated by another.

    Raises:
        MissionError: there is no scheduler or no worker.
    """
    with needs("cluster", "--cluster"):
        from distributed import Client, KilledWorker
    try:
        client = Client(address, timeout=TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise MissionError(
            f"there is no scheduler at {address}: {error}; "
            f"start one with `dask scheduler`, workers with `dask worker {address} --nthreads 1`"
        ) from error
    count = len(client.scheduler_info(n_workers=-1)["workers"])
    if not count:
        raise MissionError(
            f"the scheduler at {address} has no workers; start some with `dask worker`"
        )
    return Workers(count, lambda: client.get_executor(pure=False), KilledWorker)


def outcomes(runs: Sequence[PlannedRun], workers: Workers) -> Iterator[Outcome]:
    """Do runs and yield the outcome of each as soon as it is known, in no order.

    When a process dies, each run that was under way is repeated alone, which shows the one that
    kills its process.
    """
    waiting = deque(runs)
    while waiting:
        for suspect in (yield from _together(waiting, workers)):
            if (yield from _together(deque([suspect]), workers)):
                yield crash(suspect, "the process that ran it died")


def _together(
    waiting: deque[PlannedRun], workers: Workers
) -> Generator[Outcome, None, list[PlannedRun]]:
    """Do runs until none is left or a process dies; return those that were under way then."""
    under_way: dict[Future[Outcome], PlannedRun] = {}
    suspects: list[PlannedRun] = []
    executor = workers.open()
    try:
        while under_way or (waiting and not suspects):
            while waiting and not suspects and len(under_way) < 2 * workers.size:
                future = executor.submit(do, waiting[0])
                under_way[future] = waiting.popleft()
            done, _ = wait(under_way, return_when=FIRST_COMPLETED)
            for future in done:
                run = under_way.pop(future)
                try:
                    yield future.result()
                except workers.killed:
                    suspects.append(run)
                except Exception as error:
                    raise MissionError(
                        f"{run.name} cannot be done: {type(error).__name__}: {error}"
                        "; "
                        "mend what is wrong with the workers, then go on with --resume"
                    ) from error
    except workers.killed:  # when a run was handed out
        suspects += under_way.values()
    finally:
        executor.shutdown()
    return suspects


def end_with(parent: int) -> None:
    """Kill this process when its parent is gone, even if that was killed."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_S)
        os.kill(os.getpid(), signal.SIGKILL)

    threading.Thread(target=watch, daemon=True).start()


def conduct(
    store: Store, folder: Path, workers: Workers, *, retry: bool, progress: "CampaignProgress"
) -> list[Path]:
    """Do every run that is not done yet, with `retry` also those that crashed.

    Write the tables and return them.

    Raises:
        MissionError: the folder cannot be written, or a worker cannot do missions.
    """
    left = Results(folder).left(retry=retry)
    progress.begin(store.campaign.size - len(left), store.campaign.size)
    for outcome in outcomes(sorted(left, key=lambda run: run.seed), workers):
        store.keep(outcome)
        progress.done(outcome.record)
    return Results(folder).write_tables(folder)
