"""`rosa store`: show, check, copy and repair the store of a knowledge base, and change its model."""

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
from typing import Annotated, Any, Final

import typer

from kb.events import Event
from kb.exceptions import UnknownName
from kb.files import draft
from kb.knowledge import Knowledge
from kb.model import differences
from kb.network import Network, Ref
from kb.store import Store
from kb.store_file import (
    BROKEN,
    HEAD,
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
from missions.commands import FAILED, complain
from missions.commands.check import model_of
from missions.engine.mission import find_mission

app: Final = typer.Typer(
    help="Look after the store of a knowledge base.", no_args_is_help=True, add_completion=False
)
File = Annotated[Path, typer.Argument(metavar="FILE", help="The store.")]
New = Annotated[Path, typer.Argument(metavar="NEW", help="A file that is not there yet.")]

_TOLD: Final = ("failed", "active", "selected", "requested", "asserted", "asserted_required")


@app.command()
def info(file: File) -> None:
    """Say what is in a store, also while it is written to; exit with 1 if it is damaged."""
    with surveyed(file) as (connection, found):
        rows = json.loads(found.declared or "[]")
        shown: dict[str, object] = {
            "store": str(file),
            "model": rows[0][1]["name"] if rows else None,
            "last sound event": found.last,
            "last acknowledged event": found.acknowledged,
            "state": "in use, or not closed" if found.is_open else "closed",
            "damage": found.problem or "none",
        }
        if not found.problem:
            counts = connection.execute(
                "SELECT verb, COUNT(*) FROM events GROUP BY verb ORDER BY verb"
            )
            shown["events kept"] = ", ".join(f"{count} {verb}" for verb, count in counts)
            asked = "SELECT MIN(time), MAX(time) FROM events"
            ((shown["first time [s]"], shown["last time [s]"]),) = connection.execute(asked)
    for name, value in shown.items():
        typer.echo(f"{name}: {value}")
    if found.problem:
        raise typer.Exit(FAILED)


@app.command()
def check(file: File) -> None:
    """Check every record of a store, also while it is written to; exit with 1 if it is damaged."""
    with surveyed(file) as (connection, found):
        if found.problem:
            complain(str(found.error(file)))
            raise typer.Exit(FAILED)
        ((count,),) = connection.execute("SELECT COUNT(*) FROM events")
    typer.echo(
        f"{file}: sound up to event {found.last}; {count} events are kept, and all acknowledged ones were seen"
    )


@app.command()
def backup(file: File, new: New) -> Survey:
    """Copy a store to a new file as it is at this moment, also while it is written to."""
    with surveyed(file, _free(new)) as (connection, found):
        if found.problem:
            raise found.error(file)
        _save(connection, found, found.last, found.tail, new)
    typer.echo(f"{new}: a copy of {file} up to event {found.last}")
    return found


@app.command()
def repair(file: File, new: New) -> Survey:
    """Write what is sound of a damaged store to a new file; the damaged one is left as it is."""
    with surveyed(file, _free(new)) as (connection, found), draft(new) as part:
        if found.declared is None:
            raise found.error(file)
        snapshot = found.snapshot
        rows = [*_sound(connection, snapshot.number), *found.rows]
        words = f"repaired: sound up to event {found.last}; {found.missing} acknowledged ones are missing"
        last = Row.of(Event(found.last + 1, found.time, "store", (words,)), found.tail)
        make(part, found.declared)
        fresh = sqlite3.connect(part)
        try:
            fresh.executemany("INSERT INTO events VALUES (?, ?, ?, ?, ?, ?, ?)", [*rows, last])
            if snapshot.number:
                others = sum(row.verb != "measure" for row in rows) - sum(
                    row.verb != "measure" for row in found.rows
                )
                kept = Snapshot.of(*snapshot[:3], others, snapshot.tail)
                fresh.execute("INSERT INTO snapshots VALUES (?, ?, ?, ?, ?, ?)", kept)
            _save(fresh, found, last.number, last.digest, new)
        finally:
            fresh.close()
    typer.echo(
        f"{new}: {file} up to event {found.last}; {found.missing} acknowledged events after it are missing"
    )
    typer.echo(f"what was wrong: {found.problem}" if found.problem else "nothing was wrong")
    return found


@app.command()
def migrate(
    file: File,
    model: Annotated[
        list[Path] | None, typer.Argument(metavar="MODEL...", help="Files of the model.")
    ] = None,
    mission: Annotated[str | None, typer.Option(help="The model of a mission instead.")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only say what would change.")] = False,
) -> None:
    """Have a store go on with a model that has changed, in one step: say what came, went and changed, and is dropped.

    It happens at the time of the last event, all events stay, and the log says what changed. What the other model
    states to be so is not told again.
    """
    given = model_of(model or [], find_mission(mission) if mission else None)
    store = Store(file, None)
    try:
        changed = differences(store.model, given)
        now = store.time
        known, fresh = (Knowledge(one, lambda: now, RLock()) for one in (store.model, given))
        store.restore(known, now)
        written = json.loads(json.dumps(known.to_json(store.keep)))
        dropped = _carry_over(written, known.network, fresh.network, now)
        for words in changed or [f"{file}: the model is that of the store; nothing is changed"]:
            typer.echo(words)
        for words in dropped:
            typer.echo(f"dropped: {words}")
        if changed and not dry_run:
            number = known.log.last + 1
            fresh.from_json(written, number, now)
            words = "; ".join(
                ["the model was changed", *changed, *(f"dropped: {one}" for one in dropped)]
            )
            events = [*known.log.since(store.saved), Event(number, now, "store", (words,))]
            store.adopt(
                given,
                events,
                (number, now, json.dumps(fresh.to_json(store.keep), separators=(",", ":"))),
            )
    finally:
        store.close()
    if changed:
        typer.echo(
            f"{file}: {'nothing is changed yet' if dry_run else 'the store is of that model now'}"
        )


# -------------------------------------------------------------------- copies of what may be damaged, or in use


@contextmanager
def surveyed(path: Path, folder: Path | None = None) -> Iterator[tuple[sqlite3.Connection, Survey]]:
    """Survey a copy of a store: a program that has it open is not disturbed, and a damaged store is not touched.

    The copy is as if that program had been killed at one instant. SQLite's log (WAL) beside the file only grows until
    it is restarted, and it turns any mixture of old and new pages of the file into one consistent state. So all is
    copied again only if the log was restarted meanwhile.
    """
    try:
        with path.open("rb") as file, TemporaryDirectory(prefix=".rosa-", dir=folder) as place:
            check_format(path, file.read(HEAD))
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
        raise StoreError(
            f"{path}: the store cannot be read: {getattr(error, 'strerror', None) or error}"
        ) from None


def _head(log: Path) -> bytes:
    with suppress(FileNotFoundError), log.open("rb") as file:
        return file.read(32)
    return b""


def _sound(connection: sqlite3.Connection, until: int) -> list[Row]:
    """Return the sound records up to a number, read from both ends in case there is damage between."""
    found: dict[int, Row] = {}
    for order in ("ASC", "DESC"):
        with suppress(*BROKEN):
            for row in connection.execute(
                f"SELECT * FROM events WHERE number <= ? ORDER BY number {order}", (until,)
            ):
                found[row[0]] = Row(*row)
    rows = [found[number] for number in sorted(found) if is_sound(found[number])]
    torn = {
        two.number
        for one, two in pairwise(rows)
        if one.number + 1 == two.number and one.digest != two.before
    }
    return [row for row in rows if row.number not in torn]


def _free(to: Path) -> Path:
    if to.exists() or to.is_symlink():
        raise StoreError(f"{to}: there is a file already; name one that is not there")
    return to.parent


def _save(connection: sqlite3.Connection, found: Survey, last: int, tail: bytes, to: Path) -> None:
    """Close a connection, leave its database as a single file, and move that to its place."""
    own = os.urandom(16)
    write_about(connection, own, str(found.declared), found.since)
    write_life(connection, own, is_open=False, last=last, tail=tail)
    connection.commit()
    connection.execute("PRAGMA journal_mode=DELETE")
    (_, _, file), *_ = connection.execute("PRAGMA database_list").fetchall()
    connection.close()
    if not put_in_place(Path(file), to):
        _free(to)


# -------------------------------------------------------------------- what is known, with another model


def _carry_over(written: dict[str, Any], before: Network, after: Network, now: float) -> list[str]:
    """Keep of a state (JSON) only what is about elements of the new model, too; return what is dropped, in words."""
    dropped = []

    def kept(values: Iterable[Any], place: int = 0, words: str = "") -> list[Any]:
        moved = [(one, _moved(one[place], before, after)) for one in values]
        for (kind, name, *_), value in [one for one, ref in moved if ref is None and words]:
            dropped.append(f"that {kind} {name} is {'' if value is True else f'{value} '}{words}")
        return [[*one[:place], ref, *one[place + 1 :]] for one, ref in moved if ref is not None]

    for name, values in written["facts"].items():
        written["facts"][name] = kept(values, words=name.replace("_", " ") if name in _TOLD else "")
    written["reasons"] = kept(written["reasons"], 1)
    for name in ("recent", "since", "changed_by"):
        written[name] = kept(written[name])
    gone = [one for one in written["histories"] if one[0] not in after.attributes]
    dropped += [f"what was measured of {name}" for name, packed, _ in gone if packed]
    written["histories"] = [one for one in written["histories"] if one not in gone]
    for name in [name for name in written["parameters"] if name not in after.components]:
        del written["parameters"][name]
        dropped.append(f"the parameters of {name}")
    for request in written["records"]["requests"]:
        if request["end"] is None and request["action"] not in after.actions:
            request.update(end=now, result="abandoned", reason="it is no longer in the model")
    return dropped


def _moved(ref: Iterable[Any], before: Network, after: Network) -> Ref | None:
    """Return the reference to the same element in the new model: by name, or to a constraint that says the same."""
    try:
        old = before.referred(tuple(ref))
        new = after.referred(old.ref[:2])
    except UnknownName:
        return None
    if old.kind != "constraint":
        return new.ref
    said = repr(old.element).partition(", constrained=")[0]
    return next(
        (
            one.ref
            for one in new.constraints
            if repr(one.element).partition(", constrained=")[0] == said
        ),
        None,
    )
