"""The runs of a campaign in groups that are compared, and the published figures beside them."""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import floor
from types import MappingProxyType
from typing import Any

from missions.experiments.results import Kept
from missions.experiments.work import CRASHED


@dataclass(frozen=True, slots=True)
class Published:
    """A row of the table.

    Attributes:
        search_s: mean and standard deviation of the search time [s].
        distance_m: mean and standard deviation of the distance inspected [m]; the head of its column says seconds.
        reactions_s: mean reaction time to each uncertainty [s].
    """

    search_s: tuple[float, float]
    distance_m: tuple[float, float]
    reactions_s: Mapping[str, float]

    def of(self, figure: str) -> tuple[float, float] | None:
        """Return mean and standard deviation of a figure by its name among the results."""
        return {"search_time_s": self.search_s, "distance_inspected_m": self.distance_m}.get(figure)


PAPER: Mapping[tuple[str, str], Published] = MappingProxyType(
    {
        ("suave", "none"): Published((174.75, 36.00), (33.20, 13.49), {}),
        ("suave", "bt"): Published((84.09, 26.41), (62.70, 7.78), {"U1": 0.08, "U2": 0.10}),
        ("suave", "metacontrol"): Published((89.24, 35.57), (60.57, 11.17), {"U1": 1.55, "U2": 0.82}),
        ("suave", "rosa"): Published((85.11, 32.48), (60.76, 10.29), {"U1": 1.24, "U2": 1.57}),
        ("suave_extended", "bt"): Published((94.37, 34.92), (20.88, 3.81), {"U1": 0.07, "U2": 0.10, "U3": 1.09}),
        ("suave_extended", "rosa"): Published((92.75, 35.92), (18.97, 3.38), {"U1": 1.39, "U2": 1.67, "U3": 2.50}),
    }
)
"""By mission and manager."""


SEARCH = "search_time_s"
NO_FIGURES = {"seed", "task"}


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """The runs of one manager that did not crash.

    Attributes:
        manager: its name.
        task: the task layer of ours; None if the manager brings its own.
        records: by seed.
        timings: how long each took, by seed, as far as that is known.
        published: the row of the paper's table; None if there is none.
    """

    manager: str
    task: str | None
    records: Mapping[int, Mapping[str, Any]]
    timings: Mapping[int, Mapping[str, Any]]
    published: Published | None

    @property
    def label(self) -> str:
        """What it is called in the report; a star says that figures of the paper were put in."""
        return f"{self.manager}{f' ({self.task})' if self.task else ''}{'*' if self.inputs else ''}"

    @property
    def inputs(self) -> dict[str, float]:
        """What was taken from published results of the manager, by name."""
        prefix = "input_from_paper_"
        return {
            name.removeprefix(prefix): value
            for record in self.records.values()
            for name, value in record.items()
            if name.startswith(prefix)
        }

    @property
    def reactions_published(self) -> Mapping[str, float]:
        """The published mean reaction time to each uncertainty [s]; empty if there is none."""
        return self.published.reactions_s if self.published else {}

    @property
    def not_found(self) -> int:
        """How many runs never found what they searched for."""
        return sum(SEARCH in record and record[SEARCH] is None for record in self.records.values())

    @property
    def searches(self) -> list[float]:
        """The search times of the runs that found what they searched for [s]."""
        return [float(record[SEARCH]) for record in self.records.values() if record.get(SEARCH) is not None]

    def values(self, figure: str) -> dict[int, float]:
        """Return a figure by seed; as in SUAVE, a search without success takes as long as the mission."""
        found = {}
        for seed, record in self.records.items():
            value = record.get(figure)
            if value is None and figure == SEARCH:
                value = floor(record["duration_s"])
            if value is not None:
                found[seed] = float(value)
        return found

    def delays(self, uncertainty: str) -> list[float]:
        """Return every reaction time to an uncertainty [s], in simulated time."""
        told = (one for record in self.records.values() for one in record["reactions"])
        return [delay_s for name, _, delay_s in told if name == uncertainty]

    def thought(self, uncertainty: str) -> list[float]:
        """Return the time of the machine that each of these reactions took [s]."""
        told = (one for timing in self.timings.values() for one in timing["reactions"])
        return [compute_s for name, compute_s in told if name == uncertainty]


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """A mission with some settings, under several managers.

    Attributes:
        mission: its name.
        settings: what differs from the defaults.
        groups: one for each manager and task layer that has runs.
    """

    mission: str
    settings: Mapping[str, str]
    groups: tuple[Group, ...]

    @property
    def title(self) -> str:
        """What it is called in the report."""
        changed = ", ".join(f"{name} = {value}" for name, value in self.settings.items())
        return f"{self.mission} with {changed}" if changed else self.mission

    @property
    def figures(self) -> tuple[str, ...]:
        """Every figure that is a number in some run, in the order of the results."""
        names = {
            name: None
            for group in self.groups
            for record in group.records.values()
            for name, value in record.items()
            if isinstance(value, int | float) and name not in NO_FIGURES and not name.startswith("input_from_paper_")
        }
        return tuple(names)

    @property
    def uncertainties(self) -> tuple[str, ...]:
        """Every uncertainty that was reacted to."""
        found = {one[0] for group in self.groups for record in group.records.values() for one in record["reactions"]}
        return tuple(sorted(found))


def comparisons(kept: Kept) -> Iterator[Comparison]:
    """Yield what is compared in a campaign; what has no runs yet is left out."""
    parts: dict[Any, dict[Any, dict[int, Mapping[str, Any]]]] = defaultdict(lambda: defaultdict(dict))
    for record in kept.records.values():
        if record["outcome"] != CRASHED:
            place = record["mission"], tuple(record["settings"].items())
            parts[place][record["manager"], record["task"]][record["seed"]] = record
    for (mission, settings), layers in parts.items():
        groups = tuple(
            Group(manager, task, records, _timings(kept, records), PAPER.get((mission, manager)))
            for (manager, task), records in layers.items()
        )
        yield Comparison(mission, dict(settings), groups)


def _timings(kept: Kept, records: Mapping[int, Mapping[str, Any]]) -> dict[int, Mapping[str, Any]]:
    return {seed: kept.timings[record["run"]] for seed, record in records.items() if record["run"] in kept.timings}
