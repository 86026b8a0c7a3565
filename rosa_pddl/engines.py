"""Asks planners by others, in a process of its own that stays: see `worker`."""

import atexit
import json
import os
import resource
import select
import signal
import subprocess
import sys
import time
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from threading import Event, Lock
from typing import Any, Final
from weakref import WeakSet

from rosa_pddl.domain import nearest
from rosa_pddl.problem import Outcome, PddlText, PlanningFailed
from rosa_pddl.worker import fast_downward_command

OPTIMAL: Final = "fast-downward-opt"
FAST: Final = "fast-downward"
KAIROS: Final = "kairos"
DOWNWARD: Final = (OPTIMAL, FAST)

WORKER = Path(__file__).with_name("worker.py")
_LOOKS_S = 0.05
_GRACE_S = 1.0
_MEMORY_MB = 4096


class Cancelled(Exception):
    """The answer is no longer wanted."""


class EngineProcess:
    """A process that answers one question at a time; the next one starts it anew after a crash.

    It leads its own process group, which is killed with it, and works in a folder of its own, which
    goes with it: no child and no file survives.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = Lock()

    def ask(
        self, engine: str, text: PddlText, cancelled: Event, limit_s: float
    ) -> tuple[Outcome, list[Any]]:
        """Ask an engine; raise PlanningFailed for trouble, or Cancelled.

        Returns:
            The outcome, and the steps: action, arguments, and if it says them start and duration.
        """
        deadline = time.monotonic() + limit_s
        if limit_s <= 0.0 or not self._lock.acquire(timeout=limit_s):
            raise PlanningFailed(Outcome.OUT_OF_TIME, "no time was left for this question")
        try:
            process = self._running()
            question = {
                "engine": engine,
                "domain": text.domain,
                "problem": text.problem,
                "limit_s": max(deadline - time.monotonic(), 0.01),
                "memory_mb": _MEMORY_MB,
            }
            line = _answer(process, json.dumps(question).encode() + b"\n", cancelled, deadline)
        except BaseException:
            self._end()  # what it is doing is not waited for
            raise
        finally:
            self._lock.release()
        answer = json.loads(line)
        outcome = Outcome(answer["outcome"])
        if outcome.is_trouble:
            raise PlanningFailed(outcome, answer["message"])
        return outcome, answer["plan"]

    def _running(self) -> subprocess.Popen[bytes]:
        """Return the process, started if need be."""
        if self._process is not None and self._process.poll() is None:
            return self._process
        self._end()
        self._folder = mkdtemp(prefix="rosa-pddl-")
        settings = {
            "PYTHONPATH": os.pathsep.join(sys.path),
            "PYTHONWARNINGS": "ignore",
            "PYTHONHASHSEED": "0",
        }
        process = subprocess.Popen(
            [sys.executable, "-P", str(WORKER)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            cwd=self._folder,
            env=os.environ | settings,
        )
        self._process = process
        _PROCESSES.add(self)
        memory = _MEMORY_MB << 20
        resource.prlimit(process.pid, resource.RLIMIT_DATA, (memory, memory))
        return process

    def close(self) -> None:
        """End the process; the thread that waits for its answer sees the end and lets go of it."""
        _kill(self._process)
        with self._lock:
            self._end()

    def _end(self) -> None:
        """End the process, and close its pipes. The caller holds the lock."""
        process = self._process
        self._process = None
        if process is not None:
            _kill(process)
            process.communicate()  # which closes its pipes
            rmtree(self._folder, ignore_errors=True)

    def __del__(self) -> None:
        self.close()


def _answer(
    process: subprocess.Popen[bytes], question: bytes, cancelled: Event, deadline: float
) -> bytes:
    assert process.stdin is not None
    assert process.stdout is not None
    line = b""
    with suppress(BrokenPipeError):  # it has ended, which is seen below
        process.stdin.write(question)
        process.stdin.flush()
    while not line.endswith(b"\n"):
        if cancelled.is_set():
            raise Cancelled
        if time.monotonic() > deadline + _GRACE_S:
            raise PlanningFailed(
                Outcome.OUT_OF_TIME, "no answer in time; allow more time or ask for less"
            )
        if select.select([process.stdout], [], [], _LOOKS_S)[0]:
            read = os.read(process.stdout.fileno(), 1 << 16)
            if not read:
                message = f"its process ended with code {process.wait()}; the next is a new one"
                raise PlanningFailed(Outcome.ENGINE_CRASHED, message)
            line += read
    return line


def _kill(process: subprocess.Popen[bytes] | None) -> None:
    if process is not None:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


_PROCESSES = WeakSet[EngineProcess]()


@atexit.register
def _close_all() -> None:
    for process in tuple(_PROCESSES):
        process.close()


def check_name(engine: str) -> str | None:
    """Return what is wrong with the name of an engine, else None."""
    if engine in (*DOWNWARD, KAIROS):
        return None
    from unified_planning.engines.factory import DEFAULT_ENGINES

    names = [*DOWNWARD, KAIROS, *DEFAULT_ENGINES]
    if engine in names:
        return None
    ours = "ours are fast-downward-opt, fast-downward and kairos"
    return f"there is no planning engine {engine!r}; {ours}; {nearest(str(engine), names)}"


def missing_package(engine: str) -> str | None:
    """Return what to install if an engine is missing, else None."""
    if engine in DOWNWARD:
        is_there = bool(fast_downward_command())
        package = "up-fast-downward"
    elif engine == KAIROS:
        is_there = find_spec("kairos") is not None
        package = "kairos-planner"
    else:
        from unified_planning.engines.factory import DEFAULT_ENGINES

        module = DEFAULT_ENGINES[engine][0].split(".")[0]
        package = module.replace("_", "-")
        is_there = module == "unified_planning" or find_spec(module) is not None
    if is_there:
        return None
    return f"the planning engine {engine!r} is not installed; try 'pip install {package}'"
