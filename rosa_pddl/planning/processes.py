"""Programs of others: started quickly, fed, read, and ended with everything that they started."""

import atexit
import os
import resource
import selectors
import signal
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from threading import Lock
from typing import IO, Any, TypeVar
from weakref import WeakSet

__all__ = ["Cut", "Ended", "Leash"]

T = TypeVar("T")

_CHUNK = 1 << 20
# A plan of a million steps is smaller than this; what is longer is an engine that prints without end.
_MOST_OUTPUT = 64 << 20
_GRACE_S = 2
_NO_PYTHON_NOISE = {"PYTHONWARNINGS": "ignore", "PYTHONHASHSEED": "0"}


class Cut(Exception):
    """The leash was cut while a program ran, or before it could start: who wanted the answer wants it no more."""


@dataclass(frozen=True)
class Ended:
    """A program that has ended.

    Args:
        code: exit code; negative for the signal that killed it.
        output: what it wrote to its standard output.
        complaints: what it wrote to its standard error.
        is_late: whether it was killed because its time was over.
        is_endless: whether it was killed because it printed without end.
    """

    code: int
    output: bytes
    complaints: bytes
    is_late: bool = False
    is_endless: bool = False

    @property
    def last_words(self) -> str:
        """The last lines that it wrote, for a message."""
        said = (self.output[-2000:] + b"\n" + self.complaints[-2000:]).decode(errors="replace")
        text = "".join(letter if letter.isprintable() or letter == "\n" else "?" for letter in said)
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        return " / ".join(lines[-3:])[-400:] or "nothing"


class Leash:
    """Runs programs, one at a time; cutting it kills the one that runs, and lets none start any more.

    Each program leads a process group of its own, which is killed when the program has ended, however it ended:
    no child of it survives.
    """

    def __init__(self) -> None:
        _LEASHES.add(self)
        self._lock = Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._is_cut: Future[None] = Future()

    def cut(self) -> None:
        """End what runs, as its answer is no longer wanted. Returns at once."""
        with self._lock:
            if not self._is_cut.done():
                self._is_cut.set_result(None)
            if self._process is not None:
                _kill_group(self._process)

    def wait(self, future: "Future[T]", limit_s: float) -> T:
        """Wait for something that another thread makes, for as long as the leash is not cut.

        Raises:
            Cut: it is.
            TimeoutError: it was not there in time.
        """
        either: list[Future[Any]] = [future, self._is_cut]
        wait(either, limit_s, FIRST_COMPLETED)
        self.check()
        return future.result(0)

    def check(self) -> None:
        """Raise if the leash is cut.

        Raises:
            Cut: it is.
        """
        if self._is_cut.done():
            raise Cut

    def run(
        self,
        command: Sequence[str],
        *,
        given: bytes = b"",
        limit_s: float,
        memory_bytes: int | None = None,
        environment: Mapping[str, str] | None = None,
        folder: str | None = None,
    ) -> Ended:
        """Run a program to its end.

        Args:
            command: the program and its arguments.
            given: what it reads from its standard input.
            limit_s: wall-clock time after which it is killed [s].
            memory_bytes: how much data it may hold [B]; None for no limit.
            environment: variables to add to those of this process.
            folder: its working directory; by default that of this process.

        Raises:
            Cut: the leash is or was cut.
            OSError: the program cannot be started.
        """
        with self._started(command, given, environment, folder) as process:
            _limit(process.pid, limit_s, memory_bytes)
            talk = _Talk(process)
            verdict = talk.until_end(time.monotonic() + limit_s)
        self.check()
        return Ended(process.returncode, talk.output, talk.complaints, verdict == "late", verdict == "endless")

    @contextmanager
    def _started(
        self, command: Sequence[str], given: bytes, environment: Mapping[str, str] | None, folder: str | None
    ) -> "Iterator[subprocess.Popen[bytes]]":
        with _in_memory(given) as read, self._lock:
            self.check()
            process = self._process = subprocess.Popen(
                command,
                stdin=read,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                bufsize=0,
                start_new_session=True,
                cwd=folder,
                env={**os.environ, **_NO_PYTHON_NOISE, **(environment or {})},
            )
        try:
            yield process
        finally:
            # before it is reaped, as until then its number is that of no other group
            with self._lock:
                _kill_group(process)
                process.wait()
                self._process = None
            for pipe in (process.stdout, process.stderr):
                if pipe is not None:
                    pipe.close()


@contextmanager
def _in_memory(given: bytes) -> Iterator[int]:
    """Make a file without a name: a program reads it faster than a pipe, and nothing is left of it."""
    file = os.memfd_create("given", os.MFD_CLOEXEC)
    try:
        rest = memoryview(given)
        while rest:
            rest = rest[os.write(file, rest) :]
        os.lseek(file, 0, os.SEEK_SET)
        yield file
    finally:
        os.close(file)


def _limit(pid: int, limit_s: float, memory_bytes: int | None) -> None:
    with suppress(ProcessLookupError):
        # a program that outlives this process, because that was killed, still comes to its end
        seconds = int(limit_s) + _GRACE_S
        resource.prlimit(pid, resource.RLIMIT_CPU, (seconds, seconds))
        if memory_bytes is not None:
            resource.prlimit(pid, resource.RLIMIT_DATA, (memory_bytes, memory_bytes))


def _end_all() -> None:
    for leash in tuple(_LEASHES):
        leash.cut()


def _kill_group(process: "subprocess.Popen[bytes]") -> None:
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


class _Talk:
    """Reads what a program writes until it ends; a grandchild that keeps the pipes open is not waited for."""

    def __init__(self, process: "subprocess.Popen[bytes]") -> None:
        self._process = process
        self._read: dict[IO[bytes], list[bytes]] = {}
        self._size = 0

    @property
    def output(self) -> bytes:
        return self._text(self._process.stdout)

    @property
    def complaints(self) -> bytes:
        return self._text(self._process.stderr)

    def until_end(self, deadline: float) -> str:
        """Return why it ended: `itself`, `late` or `endless`."""
        with ExitStack() as stack:
            selector = stack.enter_context(selectors.DefaultSelector())
            ends = os.pidfd_open(self._process.pid)
            stack.callback(os.close, ends)
            selector.register(ends, selectors.EVENT_READ)
            self._register(selector)
            return self._listen(selector, ends, deadline)

    def _register(self, selector: selectors.BaseSelector) -> None:
        for pipe in (self._process.stdout, self._process.stderr):
            if pipe is not None:
                os.set_blocking(pipe.fileno(), False)
                selector.register(pipe, selectors.EVENT_READ)
                self._read[pipe] = []

    def _listen(self, selector: selectors.BaseSelector, ends: int, deadline: float) -> str:
        while True:
            left_s = deadline - time.monotonic()
            if left_s <= 0.0:
                return "late"
            ready = [key.fileobj for key, _ in selector.select(left_s)]
            for thing in ready:
                if thing in self._read:
                    self._take(selector, thing)
            if ends in ready:
                # a pipe holds less than one read takes, so this is all that the program wrote
                for pipe in self._read:
                    self._take(selector, pipe)
                return "itself"
            if self._size > _MOST_OUTPUT:
                return "endless"

    def _take(self, selector: selectors.BaseSelector, pipe: IO[bytes]) -> None:
        try:
            part = os.read(pipe.fileno(), _CHUNK)
        except BlockingIOError:
            return
        self._read[pipe].append(part)
        self._size += len(part)
        if not part:
            with suppress(KeyError):
                selector.unregister(pipe)

    def _text(self, pipe: IO[bytes] | None) -> bytes:
        return b"" if pipe is None else b"".join(self._read.get(pipe, []))


_LEASHES: WeakSet[Leash] = WeakSet()
atexit.register(_end_all)
