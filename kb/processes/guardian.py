"""Ends the processes that another process has started, when that one is no more, however it ended.

A program of its own, so that it outlives whom it watches; it imports nothing of ours and is run without site packages:
`python guardian.py MARK GRACE PARENT`. MARK is an entry "NAME=value" of the environment by which the processes are
known, wherever they have gone since; GRACE is how long they may take to end [s]; PARENT is the number of the process
that is watched. The end of its standard input counts as the parent's end.
"""

import os
import select
import signal
import sys
import time
from pathlib import Path

__all__ = ["main"]

_PERIOD_S = 0.2
_PERIOD_OF_ENDING_S = 0.02
_SURE_S = 2.0
"""Who was killed may have been about to start something: how long nothing must have turned up to be sure."""


def main(mark: str, grace: str, parent: str) -> None:
    """Wait for the parent to be no more, then end what carries the mark."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    while os.getppid() == int(parent):
        readable, _, _ = select.select([0], [], [], _PERIOD_S)
        if readable and not os.read(0, 1):
            break
    _end(mark.encode(), float(grace), 0.0 if os.getppid() == int(parent) else _SURE_S)


def _end(mark: bytes, grace: float, sure: float) -> None:
    deadline = time.monotonic() + grace
    _send(signal.SIGTERM, _carriers(mark))
    last_seen = time.monotonic()
    while (carriers := _carriers(mark)) or time.monotonic() < last_seen + sure:
        if carriers:
            last_seen = time.monotonic()
        if time.monotonic() >= deadline:
            _send(signal.SIGKILL, carriers)
        time.sleep(_PERIOD_OF_ENDING_S)


def _carriers(mark: bytes) -> list[int]:
    """Return the numbers of the processes that were started with an entry of the environment."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                entries = (folder / "environ").read_bytes().split(b"\0")
            except OSError:  # it has ended, or is somebody else's
                continue
            if mark in entries:
                found.append(int(folder.name))
    return found


def _send(number: signal.Signals, processes: list[int]) -> None:
    for process in processes:
        try:
            os.kill(process, number)
        except OSError:
            continue


if __name__ == "__main__":
    main(*sys.argv[1:])
