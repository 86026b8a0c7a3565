"""Decorators: an action around a behaviour, another attempt, and times by the runner's clock.

`Timeout`, `Timer`, `Delay` and `Retry` count by the clock of the `TreeRunner` that ticks their
tree; in a tree without one, by the monotonic clock of this computer.
"""

import math
import time
from collections.abc import Callable, Iterator
from typing import Any

import py_trees.decorators
import py_trees.timers
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.decorators import Decorator

from kb import KnowledgeBase
from rosa_bt.behaviours import Requester, Ticking, guard
from rosa_bt.exceptions import TreeChangeError
from rosa_bt.requests import FAILURE, INVALID, RUNNING, SUCCESS, ActionRequest

Clock = Callable[[], float]
"""Gives the time [s]."""
ROUNDING_S = 1e-9
"""A time is over if less than this is left of it [s]."""


class PassingOn(Decorator):
    """Has the status and the feedback of its child; base class."""

    def update(self) -> Status:
        self.feedback_message = self.decorated.feedback_message
        return self.decorated.status


class ForAction(Requester, PassingOn):
    """Ticks any behaviour only while a ROSA action is feasible, and requests the action meanwhile.

    Each tick asks whether the action is feasible. If it is not, the child is stopped, and this
    fails with the reason. Otherwise the action is requested when the child starts, and released
    once, however the child ends: the result is "completed" after SUCCESS, "failed" after FAILURE or
    an exception (its text is the feedback), else "abandoned".

    Args:
        action: name of the ROSA action.
        child: a leaf or a whole subtree.
        preference: name of the attribute to favour when a configuration is chosen, or None.
        wait: tick the child only when the robot is configured for the action; RUNNING until then.

    Raises:
        kb.UnknownName: no such action; the message lists the nearest ones.
    """

    def __init__(
        self,
        name: str,
        kb: KnowledgeBase,
        action: str,
        child: Behaviour,
        *,
        preference: str | None = None,
        wait: bool = False,
    ) -> None:
        super().__init__(name, child)
        kb.is_feasible(action)  # raises now, not during a mission, if it is unknown
        self.kb = kb
        self.action = action
        self.preference = preference
        self.wait = wait
        self._rosa_request = ActionRequest(self, kb)
        guard(self)

    def _rosa_work(self) -> Ticking:
        yield from self.decorated.tick()
        return self.update()

    def stop(self, new_status: Status) -> None:
        """Stop the child if it is running, and release the request.

        The status changes last: after an interrupt in here, a second call does the rest.
        """
        try:
            self.terminate(new_status)
            if new_status is INVALID or self.decorated.status is RUNNING:
                self.decorated.stop(INVALID)
        finally:
            self._rosa_request.close(new_status, self.feedback_message)
        self.status = new_status


class UntilSuccess(Decorator):
    """RUNNING until the child succeeds; a child that fails is ticked once more in the same tick.

    Without this second attempt there would be a tick after which no action is required: the robot
    would be deconfigured between two actions, and configured again a moment later.
    """

    def tick(self) -> Iterator[Behaviour]:
        yield from self.decorated.tick()
        if self.decorated.status is FAILURE:
            yield from self.decorated.tick()
        self.status = self.update()
        if self.status is not RUNNING:
            self.stop(self.status)
        yield self

    def update(self) -> Status:
        return RUNNING if self.decorated.status is FAILURE else self.decorated.status


_LEAST = {"duration": 0, "pause": 0, "num_failures": 1}
"""The least values of attributes that are numbers."""


class ClockFollower(Behaviour):
    """A behaviour that counts by the clock of its runner; base class."""

    _clock: Clock = time.monotonic

    def follow(self, clock: Clock) -> None:
        """Count by this clock from now on; a `TreeRunner` calls it."""
        self._clock = clock


class Timed(ClockFollower):
    """Has a start, from which it counts; base class."""

    _since = -math.inf

    def __setattr__(self, name: str, value: Any) -> None:  # noqa: ANN401  # any attribute
        """Refuse a number that is too small, also in the constructors of py_trees."""
        least = _LEAST.get(name, -math.inf)
        if least >= 0 and not (isinstance(value, int | float) and value >= least):
            kind = type(self).__name__
            raise ValueError(f"{kind} {self.name!r}: {name} is at least {least}, not {value!r}")
        super().__setattr__(name, value)

    def follow(self, clock: Clock) -> None:
        """Count by this clock; what has begun by another one begins anew."""
        super().follow(clock)
        self._since = clock()

    def initialise(self) -> None:
        super().initialise()
        self._since = self._clock()

    def is_over(self, duration: float) -> bool:
        """Tell whether a duration [s] has passed since the start."""
        return self._clock() - self._since >= duration - ROUNDING_S


class Timer(Timed, py_trees.timers.Timer):
    """RUNNING for a duration [s], then SUCCESS."""

    def update(self) -> Status:
        is_over = self.is_over(self.duration)
        self.feedback_message = "" if is_over else f"takes {self.duration:g} s"
        return SUCCESS if is_over else RUNNING


class Timeout(PassingOn, Timed, py_trees.decorators.Timeout):
    """Stops the child, and fails, if it is RUNNING after a duration [s]."""

    def update(self) -> Status:
        new_status = super().update()
        if new_status is RUNNING and self.is_over(self.duration):
            self.feedback_message = f"{self.decorated.name} takes more than {self.duration:g} s"
            return FAILURE
        return new_status


class Delay(PassingOn, Timed):
    """RUNNING for a duration [s]; then ticks the child."""

    def __init__(self, name: str, child: Behaviour, duration: float) -> None:
        super().__init__(name, child)
        self.duration = duration

    def tick(self) -> Iterator[Behaviour]:
        if self.status is not RUNNING:
            self.initialise()
            self.status = RUNNING
        if self.is_over(self.duration):
            yield from super().tick()
        else:
            self.feedback_message = f"{self.decorated.name} begins after {self.duration:g} s"
            yield self


class Retry(Timed, py_trees.decorators.Retry):
    """Ticks the child again after a failure, with a pause [s] before.

    FAILURE after `num_failures`.
    """

    def __init__(self, name: str, child: Behaviour, num_failures: int, pause: float = 0.0) -> None:
        super().__init__(name, child, num_failures)
        self.pause = pause

    def tick(self) -> Iterator[Behaviour]:
        has_failed = self.status is RUNNING and self.decorated.status is FAILURE
        if has_failed and not self.is_over(self.pause):
            yield self
        else:
            yield from super().tick()

    def update(self) -> Status:
        new_status = super().update()
        if self.decorated.status is FAILURE:
            self._since = self._clock()
        return new_status


_BY_CLOCK: dict[type[Behaviour], type[Behaviour]] = {
    py_trees.timers.Timer: Timer,
    py_trees.decorators.Timeout: Timeout,
}


def follow_clock(behaviour: Behaviour, clock: Clock) -> None:
    """Let a behaviour count by a clock; py_trees' own `Timeout` and `Timer` become ours.

    Raises:
        TreeChangeError: a subclass of them counts by the clock of the computer.
    """
    if type(behaviour) in _BY_CLOCK:
        behaviour.__class__ = _BY_CLOCK[type(behaviour)]
    if isinstance(behaviour, ClockFollower):
        behaviour.follow(clock)
    elif isinstance(behaviour, tuple(_BY_CLOCK)):
        kind = type(behaviour).__name__
        raise TreeChangeError(
            f"{kind} {behaviour.name!r} counts by the clock of this computer; "
            "derive it from rosa_bt.Timeout or rosa_bt.Timer, which follow the runner's"
        )
