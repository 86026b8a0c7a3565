"""Predicts attributes, and until when an action stays feasible.

A forecast continues the measurements by a straight line. It depends only on what was measured and
done until then. Its interval is conformal (Vovk, Gammerman and Shafer, "Algorithmic learning in a
random world", 2005): the same forecast from earlier measurements is compared with what came.
After misses it widens, after hits it narrows (Gibbs and Candes, "Adaptive conformal inference
under distribution shift", NeurIPS 2021).
"""

import math
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, lru_cache, partial
from itertools import combinations, groupby, pairwise
from statistics import median
from typing import Any, Final, NamedTuple

from kb.elements import Attribute, Constraint, exact, finite_number, listed
from kb.exceptions import InvalidValue
from kb.explain import shortest, why
from kb.network import Node
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
_FEWEST_POINTS: Final = 8
_MOST_POINTS: Final = 24
"""How many points the slope of a line is taken from."""
_MOST_SAMPLES: Final = 1024
_JUMP: Final = 10.0
"""A step against the usual direction that is so many times the usual one restores an attribute."""
_LOOKS: Final = 128
"""At how many instants a horizon is looked at."""
_HALVINGS: Final = 20
"""How finely the span between two looks is searched."""
_ROUNDING: Final = 1e-9


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
    reason: str
    change: str = ""
    level: float = LEVEL

    def __str__(self) -> str:
        return self.reason


def _unknown(attribute: str, why_not: str, time: float, now: float) -> Forecast:
    reason = f"it is not known what {attribute} is in {time - now:.3g} s: {why_not}"
    return Forecast(attribute, time, None, None, None, reason)


class Course:
    """How an attribute goes on from its measurements: by the sum of the rates that apply.

    Args:
        node: the attribute.
        series: its measurements.
        rates: the names of the rates that apply from each measurement on; those of the last one
            apply as far as the forecast goes. The name of a rate is that of its action; it is
            empty if the rate always applies.
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
        is_by_rates = bool(rates[-1]) or not self._element.forecasting
        self._is_trend = self._element.forecasting == "trend" and not is_by_rates
        self._is_steady = is_by_rates and (is_stated or not any(self._slopes))
        steps = [time - before for before, time in pairwise(series.times[-2 * _FEWEST_POINTS :])]
        self._step = 2.0 ** math.floor(math.log2(median(steps or [1.0])))
        self._radii = list(self._checked_radii())

    def at(self, time: float, now: float) -> Forecast:
        """Forecast the attribute for a time [s]."""
        element = self._element
        passed = time - self._series.times[-1]
        slope = self._slope(len(self._rates) - 1)
        radius = self._radius(passed)
        if slope is None:
            return _unknown(element.name, "too little was measured", time, now)
        expected = self._series.values[-1] + slope * passed
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
        return Forecast(element.name, time, value, low, high, reason, change)

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
                self._slopes[name] = slope - self._stated(names - learners)
                self._unlearned.remove(name)

    def _stated(self, names: Iterable[str]) -> float:
        return math.fsum(self._slopes[name] for name in names)

    def _slope(self, place: int) -> float | None:
        """Return the slope with which the attribute goes on from a place."""
        if not self._is_trend:
            return self._stated(self._rates[place])
        return slope_of(self._series.part(max(place + 1 - _MOST_POINTS, 0), place))

    def _radius(self, passed: float) -> float | None:
        """Return how far a forecast may be off, from the next span that was checked."""
        if not self._radii or not self._unlearned.isdisjoint(self._rates[-1]):
            return None
        ahead = max(passed, self._step)
        knot = math.ceil(math.log2(ahead / self._step) - _ROUNDING)
        last = min(knot, len(self._radii) - 1)
        share = ahead / (self._step * 2.0**last)
        is_root = share < 1.0 or self._is_steady
        return self._radii[last] * (math.sqrt(share) if is_root else share)

    def _checked_radii(self) -> Iterator[float]:
        """Yield how far a forecast may be off, for each doubling of the step that was checked."""
        ahead = self._step
        radius = 0.0
        while (checked := _quantile(list(self._errors(ahead))[-_MOST_ERRORS:])) is not None:
            radius = max(radius, checked)
            yield radius
            ahead *= 2.0

    def _errors(self, ahead: float) -> Iterator[float]:
        """Yield how far earlier forecasts were off, in order of time."""
        times, values = self._series
        gap = max(self._step, ahead / _ERRORS_IN_HORIZON)
        places = []  # the last one before each multiple of the gap, however far apart they are
        for place, (time, following) in enumerate(pairwise(times)):
            turn = math.ceil(time / gap) * gap
            if turn < following and turn <= times[-1] - ahead:
                places.append(place)
        for place in places[-2 * _MOST_ERRORS :]:
            then = times[place] + ahead
            came = bisect_left(times, then - _ROUNDING * ahead)
            slope = self._slope(place)
            if came == len(times) or slope is None:
                continue
            is_restored = self._restorations[place] < self._restorations[came]
            is_guess = not self._unlearned.isdisjoint(self._rates[place])
            is_other = self._is_steady and len(set(self._rates[place:came])) > 1
            if not (is_restored or is_guess or is_other):
                value = values[place] + slope * (max(times[came], then) - times[place])
                yield abs(values[came] - clamped(self._element, value))


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
        return self._course(attribute, doing, is_stated, self._base.log.last)

    def _find_course(
        self, attribute: str, doing: frozenset[str], is_stated: bool, _: int
    ) -> Callable[[float, float], Forecast]:
        view = self._base.attributes[attribute]
        element = view.node.attribute
        why_not = ""
        if not element.forecasting and not element.rates:
            why_not = "its model says nothing of that (see Attribute.forecast)"
        elif view.value is None:
            why_not = "it is not measured"
        elif view.is_stale:
            why_not = "what was measured is stale"
        if why_not:
            return partial(_unknown, element.name, why_not)
        latest = dict(view.history[-_MOST_SAMPLES:])  # of one instant, the last
        series = Series(tuple(latest), tuple(latest.values()))
        actions = [{""} for _ in latest]
        for request in self._base.history.actions:
            first = bisect_left(series.times, request.start)
            end = len(actions)
            if request.end is not None:
                end = bisect_left(series.times, request.end)
            for names in actions[first:end]:
                names.add(request.action)
        actions[-1] = {"", *doing}
        stated = {rate.while_ for rate in element.rates}
        rates = [frozenset(names & stated) for names in actions]
        return Course(view.node, series, rates, is_stated).at


def clamped(element: Attribute, value: float) -> float:
    """Return the value of an attribute's range that is nearest."""
    return min(max(value, element.low), element.high)


def _horizon(horizon: float) -> float:
    if finite_number(horizon) >= 0:
        return float(horizon)
    raise InvalidValue(f"a horizon is a time in seconds from 0, not {horizon!r}")


def _is_violated(constraint: Constraint, forecast: Forecast, side: int = -1) -> bool:
    """Return whether a forecast violates a constraint, at the better or the worse end (1, -1)."""
    place = 1 + (side if constraint.operator in (">=", ">") else -side)
    value = (forecast.low, forecast.value, forecast.high)[place]
    if value is None:
        value = forecast.value
    return value is not None and not OPERATORS[constraint.operator](value, constraint.value)


# -------------------------------------------------------------------- until when


class FeasibleUntil(NamedTuple):
    """When an action is expected to become unfeasible [s], and why; None: not within the horizon.

    `earliest` is for attributes at the worse ends of their intervals, `latest` for the better ends.
    """

    action: str
    at: float | None
    earliest: float | None
    latest: float | None
    reason: str
    now: float
    within: float

    def __str__(self) -> str:
        if self.at == self.now:
            return f"unfeasible now: {self.reason}"
        if self.at is None and self.earliest is None:
            return f"feasible for {self.within:g} s, as far as is known"
        at, earliest, latest = (
            f"more than {self.within:g}" if time is None else f"{time - self.now:.3g}"
            for time in (self.at, self.earliest, self.latest)
        )
        return f"unfeasible in {at} s ({earliest} to {latest}): {self.reason}"


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
        ends = [_end(state, node, courses, now, ahead, side) for side in (0, -1, 1)]
    at, earliest, latest = (time for time, _ in ends)
    reasons = [reason for _, reason in ends if reason]
    reason = reasons[0] if reasons else "nothing is known that makes it unfeasible"
    return FeasibleUntil(node.name, at, earliest, latest, reason, now, ahead)


def _end(
    state: State,
    action: Node,
    courses: Mapping[Node, Callable[[float], Forecast]],
    now: float,
    within: float,
    side: int,
) -> tuple[float | None, str]:
    """Return when and why an action is unfeasible first, for one end of the intervals."""

    def violated(time: float) -> list[Node]:
        """Return the constraints that are violated at a time."""
        return [
            node
            for node, course in courses.items()
            if _is_violated(node.constraint, course(time), side)
        ]

    def is_unfeasible(time: float) -> bool:
        nodes = violated(time)
        if not nodes:
            return False
        supposed = state.copy()
        for node in nodes:
            supposed.hold(node, Status.VIOLATED)
        supposed.infer()
        return supposed.status[action] is Status.UNFEASIBLE

    for look in range(_LOOKS):
        start = now + within * look / _LOOKS
        end = now + within * (look + 1) / _LOOKS
        if not is_unfeasible(end):
            continue
        for _ in range(_HALVINGS):
            middle = (start + end) / 2
            if is_unfeasible(middle):
                end = middle
            else:
                start = middle
        node = min(violated(end), key=violated(start).__contains__)
        forecast = courses[node](end)
        threshold = node.attribute.amount(exact(node.constraint.value))
        reason = f"{forecast.attribute} {forecast.change} and reaches {threshold}"
        return end, reason if forecast.low is not None else f"{reason}, how exactly is not known"
    return None, ""


def _constraints(node: Node) -> Iterator[Node]:
    """Yield the constraints on an element and on what it needs."""
    yield from node.constraints
    for part in node.requires:
        yield from _constraints(part)
