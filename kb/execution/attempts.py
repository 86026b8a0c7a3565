"""Commands to components: given until they are carried out or given up, each attempt on the knowledge base's record."""

import logging
import math
from dataclasses import dataclass
from typing import Final

from kb.elements import Parameters
from kb.exceptions import InvalidValue
from kb.history import Attempt
from kb.knowledge_base import KnowledgeBase
from kb.managed_system import ManagedSystem, Operation, is_active
from kb.reconfiguration import ReconfigurationPlan

__all__ = ["Command", "RetryPolicy"]

_log = logging.getLogger(__name__)

_MOST_DOUBLINGS: Final = 60


@dataclass(frozen=True, slots=True)
class RetryPolicy:
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

    def pause(self, count: int) -> float:
        """Return how long to wait after a number of failures [s]."""
        return self.back_off * 2.0 ** min(count - 1, _MOST_DOUBLINGS)


@dataclass(slots=True, eq=False)
class Command:
    """What one component is to do for a plan, on its way to an end.

    Attributes:
        kb: has each attempt on record.
        plan: what it is part of.
        policy: how often it is tried, and how long.
        managed: what is commanded; None if it is a matter of bookkeeping only.
        component: its name.
        operation: "activate", "deactivate" or "configure".
        configuration: name of what it is configured with, None for a switch.
        parameters: what is set; None for a switch.
    """

    kb: KnowledgeBase
    plan: ReconfigurationPlan
    policy: RetryPolicy
    managed: ManagedSystem | None
    component: str
    operation: str
    configuration: str | None = None
    parameters: Parameters | None = None
    _count: int = 0
    _due: float = -math.inf
    _attempt: Attempt | None = None
    _under_way: Operation | None = None
    _refusal: Exception | None = None

    @property
    def reason(self) -> str:
        """What came of the last attempt, and how often it was tried, in words."""
        tried = {1: "once", 2: "twice"}.get(self._count, f"{self._count} times")
        return f"tried {tried}: {self._attempt.reason if self._attempt is not None else ''}"

    def begin(self, now: float) -> None:
        """Give the command if it is time for that and it is not under way."""
        if self.managed is None or now < self._due or (self._attempt is not None and self._attempt.end is None):
            return
        self._count += 1
        self._attempt = self.kb.record_attempt(
            self.plan,
            self.component,
            self.operation,
            configuration=self.configuration,
            parameters=self.parameters,
            number=self._count,
        )
        self._under_way = self._refusal = None
        try:
            self._under_way = self._give(self.managed)
        except Exception as error:
            self._refusal = error

    def advance(self, now: float) -> str | None:
        """Return how it has ended, "completed" or "failed", or None as long as it has not."""
        if self.managed is None:
            return "completed"
        while True:
            self.begin(now)
            if self._attempt is None or self._attempt.end is not None:
                return None
            outcome = self._outcome(self.managed, now - self._attempt.start)
            if outcome is None:
                return None
            result, reason = outcome
            self.kb.finish_attempt(self._attempt, result, reason)
            if result == "completed" or self._count >= self.policy.attempts:
                return result
            self._due = now + self.policy.pause(self._count)

    def abandon(self, reason: str) -> None:
        """Give it up without waiting for what is under way."""
        if self._attempt is not None and self._attempt.end is None:
            _cancel(self._under_way)
            self.kb.finish_attempt(self._attempt, "abandoned", reason)

    def _give(self, managed: ManagedSystem) -> Operation | None:
        if self.parameters is not None:
            return managed.set_parameters(self.component, self.parameters)
        return (managed.activate if self.operation == "activate" else managed.deactivate)(self.component)

    def _outcome(self, managed: ManagedSystem, lasts: float) -> tuple[str, str] | None:
        """Return result and reason of the attempt under way, None while there is neither."""
        ended, error = self._has_ended()
        is_late = lasts >= self.policy.timeout
        if error is not None:
            return "failed", _words(error)
        if not ended and not is_late:
            return None
        is_reached, doubt = self._look(managed)
        if ended and is_reached is not False:
            return "completed", ""
        if not is_late:
            return None
        if is_reached:
            return "completed", "it never said so, but it is done"
        if ended:
            return "failed", f"it was said to be done, but {doubt} within {self.policy.timeout:g} s"
        _cancel(self._under_way)
        return "failed", f"it was not done within {self.policy.timeout:g} s"

    def _has_ended(self) -> tuple[bool, BaseException | None]:
        """Return whether what is under way has ended, and with which error; a cancelled future raises when asked."""
        operation = self._under_way
        try:
            if operation is None:
                return True, self._refusal
            return (True, operation.exception()) if operation.done() else (False, None)
        except Exception as error:
            return True, error

    def _look(self, managed: ManagedSystem) -> tuple[bool | None, str]:
        """Return whether the component is as it was to be, None if nobody can tell, and what speaks against it."""
        if self.operation == "configure":
            return None, ""
        try:
            active = is_active(managed, self.component)
        except Exception as error:
            return False, f"nobody could tell ({_words(error)})"
        is_reached = None if active is None else active is (self.operation == "activate")
        return is_reached, f"{self.component} was not found so"


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _cancel(operation: Operation | None) -> None:
    """Cancel an operation that can be cancelled, so that it does not come true when nobody expects it any more."""
    cancel = getattr(operation, "cancel", None)
    if callable(cancel):
        try:
            cancel()
        except Exception as error:
            _log.warning("an operation could not be cancelled: %s", _words(error))


def _words(error: BaseException) -> str:
    return str(error) or type(error).__name__
