"""Files that a run writes: tried before the run, complete or not there at all after it."""

import os
import tempfile
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from missions.engine.mission import MissionError

__all__ = ["OutputFile", "open_files"]


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
            self._direct = path.exists() and not path.is_file()
            # a link is followed, not replaced; that to a pipe leads to no path
            self._target = path if self._direct else path.resolve()
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


def open_files(paths: Mapping[str, Path], stack: ExitStack) -> dict[str, OutputFile]:
    """Open every file that is asked for, so that one that cannot be written is found out before the work begins.

    Args:
        paths: where, by the name of the option.
        stack: closes them.

    Raises:
        MissionError: one cannot be written, or two are the same.
    """
    places: dict[str, str] = {}
    for name, path in paths.items():
        other = places.setdefault(os.path.realpath(path), name)
        if other != name and not (path.is_char_device() or path.is_fifo()):
            raise MissionError(f"--{other} and --{name} name the same file, {path}; give each its own")
    return {name: stack.enter_context(OutputFile(path)) for name, path in paths.items()}


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
