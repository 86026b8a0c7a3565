"""Care for stores: what is in one that may be in use, copies, what is sound of a damaged one, and changed models."""

import json
import os
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory
from threading import RLock
from typing import Any, Final, NamedTuple

from kb.amendments import differences
from kb.events import Event
from kb.exceptions import UnknownName
from kb.files import draft
from kb.knowledge import Knowledge
from kb.model import Model
from kb.network import Network, Ref
from kb.store import Store
from kb.store_file import (
    BROKEN,
    Mark,
    Row,
    Snapshot,
    StoreError,
    Survey,
    beside,
    check_format,
    is_sound,
    make,
    put_in_place,
    survey,
    write_about,
    write_life,
)

_TOLD: Final = ("failed", "active", "selected", "requested", "asserted", "asserted_required")


@contextmanager
def surveyed(path: Path, folder: Path | None = None) -> Iterator[tuple[sqlite3.Connection, Survey]]:
    """Give what is in a store, of a copy: whoever has it open goes on, and a damaged one is not touched.

    The copy is as if that had been killed at one instant: SQLite's log beside the file only grows until it is begun
    anew, and brings any mixture of the file's pages from before and after it was brought into the file to one state.
    Only if it was begun anew is all copied again.
    """
    try:
        with path.open("rb") as file, TemporaryDirectory(prefix=".rosa-", dir=folder) as place:
            check_format(path, file.fileno())
            copy = Path(place) / path.name
            for _ in range(100):
                begun = _head(beside(path, "wal"))
                for of in ("mark", "", "wal"):
                    beside(copy, of).unlink(missing_ok=True)
                    with suppress(FileNotFoundError):
                        copyfile(beside(path, of), beside(copy, of))
                if _head(beside(path, "wal")) == begun:
                    break
            connection = sqlite3.connect(copy)
            try:
                yield connection, survey(connection, Mark.read(copy), is_whole=True)
            finally:
                connection.close()
    except (OSError, sqlite3.Error) as error:
        raise StoreError(f"{path}: the store cannot be read: {getattr(error, 'strerror', None) or error}") from None


def _head(log: Path) -> bytes:
    with suppress(FileNotFoundError), log.open("rb") as file:
        return file.read(32)
    return b""


def backup(path: Path, to: Path) -> Survey:
    """Copy a store, which may be written to meanwhile, to a file that is not there yet."""
    with surveyed(path, _free(to)) as (connection, found):
        if found.problem:
            raise found.error(path)
        _save(connection, found, found.last, found.tail, to)
    return found


def repair(path: Path, to: Path) -> Survey:
    """Write what is sound of a store to a file that is not there yet, with a record of that; returns what was found."""
    with surveyed(path, _free(to)) as (connection, found), draft(to) as part:
        if found.declared is None:
            raise found.error(path)
        snapshot = found.snapshot
        rows = [*_sound(connection, snapshot.number if snapshot else 0), *found.rows]
        words = f"repaired: sound up to event {found.last}; {found.missing} acknowledged ones are missing"
        time = rows[-1].time if rows else snapshot.time if snapshot else 0.0
        last = Row.of(Event(found.last + 1, time, "store", (words,)), found.tail)
        make(part, found.declared)
        fresh = sqlite3.connect(part)
        try:
            fresh.executemany("INSERT INTO events VALUES (?, ?, ?, ?, ?, ?, ?)", [*rows, last])
            if snapshot:
                others = sum(row.verb != "measure" for row in rows) - sum(row.verb != "measure" for row in found.rows)
                kept = Snapshot.of(*snapshot[:3], others, snapshot.tail)
                fresh.execute("INSERT INTO snapshots VALUES (?, ?, ?, ?, ?, ?)", kept)
            _save(fresh, found, last.number, last.digest, to)
        finally:
            fresh.close()
    return found


def _sound(connection: sqlite3.Connection, until: int) -> list[Row]:
    """Return the records up to one that are sound, from both ends if there is damage between."""
    found: dict[int, Row] = {}
    for order in ("ASC", "DESC"):
        with suppress(*BROKEN):
            for row in connection.execute(f"SELECT * FROM events WHERE number <= ? ORDER BY number {order}", (until,)):
                found[row[0]] = Row(*row)
    rows = [found[number] for number in sorted(found) if is_sound(found[number])]
    torn = {two.number for one, two in pairwise(rows) if one.number + 1 == two.number and one.digest != two.before}
    return [row for row in rows if row.number not in torn]


def _free(to: Path) -> Path:
    if to.exists() or to.is_symlink():
        raise StoreError(f"{to}: there is a file already; name one that is not there")
    return to.parent


def _save(connection: sqlite3.Connection, found: Survey, last: int, tail: bytes, to: Path) -> None:
    """Close the database of a connection as one file of its own, and put it in its place."""
    own = os.urandom(16)
    write_about(connection, own, str(found.declared), found.since)
    write_life(connection, own, is_open=False, last=last, tail=tail)
    connection.commit()
    connection.execute("PRAGMA journal_mode=DELETE")
    (_, _, file), *_ = connection.execute("PRAGMA database_list").fetchall()
    connection.close()
    if not put_in_place(Path(file), to):
        _free(to)


# -------------------------------------------------------------------- changed models


class Migration(NamedTuple):
    """What a migration changes, in words: between the models, and what was so of what is no longer there."""

    differences: tuple[str, ...]
    dropped: tuple[str, ...]


def migrate(path: Path, model: Model, *, dry_run: bool = False) -> Migration:
    """Have a store go on with another model, in one step; the log says what changed, and all events stay.

    It happens at the time of the last event. What the other model states to be so is not told again.
    """
    store = Store(path, None)
    try:
        now = store.time
        known, fresh = (Knowledge(one, lambda: now, RLock()) for one in (store.model, model))
        store.restore(known, now)
        before, after = known.network, fresh.network
        written = json.loads(json.dumps(known.to_json(store.keep)))
        found = Migration(tuple(differences(store.model, model)), tuple(_dropped(written, before, after)))
        if dry_run or not found.differences:
            return found
        for request in written["records"]["requests"]:
            if request["end"] is None and request["action"] not in after.actions:
                request.update(end=now, result="abandoned", reason="it is no longer in the model")
        number = known.log.last + 1
        fresh.from_json(_carried(written, before, after), number, now)
        words = "; ".join(["the model was changed", *found.differences, *(f"dropped: {one}" for one in found.dropped)])
        events = [*known.log.since(store.saved), Event(number, now, "store", (words,))]
        store.adopt(model, events, (number, now, json.dumps(fresh.to_json(store.keep), separators=(",", ":"))))
        return found
    finally:
        store.close()


def _moved(ref: Iterable[Any], before: Network, after: Network) -> Ref | None:
    """Return what refers in another model to the same: of the same name, or a constraint that says the same."""
    try:
        old = before.referred(tuple(ref))
        new = after.referred(old.ref[:2])
    except UnknownName:
        return None
    if old.kind != "constraint":
        return new.ref
    said = repr(old.element).partition(", constrained=")[0]
    return next((one.ref for one in new.constraints if repr(one.element).partition(", constrained=")[0] == said), None)


def _dropped(written: Any, before: Network, after: Network) -> Iterator[str]:  # noqa: ANN401  # what JSON holds
    for name in _TOLD:
        for ref, value in written["facts"][name]:
            if _moved(ref, before, after) is None:
                yield f"that {ref[0]} {ref[1]} is {'' if value is True else f'{value} '}{name.replace('_', ' ')}"
    heard = [one[0] for one in written["histories"] if one[1]]
    yield from (f"what was measured of {name}" for name in heard if name not in after.attributes)
    yield from (f"the parameters of {name}" for name in written["parameters"] if name not in after.components)


def _carried(written: Any, before: Network, after: Network) -> dict[str, Any]:  # noqa: ANN401  # what JSON holds
    def kept(values: Iterable[Any], place: int = 0) -> list[Any]:
        moved = [(one, _moved(one[place], before, after)) for one in values]
        return [[*one[:place], ref, *one[place + 1 :]] for one, ref in moved if ref is not None]

    return {
        **written,
        "facts": {name: kept(values) for name, values in written["facts"].items()},
        "reasons": kept(written["reasons"], 1),
        "parameters": {name: one for name, one in written["parameters"].items() if name in after.components},
        "histories": [one for one in written["histories"] if one[0] in after.attributes],
        **{name: kept(written[name]) for name in ("recent", "since", "changed_by")},
    }
