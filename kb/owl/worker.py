"""A process that holds a world and answers queries of it: what runs there stops nobody here, and can be stopped.

Python's regular expressions cannot be interrupted, nor can a parser, and both keep every other thread waiting. It is
started when it is first needed, which takes a second, and is used again by others when nobody needs it any more.
"""

import atexit
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import islice
from multiprocessing.connection import Connection, Pipe
from typing import Any, Final, TypeVar

from kb.exceptions import InvalidValue, KnowledgeBaseError, UnknownName
from kb.owl.individuals import Individual
from kb.owl.queries import Answer

_PROGRAM: Final = "import sys; sys.path[:] = {path!r}; from kb.owl.worker import serve; serve({descriptor})"
_MEMORY: Final = 4 << 30
"""How much it may use at most [bytes]."""
_AT_ONCE: Final = 500
"""How many individuals or rows are handed over at once: more would keep other threads from running."""
_GRACE: Final = 0.2
"""How much longer than its time a query may take to stop by itself, of that time, before its process is killed."""
_MOST_IDLE: Final = 2

_ERRORS: Final = {cls.__name__: cls for cls in (KnowledgeBaseError, InvalidValue, UnknownName)}

T = TypeVar("T")


class Worker:
    """A process, from here; one thread at a time talks to it, and any error ends it."""

    def __init__(self) -> None:
        self.owner, self._is_ready = os.getpid(), False
        self._line, theirs = Pipe()
        program = _PROGRAM.format(path=sys.path, descriptor=theirs.fileno())
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-c", program],
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )

    @property
    def is_alive(self) -> bool:
        return self.owner == os.getpid() and self._process.poll() is None

    def is_ready(self, deadline: float) -> bool:
        """Wait until it can be talked to, but not beyond a deadline of the monotonic clock [s]."""
        with self._or_ended():
            if not self._is_ready and self._line.poll(max(0.0, deadline - time.monotonic())):
                self._received()
                self._is_ready = True
        return self._is_ready

    def tell(self, method: str, *arguments: object) -> None:
        """Have a method of its `Book` called."""
        with self._or_ended():
            self._line.send((method, arguments))

    def write(self, context: str, given: Iterable[Individual]) -> None:
        for some in _parts(given):
            self.tell("write", context, some)

    def ask(self, query: str, timeout: float, deadline: float) -> list[tuple[Answer, ...]]:
        """Answer a query, for which a time [s] was allowed, before a deadline of the monotonic clock [s]."""
        self.tell("ask", query, timeout, max(0.01, deadline - time.monotonic()))
        rows: list[tuple[Answer, ...]] = []
        with self._or_ended():
            while True:
                left = deadline + _GRACE * timeout - time.monotonic()
                if not self._line.poll(max(0.0, left)):
                    raise stopped(timeout)
                some = self._received()
                if isinstance(some, KnowledgeBaseError):
                    break
                if some is None:
                    return rows
                rows += some
        raise some

    def end(self) -> None:
        if self.owner == os.getpid():
            self._process.kill()
            self._process.wait()
        else:
            self._process.returncode = 0  # it is another process's child
        self._line.close()

    def _received(self) -> Any:  # noqa: ANN401  # rows, an error, or None
        name, message, rows = self._line.recv()
        if name:
            cls = _ERRORS.get(name, KnowledgeBaseError)
            return cls.__new__(cls, message)
        return rows

    @contextmanager
    def _or_ended(self) -> Iterator[None]:
        """End it at any error, an interrupt too: what it would say next would be an answer to something else."""
        try:
            yield
        except (OSError, EOFError):
            self.end()
            raise KnowledgeBaseError(
                "the process that answers queries has ended, perhaps as it needed more than "
                f"{_MEMORY >> 30} GB; ask for less, or ask again"
            ) from None
        except BaseException:
            self.end()
            raise


def stopped(timeout: float) -> KnowledgeBaseError:
    return KnowledgeBaseError(f"the query was stopped after {timeout:g} s; ask for less, or allow it a longer timeout")


def _parts(given: Iterable[T]) -> Iterator[list[T]]:
    iterator = iter(given)
    while some := list(islice(iterator, _AT_ONCE)):
        yield some


# -------------------------------------------------------------------- those that nobody needs

_IDLE: Final[list[Worker]] = []


def take() -> Worker:
    while _IDLE:
        with suppress(IndexError):
            worker = _IDLE.pop()
            if worker.is_alive:
                return worker
            worker.end()
    return Worker()


def give_back(held: list[Worker]) -> None:
    for worker in held:
        if worker.is_alive and len(_IDLE) < _MOST_IDLE:
            _IDLE.append(worker)
        else:
            worker.end()
    held.clear()


@atexit.register
def _end_idle() -> None:
    while _IDLE:
        _IDLE.pop().end()


# -------------------------------------------------------------------- in the process


def serve(descriptor: int) -> None:
    """Do what comes in on a descriptor, until nothing can come any more."""
    from kb.owl.owlready import Book

    line = Connection(descriptor)
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    line.send(("", "", None))
    book: Book | None = None
    with suppress(EOFError, OSError):
        while True:
            method, arguments = line.recv()
            if method == "open":
                if book is not None:
                    book.close()
                book = Book(*arguments)
            elif method == "ask":
                *given, left = arguments
                signal.setitimer(signal.ITIMER_REAL, 2.0 * left + 5.0)  # should nobody be there to kill it
                _answer(line, book, given, left)
                signal.setitimer(signal.ITIMER_REAL, 0.0)
            else:
                getattr(book, method)(*arguments)


def _answer(line: Connection, book: Any, given: Sequence[Any], left: float) -> None:  # noqa: ANN401  # a Book, if it is open
    try:
        for some in _parts(book.ask(*given, time.monotonic() + left)):
            line.send(("", "", some))
        line.send(("", "", None))
    except KnowledgeBaseError as error:
        line.send((type(error).__name__, str(error), None))
    except MemoryError:
        message = f"the query needs more than {_MEMORY >> 30} GB of memory; ask for less"
        line.send((KnowledgeBaseError.__name__, message, None))
