"""Model files: they are read and written completely or not at all.

And places in them, for messages.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from secrets import token_hex
from typing import Final, NamedTuple

from kb.exceptions import DuplicateName, KnowledgeBaseError, ModelError, UnknownName

SUFFIXES: Final = (".tql", ".owl")  # of the files that models can be in
MOST: Final = 256 << 20  # the largest file that is read [bytes]
_MARK: Final = "\ufeff"  # what some editors put before everything else


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


class DuplicateInFile(ModelFileError, DuplicateName):
    """A name is given twice within one kind of element."""


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
        except DuplicateName as error:
            raise DuplicateInFile(str(error), *self) from None
        except KnowledgeBaseError as error:
            raise self.error(str(error)) from None


def read_text(file: Path) -> str:
    try:
        if file.stat().st_size > MOST:
            message = f"this is larger than {MOST >> 20} MB, more than any model; give it in parts"
            raise ModelFileError(message, str(file))
        content = file.read_bytes()
    except FileNotFoundError:
        beside = sorted(path.name for suffix in SUFFIXES for path in file.parent.glob(f"*{suffix}"))
        none = "there is no such file, and no other model in that folder"
        raise ModelFileError(
            str(UnknownName("file", file.name, beside)) if beside else none, str(file)
        ) from None
    except IsADirectoryError:
        raise ModelFileError("this is a folder; give the model file in it", str(file)) from None
    except (OSError, ValueError) as error:
        raise ModelFileError(f"the file cannot be read: {error}", str(file)) from None
    try:
        return content.decode("utf-8").removeprefix(_MARK)
    except UnicodeDecodeError as error:
        before = content[: error.start].decode("utf-8").removeprefix(_MARK)
        column = len(before[before.rfind("\n") + 1 :]) + 1
        message = f"byte {content[error.start]:#04x} at offset {error.start} is not UTF-8; "
        message += "the file may be Latin-1, Windows-1252 or UTF-16: save it as UTF-8"
        raise ModelFileError(message, str(file), before.count("\n") + 1, column) from None


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
        with suppress(FileNotFoundError):
            part.chmod(target.stat().st_mode & 0o777)
        part.replace(target)


def write_text(file: Path, text: str) -> None:
    """Replace the file of a model; see `write_file`."""
    try:
        write_file(file, text.encode())
    except OSError as error:
        why = "there is no such folder" if isinstance(error, FileNotFoundError) else error.strerror
        raise ModelFileError(f"the file cannot be written: {why}", str(file)) from None
