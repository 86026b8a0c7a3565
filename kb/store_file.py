"""The file of a store: each record carries a digest of itself and the one before it, so damage is found.

While the database is in use, SQLite's own log (`-wal`) and a mark (`-mark`) lie beside it. The mark names the last
event that was acknowledged: by it a file that is cut off, altered, missing or exchanged is noticed.
"""

import fcntl
import json
import os
import sqlite3
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

from kb.events import Event
from kb.exceptions import KnowledgeBaseError
from kb.files import draft, sync_folder
from kb.records import plain

FORMAT: Final = 3  # of files that this version writes and reads
HEAD: Final = 100  # the size of the header of the file, by which it is known [bytes]
_MAGIC: Final = b"SQLite format 3\0"
_OWNER: Final = 0x524F5341  # ROSA in ASCII: the application id in the header of the file
_TABLES: Final = (
    "CREATE TABLE about (declared TEXT NOT NULL, since INTEGER NOT NULL, id BLOB NOT NULL, digest BLOB NOT NULL)",
    "CREATE TABLE life (is_open INTEGER NOT NULL, last INTEGER NOT NULL, tail BLOB NOT NULL, digest BLOB NOT NULL)",
    "CREATE TABLE events (number INTEGER PRIMARY KEY, time REAL NOT NULL, verb TEXT NOT NULL, subject TEXT NOT NULL, "
    "data TEXT NOT NULL, before BLOB NOT NULL, digest BLOB NOT NULL)",
    "CREATE INDEX others ON events (number) WHERE verb <> 'measure'",
    "CREATE TABLE snapshots (number INTEGER PRIMARY KEY, time REAL NOT NULL, known TEXT NOT NULL, "
    "others INTEGER NOT NULL, tail BLOB NOT NULL, digest BLOB NOT NULL)",
)

WHOLE_CHECK: Final = 8 << 20
"""Up to which size the whole history is checked before a file is used; more is checked as it is read [bytes]."""

BROKEN: Final = (
    sqlite3.Error,
    TypeError,
    ValueError,
    LookupError,
)  # what reading a damaged file may raise


class StoreError(KnowledgeBaseError):
    """A store cannot be opened or used, or a file is no store; the file is unchanged."""


def damaged(path: Path, what: object) -> StoreError:
    repair = f"`rosa store repair {path} NEW` writes what is sound to a new file, or take a copy of it that is sound"
    return StoreError(f"{path}: the store is damaged: {what}. It is left unchanged; {repair}")


def digest(before: bytes, *values: object) -> bytes:
    return blake2b(before + repr(values).encode(), digest_size=16).digest()


def is_sound(values: tuple[Any, ...]) -> bool:
    """Tell whether a record ends with the digest of its values and of the record before it."""
    *said, before, own = values
    return isinstance(before, bytes) and own == digest(before, *said)


class Row(NamedTuple):
    """An event as it is written."""

    number: int
    time: float
    verb: str
    subject: str
    data: str
    before: bytes
    digest: bytes

    @classmethod
    def of(cls, event: Event, before: bytes) -> Self:
        data = json.dumps(
            [plain(event.arguments), event.cause, event.effects], separators=(",", ":")
        )
        subject = str(event.subject).encode("utf-8", "replace").decode()
        values = (event.number, float(event.time), event.verb, subject, data)
        return cls(*values, before, digest(before, *values))

    @property
    def event(self) -> Event:
        arguments, cause, effects = json.loads(self.data)
        given = {
            "number": self.number,
            "time": self.time,
            "verb": self.verb,
            "arguments": arguments,
        }
        return Event.from_json({**given, "cause": cause, "effects": effects})


class Snapshot(NamedTuple):
    """What was known after an event; `others` counts the events up to then that are not measurements."""

    number: int
    time: float
    known: str
    others: int
    tail: bytes
    digest: bytes

    @classmethod
    def of(cls, number: int, time: float, known: str, others: int, tail: bytes) -> Self:
        return cls(number, time, known, others, tail, digest(tail, number, time, known, others))


NOTHING: Final = Snapshot(0, 0.0, "", 0, b"", b"")
"""What is known before the first event."""


class Mark(NamedTuple):
    """The number of the last event of a store that was acknowledged, and its digest."""

    id: bytes
    number: int
    tail: bytes

    def written(self) -> bytes:
        text = f"ROSA {self.id.hex()} {self.number} {self.tail.hex() or '-'}"
        return f"{text} {digest(b'', text).hex()}\n".ljust(256).encode()

    @classmethod
    def read(cls, path: Path) -> Self | None:
        """Return the mark beside a database; None if there is none that is sound."""
        with suppress(OSError, ValueError):
            text, _, check = beside(path, "mark").read_bytes().decode().rstrip().rpartition(" ")
            if check == digest(b"", text).hex():
                _, own, number, tail = text.split()
                return cls(bytes.fromhex(own), int(number), bytes.fromhex(tail.strip("-")))
        return None


def beside(path: Path, of: str) -> Path:
    return path.with_name(f"{path.name}-{of}") if of else path


class Survey(NamedTuple):
    """The sound part of a database: the newest snapshot, and the events after it, without a gap."""

    declared: str | None  # the model; None if it is not as it was written
    since: int  # the event before which it was another model
    id: bytes
    snapshot: Snapshot
    rows: list[Row]
    last: int  # the last event that is sound with all before it, and its digest
    tail: bytes
    acknowledged: int  # the last event that was acknowledged, as far as that is known
    is_open: bool
    problem: str  # what is wrong, first of all; empty if nothing is

    @property
    def time(self) -> float:
        """The time of the last event [s]."""
        return (self.rows[-1] if self.rows else self.snapshot).time

    @property
    def missing(self) -> int:
        return max(0, self.acknowledged - self.last)

    def error(self, path: Path) -> StoreError:
        words = (
            f", and {self.missing} that were acknowledged after it are missing"
            if self.missing
            else ""
        )
        sound = (
            f"it is sound up to event {self.last}{words}"
            if self.declared is not None
            else "its model is lost"
        )
        return damaged(path, f"{self.problem}; {sound}")


def survey(connection: sqlite3.Connection, mark: Mark | None, *, is_whole: bool) -> Survey:
    """Find out what is sound in a database; nothing that is damaged raises."""
    problems: list[str] = []

    def tried(statement: str, *given: object) -> list[Any]:
        found: list[Any] = []
        try:
            found.extend(connection.execute(statement, given))
        except BROKEN as error:
            problems.append(str(error))
        return found

    if is_whole and (found := tried("PRAGMA integrity_check(1)")) and found != [("ok",)]:
        problems.append(str(found[0][0]).splitlines()[-1])
    about = [one for one in tried("SELECT * FROM about") if one[3] == digest(b"", *one[:3])]
    if not about:
        problems.append("its model is not as it was written")
    declared, since, own = about[0][:3] if about else (None, 0, b"")
    life = [one for one in tried("SELECT * FROM life") if one[3] == digest(own, *one[:3])]
    if not life:
        problems.append("how it was closed is not as it was written")
    is_open, closed_at, closed_tail = life[0][:3] if life else (True, 0, b"")
    snapshots = [Snapshot(*one) for one in tried("SELECT * FROM snapshots ORDER BY number DESC")]
    problems += [
        f"what was known after event {one.number} is damaged"
        for one in snapshots
        if not is_sound(one)
    ]
    snapshot = next((one for one in snapshots if is_sound(one)), NOTHING)
    number, tail = snapshot.number, snapshot.tail
    counted = tried("SELECT COUNT(*) FROM events WHERE verb <> 'measure' AND number <= ?", number)
    if counted and counted[0][0] != snapshot.others:
        problems.append(
            f"of {snapshot.others} events before {number} that are no measurements not all are there"
        )
    ends, rows = {number: tail}, []
    try:
        for one in connection.execute(
            "SELECT * FROM events WHERE number > ? ORDER BY number", (number,)
        ):
            row = Row(*one)
            if row.number != number + 1 or row.before != tail or not is_sound(row):
                problems.append(f"event {number + 1} is not as it was written")
                break
            if row.verb == "amend" and row.number > since:
                problems.append(
                    f"the model was changed at event {row.number}, and what was known then is not there"
                )
                break
            rows.append(row)
            number, tail = row.number, row.digest
            ends[number] = tail
    except BROKEN as error:
        problems.append(f"after event {number}: {error}")
    marks = [
        one
        for one in (mark, Mark(own, closed_at, closed_tail))
        if one is not None and one.id == own
    ]
    acknowledged = max(one.number for one in marks)
    if is_open and mark not in marks:
        problems.append(
            "the mark of what was acknowledged, a file beside it, is missing or of another store"
        )
    elif any(ends.get(one.number, one.tail) != one.tail for one in marks) or acknowledged > number:
        problems.append(f"event {acknowledged} was acknowledged, and is missing or another one")
    if is_whole and not problems:
        try:
            deque(history(connection, 0, snapshot.number), maxlen=0)
        except BROKEN as error:
            problems.append(str(error))
    problem = problems[0] if problems else ""
    return Survey(
        declared, since, own, snapshot, rows, number, tail, acknowledged, bool(is_open), problem
    )


def history(
    connection: sqlite3.Connection, after: int, until: int, only: str = "", most: int = -1
) -> Iterator[Row]:
    """Yield records in order; each is checked, also against the one before it if that is still there."""
    order = f"SELECT * FROM events WHERE number > ? AND number <= ? {only} ORDER BY number LIMIT ?"
    before: Row | None = None
    for row in (Row(*one) for one in connection.execute(order, (after, until, most))):
        follows = before is None or before.number + 1 != row.number or before.digest == row.before
        if not is_sound(row) or not follows:
            raise ValueError(f"event {row.number} is not as it was written")
        yield row
        before = row


# -------------------------------------------------------------------- opening and making


def make(path: Path, declared: str) -> bool:
    """Make the file of a store under another name and then rename it, so that it is there complete or not at all.

    Returns:
        False if there is a file already, perhaps because another process has made it meanwhile.
    """
    try:
        if path.exists() and (path.is_dir() or path.stat().st_size > 0):
            return False
        with draft(path) as part:
            connection = sqlite3.connect(part)
            for statement in (
                f"PRAGMA application_id={_OWNER}",
                f"PRAGMA user_version={FORMAT}",
                *_TABLES,
            ):
                connection.execute(statement)
            own = os.urandom(16)
            values = declared, 0, own
            connection.execute(
                "INSERT INTO about VALUES (?, ?, ?, ?)", (*values, digest(b"", *values))
            )
            write_life(connection, own, is_open=False, last=0, tail=b"")
            connection.commit()
            connection.close()
            return put_in_place(part, path)
    except (OSError, sqlite3.Error) as error:
        why = getattr(error, "strerror", None) or error
        raise StoreError(
            f"{path}: the store cannot be made: {why}; see who may write in that folder"
        ) from None


def write_life(
    connection: sqlite3.Connection, own: bytes, *, is_open: bool, last: int, tail: bytes
) -> None:
    values = int(is_open), last, tail
    connection.execute("DELETE FROM life")
    connection.execute("INSERT INTO life VALUES (?, ?, ?, ?)", (*values, digest(own, *values)))


def write_about(connection: sqlite3.Connection, own: bytes, declared: str, since: int) -> None:
    values = declared, since, own
    connection.execute(
        "UPDATE about SET declared = ?, since = ?, id = ?, digest = ?",
        (*values, digest(b"", *values)),
    )


def put_in_place(part: Path, path: Path) -> bool:
    try:
        path.hardlink_to(part)
    except FileExistsError:
        if path.stat().st_size > 0:
            return False
        part.replace(path)
    except OSError:  # a file system without links
        part.replace(path)
    sync_folder(path.parent)
    return True


def guarded(path: Path) -> int:
    """Open and lock a store that nobody else has open; returns the descriptor of its file.

    Keep it until the database is closed: closing any descriptor of a file takes away the locks of SQLite on it.
    """
    descriptor = -1
    try:
        descriptor = os.open(path, os.O_RDONLY)
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        check_format(path, os.pread(descriptor, HEAD, 0))
    except (OSError, StoreError) as error:
        if descriptor >= 0:
            os.close(descriptor)
        if isinstance(error, StoreError):
            raise
        is_taken = isinstance(error, BlockingIOError)
        raise (
            _in_use(path)
            if is_taken
            else StoreError(f"{path}: the store cannot be read: {error.strerror}")
        ) from None
    return descriptor


def _in_use(path: Path) -> StoreError:
    return StoreError(
        f"{path}: the store is in use by another knowledge base or process; close that, or name another"
    )


def check_format(path: Path, head: bytes) -> None:
    if not head.startswith(_MAGIC) or len(head) < HEAD:
        raise StoreError(f"{path}: this is not a store; it is left unchanged. Name another file")
    if int.from_bytes(head[68:72], "big") != _OWNER:
        raise StoreError(
            f"{path}: this is the database of another program; it is left unchanged. Name another file"
        )
    found = int.from_bytes(head[60:64], "big")
    if found != FORMAT:
        which = (
            "a newer version; update" if found > FORMAT else "an older version; open it with that"
        )
        raise StoreError(f"{path}: the store has format {found}, of {which}, or name another file")


def opened(path: Path) -> tuple[sqlite3.Connection, Survey]:
    """Open a database exclusively; one that is damaged or cannot be written is left unchanged."""
    log = beside(path, "wal")
    content = log.read_bytes() if log.exists() else None
    try:
        connection = sqlite3.connect(
            path, timeout=0.0, isolation_level="EXCLUSIVE", check_same_thread=False
        )
    except sqlite3.Error as error:
        raise StoreError(f"{path}: the store cannot be opened: {error}") from None
    try:
        connection.execute("PRAGMA locking_mode=EXCLUSIVE")
        connection.execute("BEGIN EXCLUSIVE")
        found = survey(connection, Mark.read(path), is_whole=path.stat().st_size <= WHOLE_CHECK)
        if found.problem:
            raise found.error(path)
        connection.execute(
            f"PRAGMA user_version={FORMAT}"
        )  # a file that may only be read is not noticed before that
        connection.rollback()
    except BaseException as error:
        _leave(connection, log, content)
        if not isinstance(error, sqlite3.Error):
            raise
        if "locked" in str(error):
            raise _in_use(path) from None
        if isinstance(error, sqlite3.OperationalError):
            raise StoreError(
                f"{path}: the store cannot be opened for writing: {error}; see who may write it"
            ) from None
        raise damaged(path, error) from None
    return connection, found


def _leave(connection: sqlite3.Connection, log: Path, content: bytes | None) -> None:
    """Close a database and put its log back as it was, as SQLite would write any log into the database."""
    connection.interrupt()
    connection.close()
    if content is None:
        log.unlink(missing_ok=True)
    elif not log.exists():  # there was nothing in it that SQLite understands
        log.write_bytes(content)
