"""Actions that a mission asks for: the answer to a request, and the record of what was required."""

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


class RequiredAction:
    """An action that a mission asked for, from when, and how it ended.

    Attributes:
        action: its name.
        preference: name of the attribute preferred when a configuration is chosen for it, or None.
        start: when it was requested [s].
    """

    __slots__ = ("_end", "_result", "action", "preference", "start")

    def __init__(self, action: str, preference: str | None, start: float) -> None:
        self.action = action
        self.preference = preference
        self.start = start
        self._end: float | None = None
        self._result: str | None = None

    @property
    def end(self) -> float | None:
        """When it ended [s], None while it is open."""
        return self._end

    @property
    def result(self) -> str | None:
        """How it ended: "completed", "failed", "abandoned"; None while it is open."""
        return self._result

    def __repr__(self) -> str:
        return f"<RequiredAction {self.action!r} ({self.result or 'open'})>"


def check_result(result: str) -> None:
    """Raise unless the word is how an action or a plan can end."""
    if result not in RESULTS:
        raise InvalidValue(f"{result!r} is no result; a result is one of {', '.join(RESULTS)}")
