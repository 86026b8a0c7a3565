"""A campaign: what is to run, read from a file and expanded into named runs, and the folder of its results.

The folder has an SQLite file with a row for each run, written when it is done, and CSV tables.
"""

import csv
import fcntl
import hashlib
import json
import os
import platform
import sqlite3
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from itertools import count, product
from pathlib import Path
from time import monotonic
from typing import Any, Final, NamedTuple, Self

from kb.files import draft, put
from missions.baselines import MANAGERS, OURS, open_run
from missions.engine.faults import Fault, read_fault
from missions.engine.mission import MissionError, find_mission
from missions.engine.runner import MissionRun
from missions.engine.settings import near
from missions.engine.task_layer import check_task
from missions.views.output import files_tried

Settings = Mapping[str, str]
FAULTS: Final = "faults"
"""The setting of a campaign that has the faults to inject, separated by semicolons."""


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
        return "/".join(
            filter(None, [self.mission, self.manager, self.task, changed, str(self.seed)])
        )

    @property
    def command(self) -> str:
        """The command line that repeats this run alone, with its full output."""
        task = f" --task {self.task}" if self.task else ""
        changed = "".join(
            f" --set {name}={value}" for name, value in self.settings if name != FAULTS
        )
        for fault in self.faults:
            verb, _, rest = str(fault).partition(" ")
            changed += f" --{verb} {rest}"
        return f"rosa run {self.mission} --manager {self.manager}{task} --seed {self.seed}{changed}"

    def open(self) -> MissionRun:
        """Open the run; MissionError if that is not possible."""
        settings = {name: value for name, value in self.settings if name != FAULTS}
        mission = find_mission(self.mission)
        run = open_run(
            mission, manager=self.manager, task=self.task, seed=self.seed, settings=settings
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
    """Every mission with every manager, task layer, set of settings and seed; the fields are the keys of its file.

    Attributes:
        name: of its folder of results.
        missions: names of missions, or "module:NAME".
        managers: names of managers, or "package:Class".
        tasks: task layers for our manager, "bt" and "pddl"; the other managers bring their own.
        runs: how many of each combination.
        first_seed: the seed of the first run of each; the next ones follow.
        settings: those that differ from the defaults in all runs; "faults" has the faults to inject, such as
            "fail boom@60; recover boom@90".
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
        points = [
            dict(zip(self.sweep, values, strict=True)) for values in product(*self.sweep.values())
        ]
        sets = product(self.cases or ({},), points)
        return tuple(
            tuple(sorted({**self.settings, **case, **point}.items())) for case, point in sets
        )

    @property
    def layers(self) -> tuple[tuple[str, str | None], ...]:
        """Every manager with each task layer that it can have."""
        return tuple(
            (one, task)
            for one in self.managers
            for task in (self.tasks if one == OURS else (None,))
        )

    def planned(self) -> Iterator[PlannedRun]:
        """Yield every run, in the order in which results are listed; there may be a million."""
        places, seeds = count(), range(self.first_seed, self.first_seed + self.runs)
        for mission, settings, layer, seed in product(
            self.missions, self.variants, self.layers, seeds
        ):
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
    missions = ("suave", "suave_extended")
    published = {"late_boot_share": "0.015"}  # fitted to the published deviations, see docs/sea.md
    return Campaign(
        "paper_table", missions, (*MANAGERS, OURS), ("bt", "pddl"), runs, settings=published
    )


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
    return (
        isinstance(value, list)
        and bool(value)
        and all(isinstance(word, str) and word for word in value)
    )


def _is_folder(value: object) -> bool:
    return isinstance(value, str) and bool(value) and "/" not in value and not value.startswith(".")


def _is_sweep(value: object) -> bool:
    tried = value.values() if isinstance(value, dict) else [None]
    return all(
        isinstance(values, list) and values and all(map(_is_value, values)) for values in tried
    )


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
    given: dict[str, Any] = {
        key: tuple(one) if isinstance(one, list) else one for key, one in data.items()
    }
    rules = {"rules": given.pop("rules")} if "rules" in given else {}
    given["settings"] = _texts({**data.get("settings", {}), **rules})
    given["cases"] = tuple(map(_texts, data.get("cases", ())))
    given["sweep"] = {
        name: tuple(map(_text, values)) for name, values in data.get("sweep", {}).items()
    }
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
    places = [
        ("settings", campaign.settings),
        ("sweep", campaign.sweep),
        *(("cases", one) for one in campaign.cases),
    ]
    for (one, names), (other, others) in product(places, places):
        if one != other and (both := set(names) & set(others)):
            raise MissionError(
                f"{source}: {min(both)} is given in {one} and in {other}; give it once"
            )


# -------------------------------------------------------------------- the folder of results

FORMAT: Final = 2
FILE: Final = "campaign.sqlite3"
SYNC_S: Final = 1.0
_TABLES: Final = """
    BEGIN;
    CREATE TABLE about (format INTEGER, campaign TEXT, provenance TEXT);
    CREATE TABLE runs (place INTEGER PRIMARY KEY, outcome TEXT, record TEXT, timing TEXT, traceback TEXT);
"""
"""`place` is `PlannedRun.place`; record, timing, campaign and provenance are JSON."""
CRASHED = "crashed"
"""Outcome of a run that raised an exception or killed its process."""

PACKAGES = ("kb", "rosa_bt", "rosa_pddl", "suave_env", "missions")
DISTRIBUTIONS = (
    "rosa-taca",
    "mujoco",
    "numpy",
    "ortools",
    "py-trees",
    "unified-planning",
    "up-fast-downward",
)


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of a run.

    Attributes:
        run: the run.
        code: fingerprint of the code that ran it; see `provenance`.
        record: its figures, which depend only on the name of the run and the code.
        timing: how long it took on the machine that did it [s].
        traceback: where it crashed, for people; empty if it did not.
    """

    run: PlannedRun
    code: str
    record: Mapping[str, Any]
    timing: Mapping[str, Any] = field(default_factory=dict)
    traceback: str = ""


@cache
def provenance() -> Mapping[str, str]:
    """Return what results depend on besides the name of the run: versions, and a fingerprint of our code."""
    digest = hashlib.sha256()
    root = Path(__file__).parents[2]
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*")):
            if (
                path.is_file()
                and path.suffix not in (".pyc", "")
                and "node_modules" not in path.parts
            ):
                digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    code, python = digest.hexdigest()[:12], ".".join(platform.python_version_tuple()[:2])
    return {"code": code, "python": python, **{name: _version(name) for name in DISTRIBUTIONS}}


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


class Kept(NamedTuple):
    """The content of a campaign's file; runs are read only when asked for, as there may be a million."""

    path: Path
    campaign: Campaign
    provenance: Mapping[str, str]

    def rows(self) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
        """Yield the figures of each run that is done, and its timing, in the order of the campaign."""
        for record, timing in self._read("SELECT record, timing FROM runs ORDER BY place"):
            yield json.loads(record), json.loads(timing)

    @property
    def records(self) -> Iterator[dict[str, Any]]:
        return (record for record, _ in self.rows())

    @property
    def crashed(self) -> list[dict[str, Any]]:
        rows = self._read("SELECT record FROM runs WHERE outcome = ? ORDER BY place", CRASHED)
        return [json.loads(record) for (record,) in rows]

    def done(self, *, retry: bool = False) -> set[int]:
        """Return the places of the runs that are done; with `retry`, without those that crashed."""
        rows = self._read("SELECT place FROM runs WHERE outcome != ?", CRASHED if retry else "")
        return {place for (place,) in rows}

    def _read(self, query: str, *given: str) -> Iterator[tuple[Any, ...]]:
        with files_tried(f"read {self.path}"), closing(_opened(self.path)) as file:
            yield from file.execute(query, given)


class Store:
    """The folder of a campaign, locked by the program that runs it; a context manager.

    Args:
        folder: its path.
        campaign: what to run; None, with `resume`: the campaign in the folder.

    Raises:
        MissionError: the folder holds no or another campaign, or another program runs it.
    """

    def __init__(self, folder: Path, campaign: Campaign | None, *, resume: bool = False) -> None:
        self._folder, self._synced_s = folder, monotonic()
        self.campaign = (
            _begun(folder, campaign) if campaign and not resume else _same(folder, campaign)
        )
        if campaign is None and (own := ", ".join(self.campaign.own_modules)):
            advice = f"if it is yours, say so by its file: rosa campaign FILE.toml --resume --out {folder}"
            raise MissionError(
                f"the campaign in {folder} would import {own}, because a file of results says so; {advice}"
            )
        with ExitStack() as stack, files_tried(f"write to {folder}"):
            held = os.open(folder, os.O_RDONLY)
            stack.callback(os.close, held)
            try:
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise MissionError(
                    f"another program is running the campaign in {folder}"
                ) from error
            self._file = stack.enter_context(closing(_opened(folder / FILE)))
            self._file.executescript(
                "PRAGMA journal_mode=WAL; PRAGMA synchronous=1; PRAGMA user_version=0"
            )
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        with self._stack:
            self._sync()

    def keep(self, outcome: Outcome) -> None:
        """Write an outcome to the file at once; it is synced to disk with a later one after a second, or at the end.

        Raises:
            MissionError: it was run by other code, or the disk is full.
        """
        code = provenance()["code"]
        if outcome.code != code:
            raise MissionError(
                f"{outcome.run.name} was run by other code ({outcome.code}) than the campaign ({code}); "
                "install the same on every worker, then go on with --resume"
            )
        texts = (
            json.dumps(one, allow_nan=False, ensure_ascii=False)
            for one in (outcome.record, outcome.timing)
        )
        row = outcome.run.place, outcome.record["outcome"], *texts, outcome.traceback
        with files_tried(f"write to {self._folder}", "; make room, then go on with --resume"):
            self._file.execute("INSERT OR REPLACE INTO runs VALUES (?, ?, ?, ?, ?)", row)
        if monotonic() >= self._synced_s + SYNC_S:
            self._sync()

    def _sync(self) -> None:
        """Sync to disk what was written; not after each run, as it takes longer than some runs."""
        with files_tried(f"write to {self._folder}", "; make room, then go on with --resume"):
            self._file.execute("PRAGMA wal_checkpoint")
        self._synced_s = monotonic()


def _opened(path: Path, mode: str = "rw") -> sqlite3.Connection:
    if not os.access(path.parent, os.W_OK) and not path.with_name(f"{path.name}-wal").exists():
        mode = "ro&immutable=1"  # else SQLite would write beside the file to read it
    return sqlite3.connect(
        f"{path.absolute().as_uri()}?mode={mode}", uri=True, isolation_level=None
    )


def read_store(folder: Path) -> Kept:
    """Read the folder of a campaign; MissionError if it holds none, or a damaged one."""
    path = folder / FILE
    if not folder.is_dir():
        raise MissionError(
            f"there is no folder {folder}; `rosa campaign FILE.toml --out {folder}` makes one"
        )
    if not path.exists():
        raise MissionError(f"{folder} holds no campaign: there is no {FILE} in it")
    try:
        with closing(_opened(path)) as file:
            (made, campaign, begun_with), *_ = file.execute("SELECT * FROM about").fetchall()
    except (sqlite3.Error, ValueError) as error:
        raise MissionError(f"{path} is damaged: {error}") from error
    if made != FORMAT:
        raise MissionError(f"{path} has format {made}; this version reads format {FORMAT}")
    return Kept(path, from_data(json.loads(campaign), str(path)), json.loads(begun_with))


def _begun(folder: Path, campaign: Campaign) -> Campaign:
    if (folder / FILE).exists():
        raise MissionError(
            f"{folder} holds a campaign already; go on with it by --resume, or give another --out"
        )
    with files_tried(f"make {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
        with closing(_opened(folder / FILE, "rwc")) as file:
            file.executescript(_TABLES)
            about = (
                FORMAT,
                *(
                    json.dumps(one, ensure_ascii=False)
                    for one in (asdict(campaign), dict(provenance()))
                ),
            )
            file.execute("INSERT INTO about VALUES (?, ?, ?)", about)
            file.execute("COMMIT")
    return campaign


def _same(folder: Path, campaign: Campaign | None) -> Campaign:
    """Return the campaign of a folder; MissionError if another one is asked for, or the versions differ."""
    _, kept, begun_with = read_store(folder)
    if campaign is not None and campaign != kept:
        mine, theirs = (json.loads(json.dumps(asdict(one))) for one in (campaign, kept))
        key = next(key for key in mine if mine[key] != theirs[key])
        problem = f"{folder} holds another campaign: its {key} is {theirs[key]}, not {mine[key]}"
        raise MissionError(f"{problem}; give another --out")
    for name, now in provenance().items():
        if begun_with.get(name) != now:
            raise MissionError(
                f"{folder} was begun with {name} {begun_with.get(name)}, here is {now}: results of different "
                "versions cannot be mixed; go on with that version, or begin anew with another --out"
            )
    return kept


def run_rows(kept: Kept) -> Iterator[dict[str, Any]]:
    """Yield a row for each run, all with the same columns; settings come last and have the prefix "set_"."""
    figures, changed = dict[str, None](), dict[str, None]()
    for record in kept.records:
        figures |= dict.fromkeys(one for one in record if one not in ("reactions", "settings"))
        changed |= dict.fromkeys(record["settings"])
    for record in kept.records:
        settings = {f"set_{name}": record["settings"].get(name) for name in changed}
        yield {name: record.get(name) for name in figures} | settings


def reaction_rows(kept: Kept) -> Iterator[dict[str, Any]]:
    """Yield a row for each reaction to an uncertainty."""
    same, own = ("run", "mission", "manager", "task", "seed"), ("uncertainty", "start_s", "delay_s")
    for record in kept.records:
        for reaction in record.get("reactions", []):
            yield {key: record[key] for key in same} | dict(zip(own, reaction, strict=True))


def write_tables(kept: Kept, folder: Path) -> list[Path]:
    """Write the runs and the reactions, and return the files; raises MissionError if one cannot be written."""
    written = []
    for name, rows in (("runs.csv", run_rows), ("reactions.csv", reaction_rows)):
        written.append(folder / name)
        with files_tried(f"write {written[-1]}"), draft(written[-1].resolve()) as part:
            first = next(rows(kept), None)
            with part.open("w", encoding="utf-8", newline="") as file:
                writer = csv.DictWriter(file, list(first or ["run"]), lineterminator="\n")
                writer.writeheader()
                writer.writerows(rows(kept))
            put(part, written[-1].resolve())
    written.append(folder / "runs.json")
    with files_tried(f"write {written[-1]}"), draft(written[-1].resolve()) as part:
        with part.open("w", encoding="utf-8") as file:
            lines = (json.dumps(row, ensure_ascii=False) for row in run_rows(kept))
            file.write("[\n")
            for number, line in enumerate(lines):
                file.write(f"{',' if number else ' '}{line}\n")
            file.write("]\n")
        put(part, written[-1].resolve())
    return written
