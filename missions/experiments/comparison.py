"""The runs of a campaign in groups, the published figures, and statistics."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import floor, inf, sqrt
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from missions.engine.mission import NO_SUCCESS, needs
from missions.experiments.results import CRASHED, Results

Array = NDArray[np.float64]
Values = Sequence[float] | Array

SEARCH: Final = "search_time_s"
INPUT: Final = "input_from_paper_"


Published = dict[str, tuple[float, ...]]
"""Of a row of the paper's table: by figure the mean and standard deviation, by uncertainty the mean
reaction [s]."""


def _row(
    search_s: tuple[float, float], distance_m: tuple[float, float], *reactions_s: float
) -> Published:
    reactions = {f"U{number}": (mean,) for number, mean in enumerate(reactions_s, start=1)}
    return {SEARCH: search_s, "distance_inspected_m": distance_m, **reactions}


PAPER: Final = {
    ("suave", "none"): _row((174.75, 36.00), (33.20, 13.49)),
    ("suave", "bt"): _row((84.09, 26.41), (62.70, 7.78), 0.08, 0.10),
    ("suave", "metacontrol"): _row((89.24, 35.57), (60.57, 11.17), 1.55, 0.82),
    ("suave", "rosa"): _row((85.11, 32.48), (60.76, 10.29), 1.24, 1.57),
    ("suave_extended", "bt"): _row((94.37, 34.92), (20.88, 3.81), 0.07, 0.10, 1.09),
    ("suave_extended", "rosa"): _row((92.75, 35.92), (18.97, 3.38), 1.39, 1.67, 2.50),
}
"""By mission and manager."""


@dataclass
class Group:
    """The runs of one manager that did not crash.

    `task` is the task layer of ours, None for other managers.
    """

    mission: str
    manager: str
    task: str | None
    records: list[Mapping[str, Any]] = field(default_factory=list)

    @property
    def published(self) -> Published:
        """What the paper says."""
        return PAPER.get((self.mission, self.manager), {})

    @property
    def inputs(self) -> dict[str, float]:
        """The settings that were taken from published results."""
        items = [item for record in self.records for item in record.items()]
        return {name.removeprefix(INPUT): value for name, value in items if name.startswith(INPUT)}

    @property
    def label(self) -> str:
        """Its name in the report; a star says that it was given figures of the paper."""
        return f"{self.manager}{f' ({self.task})' if self.task else ''}{'*' if self.inputs else ''}"

    @property
    def successes(self) -> int:
        """How many runs have reached their goal."""
        return sum(record["outcome"] not in NO_SUCCESS for record in self.records)

    def values(self, figure: str) -> dict[int, float]:
        """Return a figure by the seed of the run; a failed search counts as long as the mission."""
        values = {}
        for record in self.records:
            value = record.get(figure)
            if figure == SEARCH and value is None and SEARCH in record:
                value = floor(record["duration_s"])
            if value is not None:
                values[record["seed"]] = float(value)
        return values

    def delays(self, uncertainty: str) -> Array:
        """Return the delays of the reactions to an uncertainty [s]."""
        reactions = [reaction for record in self.records for reaction in record["reactions"]]
        return np.array([delay_s for name, _, delay_s in reactions if name == uncertainty])


class Comparison(NamedTuple):
    """A mission with some settings: one group of runs for each manager and task layer."""

    mission: str
    settings: Mapping[str, str]
    groups: list[Group]

    @property
    def title(self) -> str:
        """The mission with its settings, as text."""
        changed = ", ".join(f"{name} = {value}" for name, value in self.settings.items())
        return f"{self.mission} with {changed}" if changed else self.mission

    @property
    def figures(self) -> list[str]:
        """All figures that are numbers in some run, in the order of the results."""
        records = [record for group in self.groups for record in group.records]
        names = dict.fromkeys(
            name
            for record in records
            for name, value in record.items()
            if isinstance(value, int | float) and name != "seed" and not name.startswith(INPUT)
        )
        return list(names)

    @property
    def uncertainties(self) -> list[str]:
        """All uncertainties to which some run reacted."""
        records = [record for group in self.groups for record in group.records]
        return sorted({name for record in records for name, *_ in record["reactions"]})


def comparisons(results: Results) -> list[Comparison]:
    """Return the comparisons of a campaign, without those that have no runs yet."""
    parts: dict[Any, dict[Any, Group]] = {}
    for record in results.records:
        if record["outcome"] != CRASHED:
            groups = parts.setdefault((record["mission"], (*record["settings"].items(),)), {})
            layer = record["mission"], record["manager"], record["task"]
            groups.setdefault(layer, Group(*layer)).records.append(record)
    return [
        Comparison(mission, dict(settings), [*groups.values()])
        for (mission, settings), groups in parts.items()
    ]


class Interval(NamedTuple):
    """A mean, the ends of its 95 % confidence interval, and p of the test that it is 0.

    A single value has no interval: its ends are infinite.
    """

    mean: float
    low: float
    high: float
    p: float
    observations: int

    def __format__(self, spec: str) -> str:
        return f"{self.mean:{spec}} [{self.low:{spec}}, {self.high:{spec}}]"


def mean_of(values: Values) -> Interval:
    """Return the mean of values with Student's interval.

    Of differences, it is the paired test.
    """
    with needs("plot", "an interval"):
        from scipy.stats import t

    mean = float(np.mean(values))
    freedom = len(values) - 1
    if not freedom:
        return Interval(mean, -inf, inf, 1.0, 1)
    error = float(np.std(values, ddof=1)) / sqrt(len(values))
    if error == 0:
        return Interval(mean, mean, mean, float(mean == 0), len(values))
    low, high = t.interval(0.95, freedom, mean, error)
    p = float(2 * t.sf(abs(mean / error), freedom))
    return Interval(mean, float(low), float(high), p, len(values))


def holm(ps: Sequence[float]) -> list[float]:
    """Correct p-values for multiple tests (Holm 1979); they keep their order."""
    order = np.argsort(ps)
    ranked = np.maximum.accumulate(np.take(ps, order) * np.arange(len(ps), 0, -1))
    corrected = np.minimum(ranked, 1.0)
    return [float(p) for p in corrected[np.argsort(order)]]
