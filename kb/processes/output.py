"""What the process of a component writes: in a file that does not grow beyond a limit, its last lines at hand."""

import logging
import os
import select
from pathlib import Path
from threading import Lock, Thread
from typing import Final

MOST: Final = 1 << 20
"""How much is kept of each component [bytes], in two files: what is written now, and what was before it."""

_log = logging.getLogger(__name__)
_CHUNK: Final = 1 << 16
_TAIL: Final = 2000
_LINES, _WIDTH = 3, 160


class Output:
    """Keeps what is written, in FILE, and what was written before that in FILE.1; nobody else may read them.

    Args:
        path: FILE; it is made, never followed elsewhere nor written on.
        most: how much is kept [bytes].
    """

    def __init__(self, path: Path, most: int = MOST) -> None:
        self.path, self._half = path, max(1, most // 2)
        self._lock = Lock()
        self._source = self._file = -1
        self._size, self._tail = 0, b""

    def follow(self, source: int) -> None:
        """Read from a pipe until all who can write to it are gone, in a thread of its own; it is closed then."""
        os.set_blocking(source, False)
        self._source, self._tail = source, b""
        Thread(target=self._follow, args=(source,), name=f"output to {self.path.name}", daemon=True).start()

    def last_lines(self) -> str:
        """Return the last lines in one, after all was read that an ended process has written; empty if nothing was."""
        for _ in range(2 * MOST // _CHUNK):
            if not self._take(self._source):
                break
        text = self._tail.decode("utf-8", "replace")
        lines = ["".join(one for one in line if one.isprintable()).strip()[:_WIDTH] for line in text.splitlines()]
        return " | ".join([line for line in lines if line][-_LINES:])

    def _follow(self, source: int) -> None:
        readable = select.poll()
        readable.register(source, select.POLLIN)
        is_open = True
        while is_open:
            readable.poll()
            is_open = self._take(source) or self._source == source
        with self._lock:
            os.close(source)

    def _take(self, source: int) -> bool:
        """Read what there is; returns whether there was something. At the end nothing is followed any more."""
        with self._lock:
            if source < 0 or source != self._source:
                return False
            try:
                data = os.read(source, _CHUNK)
            except BlockingIOError:
                return False
            if not data:
                self._source = -1
                return False
            self._tail = (self._tail + data)[-_TAIL:]
            try:
                self._write(data)
            except OSError as error:  # a full disk stops nobody
                _log.warning("what goes to %s is lost: %s", self.path, error.strerror)
            return True

    def _write(self, data: bytes) -> None:
        while data:
            if self._file < 0 or self._size >= self._half:
                if self._file >= 0:
                    os.close(self._file)
                    self._file = -1
                if self.path.is_symlink() or self.path.exists():
                    self.path.replace(f"{self.path}.1")
                how = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
                self._file, self._size = os.open(self.path, how, 0o600), 0
            written = os.write(self._file, data[: self._half - self._size])
            self._size, data = self._size + written, data[written:]

    def close(self) -> None:
        with self._lock:
            if self._file >= 0:
                os.close(self._file)
                self._file = -1
