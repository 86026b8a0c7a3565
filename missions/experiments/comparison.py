"""The runs of a campaign in groups that are compared, and the published figures beside them."""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import floor
from typing import Any, Final, NamedTuple

from missions.engine.mission import NO_SUCCESS
from missions.experiments.results import CRASHED, Kept


class Published(NamedTuple):
    """A row of the paper's table: means and standard deviations, and mean reaction times to each uncertainty [s]."""

    search_s: tuple[float, float]
    distance_m: tuple[float, float]  # the head of its column says seconds
    reactions_s: Mapping[str, float]

    def of(self, figure: str) -> tuple[float, float] | None:
        """Return mean and standard deviation of a figure by its name among the results."""
        return {"search_time_s": self.search_s, "distance_inspected_m": self.distance_m}.get(figure)


PAPER: Final = {
    ("suave", "none"): Published((174.75, 36.00), (33.20, 13.49), {}),
    ("suave", "bt"): Published((84.09, 26.41), (62.70, 7.78), {"U1": 0.08, "U2": 0.10}),
    ("suave", "metacontrol"): Published((89.24, 35.57), (60.57, 11.17), {"U1": 1.55, "U2": 0.82}),
    ("suave", "rosa"): Published((85.11, 32.48), (60.76, 10.29), {"U1": 1.24, "U2": 1.57}),
    ("suave_extended", "bt"): Published((94.37, 34.92), (20.88, 3.81), {"U1": 0.07, "U2": 0.10, "U3": 1.09}),
    ("suave_extended", "rosa"): Published((92.75, 35.92), (18.97, 3.38), {"U1": 1.39, "U2": 1.67, "U3": 2.50}),
}
"""By mission and manager."""


SEARCH = "search_time_s"
INPUT = "input_from_paper_"
NO_FIGURES = {"seed", "task"}


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """The runs of one manager that did not crash, by seed; `task` is the task layer of ours, None for other managers.

    Timings say how long each took, as far as that is known.
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
        figures = [one for record in self.records.values() for one in record.items()]
        return {name.removeprefix(INPUT): value for name, value in figures if name.startswith(INPUT)}

    def published_of(self, figure: str) -> tuple[float, float] | None:
        """Return the published mean and standard deviation of a figure, if there are."""
        return self.published.of(figure) if self.published else None

    def published_reaction(self, uncertainty: str) -> float | None:
        """Return the published mean reaction time to an uncertainty [s], if there is one."""
        return self.published.reactions_s.get(uncertainty) if self.published else None

    @property
    def not_found(self) -> int:
        """How many runs never found what they searched for."""
        return sum(SEARCH in record and record[SEARCH] is None for record in self.records.values())

    @property
    def successes(self) -> int:
        return sum(record["outcome"] not in NO_SUCCESS for record in self.records.values())

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
        reactions = (one for record in self.records.values() for one in record["reactions"])
        return [delay_s for name, _, delay_s in reactions if name == uncertainty]

    def thought(self, uncertainty: str) -> list[float]:
        """Return the time of the machine that each of these reactions took [s]."""
        reactions = (one for timing in self.timings.values() for one in timing["reactions"])
        return [compute_s for name, compute_s in reactions if name == uncertainty]


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """A mission with some settings, under several managers: one group for each that has runs, and each task layer."""

    mission: str
    settings: Mapping[str, str]
    groups: tuple[Group, ...]

    @property
    def title(self) -> str:
        changed = ", ".join(f"{name} = {value}" for name, value in self.settings.items())
        return f"{self.mission} with {changed}" if changed else self.mission

    @property
    def figures(self) -> tuple[str, ...]:
        """Every figure that is a number in some run, in the order of the results."""
        figures = [one for group in self.groups for record in group.records.values() for one in record.items()]
        names = dict.fromkeys(name for name, value in figures if isinstance(value, int | float))
        return tuple(name for name in names if name not in NO_FIGURES and not name.startswith(INPUT))

    @property
    def uncertainties(self) -> tuple[str, ...]:
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
        groups = []
        for (manager, task), records in layers.items():
            names = {seed: record["run"] for seed, record in records.items()}
            timings = {seed: kept.timings[name] for seed, name in names.items() if name in kept.timings}
            groups.append(Group(manager, task, records, timings, PAPER.get((mission, manager))))
        yield Comparison(mission, dict(settings), tuple(groups))
