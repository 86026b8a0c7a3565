"""Learn from runs: how fast attributes change while actions are done, and how long actions take, with intervals.

Intervals are Student's, of the means of whole runs, because the measurements within a run are not independent.
"""

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from pathlib import Path
from statistics import fmean, median, stdev
from typing import Final, NamedTuple, Self

from kb import Event, Model
from kb.elements import Attribute, AttributeKind
from kb.forecast import Series, slope_of
from missions.engine.mission import MissionError, needs
from missions.engine.runner import MissionRun, RosaRun
from missions.experiments.campaign import FILE, read_store
from missions.wires.mcap import read_bag

LEVEL: Final = 0.95  # how often an interval holds the true value
_ROUNDING: Final = 1e-6  # least relative half width of an interval, as times and values are rounded
_SURE: Final = 0.5  # largest relative half width of an interval, if the model states nothing
_BENT: Final = 0.05  # largest median distance of a series from a line, relative to its change


class Experience(NamedTuple):
    """What can be learned from of a run: its name and its events."""

    name: str
    events: Sequence[Event]

    @classmethod
    def of(cls, name: str, run: MissionRun) -> Self:
        """Do an open run, and return it as an experience."""
        run.run()
        return cls(name, list(run.kb.log))


class Spread(NamedTuple):
    """A mean, its interval, and the number of observations; the bounds of a single one are infinite."""

    value: float
    low: float
    high: float
    observations: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Self:
        """Return the mean of values, with its interval."""
        with needs("plot", "the intervals of what is learned"):
            from scipy.stats import t
        mean = fmean(values)
        count = len(values)
        half = math.inf
        if count > 1:
            quantile = float(t.ppf((1 + LEVEL) / 2, count - 1))
            half = max(quantile * stdev(values) / math.sqrt(count), _ROUNDING * abs(mean))
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
    found: Spread
    stated: float | None = None

    def __str__(self) -> str:
        text = f"{self.kind}: {self.about}: {self.found}"
        if self.stated is None:
            return text
        verdict = "as stated" if self.found.holds(self.stated) else "stated is"
        return f"{text}; {verdict} {self.stated:.4g}"


def learn(runs: Iterable[Experience], model: Model) -> list[Learned]:
    """Return the rates and durations that runs show.

    Raises:
        MissionError: an action of a run is not in the model, so the run is of another robot.
    """
    runs = list(runs)
    for run in runs:
        for event in run.events:
            if event.verb == "request_action" and event.subject not in model.actions:
                known = ", ".join(model.actions)
                what = f"in {run.name} {event.subject} is done, which is no action of {model.name}"
                raise MissionError(f"{what}: {known}")
    rates = [
        learned
        for attribute in model.attributes.values()
        for learned in _rates(attribute, [_slopes(run, attribute) for run in runs])
    ]
    return [*rates, *_durations(runs)]


def _slopes(run: Experience, attribute: Attribute) -> dict[str, float]:
    """Return the mean rate of change of an attribute in a run, by the action that was done alone."""
    doing: dict[str, None] = {}
    points: list[tuple[frozenset[str], float, float]] = []
    for event in run.events:
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
    """Yield the rates of an attribute by action; one rate for all actions if they make no difference."""
    if attribute.kind is AttributeKind.ENVIRONMENTAL and not attribute.rates:
        return  # the robot changes its own qualities, not its surroundings
    by_action: defaultdict[str, list[float]] = defaultdict(list)
    for run in slopes:
        for action, slope in run.items():
            by_action[action].append(slope)
    spreads = {action: Spread.of(values) for action, values in by_action.items()}
    if len(spreads) > 1:
        always = Spread.of([fmean(run.values()) for run in slopes if run])
        if all(spread.holds(always.value) for spread in spreads.values()):
            spreads = {"": always}
    stated = {rate.while_: rate.per_s for rate in attribute.rates}
    for action, spread in spreads.items():
        if action in stated or spread.is_sure:
            when = f" while {action}" if action else ", always"
            about = f"{attribute.name}{when} [{attribute.unit or '1'}/s]"
            yield Learned("rate", about, spread, stated.get(action))


def _durations(runs: Sequence[Experience]) -> Iterator[Learned]:
    """Yield how long the completed actions took."""
    took: defaultdict[str, list[float]] = defaultdict(list)
    for run in runs:
        begun: dict[str, float] = {}
        for event in run.events:
            if event.verb == "request_action":
                begun.setdefault(event.subject, event.time)
            elif event.verb == "cancel_action" and event.subject in begun:
                start = begun.pop(event.subject)
                if event.arguments[1] == "completed":
                    took[event.subject].append(event.time - start)
    for action, seconds in took.items():
        yield Learned("duration", f"{action} [s]", Spread.of(seconds))


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
            found = [Experience(path.name, bag.events)] if bag.events else []
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
