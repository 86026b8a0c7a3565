"""Diagnostics as a file, one message per line as JSON with its time: written during a run, read for a replay.

A short stream for a test is written by hand, in Python:

    [measured(0.5, water_visibility=3.75), failed(35.5, "c_thruster_1"), sensed(100.0, pipeline_found=True)]
"""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict
from numbers import Real
from pathlib import Path
from typing import Any

from missions.engine.mission import Message, MissionError, check_message
from missions.engine.runner import Listener, MissionRun


def line_of(message: Message) -> str:
    return json.dumps(message, separators=(",", ":"), sort_keys=True, default=_plain) + "\n"


def _plain(value: object) -> float | str | dict[Any, Any]:
    """Return what JSON writes for a value of no type of its own: a number of numpy, another mapping, else its text."""
    return (
        float(value)
        if isinstance(value, Real)
        else dict(value)
        if isinstance(value, Mapping)
        else str(value)
    )


def header(run: MissionRun, seed: int) -> Message:
    """Return the first message of a recording: it has no status, but says how the mission was run, for the replay."""
    about = {
        "mission": run.mission.name,
        "task": run.task,
        "seed": seed,
        "settings": asdict(run.settings),
        "switching_s": dict(getattr(run.world.managed, "takes", {})),
    }
    if run.faults is not None:
        about["faults"] = [str(fault) for fault in run.faults.planned]
    return {"time": 0.0, "status": [], "run": about}


class LineRecorder(Listener):
    """Writes a header and then each message of an open run, one per line."""

    def __init__(self, run: MissionRun, seed: int, write: Callable[[str], object]) -> None:
        self._write = write
        self.message(header(run, seed))
        run.listen(self)

    def message(self, message: Message) -> None:
        self._write(line_of(message))


def measured(time: float, **values: float) -> Message:
    """Return a message that attributes were measured at this time [s]; values by name, in the attributes' units."""
    return _said(
        time, "attribute measurement", {name: repr(value) for name, value in values.items()}
    )


def failed(time: float, *components: str) -> Message:
    """Return a message that components have failed at this time [s]."""
    return _said(time, "component status", dict.fromkeys(components, "failure"))


def recovered(time: float, *components: str) -> Message:
    """Return a message that components have recovered at this time [s]."""
    return _said(time, "component status", dict.fromkeys(components, "recovered"))


def sensed(time: float, **news: object) -> Message:
    """Return a message for the percepts only, at this time [s], e.g. pipeline_found=True."""
    return _said(time, "mission status", {name: str(value).lower() for name, value in news.items()})


def read_recording(source: str | Path | Iterable[Message]) -> Iterator[Message]:
    """Yield the messages of a recording in order of time.

    Args:
        source: a file, or the messages themselves.

    Raises:
        MissionError: the file cannot be read, or a line is no message; names the line and what was expected.
    """
    last = -math.inf
    if isinstance(source, str | Path):
        found = _lines_of(source)
    else:
        found = ((f"message {number}", message) for number, message in enumerate(source, start=1))
    for where, message in found:
        check_message(message, where)
        run = message.get("run", {})
        parts = (
            [run.get(one, {}) for one in ("settings", "switching_s")]
            if isinstance(run, dict)
            else [None]
        )
        if not all(isinstance(one, dict) for one in parts):
            wanted = 'an object with objects "settings" and "switching_s"'
            raise MissionError(f'{where}: "run" says how it was run: {wanted}')
        if message["time"] < last:
            raise MissionError(
                f"{where}: time {message['time']} comes after {last}; order them by time"
            )
        last = message["time"]
        yield message


def _said(time: float, what: str, values: dict[str, str]) -> Message:
    return {"time": float(time), "status": [{"name": "by hand", "message": what, "values": values}]}


def _lines_of(path: str | Path) -> Iterator[tuple[str, Any]]:
    try:
        lines = Path(path).read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise MissionError(
            f"cannot read the recording {path}: {getattr(error, 'strerror', None) or error}"
        ) from None
    for number, line in enumerate(lines, start=1):
        where = f"{path}:{number}"
        try:
            if line.strip():
                yield where, json.loads(line)
        except json.JSONDecodeError as error:
            said = f"not JSON ({error.msg}); one message per line is expected"
            raise MissionError(f"{where}:{error.colno}: {said}") from None
