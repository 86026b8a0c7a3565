"""Draws a finished run as one picture: where the robot went, what it measured, how it adapted."""

import textwrap
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO
from itertools import cycle
from typing import Any, Final, NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from missions.views.report import Recorded

Array = NDArray[np.float64]
Entry = Mapping[str, Any]
Hues = Mapping[str, str]

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
LANE, PANEL, EVENT = 0.6, 4.0, 0.9
"""Heights of a bar, a measurement and a row of events, relative to one another."""
LONGEST: Final = 360
"""The longest text about an adaptation [letters]."""
MOST_PLACES: Final = 20
"""If there are more places on a map, none is named."""
MOST_LIMITS: Final = 5
"""If an attribute has more thresholds, they are counted instead of named."""


class Span(NamedTuple):
    """A time [s] during which something with a name holds."""

    name: str
    start: float
    end: float


class RunTimeline:
    """The data of a run as the picture needs them.

    Attributes:
        end: time of the end [s].
        times, xy: of the poses: times (n,) [s] and positions (n, 2) [m], world frame.
        places: points (n, 2) [m] by name.
        lanes: spans by the name of the lane: actions, and what was selected where there was a
            choice.
        courses: measurements (2, n) by name: times [s] and values; `units` by name.
        limits: names of constrained elements by attribute and threshold.
        adaptations, disturbances: as in the page, in order of time.
    """

    def __init__(self, run: Recorded) -> None:
        self.end = max(run.rows[-1][0], 1e-3)
        elements = {key: value for _, key, value in run.track("element") if value is not None}
        self._names = {key: str(value["name"]) for key, value in elements.items()}
        poses = [(time, *position[:2]) for time, _, position in run.track("pose")]
        table = np.array(poses, dtype=float).reshape(-1, 3)
        self.times = table[:, 0]
        self.xy = table[:, 1:]
        scene = run.last("scene").get(0, ())
        self.places = {
            place["name"]: np.array(place["points"]) for place in scene if place["points"]
        }
        self.lanes: dict[str, list[Span]] = {"actions": [], "designs": [], "configurations": []}
        for action in run.last("action").values():
            name = self._names[action["action"]]
            self.lanes["actions"].append(Span(name, action["start"], action["end"] or self.end))
        for lane, owner in (("designs", "function"), ("configurations", "component")):
            for element in elements.values():
                if element["kind"] == owner and len(element[lane]) > 1:
                    self.lanes[lane] += self._selected(run, element[lane])
        self.units: dict[str, str] = {}
        self.courses = self._courses(run, elements)
        self.limits: defaultdict[str, dict[float, list[str]]] = defaultdict(dict)
        for element in elements.values():
            if element["kind"] == "constraint":
                self._add_limit(element)
        self.adaptations = _in_order(run.last("adaptation").values())
        self.disturbances = _in_order(run.last("disturbance").values())

    def where(self, time: float) -> Array:
        """Return the position of the robot (2,) [m] at a time [s]."""
        return np.array([np.interp(time, self.times, column) for column in self.xy.T])

    def _selected(self, run: Recorded, parts: Sequence[int]) -> Iterator[Span]:
        since: dict[int | str, float] = {}
        for time, key, is_selected in (
            *run.track("selected"),
            *((self.end, key, 0) for key in parts),
        ):
            if key in parts and is_selected:
                since[key] = time
            elif key in since:
                yield Span(self._names[key], since.pop(key), time)

    def _courses(self, run: Recorded, elements: Mapping[int | str, Entry]) -> dict[str, Array]:
        points: defaultdict[str, list[tuple[float, float]]] = defaultdict(list)
        for time, key, value in (*run.track("value"), *run.track("signal")):
            name, _, unit = str(self._names.get(key, key)).replace("_", " ").partition(" [")
            self.units[name] = unit.rstrip("]") or str(elements.get(key, {}).get("unit", ""))
            points[name].append((time, np.nan if value is None else value))
        signals = [signal.replace("_", " ") for signal in run.header.get("signals", ())]
        names = [signal for signal in signals if signal in points] or list(points)
        courses = {}
        for name in names:
            course = np.array([*points[name], (self.end, points[name][-1][1])]).T
            values = course[1][np.isfinite(course[1])]
            if len(values) and np.ptp(values) > 0:
                courses[name] = course
        return courses

    def _add_limit(self, constraint: Entry) -> None:
        attribute = self._names[constraint["attribute"]].replace("_", " ")
        label = f"{brief(constraint['operator'])} {constraint['value']:g}"
        names = self.limits[attribute].setdefault(constraint["value"], [])
        names += [f"{label}  {brief(self._names[key])}" for key in constraint["on"]]


def _in_order(entries: Any) -> list[Entry]:  # noqa: ANN401  # the values of a track
    return sorted(entries, key=lambda entry: float(entry["t"]))


def brief(text: str, most: int = 26) -> str:
    """Return a text of at most so many characters, with signs such as ≥ instead of ASCII."""
    short = text.replace("->", "→").replace(">=", "≥").replace("<=", "≤")
    return short if len(short) <= most else f"{short[: most - 1]}…"


def draw(run: Recorded) -> bytes:
    """Draw a finished run as PNG, 1600 x 1200 px; the same run gives the same bytes."""
    png = BytesIO()
    picture(run).savefig(png, format="png", dpi=DPI, metadata={"Software": None})
    return png.getvalue()


@rc_context(STYLE)
def picture(run: Recorded) -> Figure:
    """Return what `draw` writes: a map and the list of adaptations over lines of time."""
    figure = Figure(figsize=(WIDTH / DPI, HEIGHT / DPI), dpi=DPI)
    FigureCanvasAgg(figure)
    timeline = RunTimeline(run)
    actions = dict.fromkeys(span.name for span in timeline.lanes["actions"])
    hues = dict(zip(actions, cycle(HUES), strict=False))
    has_map = len(timeline.xy) > 0
    middle = 0.52 if has_map else 0.72
    left = 0.55 if has_map else 0.03
    _write_title(figure, run)
    _write_legend(figure, timeline, hues)
    _draw_timelines(figure, timeline, hues, middle - 0.03)
    if run.header["manager"] == "ours":  # how others adapt is not recorded
        place = (left + 0.01, middle + 0.02, 0.98 - left, 0.88 - middle)
        _write_adaptations(figure.add_axes(place), timeline.adaptations)
    if has_map:
        _draw_map(
            figure.add_axes((0.05, middle + 0.05, left - 0.06, 0.85 - middle)), timeline, hues
        )
    return figure


def _write_title(figure: Figure, run: Recorded) -> None:
    header = run.header
    result = run.last("result").get(0, {})
    task = {"bt": "behaviour tree", "pddl": "PDDL plans"}.get(header["task"], header["task"])
    who = task if header["manager"] == "ours" else f"manager: {header['manager']}"
    name = f"{header['title']}  ·  {who}  ·  seed {header['seed']}"
    facts = [f"{result.get('outcome', '').replace('_', ' ')} after {run.rows[-1][0]:.0f} s"]
    for words, unit, value in result.get("figures", ())[:3]:
        facts.append(f"{words} {value} {unit}".strip())
    figure.text(0.01, 0.975, name, fontsize=13, fontweight="bold", va="center")
    figure.text(0.99, 0.975, "   ·   ".join(facts), fontsize=9.5, ha="right", va="center")


def _write_legend(figure: Figure, timeline: RunTimeline, hues: Hues) -> None:
    entries = [Line2D([], [], color=hue, linewidth=4, label=name) for name, hue in hues.items()]
    for kind in dict.fromkeys(entry["kind"] for entry in timeline.adaptations):
        style: dict[str, Any] = {"marker": "o", "linestyle": "", "ms": 9, "mec": INK}
        entries.append(Line2D([], [], label=f"{kind} adaptation", mfc=BADGES[kind][0], **style))
    if timeline.disturbances:
        entries.append(Line2D([], [], color=ALARM, linestyle="--", label="disturbance"))
    letters = sum(8 + len(str(entry.get_label())) for entry in entries)
    figure.legend(
        handles=entries,
        fontsize=9 * min(1.0, 185 / max(letters, 1)),
        loc="center left",
        bbox_to_anchor=(0.0, 0.945),
        ncols=max(len(entries), 1),
    )


def _draw_map(axes: Axes, timeline: RunTimeline, hues: Hues) -> None:
    start = timeline.xy[0]
    axes.set(xlabel="east x [m]", ylabel="north y [m]", facecolor="#f6f9fb")
    axes.update_datalim([*timeline.xy, start - 1.0, start + 1.0])
    for points in timeline.places.values():
        nearest = points[np.argmin(np.hypot(*(points - start).T))]
        axes.update_datalim([nearest])
        axes.plot(*points.T, color=FAINT, linewidth=10, scalex=False, scaley=False)
    axes.plot(*timeline.xy.T, color=FAINT, linewidth=1.8)
    for number, span in enumerate(timeline.lanes["actions"]):
        inside = timeline.xy[(span.start <= timeline.times) & (timeline.times <= span.end)]
        width = 4.6 - 2.8 * number / len(timeline.lanes["actions"])  # an earlier way stays visible
        axes.plot(*inside.T, color=hues[span.name], linewidth=width, zorder=4)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.1)
    axes.apply_aspect()
    axes.autoscale(False)
    labels = [(start, "start", ""), (timeline.xy[-1], f"end, {timeline.end:.0f} s", "")]
    for name, points in timeline.places.items() if len(timeline.places) <= MOST_PLACES else ():
        visible = [point for point in points if axes.viewLim.contains(*point)]
        if visible:
            labels.append((visible[len(visible) // 2], name, ""))
    for number, entry in enumerate(timeline.adaptations, start=1):
        labels.append((timeline.where(entry["t"]), str(number), entry["kind"]))
    _write_apart(axes, labels)


def _write_apart(axes: Axes, labels: Sequence[tuple[Array, str, str]]) -> None:
    """Write texts near their points [m], each where none is yet, with a line to its point."""
    taken: list[Bbox] = []
    line = {"arrowstyle": "-", "color": MUTED, "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
    outlined = {"path_effects": [withStroke(linewidth=2.5, foreground="white")]}
    for xy, text, kind in labels:
        style: dict[str, Any] = _badge(kind) if kind else outlined
        anchor = axes.transData.transform(xy)
        half = np.array((4.2 * len(text) + 8, 10.0))
        for step in range(160):
            direction = np.array((np.cos(step * 0.7), np.sin(step * 0.7)))
            offset = (half + 4 + step * 0.6) * direction
            box = Bbox([anchor + offset - half, anchor + offset + half])
            is_inside = axes.bbox.fully_contains(*box.min) and axes.bbox.fully_contains(*box.max)
            if is_inside and not box.count_overlaps(taken):
                break
        taken.append(box)
        style = {**style, "ha": "center", "va": "center", "zorder": 7, "arrowprops": line}
        axes.annotate(text, tuple(xy), tuple(offset), textcoords="offset pixels", **style)
        axes.plot(*xy, "o", color=INK, markersize=4, zorder=6)


def _badge(kind: str) -> dict[str, Any]:
    ground, digits = BADGES[kind]
    box = {"boxstyle": "circle,pad=0.25", "facecolor": ground, "edgecolor": INK}
    style = {"bbox": box, "color": digits, "fontsize": 7.5, "fontweight": "bold"}
    return {**style, "ha": "center", "va": "center"}


def _write_adaptations(axes: Axes, entries: Sequence[Entry]) -> None:
    """Write cause and change of each adaptation, in the largest letters that fit."""
    axes.set(xlim=(0, 1), ylim=(1, 0))
    axes.set_axis_off()
    head = "adaptations: cause → change" if entries else "no adaptation"
    axes.text(0, -0.02, head, fontsize=10, fontweight="bold")
    for size, has_reason in ((9.0, True), (8.0, True), (9.0, False), (7.0, False), (6.0, False)):
        letters = int(axes.bbox.width * 0.86 / (size * 1.05))
        line = size * 1.3 * DPI / 72 / axes.bbox.height
        texts = [_words(entry, letters, has_reason) for entry in entries]
        if sum(len(text) + 0.5 for text in texts) * line < 0.98:
            break
    y = 0.02
    for number, (entry, text) in enumerate(zip(entries, texts, strict=False), start=1):
        if y + line * (len(text) + 1) > 1.0 and number < len(entries):
            axes.text(0.14, y, f"… and {len(entries) - number + 1} more", fontsize=size, va="top")
            break
        axes.text(0.02, y + line / 2, str(number), **_badge(entry["kind"]))
        axes.text(0.045, y, f"{entry['t']:.1f} s", fontsize=size, fontweight="bold", va="top")
        axes.text(0.14, y, "\n".join(text), fontsize=size, va="top", linespacing=1.12)
        y += line * (len(text) + 0.5)


def _words(entry: Entry, letters: int, has_reason: bool) -> list[str]:
    reaction = entry["reaction"]
    soon = "not in force" if reaction is None else f"in {reaction:.2f} s"
    text = f"{entry['cause']}: {entry['decided']}" if has_reason else entry["cause"]
    cause = textwrap.wrap(brief(text, LONGEST), letters)
    change = f"→ {brief(entry['changed'], LONGEST)} [{soon}]"
    return cause + textwrap.wrap(change, letters, subsequent_indent="    ")


def _draw_timelines(figure: Figure, timeline: RunTimeline, hues: Hues, top: float) -> None:
    """Draw everything over time: disturbances, measurements, adaptations and lanes, in rows."""
    heights = {"disturbances": EVENT} if timeline.disturbances else {}
    heights |= dict.fromkeys(timeline.courses, PANEL)
    heights |= {"adaptations": EVENT} if timeline.adaptations else {}
    for lane, spans in timeline.lanes.items():
        if spans:
            heights[lane] = LANE * (len({span.name for span in spans}) + 0.5)
    place: Any = {"left": 0.11, "right": 0.86, "bottom": 0.05, "top": top, "hspace": 0.08}
    grid = figure.add_gridspec(
        max(len(heights), 1), 1, height_ratios=[*heights.values()] or [1], **place
    )
    for number, row in enumerate(heights):
        axes = figure.add_subplot(grid[number], xlim=(0, timeline.end))
        for entry in timeline.adaptations:
            axes.axvline(entry["t"], color="#999999", linewidth=0.7, zorder=1.5)
        for entry in timeline.disturbances:
            axes.axvline(entry["t"], color=ALARM, linewidth=0.7, linestyle="--", zorder=1.6)
        if row in timeline.courses:
            _draw_course(axes, timeline, hues, row)
        elif row in timeline.lanes:
            _draw_lane(axes, timeline.lanes[row], hues, row)
        else:
            _draw_events(axes, timeline, row)
        is_last = number == len(heights) - 1
        axes.tick_params(labelbottom=is_last, bottom=is_last)
        axes.set_xlabel("time [s]" if is_last else "")


def _draw_events(axes: Axes, timeline: RunTimeline, row: str) -> None:
    axes.set(ylim=(-1, 1), yticks=[])
    _write_beside(axes, row, 0.5)
    if row == "adaptations":
        for number, entry in enumerate(timeline.adaptations, start=1):
            axes.text(entry["t"], 0, str(number), **_badge(entry["kind"]))
        return
    free = -1.0
    for entry in timeline.disturbances:
        words = brief(entry["words"], 48)
        width = timeline.end * len(words) / 190
        if entry["t"] > free and entry["t"] + width < timeline.end * 1.1:
            axes.text(entry["t"], 0, f" {words}", color=ALARM, va="center", fontsize=7.5)
            free = entry["t"] + width


def _write_beside(axes: Axes, text: str, y: float, color: str = MUTED) -> None:
    axes.text(1.006, y, text, transform=axes.transAxes, va="center", color=color, fontsize=7.5)


def _draw_lane(axes: Axes, spans: Sequence[Span], hues: Hues, row: str) -> None:
    names = list(dict.fromkeys(span.name for span in spans))
    axes.set(ylim=(len(names) - 0.45, -0.55))
    axes.set_yticks(range(len(names)), [brief(name) for name in names])
    axes.tick_params(left=False)
    _write_beside(axes, row, 0.5)
    for name, start, end in spans:
        hue = hues[name] if row == "actions" else "#7d8790"
        axes.barh(names.index(name), end - start, left=start, height=0.76, color=hue, zorder=2)


def _draw_course(axes: Axes, timeline: RunTimeline, hues: Hues, name: str) -> None:
    for action, start, end in timeline.lanes["actions"]:
        axes.axvspan(start, end, color=hues[action], alpha=0.09, linewidth=0, zorder=0.5)
    axes.step(*timeline.courses[name], where="post", color=INK, linewidth=1.5, zorder=4)
    limits = timeline.limits.get(name, {})
    axes.hlines(list(limits), 0, timeline.end, color=LIMIT, linewidth=1, linestyle=":", zorder=3)
    words = [*textwrap.wrap(name, 16), f"[{timeline.units[name] or '-'}]"]
    axes.set_ylabel("\n".join(words), rotation=0, ha="right", va="center", labelpad=9)
    axes.margins(y=0.12)
    if len(limits) > MOST_LIMITS:
        _write_beside(axes, f"{len(limits)} thresholds", 0.5, LIMIT)
        return
    low, high = axes.get_ylim()
    line = 13 / axes.bbox.height
    free = -line
    for value, names in sorted(limits.items()):
        text = f"{names[0]} and {len(names) - 1} more" if len(names) > 2 else "\n".join(names)
        free = max(free + line, (value - low) / (high - low))
        _write_beside(axes, text, free, LIMIT)
        free += line * text.count("\n")
