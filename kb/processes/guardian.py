"""The guardian: a program that ends the processes of components when the process that started them is no more.

It finds them by a mark in their environment, which everything that a component starts inherits: a random text, and the
pid and the start time of the process that started the component. A pid alone is not enough, since it is used again.

The guardian is a program of its own, so that it outlives the process that it watches; it imports nothing of ours and
runs without site packages: `python guardian.py MARK GRACE PARENT`. GRACE is how long marked processes may take to end
[s]; PARENT is the pid of the watched process. The end of the guardian's standard input counts as the parent's end.
"""

import os
import select
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Final

MARK: Final = "KB_STARTED_BY"
"""The name of the variable that holds the mark."""

_PROC: Final = Path("/proc")
_STATE, _GROUP, _STARTED = 0, 2, 19
_ENDED: Final = (b"Z", b"X")
_SURE_S: Final = 2.0
"""How long no marked process may appear before the guardian ends [s]: a killed parent may just have started one."""


def new_mark() -> str:
    """Return a new mark for what this process starts."""
    return f"{os.urandom(16).hex()}.{os.getpid()}.{started(os.getpid())}"


def started(pid: int) -> int | None:
    """Return when a process was started [clock ticks since boot]; None if there is none or it has ended."""
    fields = _fields(pid)
    return None if not fields or fields[_STATE] in _ENDED else int(fields[_STARTED])


def left_over(pid: int) -> str | None:
    """Return the mark of a process whose starter is no more; None for any other process, which must be left alone."""
    begin = f"{MARK}=".encode()
    marks = [
        entry.removeprefix(begin).decode() for entry in _environment(pid) if entry.startswith(begin)
    ]
    if not marks or marks[0].count(".") != 2:
        return None
    _, starter, began = marks[0].split(".")
    return None if not starter.isdigit() or str(started(int(starter))) == began else marks[0]


def has_others(leader: int) -> bool:
    """Return whether the process group of a process has other living members."""
    others = (_fields(pid) for pid in _pids() if pid != leader)
    return any(one and int(one[_GROUP]) == leader and one[_STATE] not in _ENDED for one in others)


def main(mark: str, grace: str, parent: str) -> None:
    """Wait until the parent has ended, then end all processes with the mark."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    while os.getppid() == int(parent):
        readable, _, _ = select.select([0], [], [], 0.2)
        if readable and not os.read(0, 1):
            break
    _end(mark, float(grace), 0.0 if os.getppid() == int(parent) else _SURE_S)


def _end(mark: str, grace: float, sure: float) -> None:
    """End all processes with a mark, kill them after a grace [s]; return when none was seen for `sure` [s]."""
    deadline = time.monotonic() + grace
    _send(signal.SIGTERM, _carriers(mark))
    last_seen = time.monotonic()
    while (carriers := _carriers(mark)) or time.monotonic() < last_seen + sure:
        if carriers:
            last_seen = time.monotonic()
        if time.monotonic() >= deadline:
            _send(signal.SIGKILL, carriers)
        time.sleep(0.02)


def _carriers(mark: str) -> list[int]:
    entry = f"{MARK}={mark}".encode()
    return [pid for pid in _pids() if entry in _environment(pid)]


def _send(number: signal.Signals, processes: list[int]) -> None:
    for process in processes:
        with suppress(OSError):
            os.kill(process, number)


def _pids() -> list[int]:
    return [int(folder.name) for folder in _PROC.iterdir() if folder.name.isdigit()]


def _environment(pid: int) -> list[bytes]:
    return _read(pid, "environ").split(b"\0")


def _fields(pid: int) -> list[bytes]:
    """Return the fields of /proc/PID/stat from the state on; none if there is no such process."""
    return _read(pid, "stat").rpartition(b")")[2].split()


def _read(pid: int, file: str) -> bytes:
    """Return a file of /proc/PID; empty if the process has ended or belongs to another user."""
    try:
        return (_PROC / str(pid) / file).read_bytes()
    except OSError:
        return b""


if __name__ == "__main__":
    main(*sys.argv[1:])
