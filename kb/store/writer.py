"""What is told is written to a file by one thread, in order; see `kb.store.file` for the file.

A commit holds whole calls, so a kill loses only the last of them. What cannot be written waits, and is tried again.
"""

import json
import logging
import os
import sqlite3
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from kb.elements import Attribute
from kb.individuals import STATED, Individual, Ref, named_id
from kb.store.file import (
    FORMAT,
    StoreError,
    blamed,
    check_format,
    guarded,
    has_content,
    locked,
    make,
    values_of,
)
from kb.store.journal import Group, Journal, Measured

if TYPE_CHECKING:
    from kb.owl import Book

__all__ = ["FORMAT", "Store", "StoreError", "measurement"]

_SLACK: Final = 256
"""How many measurements may be in excess before they are removed together."""

_PAUSE: Final = 0.001
"""How long the writer lets those who tell go on before it writes what they have told together [s]."""

_LINGER: Final = 20
"""How often the writer looks for more of itself before it rests: to be woken costs whoever tells."""

_AHEAD: Final = 1 << 20
"""How much is written to the log beside the file before it is brought into the file [bytes]."""

_AGAIN: Final = 1.0
"""How long after a failure it is tried again to write [s]."""

_MOST_WAITING: Final = 100_000
"""How many calls may wait for room on the disk before it is given up: memory has an end too."""

_log = logging.getLogger(__name__)


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
        error: why nothing is saved at present; None while all is well.
        is_given_up: nothing will be saved any more.

    Raises:
        StoreError: the file cannot be opened, or is no store.
    """

    def __init__(self, path: Path, base: str, declared: str, given: Iterable[Individual], keep: int) -> None:
        self.path, self.keep = path, keep
        self.saved = 0
        self.error: str | None = None
        self.is_given_up = False
        self.is_new = not has_content(path) and make(path, base, declared, given)
        self._guard = guarded(path)
        try:
            check_format(path, self._guard)
            self._connection = locked(path)
        except StoreError:
            os.close(self._guard)
            raise
        self.book: Book
        self._journal: Journal
        self._base: AbstractContextManager[object]
        self._measured: dict[str, deque[int]] = {}
        self._counted = 0
        self._excess: list[int] = []
        self._using = threading.Lock()
        self._progress = threading.Condition()
        self._wake = threading.Lock()
        self._wake.acquire()
        self._closing = False
        self._thread: threading.Thread | None = None
        self._on_news: Callable[[str], None]

    @property
    def declared(self) -> str:
        """The model as it was when the store was made."""
        with blamed(self.path):
            text = str(values_of(self._connection, "declared")[0])
            json.loads(text)
            return text

    def amendments(self) -> list[str]:
        """Return the changes of the model, in order."""
        with blamed(self.path):
            found = [str(one) for one in values_of(self._connection, "change")]
            return [text for text in found if json.loads(text)]

    def open(self, base: str) -> list[Individual]:
        """Take up the file; returns what was told, in order."""
        from kb.owl import Book

        with blamed(self.path):
            self._connection.execute("PRAGMA journal_mode=WAL")
            self._connection.execute("PRAGMA synchronous=NORMAL")
            (page,) = self._connection.execute("PRAGMA page_size").fetchone()
            self._connection.execute(f"PRAGMA wal_autocheckpoint={_AHEAD // page}")
            self._connection.execute(f"PRAGMA journal_size_limit={_AHEAD}")
            self.book = Book(base, self.path, self._connection)
            self.book.commit()  # what owlready2 notes at each opening; an open transaction would keep copies waiting
            facts = self.book.facts()
            self.saved = self.book.number
        for one in facts:
            if one.kind == "Measurement" and isinstance(one.values["measures"][0], Ref):
                self._count(one.values["measures"][0].id, int(one.id.rpartition(".")[2]))
        return facts

    def start(self, journal: Journal, base: AbstractContextManager[object], on_news: Callable[[str], None]) -> None:
        """Write from now on; if that fails, say so once, and try it again until it is of no use any more.

        Args:
            journal: what is told to it.
            base: the lock that whoever tells holds.
            on_news: called with what is wrong, and when it is well again.
        """
        self._journal, self._base, self._on_news = journal, base, on_news
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
        with self._progress:
            self._closing = True
            self._progress.notify_all()
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
        while not self.is_given_up and not (self._closing and not self._journal.waiting):
            self._rest()
            while batch := self._waiting():
                try:
                    self._write(batch)
                except Exception as error:
                    self._fail(error)
                    break
                self._forget_waiting(len(batch))

    def _rest(self) -> None:
        """Wait until there may be something to write, and let who tells go on for a moment."""
        if self.error is not None:
            with self._progress:
                self._progress.wait_for(lambda: self._closing, _AGAIN)
            return
        for _ in range(_LINGER):
            time.sleep(_PAUSE)
            if self._wake.acquire(blocking=False):
                return
        self._wake.acquire()
        time.sleep(_PAUSE)

    def _waiting(self) -> list[Measured | Group]:
        """Return what waits; whoever tells holds the base, so that this is whole calls."""
        with self._base:
            return list(self._journal.waiting)

    def _forget_waiting(self, count: int) -> None:
        """Take from what waits the first so many calls, which are in the file."""
        with self._base:
            for _ in range(count):
                self._journal.waiting.popleft()

    def _write(self, batch: Iterable[Measured | Group]) -> None:
        """Write what was told; if that fails, everything is as before."""
        measured: dict[int, Individual] = {}
        entries: list[Individual] = []
        last = 0
        for one in batch:
            if isinstance(one, Measured):
                last = one.number
                measured[last] = measurement(one)
                if last > self._counted:
                    self._count(named_id(Attribute, one.attribute), last)
            else:
                last = one.last
                entries += one.entries
        gone = [number for number in self._excess if number not in measured]
        for number in self._excess:
            measured.pop(number, None)
        self._commit([*measured.values(), *entries], gone if len(gone) > _SLACK else [], last)
        self._excess = [] if len(gone) > _SLACK else gone

    def _commit(self, entries: Sequence[Individual], gone: Sequence[int], last: int) -> None:
        with self._using:
            self.book.write(entries)
            self.book.forget(gone)
            self.book.number = last
            self.book.commit()
        was_wrong = self.error is not None
        with self._progress:
            self.saved, self.error = last, None
            self._progress.notify_all()
        if was_wrong:
            text = f"{self.path}: all is saved again"
            _log.warning(text)
            self._on_news(text)

    def _count(self, attribute: str, number: int) -> None:
        self._counted = number
        numbers = self._measured.setdefault(attribute, deque())
        numbers.append(number)
        if len(numbers) > self.keep:
            self._excess.append(numbers.popleft())

    def _fail(self, error: Exception) -> None:
        with self._using, suppress(sqlite3.Error):
            self.book.roll_back()
        is_news = self.error is None
        self.is_given_up = self._closing or len(self._journal.waiting) > _MOST_WAITING
        since = (
            f"{self.path}: nothing is saved {'any more ' if self.is_given_up else ''}since fact {self.saved}: {error}"
        )
        text = since if self.is_given_up else f"{since}; it is tried again every second"
        with self._progress:
            self.error = text
            self._progress.notify_all()
        if is_news or self.is_given_up:
            _log.error(text)
            self._on_news(text)
