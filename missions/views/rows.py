"""What a page is made of: rows (time, track, key, value), each an assignment that holds from its time on.

The last row of each track and key up to an instant is all that there is to see then. A report has all rows, a live page
gets the same ones as they come, and a recording is the same ones in a file.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from math import isfinite
from threading import Lock
from typing import Any, Final

VERSION: Final = 1
NUMBERED: Final = frozenset({"event", "action", "plan", "taskplan", "adaptation", "whatif", "disturbance", "problem"})
"""The tracks whose keys are numbers of what happened: only more come, and what is too old to be kept is let go."""

VERBATIM: Final = frozenset(
    {"pose", "signal", "scene", "disturbance", "problem", "result", "taskplan", "tree", "node", "tick", "adaptation"}
)
"""The tracks that do not follow from the events of a knowledge base: a recording holds these beside the events."""

Row = tuple[float, str, int | str, Any]
_ENCODER: Final = json.JSONEncoder(separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def encoded(value: object) -> str:
    return _ENCODER.encode(value)


class Rows:
    """The rows of a run, in order; written by one thread at a time, read by any.

    Args:
        keep: how many to keep at most, the newest; of those before, the last of each track and key is known. None for
            all.

    Attributes:
        first: number of the oldest row that is kept; the first of all is 0.
        heard: called with each row as it comes; for a file.
    """

    def __init__(self, keep: int | None = None) -> None:
        self.first = 0
        self.heard: list[Callable[[Row], None]] = []
        self._keep = keep
        self._rows: list[Row] = []
        self._latest: dict[tuple[str, int | str], Row] = {}
        self._lock = Lock()
        self._now = 0.0

    @property
    def next(self) -> int:
        return self.first + len(self._rows)

    @property
    def now(self) -> float:
        """Time of the last row [s]."""
        return self._now

    def put(self, time: float, track: str, key: int | str, value: object) -> None:
        """Append a row, unless it says what holds already; a measurement counts each time."""
        if isinstance(value, float) and not isfinite(value):
            value = None
        with self._lock:
            before = self._latest.get((track, key))
            if before is not None and before[3] == value and track != "value":
                return
            self._now = max(self._now, round(time, 3))
            row = self._latest[track, key] = (self._now, track, key, value)
            self._rows.append(row)
            if self._keep is not None and len(self._rows) > 1.25 * self._keep:
                self._let_go(len(self._rows) - self._keep)
        for hear in self.heard:
            hear(row)

    def since(self, number: int, most: int | None = None) -> tuple[int, list[Row]]:
        """Return the rows from a number on, at most so many, and the number of the first: later if it is not kept."""
        with self._lock:
            start = min(max(0, number - self.first), len(self._rows))
            return self.first + start, self._rows[start : None if most is None else start + most]

    def snapshot(self) -> tuple[list[Row], int]:
        """Return the last row of each track and key, by time, and the number of the next row to come."""
        with self._lock:
            return sorted(self._latest.values(), key=lambda row: row[0]), self.next

    def _let_go(self, count: int) -> None:
        for row in self._rows[:count]:
            if (row[1] in NUMBERED or row[3] is None) and self._latest.get((row[1], row[2])) is row:
                del self._latest[row[1], row[2]]
        del self._rows[:count]
        self.first += count


@dataclass(frozen=True)
class Recorded:
    """A run as a page shows it: a header, and its rows.

    Attributes:
        header: what was run: title, mission, task, manager, seed, settings, model.
        rows: all of them, by time.
        note: what is wrong with it, in a sentence; empty if nothing is.
    """

    header: Mapping[str, Any]
    rows: list[Row] = field(repr=False)
    note: str = ""

    @property
    def title(self) -> str:
        return str(self.header.get("title", ""))

    def track(self, name: str) -> Iterator[tuple[float, int | str, Any]]:
        return ((time, key, value) for time, track, key, value in self.rows if track == name)

    def last(self, name: str) -> dict[int | str, Any]:
        return {key: value for _, key, value in self.track(name)}
