"""`rosa store`: what is in the store of a knowledge base, whether it is sound, copies of it, and its model."""

import json
from pathlib import Path
from typing import Annotated, Final

import typer

from missions.commands import FAILED, complain
from missions.commands.check import model_of
from missions.engine import stores
from missions.engine.registry import find_mission

app: Final = typer.Typer(help="Look after the store of a knowledge base.", no_args_is_help=True, add_completion=False)
File = Annotated[Path, typer.Argument(metavar="FILE", help="The store.")]
New = Annotated[Path, typer.Argument(metavar="NEW", help="A file that is not there yet.")]


@app.command()
def info(file: File, as_json: Annotated[bool, typer.Option("--json", help="Print it as JSON.")] = False) -> None:
    """Say what is in a store, also while it is written to; exit with 1 if it is damaged."""
    with stores.surveyed(file) as (connection, found):
        names = [one for one in json.loads(found.declared or "[]") if one[0] == "RobotModel"]
        shown: dict[str, object] = {
            "store": str(file),
            "model": names[0][2]["name"][0] if names else None,
            "last sound event": found.last,
            "last acknowledged event": found.acknowledged,
            "state": "in use, or not closed" if found.is_open else "closed",
            "damage": found.problem or None,
        }
        if not found.problem:
            counts = connection.execute("SELECT verb, COUNT(*) FROM events GROUP BY verb ORDER BY verb")
            shown["events kept"] = dict(counts.fetchall())
            asked = "SELECT MIN(time), MAX(time) FROM events"
            ((shown["first time [s]"], shown["last time [s]"]),) = connection.execute(asked)
    if as_json:
        typer.echo(json.dumps(shown, indent=2))
    else:
        for name, value in shown.items():
            typer.echo(f"{name}: {json.dumps(value) if isinstance(value, dict) else value}")
    if found.problem:
        raise typer.Exit(FAILED)


@app.command()
def check(file: File) -> None:
    """Check every record of a store, also while it is written to; exit with 1 if it is damaged."""
    with stores.surveyed(file) as (connection, found):
        if found.problem:
            complain(str(found.error(file)))
            raise typer.Exit(FAILED)
        ((count,),) = connection.execute("SELECT COUNT(*) FROM events")
    typer.echo(f"{file}: sound up to event {found.last}; {count} events are kept, and all acknowledged ones were seen")


@app.command()
def backup(file: File, new: New) -> None:
    """Copy a store to a new file as it is at this moment, also while it is written to."""
    found = stores.backup(file, new)
    typer.echo(f"{new}: a copy of {file} up to event {found.last}")


@app.command()
def repair(file: File, new: New) -> None:
    """Write what is sound of a damaged store to a new file; the damaged one is left as it is."""
    found = stores.repair(file, new)
    typer.echo(f"{new}: {file} up to event {found.last}; {found.missing} acknowledged events after it are missing")
    typer.echo(f"what was wrong: {found.problem}" if found.problem else "nothing was wrong")


@app.command()
def migrate(
    file: File,
    model: Annotated[list[Path] | None, typer.Argument(metavar="MODEL...", help="Files of the model.")] = None,
    mission: Annotated[str | None, typer.Option(help="The model of a mission instead.")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only say what would change.")] = False,
) -> None:
    """Have a store go on with a model that has changed: say what came, went and changed, and what is dropped."""
    given = model_of(model or [], find_mission(mission) if mission else None)
    found = stores.migrate(file, given, dry_run=dry_run)
    for words in found.differences:
        typer.echo(words)
    for words in found.dropped:
        typer.echo(f"dropped: {words}")
    if not found.differences:
        typer.echo(f"{file}: the model is that of the store; nothing is changed")
    else:
        typer.echo(f"{file}: {'nothing is changed yet' if dry_run else 'the store is of that model now'}")
