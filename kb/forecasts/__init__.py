"""What an attribute will be, and until when an action stays feasible, as far as the past tells.

Forecasts are computed when they are asked for, and depend only on what was measured and done until then: the same
events give the same answers. A forecast only adds caution: what is violated now stays violated, whatever is forecast.

A series of measurements is continued by a curve, with an interval from how far such curves were off so far. Intervals
are conformal (Vovk, Gammerman and Shafer, "Algorithmic learning in a random world", 2005): forecasts from earlier
points of the same series are compared with what was measured then, and the interval is as wide as would have held those
values often enough. After misses it widens, after hits it narrows (Gibbs and Candes, "Adaptive conformal inference
under distribution shift", NeurIPS 2021).
"""

import logging
import math
import operator
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from itertools import combinations, groupby, pairwise
from statistics import median
from typing import Any, Final, NamedTuple

from kb.elements import FUNCTIONS, Attribute, exact, finite_number, listed
from kb.exceptions import InvalidValue
from kb.explanation import reading, why
from kb.knowledge import Knowledge
from kb.network import Node
from kb.records import RequiredAction
from kb.state import Overlay, State, propagate
from kb.status import OPERATORS, Status
from kb.views import Readable

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


def straight(time: float, value: float, slope: float, words: str = "") -> Curve:
    """Go on from a point with a slope [1/s]."""
    way = (
        f"{'rises' if slope > 0 else 'falls'} by {abs(slope):.3g}{{}}/s"
        if slope
        else "stays as it is"
    )
    return Curve(lambda then: value + slope * (then - time), way + words)


def slope_of(series: Series) -> float | None:
    """Return the median of the slopes between any two points, thinned out [1/s] (Theil 1950, Sen 1968).

    Nearly three in ten points may be arbitrarily wrong; None of too few points.
    """
    points = list(zip(*series, strict=True))[
        :: -max(1, math.ceil(len(series.times) / _MOST_POINTS))
    ]
    slopes = [
        (two[1] - one[1]) / (two[0] - one[0])
        for one, two in combinations(points, 2)
        if two[0] != one[0]
    ]
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
        swings = np.linalg.solve(
            basis @ basis.transpose(0, 2, 1) + _ROUNDING * np.eye(3), basis @ values[:, None]
        )
        rest = values - (swings.transpose(0, 2, 1) @ basis)[:, 0]
        return (rest * rest).sum(axis=1)

    end = series.times[-1]
    width = (end - series.times[-_WAVE_POINTS:][0]) / _WAVE_POINTS
    while True:
        found = sorted(
            {bisect_right(series.times, end - width * back) for back in range(_WAVE_POINTS)} - {0}
        )
        times = np.array([series.times[place - 1] - end for place in found])
        values = np.array([series.values[place - 1] for place in found])
        span = -float(times[0])
        if len(found) < _LEAST_POINTS or not span:
            return None
        periods = np.geomspace(4 * width, 3 * span, _PERIODS)
        for _ in range(_ROUNDS):
            best = int(np.argmin(misfits(periods)))
            periods = np.linspace(
                periods[max(best - 1, 0)], periods[min(best + 1, len(periods) - 1)], _MOST_POINTS
            )
        period = float(periods[int(np.argmin(misfits(periods)))])
        if period < _SEEN * span or end - width * _WAVE_POINTS < series.times[0]:
            break
        width *= 2
    waves = range(1, 3 if period < _SEEN * span else 2)
    angles = [2 * math.pi * wave / period for wave in waves]
    columns = [
        np.ones_like(times),
        *(one(angle * times) for angle in angles for one in (np.cos, np.sin)),
    ]
    base, *swings = np.linalg.lstsq(np.stack(columns, axis=1), values, rcond=None)[0].tolist()
    low, high = float(values.min()), float(values.max())
    low, high = 2 * low - high, 2 * high - low

    def value(then: float) -> float:
        turns = [wave(angle * (then - end)) for angle in angles for wave in (math.cos, math.sin)]
        return float(min(max(base + sum(map(operator.mul, swings, turns)), low), high))

    return Curve(value, f"goes up and down every {period:.3g} s")


def by_function(
    function: Callable[[Sequence[tuple[float, float]], float], float | None], series: Series
) -> Curve:
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


WAYS: Final[Mapping[str, Callable[[Series, float], Curve | None]]] = {
    "constant": lambda series, _: straight(series.times[-1], series.values[-1], 0.0),
    "trend": trend,
    "periodic": periodic,
}


class Outlook:
    """How one series goes on, and how far that may be off, for each time ahead.

    `fit` continues the series from one of its points, to be right about so far ahead [s]. Spans of time are alike if
    the same actions are done in both. A stated rate is trusted, however little was measured.
    """

    def __init__(
        self, series: Series, fit: Fit, is_alike: Callable[[float, float], bool], is_stated: bool
    ) -> None:
        self._series, self._fit, self._is_alike, self._is_stated = series, fit, is_alike, is_stated
        steps = sorted(
            two - one for one, two in pairwise(series.times[-2 * _LEAST_POINTS :]) if two > one
        )
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
        return (
            radii[-1] * ahead / most
            if radii and (self._is_stated or ahead <= _REACH * most)
            else None
        )

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
        return (
            None
            if value is None
            else (abs(values[came] - value), self._is_alike(times[place], then))
        )


def _quantile(errors: Sequence[float]) -> float | None:
    """Return the bound that the next error keeps as often as an interval shall hold; None for too few errors."""
    chance, radius = 1.0 - LEVEL, None
    for count in range(_ENOUGH, len(errors) + 1):
        ranked, rank = sorted(errors[:count]), max(1, math.ceil((count + 1) * (1.0 - chance)))
        radius = (
            ranked[rank - 1] if rank <= count else 2.0 * ranked[-1]
        )  # beyond what can be told from so few
        chance += _PACE * (1.0 - LEVEL - any(error > radius for error in errors[count : count + 1]))
    return radius


# -------------------------------------------------------------------- of a knowledge base

_MOST_SAMPLES, _MOST_REQUESTS, _MOST_FITS = 2048, 64, 4096
_LOOKS, _HALVINGS = 128, 24
"""At how many instants a horizon is looked at, and how often it is halved where something changes between two."""
_WORSE, _EXPECTED, _BETTER = -1, 0, 1
_At = Callable[[float], Expected | None]
_Slopes = tuple[
    dict[str, float], set[str]
]  # by action [1/s], and those of which nothing was learned yet


class Forecast(NamedTuple):
    """The expected value of an attribute at a time [s, by the clock], its interval from low to high, and why.

    `level` is how often the interval holds what comes. Value, low and high are None where they are not known.
    """

    attribute: str
    at: float
    value: float | None
    low: float | None
    high: float | None
    level: float
    reason: str

    def __str__(self) -> str:
        return self.reason


class FeasibleUntil(NamedTuple):
    """When an action is expected to become unfeasible [s, by the clock], and why; None: not `within` s from `now`.

    `earliest` is for attributes at the worse ends of their intervals, `latest` for the better ends; `is_bounded` tells
    whether the interval of the attribute that makes the action unfeasible is known.
    """

    action: str
    at: float | None
    earliest: float | None
    latest: float | None
    reason: str
    now: float
    within: float
    is_bounded: bool = False

    def __str__(self) -> str:
        at, earliest, latest = (
            f"{one - self.now:.3g}" if one is not None else "" for one in self[1:4]
        )
        if self.at == self.now:
            return f"unfeasible now: {self.reason}"
        if at:
            between = f"{earliest or at} to {latest or f'more than {self.within:g}'}"
            exactly = (
                between
                if self.is_bounded or self.earliest != self.latest
                else "how exactly is not known"
            )
            return f"unfeasible in {at} s ({exactly}): {self.reason}"
        first = f", unfeasible in {earliest} s at the earliest: {self.reason}" if earliest else ""
        return f"feasible for {self.within:g} s, as far as is known{first}"


class _Deeds:
    """Which actions were done when, as far as that is on record."""

    def __init__(self, requests: Sequence[RequiredAction]) -> None:
        spans = [
            (one.start, math.inf if one.end is None else one.end, one.action) for one in requests
        ]
        self._times = [-math.inf, *sorted({time for *span, _ in spans for time in span})]
        self._doing = [
            frozenset(one for start, end, one in spans if start <= time < end)
            for time in self._times
        ]

    def between(self, start: float, end: float) -> Iterator[tuple[float, float, frozenset[str]]]:
        """Yield the spans between two times [s] within which the same was done, the latest first."""
        place = bisect_right(self._times, end) - 1
        while end > start:
            begin = max(start, self._times[place])
            if end > begin:
                yield begin, end, self._doing[place]
            end, place = begin, place - 1


class Forecaster:
    """Looks ahead for a knowledge base; called, it forecasts an attribute."""

    def __init__(self, base: Readable, known: Knowledge) -> None:
        self._base, self._known = base, known
        self._outlooks: dict[int, tuple[object, Outlook | str]] = {}
        self._fits: dict[object, Any] = {}
        self._deeds: tuple[object, _Deeds] = None, _Deeds(())

    def __call__(
        self, attribute: str, horizon: float, *, doing: Iterable[str] | None = None
    ) -> Forecast:
        """Forecast an attribute `horizon` s from now, while actions are done; by default those required now."""
        now, ahead = self._base.now, _horizon(horizon)
        with self._base.reading() as state:
            node = state.network.attributes[attribute]
            return self.at(state, node, now + ahead, now, self.doing(state, doing))

    def doing(self, state: State, given: Iterable[str] | None) -> frozenset[str]:
        """Return the names of the actions that are done meanwhile."""
        if given is None:
            return frozenset(self._known.records.required)
        names = (given,) if isinstance(given, str) else listed("the actions that are done", given)
        return frozenset(state.network.actions[name].name for name in names)

    def at(
        self, state: State, node: Node, time: float, now: float, doing: frozenset[str]
    ) -> Forecast:
        """Forecast an attribute for a time [s] while something is done."""
        outlook = self.outlook(state, node, doing)
        too_far = "too little was measured to go so far ahead"
        expected = outlook if isinstance(outlook, str) else outlook.at(time) or too_far
        if isinstance(expected, str):
            reason = f"it is not known what {node.name} is in {time - now:.3g} s: {expected}"
            return Forecast(node.name, time, None, None, None, LEVEL, reason)
        value, radius, words = (
            expected[0],
            expected[1],
            expected[2].format(node.attribute.amount("")),
        )
        low, value, high = (
            _possible(node, value + side * (radius or 0.0)) for side in (_WORSE, _EXPECTED, _BETTER)
        )
        span = "how exactly is not known" if radius is None else f"{low:.3g} to {high:.3g}"
        shown = reading(value, state.network.thresholds(node).around(value), node)
        reason = f"{node.name} is {shown} ({span}) in {time - now:.3g} s: it {words}"
        is_known = radius is not None
        return Forecast(
            node.name,
            time,
            value,
            low if is_known else None,
            high if is_known else None,
            LEVEL,
            reason,
        )

    def outlook(self, state: State, node: Node, doing: frozenset[str]) -> Outlook | str:
        """Return how an attribute goes on while these actions are done, or why that is not known."""
        element, history = node.attribute, state.histories.get(node.index)
        if not element.forecasting and not element.rates:
            return "its model says nothing of that (see Attribute.forecast)"
        if state.value[node.index] is None or history is None or not history.pairs:
            return "it is not measured"
        if state.stale[node.index]:
            return "what was measured is stale"
        requests = self._known.records.requests
        past = next(reversed(requests), 0), self._known.records.last_end
        key = (
            *history.pairs[-2:],
            len(history.pairs),
            history.begins,
            past,
            doing,
            element.forecasting,
            element.rates,
        )
        known = self._outlooks.get(node.index)
        if known is None or known[0] != key:
            if self._deeds[0] != past:
                self._deeds = past, _Deeds(list(requests.values())[-_MOST_REQUESTS:])
            series = Series(history.pairs[::2], history.pairs[1::2])
            known = self._outlooks[node.index] = (
                key,
                self._made(node, series, history.begins, doing),
            )
        return known[1]

    def _once(self, key: object, make: Callable[[], Any]) -> Any:  # noqa: ANN401  # what is made
        """Return what is computed from a point of the past, which never changes; it is computed once."""
        if key not in self._fits:
            if len(self._fits) >= _MOST_FITS:
                self._fits.clear()
            self._fits[key] = make()
        return self._fits[key]

    def _made(
        self, node: Node, series: Series, begins: float, doing: frozenset[str]
    ) -> Outlook | str:
        element, deeds, last = node.attribute, self._deeds[1], len(series.times) - 1
        way, function = element.forecasting, FUNCTIONS.get(element.forecasting)
        is_stated = not way or any(
            not rate.while_ or rate.while_ in doing for rate in element.rates
        )
        if not is_stated and ":" in way and function is None:
            return f"it is forecast by the function {way}, which this program has not given"

        def fit(place: int, ahead: float) -> Curve | None:
            past = series.between(series.times[max(0, place - _MOST_SAMPLES)], series.times[place])
            key = node.index, begins, past.times[-1], past.values[-1]
            if is_stated:
                rates = self._once((*key, element.rates), lambda: _slopes(element, past, deeds))
                return _rated(node, rates, past, deeds, doing if place == last else None)
            if function is not None:
                return by_function(function, past)
            made: Curve | None = self._once(
                (*key, way, way == "trend" and ahead), lambda: WAYS[way](past, ahead)
            )
            return made

        return Outlook(
            series,
            fit,
            lambda *span: {doing}.issuperset(one[2] for one in deeds.between(*span)),
            is_stated,
        )


def feasible_until(
    base: Readable, action: str, within: float = 300.0, *, doing: Iterable[str] | None = None
) -> FeasibleUntil:
    """Say until when an action stays feasible, looking ahead by `within` [s], while the actions of `doing` are done.

    By default these are the actions that are required now, or only this one if it is not among them.
    """
    now, ahead = base.now, _horizon(within)
    with base.reading() as state:
        node = state.network.actions[action]
        if state.status[node.index] is Status.UNFEASIBLE:
            return FeasibleUntil(node.name, now, now, now, why(state, node, now), now, ahead)
        done = base.forecast.doing(
            state, (node.name,) if doing is None and not state.requested[node.index] else doing
        )
        constraints = [
            one
            for one in dict.fromkeys(_constraints(node))
            if state.status[one.index] is Status.SATISFIED
        ]
        outlooks = {one: base.forecast.outlook(state, one.parts[0], done) for one in constraints}
        known = {
            one: cache(outlook.at)
            for one, outlook in outlooks.items()
            if isinstance(outlook, Outlook)
        }
        found = [
            _first(state, node, known, now, ahead, side) for side in (_EXPECTED, _WORSE, _BETTER)
        ]
    at, earliest, latest = (None if one is None else one[0] for one in found)
    first = next(
        (one for one in found if one is not None),
        (0.0, "nothing is known that makes it unfeasible", False),
    )
    return FeasibleUntil(node.name, at, earliest, latest, first[1], now, ahead, first[2])


def _first(
    state: State, action: Node, known: Mapping[Node, _At], now: float, within: float, side: int
) -> tuple[float, str, bool] | None:
    """Return when an action becomes unfeasible, why, and whether how exactly is known; None if not in the horizon."""
    found: dict[tuple[Node, ...], bool] = {(): False}

    def violated(time: float) -> tuple[Node, ...]:
        return tuple(one for one, at in known.items() if _is_violated(one, at(time), side))

    def is_unfeasible(nodes: tuple[Node, ...]) -> bool:
        if nodes not in found:
            layer = Overlay(state)
            for node in nodes:
                layer.verdict[node.index] = Status.VIOLATED
            propagate(layer, nodes)
            found[nodes] = layer.status[action.index] is Status.UNFEASIBLE
        return found[nodes]

    for before, time in pairwise(now + within * look / _LOOKS for look in range(_LOOKS + 1)):
        if is_unfeasible(violated(time)):
            for _ in range(_HALVINGS):
                middle = (before + time) / 2
                before, time = (
                    (before, middle) if is_unfeasible(violated(middle)) else (middle, time)
                )
            nodes, already = violated(time), violated(before)
            one = next((one for one in nodes if one not in already), nodes[0])
            _, radius, words = known[one](time) or (0.0, None, "")
            threshold = one.attribute.amount(exact(one.constraint.value))
            reason = f"{one.attribute.name} {words.format(one.attribute.amount(''))} and reaches {threshold}"
            return time, reason, radius is not None
    return None


def _is_violated(node: Node, expected: Expected | None, side: int) -> bool:
    """Tell whether a constraint is violated by what is expected, or at the worse or better end of the interval."""
    if expected is None:
        return False
    far = side * (expected[1] or 0.0) * (1 if node.constraint.operator in (">=", ">") else -1)
    return not OPERATORS[node.constraint.operator](
        _possible(node, expected[0] + far), node.constraint.value
    )


def suppose_forecast(state: State, node: Node, forecast: Forecast) -> Sequence[Node]:
    """Enter what is forecast for an attribute in a layer; returns the constraints whose status it may change.

    A constraint is violated if it is now, or if the worse end of the interval violates it, and else stays as it is.
    """
    if forecast.value is None:
        return ()
    for one in node.constraints:
        worse = forecast.low if one.constraint.operator in (">=", ">") else forecast.high
        is_so = OPERATORS[one.constraint.operator](
            forecast.value if worse is None else worse, one.constraint.value
        )
        state.verdict[one.index] = state.status[one.index] if is_so else Status.VIOLATED
    state.value[node.index], state.time[node.index] = forecast.value, None
    state.give_reason("forecast", node, forecast.reason)
    return node.constraints


def _constraints(node: Node) -> Iterator[Node]:
    """Yield the constraints on an element and on what it needs."""
    yield from node.constraints
    for part in node.parts:
        yield from _constraints(part)


def _slopes(element: Attribute, past: Series, deeds: _Deeds) -> _Slopes:
    """Return the rate of each action [unit/s]: as stated, or, if it learns, as measured when last done alone."""
    slopes, guessed = {rate.while_: rate.per_s for rate in element.rates}, set[str]()
    for name in [rate.while_ for rate in element.rates if rate.learns]:
        alone = (
            span
            for *span, done in deeds.between(past.times[0], past.times[-1])
            if done == {name} - {""}
        )
        parts = (
            part
            for span in alone
            for part in reversed(past.between(*span).inside(element.low, element.high))
        )
        learned = next((slope for slope in map(slope_of, parts) if slope is not None), None)
        if learned is None:
            guessed.add(name)
        else:
            slopes[name] = learned
    return slopes, guessed


def _rated(
    node: Node, rates: _Slopes, past: Series, deeds: _Deeds, doing: frozenset[str] | None
) -> Curve:
    """Go on with the rates of the actions that are done; without any given, of those that were done at each time."""
    (slopes, guessed), time, value = rates, past.times[-1], past.values[-1]
    if doing is not None:
        applying = [name for name in slopes if not name or name in doing]
        names = ", ".join(filter(None, applying))
        way = straight(
            time,
            value,
            math.fsum(map(slopes.__getitem__, applying)),
            f" while {names}" if names else "",
        )
        return Curve(way.value, way.words, not guessed.isdisjoint(applying))

    def at(then: float) -> float:
        spans = list(deeds.between(time, then))
        done = [
            slopes[name] * (end - begin)
            for name in slopes
            for begin, end, one in spans
            if not name or name in one
        ]
        return _possible(node, value + math.fsum(done))

    return Curve(at, "")


def _possible(node: Node, value: float) -> float:
    return min(max(value, node.attribute.low), node.attribute.high)


def _horizon(given: float) -> float:
    if (horizon := finite_number(given)) >= 0:
        return horizon
    raise InvalidValue(f"a horizon is a time in seconds from 0, not {given!r}")
