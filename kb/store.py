"""The store: the log of a knowledge base in one SQLite file, with snapshots of what was known.

One thread writes the events in order, a batch in one transaction, and each transaction is on disk
before it is acknowledged (WAL, synchronous FULL). To open a store, the last snapshot and the events
after it are replayed. If the disk is slower than the robot, whoever records waits.
"""

import json
import logging
import os
import sqlite3
import threading
import time
from collections.abc import Iterable
from contextlib import closing, suppress
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from weakref import WeakKeyDictionary

from kb.events import Event
from kb.exceptions import InvalidValue, KnowledgeBaseError
from kb.model import Model, amend, amended_alike, differences, rebuilt
from kb.owl import Serials, individuals, plain_json
from kb.records import ReconfigurationPlan, plain

if TYPE_CHECKING:
    from kb.knowledge_base import KnowledgeBase

KEPT: Final = 10_000
"""How many measurements of each attribute are kept: the newest ones."""
_APPLICATION: Final = 0x524F5341  # ROSA in ASCII
_FORMAT: Final = 4
_TABLES: Final = """
CREATE TABLE about (name TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE events (number INTEGER PRIMARY KEY, time REAL NOT NULL, verb TEXT NOT NULL,
    subject TEXT NOT NULL, data TEXT NOT NULL);
CREATE TABLE snapshots (number INTEGER PRIMARY KEY, time REAL NOT NULL, data TEXT NOT NULL);
"""
_FORGET_MEASUREMENTS: Final = """
DELETE FROM events WHERE number IN (SELECT number FROM (SELECT number, row_number() OVER (
    PARTITION BY subject ORDER BY number DESC) AS place FROM events WHERE verb = 'measure')
    WHERE place > ? AND number <= ?)
"""
_SNAPSHOT_AFTER: Final = 10_000  # events
_MOST_WAITING: Final = 20_000  # events; with more, whoever records waits
_MOST_LOST: Final = 100_000  # events; with more on a disk that is full, the store gives up
_BATCH_PAUSE_S: Final = 0.001  # so that one transaction holds several events
_RETRY_S: Final = 1.0
_LONGEST_FORK_WAIT_S: Final = 5.0

_log = logging.getLogger(__name__)


class StoreError(KnowledgeBaseError):
    """A store cannot be opened or used; the file is unchanged."""


class Store:
    """The log of a knowledge base on disk.

    Attributes:
        path: path of the file.
        is_new: whether the file has no events yet.
        saved: number of the last event that is certainly on disk.
        error: why nothing is saved now; None while there is no error.
        left: actions that an earlier program left required; a task layer resumes or cancels them.
        model: the model that the events are about.
        time: time of the last event in the file when it was opened [s].
        keep: how many measurements of each attribute are kept.

    Raises:
        InvalidValue: the path is not a path.
        StoreError: the file cannot be opened, is damaged, is no store, is in use, or is the store
            of another model.
    """

    def __init__(self, path: str | Path, model: Model | None, keep: int = KEPT) -> None:
        if not isinstance(path, str | Path) or not str(path):
            raise InvalidValue(f"a store is the path of a file, or None for none, not {path!r}")
        self.path = Path(path)
        self.keep = keep
        self.error: str | None = None
        self.left: tuple[str, ...] = ()
        self._using = threading.Lock()  # held while the file is used
        self._progress = threading.Condition()
        self._wake = threading.Event()
        self._is_stopping = self._is_closed = self._is_given_up = False
        self._owner = os.getpid()
        self._thread: threading.Thread | None = None
        self._kb: KnowledgeBase
        self._lock: Any = None
        self._connection = connect(self.path, is_new_allowed=model is not None)
        try:
            self._read(model)
        except sqlite3.Error as error:
            self._connection.close()
            raise damaged(self.path, error) from None
        except BaseException:
            self._connection.close()
            raise
        LOCKS_HELD_OVER_FORKS[self._using] = _LONGEST_FORK_WAIT_S

    def _read(self, model: Model | None) -> None:
        about = dict(self._connection.execute("SELECT name, value FROM about"))
        if not about and model is not None:
            self._write_about("model", _declared(model))
            about["model"] = _declared(model)
        if about.get("is_open") == "1":
            ((verdict,),) = self._connection.execute("PRAGMA integrity_check(1)")
            if verdict != "ok":
                raise damaged(self.path, verdict)
        last = self._connection.execute(
            "SELECT number, time FROM events ORDER BY number DESC LIMIT 1"
        ).fetchone()
        snapshot = self._connection.execute(
            "SELECT number, time, data FROM snapshots ORDER BY number DESC LIMIT 1"
        ).fetchone()
        self._snapshot_number = 0 if snapshot is None else snapshot[0]
        self._snapshot = None if snapshot is None else snapshot[2]
        self.saved = self._written = 0 if last is None else last[0]
        self.time = 0.0 if last is None else last[1]
        self.is_new = last is None
        self.model, self.serials = self._matched(model, about["model"])

    def _matched(self, model: Model | None, declared: str) -> tuple[Model, Serials]:
        """Return the model to continue with, amended as in the file, and its serial numbers."""
        rows = self._connection.execute(
            "SELECT data FROM events WHERE verb = 'amend' ORDER BY number"
        )
        amendments = [json.loads(data)["arguments"] for (data,) in rows]
        if model is not None and declared == _declared(model):
            serials = Serials.of(model)
            for amendment in amendments:
                amend(model, serials, *amendment)
            return model, serials
        then, numbers = rebuilt(json.loads(declared), amendments)
        if model is None:
            return then, numbers
        alike = amended_alike(then, numbers, model)
        if alike is not None:
            return model, alike
        raise StoreError(
            f"{self.path}: the store is of another model: {'; '.join(differences(then, model))}. "
            "Give that model, or name another file"
        )

    # ---------------------------------------------------------------- read

    def restore(self, kb: "KnowledgeBase", now: float) -> None:
        """Restore what is in the file; open plans and attempts end now [s] as "abandoned"."""
        snapshot = None if self._snapshot is None else json.loads(self._snapshot)
        self._snapshot = None
        kb.restore_log(snapshot, self.events(self._snapshot_number), self.saved, self.serials)
        self.left = kb.abandon_what_was_under_way(now)

    def events(self, after: int = 0, most: int = -1, *, measurements: bool = True) -> list[Event]:
        """Return at most `most` events of the file after a number, with or without measurements."""
        self.check_owner()
        only = "" if measurements else "AND verb <> 'measure'"
        query = (
            f"SELECT number, time, verb, data FROM events WHERE number > ? {only} "
            "ORDER BY number LIMIT ?"
        )
        with self._using:
            if self._is_closed:
                return []
            return [_event(*row) for row in self._connection.execute(query, (after, most))]

    def check_owner(self) -> None:
        """Raise StoreError in a process that was forked from the one that opened the store."""
        if os.getpid() != self._owner:
            raise StoreError(
                f"{self.path}: the store is open in the process that this one was forked from, "
                "which goes on with it. Make a knowledge base with a store of its own here"
            )

    # ---------------------------------------------------------------- write

    def start(self, kb: "KnowledgeBase", lock: Any) -> None:  # noqa: ANN401  # an RLock has no type
        """Write events from now on."""
        self._kb = kb
        self._lock = lock
        self._most_waiting = max(1, min(_MOST_WAITING, kb.log.capacity // 2))
        try:
            self._write_about("is_open", "1")
        except sqlite3.Error as error:
            raise StoreError(f"{self.path}: it cannot be written: {error}") from None
        kb.log.heard = self._wake.set
        self._begin()

    def _begin(self) -> None:
        name = f"store {self.path.name}"
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()
        self._wake.set()

    def wait_for_room(self, last: int) -> None:
        """Wait while too many events up to this number are not saved, unless saving fails."""
        if last - self.saved <= self._most_waiting or os.getpid() != self._owner:
            return
        with self._progress:
            self._progress.wait_for(
                lambda: last - self.saved <= self._most_waiting or self.error or self._is_closed
            )

    def flush(self, timeout: float | None = None) -> bool:
        """Wait, at most for a timeout [s], until all events so far are on disk."""
        self.check_owner()
        wanted = self._kb.log.last
        self._wake.set()
        with self._progress:
            self._progress.wait_for(
                lambda: self.saved >= wanted or self.error or self._is_closed, timeout
            )
        return self.saved >= wanted

    def close(self) -> None:
        """Save all events and close the file.

        Raises:
            StoreError: some events could not be saved. The store keeps trying: make room on the
                disk and close again.
        """
        if self._is_closed or self._is_stopping or os.getpid() != self._owner:
            return
        self._is_stopping = True
        self._wake.set()
        if self._thread is threading.current_thread():
            return  # it dropped the last reference to the base, and ends by itself
        if self._thread is not None:
            self._thread.join()
            unsaved = self._kb.log.last - self.saved
            if unsaved:
                if not self._is_given_up:
                    self._is_stopping = False
                    self._begin()
                    advice = "are not saved; make room, and close it again"
                else:
                    self._end()
                    advice = "are lost"
                raise StoreError(f"{self.error}. {unsaved} events {advice}")
        self._end()

    def _end(self) -> None:
        with self._using, suppress(sqlite3.Error):
            if self._thread is not None and self.error is None:
                self._write_about("is_open", "0")
                self._connection.execute("PRAGMA journal_mode=DELETE")
            self._connection.close()
        self._is_closed = True
        with self._progress:
            self._progress.notify_all()

    def _run(self) -> None:
        while not self._is_given_up:
            self._wake.wait(_RETRY_S if self.error else None)
            self._wake.clear()
            if not self._is_stopping:
                time.sleep(_BATCH_PAUSE_S)
            is_last = self._is_stopping  # there may be more if `close` is called during the write
            self._write()
            if is_last and (self.error or self.saved == self._kb.log.last):
                break
            if is_last:
                self._wake.set()
        if self._is_stopping and self._thread is threading.current_thread() and not self.error:
            return

    def _write(self) -> None:
        """Write the new events; if that fails, the file is as before."""
        with self._lock:
            self._kb.log.settle()
            last = self._kb.log.last
            batch = list(self._kb.log.since(self._written))
            snapshot = self._next_snapshot(batch, last)
        if last == self.saved and snapshot is None:
            return
        is_lost = len(batch) != last - self._written
        if is_lost:
            self._fail(OSError("too many events wait to be saved"), is_given_up=True)
            return
        try:
            with self._using:
                self._commit(batch, snapshot)
        except (sqlite3.Error, OSError) as error:
            self._fail(error, is_given_up=len(batch) > _MOST_LOST)
            return
        was_wrong = self.error is not None
        with self._progress:
            self._written = self.saved = last
            self.error = None
            self._progress.notify_all()
        if was_wrong:
            self._say(f"{self.path}: everything is saved again", logging.WARNING)

    def _next_snapshot(self, batch: Iterable[Event], last: int) -> tuple[int, float, str] | None:
        since = last - self._snapshot_number
        is_amended = any(event.verb == "amend" for event in batch)
        is_long_ago = since >= (1000 if self._is_stopping else _SNAPSHOT_AFTER)
        if not (is_amended or is_long_ago):
            return None
        data = json.dumps(self._kb.snapshot(self.keep), separators=(",", ":"))
        return last, self._kb.log.time, data

    def _commit(self, batch: Iterable[Event], snapshot: tuple[int, float, str] | None) -> None:
        rows = [_row(event) for event in batch]
        connection = self._connection
        try:
            connection.execute("BEGIN")
            connection.executemany("INSERT INTO events VALUES (?, ?, ?, ?, ?)", rows)
            if snapshot is not None:
                connection.execute("DELETE FROM snapshots")
                connection.execute("INSERT INTO snapshots VALUES (?, ?, ?)", snapshot)
                connection.execute(_FORGET_MEASUREMENTS, (self.keep, snapshot[0]))
            connection.execute("COMMIT")
        except BaseException:
            with suppress(sqlite3.Error):
                connection.execute("ROLLBACK")
            raise
        if snapshot is not None:
            self._snapshot_number = snapshot[0]

    def _write_about(self, name: str, value: str) -> None:
        self._connection.execute("INSERT OR REPLACE INTO about VALUES (?, ?)", (name, value))

    def _fail(self, error: Exception, *, is_given_up: bool) -> None:
        is_news = self.error is None
        self._is_given_up = is_given_up
        what_next = "nothing will be saved any more" if is_given_up else "it is tried again"
        words = (
            f"{self.path}: nothing has been saved since event {self.saved}: {error}; {what_next}"
        )
        with self._progress:
            self.error = words
            self._progress.notify_all()
        if is_news or is_given_up:
            self._say(words, logging.ERROR)

    def _say(self, words: str, level: int) -> None:
        _log.log(level, words)
        self._kb.record_store_message(words)


def connect(path: Path, *, is_new_allowed: bool) -> sqlite3.Connection:
    """Open the file of a store, which nobody else may use meanwhile.

    Raises:
        StoreError: it cannot be opened, is in use, or is no store.
    """
    if not is_new_allowed and not path.exists():
        raise StoreError(f"{path}: there is no such file")
    if path.is_symlink() or (path.exists() and not path.is_file()):
        raise StoreError(f"{path}: a store is an ordinary file")
    connection: sqlite3.Connection | None = None
    try:
        connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=1)
        connection.execute("PRAGMA locking_mode=EXCLUSIVE")
        connection.execute("BEGIN EXCLUSIVE")
        ((application,),) = connection.execute("PRAGMA application_id")
        ((version,),) = connection.execute("PRAGMA user_version")
        ((tables,),) = connection.execute("SELECT count(*) FROM sqlite_master")
        if tables and application != _APPLICATION:
            raise StoreError(f"{path}: this is no store, but another SQLite database")
        if tables and version != _FORMAT:
            raise StoreError(
                f"{path}: the store has format {version}, and this version reads {_FORMAT}; "
                "name another file"
            )
        if not tables:
            for statement in _TABLES.split(";"):
                connection.execute(statement)
            connection.execute(f"PRAGMA application_id={_APPLICATION}")
            connection.execute(f"PRAGMA user_version={_FORMAT}")
        connection.execute("COMMIT")
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("PRAGMA synchronous=FULL")
    except sqlite3.OperationalError as error:
        if connection is not None:
            connection.close()
        what = "it is in use by another program" if "locked" in str(error) else str(error)
        raise StoreError(f"{path}: the store cannot be opened: {what}") from None
    except sqlite3.DatabaseError as error:
        if connection is not None:
            connection.close()
        raise damaged(path, error) from None
    except BaseException:
        if connection is not None:
            connection.close()
        raise
    return connection


def damaged(path: Path, what: object) -> StoreError:
    """Return the error for a file that SQLite cannot read."""
    return StoreError(
        f"{path}: the store is damaged: {what}. It is left unchanged; go back to a backup of it"
    )


def store_info(path: Path) -> dict[str, object]:
    """Return what is in a store that is not in use, by title.

    Raises:
        StoreError: it cannot be opened, or is damaged.
    """
    with closing(connect(path, is_new_allowed=False)) as connection:
        try:
            ((verdict,),) = connection.execute("PRAGMA integrity_check(1)")
            if verdict != "ok":
                raise damaged(path, verdict)
            about = dict(connection.execute("SELECT name, value FROM about"))
            counts = connection.execute(
                "SELECT verb, count(*) FROM events GROUP BY verb ORDER BY verb"
            )
            kept = ", ".join(f"{count} {verb}" for verb, count in counts)
            ((last, first_time, last_time),) = connection.execute(
                "SELECT max(number), min(time), max(time) FROM events"
            )
        except sqlite3.Error as error:
            raise damaged(path, error) from None
        connection.execute("PRAGMA journal_mode=DELETE")
    model = json.loads(about.get("model", "[]"))
    titles = [one[2]["name"][0] for one in model if one[0] == "RobotModel"]
    return {
        "store": str(path),
        "model": titles[0] if titles else None,
        "state": "not closed" if about.get("is_open") == "1" else "closed",
        "last event": last or 0,
        "events kept": kept or "none",
        "first time [s]": first_time,
        "last time [s]": last_time,
    }


def backup_store(path: Path, copy: Path) -> None:
    """Copy a store that is not in use to a file that is not there yet.

    Raises:
        StoreError: one of them cannot be opened, or the copy is there already.
    """
    if copy.exists():
        raise StoreError(f"{copy}: this file is there already; name another one")
    with (
        closing(connect(path, is_new_allowed=False)) as connection,
        closing(sqlite3.connect(copy)) as target,
    ):
        connection.backup(target)
        connection.execute("PRAGMA journal_mode=DELETE")


def _row(event: Event) -> tuple[int, float, str, str, str]:
    data: dict[str, object] = {"arguments": plain(event.arguments)}
    if event.cause is not None:
        data["cause"] = event.cause
    if event.effects:
        data["effects"] = event.effects
    if event.words:
        data["words"] = event.words
    if event.plan is not None:
        plan = event.plan
        data["plan"] = {field.name: plain(getattr(plan, field.name)) for field in fields(plan)}
        data["plan"] |= {"end": None, "result": None}  # type: ignore[operator]  # a mapping
    subject = event.subject.encode("utf-8", "replace").decode()
    text = json.dumps(data, separators=(",", ":"))
    return event.number, float(event.time), event.verb, subject, text


def _event(number: int, at: float, verb: str, text: str) -> Event:
    data = json.loads(text)
    written = data.pop("plan", None)
    event = Event.from_json({"number": number, "time": at, "verb": verb, **data})
    if written is None:
        return event
    for name in ("activate", "deactivate", "parameters"):
        written[name] = tuple(written[name])
    written["plain"] = frozenset(written["plain"])
    return event._replace(plan=ReconfigurationPlan(**written))


def _declared(model: Model) -> str:
    return json.dumps(plain_json(individuals(model)))


# -------------------------------------------------------------------- forks

LOCKS_HELD_OVER_FORKS: Final[WeakKeyDictionary[Any, float]] = WeakKeyDictionary()
"""The locks that are taken before a fork, and how long it waits for each [s]; -1 without a limit.

If another thread held the lock of a knowledge base at a fork, the child could never use that base.
"""
_held_locks: list[Any] = []


def _hold_locks() -> None:
    for lock, longest in tuple(LOCKS_HELD_OVER_FORKS.items()):
        if lock.acquire(timeout=longest):
            _held_locks.append(lock)


def _release_locks() -> None:
    while _held_locks:
        _held_locks.pop().release()


os.register_at_fork(
    before=_hold_locks, after_in_parent=_release_locks, after_in_child=_release_locks
)
