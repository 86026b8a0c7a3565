"""Diagnostics as they travel, and the percepts among them, which only the task layer looks at.

A short stream for a test is written by hand:

    [measured(0.5, water_visibility=3.75), failed(35.5, "c_thruster_1"), sensed(100.0, found=True)]
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from math import inf
from typing import Any, Final

from missions.engine.settings import MissionError

Message = Mapping[str, Any]
"""`{"time": s, "status": [{"name": ..., "message": ..., "values": {...}}, ...]}`."""

MISSION_STATUS: Final = "mission status"


def check_message(message: Any, source: str) -> None:  # noqa: ANN401  # anything, until it is checked
    """Check the form of a message; raise MissionError, which names the source, if it is wrong."""
    try:
        texts: list[Any] = []
        for status in message["status"]:
            texts += [status["message"], *status["values"].keys()]
        is_fit = 0 <= message["time"] < inf and all(isinstance(text, str) for text in texts)
    except (AttributeError, LookupError, TypeError):
        is_fit = False
    if not is_fit:
        raise MissionError(
            f'{source}: a message is an object with a number "time" [s] from 0 and a list "status" '
            f'of objects, each with a text "message" and an object "values", not {message!r:.100}'
        )


def measured(time: float, **values: float) -> Message:
    """Return a message that attributes were measured; values in the attributes' units."""
    texts = {name: repr(value) for name, value in values.items()}
    return _message(time, "attribute measurement", texts)


def failed(time: float, *components: str) -> Message:
    """Return a message that components have failed."""
    return _message(time, "component status", dict.fromkeys(components, "failure"))


def recovered(time: float, *components: str) -> Message:
    """Return a message that components have recovered."""
    return _message(time, "component status", dict.fromkeys(components, "recovered"))


def sensed(time: float, **news: object) -> Message:
    """Return a message for the percepts only, e.g. pipeline_found=True."""
    return _message(
        time, MISSION_STATUS, {name: str(value).lower() for name, value in news.items()}
    )


def _message(time: float, kind: str, values: dict[str, str]) -> Message:
    status = {"name": "by hand", "message": kind, "values": values}
    return {"time": float(time), "status": [status]}


class Percepts:
    """Receives the same messages as the knowledge base, and stores those of "mission status".

    The knowledge base ignores these; a mission's conditions look at them.

    Attributes:
        revision: how many such statuses were received; while it stays the same, so do all values.
    """

    def __init__(self) -> None:
        self._values: dict[str, str] = {}
        self._counts: Counter[str] = Counter()
        self.revision = 0

    def receive(self, message: Message) -> Sequence[str]:
        """Receive a message; return the keys that hold now and did not before, or vice versa."""
        before: dict[str, bool] = {}
        for status in message["status"]:
            if str(status["message"]).casefold() == MISSION_STATUS:
                self.revision += 1
                for key, value in status["values"].items():
                    before.setdefault(key, self.holds(key))
                    self._values[key] = str(value)
                    self._counts[key] += 1
        return [key for key, held_before in before.items() if self.holds(key) is not held_before]

    def holds(self, key: str) -> bool:
        """Return whether the last value of a key was "true"; False if it was never received."""
        return self._values.get(key, "").casefold() == "true"

    def value(self, key: str) -> float | None:
        """Return the last value of a key as a number; None if it is no number or is missing."""
        try:
            return float(self._values[key])
        except (KeyError, ValueError):
            return None

    def count(self, key: str) -> int:
        """Return how often a key was received."""
        return self._counts[key]
