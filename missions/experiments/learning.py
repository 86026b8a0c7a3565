"""Learn from runs how fast attributes change and how long actions take.

Intervals are Student's, of the means of whole runs, because the measurements within a run are not
independent.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from statistics import fmean, median
from typing import Final, NamedTuple

from kb import Event, Model
from kb.elements import Attribute, AttributeKind
from kb.forecast import Series, slope_of
from missions.engine.mission import MissionError
from missions.experiments.comparison import Interval, mean_of
from missions.wires.mcap import read_bag

_ROUNDING: Final = 1e-6  # least relative half width of an interval, as times and values are rounded
_SURE: Final = 0.5  # largest relative half width of an interval, if the model states nothing
_BENT: Final = 0.05  # largest median distance of a series from a line, relative to its change


Runs = Mapping[str, Sequence[Event]]
"""The events of runs, by their names."""


class Learned(NamedTuple):
    """What runs tell of a model.

    Attributes:
        kind: "rate" or "duration".
        about: what it is about, with its unit.
        found: the value with its interval.
        stated: what the model says; None if it says nothing.
    """

    kind: str
    about: str
    found: Interval
    stated: float | None = None

    def __str__(self) -> str:
        mean, low, high, _, count = self.found
        details = f"{low:.4g} to {high:.4g}, {count} observations"
        if count == 1:
            details = "1 observation: no interval"
        text = f"{self.kind}: {self.about}: {mean:.4g} ({details})"
        if self.stated is None:
            return text
        verdict = "as stated" if _holds(self.found, self.stated) else "stated is"
        return f"{text}; {verdict} {self.stated:.4g}"


def _holds(found: Interval, value: float) -> bool:
    """Return whether a value is in an interval, but for rounding."""
    rounding = _ROUNDING * abs(found.mean)
    return found.low - rounding <= value <= found.high + rounding


def learn(runs: Runs, model: Model) -> list[Learned]:
    """Return the rates and durations that runs show.

    Raises:
        MissionError: an action of a run is not in the model, so the run is of another robot.
    """
    for name, events in runs.items():
        for event in events:
            if event.verb == "request_action" and event.subject not in model.actions:
                names = ", ".join(model.actions)
                raise MissionError(
                    f"in {name} {event.subject} is done, which is no action of {model.name}"
                    f": {names}"
                )
    learned: list[Learned] = []
    for attribute in model.attributes.values():
        learned += _rates(attribute, [_slopes(events, attribute) for events in runs.values()])
    return [*learned, *_durations(runs)]


def _slopes(events: Sequence[Event], attribute: Attribute) -> dict[str, float]:
    """Return the mean rate of change of an attribute, by the action that was done alone."""
    doing: dict[str, None] = {}
    points: list[tuple[frozenset[str], float, float]] = []
    for event in events:
        if event.verb == "request_action":
            doing[event.subject] = None
        elif event.verb == "cancel_action":
            doing.pop(event.subject, None)
        elif event.verb == "measure" and event.arguments[0] == attribute.name:
            points.append((frozenset(doing), event.time, float(event.arguments[1])))
    slopes: defaultdict[str, list[float]] = defaultdict(list)
    for actions, part in groupby(points, lambda point: point[0]):
        _, times, values = zip(*part, strict=True)
        if len(actions) == 1:
            for series in _inside(Series(times, values), attribute.low, attribute.high):
                slope = slope_of(series)
                if slope is not None and _is_straight(series, slope):
                    slopes[min(actions)].append(slope)
    return {action: fmean(values) for action, values in slopes.items()}


def _is_straight(series: Series, slope: float) -> bool:
    """Tell whether at least half of a series lies beside a straight line."""
    pairs = zip(series.times, series.values, strict=True)
    heights = [value - slope * time for time, value in pairs]
    middle = median(heights)
    change = abs(slope) * (series.times[-1] - series.times[0])
    off = median(abs(height - middle) for height in heights)
    return off <= _BENT * change + _ROUNDING * abs(middle)


def _inside(series: Series, low: float, high: float) -> Iterator[Series]:
    """Yield the parts between two bounds: what is at a bound is held there, and shows no rate."""
    points = zip(*series, strict=True)
    for is_inside, part in groupby(points, lambda point: low < point[1] < high):
        if is_inside:
            yield Series(*zip(*part, strict=True))


def _rates(attribute: Attribute, slopes: Sequence[dict[str, float]]) -> Iterator[Learned]:
    """Yield the rates of an attribute by action.

    One rate for all actions if they make no difference.
    """
    if attribute.kind is AttributeKind.ENVIRONMENTAL and not attribute.rates:
        return  # the robot changes its own qualities, not its surroundings
    by_action: defaultdict[str, list[float]] = defaultdict(list)
    for run in slopes:
        for action, slope in run.items():
            by_action[action].append(slope)
    rates = {action: mean_of(values) for action, values in by_action.items()}
    if len(rates) > 1:
        always = mean_of([fmean(run.values()) for run in slopes if run])
        if all(_holds(rate, always.mean) for rate in rates.values()):
            rates = {"": always}
    stated = {rate.while_: rate.per_s for rate in attribute.rates}
    for action, rate in rates.items():
        is_sure = rate.mean != 0 and rate.high - rate.low <= 2 * _SURE * abs(rate.mean)
        if action in stated or is_sure:
            when = f" while {action}" if action else ", always"
            about = f"{attribute.name}{when} [{attribute.unit or '1'}/s]"
            yield Learned("rate", about, rate, stated.get(action))


def _durations(runs: Runs) -> Iterator[Learned]:
    """Yield how long the completed actions took."""
    took: defaultdict[str, list[float]] = defaultdict(list)
    for events in runs.values():
        begun: dict[str, float] = {}
        for event in events:
            if event.verb == "request_action":
                begun.setdefault(event.subject, event.time)
            elif event.verb == "cancel_action" and event.subject in begun:
                start = begun.pop(event.subject)
                if event.arguments[1] == "completed":
                    took[event.subject].append(event.time - start)
    for action, seconds in took.items():
        yield Learned("duration", f"{action} [s]", mean_of(seconds))


def read_runs(paths: Iterable[Path]) -> Runs:
    """Read recordings.

    Raises:
        MissionError: nothing can be learned from one of them; the message says why.
    """
    runs: dict[str, Sequence[Event]] = {}
    for path in paths:
        runs[path.name] = read_bag(path).events
        if not runs[path.name]:
            raise MissionError(f"{path} holds no run in which a knowledge base knew what was done")
    return runs
