"""Learn from runs: rates of attributes, durations of actions, effects of choices, and whether thresholds fit.

Each finding is a suggestion with its interval; the model changes only on request. Intervals are Student's, of the means
of whole runs, because the measurements within a run are not independent.
"""

import math
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import groupby
from pathlib import Path
from statistics import fmean, median, stdev
from typing import Final, NamedTuple, Self

from kb import Event, Model
from kb.elements import (
    Action,
    Attribute,
    AttributeKind,
    Constraint,
    Estimation,
    EstimationKind,
    Rate,
)
from kb.forecast import Series, slope_of
from missions.engine.mission import MISSION_STATUS, Message, Mission, MissionError, needs
from missions.engine.runner import MissionRun, RosaRun
from missions.experiments.campaign import FILE, read_store
from missions.wires.mcap import read_bag

LEVEL: Final = 0.95  # how often an interval holds the true value
_ROUNDING: Final = (
    1e-6  # relative half width below which no interval falls, as times and values are rounded
)
_SURE: Final = 0.5  # largest relative half width of an interval, if the model states nothing
_BENT: Final = (
    0.05  # largest median distance of a series from a straight line, relative to its change
)
_ANY: Final = (-math.inf, math.inf)
_EPISODES: Final = 5  # how often a threshold has to be passed before it is judged

_Slopes = dict[tuple[str, frozenset[str]], dict[int, float]]
"""By action, done alone, and its configuration: the mean rate of change in each run, by number of the run."""


class Experience(NamedTuple):
    """What can be learned from of a run: its name, its events, and the messages."""

    name: str
    events: Sequence[Event]
    messages: Sequence[Message] = ()

    @classmethod
    def of(cls, name: str, run: MissionRun) -> Self:
        """Do an open run, and return it as an experience."""
        messages: list[Message] = []

        def hear(heard: Sequence[Message], _: float) -> Sequence[Message]:
            messages.extend(heard)
            return heard

        run.alter = hear
        run.run()
        return cls(name, list(run.kb.log), messages)


class Spread(NamedTuple):
    """A mean, its interval, and the number of observations; the bounds of a single one are infinite."""

    value: float
    low: float
    high: float
    observations: int

    @classmethod
    def of(cls, values: Sequence[float], *, next_one: bool = False) -> Self:
        """Return the mean of values, with the interval of the true mean or, if `next_one`, of the next value."""
        with needs("plot", "the intervals of what is learned"):
            from scipy.stats import t
        mean, count, half = fmean(values), len(values), math.inf
        if count > 1:
            half = (
                float(t.ppf((1 + LEVEL) / 2, count - 1))
                * stdev(values)
                * math.sqrt(next_one + 1 / count)
            )
            half = max(half, _ROUNDING * abs(mean))
        return cls(mean, mean - half, mean + half, count)

    def holds(self, value: float) -> bool:
        return self.low <= value <= self.high

    @property
    def is_sure(self) -> bool:
        """Whether the sign is certain, and the size roughly."""
        return 0.0 < self.high - self.low <= 2 * _SURE * abs(self.value)

    def __str__(self) -> str:
        if self.observations == 1:
            return f"{self.value:.4g} (1 observation: no interval)"
        return f"{self.value:.4g} ({self.low:.4g} to {self.high:.4g}, {self.observations} observations)"


@dataclass(frozen=True, slots=True)
class Suggestion:
    """A finding from runs about a model.

    Attributes:
        kind: "rate", "duration", "estimation", "worth" or "threshold".
        about: what it is about, with its unit.
        found: the value with its interval.
        stated: what the model says; None if it says nothing.
        change: what would change, in words; empty if nothing would.
        apply: makes this change in the model; None if the model does not state it, or it is not certain.
    """

    kind: str
    about: str
    found: Spread
    stated: float | None = None
    change: str = ""
    apply: Callable[[], None] | None = None

    def __str__(self) -> str:
        stated = "" if self.stated is None else f"; stated: {self.stated:.4g}"
        return f"{self.kind}: {self.about}: {self.found}{stated}{f' -> {self.change}' if self.change else ''}"


@dataclass(slots=True)
class _Span:
    """A span of time with the same actions and choices, and the values measured in it, by name."""

    doing: frozenset[str]
    chosen: frozenset[str]
    series: dict[str, tuple[list[float], list[float]]] = field(
        default_factory=lambda: defaultdict(lambda: ([], []))
    )

    def slopes(self, model: Model) -> Iterator[tuple[str, float]]:
        """Yield the slope [1/s] of each series between its bounds, if it is long enough and nearly straight."""
        ranges = {one.name: (one.low, one.high) for one in model.attributes.values()}
        parts = (
            (of, part)
            for of, seen in self.series.items()
            for part in _inside(Series(*seen), *ranges.get(of, _ANY))
        )
        for name, (times, values) in parts:
            slope = slope_of(Series(times, values))
            if slope is not None:
                heights = [value - slope * time for time, value in zip(times, values, strict=True)]
                middle, change = median(heights), abs(slope) * (times[-1] - times[0])
                if median(abs(one - middle) for one in heights) <= _BENT * change + _ROUNDING * abs(
                    middle
                ):
                    yield name, slope


def _inside(series: Series, low: float, high: float) -> Iterator[Series]:
    """Yield the parts between two bounds: what is at a bound is held there, and shows no rate."""
    points = zip(*series, strict=True)
    for is_inside, part in groupby(points, lambda point: low < point[1] < high):
        if is_inside:
            yield Series(*zip(*part, strict=True))


def spans_of(one: Experience, model: Model) -> list[_Span]:
    """Divide a run into spans with the same actions and the same choices, of those that were in use."""
    said = deque(
        (float(message["time"]), *pair) for message in one.messages for pair in _numbers(message)
    )
    spans, doing, chosen = [_Span(frozenset(), frozenset())], dict[str, None](), dict[str, None]()
    for event in one.events:
        while said and said[0][0] <= event.time:
            _add(spans[-1], *said.popleft())
        if event.verb == "measure":
            _add(spans[-1], event.time, event.arguments[0], float(event.arguments[1]))
            continue
        if event.verb in ("request_action", "cancel_action"):
            (doing.setdefault if event.verb == "request_action" else doing.pop)(
                event.arguments[0], None
            )
        for _, name, is_so in event.effects:
            (chosen.setdefault if is_so else chosen.pop)(name, None)
        if event.effects or event.verb in ("request_action", "cancel_action", "finish_plan"):
            designs = [model.designs[name] for name in chosen if name in model.designs]
            in_use = {name for design in designs for name in (design.name, *design.components)}
            idle = {
                one.name for one in model.configurations.values() if one.component not in in_use
            }
            spans.append(_Span(frozenset(doing), frozenset(chosen.keys() - idle)))
    for late in said:
        _add(spans[-1], *late)
    return spans


def _add(span: _Span, time: float, name: str, value: float) -> None:
    times, values = span.series[name]
    times.append(time)
    values.append(value)


def _numbers(message: Message) -> Iterator[tuple[str, float]]:
    """Yield the numbers in a message that are for the task layer only."""
    for status in message["status"]:
        if str(status["message"]).casefold() == MISSION_STATUS:
            for key, value in status["values"].items():
                try:
                    yield str(key), float(value)
                except ValueError:
                    continue


def _slopes(runs: Sequence[Sequence[_Span]], model: Model) -> dict[str, _Slopes]:
    found: dict[str, _Slopes] = defaultdict(lambda: defaultdict(dict))
    for number, run in enumerate(runs):
        here: dict[tuple[str, str, frozenset[str]], list[float]] = defaultdict(list)
        for span in run:
            if len(span.doing) == 1:
                (action,) = span.doing
                for name, slope in span.slopes(model):
                    here[name, action, span.chosen].append(slope)
        for (name, action, chosen), values in here.items():
            found[name][action, chosen][number] = fmean(values)
    return found


def _by_action(slopes: _Slopes) -> dict[str, Spread]:
    """Return the rate of change during each action; only one, under "", if actions make no difference."""
    values: dict[str, dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    for (action, _), by_run in slopes.items():
        for number, slope in by_run.items():
            values[action][number].append(slope)
            values[""][number].append(slope)
    spreads = {
        action: Spread.of([fmean(one) for one in by_run.values()])
        for action, by_run in values.items()
    }
    always = spreads.pop("")
    is_one = len(spreads) > 1 and all(one.holds(always.value) for one in spreads.values())
    return {"": always} if is_one else spreads


def learn(
    runs: Iterable[Experience], model: Model, mission: Mission | None = None
) -> list[Suggestion]:
    """Return suggestions for a model, and for the durations in the schemas of a mission.

    Raises:
        MissionError: an action of a run is not in the model, so the run is of another robot.
    """
    known = list(runs)
    for run in known:
        for action in {
            event.subject: None for event in run.events if event.verb == "request_action"
        }:
            if action not in model.actions:
                there = ", ".join(model.actions)
                raise MissionError(
                    f"in {run.name} {action} is done, which is no action of {model.name}: {there}"
                )
    spans = [spans_of(one, model) for one in known]
    slopes = _slopes(spans, model)
    return [
        *(
            one
            for name, attribute in model.attributes.items()
            for one in _rates(name, slopes[name], attribute)
        ),
        *(
            one
            for name in sorted(slopes.keys() - model.attributes.keys())
            for one in _rates(name, slopes[name])
        ),
        *_estimations(spans, model),
        *_durations(known, mission),
        *(one for last in _last_thresholds(model) for one in _threshold(*last, known)),
    ]


def _rates(name: str, slopes: _Slopes, attribute: Attribute | None = None) -> Iterator[Suggestion]:
    """Yield the rates of an attribute or, without one, of a counted quantity: what a second of an action is worth."""
    if (
        attribute is not None
        and attribute.kind is AttributeKind.ENVIRONMENTAL
        and not attribute.rates
    ):
        return  # the robot changes its own qualities, not its surroundings
    kind, unit = (
        ("worth", "[1/s]") if attribute is None else ("rate", f"[{attribute.unit or '1'}/s]")
    )
    for action, found in _by_action(slopes).items() if slopes else ():
        about = f"{name}{f' while {action}' if action else ', always'} {unit}"
        if attribute is not None:
            yield from _rate(attribute, action, found, about)
        elif found.is_sure and found.value > 0:
            yield Suggestion(kind, about, found)
    # configurations of an action whose rates certainly differ
    for action in sorted({action for action, _ in slopes}):
        spreads = {
            chosen: Spread.of(list(by_run.values()))
            for (of, chosen), by_run in slopes.items()
            if of == action
        }
        common, each = frozenset.intersection(*spreads), spreads.values()
        if all(one.is_sure for one in each) and min(one.high for one in each) < max(
            one.low for one in each
        ):
            for chosen, spread in spreads.items():
                what = ", ".join(sorted(chosen - common)) or "none of the others"
                yield Suggestion(kind, f"{name} while {action} with {what} {unit}", spread)


def _rate(attribute: Attribute, action: str, found: Spread, about: str) -> Iterator[Suggestion]:
    before = next((one for one in attribute.rates if one.while_ == action), None)
    stated = before and before.per_s
    if stated is None and not found.is_sure:
        return
    if found.observations == 1 or (stated is not None and found.holds(stated)):
        yield Suggestion("rate", about, found, stated)
        return
    others = [one for one in attribute.rates if action and one.while_ not in ("", action)]
    rates = [*others, Rate(found.value, action, before is not None and before.learns)]
    change = (
        f"{attribute.name}.changes({found.value:.6g}{f', while_={action!r}' if action else ''})"
    )
    yield Suggestion(
        "rate",
        about,
        found,
        stated,
        change,
        partial(attribute.model.change, attribute, rates=rates),
    )


def _estimations(runs: Sequence[Sequence[_Span]], model: Model) -> Iterator[Suggestion]:
    """Find wrong estimations: with one choice the measured rate differs from the estimate, and without it it fits."""
    by_attribute: dict[str, list[Estimation]] = defaultdict(list)
    for one in model.estimations:
        if one.kind is not EstimationKind.ABSOLUTE:
            by_attribute[one.attribute].append(one)
    for name, estimations in by_attribute.items():
        rests: dict[int, list[tuple[frozenset[str], float]]] = defaultdict(list)
        for number, span in ((number, span) for number, run in enumerate(runs) for span in run):
            chosen = [one for one in estimations if one.causer.name in span.chosen]
            estimated = math.fsum(one.adds for one in chosen)
            slopes = [slope for of, slope in span.slopes(model) if of == name and chosen]
            rests[number] += [(span.chosen, slope - estimated) for slope in slopes]
        for one in estimations:
            off, right = (_mean_rest(rests, one.causer.name, having) for having in (True, False))
            if (
                off is None
                or off.observations == 1
                or _is_right(off, one)
                or (right and not _is_right(right, one))
            ):
                continue
            sign = one.adds and math.copysign(1.0, one.adds)
            low, high = sorted(one.value + sign * end for end in (off.low, off.high))
            found = Spread(one.value + sign * off.value, low, high, off.observations)
            about = f"{name} by {one.causer.name} [{model.attributes[name].unit or '1'}/s]"
            change = f"{one.causer.name}.estimate({name!r}, {found.value:.6g}, {str(one.kind)!r})"
            apply = partial(model.change, one, value=found.value)
            yield Suggestion("estimation", about, found, one.value, change, apply)


def _is_right(rest: Spread, one: Estimation) -> bool:
    return rest.holds(0.0) or abs(rest.value) <= _ROUNDING * abs(one.value)


def _mean_rest(
    rests: dict[int, list[tuple[frozenset[str], float]]], name: str, having: bool
) -> Spread | None:
    by_run = [
        [rest for chosen, rest in found if (name in chosen) is having] for found in rests.values()
    ]
    means = [fmean(found) for found in by_run if found]
    return Spread.of(means) if means else None


def _durations(runs: Sequence[Experience], mission: Mission | None) -> Iterator[Suggestion]:
    took: dict[str, list[float]] = defaultdict(list)
    for run in runs:
        begun: dict[str, float] = {}
        for event in run.events:
            if event.verb == "request_action":
                begun.setdefault(event.subject, event.time)
            elif event.verb == "cancel_action" and event.subject in begun:
                start = begun.pop(event.subject)
                if event.arguments[1] == "completed":
                    took[event.subject].append(event.time - start)
    schemas = [
        getattr(one, "schema", None) for one in (mission.actions if mission else {}).values()
    ]
    stated = {
        one.rosa_action: float(one.duration_s)
        for one in schemas
        if one is not None and one.duration_s
    }
    for action, seconds in took.items():
        found, before = Spread.of(seconds), stated.get(action)
        is_news = found.observations > 1 and before is not None and not found.holds(before)
        change = f"duration_s={found.value:.3g} in the schema of {action}" if is_news else ""
        yield Suggestion("duration", f"{action} [s]", found, before, change)


def _last_thresholds(model: Model) -> Iterator[tuple[Attribute, float, float, list[Constraint]]]:
    """Yield the outermost constraints of actions: for side 1 the lowest of `>=`, for side -1 the highest of `<=`."""
    of_actions = [
        one
        for one in model.constraints
        if any(isinstance(each, Action) for each in one.constrained)
    ]
    for attribute in model.attributes.values():
        for side, bound, signs in (
            (1.0, attribute.low, (">=", ">")),
            (-1.0, attribute.high, ("<=", "<")),
        ):
            mine = [
                one
                for one in of_actions
                if one.attribute == attribute.name and one.operator in signs
            ]
            if mine and math.isfinite(bound):
                last = min(side * one.value for one in mine)
                yield attribute, side, bound, [one for one in mine if side * one.value == last]


def _threshold(
    attribute: Attribute,
    side: float,
    bound: float,
    constraints: Sequence[Constraint],
    runs: Sequence[Experience],
) -> Iterator[Suggestion]:
    """Judge a threshold by how much was left of the range each time it was passed, until it held again."""
    constraint, left = constraints[0], list[float]()
    for run in runs:
        worst: float | None = None
        for event in run.events:
            if event.verb == "measure" and event.arguments[0] == attribute.name:
                beyond = side * (float(event.arguments[1]) - constraint.value)
                if beyond < 0:
                    worst = min(beyond, math.inf if worst is None else worst)
                elif worst is not None:
                    left.append(side * (constraint.value - bound) + worst)
                    worst = None
    if len(left) < _EPISODES:
        return
    found, count = Spread.of(left, next_one=True), sum(one <= _ROUNDING for one in left)
    about = f"left of {attribute.name} until {constraint} holds again [{attribute.unit or '1'}]"
    if count or found.low <= 0:
        change = f"too narrow: nothing was left in {count} of them" if count else ""
        yield Suggestion("threshold", about, found, change=change)
        return
    value = constraint.value - side * found.low

    def apply() -> None:
        for one in constraints:
            attribute.model.change(one, value=value)

    change = f"too wide: {constraint.attribute} {constraint.operator} {value:.4g}"
    yield Suggestion("threshold", about, found, None, change, apply)


def read_runs(paths: Iterable[Path]) -> Iterator[Experience]:
    """Read recordings, and repeat the runs of campaigns, which depend only on their names and the code.

    Raises:
        MissionError: nothing can be learned from one of them; the message says why.
    """
    for path in paths:
        if (path / FILE).exists():
            found = list(_campaign(path))
        else:
            bag = read_bag(path)
            found = [Experience(path.name, bag.events, bag.messages)] if bag.events else []
        if not found:
            raise MissionError(f"{path} holds no run in which a knowledge base knew what was done")
        yield from found


def _campaign(path: Path) -> Iterator[Experience]:
    kept = read_store(path)
    done = kept.done(retry=True)
    for run in (one for one in kept.campaign.planned() if one.place in done):
        opened = run.open()
        if isinstance(opened, RosaRun):
            yield Experience.of(run.name, opened)
