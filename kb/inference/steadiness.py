"""Constraints that do not flap: by hysteresis, by dwell, and by n of the last k measurements.

All are without effect by default, as in ROSA. What such a constraint is depends on what was measured before, so its
verdict is remembered with the facts; inference reads it there.
"""

from collections.abc import Iterable
from decimal import Decimal
from functools import lru_cache

from kb.elements import Constraint
from kb.status import OPERATORS, Status

__all__ = ["turning_point", "verdict"]


def verdict(constraint: Constraint, values: Iterable[float], enough: int, before: Status | None) -> Status | None:
    """Return what measurements say of a constraint, whatever its dwell.

    Args:
        constraint: with its hysteresis.
        values: the latest measurements that count, in the attribute's unit.
        enough: how many of them have to agree.
        before: what it was; None if it was neither satisfied nor violated.

    Returns:
        What it was, unless enough of the measurements say otherwise.
    """
    votes = [_side(constraint, value, before) for value in values]
    agreed = [status for status in (Status.SATISFIED, Status.VIOLATED) if votes.count(status) >= enough]
    return agreed[0] if agreed else before


def _side(constraint: Constraint, value: float, before: Status | None) -> Status:
    """Return on which side of the threshold a value is; for one that was violated it lies further off."""
    is_so = OPERATORS[constraint.operator](value, turning_point(constraint, before))
    return Status.SATISFIED if is_so else Status.VIOLATED


def turning_point(constraint: Constraint, before: Status | None) -> float:
    """Return the value at which a constraint turns, after what it was, in the attribute's unit."""
    if before is not Status.VIOLATED or not constraint.hysteresis:
        return constraint.value
    sign = 1 if constraint.operator in (">=", ">") else -1
    return _sum(constraint.value, sign * constraint.hysteresis)


@lru_cache(maxsize=1024)
def _sum(value: float, margin: float) -> float:
    """Add as one does on paper: 0.1 and 0.2 are 0.3."""
    return float(Decimal(repr(value)) + Decimal(repr(margin)))
