"""The store: the log of a knowledge base in one SQLite file, with snapshots of what was known.

One thread writes the events in order, and each commit is on disk before it is acknowledged. Opening a store reads the
last snapshot and the events after it, not the whole history. A damaged or foreign file is left unchanged.
"""

import ctypes
import json
import logging
import os
import sqlite3
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any, Final
from weakref import WeakKeyDictionary

from kb import store_file
from kb.events import Event
from kb.exceptions import InvalidValue
from kb.files import sync_folder
from kb.knowledge import Knowledge
from kb.model import Model, amend, amended_alike, differences, rebuilt
from kb.owl import Serials, individuals, plain_json

KEPT: Final = 10_000  # how many measurements of each attribute are kept: the newest ones
_EXCESS: Final = """
    DELETE FROM events WHERE number IN (SELECT number FROM (SELECT number, row_number() OVER (
        PARTITION BY subject ORDER BY number DESC) AS place FROM events WHERE verb = 'measure')
        WHERE place > ? AND number <= ?)"""

_SNAPSHOT_AFTER: Final = (
    10_000  # the usual number of events between two snapshots; more if the state is large
)
_PAUSE: Final = 0.001  # the writer waits this long, so that one commit holds several events [s]
_AHEAD: Final = (
    1 << 20
)  # how long SQLite's write-ahead log gets before it is copied into the file [bytes]
_AGAIN: Final = 1.0  # how often a failed write is tried again, and the mark is forced to disk [s]
_LONGEST_HOLD: Final = 5.0  # how long a fork waits for another thread that uses the file [s]
_MOST_WAITING: Final = (
    100_000  # with more events than this to write, the store gives up: memory is limited
)

_log = logging.getLogger(__name__)


class Store:
    """The log of a knowledge base on disk.

    Attributes:
        path: path of the file.
        is_new: whether the file has no events yet.
        saved: number of the last event that is certainly on disk.
        error: why nothing is saved now; None while there is no error.
        left: actions that an earlier program left required; a task layer resumes or cancels them.
        model: the model that the events are about; if none is given, the model in the file.
        time: time of the last event in the file when it was opened [s].
        using: a lock that is held while the file is used.

    Raises:
        InvalidValue: the path is not a path.
        StoreError: the file cannot be opened, is damaged, is no store, or is the store of another model.
    """

    def __init__(self, path: str | Path, model: Model | None, keep: int = KEPT) -> None:
        if not isinstance(path, str | Path) or not str(path):
            raise InvalidValue(f"a store is the path of a file, or None for none, not {path!r}")
        self.path, self.keep = Path(path), keep
        self.saved = 0
        self.error: str | None = None
        self.left: tuple[str, ...] = ()
        self.is_new = model is not None and store_file.make(self.path, _declared(model))
        self._guard, self._mark = store_file.guarded(self.path), -1
        self.using = threading.Lock()
        HELD_OVER_FORKS[self.using] = _LONGEST_HOLD
        self._progress = threading.Condition()
        self._wake = threading.Event()
        self._closing = self._is_stopping = self._is_given_up = False
        self._ends_itself, self._owner = False, os.getpid()
        self._thread: threading.Thread | None = None
        self._knowledge: Knowledge
        self._lock: AbstractContextManager[object] = threading.RLock()
        try:
            self._connection, found = store_file.opened(self.path)
        except BaseException:
            os.close(self._guard)
            raise
        self._id, self._found = found.id, found
        self._written, self._tail = found.last, found.tail
        self._snapshot = found.snapshot.number
        self._others = found.snapshot.others + sum(row.verb != "measure" for row in found.rows)
        self._synced = 0.0
        self.time = found.time
        try:
            self.model, self._serials = self._matched(model)
        except BaseException:
            self._release()
            raise
        ctypes.pythonapi.Py_IncRef(
            ctypes.py_object(self._connection)
        )  # else a forked child that frees it would write

    # ---------------------------------------------------------------- read

    def restore(self, known: Knowledge, now: float) -> None:
        """Restore all that is in the file; plans and attempts that were under way end now [s] as "abandoned"."""
        known.serials, found = self._serials, self._found
        with _blamed(self.path):
            if found.snapshot.number:
                known.from_json(
                    json.loads(found.snapshot.known), found.snapshot.number, found.snapshot.time
                )
            for row in found.rows:
                known.repeat(row.event)
            self.saved = self._written
            known.log.resume(self.saved)
        found.rows.clear()
        for plan in list(known.records.open_plans.values()):
            known.apply(now, "finish_plan", (plan.number, "abandoned"))
        for serial in [serial for serial, one in known.records.attempts.items() if one.end is None]:
            known.apply(now, "finish_attempt", (serial, "abandoned", "its result is not known"))
        self.left = tuple(known.records.required)

    def events(self, after: int = 0, most: int = -1, *, measurements: bool = True) -> list[Event]:
        """Return at most `most` events of the file after a number, with or without the measurements that it keeps.

        A closed store returns none: then only what is held in memory can be asked.
        """
        self.check_owner()
        only = "" if measurements else "AND verb <> 'measure'"
        with self.using, _blamed(self.path):
            rows = (
                ()
                if self._closing
                else store_file.history(self._connection, after, self._written, only, most)
            )
            return [row.event for row in rows]

    def check_owner(self) -> None:
        """Raise StoreError in a process that was forked from the one that opened the store."""
        if os.getpid() != self._owner:
            raise store_file.StoreError(
                f"{self.path}: the store is open in the process that this one was forked from, which goes on with it. "
                "Make a knowledge base with a store of its own here"
            )

    def _matched(self, model: Model | None) -> tuple[Model, Serials]:
        """Return the model to continue with, amended as in the file, and the serial numbers of its elements."""
        stored, since = str(self._found.declared), self._found.since
        with _blamed(self.path):
            rows = store_file.history(self._connection, since, self._written, "AND verb = 'amend'")
            amendments = [row.event.arguments for row in rows]
            if model is not None and stored == _declared(model):
                serials = Serials.of(model)
                for one in amendments:
                    amend(model, serials, *one)
                return model, serials
            then, numbers = rebuilt(json.loads(stored), amendments)
        if model is None:
            return then, numbers
        alike = amended_alike(then, numbers, model)
        if alike is not None:
            return model, alike
        raise store_file.StoreError(
            f"{self.path}: the store is of another model: {'; '.join(differences(then, model))}. Give that model, or "
            f"name another file; `rosa store migrate {self.path} MODEL` takes the facts over to another model"
        )

    # ---------------------------------------------------------------- write

    def start(self, known: Knowledge, lock: AbstractContextManager[object]) -> None:
        """Write events from now on; a failure is reported once, and tried again until too many events wait."""
        self._knowledge, self._lock = known, lock
        with _blamed(self.path):
            try:
                flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW
                self._mark = os.open(store_file.beside(self.path, "mark"), flags, 0o666)
                self._acknowledge()
                os.fsync(self._mark)
                sync_folder(self.path.parent)
            except OSError as error:
                raise store_file.StoreError(
                    f"{store_file.beside(self.path, 'mark')}: it cannot be written: {error.strerror}"
                ) from None
            self._connection.execute("PRAGMA journal_mode=WAL")
            self._connection.execute("PRAGMA synchronous=FULL")
            self._connection.execute(f"PRAGMA wal_autocheckpoint={_AHEAD // 4096}")  # in pages
            self._connection.execute(f"PRAGMA journal_size_limit={_AHEAD}")
            self._live(is_open=True)
            self._connection.execute(
                "PRAGMA wal_checkpoint(FULL)"
            )  # so that a missing write-ahead log is noticed
        known.log.heard = self._wake.set
        self._begin()

    def flush(self, timeout: float | None = None) -> bool:
        """Wait, at most for a timeout [s], until all events so far are on disk; returns whether they are."""
        self.check_owner()
        wanted = self._knowledge.log.last
        self._wake.set()
        with self._progress:
            self._progress.wait_for(
                lambda: self.saved >= wanted or self.error or self._closing, timeout
            )
        return self.saved >= wanted

    def close(self) -> None:
        """Save all events and close the file.

        Raises:
            StoreError: some events could not be saved. The store keeps trying: make room on the disk and close again.
        """
        if self._closing or self._is_stopping or os.getpid() != self._owner:
            return
        self._is_stopping = True
        self._wake.set()
        if self._thread is threading.current_thread():
            self._ends_itself = (
                True  # this thread dropped the last reference to the base, and cannot join itself
            )
            return
        unsaved = 0
        if self._thread is not None:
            self._thread.join()
            unsaved = self._knowledge.log.last - self.saved
            if unsaved and not self._is_given_up:
                self._is_stopping = False
                self._begin()
                raise store_file.StoreError(
                    f"{self.error}. {unsaved} events are not saved; make room, and close it again"
                )
        self._end()
        if unsaved:
            raise store_file.StoreError(
                f"{self.error}. {unsaved} events are lost; the file is sound"
            )

    def _end(self) -> None:
        with self.using, suppress(sqlite3.Error):
            if self._mark >= 0 and self.error is None:
                self._live(is_open=False)
                self._connection.execute("PRAGMA journal_mode=DELETE")
                store_file.beside(self.path, "mark").unlink(missing_ok=True)
        self._release()
        with self._progress:
            self._progress.notify_all()

    def _release(self) -> None:
        self._closing = True
        with suppress(sqlite3.Error):
            self._connection.close()
        for descriptor in (self._guard, self._mark):
            if descriptor >= 0:
                os.close(descriptor)

    def _live(self, *, is_open: bool) -> None:
        store_file.write_life(
            self._connection, self._id, is_open=is_open, last=self._written, tail=self._tail
        )
        self._connection.commit()

    def _begin(self) -> None:
        self._thread = threading.Thread(
            target=self._run, name=f"store {self.path.name}", daemon=True
        )
        self._thread.start()
        self._wake.set()

    def _run(self) -> None:
        while not self._is_given_up:
            self._wake.wait(_AGAIN if self.error else None)
            self._wake.clear()
            if not self._is_stopping:
                time.sleep(_PAUSE)
            is_last = self._is_stopping  # if `close` is called during the write, there may be more
            self._write()
            if is_last and (self.error or self.saved == self._knowledge.log.last):
                break
            if is_last:
                self._wake.set()
        if self._ends_itself:
            self._end()

    def _write(self) -> None:
        """Write the new events; if that fails, the file is as before."""
        known, snapshot = self._knowledge, None
        with self._lock:
            known.settled()
            last = known.log.last
            waiting = last - self._written
            batch = list(known.log.since(self._written))
            if self._needs_snapshot(batch, last):
                snapshot = (
                    last,
                    known.now,
                    json.dumps(known.to_json(self.keep), separators=(",", ":")),
                )
        if (last == self.saved and snapshot is None) or self._is_given_up:
            return
        if waiting > _MOST_WAITING or len(batch) != waiting:
            self._fail(OSError("too many events wait to be saved"), is_given_up=True)
            return
        try:
            if batch or snapshot is not None:
                with self.using:
                    self._commit(batch, snapshot)
            self._acknowledge()
        except (sqlite3.Error, OSError) as error:
            self._fail(error, is_given_up=waiting > _MOST_WAITING)
            return
        was_wrong = self.error is not None
        with self._progress:
            self.saved, self.error = last, None
            self._progress.notify_all()
        if was_wrong:
            self._say(f"{self.path}: everything is saved again", logging.WARNING)
        if (now := time.monotonic()) - self._synced > _AGAIN:
            self._synced = now
            with suppress(OSError):
                os.fdatasync(self._mark)

    def _acknowledge(self) -> None:
        """Write the number of the last event into the mark, a file beside the database, so that a loss is noticed.

        The mark is not forced to disk each time, as that would double the wait. If the process is killed, the mark is
        still correct; if the power fails, the mark may be older than the database, never newer.
        """
        os.pwrite(self._mark, store_file.Mark(self._id, self._written, self._tail).written(), 0)

    def _needs_snapshot(self, batch: Iterable[Event], last: int) -> bool:
        if any(event.verb == "amend" for event in batch):
            return True  # so that all events after a snapshot belong to one model
        state = self._knowledge.state
        measured = sum(min(len(one), self.keep) for one in state.histories.values())
        much = max(min(_SNAPSHOT_AFTER, 10 * self.keep), len(state.network.nodes), measured // 2)
        return last - self._snapshot >= (1000 if self._is_stopping else much)

    def adopt(self, model: Model, batch: Iterable[Event], snapshot: tuple[int, float, str]) -> None:
        """Write events, replace the model, and write a snapshot for the new model, in one commit."""
        with _blamed(self.path):
            self._commit(batch, snapshot, model)

    def _commit(
        self,
        batch: Iterable[Event],
        snapshot: tuple[int, float, str] | None,
        model: Model | None = None,
    ) -> None:
        rows, before = [], self._tail
        for event in batch:
            rows.append(store_file.Row.of(event, before))
            before = rows[-1].digest
        others = self._others + sum(row.verb != "measure" for row in rows)
        try:
            self._connection.executemany("INSERT INTO events VALUES (?, ?, ?, ?, ?, ?, ?)", rows)
            if snapshot is not None:
                kept = store_file.Snapshot.of(*snapshot, others, before)
                self._connection.execute(
                    "INSERT OR REPLACE INTO snapshots VALUES (?, ?, ?, ?, ?, ?)", kept
                )
                self._connection.execute(
                    "DELETE FROM snapshots WHERE number < ?", (self._snapshot,)
                )
                # events after the previous snapshot stay: they can be repeated from there
                self._connection.execute(_EXCESS, (self.keep, self._snapshot))
            if model is not None:
                store_file.write_about(
                    self._connection, self._id, _declared(model), rows[-1].number
                )
                store_file.write_life(
                    self._connection, self._id, is_open=False, last=rows[-1].number, tail=before
                )
            self._connection.commit()
        except BaseException:
            with suppress(sqlite3.Error):
                self._connection.rollback()
            raise
        self._tail, self._others, self._written = (
            before,
            others,
            rows[-1].number if rows else self._written,
        )
        if snapshot is not None:
            self._snapshot = snapshot[0]

    def _fail(self, error: Exception, *, is_given_up: bool) -> None:
        is_news, self._is_given_up = self.error is None, is_given_up
        since = f"{self.path}: nothing has been saved since event {self.saved}: {error}"
        words = f"{since}; {'nothing will be saved any more' if is_given_up else 'it is tried again every second'}"
        with self._progress:
            self.error = words
            self._progress.notify_all()
        if is_news or is_given_up:
            self._say(words, logging.ERROR)

    def _say(self, words: str, level: int) -> None:
        _log.log(level, words)
        with self._lock, self._knowledge.telling:
            self._knowledge.apply(self._knowledge.now, "store", (words,))
        self._knowledge.heard()


def _declared(model: Model) -> str:
    return json.dumps(plain_json(individuals(model)))


@contextmanager
def _blamed(path: Path) -> Iterator[None]:
    try:
        yield
    except store_file.BROKEN as error:
        raise store_file.damaged(path, error) from None


# -------------------------------------------------------------------- forks

HELD_OVER_FORKS: Final[WeakKeyDictionary[Any, float]] = WeakKeyDictionary()
"""The locks that are taken before a fork, and how long it waits for each [s]; -1 means without a limit.

The locks of knowledge bases have no limit: if another thread held one at the fork, the child could never use that base.
Those of files have one: a child may not use the file; they only keep it from inheriting locks of SQLite that are taken.
"""


def _hold() -> None:
    """Take the locks before the process is forked, so that no event is half-done in the child process."""
    _HELD.extend(
        lock for lock, longest in tuple(HELD_OVER_FORKS.items()) if lock.acquire(timeout=longest)
    )


def _let_go() -> None:
    while _HELD:
        _HELD.pop().release()


_HELD: Final[list[Any]] = []
os.register_at_fork(before=_hold, after_in_parent=_let_go, after_in_child=_let_go)
