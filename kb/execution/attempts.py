"""Commands to components: given until they are carried out or given up, each attempt on the knowledge base's record."""

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

from kb.elements import Parameters
from kb.exceptions import InvalidValue
from kb.history import Attempt
from kb.knowledge_base import KnowledgeBase
from kb.managed import Operation
from kb.reconfiguration import ReconfigurationPlan

__all__ = ["Attempt", "Command", "Patience", "Step"]

_log = logging.getLogger(__name__)

_NOTHING: Final[Parameters] = MappingProxyType({})
_MOST_DOUBLINGS: Final = 60


@dataclass(frozen=True, slots=True)
class Patience:
    """How often a command is given, and how long it may take.

    Attributes:
        attempts: how often it is given before it is given up.
        timeout: how long one attempt may take [s].
        back_off: how long after a failure it is given again [s]; twice as long after each further one.
    """

    attempts: int
    timeout: float
    back_off: float

    def __post_init__(self) -> None:
        if not isinstance(self.attempts, int) or isinstance(self.attempts, bool) or self.attempts < 1:
            raise InvalidValue(f"a command is given a whole number of times, once at least, not {self.attempts!r}")
        if not _is_number(self.timeout) or not self.timeout > 0:
            raise InvalidValue(f"a time-out is more than 0 s, math.inf for none, not {self.timeout!r}")
        if not _is_number(self.back_off) or not 0 <= self.back_off < math.inf:
            raise InvalidValue(f"a back-off is a finite number of seconds from 0, not {self.back_off!r}")


@dataclass(frozen=True, slots=True)
class Command:
    """What one component is to do.

    Attributes:
        component: its name.
        operation: "activate", "deactivate" or "configure".
        give: gives the command; None if it is a matter of bookkeeping only.
        is_reached: asks whether the component is as it was to be; None for "cannot be told".
        configuration: name of what it is configured with, None for a switch.
        parameters: what is set; empty for a switch.
    """

    component: str
    operation: str
    give: Callable[[], Operation | None] | None
    is_reached: Callable[[], bool | None] = lambda: None
    configuration: str | None = None
    parameters: Parameters = field(default_factory=lambda: _NOTHING)


class Step:
    """A command of a plan on its way to an end.

    Args:
        kb: has each attempt on record.
        plan: what it is part of.
        command: what is to be done.
        patience: how often it is tried, and how long.
    """

    def __init__(self, kb: KnowledgeBase, plan: ReconfigurationPlan, command: Command, patience: Patience) -> None:
        self.command = command
        self._kb = kb
        self._plan = plan
        self._patience = patience
        self._count = 0
        self._due = -math.inf
        self._attempt: Attempt | None = None
        self._operation: Operation | None = None

    @property
    def reason(self) -> str:
        """What came of the last attempt, and how often it was tried, in words."""
        tried = {1: "once", 2: "twice"}.get(self._count, f"{self._count} times")
        return f"tried {tried}: {self._attempt.reason if self._attempt is not None else ''}"

    @property
    def is_void(self) -> bool:
        """Whether what is commanded, or what it is configured with, is no longer in the model."""
        component, configuration = self.command.component, self.command.configuration
        known = self._kb.configurations
        return component not in self._kb.components or (configuration is not None and configuration not in known)

    def begin(self, now: float) -> None:
        """Give the command if it is time for that and it is not under way."""
        command = self.command
        if command.give is None or now < self._due or (self._attempt is not None and self._attempt.end is None):
            return
        self._count += 1
        self._attempt = self._kb.record_attempt(
            self._plan,
            command.component,
            command.operation,
            configuration=command.configuration,
            parameters=command.parameters,
            number=self._count,
        )
        try:
            self._operation = command.give()
        except Exception as error:
            self._operation = _Refused(error)

    def advance(self, now: float) -> str | None:
        """Return how the step has ended, "completed" or "failed", or None as long as it has not."""
        if self.command.give is None:
            return "completed"
        while True:
            self.begin(now)
            if self._attempt is None or self._attempt.end is not None:
                return None
            verdict = self._verdict(now - self._attempt.start)
            if verdict is None:
                return None
            result, reason = verdict
            self._kb.finish_attempt(self._attempt, result, reason)
            if result == "completed" or self._count >= self._patience.attempts:
                return result
            self._due = now + self._patience.back_off * 2.0 ** min(self._count - 1, _MOST_DOUBLINGS)

    def abandon(self, reason: str) -> None:
        """Give it up without waiting for what is under way."""
        if self._attempt is not None and self._attempt.end is None:
            _cancel(self._operation)
            self._kb.finish_attempt(self._attempt, "abandoned", reason)

    def _verdict(self, lasts: float) -> tuple[str, str] | None:
        """Return result and reason of the attempt under way, None while there is neither."""
        ended, error = _outcome(self._operation)
        is_late = lasts >= self._patience.timeout
        if error is not None:
            return "failed", _told(error)
        if not ended and not is_late:
            return None
        is_reached, doubt = self._look()
        if ended and is_reached is not False:
            return "completed", ""
        if not is_late:
            return None
        if is_reached:
            return "completed", "it never said so, but it is done"
        if ended:
            return "failed", f"it was said to be done, but {doubt} within {self._patience.timeout:g} s"
        _cancel(self._operation)
        return "failed", f"it was not done within {self._patience.timeout:g} s"

    def _look(self) -> tuple[bool | None, str]:
        """Return whether the component is as it was to be, and what speaks against it."""
        try:
            is_reached = self.command.is_reached()
        except Exception as error:
            return False, f"nobody could tell ({_told(error)})"
        return is_reached, f"{self.command.component} was not found so"


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _outcome(operation: Operation | None) -> tuple[bool, BaseException | None]:
    """Return whether an operation has ended, and with which error; asking may raise, e.g. of a cancelled future."""
    if operation is None:
        return True, None
    try:
        return (True, operation.exception()) if operation.done() else (False, None)
    except Exception as error:
        return True, error


def _cancel(operation: Operation | None) -> None:
    """Cancel an operation that can be cancelled, so that it does not come true when nobody expects it any more."""
    cancel = getattr(operation, "cancel", None)
    if callable(cancel):
        try:
            cancel()
        except Exception as error:
            _log.warning("an operation could not be cancelled: %s", _told(error))


def _told(error: BaseException) -> str:
    return str(error) or type(error).__name__


class _Refused:
    """A command that raised at once, as an operation that has ended."""

    def __init__(self, error: Exception) -> None:
        self._error = error

    def done(self) -> bool:
        return True

    def exception(self) -> Exception:
        return self._error
