"""The store: the log of a knowledge base in one SQLite file, with snapshots of what was known.

One thread writes the events in order, a batch in one transaction, and each transaction is on disk
before it is acknowledged (WAL, synchronous FULL). To open a store, the last snapshot and the events
after it are replayed. If the disk is slower than the robot, whoever records waits.
"""

import json
import logging
import os
import sqlite3
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from threading import Condition, Thread
from threading import Event as Signal
from types import MappingProxyType
from typing import Any, Final

from kb.debounce import Debounced
from kb.events import Event
from kb.exceptions import KnowledgeBaseError
from kb.model import Model, differences
from kb.network import Network, Node
from kb.records import (
    Attempt,
    Log,
    Process,
    ReconfigurationPlan,
    RequiredAction,
    VetoAnswer,
)
from kb.state import Reason
from kb.status import Status

_APPLICATION: Final = 0x524F5341  # ROSA in ASCII
_FORMAT: Final = 6
_TABLES: Final = """
CREATE TABLE about (name TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE events (number INTEGER PRIMARY KEY, time REAL NOT NULL, verb TEXT NOT NULL,
    subject TEXT NOT NULL, data TEXT NOT NULL);
CREATE TABLE snapshots (number INTEGER PRIMARY KEY, data TEXT NOT NULL);
"""
_FORGET_MEASUREMENTS: Final = """
DELETE FROM events WHERE number IN (SELECT number FROM (SELECT number, row_number() OVER (
    PARTITION BY subject ORDER BY number DESC) AS place FROM events WHERE verb = 'measure')
    WHERE place > ? AND number <= ?)
"""
_ABOUT: Final = "INSERT OR REPLACE INTO about VALUES (?, ?)"
_SNAPSHOT_AFTER: Final = 10_000  # events
_MOST_WAITING: Final = 20_000  # events; with more, whoever records waits
_BATCH_PAUSE_S: Final = 0.001  # so that one transaction holds several events
_RETRY_S: Final = 1.0


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

    Raises:
        StoreError: the file cannot be opened, is damaged, is no store, is in use, or is the store
            of another model.
    """

    def __init__(self, path: str | Path, model: Model, keep: int) -> None:
        self.path = Path(path)
        self.error: str | None = None
        self.left: tuple[str, ...] = ()
        self._keep = keep
        self._snapshot_number = 0
        self._progress = Condition()
        self._wake = Signal()
        self._is_stopping = False
        self._owner = os.getpid()
        self._connection = connect(self.path, is_new_allowed=True)
        try:
            with _refusals(self.path):
                self._read(model)
        except BaseException:
            self._connection.close()
            raise

    def _read(self, model: Model) -> None:
        connection = self._connection
        about = dict(connection.execute("SELECT name, value FROM about"))
        if not about:
            about["model"] = json.dumps(model.plain())
            connection.execute(_ABOUT, ("model", about["model"]))
        if about.get("is_open") == "1":
            check_integrity(connection, self.path)
        ((last,),) = connection.execute("SELECT max(number) FROM events")
        self.is_new = last is None
        self.saved: int = last or 0
        self._amend(model, json.loads(about["model"]))

    def _amend(self, model: Model, declared: Any) -> None:  # noqa: ANN401  # what JSON holds
        """Amend a model as it was amended, unless it is so already."""
        is_declared = declared == json.loads(json.dumps(model.plain()))
        then = model if is_declared else Model.from_plain(declared)
        rows = self._connection.execute(
            "SELECT data FROM events WHERE verb = 'amend' ORDER BY number"
        )
        for (data,) in rows.fetchall():
            then.amend(*json.loads(data)["arguments"])
        if then != model:
            raise StoreError(
                f"{self.path}: the store is of another model; only one of the two has "
                f"{'; '.join(differences(then, model))}. Give that model, or name another file"
            )

    def restored(self, network: Network) -> tuple[dict[str, Any] | None, list[Event]]:
        """Return the last snapshot, and the events after it."""
        row = self._connection.execute("SELECT number, data FROM snapshots").fetchone()
        self._snapshot_number, data = row or (0, "null")
        snapshot = decode(json.loads(data), network, [])
        return snapshot, list(events_in(self._connection, self._snapshot_number))

    def check_open(self) -> None:
        """Raise an error if nothing more can be recorded here."""
        if os.getpid() != self._owner:
            raise StoreError(
                f"{self.path}: the store is open in the process that this one was forked from, "
                "which goes on with it. Make a knowledge base with a store of its own here"
            )
        if self._is_stopping:
            raise KnowledgeBaseError(
                "this knowledge base is closed: its store is given back, so nothing more can be "
                "recorded. Record before you close it, or make a new one of this model and store"
            )

    # ---------------------------------------------------------------- write

    def start(
        self,
        log: Log,
        lock: Any,  # noqa: ANN401  # an RLock has no type
        snapshot: Callable[[], dict[str, Any]],
        record_message: Callable[[str], None],
    ) -> None:
        """Write events from now on.

        Args:
            log: the events.
            lock: that of the base, which is held while the log is read.
            snapshot: returns all that is known.
            record_message: records how the store is.
        """
        self._log = log
        self._lock = lock
        self._snapshot = snapshot
        self._record_message = record_message
        try:
            self._connection.execute(_ABOUT, ("is_open", "1"))
        except sqlite3.Error as error:
            raise StoreError(f"{self.path}: it cannot be written: {error}") from None
        self._begin()

    def _begin(self) -> None:
        self._thread = Thread(target=self._run, name=f"store {self.path.name}", daemon=True)
        self._thread.start()
        self._wake.set()

    def proceed(self, last: int) -> None:
        """Write what is new, and wait while too many events up to this number are not saved."""
        self._wake.set()
        if last - self.saved > _MOST_WAITING and os.getpid() == self._owner:
            self._wait(last - _MOST_WAITING)

    def flush(self, timeout: float | None = None) -> bool:
        """Wait, at most for a timeout [s], until all events so far are on disk."""
        last = self._log.last
        if os.getpid() == self._owner:
            self._wake.set()
            self._wait(last, timeout)
        return self.saved >= last

    def _wait(self, number: int, timeout: float | None = None) -> None:
        with self._progress:
            self._progress.wait_for(lambda: self.saved >= number or self.error, timeout)

    def close(self) -> None:
        """Save all events and close the file.

        Raises:
            StoreError: some events could not be saved. The store keeps trying: make room on the
                disk and close again.
        """
        with self._lock:
            if self._is_stopping or os.getpid() != self._owner:
                return
            self._is_stopping = True
        self._wake.set()
        self._thread.join()
        unsaved = self._log.last - self.saved
        if unsaved:
            self._is_stopping = False
            self._begin()
            advice = "are not saved; make room, and close it again"
            raise StoreError(f"{self.error}. {unsaved} events {advice}")
        with suppress(sqlite3.Error):
            self._connection.execute(_ABOUT, ("is_open", "0"))
            self._connection.execute("PRAGMA journal_mode=DELETE")
            self._connection.close()

    def _run(self) -> None:
        while True:
            self._wake.wait(_RETRY_S if self.error else None)
            self._wake.clear()
            is_last = self._is_stopping  # nothing is recorded any more but how the store is
            if not is_last:
                time.sleep(_BATCH_PAUSE_S)
            self._write()
            if is_last:
                if self.error or self.saved == self._log.last:
                    return
                self._wake.set()

    def _write(self) -> None:
        """Write the new events; if that fails, the file is as before."""
        with self._lock, self._log.reading():  # what was interrupted ends
            last = self._log.last
            batch = list(self._log.since(self.saved))
            snapshot = None
            since = last - self._snapshot_number
            is_long_ago = since >= (1000 if self._is_stopping else _SNAPSHOT_AFTER)
            is_forgotten = len(batch) < last - self.saved  # by the log, while nothing was saved
            if is_long_ago or is_forgotten or any(event.verb == "amend" for event in batch):
                facts = encode(self._snapshot(), {})
                snapshot = json.dumps(facts, separators=(",", ":"), default=str)
        before = self.error
        try:
            if batch or snapshot is not None:
                self._commit(batch, last, snapshot)
            self.error = None
            self.saved = last
        except (sqlite3.Error, OSError) as error:
            reason = f"nothing has been saved since event {self.saved}: {error}; it is tried again"
            self.error = f"{self.path}: {reason}"
        with self._progress:
            self._progress.notify_all()
        if (before is None) is not (self.error is None):
            words = self.error or f"{self.path}: everything is saved again"
            logging.getLogger(__name__).error(words)
            self._record_message(words)

    def _commit(self, batch: list[Event], last: int, snapshot: str | None) -> None:
        with self._connection as connection:  # it commits, or rolls back
            connection.execute("BEGIN")
            rows = [_row(event) for event in batch]
            connection.executemany("INSERT INTO events VALUES (?, ?, ?, ?, ?)", rows)
            if snapshot is not None:
                connection.execute("DELETE FROM snapshots")
                connection.execute("INSERT INTO snapshots VALUES (?, ?)", (last, snapshot))
                connection.execute(_FORGET_MEASUREMENTS, (self._keep, last))
        if snapshot is not None:
            self._snapshot_number = last


def connect(path: Path, *, is_new_allowed: bool = False) -> sqlite3.Connection:
    """Open the file of a store, which nobody else may use meanwhile.

    Raises:
        StoreError: it cannot be opened, is in use, or is no store.
    """
    if not is_new_allowed and not path.exists():
        raise StoreError(f"{path}: there is no such file")
    with _refusals(path):
        connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=1)
        try:
            _prepare(connection, path)
        except BaseException:
            connection.close()
            raise
    return connection


@contextmanager
def _refusals(path: Path) -> Iterator[None]:
    """Raise the errors of SQLite as those of a store."""
    try:
        yield
    except sqlite3.OperationalError as error:
        what = "it is in use by another program" if "locked" in str(error) else str(error)
        raise StoreError(f"{path}: the store cannot be opened: {what}") from None
    except sqlite3.DatabaseError as error:
        raise damaged(path, error) from None


def _prepare(connection: sqlite3.Connection, path: Path) -> None:
    """Make the tables of a new file; refuse one that is not a store of this format."""
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


def damaged(path: Path, what: object) -> StoreError:
    """Return the error for a file that SQLite cannot read."""
    return StoreError(
        f"{path}: the store is damaged: {what}. It is left unchanged; go back to a backup of it"
    )


def check_integrity(connection: sqlite3.Connection, path: Path) -> None:
    """Raise StoreError, with SQLite's words, if the file is damaged."""
    ((verdict,),) = connection.execute("PRAGMA integrity_check(1)")
    if verdict != "ok":
        raise damaged(path, verdict)


def store_info(path: Path) -> dict[str, object]:
    """Return what is in a store that is not in use, by title.

    Raises:
        StoreError: it cannot be opened, or is damaged.
    """
    with closing(connect(path)) as connection, _refusals(path):
        check_integrity(connection, path)
        about = dict(connection.execute("SELECT name, value FROM about"))
        counts = connection.execute("SELECT verb, count(*) FROM events GROUP BY verb ORDER BY verb")
        kept = ", ".join(f"{count} {verb}" for verb, count in counts)
        ((last, first_time, last_time),) = connection.execute(
            "SELECT max(number), min(time), max(time) FROM events"
        )
        connection.execute("PRAGMA journal_mode=DELETE")
    model = json.loads(about.get("model", "[]"))
    return {
        "store": str(path),
        "model": next((values["name"] for words, values in model if words == "model"), None),
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
    with closing(connect(path)) as connection, closing(sqlite3.connect(copy)) as target:
        connection.backup(target)
        connection.execute("PRAGMA journal_mode=DELETE")


_READERS: Final[dict[str, Callable[[list[Any]], Any]]] = {
    "dict": dict,
    "mappingproxy": lambda pairs: MappingProxyType(dict(pairs)),
    "set": set,
    "tuple": tuple,
    "deque": lambda rows: deque(map(tuple, rows)),
}
_CLASSES: Final = {
    cls.__name__: cls
    for cls in (
        *(Status, Debounced, Reason),
        *(RequiredAction, ReconfigurationPlan, Process, Attempt, VetoAnswer),
    )
}
"""The classes of which facts are made, beside the plain ones."""


def encode(value: Any, memo: dict[int, int]) -> Any:  # noqa: ANN401  # of which facts are made
    """Return a fact as JSON can hold it: what JSON does not know as {class: content}.

    A record that is there several times is written once, and then by its place in the memo.
    """
    cls = type(value)
    if cls is Node:
        return {"Node": value.ref}
    if cls.__name__ not in {*_READERS, *_CLASSES}:
        return value
    if id(value) in memo:
        return {"same": memo[id(value)]}
    if cls is Status:
        return {"Status": [str(value)]}
    if cls is deque:  # of measurements, which are many
        return {"deque": list(value)}
    items = value.items() if isinstance(value, Mapping) else value
    if is_dataclass(value):
        items = [getattr(value, field.name) for field in fields(value)]
    content = [encode(item, memo) for item in items]
    if is_dataclass(value):
        memo[id(value)] = len(memo)
    return {cls.__name__: content}


def decode(written: Any, network: Network | None, memo: list[Any]) -> Any:  # noqa: ANN401  # what JSON holds
    """Return the fact that was encoded."""
    if not isinstance(written, dict):
        return written
    ((word, content),) = written.items()
    if word == "same":
        return memo[content]
    if word == "Node" and network is not None:
        return network.referred(tuple(content))
    items = [decode(item, network, memo) for item in content]
    if word in _READERS:
        return _READERS[word](items)
    value = _CLASSES[word](*items)
    if is_dataclass(value):
        memo.append(value)
    return value


def events_in(connection: sqlite3.Connection, after: int = 0) -> Iterator[Event]:
    """Yield the events of a store after a number, in order."""
    query = "SELECT data FROM events WHERE number > ? ORDER BY number"
    for (data,) in connection.execute(query, (after,)):
        values = json.loads(data)
        yield Event.from_json(values, decode(values.get("plan"), None, []))


def _row(event: Event) -> tuple[int, float, str, str, str]:
    values = event.to_json()
    values.pop("changes", None)  # they follow again
    if event.plan is not None:
        values["plan"] = encode(replace(event.plan, end=None, result=None), {})
    data = json.dumps(values, separators=(",", ":"), default=str)
    return event.number, float(event.time), event.verb, event.subject, data
