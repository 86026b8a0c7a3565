"""Diagnostics as a file, one message per line as JSON: written during a run, read for a replay."""

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict
from math import inf
from pathlib import Path
from typing import Any

from missions.engine.percepts import Message, check_message
from missions.engine.runner import Listener, MissionRun
from missions.engine.settings import MissionError


def line_of(message: Message) -> str:
    plain = {**message, "time": float(message["time"])}
    return json.dumps(plain, separators=(",", ":"), sort_keys=True, default=str) + "\n"


def header(run: MissionRun, seed: int) -> Message:
    """Return the first message of a recording, which says how the mission was run."""
    about = {
        "mission": run.mission.name,
        "task": run.task,
        "seed": seed,
        "settings": asdict(run.settings),
        "switching_s": dict(getattr(run.world.managed, "takes", {})),
    }
    return {"time": 0.0, "status": [], "run": about}


class LineRecorder(Listener):
    """Writes a header and then each message of an open run, one per line."""

    def __init__(self, run: MissionRun, seed: int, write: Callable[[str], object]) -> None:
        self._write = write
        self.message(header(run, seed))
        run.listen(self)

    def message(self, message: Message) -> None:
        self._write(line_of(message))


def read_recording(source: str | Path | Iterable[Message]) -> Iterator[Message]:
    """Yield the messages of a recording in order of time.

    Args:
        source: a file, or the messages themselves.

    Raises:
        MissionError: the file cannot be read, or a line is no message; names the line and what was
            expected.
    """
    last = -inf
    for where, message in _numbered(source):
        check_message(message, where)
        if message["time"] < last:
            order = f"time {message['time']} comes after {last}; order them by time"
            raise MissionError(f"{where}: {order}")
        last = message["time"]
        yield message


def _numbered(source: str | Path | Iterable[Message]) -> Iterator[tuple[str, Any]]:
    """Yield each message with its place in the source."""
    if not isinstance(source, str | Path):
        for number, message in enumerate(source, start=1):
            yield f"message {number}", message
        return
    try:
        lines = Path(source).read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        advice = "a recording has a JSON message in each line, or a name that ends in .mcap"
        raise MissionError(f"cannot read the recording {source}: {reason}; {advice}") from None
    for number, line in enumerate(lines, start=1):
        try:
            if line.strip():
                yield f"{source}:{number}", json.loads(line)
        except json.JSONDecodeError as error:
            problem = f"not JSON ({error.msg}); one message per line is expected"
            raise MissionError(f"{source}:{number}:{error.colno}: {problem}") from None
