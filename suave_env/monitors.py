"""The messages of the monitors, as plain data in the shape of ROS diagnostic_msgs."""

from collections.abc import Callable
from typing import TypedDict

from suave_env.settings import Settings

EA_MEASUREMENT = "EA measurement"
"""Text of a measurement of the environment; kas-lab/suave v1.3.0."""
QA_STATUS = "QA status"
"""Text of a measurement of a quality of the vehicle; kas-lab/suave v1.3.0."""
COMPONENT_STATUS = "Component status"
"""Text of a failure or recovery of a component; kas-lab/suave v1.3.0."""
MISSION_STATUS = "mission status"
"""Text of a percept of the task layer; knowledge bases that follow ROSA ignore it."""


class Status(TypedDict):
    """One status: its source (`name`), its kind (`message`), and strings by key (`values`)."""

    name: str
    message: str
    values: dict[str, str]


class Message(TypedDict):
    """One message: the time since GUIDED [s] at which it was published, and its statuses."""

    time: float
    status: list[Status]


class Outbox:
    """Collects messages until they are fetched; calls `hear` with time [s], key and value of each."""

    def __init__(self, hear: Callable[[float, str, str], None] = lambda time, key, value: None) -> None:
        self._hear = hear
        self._messages: list[Message] = []

    @property
    def is_waiting(self) -> bool:
        return bool(self._messages)

    def publish(self, time: float, name: str, text: str, key: str, value: float | str) -> None:
        """Publish one status of a kind such as `EA_MEASUREMENT`, now [s]; a number as its `repr`, which is exact."""
        written = value if isinstance(value, str) else repr(value)
        self._messages.append({"time": time, "status": [{"name": name, "message": text, "values": {key: written}}]})
        self._hear(time, key, written)

    def fetch(self) -> list[Message]:
        """Return the messages since the last call, in order of time."""
        messages, self._messages = self._messages, []
        return messages


def thruster_words(settings: Settings, fails: bool) -> tuple[str, ...]:
    """Return the words in which a failure or a recovery is published, one message each."""
    words = ("FALSE", "ERROR") if fails else ("RECOVERED", "OK")
    return words if settings.thruster_told_twice else words[:1]
