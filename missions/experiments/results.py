"""The folder of a campaign: a line for each run that is done, and the table of runs."""

import csv
import fcntl
import hashlib
import json
import os
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from io import StringIO
from pathlib import Path
from typing import Any, Final, Self

from missions.engine.mission import MissionError
from missions.experiments.campaign import Campaign, PlannedRun, from_data
from missions.views.output import OutputFile, files_tried

FILE: Final = "campaign.json"
RUNS: Final = "runs.jsonl"
CRASHED: Final = "crashed"
"""Outcome of a run that raised an exception or killed its process."""
PACKAGES: Final = ("kb", "rosa_bt", "rosa_pddl", "suave_env", "missions")
DISTRIBUTIONS: Final = (
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
        place: of the run in its campaign.
        code: fingerprint of the code that ran it; see `provenance`.
        record: its figures, which depend only on the name of the run and the code.
        timing: how long it took on the machine that did it [s].
        traceback: where it crashed, for people; empty if it did not.
    """

    place: int
    code: str
    record: Mapping[str, Any]
    timing: Mapping[str, Any] = field(default_factory=dict)
    traceback: str = ""


@cache
def provenance() -> Mapping[str, str]:
    """Return what results depend on besides the name of the run.

    Versions, and a fingerprint of our code.
    """
    digest = hashlib.sha256()
    root = Path(__file__).parents[2]
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.*")):
            if path.suffix != ".pyc" and path.is_file() and "node_modules" not in path.parts:
                digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    versions = {"code": digest.hexdigest()[:12], "python": platform.python_version()[:4]}
    for name in DISTRIBUTIONS:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return versions


class Results:
    """The results of a campaign, as far as its runs are done.

    Attributes:
        campaign: what is run.
        provenance: the versions that it was begun with.
        outcomes: by place, in the order of the campaign.

    Raises:
        MissionError: the folder holds no campaign, or a damaged one.
    """

    def __init__(self, folder: Path) -> None:
        path = folder / FILE
        if not path.exists():
            raise MissionError(
                f"{folder} holds no campaign: there is no {FILE} in it; "
                f"`rosa campaign FILE.toml --out {folder}` makes one"
            )
        lines: list[dict[str, Any]] = []
        try:
            about = json.loads(path.read_text(encoding="utf-8"))
            self.campaign = from_data(about["campaign"], str(path))
            self.provenance: Mapping[str, str] = about["provenance"]
            for line in (folder / RUNS).read_text(encoding="utf-8").splitlines(keepends=True):
                lines += [json.loads(line)] if line.endswith("\n") else []  # else it was cut short
            by_place = {line["place"]: Outcome(**line) for line in lines}
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise MissionError(f"the campaign in {folder} is damaged: {error}") from error
        self.outcomes = {place: by_place[place] for place in sorted(by_place)}

    @property
    def records(self) -> list[Mapping[str, Any]]:
        """The figures of the runs that are done."""
        return [outcome.record for outcome in self.outcomes.values()]

    @property
    def crashed(self) -> list[Mapping[str, Any]]:
        """The records of the runs that crashed."""
        return [record for record in self.records if record["outcome"] == CRASHED]

    def left(self, *, retry: bool) -> list[PlannedRun]:
        """Return the runs that are still to be done; with `retry`, also those that crashed."""
        runs = []
        for run in self.campaign.planned():
            outcome = self.outcomes.get(run.place)
            if outcome is None or (retry and outcome.record["outcome"] == CRASHED):
                runs.append(run)
        return runs

    def write_tables(self, folder: Path) -> list[Path]:
        """Write the table of runs as CSV and as JSON, and return the files."""
        rows = []
        for record in self.records:
            figures = {
                name: record[name] for name in record if name not in ("reactions", "settings")
            }
            settings = record["settings"].items()
            rows.append(figures | {f"set_{name}": value for name, value in settings})
        columns = dict.fromkeys(name for row in rows for name in row) or {"run": None}
        text = StringIO()
        ordered = sorted(columns, key=lambda name: name.startswith("set_"))
        writer = csv.DictWriter(text, ordered, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        lines = ",\n ".join(json.dumps(record, ensure_ascii=False) for record in self.records)
        tables = {"runs.csv": text.getvalue(), "runs.json": f"[{lines}]\n"}
        for name, content in tables.items():
            OutputFile(folder / name).finish(content)
        return [folder / name for name in tables]


class Store:
    """The folder of a campaign, locked by the program that runs it; a context manager.

    Args:
        folder: its path.
        campaign: what to run; None, with `resume`: the campaign in the folder.

    Raises:
        MissionError: the folder holds no or another campaign, or another program runs it.
    """

    def __init__(self, folder: Path, campaign: Campaign | None, *, resume: bool = False) -> None:
        self._folder = folder
        if campaign is not None and not resume:
            _begin(folder, campaign)
        self.campaign = Results(folder).campaign
        _check_same(folder, campaign)
        with files_tried(f"write to {folder}"):
            self._lock = (folder / FILE).open("rb")
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                self._lock.close()
                problem = f"another program is running the campaign in {folder}"
                raise MissionError(problem) from error
            with (folder / RUNS).open("r+b") as runs:
                runs.truncate(runs.read().rfind(b"\n") + 1)  # without a line that was cut short

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._lock.close()

    def keep(self, outcome: Outcome) -> None:
        """Write an outcome to the file and to disk.

        Raises:
            MissionError: it was run by other code, or the disk is full.
        """
        name = outcome.record["run"]
        code = provenance()["code"]
        if outcome.code != code:
            raise MissionError(
                f"{name} was run by other code ({outcome.code}) than the campaign ({code})"
                "; "
                "install the same on every worker, then go on with --resume"
            )
        line = json.dumps(asdict(outcome), allow_nan=False, ensure_ascii=False) + "\n"
        with (
            files_tried(f"write to {self._folder}", "; make room, then go on with --resume"),
            (self._folder / RUNS).open("ab") as runs,
        ):
            runs.write(line.encode())
            runs.flush()
            os.fsync(runs.fileno())


def _begin(folder: Path, campaign: Campaign) -> None:
    if (folder / FILE).exists():
        raise MissionError(
            f"{folder} holds a campaign already; go on with it by --resume, or give another --out"
        )
    about = {"campaign": asdict(campaign), "provenance": provenance()}
    with files_tried(f"make {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / RUNS).touch()
        (folder / FILE).write_text(json.dumps(about, indent=1, ensure_ascii=False) + "\n")


def _check_same(folder: Path, campaign: Campaign | None) -> None:
    """Raise MissionError if a folder holds another campaign, or other versions began it."""
    results = Results(folder)
    kept = asdict(results.campaign)
    if campaign is None and (own := ", ".join(results.campaign.own_modules)):
        problem = f"the campaign in {folder} would import {own}, because a file of results says so"
        advice = (
            f"if it is yours, say so by its file: rosa campaign FILE.toml --resume --out {folder}"
        )
        raise MissionError(f"{problem}; {advice}")
    for key, value in asdict(campaign).items() if campaign is not None else ():
        if value != kept[key]:
            problem = f"{folder} holds another campaign: its {key} is {kept[key]}, not {value}"
            raise MissionError(f"{problem}; give another --out")
    for name, here in provenance().items():
        if results.provenance.get(name) != here:
            problem = (
                f"{folder} was begun with {name} {results.provenance.get(name)}, here is {here}"
            )
            advice = "results of different versions cannot be mixed; begin anew with another --out"
            raise MissionError(f"{problem}: {advice}")
