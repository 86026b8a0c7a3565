"""A stream of diagnostics as a file: one message per line, as JSON, with its time; written live, read for a replay."""

import json
import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from missions.mission import Message, MissionError
from missions.runner import MissionRun

__all__ = ["header", "line_of", "read_recording"]


def line_of(message: Message) -> str:
    """Return a message as one line of a recording."""
    return json.dumps(message, separators=(",", ":"), sort_keys=True) + "\n"


def header(run: MissionRun, seed: int) -> Message:
    """Return the first message of a recording: nothing heard yet, but how the mission was run, for its replay."""
    return {
        "time": 0.0,
        "status": [],
        "run": {
            "mission": run.mission.name,
            "task": run.task,
            "seed": seed,
            "settings": asdict(run.settings),
            "switching_s": dict(run.world.switching_s()),
        },
    }


def read_recording(path: str | Path) -> Iterator[Message]:
    """Yield the messages of a recording in order of time.

    Raises:
        MissionError: the file cannot be read, or a line is no message; names the line and what was expected.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise MissionError(f"cannot read the recording {path}: {error}") from error
    last = float("-inf")
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        message = _message(line, f"{path}:{number}")
        if message["time"] < last:
            raise MissionError(f"{path}:{number}: time {message['time']} comes after {last}; order the lines by time")
        last = message["time"]
        yield message


def _message(line: str, where: str) -> Message:
    try:
        message = json.loads(line)
    except json.JSONDecodeError as error:
        raise MissionError(f"{where}:{error.colno}: not JSON ({error.msg}); one message per line is expected") from None
    if not isinstance(message, dict) or not _is_time(message.get("time")):
        raise MissionError(f'{where}: a message is an object with a number "time" [s] from 0 and a list "status"')
    statuses = message.get("status")
    if not isinstance(statuses, list) or not all(
        isinstance(one, dict) and isinstance(one.get("message"), str) and isinstance(one.get("values"), dict)
        for one in statuses
    ):
        raise MissionError(f'{where}: each "status" is an object with a text "message" and an object "values"')
    return message


def _is_time(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value < math.inf
