"""The file that keeps what was told: opened by one process at a time, written by one thread, in order.

A commit holds whole calls, so a kill loses only the last of them. The file says in its header that it is ours and of
which format, so that any other is left alone.
"""

import fcntl
import json
import logging
import os
import sqlite3
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from kb.elements import Attribute
from kb.exceptions import KnowledgeBaseError
from kb.individuals import MODEL, STATED, Individual, Ref, named_id
from kb.journal import Group, Journal, Measured
from kb.rdfxml import ROSA

if TYPE_CHECKING:
    from kb.owl import Book

__all__ = ["FORMAT", "Store", "StoreError", "measurement"]

FORMAT: Final = 1
"""Of files that this version writes."""

_MAGIC: Final = b"SQLite format 3\0"
_OWNER: Final = 0x524F5341
"""ROSA in ASCII: the application id in the header of the file."""

_SLACK: Final = 256
"""How many measurements may be in excess before they are removed together."""

_PAUSE: Final = 0.001
"""How long the writer lets those who tell go on before it writes what they have told together [s]."""

_AHEAD: Final = 1 << 20
"""How much is written to the log beside the file before it is brought into the file [bytes]."""

_VALUE: Final = "SELECT o FROM datas WHERE p = (SELECT storid FROM resources WHERE iri = ?)"

_log = logging.getLogger(__name__)


class StoreError(KnowledgeBaseError):
    """A store cannot be opened, or is not one; it is as it was."""


def measurement(one: Measured) -> Individual:
    """Return a measurement as an individual."""
    about = Ref(named_id(Attribute, one.attribute))
    values: dict[str, tuple[Ref | float | bool, ...]] = {
        "measures": (about,),
        "value": (float(one.value),),
        "time": (float(one.time),),
    }
    if not one.latest:
        values["latest"] = (False,)
    return Individual("Measurement", f"{STATED}.{one.number}", values)


class Store:
    """Writes what a journal holds to a file, on a thread of its own.

    Args:
        path: of the file; made if it is not there.
        base: the IRI of the model.
        keep: how many measurements of each attribute are kept; the newest.

    Attributes:
        saved: number of the last fact in the file.
        error: why nothing is saved any more; None while all is well.

    Raises:
        StoreError: the file cannot be opened, or is no store.
    """

    def __init__(self, path: Path, base: str, declared: str, given: Iterable[Individual], keep: int) -> None:
        self.path, self.keep = path, keep
        self.saved = 0
        self.error: str | None = None
        self.is_new = not _has_content(path) and _make(path, base, declared, given)
        self._guard = _guarded(path)
        try:
            _check_format(path, self._guard)
            self._connection = _locked(path)
        except StoreError:
            os.close(self._guard)
            raise
        self.book: Book
        self._journal: Journal
        self._base: AbstractContextManager[object]
        self._measured: dict[str, deque[int]] = {}
        self._excess: list[int] = []
        self._using = threading.Lock()
        self._progress = threading.Condition()
        self._wake = threading.Lock()
        self._wake.acquire()
        self._closing = False
        self._thread: threading.Thread | None = None
        self._on_error: Callable[[str], None] | None = None

    @property
    def declared(self) -> str:
        """The model as it was when the store was made."""
        with _blamed(self.path):
            text = str(_said(self._connection, "declared"))
            json.loads(text)
            return text

    def amendments(self) -> list[str]:
        """Return the changes of the model, in order."""
        with _blamed(self.path):
            found = self._connection.execute(f"{_VALUE} ORDER BY s", (f"{ROSA}change",)).fetchall()
            return [text for (text,) in found if json.loads(text)]

    def open(self, base: str) -> list[Individual]:
        """Take up the file; returns what was told, in order."""
        from kb.owl import Book

        with _blamed(self.path):
            self._connection.execute("PRAGMA journal_mode=WAL")
            self._connection.execute("PRAGMA synchronous=NORMAL")
            (page,) = self._connection.execute("PRAGMA page_size").fetchone()
            self._connection.execute(f"PRAGMA wal_autocheckpoint={_AHEAD // page}")
            self._connection.execute(f"PRAGMA journal_size_limit={_AHEAD}")
            self.book = Book(base, self.path, self._connection)
            self.book.commit()  # what owlready2 notes at each opening; an open transaction would keep copies waiting
            facts = self.book.facts()
            self.saved = int(str(_said(self._connection, "told")))
        for one in facts:
            if one.kind == "Measurement" and isinstance(one.values["measures"][0], Ref):
                self._count(one.values["measures"][0].id, int(one.id.rpartition(".")[2]))
        return facts

    def start(self, journal: Journal, base: AbstractContextManager[object], on_error: Callable[[str], None]) -> None:
        """Write from now on; if that fails, say so once and stop.

        Args:
            journal: what is told to it.
            base: the lock that whoever tells holds.
            on_error: called with what is wrong.
        """
        self._journal, self._base, self._on_error = journal, base, on_error
        self._thread = threading.Thread(target=self._run, name=f"store {self.path.name}", daemon=True)
        self._thread.start()

    def wake(self) -> None:
        """Have it look for something to write; the quickest way to wake a thread."""
        if self._wake.locked():
            with suppress(RuntimeError):  # another thread was quicker
                self._wake.release()

    def flush(self, timeout: float | None = None) -> bool:
        """Wait until all that was told by now is in the file; returns whether it is."""
        wanted = self._journal.told
        self.wake()
        with self._progress:
            self._progress.wait_for(lambda: self.saved >= wanted or self.error or self._closing, timeout)
        return self.saved >= wanted

    def copy_to(self, other: "Book") -> None:
        """Copy what is in the file."""
        with self._using:
            self.book.copy_to(other)

    @property
    def is_closed(self) -> bool:
        """Whether the file is given back."""
        return self._closing

    def close(self) -> None:
        """Write what is left, and give the file back."""
        if not self._closing:
            self.finish()
            self.release()

    def finish(self) -> None:
        """Write what is left; `release` has to follow."""
        self._closing = True
        self.wake()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()
        with self._using, suppress(sqlite3.Error):
            if self.error is None:
                self._connection.execute("PRAGMA journal_mode=DELETE")

    def release(self) -> None:
        """Give the file back as it is."""
        self._closing = True
        with suppress(sqlite3.Error):
            self._connection.close()
        os.close(self._guard)

    def _run(self) -> None:
        while not (self._closing and not self._journal.waiting):
            self._wake.acquire()
            time.sleep(_PAUSE)
            while batch := self._taken():
                try:
                    self._write(batch)
                except Exception as error:
                    self._fail(error, batch)
                    return

    def _write(self, batch: Iterable[Measured | Group]) -> None:
        measured: dict[int, Individual] = {}
        entries: list[Individual] = []
        last = 0
        for one in batch:
            if isinstance(one, Measured):
                last = one.number
                measured[last] = measurement(one)
                self._count(named_id(Attribute, one.attribute), last)
            else:
                last = one.last
                entries += one.entries
        self._excess = [number for number in self._excess if measured.pop(number, None) is None]
        self._commit([*measured.values(), *entries], last)

    def _taken(self) -> list[Measured | Group]:
        """Take what waits; whoever tells holds the base, so that this is whole calls."""
        with self._base:
            batch = list(self._journal.waiting)
            self._journal.waiting.clear()
        return batch

    def _commit(self, entries: Sequence[Individual], last: int) -> None:
        with self._using:
            self.book.write(entries)
            if len(self._excess) > _SLACK:
                self.book.forget(self._excess)
                self._excess.clear()
            self.book.set_number(last)
            self.book.commit()
        with self._progress:
            self.saved = last
            self._progress.notify_all()

    def _count(self, attribute: str, number: int) -> None:
        numbers = self._measured.setdefault(attribute, deque())
        numbers.append(number)
        if len(numbers) > self.keep:
            self._excess.append(numbers.popleft())

    def _fail(self, error: Exception, batch: Sequence[Measured | Group]) -> None:
        text = f"{self.path}: nothing is saved any more since fact {self.saved}: {error}"
        with suppress(sqlite3.Error):
            self._connection.rollback()
        with self._base:
            self._journal.waiting.extendleft(reversed(batch))
        with self._progress:
            self.error = text
            self._progress.notify_all()
        _log.error(text)
        if self._on_error is not None:
            self._on_error(text)


def _has_content(path: Path) -> bool:
    try:
        return path.stat().st_size > 0
    except FileNotFoundError:
        return False
    except OSError as error:
        raise StoreError(f"{path}: the store cannot be read: {error.strerror}") from None


def _make(path: Path, base: str, declared: str, given: Iterable[Individual]) -> bool:
    """Make the file of a store beside its place, so that it is there as a whole or not at all.

    Returns:
        False if another process has made one meanwhile.
    """
    from kb.owl import Book, database
    from kb.rdfxml import metamodel

    part = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}.part")
    try:
        connection = database(part)
        book = Book(base, part, connection)
        book.describe(metamodel(), given)
        book.write([Individual("", MODEL, {"told": (0,), "declared": (declared,)})])
        book.commit()
        connection.execute(f"PRAGMA application_id={_OWNER}")
        connection.execute(f"PRAGMA user_version={FORMAT}")
        book.close()
        return _put_in_place(part, path)
    except (OSError, sqlite3.Error) as error:
        raise StoreError(f"{path}: the store cannot be made: {error}; see who may write in that folder") from None
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def _put_in_place(part: Path, path: Path) -> bool:
    try:
        path.hardlink_to(part)
    except FileExistsError:
        if path.stat().st_size > 0:
            return False
        part.replace(path)
    except OSError:  # a file system without links
        part.replace(path)
    return True


def _guarded(path: Path) -> int:
    """Open a file that nobody else has open as a store; returns its descriptor.

    It is kept until the database is closed: to close any descriptor of a file takes away the locks of SQLite on it.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except OSError as error:
        raise StoreError(f"{path}: the store cannot be read: {error.strerror}") from None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise _in_use(path) from None
    return descriptor


def _in_use(path: Path) -> StoreError:
    return StoreError(f"{path}: the store is in use by another knowledge base or process; close that, or name another")


def _check_format(path: Path, descriptor: int) -> None:
    try:
        head = os.pread(descriptor, 100, 0)
    except OSError as error:
        raise StoreError(f"{path}: the store cannot be read: {error.strerror}") from None
    if not head.startswith(_MAGIC) or len(head) < 100:
        raise StoreError(f"{path}: this is no store but another file; it is left as it is. Name another one")
    if int.from_bytes(head[68:72], "big") != _OWNER:
        raise StoreError(f"{path}: this is a database of something else; it is left as it is. Name another file")
    found = int.from_bytes(head[60:64], "big")
    if found > FORMAT:
        raise StoreError(
            f"{path}: the store has format {found}, of a newer version; this one knows those up to {FORMAT}. "
            "Update, or name another file"
        )


def _locked(path: Path) -> sqlite3.Connection:
    """Open a database for nobody else; one that is damaged or may not be written is left as it is."""
    try:
        connection = sqlite3.connect(path, timeout=0.0, isolation_level="EXCLUSIVE", check_same_thread=False)
    except sqlite3.Error as error:
        raise StoreError(f"{path}: the store cannot be opened: {error}") from None
    try:
        connection.execute("PRAGMA locking_mode=EXCLUSIVE")
        connection.execute("BEGIN EXCLUSIVE")
        (found,) = connection.execute("PRAGMA integrity_check(1)").fetchone()
        connection.execute(f"PRAGMA user_version={FORMAT}")  # a file that may only be read is not noticed before that
        connection.rollback()
    except sqlite3.Error as error:
        connection.close()
        if "locked" in str(error):
            raise _in_use(path) from None
        if isinstance(error, sqlite3.OperationalError):
            raise StoreError(f"{path}: the store cannot be opened for writing: {error}; see who may write it") from None
        raise _damaged(path, error) from None
    if found != "ok":
        connection.close()
        raise _damaged(path, found.splitlines()[-1])
    return connection


def _said(connection: sqlite3.Connection, word: str) -> object:
    (found,) = connection.execute(_VALUE, (f"{ROSA}{word}",)).fetchone()
    return found


@contextmanager
def _blamed(path: Path) -> Iterator[None]:
    try:
        yield
    except (sqlite3.Error, TypeError, ValueError, LookupError) as error:
        raise _damaged(path, error) from None


def _damaged(path: Path, what: object) -> StoreError:
    return StoreError(f"{path}: the store is damaged: {what}. Take a copy of it that is not, or name another file")
