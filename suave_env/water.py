"""The visibility of the water, and the search altitude that it requires."""

import math

from suave_env.settings import Settings

THRESHOLDS_M = (3.25, 2.25)
"""Visibilities [m] at which the highest useful search altitude changes (3, 2, 1 m); from kas-lab/suave v1.3.0."""


def expected_altitude(visibility: float) -> float:
    """Return the altitude [m] at which to search in water of some visibility [m]; from kas-lab/suave v1.3.0."""
    return 3.0 if visibility >= THRESHOLDS_M[0] else 2.0 if visibility >= THRESHOLDS_M[1] else 1.0


class Water:
    """Murky water whose visibility rises and falls: `A cos(2 pi (t + shift) / T) + A + min` with `A = (max - min) / 2`.

    The formula is that of kas-lab/suave v1.3.0 (water visibility node).
    """

    def __init__(self, settings: Settings) -> None:
        self._amplitude = (settings.visibility_max_m - settings.visibility_min_m) / 2
        self._least = settings.visibility_min_m
        self._period = settings.visibility_period_s
        self._shift = settings.visibility_shift_s

    def visibility(self, time: float) -> float:
        """Return the visibility [m] at a time since GUIDED [s]."""
        angle = 2 * math.pi * (time + self._shift) / self._period
        return self._amplitude * math.cos(angle) + self._amplitude + self._least

    def next_crossing(self, threshold: float, after: float) -> tuple[float, bool] | None:
        """Return the next time after another [s] at which the visibility crosses a threshold [m], and whether it falls.

        In closed form; None if it never crosses.
        """
        middle = self._least + self._amplitude
        if not abs(threshold - middle) < self._amplitude:
            return None
        angle = math.acos((threshold - middle) / self._amplitude)
        falls, rises = self._next(angle, after), self._next(2 * math.pi - angle, after)
        return (falls, True) if falls < rises else (rises, False)

    def _next(self, angle: float, after: float) -> float:
        """Return the first time [s] clearly after another at which the cosine has an angle [rad]."""
        first = angle / (2 * math.pi) * self._period - self._shift
        return first + (math.floor((after + 1e-6 - first) / self._period) + 1) * self._period
