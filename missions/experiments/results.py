"""The folder of a campaign: each run is a line in it, kept the moment it is done, and the tables made of the lines."""

import csv
import fcntl
import hashlib
import io
import json
import os
import platform
from array import array
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from itertools import chain
from mmap import ACCESS_READ, mmap
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple, Self

from missions.engine.mission import MissionError
from missions.experiments.campaign import Campaign, PlannedRun, PlannedRuns, files_tried, from_data
from missions.views.output import OutputFile

FORMAT = 1
CAMPAIGN, RUNS, TIMING, CRASHES = "campaign.json", "runs.jsonl", "timing.jsonl", "crashes.txt"
SYNC_S = 1.0
CRASHED = "crashed"
"""Outcome of a run that raised an exception or took its process down with it."""

PACKAGES = ("kb", "rosa_bt", "rosa_pddl", "suave_env", "missions")
DISTRIBUTIONS = ("rosa-taca", "mujoco", "numpy", "ortools", "py-trees", "unified-planning", "up-fast-downward")


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a run.

    Attributes:
        run: which one.
        code: fingerprint of the code that ran it; see `provenance`.
        record: its figures: they depend on nothing but the name of the run and the code.
        timing: how long it took on the machine that did it.
        traceback: where it crashed, for a person to read; empty if it did not.
    """

    run: PlannedRun
    code: str
    record: Mapping[str, Any]
    timing: Mapping[str, Any] = field(default_factory=dict)
    traceback: str = ""


@cache
def provenance() -> Mapping[str, str]:
    """Return what results depend on beside a run's name: versions, and a fingerprint of our own code."""
    digest = hashlib.sha256()
    root = Path(__file__).parents[2]
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*")):
            if path.is_file() and path.suffix not in (".pyc", ""):
                digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    code, python = digest.hexdigest()[:12], ".".join(platform.python_version_tuple()[:2])
    return {"code": code, "python": python, **{name: _version(name) for name in DISTRIBUTIONS}}


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


class Lines(Mapping[str, Mapping[str, Any]]):
    """The complete lines of a file by the names of runs, in the order of the campaign; the last of a name counts.

    A line is read when it is asked for; held is where it begins: 8 bytes a run.

    Raises:
        MissionError: a line is damaged, was made by other code than that given, or is of no run of the campaign.
    """

    def __init__(self, path: Path, planned: PlannedRuns, code: str | None = None) -> None:
        self._path, self._planned, start = path, planned, 0
        self._starts = array("q", [-1]) * len(planned)
        with files_tried(f"read {path}"), path.open("rb") if path.exists() else io.BytesIO() as file:
            for number, line in enumerate(file, start=1):
                if line.endswith(b"\n"):
                    self._starts[self._place(line, number, code)] = start
                    start += len(line)

    def _place(self, line: bytes, number: int, code: str | None) -> int:
        try:
            data = json.loads(line)
            name, place = data["run"], self._planned.place(data["run"])
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            problem = f"{self._path}, line {number} is damaged"
            raise MissionError(f"{problem}: take it away, then go on with --resume") from error
        if code != (by := data.get("code")):
            problem = f"{self._path}: {name} was run by code {by}, the campaign by {code}"
            raise MissionError(f"{problem}; results of different versions cannot be mixed")
        if place is None:
            raise MissionError(f"{self._path} holds {name}, which is no run of the campaign")
        return place

    def __getitem__(self, name: str) -> Mapping[str, Any]:
        place = self._planned.place(name)
        if place is None or self._starts[place] < 0:
            raise KeyError(name)
        with files_tried(f"read {self._path}"), self._path.open("rb") as file:
            file.seek(self._starts[place])
            return dict(json.loads(file.readline()))

    def __iter__(self) -> Iterator[str]:
        return (run.name for run, start in zip(self._planned, self._starts, strict=True) if start >= 0)

    def __len__(self) -> int:
        return len(self._starts) - self._starts.count(-1)


class Kept(NamedTuple):
    """What the folder of a campaign holds; records and timings by the names of runs, in the order of the campaign."""

    campaign: Campaign
    provenance: Mapping[str, str]
    records: Mapping[str, Mapping[str, Any]]
    timings: Mapping[str, Mapping[str, Any]]

    @property
    def crashed(self) -> tuple[Mapping[str, Any], ...]:
        return tuple(record for record in self.records.values() if record["outcome"] == CRASHED)

    @property
    def missing(self) -> int:
        return len(self.campaign.planned()) - len(self.records)


class Store:
    """The folder of a campaign, held by the one program that runs it; used as a context.

    A line is complete or not there at all: what a killed program left half-written is taken away when the campaign is
    gone on with (`resume`; without a campaign, with what the folder says).

    Raises:
        MissionError: the folder is not what it should be, or another program holds it.
    """

    def __init__(self, folder: Path, campaign: Campaign | None, *, resume: bool = False) -> None:
        self._folder, self._synced_s = folder, monotonic()
        if campaign is None and not resume:
            raise MissionError("say what to run: FILE.toml or --paper-table, or --resume --out DIR")
        self.campaign = _begun(folder, campaign) if campaign and not resume else _same(folder, campaign)
        if campaign is None and (own := ", ".join(self.campaign.own_modules)):
            advice = f"if it is yours, say so by its file: rosa campaign FILE.toml --resume --out {folder}"
            raise MissionError(
                f"the campaign in {folder} would import {own}, because a file of results says so; {advice}"
            )
        with ExitStack() as stack:
            self._runs, self._timing, self._crashes = (self._open(name, stack) for name in (RUNS, TIMING, CRASHES))
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        with self._stack:
            self._sync()

    def keep(self, outcome: Outcome) -> None:
        """Add what came of a run, to the files at once and on disk within a second of the next, or at the end.

        Raises:
            MissionError: other code ran it, or there is no room.
        """
        code = provenance()["code"]
        if outcome.code != code:
            raise MissionError(
                f"{outcome.run.name} was run by other code ({outcome.code}) than the campaign ({code}); "
                "install the same on every worker, then go on with --resume"
            )
        if outcome.traceback:
            self._write(self._crashes, f"{outcome.run.name}\n{outcome.run.command}\n{outcome.traceback}\n")
        if outcome.timing:
            self._write(self._timing, _line(outcome.timing))
        self._write(self._runs, _line({**outcome.record, "code": outcome.code}))
        if monotonic() >= self._synced_s + SYNC_S:
            self._sync()

    def _sync(self) -> None:
        """Have on disk what was written: together, as it takes longer than many a run."""
        with files_tried(f"write to {self._folder}", "; make room, then go on with --resume"):
            for file in (self._runs, self._timing, self._crashes):
                os.fsync(file)
        self._synced_s = monotonic()

    def _open(self, name: str, stack: ExitStack) -> int:
        """Open a file to append to, hold it, and take away what is half-written."""
        path = self._folder / name
        with files_tried(f"write {path}"):
            file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
            stack.callback(os.close, file)
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise MissionError(f"another program is running the campaign in {self._folder}") from error
            if os.fstat(file).st_size:
                with mmap(file, 0, access=ACCESS_READ) as content:
                    complete = content.rfind(b"\n") + 1
                os.ftruncate(file, complete)
        return file

    def _write(self, file: int, text: str) -> None:
        content = text.encode()
        with files_tried(f"write to {self._folder}", "; make room, then go on with --resume"):
            while content:
                content = content[os.write(file, content) :]


def read_store(folder: Path) -> Kept:
    """Say what the folder of a campaign holds; a last line that is half-written is passed over."""
    campaign, begun_with = _head(folder)
    planned = campaign.planned()
    records = Lines(folder / RUNS, planned, begun_with["code"])
    return Kept(campaign, begun_with, records, Lines(folder / TIMING, planned))


def _line(data: Mapping[str, Any]) -> str:
    return json.dumps(data, allow_nan=False, ensure_ascii=False) + "\n"


def _head(folder: Path) -> tuple[Campaign, dict[str, str]]:
    """Return the campaign of a folder and what it was begun with."""
    path = folder / CAMPAIGN
    if not folder.is_dir():
        raise MissionError(f"there is no folder {folder}; `rosa campaign FILE.toml --out {folder}` makes one")
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        made, campaign, begun_with = data["format"], data["campaign"], dict(data["provenance"])
        begun_with["code"]
    except FileNotFoundError as error:
        raise MissionError(f"{folder} holds no campaign: there is no {CAMPAIGN} in it") from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise MissionError(f"{path} is damaged: {type(error).__name__}: {error}") from error
    if made != FORMAT:
        raise MissionError(f"{path} has format {made}; this version reads format {FORMAT}")
    return from_data(campaign, str(path)), begun_with


def _begun(folder: Path, campaign: Campaign) -> Campaign:
    if (folder / CAMPAIGN).exists() or (folder / RUNS).exists():
        raise MissionError(f"{folder} holds a campaign already; go on with it by --resume, or give another --out")
    with files_tried(f"make {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
    data = {"format": FORMAT, "campaign": campaign.as_data(), "provenance": dict(provenance())}
    with OutputFile(folder / CAMPAIGN) as file:
        file.finish(json.dumps(data, indent=2, ensure_ascii=False) + "\n")
    return campaign


def _same(folder: Path, campaign: Campaign | None) -> Campaign:
    """Return the campaign of a folder, which must be the one asked for and have been begun with what there is now."""
    kept, begun_with = _head(folder)
    if campaign is not None and campaign != kept:
        mine, theirs = campaign.as_data(), kept.as_data()
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
    for record in kept.records.values():
        figures |= dict.fromkeys(one for one in record if one not in ("code", "reactions", "settings"))
        changed |= dict.fromkeys(record["settings"])
    for record in kept.records.values():
        settings = {f"set_{name}": record["settings"].get(name) for name in changed}
        yield {name: record.get(name) for name in figures} | settings


def reaction_rows(kept: Kept) -> Iterator[dict[str, Any]]:
    """Yield a row for each reaction to an uncertainty."""
    same, own = ("run", "mission", "manager", "task", "seed"), ("uncertainty", "start_s", "delay_s")
    for record in kept.records.values():
        for reaction in record.get("reactions", []):
            yield {key: record[key] for key in same} | dict(zip(own, reaction, strict=True))


def write_tables(kept: Kept, folder: Path) -> list[Path]:
    """Write the runs and the reactions, and return the files; raises MissionError if one cannot be written."""
    written = []
    for name, rows in (("runs", run_rows(kept)), ("reactions", reaction_rows(kept))):
        written.append(folder / f"{name}.csv")
        with OutputFile(written[-1]) as file:
            first = next(rows, None)
            writer = csv.DictWriter(file, list(first or ["run"]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(chain([first] if first else [], rows))
            file.finish()
    return written
