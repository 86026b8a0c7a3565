"""Predicts attributes, and until when an action stays feasible.

A forecast continues the measurements by a straight line. It depends only on what was measured and
done until then. Its interval is conformal (Vovk, Gammerman and Shafer, "Algorithmic learning in a
random world", 2005): the same forecast from earlier measurements is compared with what came.
After misses it widens, after hits it narrows (Gibbs and Candes, "Adaptive conformal inference
under distribution shift", NeurIPS 2021).
"""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, lru_cache, partial
from itertools import combinations, groupby, pairwise
from statistics import median
from typing import Any, Final, NamedTuple

from kb.elements import Attribute, Constraint, exact, finite_number, listed
from kb.exceptions import InvalidValue
from kb.explain import shortest, why
from kb.network import Node
from kb.records import RequiredAction
from kb.state import State
from kb.status import OPERATORS, Status

LEVEL: Final = 0.9
"""How often an interval shall contain what comes."""
_FEWEST_ERRORS: Final = 9
_MOST_ERRORS: Final = 40
_ERRORS_IN_HORIZON: Final = 4
"""More errors in a horizon would overlap."""
_ADAPTATION: Final = 0.1
"""How quickly an interval adapts after a hit or a miss."""
_REACH: Final = 4.0
"""How many times further ahead than it was checked a forecast goes."""
_FEWEST_POINTS: Final = 8
_MOST_POINTS: Final = 24
"""How many points the slope of a line is taken from."""
_MOST_SAMPLES: Final = 1024
_JUMP: Final = 10.0
"""A step against the usual direction that is so many times the usual one restores an attribute."""
_LOOKS: Final = 128
"""At how many instants a horizon is looked at."""
_TICKS: Final = 2**20
"""How finely the span between two looks is searched."""
_ROUNDING: Final = 1e-9
_WORSE = -1
_EXPECTED = 0
_BETTER = 1


class Series(NamedTuple):
    """Measurements by time [s]."""

    times: Sequence[float]
    values: Sequence[float]

    def part(self, first: int, last: int) -> "Series":
        """Return the measurements from one place to another, both included."""
        return Series(self.times[first : last + 1], self.values[first : last + 1])


@lru_cache(maxsize=4096)
def slope_of(series: Series) -> float | None:
    """Return the median slope between two points [1/s]; None for too few points.

    Nearly three in ten points may be arbitrarily wrong (Theil 1950, Sen 1968).
    """
    if len(series.times) < _FEWEST_POINTS:
        return None
    thinning = math.ceil(len(series.times) / _MOST_POINTS)
    points = list(zip(*series, strict=True))[::-thinning]
    return median(
        (value - earlier) / (time - before)
        for (time, value), (before, earlier) in combinations(points, 2)
    )


def restorations(values: Sequence[float]) -> list[int]:
    """Return how often an attribute was restored until each measurement.

    It jumped against its usual direction then. What only comes back from an outlier is no jump.
    """
    steps = [value - before for before, value in pairwise(values)]
    usual = median(steps or [0.0])
    largest = _JUMP * median(map(abs, steps)) if usual else math.inf
    counts = [0, 0]
    for place in range(2, len(values)):
        rises = [(before - values[place]) * usual for before in values[place - 2 : place]]
        counts.append(counts[-1] + (min(rises) > largest * abs(usual)))
    return counts


def rates_by_measurement(
    element: Attribute, times: Sequence[float], requests: Iterable[RequiredAction]
) -> list[frozenset[str]]:
    """Return the names of the rates that applied from each measurement on.

    The name of a rate is that of its action; it is empty if the rate always applies.
    """
    changes = []
    for request in requests:
        changes.append((request.start, request.action, True))
        if request.end is not None:
            changes.append((request.end, request.action, False))
    changes.sort(reverse=True)
    actions = {""}
    names = []
    for time in times:
        while changes and changes[-1][0] <= time:
            _, action, is_start = changes.pop()
            (actions.add if is_start else actions.discard)(action)
        names.append(_applying(element, actions))
    return names


def _applying(element: Attribute, actions: Iterable[str]) -> frozenset[str]:
    return frozenset({rate.while_ for rate in element.rates} & {"", *actions})


class Forecast(NamedTuple):
    """The expected value of an attribute at a time [s], its interval, and why.

    `level` is how often the interval contains what comes. Value, low and high are None where they
    are not known. `change` says how the attribute gets there.
    """

    attribute: str
    at: float
    value: float | None
    low: float | None
    high: float | None
    level: float
    reason: str
    change: str = ""

    def __str__(self) -> str:
        return self.reason


def _unknown(attribute: str, why_not: str, time: float, now: float) -> Forecast:
    reason = f"it is not known what {attribute} is in {time - now:.3g} s: {why_not}"
    return Forecast(attribute, time, None, None, None, LEVEL, reason)


class Course:
    """How an attribute goes on from its measurements.

    Args:
        node: the attribute.
        series: its measurements.
        rates: the names of the rates that apply from each measurement on; those of the last one
            apply as far as the forecast goes.
        is_stated: somebody states what is done meanwhile. Else the errors include what came of
            actions that began or ended.
    """

    def __init__(
        self, node: Node, series: Series, rates: list[frozenset[str]], is_stated: bool
    ) -> None:
        self._node = node
        self._element = node.attribute
        self._series = series
        self._rates = rates
        self._restorations = restorations(series.values)
        self._slopes = {rate.while_: rate.per_s for rate in self._element.rates}
        self._unlearned = {rate.while_ for rate in self._element.rates if rate.learns}
        self._learn()
        self._is_by_rates = bool(rates[-1]) or not self._element.forecasting
        self._is_steady = self._is_by_rates and (is_stated or not any(self._slopes))
        steps = [time - before for before, time in pairwise(series.times[-2 * _FEWEST_POINTS :])]
        self._step = 2.0 ** math.floor(math.log2(median(steps or [1.0])))
        self._radii = list(self._checked_radii())

    def at(self, time: float, now: float) -> Forecast:
        """Forecast the attribute for a time [s]."""
        element = self._element
        passed = time - self._series.times[-1]
        line = self._line(len(self._rates) - 1)
        radius = self._radius(passed)
        if line is None or (radius is None and not self._is_by_rates):
            return _unknown(element.name, "too little was measured to go so far ahead", time, now)
        last, slope = line
        expected = last + slope * passed
        value = clamped(element, expected)
        low = high = None
        span = "how exactly is not known"
        if radius is not None:
            low = clamped(element, expected - radius)
            high = clamped(element, expected + radius)
            span = f"{low:.3g} to {high:.3g}"
        change = "stays as it is"
        if slope:
            speed = element.amount(f"{abs(slope):.3g}")
            change = f"{'rises' if slope > 0 else 'falls'} by {speed}/s"
        actions = ", ".join(sorted(filter(None, self._rates[-1])))
        if actions:
            change += f" while {actions}"
        thresholds = [constraint.constraint.value for constraint in self._node.constraints]
        shown = element.amount(shortest(value, thresholds))
        reason = f"{element.name} is {shown} ({span}) in {time - now:.3g} s: it {change}"
        return Forecast(element.name, time, value, low, high, LEVEL, reason, change)

    def _learn(self) -> None:
        """Learn rates from the latest pieces in which only one of them is unknown."""
        element = self._element

        def piece_of(place: int) -> tuple[frozenset[str], int, bool]:
            is_inside = element.low < self._series.values[place] < element.high
            return self._rates[place], self._restorations[place], is_inside

        places = range(len(self._rates) - 1)  # from the last one on, other actions may be done
        pieces = [(key, list(part)) for key, part in groupby(reversed(places), piece_of)]
        for (names, _, is_inside), part in sorted(pieces, key=lambda piece: len(piece[0][0])):
            learners = names & self._unlearned
            slope = slope_of(self._series.part(part[-1], part[0]))
            if len(learners) == 1 and is_inside and slope is not None:
                (name,) = learners
                self._slopes[name] = slope - self._slope(names - learners)
                self._unlearned.remove(name)

    def _is_guess(self, place: int) -> bool:
        """Return whether a rate that was not learned yet applies."""
        return self._is_by_rates and not self._unlearned.isdisjoint(self._rates[place])

    def _slope(self, names: Iterable[str]) -> float:
        return math.fsum(self._slopes[name] for name in names)

    def _line(self, place: int) -> tuple[float, float] | None:
        """Return the value and the slope at a place of the line that goes on from there."""
        times, values = self._series
        if self._is_by_rates:
            return values[place], self._slope(self._rates[place])
        if self._element.forecasting == "constant":
            return values[place], 0.0
        latest = self._series.part(max(place + 1 - _MOST_POINTS, 0), place)
        slope = slope_of(latest)
        if slope is None:
            return None
        heights = [
            value - slope * (time - times[place]) for time, value in zip(*latest, strict=True)
        ]
        return median(heights), slope

    def _radius(self, passed: float) -> float | None:
        """Return how far a forecast may be off, from the next span that was checked."""
        if not self._radii or self._is_guess(len(self._rates) - 1):
            return None
        ahead = max(passed, self._step)
        knot = math.ceil(math.log2(ahead / self._step) - _ROUNDING)
        last = min(knot, len(self._radii) - 1)
        share = ahead / (self._step * 2.0**last)
        if share > _REACH and not self._is_by_rates:
            return None
        is_root = share < 1.0 or self._is_steady
        return self._radii[last] * (math.sqrt(share) if is_root else share)

    def _checked_radii(self) -> Iterator[float]:
        """Yield how far a forecast may be off, for each doubling of the step that was checked."""
        ahead = self._step
        radius = 0.0
        while (checked := _quantile(self._errors(ahead))) is not None:
            radius = max(radius, checked)
            yield radius
            ahead *= 2.0

    def _errors(self, ahead: float) -> list[float]:
        """Return how far earlier forecasts were off, in order of time."""
        times = self._series.times
        gap = max(self._step, ahead / _ERRORS_IN_HORIZON)
        turns = range(math.ceil(times[0] / gap), math.floor((times[-1] - ahead) / gap) + 1)
        places = dict.fromkeys(bisect_right(times, turn * gap) - 1 for turn in turns)
        errors = [self._error(place, ahead) for place in list(places)[-2 * _MOST_ERRORS :]]
        counted = [error for error in errors if error is not None][-_MOST_ERRORS:]
        # no error in n spans, one after the other, leaves a chance of 1 in n + 1 for the next
        is_evident = len(counted) * gap >= _FEWEST_ERRORS * ahead
        return counted if self._is_by_rates or is_evident or any(counted) else []

    def _error(self, place: int, ahead: float) -> float | None:
        """Return how far a forecast from a place was off; None if it does not count."""
        times, values = self._series
        then = times[place] + ahead
        came = bisect_left(times, then - _ROUNDING * ahead)
        if came == len(times):
            return None
        line = self._line(place)
        if line is None or self._restorations[place] < self._restorations[came]:
            return None
        if self._is_guess(place):
            return None
        if self._is_steady and len(set(self._rates[place:came])) > 1:
            return None
        value, slope = line
        value += slope * (max(times[came], then) - times[place])
        return abs(values[came] - clamped(self._element, value))


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


class Forecaster:
    """Predicts attributes of a knowledge base; called, it forecasts one attribute."""

    def __init__(self, base: Any) -> None:  # noqa: ANN401  # a KnowledgeBase, made with this
        self._base = base
        self._course = lru_cache(maxsize=32)(self._find_course)

    def __call__(
        self, attribute: str, horizon: float, *, doing: Iterable[str] | None = None
    ) -> Forecast:
        """Forecast an attribute `horizon` s from now while actions are done.

        By default these are the required ones, and the interval includes what comes of others that
        may begin meanwhile.
        """
        now = self._base.now
        then = now + _horizon(horizon)
        course = self.course(attribute, self.doing(doing), is_stated=doing is not None)
        return course(then, now)

    def doing(self, actions: Iterable[str] | None) -> frozenset[str]:
        """Return the names of the actions done meanwhile; by default those required now."""
        if actions is None:
            return frozenset(request.action for request in self._base.required_actions)
        names = listed("the actions that are done", actions)
        return frozenset(self._base.actions[name].name for name in names)

    def course(
        self, attribute: str, doing: frozenset[str], *, is_stated: bool = True
    ) -> Callable[[float, float], Forecast]:
        """Return a function that forecasts an attribute for a time, from now [s]."""
        node = self._base.attributes[attribute].node
        return self._course(node, doing, is_stated, self._base.log.last)

    def _find_course(
        self, node: Node, doing: frozenset[str], is_stated: bool, _: int
    ) -> Callable[[float, float], Forecast]:
        element = node.attribute
        view = self._base.attributes[node.name]
        why_not = ""
        if not element.forecasting and not element.rates:
            why_not = "its model says nothing of that (see Attribute.forecast)"
        elif view.value is None:
            why_not = "it is not measured"
        elif view.is_stale:
            why_not = "what was measured is stale"
        if why_not:
            return partial(_unknown, node.name, why_not)
        latest = dict(view.history[-_MOST_SAMPLES:])  # of one instant, the last
        series = Series(tuple(latest), tuple(latest.values()))
        rates = rates_by_measurement(element, series.times, self._base.history.actions)
        rates[-1] = _applying(element, doing)
        return Course(node, series, rates, is_stated).at


def clamped(element: Attribute, value: float) -> float:
    """Return the value of an attribute's range that is nearest."""
    return min(max(value, element.low), element.high)


def _horizon(horizon: float) -> float:
    if finite_number(horizon) >= 0:
        return float(horizon)
    raise InvalidValue(f"a horizon is a time in seconds from 0, not {horizon!r}")


def _is_violated(constraint: Constraint, forecast: Forecast, side: int = _WORSE) -> bool:
    """Return whether one end of a forecast violates a constraint."""
    ends = {_WORSE: forecast.low, _EXPECTED: forecast.value, _BETTER: forecast.high}
    value = ends[side if constraint.operator in (">=", ">") else -side]
    if value is None:
        value = forecast.value
    return value is not None and not OPERATORS[constraint.operator](value, constraint.value)


# -------------------------------------------------------------------- until when


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
        feasible = f"feasible for {self.within:g} s, as far as is known"
        if self.at is None and self.earliest is None:
            return feasible
        at, earliest, latest = (
            "" if time is None else f"{time - self.now:.3g}"
            for time in (self.at, self.earliest, self.latest)
        )
        if self.at is None:
            return f"{feasible}, unfeasible in {earliest} s at the earliest: {self.reason}"
        interval = f"{earliest or at} to {latest or f'more than {self.within:g}'}"
        if not self.is_bounded and earliest == latest:
            interval = "how exactly is not known"
        return f"unfeasible in {at} s ({interval}): {self.reason}"


def feasible_until(
    base: Any,  # noqa: ANN401  # a knowledge base, which imports this module
    action: str,
    within: float = 300.0,
    *,
    doing: Iterable[str] | None = None,
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
        done = base.forecast.doing(doing)
        courses = {}
        for constraint in _constraints(node):
            if state.status[constraint] is Status.SATISFIED:
                course = base.forecast.course(constraint.constraint.attribute, done)
                courses[constraint] = cache(partial(course, now=now))
        sides = (_EXPECTED, _WORSE, _BETTER)
        ends = [_end(state, node, courses, now, ahead, side) for side in sides]
    expected, earliest, latest = (end and end.time for end in ends)
    for end in ends:
        if end is not None:
            times = (expected, earliest, latest)
            return FeasibleUntil(node.name, *times, end.reason, now, ahead, end.is_bounded)
    reason = "nothing is known that makes it unfeasible"
    return FeasibleUntil(node.name, None, None, None, reason, now, ahead)


class _End(NamedTuple):
    time: float
    reason: str
    is_bounded: bool


def _end(
    state: State,
    action: Node,
    courses: Mapping[Node, Callable[[float], Forecast]],
    now: float,
    within: float,
    side: int,
) -> _End | None:
    """Return when and why an action is unfeasible first, for one end of the intervals."""

    def time(tick: int) -> float:
        return now + within * tick / (_LOOKS * _TICKS)

    def violated(tick: int) -> list[Node]:
        return [
            node
            for node, course in courses.items()
            if _is_violated(node.constraint, course(time(tick)), side)
        ]

    def is_unfeasible(tick: int) -> bool:
        nodes = violated(tick)
        if not nodes:
            return False
        supposed = state.copy()
        for node in nodes:
            supposed.hold(node, Status.VIOLATED)
        supposed.infer()
        return supposed.status[action] is Status.UNFEASIBLE

    for end in range(_TICKS, _LOOKS * _TICKS + 1, _TICKS):
        if is_unfeasible(end):
            tick = bisect_left(range(end), True, end - _TICKS, key=is_unfeasible)
            before = violated(tick - 1)
            node = min(violated(tick), key=before.__contains__)
            forecast = courses[node](time(tick))
            threshold = node.attribute.amount(exact(node.constraint.value))
            reason = f"{forecast.attribute} {forecast.change} and reaches {threshold}"
            return _End(time(tick), reason, forecast.low is not None)
    return None


def _constraints(node: Node) -> Iterator[Node]:
    """Yield the constraints on an element and on what it needs."""
    yield from node.constraints
    for part in node.requires:
        yield from _constraints(part)
