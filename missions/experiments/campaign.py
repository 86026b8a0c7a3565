"""The definition of a campaign: read from a file, checked before it begins, and expanded into named runs."""

import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from itertools import count, product
from pathlib import Path
from typing import Any, Final

from missions.baselines import MANAGERS, OURS, open_run
from missions.engine.mission import MissionError
from missions.engine.registry import find_mission
from missions.engine.runner import MissionRun
from missions.engine.settings import near
from missions.engine.task_layer import check_task
from missions.views.output import files_tried

Settings = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """One run of a campaign. `settings` are those that are not default; `task` is None if the manager has its own.

    The n-th run has the same seed under every manager, so that they meet the same world. `place` is its index among
    the runs of the campaign.
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
        return "/".join(filter(None, [self.mission, self.manager, self.task, changed, str(self.seed)]))

    @property
    def command(self) -> str:
        """The command line that repeats this run alone, with its full output."""
        task = f" --task {self.task}" if self.task else ""
        changed = "".join(f" --set {name}={value}" for name, value in self.settings)
        return f"rosa run {self.mission} --manager {self.manager}{task} --seed {self.seed}{changed}"

    def open(self) -> MissionRun:
        """Open the run; MissionError if that is not possible."""
        mission, settings = find_mission(self.mission), dict(self.settings)
        return open_run(mission, manager=self.manager, task=self.task, seed=self.seed, settings=settings)


@dataclass(frozen=True, slots=True)
class Campaign:
    """Every mission with every manager, task layer, set of settings and seed; the fields are the keys of its file.

    Attributes:
        name: of its folder of results.
        missions: names of missions, or "module:NAME".
        managers: names of managers, or "package:Class".
        tasks: task layers for our manager, "bt" and "pddl"; the other managers bring their own.
        runs: how many of each combination.
        first_seed: the seed of the first run of each; the next ones follow.
        settings: those that differ from the defaults in all runs.
        cases: sets of settings, each combined with everything else.
        sweep: values by name of a setting; all combinations are run.
    """

    name: str
    missions: tuple[str, ...]
    managers: tuple[str, ...] = (OURS,)
    tasks: tuple[str, ...] = ("bt",)
    runs: int = 10
    first_seed: int = 0
    settings: Settings = field(default_factory=dict)
    cases: tuple[Settings, ...] = ()
    sweep: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def variants(self) -> tuple[tuple[tuple[str, str], ...], ...]:
        """Every set of settings, as sorted pairs of name and value."""
        points = [dict(zip(self.sweep, values, strict=True)) for values in product(*self.sweep.values())]
        sets = product(self.cases or ({},), points)
        return tuple(tuple(sorted({**self.settings, **case, **point}.items())) for case, point in sets)

    @property
    def layers(self) -> tuple[tuple[str, str | None], ...]:
        """Every manager with each task layer that it can have."""
        return tuple((one, task) for one in self.managers for task in (self.tasks if one == OURS else (None,)))

    def planned(self) -> Iterator[PlannedRun]:
        """Yield every run, in the order in which results are listed; there may be a million."""
        places, seeds = count(), range(self.first_seed, self.first_seed + self.runs)
        for mission, settings, layer, seed in product(self.missions, self.variants, self.layers, seeds):
            yield PlannedRun(mission, *layer, seed, settings, next(places))

    @property
    def size(self) -> int:
        """How many runs are planned."""
        return len(self.missions) * len(self.variants) * len(self.layers) * self.runs

    @property
    def own_modules(self) -> tuple[str, ...]:
        """The modules of missions and managers of one's own."""
        names = (name.partition(":") for name in (*self.missions, *self.managers))
        return tuple(dict.fromkeys(module for module, colon, _ in names if colon))


def paper_table(runs: int = 100) -> Campaign:
    """Return the campaign behind the table of the ROSA paper: both missions under every manager, rules of 2024."""
    return Campaign("paper_table", ("suave", "suave_extended"), (*MANAGERS, OURS), ("bt", "pddl"), runs)


def read_campaign(path: Path) -> Campaign:
    """Read a campaign from a TOML file; raises MissionError if it cannot be read, or says what is not expected."""
    with files_tried(f"read {path}"):
        content = path.read_bytes()
    try:
        data = tomllib.loads(content.decode())
    except ValueError as error:
        raise MissionError(f"{path} is no TOML: {error}") from error
    return from_data({"name": path.stem} | data, str(path))


def _is_value(value: object) -> bool:
    return isinstance(value, str | int | float)


def _is_table(value: object) -> bool:
    return isinstance(value, dict) and all(map(_is_value, value.values()))


def _is_words(value: object) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(word, str) and word for word in value)


def _is_folder(value: object) -> bool:
    return isinstance(value, str) and bool(value) and "/" not in value and not value.startswith(".")


def _is_sweep(value: object) -> bool:
    tried = value.values() if isinstance(value, dict) else [None]
    return all(isinstance(values, list) and values and all(map(_is_value, values)) for values in tried)


_WORDS: Final = (_is_words, "a list of one name or more")
_KEYS: Final[Mapping[str, tuple[Callable[[Any], bool], str]]] = {
    "name": (_is_folder, "a word that can be the name of a folder"),
    "missions": _WORDS,
    "managers": _WORDS,
    "tasks": _WORDS,
    "runs": (lambda value: type(value) is int and value >= 1, "a whole number from 1"),
    "first_seed": (lambda value: type(value) is int and value >= 0, "a whole number from 0"),
    "settings": (_is_table, "a table of names, each with a number, a word, true or false"),
    "cases": (
        lambda value: isinstance(value, list) and all(map(_is_table, value)),
        "a list of tables as settings",
    ),
    "sweep": (_is_sweep, "a table of names, each with a list of numbers, words, true or false"),
    "rules": (_is_value, "a year"),
}
"""The keys of a campaign file: the check of each value, and what the message says is expected."""


def from_data(data: Mapping[str, Any], source: str) -> Campaign:
    """Make a campaign from plain data: its fields by name; `rules` is short for the setting of that name.

    Raises:
        MissionError: a key or value is not what is expected; the message names the source.
    """
    for key, value in data.items():
        if key not in _KEYS:
            close = near(key, _KEYS)
            hint = f"did you mean {close[0]}?" if close else f"there are {', '.join(_KEYS)}"
            raise MissionError(f"{source}: unknown key {key!r}; {hint}")
        holds, expected = _KEYS[key]
        if not holds(value):
            raise MissionError(f"{source}: {key} is {value!r}; expected is {expected}")
    if "missions" not in data:
        raise MissionError(f'{source} says no missions; add, for example, missions = ["suave"]')
    given: dict[str, Any] = {key: tuple(one) if isinstance(one, list) else one for key, one in data.items()}
    rules = {"rules": given.pop("rules")} if "rules" in given else {}
    given["settings"] = _texts({**data.get("settings", {}), **rules})
    given["cases"] = tuple(map(_texts, data.get("cases", ())))
    given["sweep"] = {name: tuple(map(_text, values)) for name, values in data.get("sweep", {}).items()}
    campaign = Campaign(**given)
    _check_once(campaign, source)
    return campaign


def _texts(values: Mapping[str, object]) -> dict[str, str]:
    return {name: _text(value) for name, value in values.items()}


def _text(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def check_campaign(campaign: Campaign) -> None:
    """Open one run of each combination to check it; MissionError if something does not exist or is not allowed."""
    for task in campaign.tasks:
        check_task(task)
    if campaign.runs < 1:
        raise MissionError(f"a campaign of {campaign.runs} runs does nothing; ask for 1 at least")
    for name, settings, layer in product(campaign.missions, campaign.variants, campaign.layers):
        run = PlannedRun(name, *layer, campaign.first_seed, settings).open()
        with closing(run.world):
            run.end()


def _check_once(campaign: Campaign, source: str) -> None:
    """Refuse a value that is listed twice, or a setting that is given in two places."""
    lists = {name: getattr(campaign, name) for name in ("missions", "managers", "tasks", "cases")}
    for name, values in {**lists, **campaign.sweep}.items():
        twice = next((value for value in values if values.count(value) > 1), None)
        if twice is not None:
            raise MissionError(f"{source}: {name} has {twice} twice; once is enough")
    places = [("settings", campaign.settings), ("sweep", campaign.sweep), *(("cases", one) for one in campaign.cases)]
    for (one, names), (other, others) in product(places, places):
        if one != other and (both := set(names) & set(others)):
            raise MissionError(f"{source}: {min(both)} is given in {one} and in {other}; give it once")
