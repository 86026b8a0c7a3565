"""Reports: a run as a page to click through, and the rows that pages are made of.

A row (time, track, key, value) is an assignment that holds from its time [s] on. A page shows, for
an instant, the last row of each track and key up to it. A report has all rows of a run, a live page
gets the same rows as they come, and a recording holds the same rows in a file.
"""

import json
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from itertools import chain
from math import isfinite
from operator import itemgetter
from pathlib import Path
from threading import Lock
from typing import Any, Final

from missions.engine.mission import MissionError
from missions.views.output import OutputFile, plain

NUMBERED: Final = frozenset(
    {"event", "action", "plan", "taskplan", "adaptation", "disturbance", "problem"}
)
"""The tracks with a key for each thing that happened; their oldest entries can be dropped."""

LOGGED: Final = ("event", "taskplan", "adaptation", "disturbance", "problem", "result")
"""The tracks whose entries are the event log; each has the time `t` [s], `level` and `words`."""

VERBATIM: Final = frozenset(
    {
        "pose",
        "signal",
        "scene",
        "disturbance",
        "problem",
        "result",
        "taskplan",
        "tree",
        "node",
        "tick",
        "adaptation",
    }
)
"""The tracks that do not follow from the events of a knowledge base: a recording holds them besides
the events."""

Row = tuple[float, str, int | str, Any]
_ENCODER: Final = json.JSONEncoder(separators=(",", ":"), ensure_ascii=False, allow_nan=False)
_POLICY: Final = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data:; connect-src 'self'"
)
"""The page makes no requests, except a live page to its own server."""


class Rows:
    """The rows of a run, in order; written by one thread at a time, read by any.

    Args:
        keep: how many of the newest rows to keep, besides the last of each track and key; None for
            all.

    Attributes:
        first: number of the oldest row that is kept; the first row of all has number 0.
        now: time of the last row [s].
        listeners: functions that are called with each new row, e.g. to write it to a file.
    """

    def __init__(self, keep: int | None = None) -> None:
        self.first = 0
        self.listeners: list[Callable[[Row], None]] = []
        self._keep = keep
        self._rows: list[Row] = []
        self._latest: defaultdict[str, dict[int | str, Row]] = defaultdict(dict)
        self._lock = Lock()
        self.now = 0.0

    @property
    def next(self) -> int:
        return self.first + len(self._rows)

    def put(self, time: float, track: str, key: int | str, value: object) -> bool:
        """Append a row, unless its value is the current one; a measurement is always appended.

        Returns:
            Whether it was appended.
        """
        if isinstance(value, float) and not isfinite(value):
            value = None
        with self._lock:
            latest = self._latest[track]
            current = latest[key][3] if key in latest else None
            if current == value and track != "value":
                return False
            self.now = max(self.now, round(time, 3))
            row = latest[key] = (self.now, track, key, value)
            self._rows.append(row)
            if self._keep is not None and len(self._rows) > 1.25 * self._keep:
                self._forget(len(self._rows) - self._keep)
        for listener in self.listeners:
            listener(row)
        return True

    def last(self, track: str) -> dict[int | str, Any]:
        """Return the last value of each key of a track."""
        with self._lock:
            return {key: row[3] for key, row in self._latest[track].items()}

    def since(self, number: int, most: int | None = None) -> tuple[int, list[Row]]:
        """Return the number of the first row and the rows from `number` on.

        Later ones if it is no longer kept.
        """
        with self._lock:
            start = min(max(0, number - self.first), len(self._rows))
            return self.first + start, self._rows[start : None if most is None else start + most]

    def snapshot(self) -> tuple[list[Row], int]:
        """Return the last row of each track and key by time, and the number of the next row."""
        with self._lock:
            latest = chain.from_iterable(rows.values() for rows in self._latest.values())
            return sorted(latest, key=itemgetter(0)), self.next

    def _forget(self, count: int) -> None:
        for row in self._rows[:count]:
            latest = self._latest[row[1]]
            if (row[1] in NUMBERED or row[3] is None) and latest.get(row[2]) is row:
                del latest[row[2]]
        del self._rows[:count]
        self.first += count


@dataclass(frozen=True)
class Recorded:
    """A run as a page shows it: a header, and its rows.

    Attributes:
        header: title, mission, task, manager, seed, settings, model and so on.
        rows: all rows, in order of time.
        note: what is wrong with the run, in a sentence; empty if nothing is.
    """

    header: Mapping[str, Any]
    rows: list[Row] = field(repr=False)
    note: str = ""

    def track(self, name: str) -> Iterator[tuple[float, int | str, Any]]:
        return ((time, key, value) for time, track, key, value in self.rows if track == name)

    def last(self, name: str) -> dict[int | str, Any]:
        return {key: value for _, key, value in self.track(name)}


def encoded(value: object) -> str:
    """Return a value as JSON; objects that JSON cannot hold are written as text."""
    try:
        text = _ENCODER.encode(value)
    except (TypeError, ValueError):
        text = _ENCODER.encode(plain(value))
    return text.encode(errors="replace").decode()


def page_of(document: Mapping[str, Any], title: str) -> str:
    """Return the self-contained page that shows a document.

    Raises:
        MissionError: the page's script or style is not built.
    """
    data = encoded(document).replace("<", "\\u003c")
    script = _read_built("page.js").replace("</script", "<\\/script").replace("<!--", "<\\!--")
    style = _read_built("page.css").replace("</style", "<\\/style")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        f'<title>{escape(title)}</title><link rel="icon" href="data:,">'
        f"<style>{style}</style></head>\n"
        f'<body><div id="app"></div>\n'
        f'<script type="application/json" id="rosa-data">{data}</script>\n'
        f"<script>{script}</script></body></html>\n"
    )


def report(run: Recorded) -> str:
    """Return the page of a run."""
    document = {
        "run": {"header": run.header, "rows": run.rows},
        "live": None,
        "note": run.note,
    }
    return page_of(document, str(run.header["title"]))


def write_report(path: str | Path, run: Recorded) -> None:
    """Write the page of a run to a file, which is complete or not there at all."""
    OutputFile(Path(path)).finish(report(run))


def _read_built(name: str) -> str:
    try:
        return files("missions.views").joinpath("page", "dist", name).read_text(encoding="utf-8")
    except OSError:
        raise MissionError(f"the page's {name} is not built: run `make page`") from None
