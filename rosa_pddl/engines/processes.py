"""Runs external programs: starts them quickly, passes input, reads output, and ends them with all their children."""

import atexit
import os
import resource
import select
import signal
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from dataclasses import dataclass
from typing import BinaryIO
from weakref import WeakSet

from rosa_pddl.domain import Outcome, Trouble

INSTALL_ADVICE = "try 'pip install --force-reinstall up-fast-downward'"
"""Advice for the case that a program does not work."""

# A plan of a million steps is smaller than this; an engine that writes more is printing without end.
_MOST_OUTPUT = 64 << 20
_LOOKS_S = 0.05
_GRACE_S = 2
_NO_PYTHON_NOISE = {"PYTHONWARNINGS": "ignore", "PYTHONHASHSEED": "0"}


class Cancelled(Exception):
    """The answer is no longer wanted; raised where a program runs or would start."""


@dataclass(frozen=True)
class Ended:
    """A program that has ended: its exit code, or minus the signal that killed it, and its output."""

    code: int
    output: bytes
    complaints: bytes

    @property
    def last_words(self) -> str:
        said = (self.output[-2000:] + b"\n" + self.complaints[-2000:]).decode(errors="replace")
        text = "".join(letter if letter.isprintable() or letter == "\n" else "?" for letter in said)
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        return " / ".join(lines[-3:])[-400:] or "nothing"


class ProcessHandle:
    """Runs programs, one at a time; cancelling kills the running program, and no program can start any more.

    Each program leads its own process group, which is killed after the program has ended for whatever reason: no child
    survives, and a child that keeps the output open is not waited for. The memory limit of a program is in bytes.
    """

    def __init__(self, memory_bytes: int | None = None) -> None:
        self._memory_bytes = memory_bytes
        _HANDLES.add(self)
        self.is_running = False
        self._is_cancelled: Future[None] = Future()

    def cancel(self) -> None:
        """End the running program, as its answer is no longer wanted. Returns at once.

        The thread that runs the program soon kills it; so there is no lock that an interrupt could leave locked.
        """
        with suppress(InvalidStateError):
            self._is_cancelled.set_result(None)

    def ask(
        self,
        command: Sequence[str],
        *,
        given: bytes = b"",
        limit_s: float,
        environment: Mapping[str, str] | None = None,
    ) -> Ended:
        """Run a program for at most `limit_s` of wall-clock time [s]; raises Cancelled, or Trouble if it fails.

        The program reads `given` from its input; `environment` adds variables to those of this process.
        """
        with _in_memory(given) as read, _in_memory() as output, _in_memory() as complaints:
            self.check()
            self.is_running = True
            try:
                process = subprocess.Popen(
                    command,
                    stdin=read,
                    stdout=output,
                    stderr=complaints,
                    start_new_session=True,
                    env={**os.environ, **_NO_PYTHON_NOISE, **(environment or {})},
                )
                try:
                    _limit(process.pid, limit_s, self._memory_bytes)
                    verdict = _verdict(
                        process.pid, limit_s, (output, complaints), self._is_cancelled.done
                    )
                finally:
                    # before the program is reaped, as until then no other group can have its number
                    with suppress(ProcessLookupError):
                        os.killpg(process.pid, signal.SIGKILL)
                    process.wait()
            except OSError as error:
                raise Trouble(
                    Outcome.ENGINE_MISSING, f"it cannot be started ({error}); {INSTALL_ADVICE}"
                ) from error
            finally:
                self.is_running = False
            self.check()
            ended = Ended(process.returncode, _content(output), _content(complaints))
        if verdict == "late":
            raise Trouble(
                Outcome.OUT_OF_TIME,
                f"no answer after {limit_s:.3g} s; allow more time or ask for less",
            )
        if verdict == "endless":
            raise Trouble(Outcome.ENGINE_CRASHED, f"it printed without end: {ended.last_words}")
        return ended

    def check(self) -> None:
        if self._is_cancelled.done():
            raise Cancelled


def _in_memory(content: bytes = b"") -> BinaryIO:
    """Make a file in memory: faster than a pipe, needs no reader meanwhile, and leaves nothing behind."""
    file = os.fdopen(os.memfd_create("rosa_pddl"), "w+b")
    file.write(content)
    file.seek(0)
    return file


def _content(file: BinaryIO) -> bytes:
    return os.pread(file.fileno(), min(os.fstat(file.fileno()).st_size, _MOST_OUTPUT), 0)


def _limit(pid: int, limit_s: float, memory_bytes: int | None) -> None:
    with suppress(ProcessLookupError):
        # a limit of CPU time also ends a program when this process has been killed
        seconds = int(limit_s) + _GRACE_S
        resource.prlimit(pid, resource.RLIMIT_CPU, (seconds, seconds))
        if memory_bytes is not None:
            resource.prlimit(pid, resource.RLIMIT_DATA, (memory_bytes, memory_bytes))


def _verdict(
    pid: int, limit_s: float, written: Sequence[BinaryIO], is_cancelled: Callable[[], bool]
) -> str:
    """Wait for a program; return why the waiting ended: `itself`, `late`, `endless` or `cancelled`."""
    deadline, file = time.monotonic() + limit_s, os.pidfd_open(pid)
    try:
        poll = select.poll()
        poll.register(file, select.POLLIN)
        while (left_s := deadline - time.monotonic()) > 0.0:
            if poll.poll(min(left_s, _LOOKS_S) * 1e3):
                return "itself"
            if any(os.fstat(one.fileno()).st_size > _MOST_OUTPUT for one in written):
                return "endless"
            if is_cancelled():
                return "cancelled"
        return "late"
    finally:
        os.close(file)


_HANDLES: WeakSet[ProcessHandle] = WeakSet()


@atexit.register
def _cancel_all() -> None:
    handles = tuple(_HANDLES)
    for handle in handles:
        handle.cancel()
    deadline = time.monotonic() + _GRACE_S
    while any(handle.is_running for handle in handles) and time.monotonic() < deadline:
        time.sleep(_LOOKS_S / 10)
