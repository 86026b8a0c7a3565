"""A finished run as one picture: where the robot went, what it measured, and how it adapted."""

import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby, pairwise
from typing import Any, BinaryIO, Final

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.transforms import IdentityTransform
from numpy.typing import NDArray

from missions.runner import MissionRun

__all__ = ["draw", "picture"]

Array = NDArray[np.float64]
Events = Sequence[Mapping[str, Any]]

WIDTH, HEIGHT, DPI = 1600, 1200, 125  # [px], [px], [px/inch]
LEFT, RIGHT = 150, 1395  # ends of the time axis [px]
PANELS, LANE, EVENT, GAP = 320, 18, 26, 7  # heights of all signals, a bar, a row of events and between rows [px]
REACH = (0, 8, 18, 30, 45, 65, 90)  # how far from its place a label may go [px]
LINE = 1.22 * DPI / 72  # from one line of text to the next [px] for each point of its size
INK, MUTED, FAINT, ALARM, LIMIT = "#222222", "#666666", "#b5b5b5", "#d55e00", "#0f6b78"
HUES = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#8c6d31", "#b8ac00")  # Okabe and Ito's, but ALARM
BADGES: Final = {  # how the number of an adaptation looks: diameter [px], face, edge, digits
    "task": (25, INK, INK, "white"),
    "structural": (23, "white", INK, INK),
    "parameter": (20, "#e2e2e2", "#9a9a9a", INK),
}
DIAMOND: Final[dict[str, Any]] = {"marker": "D", "markersize": 4.5, "color": ALARM}
SIDES: Final = np.array([-1, 1])
PIXELS: Final = IdentityTransform()
TICKS = {"color": FAINT, "labelcolor": INK, "labelsize": 8, "major.size": 3}
STYLE: Final[dict[Any, Any]] = {
    **{"font.family": "DejaVu Sans", "font.size": 8.5, "text.color": INK, "text.parse_math": False},
    **{"axes.edgecolor": FAINT, "axes.linewidth": 0.7, "axes.labelpad": 1, "legend.frameon": False},
    **{f"{side}tick.{key}": value for side in "xy" for key, value in TICKS.items()},
}


@dataclass(frozen=True)
class _Story:
    """A run as n samples, times in [s]; limits: labels of the thresholds by attribute and value."""

    end: float
    times: Array
    xy: Array  # (n, 2) [m], world frame
    actions: list[str]
    configurations: list[str]
    signals: dict[str, Array]  # NaN where there was none
    limits: dict[str, dict[float, list[str]]]
    adaptations: Events
    disturbances: Events

    @property
    def hues(self) -> dict[str, str]:
        return {name: HUES[index % len(HUES)] for index, name in enumerate(_names(self.actions))}

    def spans(self, column: Sequence[str]) -> Iterator[tuple[str, float, float]]:
        edges = [*self.times, self.end]
        for names, group in groupby(range(len(column)), key=lambda index: column[index]):
            held = list(group)
            yield from ((name, edges[held[0]], edges[held[-1] + 1]) for name in _names([names]))


def draw(run: MissionRun, data: Mapping[str, Any], out: BinaryIO) -> None:
    """Write the picture of a finished run as PNG, 1600 x 1200 px; the same run gives the same bytes.

    Args:
        run: the run, ended.
        data: what `report.summary` returned for it.
        out: a file that is open for writing bytes.
    """
    picture(run, data).savefig(out, format="png", dpi=DPI, metadata={"Software": None})


@rc_context(STYLE)
def picture(run: MissionRun, data: Mapping[str, Any]) -> Figure:
    """Return what `draw` writes: a map and the list of adaptations over lines of time."""
    figure = Figure(figsize=(WIDTH / DPI, HEIGHT / DPI), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    story, split = _story(run, data), 12
    _title(figure, data, run.world.results())
    _legend(figure, story)
    top = _timelines(figure, story)
    if np.isfinite(story.xy).any():
        split = 960 if story.adaptations else 1420 if _is_ours(data) else WIDTH - 34
        places = {name: np.asarray(points, dtype=float) for name, points in run.world.scenery().items() if len(points)}
        _map(_axes(figure, 72, 106, split - 72, top - 162), story, places)
    if _is_ours(data):  # how others adapt is not told, only what they switch
        _list(_axes(figure, split + 22, 106, WIDTH - split - 30, top - 120), story.adaptations)
    return figure


def _is_ours(data: Mapping[str, Any]) -> bool:
    return bool(data.get("manager", "ours") == "ours")


def _story(run: MissionRun, data: Mapping[str, Any]) -> _Story:
    samples = [sample for sample, _, _ in run.trace.samples]
    signals = dict.fromkeys(name for sample in samples for name in sample.signals)
    limits: dict[str, dict[float, list[str]]] = {}
    for one in run.kb.model.constraints:
        labels = limits.setdefault(one.attribute.replace("_", " "), {}).setdefault(one.value, [])
        labels += [f"{_brief(one.operator)} {one.value:g}  {_brief(each.name)}" for each in one.constrained]
    return _Story(
        max(float(data["duration_s"]), 1e-3),
        np.array([sample.time for sample in samples], dtype=float),
        np.array([sample.position[:2] for sample in samples], dtype=float).reshape(-1, 2),
        [action for _, action, _ in run.trace.samples],
        [configuration for _, _, configuration in run.trace.samples],
        {name: np.array([sample.signals.get(name, np.nan) for sample in samples], dtype=float) for name in signals},
        limits,
        data["adaptations"],
        data["disturbances"],
    )


def _names(column: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(name for names in column for name in names.split(", ") if name))


def _bare(signal: str) -> str:
    return signal.split(" [")[0]


def _brief(text: str, most: int = 18) -> str:
    short = text.replace(" = ", "\u00a0=\u00a0").replace("->", "→").replace(">=", "≥").replace("<=", "≤")
    return short if len(short) <= most else f"{short[: most - 1]}…"


def _axes(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Add axes by their place in [px], counted from the upper left corner."""
    return figure.add_axes((left / WIDTH, 1 - (top + height) / HEIGHT, width / WIDTH, height / HEIGHT))


def _badge(axes: Axes, at: Array, number: int, kind: str) -> None:
    """Put the number of an adaptation at a pixel of the figure."""
    size, face, edge, digits = BADGES.get(kind, BADGES["parameter"])
    circle = Line2D(at[:1], at[1:], marker="o", markersize=size * 72 / DPI, markerfacecolor=face, markeredgecolor=edge)
    axes.add_artist(circle).set(transform=PIXELS, zorder=8, clip_on=False)
    digit = axes.text(at[0], at[1], str(number), ha="center", va="center_baseline", color=digits, fontsize=size / 3)
    digit.set(transform=PIXELS, zorder=9, fontweight="bold")


FACTS = 3
"""How many figures the title has room for; the result in JSON has all of them."""


def _title(figure: Figure, data: Mapping[str, Any], results: Mapping[str, float | None]) -> None:
    task = {"bt": "behaviour tree", "pddl": "PDDL plans"}.get(data["task"], data["task"])
    if not _is_ours(data):
        task = f"manager: {data['manager']}"
    name = f"{data['mission']}  ·  {task}  ·  seed {data['seed']}"
    figure.text(0.015, 1 - 32 / HEIGHT, name, fontsize=13, fontweight="bold", va="center")
    facts = [f"{data['outcome'].replace('_', ' ')} after {data['duration_s']:.0f} s"]
    for key, value in list(results.items())[:FACTS]:
        words, _, unit = key.rpartition("_")
        facts.append(f"{words.replace('_', ' ')} {'-' if value is None else f'{value:.1f} {unit}'}")
    figure.text(0.988, 1 - 32 / HEIGHT, "   ·   ".join(facts), fontsize=9.5, ha="right", va="center")


def _legend(figure: Figure, story: _Story) -> None:
    entries = [Line2D([], [], color=hue, linewidth=4, label=name) for name, hue in story.hues.items()]
    for kind in dict.fromkeys(one["kind"] for one in story.adaptations):
        size, face, edge, _ = BADGES.get(kind, BADGES["parameter"])
        badge = Line2D([], [], linestyle="", marker="o", markersize=size * 0.42, label=f"{kind} adaptation")
        badge.set(markerfacecolor=face, markeredgecolor=edge)
        entries.append(badge)
    if story.disturbances:
        entries.append(Line2D([], [], linewidth=1, linestyle="--", label="disturbance", **DIAMOND))
    legend = figure.legend(handles=entries, loc="center left", ncols=max(len(entries), 1), borderaxespad=0, fontsize=9)
    legend.set_bbox_to_anchor((0.01, 1 - 76 / HEIGHT))


class _Room:
    """Finds room on a map for what is written there, near what it names and off the path; in [px]."""

    def __init__(self, axes: Axes, xy: Array) -> None:
        self._axes, self._path = axes, axes.transData.transform(xy)
        self._taken: Array = np.empty((0, 2, 2))

    def name(self, xy: Array, text: str, marker: str, size: float, color: str = INK) -> None:
        """Mark a point [m] and name it."""
        point = self._axes.plot(xy[0], xy[1], marker, color=color, markersize=size, zorder=6)[0]
        point.set(markeredgecolor="white", markeredgewidth=0.7)
        x, y = self.lead(xy, 8.8 * len(text) + 4, 18)
        label = self._axes.text(x, y, text, ha="center", va="center", color=color)
        label.set(transform=PIXELS, zorder=7, path_effects=[withStroke(linewidth=2.5, foreground="white")])

    def lead(self, xy: Array, width: float, height: float) -> Array:
        """Take a box of a size near a point [m], draw a line from there to its edge, and return its centre."""
        anchor, half = self._axes.transData.transform(xy), np.array([width, height]) / 2
        turns = np.arange(0.25, 6.5, np.pi / 8)
        tries = [anchor + (half + 6 + far) * (np.cos(turn), np.sin(turn)) for far in REACH for turn in turns]
        centre = min(tries, key=lambda centre: self._cost(anchor, centre, half))
        self._taken = np.vstack([self._taken, [[centre - half, centre + half], [anchor - 5, anchor + 5]]])
        edge = centre + (anchor - centre) * min(1.0, *(half / np.maximum(np.abs(anchor - centre), 1e-9)))
        self._axes.plot(*np.stack([anchor, edge]).T, transform=PIXELS, color=MUTED, linewidth=0.8, zorder=5)
        return np.asarray(centre)

    def _cost(self, anchor: Array, centre: Array, half: Array) -> float:
        low, high, lead = centre - half - 2, centre + half + 2, np.linspace(anchor, centre, 9)[2:-1, None]
        hidden = np.all((self._path > low) & (self._path < high), axis=1).sum()
        met = np.all((low < self._taken[:, 1]) & (high > self._taken[:, 0]), axis=1).sum()
        crossed = np.all((lead > self._taken[:, 0]) & (lead < self._taken[:, 1]), axis=2).sum()
        outside = np.any((low < self._axes.bbox.min) | (high > self._axes.bbox.max))
        return float(np.hypot(*(centre - anchor)) + 5 * hidden + 20 * crossed + 300 * met + 1000 * outside)


def _map(axes: Axes, story: _Story, places: Mapping[str, Array]) -> None:
    near = [points[[np.argmin(np.hypot(*(points - story.xy[0]).T))]] for points in places.values()]
    shown, box = np.vstack([story.xy, *near]), axes.bbox.size
    half = np.ptp(shown, axis=0) * 0.55 + 0.8
    middle, half = (shown.min(axis=0) + shown.max(axis=0)) / 2, np.maximum(half, half[::-1] * box / box[::-1])
    axes.set(xlim=middle[0] + half[0] * SIDES, ylim=middle[1] + half[1] * SIDES, facecolor="#f6f9fb")
    axes.set(aspect="equal", xlabel="east x [m]", ylabel="north y [m]")
    links, hues = np.stack([story.xy[:-1], story.xy[1:]], axis=1), story.hues
    turns = np.cumsum([before != after for before, after in pairwise(story.actions)])
    lines = LineCollection(list(links), capstyle="round", zorder=4)
    lines.set(color=[hues.get(names.split(", ")[0], FAINT) for names in story.actions[:-1]])
    lines.set(linewidth=1.8 + 2.8 * (1 - turns / max([1, *turns[-1:]])))  # an earlier passage stays in sight below
    axes.add_collection(lines, autolim=False)
    room = _Room(axes, story.xy)
    for name, points in places.items():
        axes.plot(*points.T, color="#c9ced3", linewidth=10, solid_capstyle="round", zorder=2)
        inside = points[np.all(np.abs(points - middle) < half, axis=1)]
        lonely = [np.hypot(*(story.xy - point).T).min() for point in inside]
        room.name(inside[np.argmax(lonely)], name, "" if len(points) > 1 else "s", 9)
    room.name(story.xy[0], "start", "o", 8)

    def where(time: float) -> Array:
        return np.array([np.interp(time, story.times, column) for column in story.xy.T])

    for number, one in enumerate(story.adaptations, start=1):
        size = BADGES.get(one["kind"], BADGES["parameter"])[0]
        _badge(axes, room.lead(where(one["at_s"]), size, size), number, one["kind"])
    step = next(one for one in (5, 10, 30, 60, 120, 300, 600, 1800, 7200, 10**9) if story.end / one <= 10)
    for time in range(step, int(story.times[-1]) + 1, step):
        room.name(where(time), f"{time} s", "o", 4.5, MUTED)


def _list(axes: Axes, adaptations: Events) -> None:
    """Write what set each adaptation off and what was changed, as large and as fully as there is room."""
    axes.set_axis_off()
    axes.set(xlim=(0, axes.bbox.width), ylim=(axes.bbox.height, 0))
    head = "adaptations: what set them off → what was changed" if adaptations else "no adaptation"
    axes.text(0, 0, head, fontsize=10, fontweight="bold", va="top")
    for size, full in ((10, True), (9, True), *((size, False) for size in (9, 8.5, 8, 7.5, 7, 6.5, 6))):
        line, left = size * LINE, 18 + size * 13
        texts = [_lines(one, full, (axes.bbox.width - left) / (0.43 * line)) for one in adaptations]
        starts = 32 + np.cumsum([0, *(line * (len(text) + 0.3) for text in texts)])
        if starts[-1] <= axes.bbox.height:
            break
    for number, (one, text, y) in enumerate(zip(adaptations, texts, starts, strict=False), start=1):
        if starts[-1] > axes.bbox.height < starts[number] + line:
            axes.text(left, y, f"… and {len(texts) - number + 1} more", fontsize=size, color=MUTED, va="top")
            break
        _badge(axes, axes.transData.transform((13, y + line * 0.8)), number, one["kind"])
        axes.text(32, y, f"{one['at_s']:.1f} s", fontsize=size, fontweight="bold", va="top")
        axes.text(32, y + line, one["kind"], fontsize=size - 0.5, color=MUTED, va="top")
        for index, part in enumerate(text):
            axes.text(left, y + index * line, part, fontsize=size, va="top")


def _lines(one: Mapping[str, Any], full: bool, width: float) -> list[str]:
    reaction = "not in force" if one["reaction_s"] is None else f"in\u00a0{one['reaction_s']:.2f}\u00a0s"
    texts = one["trigger"] + (f": {one['reason']}" if full else ""), f"-> {one['change']} [{reaction}]"
    return [part for text in texts for part in textwrap.wrap(_brief(text, 500), int(width), subsequent_indent="    ")]


def _timelines(figure: Figure, story: _Story) -> float:
    """Draw everything over time, one row above the other; return where the rows begin [px from the top]."""
    panels = _panels(story)
    told = [one for one in story.disturbances if not any(one["what"].startswith(_bare(name)) for name in panels)]
    rows: list[tuple[int, Callable[[Axes], None]]] = [_events(story, "disturbances", told, 8.4)] if told else []
    tall = min(150, PANELS // max(1, len(panels)))
    rows += [(tall, partial(_panel, story=story, names=[name, *others])) for name, others in panels.items()]
    rows += [_events(story, "adaptations", story.adaptations, 0)] if story.adaptations else []
    for title, column in (("active action", story.actions), ("configuration", story.configurations)):
        if names := _names(column):
            rows.append((LANE * len(names) + 4, partial(_bars, story=story, title=title, column=column, names=names)))
    start = top = HEIGHT - 46.0 - sum(height + GAP for height, _ in rows)
    for number, (height, show) in enumerate(rows, start=1):
        axes = _axes(figure, LEFT, top, RIGHT - LEFT, height)
        axes.set_xlim(0, story.end)
        show(axes)
        for one in story.adaptations:
            axes.axvline(one["at_s"], color="#999999", linewidth=0.7, zorder=1.5)
        for one in story.disturbances:
            axes.axvline(one["at_s"], color=ALARM, linewidth=0.8, dashes=(4, 3), alpha=0.7, zorder=1.6)
        axes.tick_params(labelbottom=number == len(rows), bottom=number == len(rows))
        axes.set_xlabel("time [s]" if number == len(rows) else "")
        top += height + GAP
    return start


def _panels(story: _Story) -> dict[str, list[str]]:
    """Return the signals worth a panel, each with those that share it since their names end with its name."""
    worth = [
        name
        for name, values in story.signals.items()
        if np.isfinite(values).any() and (np.nanmin(values) < np.nanmax(values) or _bare(name) in story.limits)
    ]
    hosts = {name: next((host for host in worth if name.endswith(f" {host}")), name) for name in worth}
    return {host: [name for name in worth if hosts[name] == host != name] for host in worth if hosts[host] == host}


def _events(story: _Story, title: str, events: Events, letter: float) -> tuple[int, Callable[[Axes], None]]:
    """Return the height [px] of a row of events, and what draws it; `letter`: how wide one of a text is [px]."""
    ends: list[float] = []
    levels, sides = [], []
    for one in events:
        x, width = one["at_s"] / story.end * (RIGHT - LEFT), 26 + letter * len(one.get("what", ""))
        sides.append("right" if letter and x + width > RIGHT - LEFT else "left")
        start, end = (x, x + width) if sides[-1] == "left" else (x - width, x + 10)
        free = (level for level, taken in enumerate(ends) if taken <= start)
        levels.append(next(free, min(len(ends), 5)))
        ends[levels[-1] : levels[-1] + 1] = [end]

    def show(axes: Axes) -> None:
        axes.set(ylim=(len(ends) - 0.5, -0.5), yticks=[])
        _aside(axes, title, 0.5)
        for number, (level, side, one) in enumerate(zip(levels, sides, events, strict=True), start=1):
            if "what" not in one:
                _badge(axes, axes.transData.transform((one["at_s"], level)), number, one["kind"])
                continue
            axes.plot(one["at_s"], level, zorder=3, **DIAMOND)
            gap = story.end * (0.007 if side == "left" else -0.007)
            text = axes.text(one["at_s"] + gap, level, one["what"], color=ALARM, ha=side, va="center")
            text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0})

    return EVENT * len(ends), show


def _aside(axes: Axes, text: str, y: float, color: str = MUTED) -> None:
    """Write to the right of a row, at a part of its height."""
    axes.text(1.006, y, text, transform=axes.transAxes, va="center", color=color, fontsize=8)


def _bars(axes: Axes, story: _Story, title: str, column: Sequence[str], names: list[str]) -> None:
    axes.set(ylim=(len(names) - 0.45, -0.55))
    axes.set_yticks(range(len(names)), [_brief(name) for name in names])
    axes.tick_params(left=False)
    _aside(axes, title, 0.5)
    for name, start, end in story.spans(column):
        hue = story.hues[name] if column is story.actions else "#7d8790"
        axes.barh(names.index(name), end - start, left=start, height=0.76, color=hue, zorder=2)


def _panel(axes: Axes, story: _Story, names: list[str]) -> None:
    """Draw a signal and those that share its panel, the thresholds of the model, and the disturbances it shows."""
    for name, start, end in story.spans(story.actions):
        axes.axvspan(start, end, color=story.hues[name], alpha=0.09, linewidth=0, zorder=0.5)
    for name, color, dashes in zip(names, (INK, "#7b3294", "#0f6b78"), ("-", "--", ":"), strict=False):
        line = axes.plot(story.times, story.signals[name], dashes, color=color, linewidth=1.5, zorder=4)[0]
        line.set(label=_bare(name), drawstyle="default" if name == names[0] else "steps-post")
    limits = story.limits.get(_bare(names[0]), {})
    axes.hlines(list(limits), 0, story.end, color=LIMIT, linewidth=1, linestyle=":", zorder=3)
    axes.margins(y=0.12)
    (low, high), height = axes.get_ylim(), 0.0
    for value, labels in sorted(limits.items()):
        height = max(height + 0.08 * len(labels), (value - low) / (high - low))
        _aside(axes, "\n".join(labels), height, LIMIT)
        height += 0.08 * len(labels)
    for one in story.disturbances:
        if one["what"].startswith(_bare(names[0])):
            axes.plot(one["at_s"], np.interp(one["at_s"], story.times, story.signals[names[0]]), zorder=5, **DIAMOND)
    axes.set_ylabel(names[0].replace(" ", "\n"), rotation=0, ha="right", va="center", labelpad=6)
    if len(names) > 1:
        axes.legend(loc="center left", bbox_to_anchor=(1, 0.5), fontsize=8)
