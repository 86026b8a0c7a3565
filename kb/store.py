"""The store: the log of a knowledge base in one SQLite file, with what was known at some of its events.

One thread writes it, in order, and each commit is on disk before it is acknowledged. Each record carries a check of
itself and of the one before it. To open a store costs what was written after the last snapshot, not the history.
A file that is not ours, or not well, is left as it is.
"""

import fcntl
import json
import logging
import os
import sqlite3
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from hashlib import blake2b
from pathlib import Path
from typing import Final, NamedTuple

from kb.amendments import Amendment, amend, amended_alike, differences
from kb.events import Event
from kb.exceptions import InvalidValue, KnowledgeBaseError
from kb.knowledge import Knowledge
from kb.model import Model
from kb.owl.individuals import Serials, individuals, plain_json

FORMAT: Final = 2
"""Of files that this version writes and reads."""

KEPT: Final = 10_000
"""How many measurements of each attribute are kept; the newest."""

_MAGIC: Final = b"SQLite format 3\0"
_OWNER: Final = 0x524F5341
"""ROSA in ASCII: the application id in the header of the file."""

_TABLES: Final = (
    "CREATE TABLE about (declared TEXT NOT NULL, digest BLOB NOT NULL)",
    "CREATE TABLE events (number INTEGER PRIMARY KEY, time REAL NOT NULL, verb TEXT NOT NULL, subject TEXT NOT NULL, "
    "data TEXT NOT NULL, before BLOB NOT NULL, digest BLOB NOT NULL)",
    "CREATE INDEX others ON events (number) WHERE verb <> 'measure'",
    "CREATE TABLE snapshots (number INTEGER PRIMARY KEY, time REAL NOT NULL, known TEXT NOT NULL, "
    "digest BLOB NOT NULL)",
)
_EXCESS: Final = """
    DELETE FROM events WHERE number IN (SELECT number FROM (SELECT number, row_number() OVER (
        PARTITION BY subject ORDER BY number DESC) AS place FROM events WHERE verb = 'measure')
        WHERE place > ? AND number <= ?)"""

_SNAPSHOT_AFTER: Final = 10_000
"""How many events are written, at least, before what is known is written too; more where that is much."""

_WHOLE_CHECK: Final = 8 << 20
"""Up to which size a file is checked as a whole when it is opened [bytes]."""

_PAUSE: Final = 0.001
"""How long the writer lets those who tell go on before it writes what they have told together [s]."""

_AHEAD: Final = 1 << 20
"""How much is written to the log beside the file before it is brought into the file [bytes]."""

_AGAIN: Final = 1.0
"""How long after a failure it is tried again to write [s]."""

_MOST_WAITING: Final = 100_000
"""How many events may wait for room on the disk before it is given up: memory has an end too."""

_log = logging.getLogger(__name__)


class StoreError(KnowledgeBaseError):
    """A store cannot be opened, or is not one; it is as it was."""


class _Row(NamedTuple):
    number: int
    time: float
    verb: str
    subject: str
    data: str
    before: bytes
    digest: bytes

    @property
    def event(self) -> Event:
        arguments, cause, effects = json.loads(self.data)
        given = {"number": self.number, "time": self.time, "verb": self.verb, "arguments": arguments}
        return Event.from_json({**given, "cause": cause, "effects": effects})

    @property
    def is_whole(self) -> bool:
        return self.digest == _digest(self.before, *self[:5])


def _row(event: Event, before: bytes) -> _Row:
    written = event.to_json()
    data = json.dumps([written["arguments"], event.cause, event.effects], separators=(",", ":"))
    values = (event.number, float(event.time), event.verb, str(event.subject).encode("utf-8", "replace").decode(), data)
    return _Row(*values, before, _digest(before, *values))


def _digest(before: bytes, *values: object) -> bytes:
    return blake2b(before + repr(values).encode(), digest_size=16).digest()


class Store:
    """The log of a knowledge base on disk.

    Attributes:
        path: of the file.
        is_new: there is nothing in it yet.
        saved: number of the last event in the file.
        error: why nothing is saved at present, or any more; None while all is well.
        left: actions that were required when it was opened, by a program that has ended; a task layer settles them.

    Raises:
        InvalidValue: the path is none.
        StoreError: the file cannot be opened, or is no store, or that of another model.
    """

    def __init__(self, path: str | Path, model: Model, keep: int) -> None:
        if not isinstance(path, str | Path) or not str(path):
            raise InvalidValue(f"a store is the path of a file, or None for none, not {path!r}")
        self.path, self.keep = Path(path), keep
        self.saved = 0
        self.error: str | None = None
        self.left: tuple[str, ...] = ()
        declared = json.dumps(plain_json(individuals(model)))
        self.is_new = not _has_content(self.path) and _make(self.path, declared)
        self._guard = _guarded(self.path)
        try:
            _check_format(self.path, self._guard)
            self._connection = _locked(self.path)
        except StoreError:
            os.close(self._guard)
            raise
        self._serials: Serials
        self._snapshot, self._tail = 0, b""
        self._using = threading.Lock()
        self._progress = threading.Condition()
        self._wake = threading.Event()
        self._closing = self._is_stopping = self._is_given_up = False
        self._past: list[Event] = []
        self._thread: threading.Thread | None = None
        self._knowledge: Knowledge
        self._lock: AbstractContextManager[object]
        try:
            self._open(model, declared)
        except BaseException:
            self._release()
            raise

    # ---------------------------------------------------------------- read

    def restore(self, known: Knowledge, now: float) -> None:
        """Have everything known that is in the file; plans and attempts that were under way are abandoned [s]."""
        known.serials = self._serials
        with _blamed(self.path):
            found = self._connection.execute("SELECT * FROM snapshots ORDER BY number DESC LIMIT 1").fetchone()
            if found is not None:
                number, moment, written, digest = found
                if digest != _digest(b"", number, moment, written):
                    raise ValueError(f"what was known after event {number} is not as it was written")
                known.from_json(json.loads(written), number, moment)
                self._snapshot = number
            for row in self._rows(self._snapshot):
                known.repeat(row.event)
                self._tail = row.digest
            known.log.last = self.saved = max(self._snapshot, known.log.last)
        for plan in list(known.records.open_plans.values()):
            known.apply(now, "finish_plan", (plan.number, "abandoned"))
        for serial in [serial for serial, one in known.records.attempts.items() if one.end is None]:
            known.apply(now, "finish_attempt", (serial, "abandoned", "nobody saw what came of it"))
        self.left = tuple(known.records.required)

    def events(self, after: int = 0, *, measurements: bool = True) -> list[Event]:
        """Return the events in the file after one, with the measurements that are kept or without.

        Once it is closed, none but the newest measurements are there, which the state holds.
        """
        with self._using, _blamed(self.path):
            if self._closing:
                return [event for event in self._past if event.number > after]
            return [row.event for row in self._rows(after, "" if measurements else "AND verb <> 'measure'")]

    def check(self) -> int:
        with self._using, _blamed(self.path):
            (found,) = self._connection.execute("PRAGMA integrity_check(1)").fetchone()
            if found != "ok":
                raise ValueError(found)
            return sum(1 for _ in self._rows(0))

    def _open(self, model: Model, declared: str) -> None:
        with _blamed(self.path):
            (stored, digest) = self._connection.execute("SELECT declared, digest FROM about").fetchone()
            if digest != _digest(b"", stored):
                raise ValueError("the model in it is not as it was written")
            rows = self._rows(0, "AND verb <> 'measure' AND verb = 'amend'")
            amendments = [Amendment(*row.event.arguments) for row in rows]
        if stored == declared:
            self._serials = Serials(model)
            for one in amendments:
                amend(model, self._serials, *one)
            return
        serials = amended_alike(json.loads(stored), amendments, model)
        if serials is None:
            listed = list(differences(json.loads(stored), json.loads(declared)))
            words = "; ".join(listed[:3]) + ("; ..." if len(listed) > 3 else "")
            raise StoreError(
                f"{self.path}: the store is of another model: {words}. Give that model, or name another file"
            )
        self._serials = serials

    def _rows(self, after: int, only: str = "") -> Iterator[_Row]:
        """Yield the records after one; each is checked, and with the one before it where that is still there."""
        before: _Row | None = None
        rows = self._connection.execute(f"SELECT * FROM events WHERE number > ? {only} ORDER BY number", (after,))
        for values in rows:
            row = _Row(*values)
            follows = before is None or before.number + 1 != row.number or before.digest == row.before
            if not row.is_whole or not follows:
                raise ValueError(f"event {row.number} is not as it was written")
            yield row
            before = row

    # ---------------------------------------------------------------- write

    def start(self, known: Knowledge, lock: AbstractContextManager[object]) -> None:
        """Write from now on; if that fails, say so once, and try it again until it is of no use any more."""
        self._knowledge, self._lock = known, lock
        with _blamed(self.path):
            self._connection.execute("PRAGMA journal_mode=WAL")
            self._connection.execute("PRAGMA synchronous=FULL")
            (page,) = self._connection.execute("PRAGMA page_size").fetchone()
            self._connection.execute(f"PRAGMA wal_autocheckpoint={_AHEAD // page}")
            self._connection.execute(f"PRAGMA journal_size_limit={_AHEAD}")
        known.log.heard = self._heard
        self._thread = threading.Thread(target=self._run, name=f"store {self.path.name}", daemon=True)
        self._thread.start()
        self._wake.set()

    def flush(self, timeout: float | None = None) -> bool:
        wanted = self._knowledge.log.last
        self._wake.set()
        with self._progress:
            self._progress.wait_for(lambda: self.saved >= wanted or self.error or self._closing, timeout)
        return self.saved >= wanted

    def close(self) -> None:
        if self._closing or self._is_stopping:
            return
        self._is_stopping = True
        self._wake.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()
        with suppress(StoreError):
            self._past = self.events(measurements=False)
        with self._using, suppress(sqlite3.Error):
            if self.error is None:
                self._connection.execute("PRAGMA journal_mode=DELETE")
        self._release()
        with self._progress:
            self._progress.notify_all()

    def _release(self) -> None:
        self._closing = True
        with suppress(sqlite3.Error):
            self._connection.close()
        os.close(self._guard)

    def _heard(self) -> None:
        if not self._wake.is_set():
            self._wake.set()

    def _run(self) -> None:
        while not self._is_given_up:
            self._wake.wait(_AGAIN if self.error else None)
            self._wake.clear()
            if not self._is_stopping:
                time.sleep(_PAUSE)
            is_last = self._is_stopping  # if it is told to stop while it writes, there may be more
            self._write()
            if is_last:
                return

    def _write(self) -> None:
        """Write what is new; if that fails, everything is as before."""
        known, snapshot = self._knowledge, None
        with self._lock:
            known.finish()
            last, waiting = known.log.last, known.log.last - self.saved
            batch = list(known.log.since(self.saved))
            if self._needs_snapshot(batch, last):
                snapshot = (last, known.clock(), json.dumps(known.to_json(self.keep), separators=(",", ":")))
        if not batch:
            return
        if waiting > _MOST_WAITING or batch[0].number != self.saved + 1:
            self._fail(OSError("too much waits for room"), is_given_up=True)
            return
        try:
            with self._using:
                self._commit(batch, snapshot)
        except (sqlite3.Error, OSError) as error:
            self._fail(error, is_given_up=self._is_stopping or waiting > _MOST_WAITING)
            return
        was_wrong = self.error is not None
        with self._progress:
            self.saved, self.error = last, None
            self._progress.notify_all()
        if was_wrong:
            self._say(f"{self.path}: all is saved again", logging.WARNING)

    def _needs_snapshot(self, batch: Iterable[Event], last: int) -> bool:
        if any(event.verb == "amend" for event in batch):
            return True  # so that what is repeated after a snapshot is all of one model
        state = self._knowledge.state
        measured = sum(min(len(one), self.keep) for one in state.histories.values())
        much = max(min(_SNAPSHOT_AFTER, 10 * self.keep), len(state.network.nodes), measured // 2)
        return last - self._snapshot >= (1000 if self._is_stopping else much)

    def _commit(self, batch: Iterable[Event], snapshot: tuple[int, float, str] | None) -> None:
        rows, before = [], self._tail
        for event in batch:
            rows.append(_row(event, before))
            before = rows[-1].digest
        try:
            self._connection.executemany("INSERT INTO events VALUES (?, ?, ?, ?, ?, ?, ?)", rows)
            if snapshot is not None:
                self._connection.execute(
                    "INSERT OR REPLACE INTO snapshots VALUES (?, ?, ?, ?)", (*snapshot, _digest(b"", *snapshot))
                )
                self._connection.execute("DELETE FROM snapshots WHERE number < ?", (self._snapshot,))
                self._connection.execute(_EXCESS, (self.keep, snapshot[0]))
            self._connection.commit()
        except BaseException:
            with suppress(sqlite3.Error):
                self._connection.rollback()
            raise
        self._tail = before
        if snapshot is not None:
            self._snapshot = snapshot[0]

    def _fail(self, error: Exception, *, is_given_up: bool) -> None:
        is_news, self._is_given_up = self.error is None, is_given_up
        since = f"{self.path}: nothing is saved {'any more ' if is_given_up else ''}since event {self.saved}: {error}"
        words = since if is_given_up else f"{since}; it is tried again every second"
        with self._progress:
            self.error = words
            self._progress.notify_all()
        if is_news or is_given_up:
            self._say(words, logging.ERROR)

    def _say(self, words: str, level: int) -> None:
        _log.log(level, words)
        with self._lock:
            self._knowledge.apply(self._knowledge.clock(), "store", (words,))
        self._knowledge.heard()


# -------------------------------------------------------------------- the file


def _has_content(path: Path) -> bool:
    try:
        return path.stat().st_size > 0
    except FileNotFoundError:
        return False
    except OSError as error:
        raise StoreError(f"{path}: the store cannot be read: {error.strerror}") from None


def _make(path: Path, declared: str) -> bool:
    """Make the file of a store beside its place, so that it is there as a whole or not at all.

    Returns:
        False if another process has made one meanwhile.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}.part")
    try:
        connection = sqlite3.connect(part)
        for statement in (f"PRAGMA application_id={_OWNER}", f"PRAGMA user_version={FORMAT}", *_TABLES):
            connection.execute(statement)
        connection.execute("INSERT INTO about VALUES (?, ?)", (declared, _digest(b"", declared)))
        connection.commit()
        connection.close()
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
    if found != FORMAT:
        which = "a newer version; update" if found > FORMAT else "an older version; open it with that"
        raise StoreError(f"{path}: the store has format {found}, of {which}, or name another file")


def _locked(path: Path) -> sqlite3.Connection:
    """Open a database for nobody else; one that is damaged or may not be written is left as it is."""
    try:
        connection = sqlite3.connect(path, timeout=0.0, isolation_level="EXCLUSIVE", check_same_thread=False)
    except sqlite3.Error as error:
        raise StoreError(f"{path}: the store cannot be opened: {error}") from None
    found = "ok"
    try:
        connection.execute("PRAGMA locking_mode=EXCLUSIVE")
        connection.execute("BEGIN EXCLUSIVE")
        if path.stat().st_size <= _WHOLE_CHECK:
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


@contextmanager
def _blamed(path: Path) -> Iterator[None]:
    try:
        yield
    except (sqlite3.Error, TypeError, ValueError, LookupError) as error:
        raise _damaged(path, error) from None


def _damaged(path: Path, what: object) -> StoreError:
    return StoreError(f"{path}: the store is damaged: {what}. Take a copy of it that is not, or name another file")
