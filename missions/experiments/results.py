"""The folder of a campaign: each run is a line in it, kept the moment it is done, and the tables made of the lines."""

import csv
import fcntl
import io
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from missions.engine.mission import MissionError
from missions.experiments.campaign import Campaign, from_data
from missions.experiments.work import CRASHED, Outcome, provenance
from missions.views.output import OutputFile

FORMAT = 1
CAMPAIGN, RUNS, TIMING, CRASHES = "campaign.json", "runs.jsonl", "timing.jsonl", "crashes.txt"


@dataclass(frozen=True, slots=True)
class Kept:
    """What the folder of a campaign holds.

    Attributes:
        campaign: what was to be run.
        provenance: what it was begun with: versions, and the fingerprint of the code.
        records: what came of each run, by the name of the run, in the order in which the campaign lists them.
        timings: how long each took, by the name of the run.
    """

    campaign: Campaign
    provenance: Mapping[str, str]
    records: Mapping[str, Mapping[str, Any]]
    timings: Mapping[str, Mapping[str, Any]]

    @property
    def crashed(self) -> tuple[Mapping[str, Any], ...]:
        """The runs that crashed."""
        return tuple(record for record in self.records.values() if record["outcome"] == CRASHED)

    @property
    def missing(self) -> int:
        """How many runs are still to be done."""
        return len(self.campaign.planned()) - len(self.records)


class Store:
    """The folder of a campaign, held by the one program that runs it; used as a context.

    A line is complete or not there at all: what a killed program left half-written is taken away when the campaign is
    gone on with.

    Args:
        folder: where the campaign is kept.
        campaign: what is to be run; None for what the folder says.
        resume: whether the folder holds the campaign already.

    Attributes:
        campaign: what is to be run.

    Raises:
        MissionError: the folder is not what it should be, or another program holds it.
    """

    def __init__(self, folder: Path, campaign: Campaign | None, *, resume: bool = False) -> None:
        self._folder = folder
        self._stack = ExitStack()
        if resume:
            self.campaign = _same(folder, campaign)
        elif campaign is None:
            raise MissionError("say what to run: FILE.toml or --paper-table, or --resume --out DIR")
        else:
            self.campaign = campaign
            _begin(folder, campaign)
        try:
            self._runs = self._open(RUNS)
            self._timing = self._open(TIMING)
            self._crashes = self._open(CRASHES)
        except BaseException:
            self._stack.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def keep(self, outcome: Outcome) -> None:
        """Add what came of a run, on disk when this returns.

        Raises:
            MissionError: it cannot be written, or other code than that of the campaign ran it.
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

    def _open(self, name: str) -> int:
        """Open a file to append to, hold it, and take away what is half-written."""
        path = self._folder / name
        try:
            file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
            self._stack.callback(os.close, file)
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            content = path.read_bytes()
            os.ftruncate(file, content.rfind(b"\n") + 1)
        except BlockingIOError as error:
            raise MissionError(f"another program is running the campaign in {self._folder}") from error
        except OSError as error:
            raise MissionError(f"cannot write {path}: {error.strerror or error}") from error
        return file

    def _write(self, file: int, text: str) -> None:
        content = text.encode()
        try:
            while content:
                content = content[os.write(file, content) :]
            os.fsync(file)
        except OSError as error:
            raise MissionError(
                f"cannot write to {self._folder}: {error.strerror or error}; make room, then go on with --resume"
            ) from error


def read_store(folder: Path) -> Kept:
    """Read what the folder of a campaign holds; a last line that is half-written is passed over.

    Raises:
        MissionError: it holds no campaign, or lines of another one or of other code.
    """
    head = _head(folder)
    campaign = from_data(head["campaign"], str(folder / CAMPAIGN))
    records = _lines(folder / RUNS)
    planned = [run.name for run in campaign.planned()]
    for name, record in records.items():
        if record.get("code") != head["provenance"]["code"]:
            raise MissionError(
                f"{folder / RUNS}: {name} was run by code {record.get('code')}, the campaign by "
                f"{head['provenance']['code']}; results of different versions cannot be mixed"
            )
    if strange := records.keys() - set(planned):
        raise MissionError(f"{folder / RUNS} holds {min(strange)}, which is no run of the campaign")
    ordered = {name: records[name] for name in planned if name in records}
    return Kept(campaign, head["provenance"], ordered, _lines(folder / TIMING))


def _line(data: Mapping[str, Any]) -> str:
    return json.dumps(data, allow_nan=False, ensure_ascii=False) + "\n"


def _lines(path: Path) -> dict[str, Any]:
    """Return the complete lines of a file by the name of the run; the last of a name counts."""
    found = {}
    try:
        content = path.read_bytes() if path.exists() else b""
    except OSError as error:
        raise MissionError(f"cannot read {path}: {error.strerror or error}") from error
    for number, line in enumerate(content.split(b"\n")[:-1], start=1):
        try:
            data = json.loads(line)
            found[data["run"]] = data
        except (ValueError, KeyError, TypeError) as error:
            raise MissionError(f"{path}, line {number} is damaged: take it away, then go on with --resume") from error
    return found


def _head(folder: Path) -> dict[str, Any]:
    path = folder / CAMPAIGN
    if not folder.is_dir():
        raise MissionError(f"there is no folder {folder}; `rosa campaign FILE.toml --out {folder}` makes one")
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        made = data["format"], data["campaign"], data["provenance"]["code"]
    except FileNotFoundError as error:
        raise MissionError(f"{folder} holds no campaign: there is no {CAMPAIGN} in it") from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise MissionError(f"{path} is damaged: {type(error).__name__}: {error}") from error
    if made[0] != FORMAT:
        raise MissionError(f"{path} has format {made[0]}; this version reads format {FORMAT}")
    return dict(data)


def _begin(folder: Path, campaign: Campaign) -> None:
    if (folder / CAMPAIGN).exists() or (folder / RUNS).exists():
        raise MissionError(f"{folder} holds a campaign already; go on with it by --resume, or give another --out")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MissionError(f"cannot make {folder}: {error.strerror or error}") from error
    data = {"format": FORMAT, "campaign": campaign.as_data(), "provenance": dict(provenance())}
    with OutputFile(folder / CAMPAIGN) as file:
        file.finish(json.dumps(data, indent=2, ensure_ascii=False) + "\n")


def _same(folder: Path, campaign: Campaign | None) -> Campaign:
    """Return the campaign of a folder, which must be the one asked for and have been begun with what there is now."""
    head = _head(folder)
    kept = from_data(head["campaign"], str(folder / CAMPAIGN))
    if campaign is not None and campaign != kept:
        mine, theirs = campaign.as_data(), kept.as_data()
        key = next(key for key in mine if mine[key] != theirs[key])
        raise MissionError(
            f"{folder} holds another campaign: its {key} is {theirs[key]}, not {mine[key]}; give another --out"
        )
    for name, now in provenance().items():
        if head["provenance"].get(name) != now:
            raise MissionError(
                f"{folder} was begun with {name} {head['provenance'].get(name)}, here is {now}: results of different "
                "versions cannot be mixed; go on with that version, or begin anew with another --out"
            )
    return kept


APART = ("code", "reactions", "settings")


def run_rows(kept: Kept) -> list[dict[str, Any]]:
    """Return one row for each run, all with the same columns; settings have the prefix "set_"."""
    flat = [
        {
            **{key: value for key, value in record.items() if key not in APART},
            **{f"set_{name}": value for name, value in record["settings"].items()},
        }
        for record in kept.records.values()
    ]
    columns = {column: None for row in flat for column in row if not column.startswith("set_")}
    columns |= {column: None for row in flat for column in row}
    return [columns | row for row in flat]


def reaction_rows(kept: Kept) -> list[dict[str, Any]]:
    """Return one row for each reaction to an uncertainty."""
    return [
        {
            "run": name,
            **{key: record[key] for key in ("mission", "manager", "task", "seed")},
            "uncertainty": uncertainty,
            "start_s": start_s,
            "delay_s": delay_s,
        }
        for name, record in kept.records.items()
        for uncertainty, start_s, delay_s in record.get("reactions", [])
    ]


def write_tables(kept: Kept, folder: Path) -> list[Path]:
    """Write the runs and the reactions, and return the files.

    Raises:
        MissionError: one cannot be written.
    """
    written = []
    for name, rows in (("runs", run_rows(kept)), ("reactions", reaction_rows(kept))):
        contents = {".csv": _csv(rows)} | ({".parquet": _parquet(rows)} if rows and find_spec("pyarrow") else {})
        for suffix, content in contents.items():
            path = folder / f"{name}{suffix}"
            with OutputFile(path) as file:
                file.finish(content)
            written.append(path)
    return written


def _csv(rows: Sequence[Mapping[str, Any]]) -> bytes:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if rows else ["run"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def _parquet(rows: Sequence[Mapping[str, Any]]) -> bytes:
    import pyarrow
    import pyarrow.parquet

    columns = {
        name: [float(v) if isinstance(v := row[name], int) and _is_mixed(rows, name) else v for row in rows]
        for name in rows[0]
    }
    sink = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.table(columns), sink)
    return sink.getvalue()


def _is_mixed(rows: Sequence[Mapping[str, Any]], name: str) -> bool:
    """Tell whether a column holds whole numbers and others."""
    return {int, float} <= {type(row[name]) for row in rows}
