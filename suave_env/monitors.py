"""What the monitors publish of the truth, as plain data in the shape of ROS diagnostic_msgs."""

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
"""Text of what the task layer senses; knowledge bases that follow ROSA pass over it."""


class Status(TypedDict):
    """One status: who says it (`name`), what kind of statement it is (`message`), and strings by key (`values`)."""

    name: str
    message: str
    values: dict[str, str]


class Message(TypedDict):
    """One message: the time since GUIDED [s] at which it was published, and its statuses."""

    time: float
    status: list[Status]


class Outbox:
    """Collects what is published until it is fetched; `hear` is called with time [s], key and value of each."""

    def __init__(self, hear: Callable[[float, str, str], None] = lambda time, key, value: None) -> None:
        self._hear = hear
        self._messages: list[Message] = []

    @property
    def is_waiting(self) -> bool:
        return bool(self._messages)

    def publish(self, time: float, name: str, text: str, key: str, value: float | str) -> None:
        """Publish one status of a kind such as `EA_MEASUREMENT`, now [s]; of a number its `repr`: nothing is lost."""
        written = value if isinstance(value, str) else repr(value)
        self._messages.append({"time": time, "status": [{"name": name, "message": text, "values": {key: written}}]})
        self._hear(time, key, written)

    def fetch(self) -> list[Message]:
        """Return what was published since the last call, in order of time."""
        messages, self._messages = self._messages, []
        return messages


def thruster_words(settings: Settings, fails: bool) -> tuple[str, ...]:
    """Return the words in which a failure or a recovery is published, one message each."""
    words = ("FALSE", "ERROR") if fails else ("RECOVERED", "OK")
    return words if settings.thruster_told_twice else words[:1]
