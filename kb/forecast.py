"""What an attribute will be, and until when an action stays feasible, as far as the past tells.

Forecasts are computed when they are asked for, and depend only on what was measured and done until
then. They only add caution: what is violated now stays violated.

A series of measurements is continued by a curve. Its interval is conformal (Vovk, Gammerman and
Shafer, "Algorithmic learning in a random world", 2005): forecasts from earlier points of the
series are compared with what was measured then. After misses it widens, after hits it narrows
(Gibbs and Candes, "Adaptive conformal inference under distribution shift", NeurIPS 2021).
"""

import logging
import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations, groupby, pairwise
from operator import itemgetter
from statistics import median
from typing import Any, Final, NamedTuple

from kb.elements import (
    FUNCTIONS,
    Attribute,
    Constraint,
    ForecastFunction,
    exact,
    finite_number,
    listed,
)
from kb.exceptions import InvalidValue
from kb.explanation import shortest, why
from kb.network import Node
from kb.records import RequiredAction
from kb.state import State
from kb.status import OPERATORS, Status
from kb.views import Readable

_log = logging.getLogger(__name__)

LEVEL: Final = 0.9
"""How often an interval shall contain what comes."""
_FEWEST_ERRORS, _MOST_ERRORS, _ERRORS_IN_HORIZON = 9, 40, 4
"""How many errors an interval needs and takes; more in a horizon would overlap."""
_ADAPTATION: Final = 0.1
"""How quickly an interval adapts after a hit or a miss."""
_REACH: Final = 4.0
"""How many times further ahead than its errors a forecast goes."""
_FEWEST_POINTS, _MOST_POINTS, _MOST_SAMPLES, _MOST_COMPUTED = 8, 24, 2048, 4096
_JUMP: Final = 10.0
"""A step against the rates that is so many times the usual one restores an attribute."""
_LOOKS, _HALVINGS = 128, 24
"""At how many instants a horizon is looked at; between two, a change is found by halving."""
_ROUNDING: Final = 1e-9
_WORSE, _EXPECTED, _BETTER = -1, 0, 1


@dataclass(frozen=True, slots=True)
class Curve:
    """The value at a time [s], and how it gets there, in words with "{}" for the unit.

    A guess uses a rate that was not learned yet.
    """

    value: Callable[[float], float | None]
    words: str = ""
    is_guess: bool = False


class Expectation(NamedTuple):
    """An expected value, how far it may be off if that is known, and how it gets there."""

    value: float
    radius: float | None
    words: str


class Series(NamedTuple):
    """Measurements by time [s]."""

    times: Sequence[float]
    values: Sequence[float]

    def part(self, first: int, last: int) -> "Series":
        """Return the measurements from one place to another, both included."""
        return Series(self.times[first : last + 1], self.values[first : last + 1])


def line(time: float, value: float, slope: float, words: str = "") -> Curve:
    """Continue from a point with a slope [1/s]."""
    change = "stays as it is"
    if slope:
        change = f"{'rises' if slope > 0 else 'falls'} by {abs(slope):.3g}{{}}/s"
    return Curve(lambda then: value + slope * (then - time), change + words)


def slope_of(series: Series) -> float | None:
    """Return the median slope between two points [1/s]; None for too few points.

    Nearly three in ten points may be arbitrarily wrong (Theil 1950, Sen 1968).
    """
    if len(series.times) < _FEWEST_POINTS:
        return None
    thinning = math.ceil(len(series.times) / _MOST_POINTS)
    points = list(zip(*series, strict=True))[::-thinning]
    slopes = [
        (value - other) / (time - before)
        for (time, value), (before, other) in combinations(points, 2)
    ]
    return median(slopes)


def jumps_in(series: Series) -> list[float]:
    """Return when an attribute was restored [s]: it jumped against its usual direction.

    No forecast is judged by what came after that. What only comes back from an outlier is no jump.
    """
    times, values = series
    steps = [value - before for before, value in pairwise(values)]
    usual = median(steps) if steps else 0.0
    if not usual:
        return []
    direction = math.copysign(1.0, usual)
    largest = _JUMP * median(map(abs, steps))
    return [
        times[place]
        for place in range(2, len(times))
        if (values[place - 1] - values[place]) * direction > largest
        and (values[place - 2] - values[place]) * direction > largest
    ]


def constant(series: Series, _: float) -> Curve:
    """Stay at the last value."""
    return line(series.times[-1], series.values[-1], 0.0)


def trend(series: Series, ahead: float) -> Curve | None:
    """Continue a robust line through the measurements of twice the time ahead [s]."""
    end = series.times[-1]
    fewest = max(len(series.times) - _FEWEST_POINTS, 0)
    first = min(fewest, bisect_left(series.times, end - 2 * ahead))
    latest = series.part(first, len(series.times) - 1)
    slope = slope_of(latest)
    if slope is None:
        return None
    heights = [value - slope * (time - end) for time, value in zip(*latest, strict=True)]
    return line(end, median(heights), slope)


def by_function(function: ForecastFunction, series: Series) -> Curve:
    """Continue as a function of the author says; an error is logged, and means unknown."""
    samples = tuple(zip(*series, strict=True))

    def value(then: float) -> float | None:
        try:
            forecast = function(samples, then)
            return None if forecast is None else finite_number(forecast)
        except Exception:
            _log.exception("the forecast %r failed", function)
            return None

    return Curve(value, "goes on as a function of the model's says")


class SeriesForecast:
    """How a series continues, and how far that may be off.

    Args:
        series: the measurements.
        fit: continues the series from one of its places, to be right about so far ahead [s].
        is_alike: whether a span of time from the past is like the one to come.
        is_trusted: a stated rate gives a value before it could be checked.
    """

    def __init__(
        self,
        series: Series,
        fit: Callable[[int, float], Curve | None],
        is_alike: Callable[[float, float], bool],
        is_trusted: bool,
    ) -> None:
        self._series = series
        self._fit = fit
        self._is_alike = is_alike
        self._jumps = jumps_in(series)
        self._is_trusted = is_trusted
        self._radii: list[float] = []
        self._is_complete = False
        self._curve = cache(lambda knot: fit(len(series.times) - 1, self._step * 2.0**knot))
        latest = series.times[-2 * _FEWEST_POINTS :]
        steps = sorted(time - before for before, time in pairwise(latest))
        self._step = 1.0
        if steps:
            self._step = 2.0 ** math.floor(math.log2(steps[len(steps) // 2]))

    def at(self, time: float) -> Expectation | None:
        """Return what is expected at a time [s]; None if that is not known."""
        ahead = max(time - self._series.times[-1], self._step)
        knot = math.ceil(math.log2(ahead / self._step) - _ROUNDING)
        radius = self._radius(knot, ahead)
        if radius is None and not self._is_trusted:
            return None
        curve = self._curve(knot)
        value = None if curve is None else curve.value(time)
        if curve is None or value is None:
            return None
        return Expectation(value, radius, curve.words)

    def _radius(self, knot: int, ahead: float) -> float | None:
        """Return how far a forecast may be off: linear between doublings of the step."""
        radii = self._radii
        while len(radii) <= knot and not self._is_complete:
            radius = _quantile(self._errors(self._step * 2.0 ** len(radii)))
            if radius is None:
                self._is_complete = True
            else:
                radii.append(max([radius, *radii[-1:]]))
        if knot < len(radii):
            low = radii[max(knot - 1, 0)]
            return low + (radii[knot] - low) * (2.0 * ahead / (self._step * 2.0**knot) - 1.0)
        farthest = self._step * 2.0 ** (len(radii) - 1)
        if radii and (self._is_trusted or ahead <= _REACH * farthest):
            return radii[-1] * ahead / farthest
        return None

    def _errors(self, ahead: float) -> list[float]:
        """Return how far earlier forecasts were off; only those of alike spans, if enough."""
        times = self._series.times
        gap = max(self._step, ahead / _ERRORS_IN_HORIZON)
        errors: list[float] = []
        alike: list[float] = []
        previous = -1
        turn = math.floor((times[-1] - ahead) / gap)
        while len(errors) < _MOST_ERRORS and turn * gap >= times[0]:
            place = bisect_right(times, turn * gap) - 1
            turn -= 1
            came = self._arrival(place, ahead)
            if place == previous or came is None:
                continue
            previous = place
            error = self._error(place, came, ahead)
            if error is None:
                continue
            errors.append(error)
            if self._is_alike(times[place], times[came]):
                alike.append(error)
        if _quantile(alike[::-1]) is not None:
            errors = alike
        # no error in n spans, one after the other, leaves a chance of 1 in n + 1 for the next
        is_evident = len(errors) * gap >= _FEWEST_ERRORS * ahead
        if self._is_trusted or is_evident or any(errors):
            return errors[::-1]
        return []

    def _arrival(self, place: int, ahead: float) -> int | None:
        """Return the place of the measurement that a forecast is compared with."""
        times = self._series.times
        then = times[place] + ahead
        came = bisect_left(times, then - _ROUNDING * ahead)
        if came == len(times):
            return None
        if times[came] > then + 2 * self._step:  # seldom measured: it is what it was last
            return came - 1
        return came

    def _error(self, place: int, came: int, ahead: float) -> float | None:
        times, values = self._series
        if bisect_right(self._jumps, times[place]) != bisect_right(self._jumps, times[came]):
            return None
        curve = self._fit(place, ahead)
        present = self._curve(0)
        if curve is None or present is None or curve.is_guess != present.is_guess:
            return None
        value = curve.value(max(times[came], min(times[place] + ahead, times[-1])))
        return None if value is None else abs(values[came] - value)


def _quantile(errors: Sequence[float]) -> float | None:
    """Return a bound of the next error at the level of intervals; None for too few."""
    chance = 1.0 - LEVEL
    radius = None
    for count in range(_FEWEST_ERRORS, len(errors) + 1):
        ranked = sorted(errors[:count])
        rank = max(1, math.ceil((count + 1) * (1.0 - chance)))
        # beyond the largest: more than so few errors can tell
        radius = ranked[rank - 1] if rank <= count else 2.0 * ranked[-1]
        is_missed = count < len(errors) and errors[count] > radius
        chance += _ADAPTATION * (1.0 - LEVEL - is_missed)
    return radius


class ActionHistory:
    """Which actions were done when, as far as that is on record."""

    def __init__(self, requests: Iterable[RequiredAction]) -> None:
        changes: list[tuple[float, bool, str]] = []
        for request in requests:
            changes.append((request.start, True, request.action))
            if request.end is not None:
                changes.append((request.end, False, request.action))
        self._times = [-math.inf]
        self._actions: list[frozenset[str]] = [frozenset()]
        for time, is_start, action in sorted(changes):
            actions = self._actions[-1]
            self._times.append(time)
            self._actions.append(actions | {action} if is_start else actions - {action})

    def between(self, start: float, end: float) -> Iterator[tuple[float, frozenset[str]]]:
        """Yield how long [s] which actions were done between two times [s], the latest first."""
        place = bisect_left(self._times, end) - 1
        while end > start:
            begin = max(start, self._times[place])
            if end > begin:
                yield end - begin, self._actions[place]
            end = begin
            place -= 1


class RateModel:
    """The rates of an attribute [unit/s], stated or learned from a series of its measurements."""

    def __init__(
        self,
        element: Attribute,
        series: Series,
        actions: ActionHistory,
        slope_between: Callable[[int, int], float | None],
    ) -> None:
        self._element = element
        self._series = series
        self._actions = actions
        self._slope_between = slope_between
        self._jumps = jumps_in(series)
        self._stated = {rate.while_: rate.per_s for rate in element.rates}
        self._pieces = self._find_pieces()

    def applying(self, actions: frozenset[str]) -> frozenset[str]:
        """Return the names of the rates that apply; empty for the one that always does."""
        return frozenset(name for name in self._stated if not name or name in actions)

    def curve(self, place: int, ahead: float, doing: frozenset[str] | None) -> Curve:
        """Continue from a place while actions are done; None: those on record."""
        time = self._series.times[place]
        value = self._series.values[place]
        slopes, guesses = self._slopes(place)

        def past_value(then: float) -> float:
            changes = [
                slopes[name] * span
                for span, actions in self._actions.between(time, then)
                for name in self.applying(actions)
            ]
            return clamped(self._element, value + math.fsum(changes))

        if doing is None:
            past = self._actions.between(time, time + ahead)
            names_then = {name for _, actions in past for name in self.applying(actions)}
            return Curve(past_value, is_guess=not guesses.isdisjoint(names_then))
        names = sorted(self.applying(doing))
        slope = math.fsum(slopes[name] for name in names)
        during = ", ".join(filter(None, names))
        future = line(time, value, slope, f" while {during}" if during else "")
        return Curve(future.value, future.words, not guesses.isdisjoint(names))

    def _slopes(self, place: int) -> tuple[dict[str, float], set[str]]:
        """Return the slope of each rate at a place, and the names of those not yet learned."""
        slopes = dict(self._stated)
        pending = {rate.while_ for rate in self._element.rates if rate.learns}
        latest_first = [piece for piece in reversed(self._pieces) if piece[0] < place]
        for first, last, rates in sorted(latest_first, key=lambda piece: len(piece[2])):
            learners = rates & pending
            if len(learners) != 1:
                continue
            slope = self._slope_between(first, min(last, place))
            if slope is None:
                continue
            (name,) = learners
            slopes[name] = slope - math.fsum(slopes[other] for other in rates - learners)
            pending.remove(name)
        return slopes, pending

    def _find_pieces(self) -> list[tuple[int, int, frozenset[str]]]:
        """Return the pieces in which the same rates apply, without jumps and bounds."""
        times, values = self._series
        rates_of_step: list[frozenset[str] | None] = []
        for place in range(1, len(times)):
            done = self._actions.between(times[place - 1], times[place])
            rates = {self.applying(actions) for _, actions in done}
            is_inside = self._is_inside(values[place - 1]) and self._is_inside(values[place])
            is_one_piece = len(rates) == 1 and is_inside and times[place] not in self._jumps
            rates_of_step.append(rates.pop() if is_one_piece else None)
        pieces = []
        for rates_of_piece, steps_of_piece in groupby(enumerate(rates_of_step), itemgetter(1)):
            numbers = [number for number, _ in steps_of_piece]
            if rates_of_piece is not None:
                pieces.append((numbers[0], numbers[-1] + 1, rates_of_piece))
        return pieces

    def _is_inside(self, value: float) -> bool:
        return self._element.low < value < self._element.high


# -------------------------------------------------------------------- of a knowledge base


class Forecast(NamedTuple):
    """The expected value of an attribute at a time [s], its interval, and why.

    `level` is how often the interval contains what comes. Value, low and high are None where they
    are not known.
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
    """When an action is expected to become unfeasible [s], and why; None: not within the horizon.

    `earliest` is for attributes at the worse ends of their intervals, `latest` for the better
    ends; `is_bounded` says whether the interval of the attribute that makes the action unfeasible
    is known.
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
        if self.at == self.now:
            return f"unfeasible now: {self.reason}"
        if self.at is None and self.earliest is None:
            return f"feasible for {self.within:g} s, as far as is known"
        earliest = self._in_seconds(self.earliest)
        if self.at is None:
            at_earliest = f"unfeasible in {earliest} s at the earliest: {self.reason}"
            return f"feasible for {self.within:g} s, as far as is known, {at_earliest}"
        at = self._in_seconds(self.at)
        interval = (
            f"{earliest or at} to {self._in_seconds(self.latest) or f'more than {self.within:g}'}"
        )
        if not self.is_bounded and self.earliest == self.latest:
            interval = "how exactly is not known"
        return f"unfeasible in {at} s ({interval}): {self.reason}"

    def _in_seconds(self, time: float | None) -> str:
        return "" if time is None else f"{time - self.now:.3g}"


class Forecaster:
    """Predicts attributes of a knowledge base; called, it forecasts one attribute."""

    def __init__(self, base: Any) -> None:  # noqa: ANN401  # a KnowledgeBase, made with this
        self._base = base
        self._forecasts: dict[str, tuple[object, SeriesForecast | str]] = {}
        self._computed: dict[object, Any] = {}
        self._history: tuple[object, ActionHistory] = ((), ActionHistory(()))

    def __call__(
        self, attribute: str, horizon: float, *, doing: Iterable[str] | None = None
    ) -> Forecast:
        """Forecast an attribute `horizon` s from now, by default with the required actions."""
        now = self._base.now
        then = now + _horizon(horizon)
        return self.at(attribute, then, now, self.doing(doing))

    def doing(self, actions: Iterable[str] | None) -> frozenset[str]:
        """Return the names of the actions done meanwhile; by default those required now."""
        if actions is None:
            return frozenset(request.action for request in self._base.required_actions)
        names = (
            (actions,) if isinstance(actions, str) else listed("the actions that are done", actions)
        )
        return frozenset(self._base.actions[name].name for name in names)

    def at(self, attribute: str, time: float, now: float, doing: frozenset[str]) -> Forecast:
        """Forecast an attribute for a time [s] while actions are done."""
        name = self._base.attributes[attribute].name
        element = self._base.model.attributes[name]
        ahead = f"{time - now:.3g} s"
        forecast = self.series_forecast(name, doing)
        expected = None if isinstance(forecast, str) else forecast.at(time)
        if expected is None:
            why_not = (
                forecast
                if isinstance(forecast, str)
                else "too little was measured to go so far ahead"
            )
            reason = f"it is not known what {name} is in {ahead}: {why_not}"
            return Forecast(name, time, None, None, None, LEVEL, reason)
        value = clamped(element, expected.value)
        words = expected.words.format(element.amount(""))
        constraints = self._base.model.constraints
        thresholds = [
            constraint.value for constraint in constraints if constraint.attribute == name
        ]
        shown = element.amount(shortest(value, thresholds))
        low = high = None
        span = "how exactly is not known"
        if expected.radius is not None:
            low = clamped(element, expected.value - expected.radius)
            high = clamped(element, expected.value + expected.radius)
            span = f"{low:.3g} to {high:.3g}"
        reason = f"{name} is {shown} ({span}) in {ahead}: it {words}"
        return Forecast(name, time, value, low, high, LEVEL, reason)

    def series_forecast(self, attribute: str, doing: frozenset[str]) -> SeriesForecast | str:
        """Return how an attribute continues while actions are done, or why that is not known."""
        element = self._base.model.attributes[attribute]
        view = self._base.attributes[attribute]
        if not element.forecasting and not element.rates:
            return "its model says nothing of that (see Attribute.forecast)"
        if view.value is None:
            return "it is not measured"
        if view.is_stale:
            return "what was measured is stale"
        requests = self._base.history.actions
        ends = tuple((request.number, request.end) for request in requests)
        if self._history[0] != ends:
            self._history = (ends, ActionHistory(requests))
        key = (view.time, view.value, ends, doing, element.forecasting, element.rates)
        cached = self._forecasts.get(attribute)
        if cached is None or cached[0] != key:
            latest = dict(view.history[-_MOST_SAMPLES:])  # of one instant, the last
            series = Series(tuple(latest), tuple(latest.values()))
            cached = (key, self._continue(element, series, doing))
            self._forecasts[attribute] = cached
        return cached[1]

    def _continue(
        self, element: Attribute, series: Series, doing: frozenset[str]
    ) -> SeriesForecast | str:
        actions = self._history[1]

        def slope_between(first: int, last: int) -> float | None:
            times = series.times
            key = ("slope", element.name, times[first], times[last], series.values[last])
            slope: float | None = self._once(key, lambda: slope_of(series.part(first, last)))
            return slope

        rates = RateModel(element, series, actions, slope_between)
        method = element.forecasting
        if not method or rates.applying(doing):
            last = len(series.times) - 1
            applying = rates.applying(doing)
            return SeriesForecast(
                series,
                lambda place, ahead: rates.curve(place, ahead, doing if place == last else None),
                lambda start, end: all(
                    rates.applying(done) == applying for _, done in actions.between(start, end)
                ),
                is_trusted=True,
            )
        function = FUNCTIONS.get(method)
        if ":" in method and function is None:
            return f"it is forecast by the function {method}, which this program has not given"

        def fit(place: int, ahead: float) -> Curve | None:
            past = series.part(0, place)
            if function is not None:
                return by_function(function, past)
            if method == "constant":
                return constant(past, ahead)
            key = ("trend", element.name, past.times[-1], past.values[-1], ahead)
            curve: Curve | None = self._once(key, lambda: trend(past, ahead))
            return curve

        def is_alike(start: float, end: float) -> bool:
            return all(done <= doing for _, done in actions.between(start, end))

        return SeriesForecast(series, fit, is_alike, is_trusted=False)

    def _once(self, key: object, compute: Callable[[], Any]) -> Any:  # noqa: ANN401  # as computed
        """Return what follows from a part of the past, which never changes; it is computed once."""
        if key not in self._computed:
            if len(self._computed) >= _MOST_COMPUTED:
                self._computed.clear()
            self._computed[key] = compute()
        return self._computed[key]


def feasible_until(
    base: Readable, action: str, within: float = 300.0, *, doing: Iterable[str] | None = None
) -> FeasibleUntil:
    """Return until when an action stays feasible, looking ahead by `within` [s].

    Meanwhile the actions of `doing` are done: by default those required now, or only this one if
    it is not among them.
    """
    now = base.now
    ahead = _horizon(within)
    with base.reading() as state:
        node = state.network.actions[action]
        if state.status[node] is Status.UNFEASIBLE:
            return FeasibleUntil(node.name, now, now, now, why(state, node, now), now, ahead)
        if doing is None and node not in state.requested:
            doing = (node.name,)
        search = _Search(base, state, node, now, ahead, base.forecast.doing(doing))
        expected = search.first(_EXPECTED)
        earliest = search.first(_WORSE)
        latest = search.first(_BETTER)
    first = expected or earliest or latest
    if first is None:
        reason = "nothing is known that makes it unfeasible"
        return FeasibleUntil(node.name, None, None, None, reason, now, ahead)
    return FeasibleUntil(
        node.name,
        None if expected is None else expected.time,
        None if earliest is None else earliest.time,
        None if latest is None else latest.time,
        first.reason,
        now,
        ahead,
        first.is_bounded,
    )


class _Unfeasible(NamedTuple):
    time: float
    reason: str
    is_bounded: bool


class _Search:
    """Looks for the first instant at which an action is unfeasible by the forecasts."""

    def __init__(
        self,
        base: Readable,
        state: State,
        action: Node,
        now: float,
        within: float,
        doing: frozenset[str],
    ) -> None:
        self._state = state
        self._action = action
        self._instants = [now + within * look / _LOOKS for look in range(_LOOKS + 1)]
        self._is_unfeasible_with: dict[tuple[Node, ...], bool] = {(): False}
        self._expected: dict[Node, Callable[[float], Expectation | None]] = {}
        for constraint in dict.fromkeys(_constraints(action)):
            forecast = base.forecast.series_forecast(constraint.requires[0].name, doing)
            is_satisfied = state.status[constraint] is Status.SATISFIED
            if is_satisfied and not isinstance(forecast, str):
                self._expected[constraint] = cache(forecast.at)

    def first(self, side: int) -> _Unfeasible | None:
        """Return the first instant, for one end of the intervals; None if there is none."""
        for before, time in pairwise(self._instants):
            if not self._is_unfeasible(time, side):
                continue
            for _ in range(_HALVINGS):
                middle = (before + time) / 2
                if self._is_unfeasible(middle, side):
                    time = middle
                else:
                    before = middle
            return self._described(before, time, side)
        return None

    def _described(self, before: float, time: float, side: int) -> _Unfeasible:
        violated = self._violated(time, side)
        already = self._violated(before, side)
        new = [constraint for constraint in violated if constraint not in already]
        node = (new or violated)[0]
        expected = self._expected[node](time)
        assert expected is not None
        change = expected.words.format(node.attribute.amount(""))
        threshold = node.attribute.amount(exact(node.constraint.value))
        reason = f"{node.attribute.name} {change} and reaches {threshold}"
        return _Unfeasible(time, reason, expected.radius is not None)

    def _violated(self, time: float, side: int) -> tuple[Node, ...]:
        return tuple(
            node
            for node, expected_at in self._expected.items()
            if _is_violated(node, expected_at(time), side)
        )

    def _is_unfeasible(self, time: float, side: int) -> bool:
        nodes = self._violated(time, side)
        if nodes not in self._is_unfeasible_with:
            supposed = self._state.copy()
            for node in nodes:
                supposed.hold(node, Status.VIOLATED)
            supposed.infer()
            status = supposed.status[self._action]
            self._is_unfeasible_with[nodes] = status is Status.UNFEASIBLE
        return self._is_unfeasible_with[nodes]


def _is_violated(node: Node, expected: Expectation | None, side: int) -> bool:
    """Return whether a constraint is violated at one end of an expected interval."""
    if expected is None:
        return False
    constraint = node.constraint
    upwards = 1 if constraint.operator in (">=", ">") else -1
    value = expected.value + side * upwards * (expected.radius or 0.0)
    return not OPERATORS[constraint.operator](clamped(node.attribute, value), constraint.value)


def is_violated_then(constraint: Constraint, forecast: Forecast) -> bool:
    """Return whether the worse end of a forecast's interval violates a constraint."""
    worse = forecast.low if constraint.operator in (">=", ">") else forecast.high
    value = forecast.value if worse is None else worse
    return value is not None and not OPERATORS[constraint.operator](value, constraint.value)


def suppose_forecast(state: State, node: Node, forecast: Forecast) -> None:
    """Enter what is forecast for an attribute in a copy of a state.

    A constraint is violated if it is now, or if the worse end of the interval violates it, and
    else stays as it is.
    """
    if forecast.value is None:
        return
    for constraint in node.constraints:
        if is_violated_then(constraint.constraint, forecast):
            state.hold(constraint, Status.VIOLATED)
        else:
            state.hold(constraint, state.status[constraint])
    state.value[node] = forecast.value
    state.time.pop(node, None)
    state.give_reason("forecast", node, forecast.reason)


def _constraints(node: Node) -> Iterator[Node]:
    """Yield the constraints on an element and on what it needs."""
    yield from node.constraints
    for part in node.requires:
        yield from _constraints(part)


def clamped(element: Attribute, value: float) -> float:
    """Return the value of an attribute's range that is nearest."""
    return min(max(value, element.low), element.high)


def _horizon(horizon: float) -> float:
    number = finite_number(horizon)
    if number >= 0:
        return number
    raise InvalidValue(f"a horizon is a time in seconds from 0, not {horizon!r}")
