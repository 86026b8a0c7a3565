"""Draws a finished run as one picture: where the robot went, what it measured, how it adapted."""

import textwrap
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO
from itertools import cycle
from operator import attrgetter, itemgetter
from typing import Any, Final, NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from missions.views.report import Recorded

Array = NDArray[np.float64]

WIDTH, HEIGHT, DPI = 1600, 1200, 125
"""Size of the picture [px], [px], and its resolution [px/inch]."""
INK, MUTED, FAINT, ALARM, LIMIT = "#222222", "#666666", "#c4c4c4", "#d55e00", "#0f6b78"
HUES: Final = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#8c6d31", "#b8ac00")
"""The colours of Okabe and Ito, without the one for alarms."""
BADGES: Final = {
    "task": (INK, "white"),
    "structural": ("white", INK),
    "parameter": ("#e2e2e2", INK),
}
"""The colours of an adaptation's number: its ground and its digits."""
STYLE: Final[dict[Any, Any]] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "text.color": INK,
    "text.parse_math": False,
    "axes.edgecolor": FAINT,
    "legend.frameon": False,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
}
LANE, PANEL = 0.6, 4.0
"""Heights of a bar and a measurement, relative to one another."""
LETTERS, LINES, LONGEST = 92, 27, 360
"""How much fits into the list of adaptations: letters of a line, lines, letters of each."""
MOST: Final = 20
"""If there are more places on a map, none is named."""
MOST_LIMITS: Final = 5
"""If an attribute has more thresholds, they are counted instead of named."""


class Span(NamedTuple):
    """A time [s] during which an action is done, or a design or configuration is selected."""

    kind: str
    name: str
    start: float
    end: float


def draw(run: Recorded) -> bytes:
    """Draw a finished run as PNG, 1600 x 1200 px; the same run gives the same bytes."""
    png = BytesIO()
    picture(run).savefig(png, format="png", dpi=DPI, metadata={"Software": None})
    return png.getvalue()


@rc_context(STYLE)
def picture(run: Recorded) -> Figure:
    """Return what `draw` writes: a map and the list of adaptations over lines of time."""
    return _Picture(run).figure


class _Picture:
    def __init__(self, run: Recorded) -> None:
        self._run = run
        self._end = max(run.rows[-1][0], 1e-3)
        self._elements = {key: value for _, key, value in run.track("element") if value}
        self._adaptations = sorted(run.last("adaptation").values(), key=itemgetter("t"))
        self._spans = sorted(self._selected(), key=attrgetter("kind"))
        actions = [span.name for span in self._spans if span.kind == "action"]
        self._hues = dict(zip(dict.fromkeys(actions), cycle(HUES), strict=False))
        self.figure = Figure(figsize=(WIDTH / DPI, HEIGHT / DPI), dpi=DPI)
        FigureCanvasAgg(self.figure)
        poses = [(time, *position[:2]) for time, _, position in run.track("pose")]
        has_map = len(poses) > 0
        middle = 0.5 if has_map else 0.72
        left = 0.52 if has_map else 0.03
        self._write_title()
        self._draw_timelines(middle)
        if run.header["manager"] == "ours":  # how others adapt is not recorded
            place = (left + 0.01, middle + 0.02, 0.98 - left, 0.89 - middle)
            self._write_adaptations(self.figure.add_axes(place))
        if has_map:
            place = (0.05, middle + 0.06, left - 0.07, 0.85 - middle)
            self._draw_map(self.figure.add_axes(place), np.array(poses, dtype=float))

    def _selected(self) -> Iterator[Span]:
        """Yield when each action was done, and when each part was selected that has a choice."""
        for action in self._run.last("action").values():
            name = str(self._elements[action["action"]]["name"])
            yield Span("action", name, action["start"], action["end"] or self._end)
        since: dict[int | str, float] = {}
        ends = ((self._end, key, None) for key in self._elements)
        for time, key, is_selected in (*self._run.track("selected"), *ends):
            if is_selected:
                since[key] = time
            elif key in since:
                element = self._elements[key]
                start = since.pop(key)
                (owner,) = element["used_by"]
                if len(self._elements[owner]["requires"]) > 1:
                    yield Span(element["kind"], element["name"], start, time)

    def _write_title(self) -> None:
        header = self._run.header
        result = self._run.last("result").get(0, {})
        task = {"bt": "behaviour tree", "pddl": "PDDL plans"}.get(header["task"], header["task"])
        who = task if header["manager"] == "ours" else f"manager: {header['manager']}"
        name = f"{header['title']}  ·  {who}  ·  seed {header['seed']}"
        facts = [f"{result.get('outcome', '').replace('_', ' ')} after {self._end:.0f} s"]
        for words, unit, value in result.get("figures", ())[:3]:
            facts.append(f"{words} {value} {unit}".strip())
        figure = self.figure
        figure.text(0.01, 0.975, name, fontsize=13, fontweight="bold", va="center")
        figure.text(0.99, 0.975, "   ·   ".join(facts), fontsize=9.5, ha="right", va="center")
        entries = [Patch(color=hue, label=brief(name)) for name, hue in self._hues.items()]
        for kind in dict.fromkeys(entry["kind"] for entry in self._adaptations):
            ground, _ = BADGES[kind]
            entries.append(Patch(facecolor=ground, edgecolor=INK, label=f"{kind} adaptation"))
        if self._run.last("disturbance"):
            entries.append(Patch(facecolor=ALARM, label="disturbance"))
        place: Any = {"loc": "center left", "bbox_to_anchor": (0.0, 0.945), "fontsize": 7.5}
        figure.legend(handles=entries, ncols=max(len(entries), 1), **place)

    # ------------------------------------------------------------ the map

    def _draw_map(self, axes: Axes, poses: Array) -> None:
        times = poses[:, 0]
        way = poses[:, 1:]
        start = way[0]
        places = [place for place in self._run.last("scene").get(0, ()) if place["points"]]
        axes.set(xlabel="east x [m]", ylabel="north y [m]", facecolor="#f6f9fb")
        axes.update_datalim([*way, start - 1.0, start + 1.0])
        for place in places:
            points = np.array(place["points"])
            axes.update_datalim([points[np.argmin(np.hypot(*(points - start).T))]])
            axes.plot(*points.T, color=FAINT, linewidth=10, scalex=False, scaley=False)
        axes.plot(*way.T, color=FAINT, linewidth=1.8)
        for name, hue in self._hues.items():
            for span in self._spans:
                inside = (span.start <= times) & (times <= span.end)
                if span.name == name and span.kind == "action":
                    axes.plot(*way[inside].T, color=hue, linewidth=2.5, zorder=4)
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.15)
        axes.apply_aspect()
        axes.autoscale(False)
        halo = withStroke(linewidth=2.5, foreground="white")
        outlined: dict[str, Any] = {"path_effects": [halo], "ha": "center", "va": "center"}
        labels = [(start, "start", outlined), (way[-1], f"end, {self._end:.0f} s", outlined)]
        for place in places if len(places) <= MOST else ():
            visible = [point for point in place["points"] if axes.viewLim.contains(*point)]
            if visible:
                labels.append((np.array(visible[len(visible) // 2]), place["name"], outlined))
        for number, entry in enumerate(self._adaptations, start=1):
            point = np.array([np.interp(entry["t"], times, column) for column in way.T])
            labels.append((point, str(number), _badge(entry["kind"])))
        _write_apart(axes, labels)

    # ------------------------------------------------------------ the list

    def _write_adaptations(self, axes: Axes) -> None:
        """Write cause and change of each adaptation."""
        axes.set_axis_off()
        count = len(self._adaptations)
        lines = ["adaptations: cause → change" if count else "no adaptation", ""]
        for number, entry in enumerate(self._adaptations, start=1):
            reaction = entry["reaction"]
            soon = "not in force" if reaction is None else f"in {reaction:.2f} s"
            change = brief(f"{entry['cause']} → {entry['changed']}", LONGEST)
            text = f"{number:>2}   {entry['t']:.1f} s   {change} [{soon}]"
            more = textwrap.wrap(text, LETTERS, subsequent_indent=" " * 8)
            if len(lines) + len(more) >= LINES:
                lines.append(f"… and {count - number + 1} more")
                break
            lines += more
        axes.text(0, 1, "\n".join(lines), fontsize=7.5, va="top", linespacing=1.35)

    # ------------------------------------------------------------ everything over time

    def _draw_timelines(self, top: float) -> None:
        """Draw measurements, then what was done and selected, with a line for each adaptation."""
        courses = dict(self._courses())
        bars = list(dict.fromkeys((span.kind, span.name) for span in self._spans))
        heights = [*[PANEL] * len(courses), LANE * (len(bars) + 2)]
        place: Any = {"left": 0.11, "right": 0.86, "bottom": 0.05, "top": top, "hspace": 0.08}
        grid = self.figure.add_gridspec(len(heights), 1, height_ratios=heights, **place)
        cells = [grid[number] for number in range(len(heights))]
        rows = [self.figure.add_subplot(cell, xlim=(0, self._end)) for cell in cells]
        for axes, ((name, unit), course) in zip(rows, courses.items(), strict=False):
            self._draw_course(axes, name, unit, course)
            axes.tick_params(labelbottom=False, bottom=False)
        for axes in rows:
            for entry in self._adaptations:
                axes.axvline(entry["t"], color="#999999", linewidth=0.7, zorder=1.5)
            for entry in self._run.last("disturbance").values():
                axes.axvline(entry["t"], color=ALARM, linewidth=0.7, linestyle="--", zorder=1.6)
        lanes = rows[-1]
        lanes.set(xlabel="time [s]", ylim=(len(bars) - 0.4, -1.8))
        lanes.set_yticks(range(len(bars)), [brief(name) for _, name in bars])
        for kind, name, start, end in self._spans:
            hue = self._hues[name] if kind == "action" else "#7d8790"
            y = bars.index((kind, name))
            lanes.barh(y, end - start, left=start, height=0.76, color=hue, zorder=2)
        for number, entry in enumerate(self._adaptations, start=1):
            lanes.text(entry["t"], -1, str(number), **_badge(entry["kind"]))

    def _courses(self) -> Iterator[tuple[tuple[str, str], Array]]:
        """Yield each measurement that varies: name and unit, times [s] and values (2, n)."""
        points: defaultdict[tuple[str, str], list[tuple[float, float]]] = defaultdict(list)
        for time, key, value in (*self._run.track("value"), *self._run.track("signal")):
            name, _, unit = str(key).partition(" [")
            signal = {"name": name.replace(" ", "_"), "unit": unit.rstrip("]")}
            element = self._elements.get(key, signal)
            measured = np.nan if value is None else value
            points[element["name"], element["unit"]].append((time, measured))
        signals = self._run.header.get("signals") or [name for name, _ in points]
        for title, measurements in points.items():
            if title[0] not in signals:
                continue
            course = np.array([*measurements, (self._end, measurements[-1][1])]).T
            values = course[1][np.isfinite(course[1])]
            if len(values) and np.ptp(values) > 0:
                yield title, course

    def _draw_course(self, axes: Axes, name: str, unit: str, course: Array) -> None:
        for span in self._spans:
            if span.kind == "action":
                hue = self._hues[span.name]
                axes.axvspan(span.start, span.end, color=hue, alpha=0.09, linewidth=0)
        axes.step(*course, where="post", color=INK, linewidth=1.5, zorder=4)
        words = [*textwrap.wrap(name.replace("_", " "), 16), f"[{unit or '-'}]"]
        axes.set_ylabel("\n".join(words), rotation=0, ha="right", va="center", labelpad=9)
        axes.margins(y=0.12)
        limits: defaultdict[tuple[float, str], list[str]] = defaultdict(list)
        for element in self._elements.values():
            if element["kind"] == "constraint" and element["requires"] == [f"attribute {name}"]:
                names = [self._elements[key]["name"] for key in element["used_by"]]
                limits[element["value"], element["operator"]] += names
        for value, _ in limits:
            axes.axhline(value, color=LIMIT, linewidth=1, linestyle=":", zorder=3)
        low, high = axes.get_ylim()
        free = 0.0
        named = sorted(limits.items()) if len(limits) <= MOST_LIMITS else ()
        for (value, operator), names in named:
            text = brief(f"{operator} {value:g}  {', '.join(names)}", 32)
            y = max(free, (value - low) / (high - low))
            style: Any = {"va": "center", "color": LIMIT, "fontsize": 7.5}
            axes.text(1.006, y, text, transform=axes.transAxes, **style)
            free = y + 14 / axes.bbox.height


def _badge(kind: str) -> dict[str, Any]:
    ground, digits = BADGES[kind]
    box = {"boxstyle": "circle,pad=0.25", "facecolor": ground, "edgecolor": INK}
    style = {"bbox": box, "color": digits, "fontsize": 7.5, "fontweight": "bold"}
    return {**style, "ha": "center", "va": "center"}


def _write_apart(axes: Axes, labels: Sequence[tuple[Array, str, Mapping[str, Any]]]) -> None:
    """Write texts near their points [m], each where none is yet, with a line to its point."""
    line = {"arrowstyle": "-", "color": MUTED, "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
    common: dict[str, Any] = {"textcoords": "offset points", "arrowprops": line, "zorder": 7}
    figure: Any = axes.figure
    taken: list[Bbox] = []
    for point, text, style in labels:
        axes.plot(*point, "o", color=INK, markersize=4, zorder=6)
        label = axes.annotate(text, tuple(point), (0, 0), **common, **style)
        for step in range(160):
            angle = step * 0.7
            far = 10 + step * 0.4
            label.set_position(((far + 2.5 * len(text)) * np.cos(angle), far * np.sin(angle)))
            label.update_positions(figure.canvas.get_renderer())
            box = Text.get_window_extent(label).padded(4)
            is_inside = axes.bbox.fully_contains(*box.min) and axes.bbox.fully_contains(*box.max)
            if is_inside and not box.count_overlaps(taken):
                break
        taken.append(box)


def brief(text: str, most: int = 26) -> str:
    """Return a text of at most so many characters, with signs such as ≥ instead of ASCII."""
    short = text.replace("->", "→").replace(">=", "≥").replace("<=", "≤")
    return short if len(short) <= most else f"{short[: most - 1]}…"
