"""Constraints that do not flap: hysteresis, dwell, n of the last k measurements, and silence.

The status of a debounced constraint depends on earlier measurements. What has to be remembered of
them is a `Debounced`; each function here is pure and returns a new one.
"""

import heapq
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from kb.elements import Constraint, StalePolicy
from kb.network import Node
from kb.status import OPERATORS, Status

NEVER = math.inf


@dataclass(frozen=True, slots=True)
class Debounced:
    """The status of a debounced constraint, and what decides when it changes.

    Attributes:
        status: satisfied, violated or not evaluated.
        since: when it got this status [s].
        is_silent: whether it has the status of its attribute's policy, because the measurements
            had gone stale and those since then have not decided otherwise.
        candidate: what the measurements since the silence say; None if they say nothing yet.
        candidate_since: since when they say so [s].
    """

    status: Status = Status.NOT_EVALUATED
    since: float = -math.inf
    is_silent: bool = False
    candidate: Status | None = None
    candidate_since: float = -math.inf


def silence(policy: StalePolicy, now: float) -> Debounced:
    """Return what is remembered once the measurements have gone stale: nothing but the policy."""
    return Debounced(policy_status(policy), now, is_silent=True)


def policy_status(policy: StalePolicy) -> Status:
    """Return the status of a constraint whose attribute is stale."""
    return Status.VIOLATED if policy is StalePolicy.VIOLATED else Status.NOT_EVALUATED


def judge(
    node: Node, before: Debounced, votes: tuple[float, ...], now: float
) -> tuple[Debounced, float]:
    """Judge a constraint by the measurements that count.

    Args:
        node: the constraint.
        before: what was remembered.
        votes: the newest measurements that count, at most k; not empty.
        now: the time [s].

    Returns:
        What is remembered from now on, and when to judge again if nothing is measured [s].
    """
    constraint = node.constraint
    if before.is_silent:
        return _judge_after_silence(node, before, votes, now)
    vote = voted_status(constraint, votes, node.attribute.agreement[0], before.status)
    if vote is None or vote is before.status:
        return before, NEVER
    dwell_end = before.since + constraint.dwell
    if before.status is not Status.NOT_EVALUATED and now < dwell_end:
        return before, dwell_end
    return Debounced(vote, now), NEVER


def _judge_after_silence(
    node: Node, before: Debounced, votes: tuple[float, ...], now: float
) -> tuple[Debounced, float]:
    constraint = node.constraint
    if before.candidate is not None and now >= before.candidate_since + constraint.dwell:
        decided = Debounced(before.candidate, before.candidate_since + constraint.dwell)
        return judge(node, decided, votes, now)
    vote = voted_status(constraint, votes, node.attribute.agreement[0], Status.VIOLATED)
    if vote is None:
        return replace(before, candidate=None), NEVER
    if vote is not before.candidate:
        before = replace(before, candidate=vote, candidate_since=now)
    decided_at = before.candidate_since + constraint.dwell
    if now >= decided_at:
        since = before.since if vote is before.status else now
        return Debounced(vote, since), NEVER
    return before, decided_at


def voted_status(
    constraint: Constraint, votes: Iterable[float], enough: int, before: Status
) -> Status | None:
    """Return the status for which enough measurements vote, dwell aside; None if there is none."""
    sides = [_side(constraint, value, before) for value in votes]
    for status in (Status.SATISFIED, Status.VIOLATED):
        if sides.count(status) >= enough:
            return status
    return None


def _side(constraint: Constraint, value: float, before: Status) -> Status:
    holds = OPERATORS[constraint.operator](value, turning_point(constraint, before))
    return Status.SATISFIED if holds else Status.VIOLATED


def turning_point(constraint: Constraint, before: Status | None) -> float:
    """Return the value at which a constraint turns, in its attribute's unit."""
    if before is not Status.VIOLATED or not constraint.hysteresis:
        return constraint.value
    sign = 1 if constraint.operator in (">=", ">") else -1
    turn = constraint.value + sign * constraint.hysteresis
    return float(f"{turn:.15g}")  # as on paper: 0.1 and 0.2 are 0.3


class Alarms:
    """When time changes something next: at most one alarm for each key, at a time of the clock.

    Args:
        is_on: False if time changes nothing: no alarm is ever due.
    """

    def __init__(self, is_on: bool = True) -> None:
        self._is_on = is_on
        self._queue: list[tuple[float, int, str, Node]] = []
        self._times: dict[tuple[str, Node], float] = {}
        self.next = NEVER

    def set(self, what: str, node: Node, time: float) -> None:
        """Set the alarm of a key [s] in place of the one that it has; infinity takes it back."""
        key = (what, node)
        if time == NEVER or not self._is_on:
            self._times.pop(key, None)
            return
        before = self._times.get(key, NEVER)
        self._times[key] = time
        if time <= before:  # one that is put off is found when it would have been due
            heapq.heappush(self._queue, (time, node.index, what, node))
            self.next = self._queue[0][0]

    def due(self, now: float) -> tuple[float, str, Node] | None:
        """Return the first alarm that is due, which stays until it is set anew; None if none is."""
        queue = self._queue
        while queue and queue[0][0] <= now:
            time, index, what, node = queue[0]
            set_for = self._times.get((what, node))
            if set_for == time:
                return time, what, node
            if set_for is None:
                heapq.heappop(queue)
            else:
                heapq.heapreplace(queue, (set_for, index, what, node))
        self.next = queue[0][0] if queue else NEVER
        return None
