"""Constraints that do not flap: hysteresis, dwell, n of the last k measurements, and silence.

The status of a debounced constraint depends on earlier measurements. What has to be remembered of
them is a `Debounced`; each function here is pure and returns a new one.
"""

import math
from collections.abc import Iterable
from typing import NamedTuple

from kb.elements import Constraint, StalePolicy
from kb.network import Node
from kb.status import NOT_EVALUATED, OPERATORS, SATISFIED, VIOLATED, Status

NEVER = math.inf


class Debounced(NamedTuple):
    """The status of a debounced constraint, and what decides when it changes.

    Attributes:
        status: satisfied, violated or not evaluated.
        since: when it got this status [s].
        is_silent: whether it has the status of its attribute's policy, because the measurements
            had gone stale and those since then have not decided otherwise.
        candidate: what the measurements since the silence say; None if they say nothing yet.
        candidate_since: since when they say so [s].
    """

    status: Status = NOT_EVALUATED
    since: float = -math.inf
    is_silent: bool = False
    candidate: Status | None = None
    candidate_since: float = -math.inf


def policy_status(policy: StalePolicy) -> Status:
    """Return the status of a constraint whose attribute is stale."""
    return VIOLATED if policy is StalePolicy.VIOLATED else NOT_EVALUATED


def debounce(
    node: Node, before: Debounced, votes: Iterable[float], now: float
) -> tuple[Debounced, float]:
    """Judge a constraint by the measurements that count.

    Args:
        node: the constraint.
        before: what was remembered.
        votes: the newest measurements that count, at most k.
        now: the time [s].

    Returns:
        What is remembered from now on, and when to judge again if nothing is measured [s].
    """
    constraint = node.constraint
    enough = node.attribute.agreement[0]
    if not before.is_silent:
        vote = voted_status(constraint, votes, enough, before.status)
        if vote is None or vote is before.status:
            return before, NEVER
        dwell_end = before.since + constraint.dwell
        if before.status is not NOT_EVALUATED and now < dwell_end:
            return before, dwell_end
        return Debounced(vote, now), NEVER
    decided_at = before.candidate_since + constraint.dwell
    if before.candidate is not None and now >= decided_at:
        return debounce(node, Debounced(before.candidate, decided_at), votes, now)
    vote = voted_status(constraint, votes, enough, VIOLATED)
    if vote is not before.candidate:
        before = Debounced(before.status, before.since, True, vote, now)
    if vote is None:
        return before, NEVER
    decided_at = before.candidate_since + constraint.dwell
    if now < decided_at:
        return before, decided_at
    return Debounced(vote, before.since if vote is before.status else now), NEVER


def voted_status(
    constraint: Constraint, votes: Iterable[float], enough: int, before: Status
) -> Status | None:
    """Return the status for which enough measurements vote, dwell aside; None if there is none."""
    holds = OPERATORS[constraint.operator]
    turn = turning_point(constraint, before)
    sides = [holds(value, turn) for value in votes]
    if sides.count(True) >= enough:
        return SATISFIED
    return VIOLATED if sides.count(False) >= enough else None


def turning_point(constraint: Constraint, before: Status | None) -> float:
    """Return the value at which a constraint turns, in its attribute's unit."""
    if before is not VIOLATED or not constraint.hysteresis:
        return constraint.value
    sign = 1 if constraint.operator in (">=", ">") else -1
    turn = constraint.value + sign * constraint.hysteresis
    return float(f"{turn:.15g}")  # as on paper: 0.1 and 0.2 are 0.3
