"""`rosa store`: show and copy the store of a knowledge base."""

from pathlib import Path
from typing import Annotated, Final

import typer

from kb.store import backup_store, store_info

app: Final = typer.Typer(
    help="Look after the store of a knowledge base.", no_args_is_help=True, add_completion=False
)
File = Annotated[Path, typer.Argument(metavar="FILE", help="The store.")]


@app.command()
def info(file: File) -> None:
    """Show what is in a store that is not in use; it is checked, too."""
    for title, value in store_info(file).items():
        typer.echo(f"{title}: {value}")


@app.command()
def backup(
    file: File,
    copy: Annotated[Path, typer.Argument(metavar="COPY", help="A file that is not there yet.")],
) -> None:
    """Copy a store that is not in use."""
    backup_store(file, copy)
    typer.echo(f"{file} is copied to {copy}")
