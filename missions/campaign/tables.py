"""The results of a campaign as tables for other programs: CSV, and Parquet where pyarrow is installed."""

import csv
import io
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from missions.campaign.store import Kept
from missions.output import OutputFile

__all__ = ["reaction_rows", "run_rows", "write_tables"]

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
                file.write(content)
                file.keep()
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
