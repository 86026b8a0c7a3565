"""What the process of a component writes: in a file that does not grow beyond a limit, its last lines at hand."""

import logging
import os
from contextlib import suppress
from io import FileIO
from pathlib import Path
from select import POLLIN, poll
from threading import Lock, Thread
from typing import IO, Final

MOST: Final = 1 << 20
"""How much is kept of each component [bytes], in two files: what is written now, and what was before it."""

_log = logging.getLogger(__name__)
_CHUNK, _TAIL = 1 << 16, 2000
_LINES, _WIDTH = 3, 160


class Output:
    """Keeps what is written, in FILE, and what was written before that in FILE.1; nobody else may read them.

    Args:
        path: FILE; it is made, never followed elsewhere nor written on.
        most: how much is kept [bytes].
    """

    def __init__(self, path: Path, most: int = MOST) -> None:
        self.path, self._half = path, max(1, most // 2)
        self._source: IO[bytes] | None = None
        self._reading = Lock()
        self._size, self._tail = 0, b""

    def follow(self, source: IO[bytes]) -> None:
        """Read from a pipe until all who can write to it are gone, in a thread of its own; it is closed then."""
        os.set_blocking(source.fileno(), False)
        self._source, self._tail = source, b""
        Thread(target=self._follow, args=(source,), name=f"output to {self.path.name}", daemon=True).start()

    def catch_up(self) -> None:
        """Take in all that an ended process has written, which the pipe holds; others may write to it for ever."""
        if self._source is not None:
            self._read(self._source)

    def last_lines(self) -> str:
        """Return the last lines in one, all that an ended process has written; empty if nothing was."""
        self.catch_up()
        text = self._tail.decode("utf-8", "replace")
        lines = ["".join(one for one in line if one.isprintable()).strip()[:_WIDTH] for line in text.splitlines()]
        return " | ".join([line for line in lines if line][-_LINES:])

    def _follow(self, source: IO[bytes]) -> None:
        written = poll()
        written.register(source, POLLIN)
        while self._read(source):
            written.poll()
        with self._reading:
            source.close()  # by nobody else, for it is this thread that waits for it

    def _read(self, source: IO[bytes]) -> bool:
        """Take in what is there, at most as much as a pipe holds; returns whether more may come."""
        with self._reading:
            left = _CHUNK
            while left > 0 and not source.closed:
                data = source.read(min(left, self._half))
                if not data:
                    return data is None
                left -= len(data)
                self._keep(data)
            return not source.closed

    def _keep(self, data: bytes) -> None:
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
