"""The runs of a campaign in groups to compare, the published figures, and the statistics of samples."""

import math
from array import array
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import nan
from statistics import NormalDist
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from missions.engine.mission import NO_SUCCESS
from missions.experiments.campaign import CRASHED, Kept

Array = NDArray[np.float64]
Values = Sequence[float] | Array

SEARCH = "search_time_s"
INPUT = "input_from_paper_"
NO_FIGURES = {"seed", "task"}


class Published(NamedTuple):
    """A row of the paper's table: by figure the mean and standard deviation, and mean reaction times [s]."""

    figures: Mapping[str, tuple[float, float]]
    reactions_s: Mapping[str, float]


def _row(
    search_s: tuple[float, float], distance_m: tuple[float, float], **reactions_s: float
) -> Published:
    return Published(
        {SEARCH: search_s, "distance_inspected_m": distance_m}, reactions_s
    )  # its head says seconds


PAPER: Final = {
    ("suave", "none"): _row((174.75, 36.00), (33.20, 13.49)),
    ("suave", "bt"): _row((84.09, 26.41), (62.70, 7.78), U1=0.08, U2=0.10),
    ("suave", "metacontrol"): _row((89.24, 35.57), (60.57, 11.17), U1=1.55, U2=0.82),
    ("suave", "rosa"): _row((85.11, 32.48), (60.76, 10.29), U1=1.24, U2=1.57),
    ("suave_extended", "bt"): _row((94.37, 34.92), (20.88, 3.81), U1=0.07, U2=0.10, U3=1.09),
    ("suave_extended", "rosa"): _row((92.75, 35.92), (18.97, 3.38), U1=1.39, U2=1.67, U3=2.50),
}
"""By mission and manager."""


@dataclass(slots=True, eq=False)
class Group:
    """The runs of one manager that did not crash; `task` is the task layer of ours, None for other managers.

    `columns` has 8 bytes for each figure and reaction of a run, as there may be a million runs, by kind ("figure", or
    "delay" and "thought" of a reaction) and name; times in [s]. `inputs` are settings taken from published results.
    """

    manager: str
    task: str | None
    published: Published
    runs: int = 0
    successes: int = 0
    not_found: int = 0
    inputs: dict[str, float] = field(default_factory=dict)
    columns: "dict[tuple[str, str], array[float]]" = field(
        default_factory=lambda: defaultdict(lambda: array("d"))
    )

    def add(self, record: Mapping[str, Any], timing: Mapping[str, Any]) -> None:
        """Add the next run, in the order of seeds, with its timing, which may be empty."""
        for name, value in record.items():
            if name.startswith(INPUT):
                self.inputs[name.removeprefix(INPUT)] = value
            elif isinstance(value, int | float):
                column = self.columns["figure", name]
                column.extend([*[nan] * (self.runs - len(column)), value])
        for name, _, delay_s in record["reactions"]:
            self.columns["delay", name].append(delay_s)
        for name, compute_s in timing.get("reactions", ()):
            self.columns["thought", name].append(compute_s)
        self.runs += 1
        self.successes += record["outcome"] not in NO_SUCCESS
        self.not_found += SEARCH in record and record[SEARCH] is None

    @property
    def label(self) -> str:
        """Its name in the report; a star says that it was given figures of the paper."""
        return f"{self.manager}{f' ({self.task})' if self.task else ''}{'*' if self.inputs else ''}"

    def of(self, kind: str, name: str) -> Array:
        """Return a column by kind and name; a figure has one value for each run, up to the last run that has it."""
        return np.asarray(self.columns.get((kind, name), ()), dtype=float)

    def values(self, figure: str) -> tuple[Array, Array]:
        """Return seeds and values of a figure, of runs that have it; a failed search counts as long as the mission."""
        found, seeds = np.full(self.runs, nan), self.of("figure", "seed")
        found[: self.of("figure", figure).size] = self.of("figure", figure)
        if figure == SEARCH:
            found = np.where(np.isnan(found), np.floor(self.of("figure", "duration_s")), found)
        return seeds[~np.isnan(found)], found[~np.isnan(found)]

    @property
    def searches(self) -> Array:
        """The search times of the runs whose search succeeded [s]."""
        found = self.of("figure", SEARCH)
        return found[~np.isnan(found)]


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """A mission with some settings: one group of runs for each manager and task layer."""

    mission: str
    settings: Mapping[str, str]
    groups: tuple[Group, ...]

    @property
    def title(self) -> str:
        changed = ", ".join(f"{name} = {value}" for name, value in self.settings.items())
        return f"{self.mission} with {changed}" if changed else self.mission

    @property
    def figures(self) -> tuple[str, ...]:
        """All figures that are numbers in some run, in the order of the results."""
        names = [name for group in self.groups for kind, name in group.columns if kind == "figure"]
        return tuple(dict.fromkeys(name for name in names if name not in NO_FIGURES))

    @property
    def uncertainties(self) -> tuple[str, ...]:
        return tuple(
            sorted(
                {name for group in self.groups for kind, name in group.columns if kind == "delay"}
            )
        )


def comparisons(kept: Kept) -> list[Comparison]:
    """Return the comparisons of a campaign, without those that have no runs yet."""
    parts = defaultdict[Any, dict[Any, Group]](dict)
    for record, timing in kept.rows():
        if record["outcome"] != CRASHED:
            groups = parts[record["mission"], tuple(record["settings"].items())]
            layer = record["manager"], record["task"]
            if layer not in groups:
                groups[layer] = Group(
                    *layer, PAPER.get((record["mission"], record["manager"]), Published({}, {}))
                )
            groups[layer].add(record, timing)
    return [
        Comparison(mission, dict(settings), (*parts[mission, settings].values(),))
        for mission, settings in parts
    ]


# -------------------------------------------------------------------- statistics: pure functions of plain samples

DRAWS = 10_000
MOST_DRAWN = 2_000_000  # values in memory at once
MOST_RESAMPLED = 10_000  # of more values, means and deviations are nearly normally distributed
LEVEL = 0.95


class Interval(NamedTuple):
    """An estimate from a sample, and the ends of its 95 % confidence interval."""

    estimate: float
    low: float
    high: float

    def shown(self, format_: str) -> str:
        """Return it as text, with its numbers in a format such as ".2f"."""
        return f"{self.estimate:{format_}} [{self.low:{format_}}, {self.high:{format_}}]"


class Clusters(NamedTuple):
    """A sample cut in two so that the variance within the parts is least.

    The separation is the distance of the means, divided by the root of the mean variance within the parts (infinite if
    that is 0). The halves of a uniform distribution have 3.5, those of a normal one 2.6; a larger one means clusters.
    """

    cut: float
    low: float
    high: float
    share_low: float
    separation: float


def interval_of_mean(values: Values, rng: Generator) -> Interval:
    """Return the mean of at least one value and its interval by the bootstrap (percentiles of 10,000 resamples).

    For more than 10,000 values it is that of a normal distribution, which differs less than resampling varies.
    """
    sample = _sample(values)
    return _interval(sample, sample.mean(), sample.std(), lambda drawn: drawn.mean(axis=1), rng)


def interval_of_sd(values: Values, rng: Generator) -> Interval:
    """Return the standard deviation (divisor n - 1) and its interval, as for the mean; NaN for a single value."""
    sample = _sample(values)
    if sample.size < 2:
        return Interval(math.nan, math.nan, math.nan)
    sd = sample.std(ddof=1)
    spread = (
        np.square(sample - sample.mean()).std() / (2 * sd) if sd else 0.0
    )  # of the variance, by the delta method
    return _interval(sample, sd, spread, lambda drawn: drawn.std(axis=1, ddof=1), rng)


def paired(first: Values, second: Values) -> tuple[Interval, float]:
    """Return the mean difference of pairs of values with its interval, and p of Student's paired test."""
    from scipy.stats import ttest_rel

    differences = _sample(first) - _sample(second)
    mean = float(differences.mean())
    if np.ptp(differences) == 0:
        return Interval(mean, mean, mean), float(mean == 0)
    result = ttest_rel(first, second)
    ends = result.confidence_interval(LEVEL)
    return Interval(mean, float(ends.low), float(ends.high)), float(result.pvalue)


def holm(ps: Sequence[float]) -> list[float]:
    """Correct p-values for multiple tests (Holm 1979); they keep their order."""
    order = np.argsort(ps)
    corrected = np.minimum(
        np.maximum.accumulate(np.take(ps, order) * np.arange(len(ps), 0, -1)), 1.0
    )
    return [float(one) for one in corrected[np.argsort(order)]]


def two_clusters(values: Values) -> Clusters | None:
    """Cut a sample in two so that the variance within the parts is least; None if all values are the same."""
    sample = np.sort(np.asarray(values, dtype=float))
    parts = [np.split(sample, [cut]) for cut in np.flatnonzero(np.diff(sample)) + 1]
    if not parts:
        return None
    low, high = min(
        parts, key=lambda part: part[0].var() * part[0].size + part[1].var() * part[1].size
    )
    spread, apart = math.sqrt((low.var() + high.var()) / 2), float(high.mean() - low.mean())
    cut = (float(low[-1]) + float(high[0])) / 2
    separation = apart / spread if spread else math.inf
    return Clusters(cut, float(low.mean()), float(high.mean()), low.size / sample.size, separation)


def _sample(values: Values) -> Array:
    sample = np.asarray(values, dtype=float)
    if not sample.size:
        raise ValueError("a sample needs one value or more")
    return sample


def _interval(
    sample: Array,
    estimate: float,
    spread: float,
    statistic: Callable[[Array], Array],
    rng: Generator,
) -> Interval:
    """Return an estimate with its interval; for many values, as the mean of values with this `spread`.

    The statistic maps resamples (k, n) to estimates (k,).
    """
    if sample.size > MOST_RESAMPLED:
        off = NormalDist().inv_cdf((1 + LEVEL) / 2) * spread / math.sqrt(sample.size)
        return Interval(float(estimate), float(estimate - off), float(estimate + off))
    at_once = max(1, MOST_DRAWN // sample.size)
    counts = [min(at_once, DRAWS - start) for start in range(0, DRAWS, at_once)]
    estimates = [
        statistic(sample[rng.integers(sample.size, size=(count, sample.size))]) for count in counts
    ]
    low, high = np.percentile(np.concatenate(estimates), [50 * (1 - LEVEL), 50 * (1 + LEVEL)])
    return Interval(float(estimate), float(low), float(high))
