"""What the process of a component writes: in a file that does not grow beyond a limit, its last lines at hand."""

import logging
import os
from contextlib import suppress
from io import FileIO
from pathlib import Path
from threading import Thread
from typing import IO, Final

MOST: Final = 1 << 20
"""How much is kept of each component [bytes], in two files: what is written now, and what was before it."""

_log = logging.getLogger(__name__)
_CHUNK, _TAIL = 1 << 16, 2000
_LINES, _WIDTH = 3, 160
_BEHIND: Final = 0.5
"""How long it is waited [s] for what an ended process has written; only who left its group can keep that back."""


class Output:
    """Keeps what is written, in FILE, and what was written before that in FILE.1; nobody else may read them.

    Args:
        path: FILE; it is made, never followed elsewhere nor written on.
        most: how much is kept [bytes].
    """

    def __init__(self, path: Path, most: int = MOST) -> None:
        self.path, self._half = path, max(1, most // 2)
        self._reader = Thread()
        self._size, self._tail = 0, b""

    def follow(self, source: IO[bytes]) -> None:
        """Read from a pipe until all who can write to it are gone, in a thread of its own; it is closed then."""
        self._tail = b""
        self._reader = Thread(target=self._follow, args=(source,), name=f"output to {self.path.name}", daemon=True)
        self._reader.start()

    def catch_up(self) -> None:
        """Wait until all was read that an ended process has written."""
        if self._reader.is_alive():
            self._reader.join(_BEHIND)

    def last_lines(self) -> str:
        """Return the last lines in one, all that an ended process has written; empty if nothing was."""
        self.catch_up()
        text = self._tail.decode("utf-8", "replace")
        lines = ["".join(one for one in line if one.isprintable()).strip()[:_WIDTH] for line in text.splitlines()]
        return " | ".join([line for line in lines if line][-_LINES:])

    def _follow(self, source: IO[bytes]) -> None:
        with source:
            while data := source.read(min(_CHUNK, self._half)):
                self._tail = (self._tail + data)[-_TAIL:]
                try:
                    self._write(data)
                except OSError as error:  # a full disk stops nobody
                    _log.warning("what goes to %s is lost: %s", self.path, error.strerror)

    def _write(self, data: bytes) -> None:
        if not 0 < self._size <= self._half - len(data):
            with suppress(FileNotFoundError):
                self.path.replace(f"{self.path}.1")
            self._size = 0
        with FileIO(self.path, "a" if self._size else "x", opener=_opened) as file:
            self._size += file.write(data)


def _opened(path: str, how: int) -> int:
    return os.open(path, how | os.O_NOFOLLOW, 0o600)
