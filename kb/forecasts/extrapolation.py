"""How a series of measurements may go on: curves through the past, and how far such curves were off so far.

Intervals are conformal (Vovk, Gammerman and Shafer, "Algorithmic learning in a random world", 2005): forecasts from
earlier points of the same series are compared with what was measured then, and the interval is as wide as would have
held those values often enough. After misses it widens, after hits it narrows (Gibbs and Candes, "Adaptive conformal
inference under distribution shift", NeurIPS 2021). Results depend on the series only; a cache just remembers them.
"""

import logging
import math
import operator
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from itertools import combinations, groupby, pairwise
from statistics import median
from typing import Any, Final, NamedTuple

from kb.elements import finite_number

_log = logging.getLogger(__name__)

LEVEL: Final = 0.9
"""How often an interval shall hold what comes."""
_ENOUGH, _ORIGINS, _GAPS = 9, 40, 4
"""From how many earlier points, at least and at most, it is looked how far a forecast was off, and how many of them lie
within a horizon at most: what overlaps more is no evidence of its own."""
_PACE: Final = 0.1
"""How quickly an interval adapts after a hit or a miss."""
_REACH: Final = 4.0
"""How many times further ahead than it could be checked a forecast goes; there its interval grows with the time."""
_MOST_POINTS, _LEAST_POINTS = 24, 8
_WAVE_POINTS, _PERIODS, _ROUNDS, _SEEN = 64, 40, 4, 0.75
"""On how many points a wave is fitted, how many periods are tried, how often it is looked between the best ones, and
which part of what is looked at a period may be, if so much was seen."""
_ROUNDING: Final = 1e-9


class Curve(NamedTuple):
    """The value of an attribute at a time [s], and how it gets there, in words with "{}" for its unit.

    A guessed curve uses a rate that was not seen yet: earlier forecasts without error do not make it certain.
    """

    value: Callable[[float], float | None]
    words: str
    is_guessed: bool = False


Fit = Callable[[int, float], Curve | None]
Expected = tuple[float, float | None, str]
"""A value, how far it may be off (None if not known), and how it gets there, in words."""


class Series(NamedTuple):
    """Measurements by time [s]."""

    times: Sequence[float]
    values: Sequence[float]

    def between(self, start: float, end: float) -> "Series":
        """Return those from one time to another [s]."""
        first, last = bisect_left(self.times, start), bisect_right(self.times, end)
        return Series(self.times[first:last], self.values[first:last])

    def inside(self, low: float, high: float) -> "list[Series]":
        """Return the parts of it between two bounds: what is at a bound is held there, and shows no rate."""
        parts = groupby(zip(*self, strict=True), lambda point: low < point[1] < high)
        return [Series(*zip(*part, strict=True)) for is_inside, part in parts if is_inside]


def constant(series: Series, _: float) -> Curve | None:
    """Stay as measured last."""
    return straight(series.times[-1], series.values[-1], 0.0)


def straight(time: float, value: float, slope: float, words: str = "") -> Curve:
    """Go on from a point with a slope [1/s]."""
    way = f"{'rises' if slope > 0 else 'falls'} by {abs(slope):.3g}{{}}/s" if slope else "stays as it is"
    return Curve(lambda then: value + slope * (then - time), way + words)


def slope_of(series: Series) -> float | None:
    """Return the median of the slopes between any two points, thinned out [1/s] (Theil 1950, Sen 1968).

    Nearly three in ten points may be arbitrarily wrong; None of too few points.
    """
    points = list(zip(*series, strict=True))[:: -max(1, math.ceil(len(series.times) / _MOST_POINTS))]
    slopes = [(two[1] - one[1]) / (two[0] - one[0]) for one, two in combinations(points, 2) if two[0] != one[0]]
    return median(slopes) if len(series.times) >= _LEAST_POINTS and slopes else None


def trend(series: Series, ahead: float) -> Curve | None:
    """Go on along a robust straight line through what was measured lately, twice as long as is looked ahead [s]."""
    end = series.times[-1]
    lately = series.between(min(end - 2 * ahead, series.times[-_LEAST_POINTS:][0]), end)
    if (slope := slope_of(lately)) is None:
        return None
    heights = (value - slope * (time - end) for time, value in zip(*lately, strict=True))
    return straight(end, median(heights), slope)


def periodic(series: Series, _: float) -> Curve | None:
    """Go on as a wave and its first overtone: for each of many periods by least squares, then between the best ones."""
    if len(series.times) < _LEAST_POINTS:
        return None
    import numpy as np

    def misfits(periods: Any) -> Any:  # noqa: ANN401  # arrays of numpy
        angles = 2 * math.pi * times / periods[:, None]
        basis = np.stack([np.ones_like(angles), np.cos(angles), np.sin(angles)], axis=1)
        # ever so little more than the normal equations, which are singular where the times hide a wave
        swings = np.linalg.solve(basis @ basis.transpose(0, 2, 1) + _ROUNDING * np.eye(3), basis @ values[:, None])
        rest = values - (swings.transpose(0, 2, 1) @ basis)[:, 0]
        return (rest * rest).sum(axis=1)

    end = series.times[-1]
    width = (end - series.times[-_WAVE_POINTS:][0]) / _WAVE_POINTS
    while True:
        found = sorted({bisect_right(series.times, end - width * back) for back in range(_WAVE_POINTS)} - {0})
        times = np.array([series.times[place - 1] - end for place in found])
        values = np.array([series.values[place - 1] for place in found])
        span = -float(times[0])
        if len(found) < _LEAST_POINTS or not span:
            return None
        periods = np.geomspace(4 * width, 3 * span, _PERIODS)
        for _ in range(_ROUNDS):
            best = int(np.argmin(misfits(periods)))
            periods = np.linspace(periods[max(best - 1, 0)], periods[min(best + 1, len(periods) - 1)], _MOST_POINTS)
        period = float(periods[int(np.argmin(misfits(periods)))])
        if period < _SEEN * span or end - width * _WAVE_POINTS < series.times[0]:
            break
        width *= 2
    waves = range(1, 3 if period < _SEEN * span else 2)
    angles = [2 * math.pi * wave / period for wave in waves]
    columns = [np.ones_like(times), *(one(angle * times) for angle in angles for one in (np.cos, np.sin))]
    base, *swings = np.linalg.lstsq(np.stack(columns, axis=1), values, rcond=None)[0].tolist()
    low, high = float(values.min()), float(values.max())
    low, high = 2 * low - high, 2 * high - low

    def value(then: float) -> float:
        turns = [wave(angle * (then - end)) for angle in angles for wave in (math.cos, math.sin)]
        return float(min(max(base + sum(map(operator.mul, swings, turns)), low), high))

    return Curve(value, f"goes up and down every {period:.3g} s")


def by_function(function: Callable[[Sequence[tuple[float, float]], float], float | None], series: Series) -> Curve:
    """Go on as a function of one's own says; what it raises is logged, and then nothing is known."""
    samples = tuple(zip(*series, strict=True))

    def value(then: float) -> float | None:
        try:
            found = function(samples, then)
            return None if found is None else finite_number(found)
        except Exception:
            _log.exception("the forecast %r failed", function)
            return None

    return Curve(value, "goes on as a function of the model's says")


WAYS: Final = {"constant": constant, "trend": trend, "periodic": periodic}


class Outlook:
    """How one series goes on, and how far that may be off, for each time ahead.

    `fit` continues the series from one of its points, to be right about so far ahead [s]. Spans of time are alike if
    the same actions are done in both. A stated rate is trusted, however little was measured.
    """

    def __init__(self, series: Series, fit: Fit, is_alike: Callable[[float, float], bool], is_stated: bool) -> None:
        self._series, self._fit, self._is_alike, self._is_stated = series, fit, is_alike, is_stated
        steps = sorted(two - one for one, two in pairwise(series.times[-2 * _LEAST_POINTS :]) if two > one)
        self._step = 2.0 ** math.floor(math.log2(steps[len(steps) // 2])) if steps else 1.0
        self._radii: list[float] = []
        self._curves: dict[int, Curve | None] = {}
        self._is_complete = False

    def at(self, time: float) -> Expected | None:
        """Return what is expected at a time [s]; None for unknown."""
        ahead = max(time - self._series.times[-1], self._step)
        knot = math.ceil(math.log2(ahead / self._step) - _ROUNDING)
        radius = self._radius(knot, ahead)
        if radius is None and not self._is_stated:
            return None
        if knot not in self._curves:
            self._curves[knot] = self._fit(len(self._series.times) - 1, self._step * 2.0**knot)
        curve = self._curves[knot]
        value = None if curve is None else curve.value(time)
        if curve is None or value is None:
            return None
        is_exact = radius is not None and radius <= _ROUNDING * abs(value)
        return value, None if curve.is_guessed and is_exact else radius, curve.words

    def _radius(self, knot: int, ahead: float) -> float | None:
        """Return how far a forecast may be off so far ahead [s]: found at each doubling of the step, linear between."""
        radii = self._radii
        while len(radii) <= knot and not self._is_complete:
            radius = _quantile(self._errors(self._step * 2.0 ** len(radii)))
            self._is_complete = radius is None
            radii += [] if radius is None else [max(radius, *radii[-1:], 0.0)]
        if knot < len(radii):
            low = radii[max(knot - 1, 0)]
            return low + (radii[knot] - low) * (2.0 * ahead / (self._step * 2.0**knot) - 1.0)
        most = self._step * 2.0 ** (len(radii) - 1)
        return radii[-1] * ahead / most if radii and (self._is_stated or ahead <= _REACH * most) else None

    def _errors(self, ahead: float) -> list[float]:
        """Return how far forecasts so far ahead [s] were off, by time; only of alike spans, if enough."""
        times, gap = self._series.times, max(self._step, ahead / _GAPS)
        found = list[tuple[float, bool]]()
        last, turn = -1, math.floor((times[-1] - ahead) / gap)
        while len(found) < _ORIGINS and turn * gap >= times[0]:
            place = bisect_right(times, turn * gap) - 1
            if place != last and (error := self._error(place, ahead)) is not None:
                found.append(error)
            last, turn = place, turn - 1
        alike = [error for error, is_alike in found if is_alike]
        errors = (alike if _quantile(alike) is not None else [error for error, _ in found])[::-1]
        # that it never was off in n spans, one after the other, leaves a chance of 1 in n + 1 for the next
        is_known = self._is_stated or any(errors) or len(errors) * gap >= _ENOUGH * ahead
        return errors if is_known else []

    def _error(self, place: int, ahead: float) -> tuple[float, bool] | None:
        times, values = self._series
        then = times[place] + ahead
        came = bisect_left(times, then - _ROUNDING * ahead)
        if came == len(times) or (curve := self._fit(place, ahead)) is None:
            return None
        is_seldom = times[came] > then + 2 * self._step  # then it is what it was last
        came, then = (came - 1, then) if is_seldom else (came, times[came])
        value = curve.value(then)
        return None if value is None else (abs(values[came] - value), self._is_alike(times[place], then))


def _quantile(errors: Sequence[float]) -> float | None:
    """Return the bound that the next error keeps as often as an interval shall hold; None for too few errors."""
    chance, radius = 1.0 - LEVEL, None
    for count in range(_ENOUGH, len(errors) + 1):
        ranked, rank = sorted(errors[:count]), max(1, math.ceil((count + 1) * (1.0 - chance)))
        radius = ranked[rank - 1] if rank <= count else 2.0 * ranked[-1]  # beyond what can be told from so few
        chance += _PACE * (1.0 - LEVEL - any(error > radius for error in errors[count : count + 1]))
    return radius
