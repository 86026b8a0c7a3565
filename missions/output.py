"""Files that a run writes: tried before the run, complete or not there at all after it."""

import os
import tempfile
from contextlib import suppress
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
        try:
            self._target = path.resolve()  # a link is followed, not replaced
            self._direct = self._target.exists() and not self._target.is_file()
            if self._target.is_dir():
                raise IsADirectoryError("it is a directory; name a file in it")
            if self._target.is_file() and not os.access(self._target, os.W_OK):
                raise PermissionError("the file there is read-only")
            if self._direct:
                self._file: BinaryIO = self._target.open("wb")
                self._draft = self._target
            else:
                handle, draft = tempfile.mkstemp(prefix=".rosa-", dir=self._target.parent)
                self._file, self._draft = os.fdopen(handle, "wb"), Path(draft)
        except OSError as error:
            raise self._failure(error) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with suppress(OSError):  # what could not be written is told by keep
            self._file.close()
        if not self._direct:
            self._draft.unlink(missing_ok=True)

    def write(self, content: str | bytes) -> None:
        """Append text or bytes.

        Raises:
            MissionError: there is no room for it.
        """
        try:
            self._file.write(content.encode() if isinstance(content, str) else content)
        except OSError as error:
            raise self._failure(error) from error

    def keep(self) -> None:
        """Put the file, which is complete now, in its place.

        Raises:
            MissionError: that cannot be done.
        """
        try:
            self._file.close()
            if not self._direct:
                self._draft.chmod(0o666 & ~_umask())
                self._draft.replace(self._target)
        except OSError as error:
            raise self._failure(error) from error

    def _failure(self, error: OSError) -> MissionError:
        return MissionError(f"cannot write {self._path}: {error.strerror or error}")


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
