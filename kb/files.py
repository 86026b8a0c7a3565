"""Model files: they are read and written completely or not at all.

And places in them, for messages.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex
from typing import Final, NamedTuple

from kb.exceptions import KnowledgeBaseError, ModelError, UnknownName

SUFFIXES: Final = (".tql", ".owl")  # of the files that models can be in


class ModelFileError(ModelError):
    """A file is not a model that can be read or written.

    Args:
        message: what stands there, and what was expected.
        file: as it was given.
        line: counted from 1; None where the file is wrong as a whole.
        column: counted from 1, in characters.
    """

    def __init__(
        self, message: str, file: str, line: int | None = None, column: int | None = None
    ) -> None:
        self.file = file
        self.line = line
        self.column = column
        super().__init__(
            f"{file}: {message}" if line is None else f"{file}:{line}:{column}: {message}"
        )


class Place(NamedTuple):
    """Where something is written."""

    file: str
    line: int
    column: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}"

    def error(self, message: str) -> ModelFileError:
        return ModelFileError(message, *self)

    @contextmanager
    def blamed(self) -> Iterator[None]:
        """Give this place to whatever the model refuses."""
        try:
            yield
        except ModelFileError:
            raise
        except KnowledgeBaseError as error:
            raise self.error(str(error)) from None


def read_text(file: Path) -> str:
    """Return the text of a model's file.

    Raises:
        ModelFileError: it cannot be read.
    """
    try:
        return file.read_text("utf-8-sig")
    except FileNotFoundError:
        beside = sorted(path.name for suffix in SUFFIXES for path in file.parent.glob(f"*{suffix}"))
        unknown = str(UnknownName("file", file.name, beside))
        message = unknown if beside else "there is no such file, and no other model in that folder"
    except (OSError, ValueError) as error:
        message = f"the file cannot be read as UTF-8: {error}"
    raise ModelFileError(message, str(file))


@contextmanager
def draft(path: Path) -> Iterator[Path]:
    """Make a new file of a random name beside a place.

    It is removed afterwards, unless it was put in that place.

    Raises:
        OSError: it cannot be made.
    """
    part = path.with_name(f".{path.name[:100]}.{token_hex(8)}.part")
    os.close(os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    try:
        yield part
    finally:
        part.unlink(missing_ok=True)


def write_file(path: Path, content: bytes) -> None:
    """Replace a file in one step, so that nothing half-written is ever found there.

    A link is followed.

    Raises:
        OSError: it cannot be written; what was there is there.
    """
    target = path.resolve()
    with draft(target) as part:
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(target)


def write_text(file: Path, text: str) -> None:
    """Replace the file of a model; see `write_file`."""
    try:
        write_file(file, text.encode())
    except OSError as error:
        why = "there is no such folder" if isinstance(error, FileNotFoundError) else error.strerror
        raise ModelFileError(f"the file cannot be written: {why}", str(file)) from None
