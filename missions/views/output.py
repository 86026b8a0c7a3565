"""The files of a run: results as JSON, which depend on mission, settings and seed only.

That a file can be written is tried before the run. After the run it is complete, or not there at
all.
"""

import json
import math
import os
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from kb import Model
from kb.files import draft, write_file
from missions.engine.mission import MissionError, Verdict
from missions.engine.runner import MissionRun

COUNTS: Final = ("times", "samples", "points", "percent")
UNITS: Final = {
    **{
        name: name
        for name in ("s", "ms", "min", "h", "m", "mm", "cm", "km", "l", "rad", "deg", "kg", *COUNTS)
    },
    **{"j": "J", "kj": "kJ", "w": "W", "wh": "Wh", "v": "V", "hz": "Hz", "percent": "%"},
    **{"m_s": "m/s", "rad_s": "rad/s"},
}
"""How to write a unit, by the ending of a figure's name."""


@contextmanager
def files_tried(what: str, advice: str = "") -> Iterator[None]:
    """Turn errors of files into a MissionError: cannot do `what`, such as "read x.toml"."""
    try:
        yield
    except (OSError, sqlite3.Error) as error:
        why = getattr(error, "strerror", None) or error
        raise MissionError(f"cannot {what}: {why}{advice}") from error


class OutputFile:
    """A file that replaces the one of its name only when it is complete.

    A device such as /dev/stdout is written directly.

    Raises:
        MissionError: it cannot be written there (raised at once), or the disk is full.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with files_tried(f"write {path}"):
            if path.is_dir():
                raise IsADirectoryError("it is a directory; name a file in it")
            self._direct = path.exists() and not path.is_file()
            if path.is_file() and not os.access(path, os.W_OK):
                raise PermissionError("the file there is read-only")
            if not self._direct:
                with draft(path.resolve()):  # only to try it
                    pass

    def finish(self, content: str | bytes) -> None:
        """Write the complete file."""
        data = content.encode() if isinstance(content, str) else content
        with files_tried(f"write {self._path}"):
            if self._direct:
                self._path.write_bytes(data)
            else:
                write_file(self._path, data)


def open_files(paths: Mapping[str, Path | None]) -> dict[str, OutputFile]:
    """Return the files that options ask for.

    Raise before any work is done if one cannot be written.
    """
    return {name: OutputFile(path) for name, path in paths.items() if path is not None}


_ADAPTATION: Final = ("at_s", "kind", "trigger", "reason", "change", "reaction_s")


def summary(
    run: MissionRun, verdict: Verdict, seed: int, changed: Mapping[str, str]
) -> dict[str, Any]:
    """Return a finished run, with the settings that were given, as plain data.

    Times in [s], units in the names.
    """
    return {
        "mission": run.mission.name,
        "task": run.task,
        "manager": run.manager,
        "seed": seed,
        "settings": dict(sorted(changed.items())),
        "outcome": verdict.outcome,
        "outcome_reason": verdict.reason,
        "duration_s": run.world.now,
        **run.results(),
        "adaptations": [_fields(adaptation, *_ADAPTATION) for adaptation in run.adaptations],
        "actions": [
            {
                "name": action.action,
                "start_s": action.start,
                "end_s": action.end,
                **_fields(action, "result", "reason"),
            }
            for action in run.actions
        ],
        "plans": [
            {**_fields(plan, "at_s", "reason"), "outcome": str(plan.outcome), "engine": plan.engine}
            | {"steps": [str(step) for step in plan.steps]}
            for plan in run.plans
        ],
        **({"plans_from": run.plans[0].number} if run.plans and run.plans[0].number > 1 else {}),
        "reactions": [
            _fields(reaction, "uncertainty", "start_s", "delay_s")
            for reaction in run.ask("reactions")
        ],
        "disturbances": [{"at_s": time, "what": text} for time, text in run.disturbances()],
        "diagnostics_problems": [
            {"at_s": time, "problem": str(problem)} for time, problem in run.problems
        ],
    }


def _fields(record: object, *names: str) -> dict[str, Any]:
    return {name: getattr(record, name) for name in names}


def as_json(data: Mapping[str, Any]) -> str:
    """Return data as JSON text.

    Numbers have 6 decimals, so that rounding errors of sums do not show.
    """
    return json.dumps(plain(data, digits=6), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def plain(value: object, digits: int | None = None) -> Any:  # noqa: ANN401  # whatever JSON holds
    """Return a value for JSON: floats rounded, NaN and infinity as None, objects as text."""
    if isinstance(value, Mapping):
        return {str(key): plain(part, digits) for key, part in value.items()}
    if isinstance(value, float):
        if not math.isfinite(value):
            return None
        return value if digits is None else round(value, digits)
    if value is None or isinstance(value, int | str):
        return value
    if isinstance(value, list | tuple):
        return [plain(part, digits) for part in value]
    return str(value)


def figure_in_words(
    name: str, value: float | None, model: Model | None = None
) -> tuple[str, str, str]:
    """Return the words, unit and value of a figure as texts.

    For example, "energy_used_j" gives "energy used", "J" and "3152.6".

    The unit is that of the model's attribute of this name, else the ending of the name, else empty.
    None gives "-".
    """
    ends = [end for end in UNITS if name.endswith(f"_{end}")]
    unit = max(ends, key=len, default="")
    words = name.removesuffix(f"_{unit}").replace("_", " ")
    sign = UNITS.get(unit, "")
    if model is not None and name in model.attributes:
        words = name.replace("_", " ")
        sign = model.attributes[name].unit
    if value is None:
        shown = "-"
    elif float(value).is_integer() and (
        not sign or unit in COUNTS
    ):  # a count of something, not an amount of a unit
        shown = f"{value:.0f}"
    else:
        shown = f"{float(value):.2f}" if abs(value) < 10 else f"{float(value):.1f}"
    return words, sign, shown
