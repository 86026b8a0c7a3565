"""What the sea publishes: plain data in the shape of ROS diagnostic_msgs/DiagnosticArray."""

from typing import TypedDict

__all__ = [
    "COMPONENT_STATUS",
    "EA_MEASUREMENT",
    "MISSION_STATUS",
    "Message",
    "Outbox",
    "QA_STATUS",
    "Status",
]

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
    """Collects what is published until it is fetched."""

    def __init__(self) -> None:
        self._messages: list[Message] = []

    @property
    def is_waiting(self) -> bool:
        """Whether anything was published since the last fetch."""
        return bool(self._messages)

    def publish(self, time: float, name: str, text: str, key: str, value: float | str) -> None:
        """Publish one status with one value.

        Args:
            time: Now [s].
            name: Who publishes.
            text: What kind of statement it is, such as `EA_MEASUREMENT`.
            key: What the value is of.
            value: A number, of which `repr` is published so that nothing is lost, or a string.
        """
        written = value if isinstance(value, str) else repr(value)
        self._messages.append({"time": time, "status": [{"name": name, "message": text, "values": {key: written}}]})

    def fetch(self) -> list[Message]:
        """Return what was published since the last call, in order of time."""
        messages, self._messages = self._messages, []
        return messages
