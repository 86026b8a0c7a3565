"""A campaign: what is to run, read from a file and expanded into named runs."""

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from itertools import count, product
from pathlib import Path
from typing import Any, Final

from missions.baselines import MANAGERS, OURS, open_run
from missions.engine.faults import Fault, read_fault
from missions.engine.mission import MissionError, find_mission
from missions.engine.runner import MissionRun
from missions.engine.settings import from_table, read_toml
from missions.engine.task_layer import check_task

Settings = Mapping[str, str]
FAULTS: Final = "faults"
"""The setting of a campaign that has the faults to inject, separated by semicolons."""


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """One run of a campaign. `settings` are those that are not default.

    `task` is None if the manager has its own.

    The n-th run has the same seed under every manager, so that they meet the same world. `place` is
    its index among the runs of the campaign.
    """

    mission: str
    manager: str
    task: str | None
    seed: int
    settings: tuple[tuple[str, str], ...] = ()
    place: int = field(default=0, compare=False)

    @property
    def name(self) -> str:
        """Its name. Apart from the code, the results depend on nothing else."""
        changed = ",".join(f"{name}={value}" for name, value in self.settings)
        return "/".join(
            filter(None, [self.mission, self.manager, self.task, changed, str(self.seed)])
        )

    @property
    def command(self) -> str:
        """The command line that repeats this run alone, with its full output."""
        words = ["rosa run", self.mission, "--manager", self.manager]
        words += ["--task", self.task] if self.task else []
        words += ["--seed", str(self.seed)]
        for name, value in self.settings:
            words += [] if name == FAULTS else ["--set", f"{name}={value}"]
        for fault in self.faults:
            words.append(f"--{fault}")
        return " ".join(words)

    def open(self) -> MissionRun:
        """Open the run; MissionError if that is not possible."""
        settings = {name: value for name, value in self.settings if name != FAULTS}
        run = open_run(
            find_mission(self.mission),
            manager=self.manager,
            task=self.task,
            seed=self.seed,
            settings=settings,
        )
        try:
            run.faults.add(*self.faults)
        except BaseException:
            run.world.close()
            raise
        return run

    @property
    def faults(self) -> tuple[Fault, ...]:
        """The faults that are injected, see `missions.engine.faults`."""
        texts = dict(self.settings).get(FAULTS, "").split(";")
        return tuple(read_fault(text) for text in texts if text.strip())


@dataclass(frozen=True, slots=True)
class Campaign:
    """Every mission with every manager, task layer, set of settings and seed.

    The fields are the keys of its file.

    Attributes:
        name: of its folder of results.
        missions: names of missions, or "module:NAME".
        managers: names of managers, or "package:Class".
        tasks: task layers for our manager, "bt" and "pddl"; the other managers bring their own.
        runs: how many of each combination.
        first_seed: the seed of the first run of each; the next ones follow.
        settings: those that differ from the defaults in all runs; "faults" has the faults to
            inject, such as "fail boom@60; recover boom@90".
        cases: sets of settings, each combined with everything else.
        sweep: values by name of a setting; all combinations are run.
    """

    name: str
    missions: tuple[str, ...] = ()
    managers: tuple[str, ...] = (OURS,)
    tasks: tuple[str, ...] = ("bt",)
    runs: int = 10
    first_seed: int = 0
    settings: Settings = field(default_factory=dict)
    cases: tuple[Settings, ...] = ()
    sweep: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def variants(self) -> list[tuple[tuple[str, str], ...]]:
        """Every set of settings, as sorted pairs of name and value."""
        variants = []
        for case, values in product(self.cases or ({},), product(*self.sweep.values())):
            point = dict(zip(self.sweep, values, strict=True))
            variants.append(tuple(sorted({**self.settings, **case, **point}.items())))
        return variants

    @property
    def layers(self) -> list[tuple[str, str | None]]:
        """Every manager with each task layer that it can have."""
        layers: list[tuple[str, str | None]] = []
        for manager in self.managers:
            layers += [(manager, task) for task in (self.tasks if manager == OURS else (None,))]
        return layers

    def planned(self) -> Iterator[PlannedRun]:
        """Yield every run, in the order in which results are listed."""
        places = count()
        seeds = range(self.first_seed, self.first_seed + self.runs)
        for mission, settings, layer, seed in product(
            self.missions, self.variants, self.layers, seeds
        ):
            yield PlannedRun(mission, *layer, seed, settings, next(places))

    @property
    def size(self) -> int:
        """How many runs are planned."""
        return len([*self.planned()])

    @property
    def own_modules(self) -> list[str]:
        """The modules of missions and managers that are not of the registry."""
        return [name.split(":")[0] for name in (*self.missions, *self.managers) if ":" in name]


def paper_table(runs: int = 100) -> Campaign:
    """Return the campaign behind the table of the ROSA paper.

    Both missions under every manager, rules of 2024.
    """
    missions = ("suave", "suave_extended")
    published = {"late_boot_share": "0.015"}  # fitted to the published deviations, see docs/sea.md
    return Campaign(
        "paper_table", missions, (*MANAGERS, OURS), ("bt", "pddl"), runs, settings=published
    )


def read_campaign(path: Path) -> Campaign:
    """Read a campaign from a TOML file; `rules` is short for the setting of that name.

    Raises:
        MissionError: it cannot be read, or says what is not expected.
    """
    table = {"name": path.stem, **read_toml(path)}
    if "rules" in table:
        table["settings"] = {**table.get("settings", {}), "rules": table.pop("rules")}
    return from_data(table, str(path))


def from_data(data: Mapping[str, Any], source: str) -> Campaign:
    """Make a campaign from plain data: its fields by name.

    Raises:
        MissionError: a key or value is not what is expected; the message names the source.
    """
    campaign = from_table(Campaign, data, source)
    if "/" in campaign.name:
        raise MissionError(f"{source}: name is {campaign.name!r}; it names a folder, without /")
    if campaign.first_seed < 0:
        raise MissionError(f"{source}: first_seed is {campaign.first_seed}; expected is 0 or more")
    names = Counter(run.name for run in campaign.planned())
    if not names:
        raise MissionError(
            f"{source} says nothing to run; "
            'give missions such as ["suave"], a value in each list, and at least 1 run'
        )
    ((name, count),) = names.most_common(1)
    if count > 1:
        raise MissionError(f"{source} lists {name} {count} times; once is enough")
    return campaign


def check_campaign(campaign: Campaign) -> None:
    """Open one run of each combination to check it.

    MissionError if something does not exist or is not allowed.
    """
    for task in campaign.tasks:
        check_task(task)
    for name, settings, layer in product(campaign.missions, campaign.variants, campaign.layers):
        run = PlannedRun(name, *layer, campaign.first_seed, settings).open()
        with closing(run.world):
            run.release()
