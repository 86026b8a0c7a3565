"""A process that holds a world and answers queries of it: what runs there stops nobody here, and can be stopped.

A query cannot be interrupted, so what takes too long is ended with its process. That is started when it is first
needed, and is used again by others when nobody needs it any more.
"""

import atexit
import os
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
from typing import Final, TypeVar

from kb.exceptions import InvalidValue, KnowledgeBaseError, UnknownName
from kb.owl.individuals import Individual

_PROGRAM: Final = "import sys; sys.path[:] = {path!r}; from kb.owl.queries import serve; serve({descriptor})"
MEMORY: Final = 4 << 30  # that it may use at most [bytes]
_AT_ONCE: Final = 500  # individuals or rows; to hand over more would keep other threads from running
_GRACE: Final = 0.2  # of its time, in which a query may stop by itself before its process is killed
_MOST_IDLE: Final = 2
_IDLE: Final[list["Worker"]] = []
_ERRORS: Final = {cls.__name__: cls for cls in (InvalidValue, UnknownName)}
ENDED: Final = f"the process that answers queries has ended; if it needed more than {MEMORY >> 30} GB, ask for less"

Answer = str | bool | int | float | None
T = TypeVar("T")


class Worker:
    """A process, from here; one thread at a time talks to it, and any error ends it."""

    def __init__(self) -> None:
        from multiprocessing.connection import Pipe  # it takes a while to import

        self._owner, self._is_ready = os.getpid(), False
        self._line, theirs = Pipe()
        program = _PROGRAM.format(path=sys.path, descriptor=theirs.fileno())
        command, given, none = [sys.executable, "-c", program], (theirs.fileno(),), subprocess.DEVNULL
        with theirs:
            self._process = subprocess.Popen(
                command, pass_fds=given, start_new_session=True, stdin=none, stdout=none, stderr=none
            )

    @property
    def is_alive(self) -> bool:
        return self._owner == os.getpid() and self._process.poll() is None

    def is_ready(self, deadline: float) -> bool:
        """Wait until it can be talked to, but not beyond a deadline of the monotonic clock [s]."""
        with self._or_ended():
            if not self._is_ready and self._line.poll(max(0.0, deadline - time.monotonic())):
                self._is_ready = self._line.recv() is not None
        return self._is_ready

    def tell(self, method: str, *arguments: object) -> None:
        """Have a method of its `Book` called."""
        with self._or_ended():
            self._line.send((method, arguments))

    def write(self, context: str, given: Iterable[Individual]) -> Iterator[None]:
        for some in parts(given):
            self.tell("write", context, some)
            yield

    def ask(self, query: str, timeout: float, deadline: float) -> list[tuple[Answer, ...]]:
        """Answer a query, for which a time [s] was allowed, before a deadline of the monotonic clock [s]."""
        self.tell("ask", query, timeout, max(0.01, deadline - time.monotonic()))
        rows: list[tuple[Answer, ...]] = []
        with self._or_ended():
            while self._line.poll(max(0.0, deadline + _GRACE * timeout - time.monotonic())):
                error, some = self._line.recv()
                if error or some is None:
                    break
                rows += some
            else:
                raise stopped(timeout)
        if not error:
            return rows
        cls = _ERRORS.get(error, KnowledgeBaseError)
        raise cls.__new__(cls, some)

    def end(self) -> None:
        if self._owner == os.getpid():
            self._process.kill()
            self._process.wait()
        self._process.returncode = 0  # also of another process's child, for which nobody waits here
        self._line.close()

    @contextmanager
    def _or_ended(self) -> Iterator[None]:
        """End it at any error, an interrupt too: what it would say next would be an answer to something else."""
        try:
            yield
        except BaseException as error:
            self.end()
            if isinstance(error, OSError | EOFError):
                raise KnowledgeBaseError(ENDED) from None
            raise


def stopped(timeout: float) -> KnowledgeBaseError:
    return KnowledgeBaseError(f"the query was stopped after {timeout:g} s; ask for less, or allow it a longer timeout")


def parts(given: Iterable[T]) -> Iterator[list[T]]:
    iterator = iter(given)
    while some := list(islice(iterator, _AT_ONCE)):
        yield some


def take() -> Worker:
    while _IDLE:
        worker = _IDLE.pop()
        if worker.is_alive:
            return worker
        worker.end()
    return Worker()


@atexit.register
def give_back(held: list[Worker] = _IDLE) -> None:
    """Keep workers that nobody needs for others, but not many, and none at the end of the program."""
    while held:
        worker = held.pop()
        if held is not _IDLE and worker.is_alive and len(_IDLE) < _MOST_IDLE:
            _IDLE.append(worker)
        else:
            worker.end()
