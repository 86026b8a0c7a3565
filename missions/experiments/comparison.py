"""The runs of a campaign in groups to compare, and the published figures."""

from array import array
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import nan
from typing import Any, Final, NamedTuple

import numpy as np

from missions.engine.mission import NO_SUCCESS
from missions.experiments.results import CRASHED, Kept
from missions.experiments.statistics import Array

SEARCH = "search_time_s"
INPUT = "input_from_paper_"
NO_FIGURES = {"seed", "task"}


class Published(NamedTuple):
    """A row of the paper's table: by figure the mean and standard deviation, and mean reaction times [s]."""

    figures: Mapping[str, tuple[float, float]]
    reactions_s: Mapping[str, float]


def _row(search_s: tuple[float, float], distance_m: tuple[float, float], **reactions_s: float) -> Published:
    return Published({SEARCH: search_s, "distance_inspected_m": distance_m}, reactions_s)  # its head says seconds


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
    columns: "dict[tuple[str, str], array[float]]" = field(default_factory=lambda: defaultdict(lambda: array("d")))

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
        return tuple(sorted({name for group in self.groups for kind, name in group.columns if kind == "delay"}))


def comparisons(kept: Kept) -> list[Comparison]:
    """Return the comparisons of a campaign, without those that have no runs yet."""
    parts = defaultdict[Any, dict[Any, Group]](dict)
    for record, timing in kept.rows():
        if record["outcome"] != CRASHED:
            groups = parts[record["mission"], tuple(record["settings"].items())]
            layer = record["manager"], record["task"]
            if layer not in groups:
                groups[layer] = Group(*layer, PAPER.get((record["mission"], record["manager"]), Published({}, {})))
            groups[layer].add(record, timing)
    return [Comparison(mission, dict(settings), (*parts[mission, settings].values(),)) for mission, settings in parts]
