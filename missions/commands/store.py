"""`rosa store`: show and copy the store of a knowledge base."""

from pathlib import Path
from typing import Annotated, Final

from typer import Argument, Typer, echo

from kb.store import backup_store, store_info

app: Final = Typer(
    help="Show or copy the store of a knowledge base.", no_args_is_help=True, add_completion=False
)
Source = Annotated[Path, Argument(metavar="FILE", help="The store.")]


@app.command()
def info(file: Source) -> None:
    """Check a store that is not in use, and show what is in it."""
    for title, value in store_info(file).items():
        echo(f"{title}: {value}")


@app.command()
def backup(
    file: Source,
    copy: Annotated[Path, Argument(metavar="COPY", help="A file that does not exist yet.")],
) -> None:
    """Copy a store that is not in use."""
    backup_store(file, copy)
    echo(f"{file} is copied to {copy}")
