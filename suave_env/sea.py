"""The sea: how far one can see in its water, and the pipeline on its seabed."""

import math
from itertools import pairwise

from suave_env.settings import Settings

THRESHOLDS_M = (3.25, 2.25)
"""Visibilities [m] at which the highest useful search altitude changes (3, 2, 1 m); from
kas-lab/suave v1.3.0."""


def expected_altitude(visibility: float) -> float:
    """Return the altitude [m] at which to search in water of some visibility [m].

    From kas-lab/suave v1.3.0.
    """
    if visibility >= THRESHOLDS_M[0]:
        return 3.0
    return 2.0 if visibility >= THRESHOLDS_M[1] else 1.0


class Water:
    """Murky water whose visibility rises and falls.

    `A cos(2 pi (t + shift) / T) + A + min` with `A = (max - min) / 2`.

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
        """Return when the visibility crosses a threshold [m] next [s], and whether it falls.

        In closed form; None if it never crosses.
        """
        middle = self._least + self._amplitude
        if not abs(threshold - middle) < self._amplitude:
            return None
        angle = math.acos((threshold - middle) / self._amplitude)
        falls = self._next(angle, after)
        rises = self._next(2 * math.pi - angle, after)
        return (falls, True) if falls < rises else (rises, False)

    def _next(self, angle: float, after: float) -> float:
        """Return the first time [s] after another at which the cosine has an angle [rad]."""
        first = angle / (2 * math.pi) * self._period - self._shift
        return first + (math.floor((after + 1e-6 - first) / self._period) + 1) * self._period


SEABED_Z_M = -20.0
"""Height of the flat seabed [m], world frame z up; the constant that every motion node of
kas-lab/suave v1.3.0 uses."""

VERTICES_M = (
    (-15.0, 0.0),
    (-25.0, 0.0),
    (-35.0, 0.0),
    (-37.41, -1.0),
    (-44.49, -8.07),
    (-51.56, -15.14),
)
"""Origins (x, y) of the six pipes [m], world frame ENU, in the order received; remaro_worlds
2650f19."""

_STEPS_PER_EDGE = 20


class Pipeline:
    """The pipeline as the 100 points that the detection of kas-lab/suave v1.3.0 interpolates.

    Every edge between two pipe origins is divided in 20 equal steps, of which the end points are
    kept.

    Attributes:
        points: The points (x, y) [m], world frame ENU.
        z: Height of the points for the detection [m], world frame z up.
    """

    def __init__(self, settings: Settings) -> None:
        self.z = SEABED_Z_M + settings.pipe_point_offset_m
        shares = [step / _STEPS_PER_EDGE for step in range(1, _STEPS_PER_EDGE + 1)]
        edges = pairwise(_turned(settings.pipe_turn_rad, (settings.start_x_m, settings.start_y_m)))
        self.points = tuple(
            (x + k * (to_x - x), y + k * (to_y - y))
            for (x, y), (to_x, to_y) in edges
            for k in shares
        )
        self._north = max(y for _, y in self.points)
        self._tangent = math.tan(settings.half_view_angle_rad)

    def first_visible(self, x: float, y: float, z: float, visibility: float) -> int | None:
        """Return the smallest index of a point that the camera sees.

        A point is seen if `|dx|` and `|dy|` are at most `h tan(half angle)`, where `h = |dz|`, and
        `h` is at most the visibility [m]: a square field of view that does not turn with the
        vehicle (kas-lab/suave v1.3.0), which is at (x, y, z) [m], world frame ENU, z up.

        Returns:
            An index into `points`, or None if no point is seen.
        """
        height = abs(z - self.z)
        half = height * self._tangent
        if (
            height > visibility or y - self._north > half
        ):  # all of it lies south: the usual case ends here
            return None
        for index, (px, py) in enumerate(self.points):
            if abs(px - x) <= half and abs(py - y) <= half:
                return index
        return None

    def path_from(self, index: int) -> tuple[tuple[float, float], ...]:
        """Return the path of an inspection begun at the point that was seen first.

        Points (x, y) [m].

        From that point to the far end, then all of them back to the near end, the far end twice
        (kas-lab/suave v1.3.0).
        """
        return self.points[index:] + self.points[::-1]


def _turned(angle: float, centre: tuple[float, float]) -> list[tuple[float, float]]:
    """Return the vertices turned to the left by an angle [rad] about a centre [m]."""
    if not angle:
        return list(VERTICES_M)  # to the bit
    cos = math.cos(angle)
    sin = math.sin(angle)
    x, y = centre
    return [
        (x + cos * (a - x) - sin * (b - y), y + sin * (a - x) + cos * (b - y))
        for a, b in VERTICES_M
    ]
