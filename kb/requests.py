"""Actions that a mission asks for: the answer to a request, and the record of what was required."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from kb.exceptions import InvalidValue

__all__ = ["Reply", "RequiredAction", "check_result"]

RESULTS: Final = ("completed", "failed", "abandoned")


class Reply(NamedTuple):
    """The answer to a request; true if it was accepted.

    Attributes:
        accepted: whether the action is required now.
        reason: why it was refused; what was accepted otherwise.
    """

    accepted: bool
    reason: str

    def __bool__(self) -> bool:
        return self.accepted


@dataclass(frozen=True, slots=True, eq=False)
class RequiredAction:
    """An action that a mission asked for, from when, and how it ended; only the knowledge base can end it.

    Attributes:
        action: its name.
        preference: name of the attribute preferred when a configuration is chosen for it, or the weight of each of
            several by name, or None.
        start: when it was requested [s].
        end: when it ended [s], None while it is open.
        result: "completed", "failed" or "abandoned", None while it is open.
        reason: why it ended so, in words, where that was told.
        cause: number of the event that led to the request, as far as that is known.
    """

    action: str
    preference: str | Mapping[str, float] | None
    start: float
    end: float | None = None
    result: str | None = None
    reason: str = ""
    cause: int | None = None

    def __repr__(self) -> str:
        return f"<RequiredAction {self.action!r} ({self.result or 'open'})>"

    def _finish(self, result: str, end: float, reason: str) -> None:
        object.__setattr__(self, "end", end)
        object.__setattr__(self, "result", result)
        object.__setattr__(self, "reason", reason)


def check_result(result: str) -> None:
    """Raise unless the word is how an action or a plan can end."""
    if result not in RESULTS:
        raise InvalidValue(f"{result!r} is no result; a result is one of {', '.join(RESULTS)}")
