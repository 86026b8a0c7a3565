"""What the task layer has been told by the robot, beside what the knowledge base knows."""

from collections import Counter
from collections.abc import Mapping
from typing import Any, Final

__all__ = ["Percepts"]

MISSION_STATUS: Final = "mission status"


class Percepts:
    """Takes in the same messages as the knowledge base and keeps those with the text "mission status".

    The knowledge base passes these over; they say what a mission's conditions look at, e.g. that something is found.
    """

    def __init__(self) -> None:
        self._said: dict[str, str] = {}
        self._times: Counter[str] = Counter()
        self._revision = 0

    @property
    def revision(self) -> int:
        """How often something was told; while it is the same, so is all that was sensed."""
        return self._revision

    def receive(self, message: Mapping[str, Any]) -> None:
        """Take in one message: `{"time": ..., "status": [{"message": ..., "values": {...}}, ...]}`."""
        for status in message["status"]:
            if str(status["message"]).casefold() == MISSION_STATUS:
                self._revision += 1
                for key, value in status["values"].items():
                    self._said[key] = str(value)
                    self._times[key] += 1

    def holds(self, key: str) -> bool:
        """Tell whether the last word about something was "true"; what was never spoken of does not hold."""
        return self._said.get(key, "").casefold() == "true"

    def value(self, key: str) -> float | None:
        """Return the last word about something as a number; None if it is none, or nothing was said."""
        try:
            return float(self._said[key])
        except (KeyError, ValueError):
            return None

    def count(self, key: str) -> int:
        """How often something was spoken of."""
        return self._times[key]
