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
    CancelledError,
    Executor,
    Future,
    wait,
)
from pathlib import Path
from typing import TYPE_CHECKING, Any

from missions.engine.mission import MissionError, needs
from missions.experiments.campaign import (
    CRASHED,
    Outcome,
    PlannedRun,
    Store,
    provenance,
    read_store,
    write_tables,
)
from missions.views.output import as_json, summary

if TYPE_CHECKING:
    from missions.views.console import CampaignProgress

TIMEOUT_S = 10.0
WATCH_S = 0.5
_ALONE = threading.Lock()


def do(run: PlannedRun) -> Outcome:
    """Do a run and return its outcome, times in [s]; an exception of the run is part of the outcome.

    A process does one run at a time, because the blackboard of py_trees belongs to the process.
    """
    with _ALONE:
        started = time.perf_counter()
        try:
            record, timing = _done(run)
        except (Exception, SystemExit) as error:
            return crash(run, f"{type(error).__name__}: {error}", traceback.format_exc())
        took = {"run": run.name, "wall_s": time.perf_counter() - started}
        return Outcome(run, provenance()["code"], record, took | timing)


def crash(run: PlannedRun, error: str, trace: str = "") -> Outcome:
    """Return the outcome of a run that crashed, with the command that repeats it."""
    record = {**_head(run), "outcome": CRASHED, "error": error, "rerun": run.command}
    return Outcome(run, provenance()["code"], record, {}, trace)


def _head(run: PlannedRun) -> dict[str, Any]:
    same = {name: getattr(run, name) for name in ("mission", "manager", "task", "seed")}
    return {"run": run.name, **same, "settings": dict(run.settings)}


def _done(run: PlannedRun) -> tuple[dict[str, Any], dict[str, Any]]:
    opened = run.open()
    verdict = opened.run()
    data = json.loads(as_json(summary(opened, verdict, run.seed, dict(run.settings))))
    figures = {name: value for name, value in data.items() if not isinstance(value, dict | list)}
    reactions = [
        [one.uncertainty, round(one.start_s, 6), round(one.delay_s, 6)]
        for one, _ in opened.reactions
    ]
    thought = [[one.uncertainty, took_s] for one, took_s in opened.reactions]
    record = {
        **_head(run),
        **figures,
        **_head(run),
        "adaptations": len(opened.adaptations),
        "reactions": reactions,
    }
    return record, {"compute_s": opened.compute_s, "reactions": thought}


class Processes:
    """Processes of this machine, by default as many as it has processors; each imports what it needs once.

    Attributes:
        count: how many runs are done at once.
        killed: the exceptions of runs that were under way when a process died.
    """

    killed: tuple[type[Exception], ...] = (BrokenExecutor,)

    def __init__(self, count: int | None = None) -> None:
        from joblib import cpu_count

        self.count = count or int(cpu_count())
        self._executor: Any = None

    def executor(self) -> Executor:
        """Return the executor to submit runs to."""
        from joblib.externals.loky import ProcessPoolExecutor

        if self._executor is None:
            self._executor = ProcessPoolExecutor(
                self.count, initializer=end_with, initargs=(os.getpid(),)
            )
        started: Executor = self._executor
        return started

    def renew(self) -> None:
        """End all processes after one has died; new ones are started when they are needed."""
        self.close()

    def look(self) -> str:
        """Return a note on the workers, called while no result comes; empty if all is well."""
        return ""

    def close(self) -> None:
        if self._executor is not None:
            self._executor.shutdown(wait=True, kill_workers=True)
            self._executor = None


class Cluster:
    """Workers of a dask cluster, used like `Processes`.

    A run whose worker dies is repeated; it is given up when several workers died during it.

    Raises:
        MissionError: there is no scheduler or no worker, or a worker lacks a module or has other versions.
    """

    def __init__(self, address: str, modules: Sequence[str] = ()) -> None:
        with needs("cluster", "--cluster"):
            from distributed import Client, KilledWorker
        self._address, self.killed = address, (KilledWorker,)
        try:
            self._client = Client(address, timeout=TIMEOUT_S, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            advice = f"start one with `dask scheduler`, and workers with `dask worker {address} --nthreads 1`"
            raise MissionError(f"there is no scheduler at {address}: {error}; {advice}") from error
        try:
            self._check(modules)
        except BaseException:
            self.close()
            raise

    @property
    def count(self) -> int:
        return len(self._client.scheduler_info(n_workers=-1)["workers"])

    def executor(self) -> Executor:
        executor: Executor = self._client.get_executor(
            pure=False
        )  # a repeated run must not return the old result
        return executor

    def renew(self) -> None:
        """Do nothing: who started the workers has to restart them."""

    def look(self) -> str:
        return (
            "" if self.count else f"no worker is left at {self._address}; waiting for one to come"
        )

    def close(self) -> None:
        self._client.close()

    def _check(self, modules: Sequence[str]) -> None:
        """Ask every worker for its versions; one that lacks the package could not answer anything else."""
        if not self.count:
            raise MissionError(
                f"the scheduler at {self._address} has no workers; start some with `dask worker`"
            )
        answers = self._client.run(_probe(tuple(modules)), on_error="return")
        for worker, answer in sorted(answers.items()):
            if isinstance(answer, Exception):
                raise MissionError(
                    f"worker {worker} cannot do missions: {type(answer).__name__}: {answer}"
                )
            for name, here in provenance().items():
                if (there := answer.get(name)) != here:
                    raise MissionError(
                        f"worker {worker} has {name} {there}, here is {here}; install the same"
                    )


Workers = Processes | Cluster


def outcomes(
    runs: Sequence[PlannedRun], workers: Workers, idle: Callable[[str], None]
) -> Iterator[Outcome]:
    """Do runs and yield the outcome of each as soon as it is known, in no order.

    When a process dies, each run that was under way is repeated alone, which shows the one that kills its process.
    While no result comes, `idle` is called with the note of `workers.look`.
    """
    waiting = deque(runs)
    while waiting:
        for suspect in (yield from _together(waiting, workers, idle)):
            if (yield from _together(deque([suspect]), workers, idle)):
                yield crash(suspect, "the process that ran it died")


def _together(
    waiting: deque[PlannedRun], workers: Workers, idle: Callable[[str], None]
) -> Generator[Outcome, None, list[PlannedRun]]:
    """Do runs until none is left or a process dies; return those that were under way then."""
    under_way: dict[Future[Outcome], PlannedRun] = {}
    suspects: list[PlannedRun] = []
    while under_way or (waiting and not suspects):
        if not suspects:
            _hand_out(waiting, under_way, workers)
        done, _ = wait(under_way, timeout=TIMEOUT_S, return_when=FIRST_COMPLETED)
        if not done and (text := workers.look()):
            idle(text)
        for future in done:
            run = under_way.pop(future)
            try:
                yield future.result()
            except workers.killed:
                suspects.append(run)
            except CancelledError as error:
                raise MissionError(
                    "the scheduler is gone; go on with --resume when it is back"
                ) from error
            except Exception as error:  # the outcome could not be sent here
                yield crash(run, f"{type(error).__name__}: {error}")
    if suspects:
        workers.renew()
    return suspects


def _hand_out(
    waiting: deque[PlannedRun], under_way: dict[Future[Outcome], PlannedRun], workers: Workers
) -> None:
    for _ in range(2 * workers.count - len(under_way)):
        if not waiting:
            return
        try:
            future = workers.executor().submit(do, waiting[0])
        except (
            workers.killed
        ):  # a process has died: the runs under way will raise it, if there are any
            if not under_way:
                workers.renew()
            return
        under_way[future] = waiting.popleft()


def end_with(parent: int) -> None:
    """Watch the parent from a thread and kill this process when the parent is gone, even if that was killed."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_S)
        os.kill(os.getpid(), signal.SIGKILL)

    threading.Thread(target=watch, daemon=True).start()


def _probe(modules: tuple[str, ...]) -> Callable[[], dict[str, str]]:
    """Return a function for workers; it is sent as code, so it reaches even one that lacks the package."""

    def probe() -> dict[str, str]:
        from importlib import import_module

        from missions.experiments.campaign import provenance

        for name in modules:
            import_module(name)
        return dict(provenance())

    return probe


def conduct(
    store: Store, folder: Path, workers: Workers, *, retry: bool, progress: "CampaignProgress"
) -> list[Path]:
    """Do every run that is not done yet, with `retry` also those that crashed; write the tables and return them.

    Raises:
        MissionError: the folder cannot be written, or the scheduler is gone.
    """
    done = read_store(folder).done(retry=retry)
    left = sorted(
        (run for run in store.campaign.planned() if run.place not in done), key=lambda run: run.seed
    )
    progress.begin(len(done), len(done) + len(left))
    for outcome in outcomes(left, workers, progress.note):
        store.keep(outcome)
        progress.done(outcome.record)
    return write_tables(read_store(folder), folder)
