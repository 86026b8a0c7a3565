"""A stream of diagnostics as a file: one message per line, as JSON, with its time; written live, read for a replay."""

import json
from collections.abc import Iterator
from pathlib import Path

from missions.mission import Message, MissionError

__all__ = ["line_of", "read_recording"]


def line_of(message: Message) -> str:
    """Return a message as one line of a recording."""
    return json.dumps(message, separators=(",", ":"), sort_keys=True) + "\n"


def read_recording(path: str | Path) -> Iterator[Message]:
    """Yield the messages of a recording in order of time.

    Raises:
        MissionError: the file cannot be read, or a line is no message; names the line and what was expected.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
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
    if not isinstance(message, dict) or type(message.get("time")) not in (int, float):
        raise MissionError(f'{where}: a message is an object with a number "time" [s] and a list "status"')
    statuses = message.get("status")
    if not isinstance(statuses, list) or not all(
        isinstance(one, dict) and isinstance(one.get("message"), str) and isinstance(one.get("values"), dict)
        for one in statuses
    ):
        raise MissionError(f'{where}: each "status" is an object with a text "message" and an object "values"')
    return message
