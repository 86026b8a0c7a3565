"""Files that a run writes: tried before the run, complete or not there at all after it."""

import os
import tempfile
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from missions.mission import MissionError

__all__ = ["OutputFile"]


class OutputFile:
    """A file that appears under its name only when it is complete; used as a context.

    Args:
        path: where it shall be; a file of that name is replaced. A device such as /dev/stdout is written directly.

    Raises:
        MissionError: it cannot be written there, found out at once.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._direct = path.exists() and not path.is_file()
        try:
            if path.is_dir():
                raise IsADirectoryError("it is a directory; name a file in it")
            if path.is_file() and not os.access(path, os.W_OK):
                raise PermissionError("the file there is read-only")
            if self._direct:
                self._file: BinaryIO = path.open("wb")
                self._draft = path
            else:
                handle, draft = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
                self._file, self._draft = os.fdopen(handle, "wb"), Path(draft)
        except OSError as error:
            raise MissionError(f"cannot write {path}: {error.strerror or error}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()
        if not self._direct:
            self._draft.unlink(missing_ok=True)

    @property
    def file(self) -> BinaryIO:
        """Where the content goes."""
        return self._file

    def write(self, text: str) -> None:
        """Append text."""
        self._file.write(text.encode())

    def keep(self) -> None:
        """Put the file, which is complete now, in its place."""
        self._file.close()
        if not self._direct:
            self._draft.chmod(0o666 & ~_umask())
            self._draft.replace(self._path)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
