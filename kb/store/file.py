"""The file of a store: made as a whole or not at all, opened by one process at a time.

One that is not ours, or not well, is left as it is. It says in its header that it is ours and of which format.
"""

import fcntl
import os
import sqlite3
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from kb.exceptions import KnowledgeBaseError
from kb.individuals import MODEL, Individual
from kb.rdfxml import ROSA

__all__ = ["FORMAT", "StoreError", "blamed", "check_format", "guarded", "has_content", "locked", "make", "values_of"]

FORMAT: Final = 1
"""Of files that this version writes."""

_MAGIC: Final = b"SQLite format 3\0"
_OWNER: Final = 0x524F5341
"""ROSA in ASCII: the application id in the header of the file."""

_VALUE: Final = "SELECT o FROM datas WHERE p = (SELECT storid FROM resources WHERE iri = ?) ORDER BY s"


class StoreError(KnowledgeBaseError):
    """A store cannot be opened, or is not one; it is as it was."""


def has_content(path: Path) -> bool:
    """Tell whether there is a file that is not empty."""
    try:
        return path.stat().st_size > 0
    except FileNotFoundError:
        return False
    except OSError as error:
        raise StoreError(f"{path}: the store cannot be read: {error.strerror}") from None


def make(path: Path, base: str, declared: str, given: Iterable[Individual]) -> bool:
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


def guarded(path: Path) -> int:
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


def check_format(path: Path, descriptor: int) -> None:
    """Raise `StoreError` unless the header of a file says that it is a store of a format that is known."""
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


def locked(path: Path) -> sqlite3.Connection:
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


def values_of(connection: sqlite3.Connection, word: str) -> list[object]:
    """Return all that is told by a word of ROSA, in order."""
    return [found for (found,) in connection.execute(_VALUE, (f"{ROSA}{word}",))]


@contextmanager
def blamed(path: Path) -> Iterator[None]:
    """Say that the file is damaged if what is in it cannot be understood."""
    try:
        yield
    except (sqlite3.Error, TypeError, ValueError, LookupError) as error:
        raise _damaged(path, error) from None


def _damaged(path: Path, what: object) -> StoreError:
    return StoreError(f"{path}: the store is damaged: {what}. Take a copy of it that is not, or name another file")
