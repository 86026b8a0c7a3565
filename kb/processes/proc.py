"""What the system tells of processes, and the mark by which those that were started here are known.

The mark is in the environment of everything that a component starts: a random text, and the number and the start of the
process that started it. A number alone says nothing, since it is given again to something else.
"""

import logging
import os
import secrets
import signal
from pathlib import Path
from typing import Final

__all__ = ["MARK", "has_ended", "is_alone", "left_over", "manner", "new_mark", "signal_group", "started"]

_log = logging.getLogger(__name__)

MARK: Final = "KB_STARTED_BY"
"""The name of the variable that holds the mark."""

_PROC: Final = Path("/proc")
_STATE, _GROUP, _STARTED = 0, 2, 19
_ENDED: Final = (b"Z", b"X")


def new_mark() -> str:
    """Return a mark for what this process starts; it tells who is who, and decides nothing."""
    return f"{secrets.token_hex(16)}.{os.getpid()}.{started(os.getpid())}"


def started(pid: int) -> int | None:
    """Return when a process was started [clock ticks since the system was], None if there is none or it has ended."""
    fields = _fields(pid)
    return None if fields is None or fields[_STATE] in _ENDED else int(fields[_STARTED])


def left_over(pid: int) -> str | None:
    """Return the mark of a process whose starter is no more; None for any other one, which is not to be touched."""
    try:
        entries = (_PROC / str(pid) / "environ").read_bytes().split(b"\0")
    except OSError:  # it has ended, or is somebody else's
        return None
    marks = [entry.partition(b"=")[2].decode() for entry in entries if entry.startswith(f"{MARK}=".encode())]
    if not marks:
        return None
    _, starter, began = marks[0].rsplit(".", 2) if marks[0].count(".") == 2 else ("", "", "")
    if not starter.isdigit() or str(started(int(starter))) == began:
        return None
    return marks[0]


def has_ended(pid: int) -> bool:
    """Tell whether a child has ended, and leave it unburied, so that its number stays its own."""
    try:
        return os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
    except ChildProcessError:
        return True


def is_alone(leader: int) -> bool:
    """Tell whether nothing else lives in the process group of a process."""
    for folder in _PROC.iterdir():
        if folder.name.isdigit() and folder.name != str(leader):
            fields = _fields(int(folder.name))
            if fields is not None and int(fields[_GROUP]) == leader and fields[_STATE] not in _ENDED:
                return False
    return True


def signal_group(leader: int, number: signal.Signals) -> None:
    """Send a signal to a process group, if it is still there."""
    try:
        os.killpg(leader, number)
    except ProcessLookupError:
        return
    except PermissionError as error:
        _log.warning("process group %d could not be sent %s: %s", leader, number.name, error)


def manner(code: int) -> str:
    """Say how a process ended, by what `subprocess` gives as its return code."""
    if code >= 0:
        return f"exit status {code}"
    try:
        return f"{signal.Signals(-code).name}"
    except ValueError:
        return f"signal {-code}"


def _fields(pid: int) -> list[bytes] | None:
    """Return what the system tells of a process, from its state on; None if there is none."""
    try:
        return (_PROC / str(pid) / "stat").read_bytes().rpartition(b")")[2].split()
    except OSError:
        return None
