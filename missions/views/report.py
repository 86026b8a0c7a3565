"""Reports: one run as a page to click through, or two side by side; and the rows that pages are made of.

A row (time, track, key, value) is an assignment that holds from its time [s] on. A page shows, for an instant, the last
row of each track and key up to it. A report has all rows of a run, a live page gets the same rows as they come, and a
recording holds the same rows in a file.
"""

import json
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from math import isfinite
from pathlib import Path
from threading import Lock
from typing import Any, Final, NamedTuple

from missions.engine.mission import MissionError
from missions.views.output import OutputFile, plain

VERSION: Final = 1
NUMBERED: Final = frozenset(
    {"event", "action", "plan", "taskplan", "adaptation", "whatif", "disturbance", "problem"}
)
"""The tracks whose keys are growing numbers, one for each thing that happened; their oldest entries can be dropped."""

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
"""The tracks that do not follow from the events of a knowledge base: a recording holds them besides the events."""

Row = tuple[float, str, int | str, Any]
_ENCODER: Final = json.JSONEncoder(separators=(",", ":"), ensure_ascii=False, allow_nan=False)
_POLICY: Final = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; connect-src 'self'"
"""The page makes no requests, except a live page to its own server."""
_DATA: Final = re.compile(
    r'<script type="application/json" id="rosa-data">(.*?)</script>', re.DOTALL
)
_MOST: Final = 200
"""The largest number of differences to show."""
_DEFAULT: Final = "the default"
_LATER_S: Final = 1.0
"""The same decision counts as a difference if its times in two runs differ by so much [s]."""


class Rows:
    """The rows of a run, in order; written by one thread at a time, read by any.

    Args:
        keep: how many of the newest rows to keep, besides the last of each track and key; None for all.

    Attributes:
        first: number of the oldest row that is kept; the first row of all has number 0.
        heard: functions that are called with each new row, e.g. to write it to a file.
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
        """Append a row, unless its value is the current one; a measurement is always appended."""
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
        """Return the number of the first row and the rows from `number` on; later ones if it is no longer kept."""
        with self._lock:
            start = min(max(0, number - self.first), len(self._rows))
            return self.first + start, self._rows[start : None if most is None else start + most]

    def snapshot(self) -> tuple[list[Row], int]:
        """Return the last row of each track and key, in order of time, and the number of the next row."""
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
        header: title, mission, task, manager, seed, settings, model and so on.
        rows: all rows, in order of time.
        note: what is wrong with the run, in a sentence; empty if nothing is.
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


def encoded(value: object) -> str:
    """Return a value as JSON; what JSON cannot hold, such as the odd feedback of a behaviour, is written as text."""
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
    script = _built("page.js").replace("</script", "<\\/script").replace("<!--", "<\\!--")
    style = _built("page.css").replace("</style", "<\\/style")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        f'<title>{escape(title)}</title><link rel="icon" href="data:,"><style>{style}</style></head>\n'
        f'<body><div id="app"></div>\n<script type="application/json" id="rosa-data">{data}</script>\n'
        f"<script>{script}</script></body></html>\n"
    )


def report(run: Recorded, other: Recorded | None = None) -> str:
    """Return the page of a run, or of two side by side on the same time axis.

    Raises:
        MissionError: the runs are of different models.
    """
    runs = [run] if other is None else [run, other]
    document = {
        "version": VERSION,
        "runs": [{"header": one.header, "rows": one.rows} for one in runs],
        "differences": [] if other is None else differences(run, other),
        "live": None,
        "note": " ".join(one.note for one in runs if one.note),
    }
    return page_of(document, " and ".join(dict.fromkeys(one.title for one in runs)))


def write_report(path: str | Path, run: Recorded, other: Recorded | None = None) -> None:
    """Write the page of a run, or of two side by side, to a file, which is complete or not there at all."""
    OutputFile(Path(path)).finish(report(run, other))


def framed(run: Recorded) -> str:
    return f'<iframe srcdoc="{escape(report(run))}" style="width: 100%; height: 50rem; border: 0"></iframe>'


def read_page(path: Path) -> Recorded:
    """Read a run from a report.

    Raises:
        MissionError: it cannot be read, holds no run or two, or is of another version.
    """
    try:
        found = _DATA.search(path.read_text(encoding="utf-8"))
        document = json.loads(found[1]) if found else {}
        version, runs = document.get("version"), document.get("runs")
    except (OSError, ValueError, AttributeError) as error:
        raise MissionError(
            f"cannot read the report {path}: {getattr(error, 'strerror', None) or error}"
        ) from None
    if not runs or len(runs) > 1:
        held = "holds no run" if not runs else "holds two runs already"
        raise MissionError(
            f"{path} {held}; give a page of `rosa run MISSION --report FILE.html`, or a recording"
        )
    if version != VERSION:
        raise MissionError(
            f"{path} is of version {version!r}; this program reads version {VERSION}"
        )
    return Recorded(
        runs[0]["header"], [tuple(row) for row in runs[0]["rows"]], str(document.get("note", ""))
    )


def _built(name: str) -> str:
    try:
        return files("missions.views").joinpath("page", "dist", name).read_text(encoding="utf-8")
    except OSError:
        raise MissionError(f"the page's {name} is not built: run `make page`") from None


class _Moment(NamedTuple):
    """A decision, or a change that led to one; two runs have it in common if kind and words are equal."""

    kind: str
    words: str
    time: float
    why: str


def differences(one: Recorded, other: Recorded) -> list[dict[str, Any]]:
    """Return how two runs differ, in order of time: what only one did, what they did at other times, and why.

    Raises:
        MissionError: they are of different models.
    """
    models = one.header["model"], other.header["model"]
    if models[0] != models[1]:
        raise MissionError(
            f"only runs of the same model can be compared, not of {models[0]} and {models[1]}"
        )
    in_a, in_b = _settings(one.header), _settings(other.header)
    asked = [
        {
            "t": 0.0,
            "words": f"{name}: {value} in A, {in_b.get(name, _DEFAULT)} in B",
            "a": None,
            "b": None,
        }
        for name, value in {**dict.fromkeys(in_b, _DEFAULT), **in_a}.items()
        if value != in_b.get(name, _DEFAULT)
    ]
    found: list[tuple[float, str]] = []
    moments: defaultdict[tuple[str, str], tuple[list[_Moment], list[_Moment]]] = defaultdict(
        lambda: ([], [])
    )
    for place, run in enumerate((one, other)):
        for each in _moments(run):
            moments[each.kind, each.words][place].append(each)
    for mine, theirs in moments.values():
        rest = _unmet(mine, theirs), _unmet(theirs, mine)
        for of_a, of_b in zip(*rest, strict=False):
            first = min(of_a, of_b, key=lambda each: each.time)
            when = (
                f"{abs(of_b.time - of_a.time):.1f} s {'sooner' if first is of_b else 'later'} in B"
            )
            found.append((first.time, f"{first.words}: {when}{first.why}"))
        paired = min(map(len, rest))
        for letter, left in zip("AB", rest, strict=True):
            found += [
                (each.time, f"only in {letter}: {each.words}{each.why}") for each in left[paired:]
            ]
    found.sort()
    differing = [
        {
            "t": time,
            "words": words,
            "a": _adaptation_at(one, time),
            "b": _adaptation_at(other, time),
        }
        for time, words in found[:_MOST]
    ]
    if differing:
        differing[0]["words"] = f"the same up to here; then {differing[0]['words']}"
    return asked + differing


def _unmet(moments: list[_Moment], others: list[_Moment]) -> list[_Moment]:
    """Return the moments that are more than a second from all the others."""
    return [
        one for one in moments if all(abs(one.time - other.time) >= _LATER_S for other in others)
    ]


def _settings(header: Mapping[str, Any]) -> dict[str, Any]:
    """Return mission, task, manager, seed and settings of a run, by name."""
    asked = {name: header.get(name) for name in ("mission", "task", "manager", "seed")}
    return asked | {f"setting {name}": value for name, value in header.get("settings", {}).items()}


def _moments(run: Recorded) -> Iterator[_Moment]:
    events = run.last("event")
    for time, _, event in run.track("event"):
        cause = events.get(event.get("cause"), {}).get("words", "")
        if event["kind"] in ("action update", "reconfiguration plan"):
            yield _Moment(event["kind"], event["words"].partition(": ")[0], time, _because(cause))
        elif event["kind"] == "monitoring data":
            for kind, name, _, new in event.get("changes", ()):
                if kind in ("action", "function design", "configuration") and new in (
                    "unfeasible",
                    "feasible",
                ):
                    yield _Moment("status", f"{name} is {new}", time, _because(event["words"]))
    for time, _, ended in run.track("result"):
        yield _Moment(
            "result", f"the mission ends: {ended['outcome']}", time, _because(ended["reason"])
        )


def _because(cause: str) -> str:
    return f", because {cause}" if cause else ""


def _adaptation_at(run: Recorded, time: float) -> int | None:
    """Return the number of the adaptation that was under way at a time [s], within a second; None if none was."""
    for number, one in sorted(run.last("adaptation").items()):
        if one["t"] - _LATER_S <= time <= max(one["in_force"] or one["t"], one["t"] + _LATER_S):
            return int(number)
    return None
