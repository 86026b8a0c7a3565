"""Pages in a file: a run to click through, or two side by side; self-contained, and read again as a recording."""

import json
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, NamedTuple

from missions.engine.mission import MissionError
from missions.views.output import OutputFile
from missions.views.rows import VERSION, Recorded, encoded

_POLICY: Final = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; connect-src 'self'"
)
"""No request leaves the page but that of a live one to where it came from."""
_DATA: Final = re.compile(r'<script type="application/json" id="rosa-data">(.*?)</script>', re.DOTALL)
_MOST: Final = 200
"""How many differences are shown."""
_LATER_S: Final = 1.0
"""The same decision counts as different if it came so much later or earlier [s]."""


def page_of(document: Mapping[str, Any], title: str) -> str:
    """Return the page that shows a document, with all that it needs in it.

    Raises:
        MissionError: the page's own program is not there.
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
    """Return the page of a run, or of two beside each other on the same axis of time.

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
    """Write the page of a run, or of two beside each other; the file is complete or not there at all."""
    OutputFile(Path(path)).finish(report(run, other))


def framed(run: Recorded) -> str:
    return f'<iframe srcdoc="{escape(report(run))}" style="width: 100%; height: 50rem; border: 0"></iframe>'


def read_page(path: Path) -> Recorded:
    """Read a run from a recording, or out of the report that was made of it.

    Raises:
        MissionError: it cannot be read, or holds no run, or one of another version.
    """
    try:
        found = _DATA.search(path.read_text(encoding="utf-8"))
        document = json.loads(found[1]) if found else {}
        version, runs = document.get("version"), document.get("runs")
    except (OSError, ValueError, AttributeError) as error:
        raise MissionError(f"cannot read the report {path}: {getattr(error, 'strerror', None) or error}") from None
    if not runs or len(runs) > 1:
        held = "holds no run" if not runs else "holds two runs already"
        raise MissionError(f"{path} {held}; give a page of `rosa run MISSION --report FILE.html`, or a recording")
    if version != VERSION:
        raise MissionError(f"{path} is of version {version!r}; this program reads version {VERSION}")
    return Recorded(runs[0]["header"], [tuple(row) for row in runs[0]["rows"]], str(document.get("note", "")))


def _built(name: str) -> str:
    try:
        return files("missions.views").joinpath("page", "dist", name).read_text(encoding="utf-8")
    except OSError:
        raise MissionError(f"the page's {name} is not built: run `make page`") from None


class _Moment(NamedTuple):
    """Something that was decided, or led to a decision: the same in two runs if kind and words are."""

    kind: str
    words: str
    time: float
    cause: str

    @property
    def why(self) -> str:
        return f", because {self.cause}" if self.cause else ""


def differences(one: Recorded, other: Recorded) -> list[dict[str, Any]]:
    """Return how two runs differ, in order of time: what only one did, and what the other did sooner or later, and why.

    Raises:
        MissionError: they are of different models.
    """
    models = one.header["model"], other.header["model"]
    if models[0] != models[1]:
        raise MissionError(f"runs of one model can be compared, not of {models[0]} and {models[1]}")
    asked = [
        {"t": 0.0, "words": f"{name}: {shown[0]} in A, {shown[1]} in B", "a": None, "b": None}
        for name, shown in _settings(one.header, other.header)
    ]
    found: list[tuple[float, str]] = []
    moments: defaultdict[tuple[str, str], tuple[list[_Moment], list[_Moment]]] = defaultdict(lambda: ([], []))
    for place, run in enumerate((one, other)):
        for each in _moments(run):
            moments[each.kind, each.words][place].append(each)
    for mine, theirs in moments.values():
        rest = _unmet(mine, theirs), _unmet(theirs, mine)
        for of_a, of_b in zip(*rest, strict=False):
            first = min(of_a, of_b, key=lambda each: each.time)
            when = f"{abs(of_b.time - of_a.time):.1f} s {'sooner' if first is of_b else 'later'} in B"
            found.append((first.time, f"{first.words}: {when}{first.why}"))
        paired = min(map(len, rest))
        for letter, left in zip("AB", rest, strict=True):
            found += [(each.time, f"only in {letter}: {each.words}{each.why}") for each in left[paired:]]
    found.sort()
    differing = [
        {"t": time, "words": words, "a": _adaptation_at(one, time), "b": _adaptation_at(other, time)}
        for time, words in found[:_MOST]
    ]
    if differing:
        differing[0]["words"] = f"the same up to here; then {differing[0]['words']}"
    return asked + differing


def _unmet(moments: list[_Moment], others: list[_Moment]) -> list[_Moment]:
    """Return the moments of which none of the others is within a second."""
    return [one for one in moments if all(abs(one.time - other.time) >= _LATER_S for other in others)]


def _settings(one: Mapping[str, Any], other: Mapping[str, Any]) -> Iterator[tuple[str, tuple[Any, Any]]]:
    for name in ("mission", "task", "manager", "seed"):
        if one.get(name) != other.get(name):
            yield name, (one.get(name), other.get(name))
    mine, theirs = one.get("settings", {}), other.get("settings", {})
    for name in sorted(mine.keys() | theirs.keys()):
        if mine.get(name) != theirs.get(name):
            yield f"setting {name}", (mine.get(name, "the default"), theirs.get(name, "the default"))


def _moments(run: Recorded) -> Iterator[_Moment]:
    events = run.last("event")
    for time, _, event in run.track("event"):
        cause = events.get(event.get("cause"), {}).get("words", "")
        if event["kind"] in ("action update", "reconfiguration plan"):
            yield _Moment(event["kind"], event["words"].partition(": ")[0], time, cause)
        elif event["kind"] == "monitoring data":
            for kind, name, _, new in event.get("changes", ()):
                if kind in ("action", "function design", "configuration") and new in ("unfeasible", "feasible"):
                    yield _Moment("status", f"{name} is {new}", time, event["words"])
    for time, _, ended in run.track("result"):
        yield _Moment("result", f"the mission ends: {ended['outcome']}", time, ended["reason"])


def _adaptation_at(run: Recorded, time: float) -> int | None:
    """Return the number of the adaptation that was under way at a time [s], or decided within a second."""
    for number, one in sorted(run.last("adaptation").items()):
        if one["t"] - _LATER_S <= time <= max(one["in_force"] or one["t"], one["t"] + _LATER_S):
            return int(number)
    return None
