"""Draws a finished run as one picture: where the robot went, what it measured, how it adapted."""

import re
import textwrap
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from io import BytesIO
from itertools import groupby, product
from typing import Any, Final

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.text import Text
from numpy.typing import NDArray

from missions.views.report import Recorded

Array = NDArray[np.float64]
Span = tuple[str, float, float]
"""A name, and the start and end of the time during which it holds [s]."""
Entry = Mapping[str, Any]

SAMPLED_S: Final = 0.6
"""The longest time between two samples of a run [s]."""
REPORTED_S: Final = 2.0
"""The longest time between a failure and its report [s]."""
_ALL: Final = {
    "function design": ("function", "designs"),
    "configuration": ("component", "configurations"),
}


class RunTimeline:
    """The data of a run as the picture needs them.

    Attributes:
        end: time of the end [s].
        times: of the poses (n,) [s].
        xy: positions of the robot (n, 2) [m], world frame; `places` are those of the scene, points (n, 2) [m] by name.
        actions, designs, configurations: spans of actions, and of selected elements where there was a choice.
        courses: measurements (2, n) by name: times [s] and values; `units` by name.
        limits: labels of thresholds, by attribute and value.
        adaptations, disturbances: as in the page, in order of time; `unseen` are the disturbances that no panel shows.
        panels: the courses that get a panel, each with those that share it because their names end with its name.
    """

    def __init__(self, run: Recorded) -> None:
        self.run, self.end = run, max(run.rows[-1][0], 1e-3)
        self._elements = {key: one for _, key, one in run.track("element") if one is not None}
        poses = np.array(
            [(time, *position[:2]) for time, _, position in run.track("pose")], dtype=float
        ).reshape(-1, 3)
        self.times, self.xy = poses[:, 0], poses[:, 1:]
        self.places = {
            one["name"]: np.array(one["points"])
            for one in run.last("scene").get(0, ())
            if one["points"]
        }
        acted = list(run.last("action").values())
        self.actions = [
            (self._name(one["action"]), one["start"], one["end"] or self.end) for one in acted
        ]
        self.designs, self.configurations = map(list[Span], map(self._chosen, _ALL))
        self.units: dict[str, str] = {}
        self.courses = self._courses()
        self.limits = self._limits()
        self.adaptations: list[Entry] = sorted(
            run.last("adaptation").values(), key=lambda one: float(one["t"])
        )
        known: list[Entry] = list(run.last("disturbance").values())
        self.disturbances = sorted(
            [*known, *self._failures(known)], key=lambda one: float(one["t"])
        )
        self.panels = self._panels()
        self.unseen = [
            one for one in self.disturbances if not one["words"].startswith(tuple(self.panels))
        ]

    def where(self, time: float) -> Array:
        """Return the position of the robot (2,) [m] at a time [s]."""
        return np.array([np.interp(time, self.times, column) for column in self.xy.T])

    def legs(self) -> Iterator[tuple[str, str, Array]]:
        """Yield each part of the path with the same action and choice: action, choice and positions (n, 2) [m]."""
        at_poses = groupby(
            zip(self.times, self.xy, strict=True), key=lambda pose: self._doing(pose[0])
        )
        for (done, choice), poses in at_poses:
            if done and choice:
                yield done, choice, np.array([xy for _, xy in poses])

    def _doing(self, time: float) -> tuple[str, str]:
        done, *chosen = (
            _at(spans, time) for spans in (self.actions, self.designs, self.configurations)
        )
        return done, ", ".join(filter(None, chosen))

    def _name(self, key: int | str) -> str:
        return str(self._elements[key]["name"])

    def _chosen(self, kind: str) -> Iterator[Span]:
        """Yield when elements with alternatives were selected, unless the action alone determines them."""
        of, parts = _ALL[kind]
        since: dict[int | str, float] = {}
        spans: defaultdict[int, list[Span]] = defaultdict(list)
        for time, key, is_selected in [
            *self.run.track("selected"),
            *((self.end, key, 0) for key in self._elements),
        ]:
            one = self._elements[key]
            if is_selected:
                since[key] = time
            elif key in since and one["kind"] == kind and len(self._elements[one[of]][parts]) > 1:
                spans[one[of]].append((one["name"], since.pop(key), time))
        for held in spans.values():
            doing = {(name, _at(self.actions, (start + end) / 2)) for name, start, end in held}
            names, actions = map(set, zip(*doing, strict=True))
            if kind != "configuration" or not len(actions) == len(doing) == len(names) > 1:
                yield from held

    def _courses(self) -> dict[str, Array]:
        points: defaultdict[str, list[tuple[float, float]]] = defaultdict(list)
        for time, key, value in (*self.run.track("value"), *self.run.track("signal")):
            signal, _, unit = str(key).partition(" [")
            name = (
                signal if unit or key not in self._elements else self._name(key).replace("_", " ")
            )
            self.units[name] = (
                unit.rstrip("]") if unit else self._elements.get(key, {}).get("unit", "")
            )
            if (
                points[name] and time > points[name][-1][0] + 2 * SAMPLED_S
            ):  # a signal is recorded only when it changes
                points[name].append((time - SAMPLED_S, points[name][-1][1]))
            points[name].append((time, np.nan if value is None else value))
        worth = [
            str(name).replace("_", " ") for name in self.run.header.get("signals", ())
        ] or list(points)
        worth = [name for name in worth if np.isfinite([value for _, value in points[name]]).any()]
        return {
            name: np.array([*points[name], (self.end, points[name][-1][1])]).T for name in worth
        }

    def _limits(self) -> dict[str, dict[float, list[str]]]:
        limits: dict[str, dict[float, list[str]]] = defaultdict(dict)
        for one in self._elements.values():
            if one["kind"] == "constraint":
                labels = limits[self._name(one["attribute"]).replace("_", " ")].setdefault(
                    one["value"], []
                )
                labels += [
                    f"{brief(one['operator'])} {one['value']:g}  {brief(self._name(key))}"
                    for key in one["on"]
                ]
        return limits

    def _panels(self) -> dict[str, list[str]]:
        worth = [
            name
            for name, (_, values) in self.courses.items()
            if name in self.limits or len({*values}) > 1
        ]
        hosts = {
            name: next((one for one in worth if name.endswith(f" {one}")), name) for name in worth
        }
        return {
            host: [name for name in worth if hosts[name] == host != name]
            for host in worth
            if hosts[host] == host
        }

    def _failures(self, disturbances: Sequence[Entry]) -> Iterator[Entry]:
        """Yield the reported failures, except those that a disturbance just before explains."""
        for time, _, event in self.run.track("event"):
            is_listed = any(0 <= time - one["t"] <= REPORTED_S for one in disturbances)
            if event["verb"] == "component_failed" and not is_listed:
                yield {"t": time, "words": event["words"]}


def _at(spans: Sequence[Span], time: float) -> str:
    return ", ".join(dict.fromkeys(name for name, start, end in spans if start <= time < end))


def brief(text: str, most: int = 26) -> str:
    """Return a text of at most so many characters, with signs such as ≥ instead of ASCII."""
    short = (
        text.replace(" = ", "\u00a0=\u00a0")
        .replace("->", "→")
        .replace(">=", "≥")
        .replace("<=", "≤")
    )
    return short if len(short) <= most else f"{short[: most - 1]}…"


WIDTH, HEIGHT, DPI = 1600, 1200, 125  # [px], [px], [px/inch]
PANELS, LANE, EVENT = 330, 20, 28  # heights of all signals, of a bar and of a row of events [px]
LETTER, TIME_AXIS = 8.4, 1100  # width of a letter, and of the axis of time, about [px]
REACH = (0, 8, 18, 30, 45, 65, 90, 120)  # how far from its place a label may go [px]
INK, MUTED, FAINT, ALARM, LIMIT = "#222222", "#666666", "#b5b5b5", "#d55e00", "#0f6b78"
HUES: Final = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#8c6d31", "#b8ac00")
"""The colours of Okabe and Ito without the one used for alarms."""
BADGES: Final = {  # how the number of an adaptation looks: face, edge, digits
    "task": (INK, INK, "white"),
    "structural": ("white", INK, INK),
    "parameter": ("#e2e2e2", "#9a9a9a", INK),
}
DIAMOND: Final[dict[str, Any]] = {"marker": "D", "markersize": 4.5, "color": ALARM}
ROUND: Final[dict[str, Any]] = {"marker": "o", "linestyle": ""}
CROWD, LONELY_M = 20, 1.0  # if there are more places, only those so near to the path are named
LONGEST, FIGURES = 420, 3  # letters of a reason, and figures in the title at most
TICKS = {"color": FAINT, "labelcolor": INK, "labelsize": 8, "major.size": 3}
STYLE: Final[dict[Any, Any]] = {
    **{"font.family": "DejaVu Sans", "font.size": 8.5, "text.color": INK, "text.parse_math": False},
    **{"axes.edgecolor": FAINT, "axes.linewidth": 0.7, "axes.labelpad": 1, "legend.frameon": False},
    **{f"{side}tick.{key}": value for side in "xy" for key, value in TICKS.items()},
}


def draw(run: Recorded) -> bytes:
    """Draw a finished run as PNG, 1600 x 1200 px; the same run gives the same bytes."""
    png = BytesIO()
    picture(run).savefig(png, format="png", dpi=DPI, metadata={"Software": None})
    return png.getvalue()


@rc_context(STYLE)
def picture(run: Recorded) -> Figure:
    """Return what `draw` writes: a map and the list of adaptations over lines of time."""
    figure, timeline = Figure(figsize=(WIDTH / DPI, HEIGHT / DPI), dpi=DPI), RunTimeline(run)
    FigureCanvasAgg(figure)
    figure.set_layout_engine("constrained", rect=(0.005, 0, 0.99, 1 - 95 / HEIGHT))
    hues = dict(zip(dict.fromkeys(name for name, *_ in timeline.actions), HUES * 99, strict=False))
    _title(figure, run)
    _legend(figure, timeline, hues)
    has_map, has_list = (
        bool(len(timeline.xy)),
        run.header["manager"] == "ours",
    )  # how others adapt is not known
    rows = list(_rows(timeline, hues, has_map=has_map))
    heights = [height for height, _ in rows]
    top = max(HEIGHT - 160 - sum(heights), 260) if has_map else 50 + 50 * len(timeline.adaptations)
    outer = figure.add_gridspec(2, 1, height_ratios=(top, sum(heights) or 1))
    above = outer[0].subgridspec(1, 2, width_ratios=(3, 2))
    below = outer[1].subgridspec(len(rows) or 1, 1, height_ratios=heights or None)
    for number, (_, show) in enumerate(rows, start=1):
        axes = figure.add_subplot(below[number - 1], xlim=(0, timeline.end))
        show(axes)
        for one in timeline.adaptations:
            axes.axvline(one["t"], color="#999999", linewidth=0.7, zorder=1.5)
        for one in timeline.unseen:
            axes.axvline(one["t"], color=ALARM, linewidth=0.8, dashes=(4, 3), alpha=0.7, zorder=1.6)
        axes.tick_params(labelbottom=number == len(rows), bottom=number == len(rows))
        axes.set_xlabel("time [s]" if number == len(rows) else "")
    seen = figure.add_subplot(above[: 2 - has_list]) if has_map else None
    listed = (
        figure.add_subplot(above[int(has_map) :], frame_on=False, xticks=[], yticks=[])
        if has_list
        else None
    )
    if seen is not None:
        _map(seen, timeline, hues)
    figure.draw_without_rendering()  # texts from here on go where there is room
    figure.set_layout_engine("none")
    for axes in figure.axes:  # the layout is exact to a rounding only
        axes.set_position(np.round(axes.get_position().bounds, 3).tolist())
    if seen is not None:
        _label(seen, timeline, hues)
    if listed is not None:
        _list(listed, timeline.adaptations)
    return figure


def _title(figure: Figure, run: Recorded) -> None:
    header, ended = run.header, run.last("result").get(0, {})
    task = {"bt": "behaviour tree", "pddl": "PDDL plans"}.get(header["task"], header["task"])
    who = task if header["manager"] == "ours" else f"manager: {header['manager']}"
    name = f"{header['title']}  ·  {who}  ·  seed {header['seed']}"
    figure.text(0.01, 1 - 30 / HEIGHT, name, fontsize=13, fontweight="bold", va="center")
    facts = [f"{ended.get('outcome', '').replace('_', ' ')} after {run.rows[-1][0]:.0f} s"]
    facts += [
        f"{words} {shown} {unit}".strip()
        for words, unit, shown in ended.get("figures", ())[:FIGURES]
    ]
    figure.text(0.99, 1 - 30 / HEIGHT, "   ·   ".join(facts), fontsize=9.5, ha="right", va="center")


def _legend(figure: Figure, timeline: RunTimeline, hues: Mapping[str, str]) -> None:
    styles: dict[str, dict[str, Any]] = {
        name: {"color": hue, "linewidth": 4} for name, hue in hues.items()
    }
    for kind in dict.fromkeys(one["kind"] for one in timeline.adaptations):
        styles[f"{kind} adaptation"] = {
            **ROUND,
            "ms": 9,
            "mfc": BADGES[kind][0],
            "mec": BADGES[kind][1],
        }
    if timeline.disturbances:
        styles["disturbance"] = {"linewidth": 1, "linestyle": "--", **DIAMOND}
    entries = [Line2D([], [], label=label, **style) for label, style in styles.items()]
    letters = 9 * min(1.0, WIDTH / max(sum(78 + 9.4 * len(label) for label in styles), 1.0))
    legend = figure.legend(
        handles=entries, loc="center left", ncols=max(len(entries), 1), fontsize=letters
    )
    legend.set_bbox_to_anchor((0.0, 1 - 72 / HEIGHT))


# ---------------------------------------------------------------- the map, seen from above


def _map(axes: Axes, timeline: RunTimeline, hues: Mapping[str, str]) -> None:
    near = [
        points[np.argmin(np.hypot(*(points - timeline.xy[0]).T))]
        for points in timeline.places.values()
    ]
    axes.set(
        xlabel="east x [m]", ylabel="north y [m]", facecolor="#f6f9fb", xmargin=0.06, ymargin=0.1
    )
    axes.update_datalim([*near, *timeline.xy, *(timeline.xy[0] + [[-1.0, -1.0], [1.0, 1.0]])])
    for points in timeline.places.values():
        axes.plot(
            *points.T,
            color="#c9ced3",
            linewidth=10,
            solid_capstyle="round",
            zorder=2,
            scalex=False,
            scaley=False,
        )
    axes.plot(*timeline.xy.T, color=FAINT, linewidth=1.8, zorder=3)
    for number, (name, start, end) in enumerate(timeline.actions):
        inside = timeline.xy[(start <= timeline.times) & (timeline.times <= end)]
        width = 4.6 - 2.8 * number / len(
            timeline.actions
        )  # so an earlier passage stays visible below
        axes.plot(*inside.T, color=hues[name], linewidth=width, solid_capstyle="round", zorder=4)


class _Room:
    """Finds room for texts on a map: near what they name, and off the path."""

    def __init__(self, axes: Axes, xy: Array) -> None:
        self.axes, self._path = axes, axes.transData.transform(xy)
        self._low: Array = np.empty((0, 2))  # corners of the boxes that are taken [px]
        self._high: Array = np.empty((0, 2))

    def write(self, xy: Array, text: str, pad: float = 2.0, **style: Any) -> None:  # noqa: ANN401  # of a text
        """Write a text near a point [m], with a line to it; `pad` is the width of the text's margin [px]."""
        line = {"arrowstyle": "-", "color": MUTED, "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
        style = {"ha": "center", "va": "center", "zorder": 7, "arrowprops": line, **style}
        label = self.axes.annotate(
            text, (xy[0], xy[1]), (0, 0), textcoords="offset pixels", **style
        )
        anchor, half = (
            self.axes.transData.transform(xy),
            np.array(Text.get_window_extent(label).size) / 2 + pad,
        )
        turns = np.arange(0.25, 6.5, np.pi / 8)
        tries = np.array(
            [(half + 6 + far) * (np.cos(turn), np.sin(turn)) for far in REACH for turn in turns]
        )
        best = tries[np.argmin(self._costs(anchor, half, tries))]
        label.set_position(tuple(best))
        self._low = np.vstack([self._low, anchor - half + best, anchor - 5])
        self._high = np.vstack([self._high, anchor + half + best, anchor + 5])

    def _costs(self, anchor: Array, half: Array, offsets: Array) -> Array:
        """Return the cost of putting a box of half size `half` at each offset (n, 2) from its anchor [px]."""
        low, high = anchor - half + offsets, anchor + half + offsets
        leads = anchor + np.linspace(0.3, 0.8, 6)[:, None, None] * offsets
        hidden = _are_within(self._path[:, None], low, high).sum(axis=0)
        crossed = _are_within(leads[:, :, None], self._low, self._high).sum(axis=(0, 2))
        met = ((low[:, None] < self._high) & (self._low < high[:, None])).all(axis=-1).sum(axis=1)
        frame = np.array([self.axes.bbox.min, self.axes.bbox.max])
        inside = _are_within(low, *frame) & _are_within(high, *frame)
        costs: Array = np.hypot(*offsets.T) + 5 * hidden + 20 * crossed + 300 * met + 1000 * ~inside
        return costs


def _are_within(points: Array, low: Array, high: Array) -> Any:  # noqa: ANN401  # one truth for each pair: numpy's
    return ((low < points) & (points < high)).all(axis=-1)


def _label(axes: Axes, timeline: RunTimeline, hues: Mapping[str, str]) -> None:
    axes.set_aspect("equal", adjustable="datalim")
    axes.apply_aspect()
    axes.autoscale(False)
    room = _Room(axes, timeline.xy)
    plain: dict[str, Any] = {"path_effects": [withStroke(linewidth=2.5, foreground="white")]}
    _mark(axes, timeline.xy[0], "o", 8, INK)
    room.write(timeline.xy[0], "start", **plain)
    _mark(axes, timeline.xy[-1], "o", 8, INK)
    room.write(timeline.xy[-1], f"end, {timeline.end:.0f} s", **plain)
    for name, points in timeline.places.items():
        inside = points[[axes.viewLim.contains(*point) for point in points]]
        lonely = np.array([np.hypot(*(timeline.xy - point).T).min() for point in inside])
        if not len(inside) or (len(timeline.places) > CROWD and np.median(lonely) > LONELY_M):
            continue
        named = inside[lonely.argmax() if lonely.max() > LONELY_M else len(inside) // 2]
        _mark(axes, named, "" if len(points) > 1 else "s", 9, INK)
        room.write(named, name, **plain)
    for number, one in enumerate(timeline.adaptations, start=1):
        room.write(timeline.where(one["t"]), str(number), 8, **_badge(one["kind"]))
    scale = axes.bbox.width / np.ptp(axes.get_xlim())
    legs = [
        (name, choice, xy, np.cumsum(np.hypot(*np.diff(xy, axis=0).T)))
        for name, choice, xy in timeline.legs()
    ]
    long = [one for one in legs if len(one[3]) and one[3][-1] * scale > 0.8 * LETTER * len(one[1])]
    for name, choice, xy, driven_m in long if len({one[1] for one in long}) > 1 else ():
        frame = {"boxstyle": "round,pad=0.25", "facecolor": "white", "linewidth": 1.4}
        middle = xy[np.searchsorted(driven_m, driven_m[-1] / 2)]
        room.write(
            middle, choice, 8, fontsize=8, bbox={**frame, "edgecolor": hues[name.split(", ")[0]]}
        )


def _mark(axes: Axes, xy: Array, marker: str, size: float, color: str) -> None:
    axes.plot(*xy, marker, color=color, markersize=size, zorder=6, mec="white", mew=0.7)


def _badge(kind: str) -> dict[str, Any]:
    face, edge, digits = BADGES.get(kind, BADGES["parameter"])
    bbox = {"boxstyle": "circle,pad=0.25", "facecolor": face, "edgecolor": edge}
    return {
        "bbox": bbox,
        "color": digits,
        "fontsize": 7.5,
        "fontweight": "bold",
        "ha": "center",
        "va": "center",
    }


# ---------------------------------------------------------------- the list of adaptations


def _list(axes: Axes, entries: Sequence[Entry]) -> None:
    """Write cause and change of each adaptation, in the largest letters and the fullest form that fit."""
    width, height = axes.bbox.width * 72 / DPI, axes.bbox.height * 72 / DPI - 20  # [pt]
    axes.set(xlim=(0, width), ylim=(height, -20))
    head = "adaptations: what set them off → what was changed" if entries else "no adaptation"
    axes.text(0, -20, head, fontsize=10, fontweight="bold", va="top")
    for size, full in (
        *product((10, 9, 8.5, 8, 7.5, 7), (True,)),
        *product((9, 8.5, 8, 7.5, 7, 6.5, 6), (False,)),
    ):
        line, left = 1.25 * size, 10 + 7.5 * size
        texts = [_lines(one, full, (width - left) / (0.58 * size)) for one in entries]
        starts = np.cumsum([0, *(line * (len(text) + 0.4) for text in texts)])
        if starts[-1] <= height:
            break
    for number, (one, text, y) in enumerate(zip(entries, texts, starts, strict=False), start=1):
        if y + line * (len(text) + 1.4) > height and one is not entries[-1]:
            axes.text(
                left,
                y,
                f"… and {len(entries) + 1 - number} more",
                fontsize=size,
                color=MUTED,
                va="top",
            )
            break
        axes.text(7, y + line * 0.8, str(number), **_badge(one["kind"]))
        axes.text(18, y, f"{one['t']:.1f} s", fontsize=size, fontweight="bold", va="top")
        axes.text(18, y + line, one["kind"], fontsize=size - 0.5, color=MUTED, va="top")
        axes.text(left, y, "\n".join(text), fontsize=size, va="top", linespacing=1.25 / 1.16)


def _lines(one: Entry, full: bool, width: float) -> list[str]:
    reaction = one["reaction"]
    how = "not in force" if reaction is None else f"in\u00a0{reaction:.2f}\u00a0s"
    why = re.sub(r" \(measured [^)]*\)", "", f": {one['decided']}") if full else ""
    texts = one["cause"] + brief(why, LONGEST), f"-> {one['changed']} [{how}]"
    return [
        part
        for text in texts
        for part in textwrap.wrap(brief(text, 500), int(width), subsequent_indent="    ")
    ]


# ---------------------------------------------------------------- everything over time, one row below the other


def _rows(
    timeline: RunTimeline, hues: Mapping[str, str], *, has_map: bool
) -> Iterator[tuple[float, Callable[[Axes], None]]]:
    """Yield for each row its approximate height [px] and a function that draws it."""
    if timeline.unseen:
        levels = _levels(timeline.unseen, timeline.end)
        yield EVENT * (1 + max(levels)), partial(_events, timeline=timeline, levels=levels)
    many = max(len(timeline.panels), 1)
    tall = min(150, PANELS / many) if has_map else min(280, 2 * PANELS / many)
    for name, sharing in timeline.panels.items():
        yield tall, partial(_panel, timeline=timeline, hues=hues, names=[name, *sharing])
    if timeline.adaptations:
        yield EVENT, partial(_numbers, timeline=timeline)
    lanes = {
        "actions": timeline.actions,
        "designs": timeline.designs,
        "configurations": timeline.configurations,
    }
    for title, spans in lanes.items():
        names = list(dict.fromkeys(name for name, *_ in spans))
        if names:
            yield (
                LANE * len(names) + 4,
                partial(_bars, title=title, names=names, spans=spans, hues=hues),
            )


def _levels(events: Sequence[Entry], end_s: float) -> list[int]:
    """Return the line of each text such that texts do not overlap, as far as six lines have room."""
    ends, levels = [0.0] * 6, list[int]()
    for one in events:
        start = max(0.0, min(one["t"] / end_s * TIME_AXIS, TIME_AXIS - LETTER * len(one["words"])))
        levels.append(next((level for level, taken in enumerate(ends) if taken <= start), 5))
        ends[levels[-1]] = start + 26 + LETTER * len(one["words"])
    return levels


def _events(axes: Axes, timeline: RunTimeline, levels: Sequence[int]) -> None:
    end = timeline.end
    axes.set(ylim=(max(levels) + 0.5, -0.5), yticks=[])
    _aside(axes, "disturbances", 0.5)
    for level, one in zip(levels, timeline.unseen, strict=True):
        axes.plot(one["t"], level, zorder=3, **DIAMOND)
        is_late = one["t"] / end * TIME_AXIS + LETTER * len(one["words"]) > TIME_AXIS
        text = axes.text(
            one["t"] + end * (-0.007 if is_late else 0.007),
            level,
            one["words"],
            color=ALARM,
            va="center",
        )
        text.set(
            ha="right" if is_late else "left",
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0},
        )


def _numbers(axes: Axes, timeline: RunTimeline) -> None:
    axes.set(ylim=(-1, 1), yticks=[])
    _aside(axes, "adaptations", 0.5)
    for number, one in enumerate(timeline.adaptations, start=1):
        axes.text(one["t"], 0, str(number), **_badge(one["kind"]))


def _aside(axes: Axes, text: str, y: float, color: str = MUTED) -> None:
    axes.text(1.006, y, text, transform=axes.transAxes, va="center", color=color, fontsize=8)


def _bars(
    axes: Axes, title: str, names: list[str], spans: Sequence[Span], hues: Mapping[str, str]
) -> None:
    axes.set(ylim=(len(names) - 0.45, -0.55))
    axes.set_yticks(range(len(names)), [brief(name) for name in names])
    axes.tick_params(left=False)
    _aside(axes, title, 0.5)
    for name, start, end in spans:
        hue = hues[name] if title == "actions" else "#7d8790"
        axes.barh(names.index(name), end - start, left=start, height=0.76, color=hue, zorder=2)


def _panel(axes: Axes, timeline: RunTimeline, hues: Mapping[str, str], names: list[str]) -> None:
    for name, start, end in timeline.actions:
        axes.axvspan(start, end, color=hues[name], alpha=0.09, linewidth=0, zorder=0.5)
    for name, color, dashes in zip(names, (INK, "#7b3294", LIMIT), ("-", "--", ":"), strict=False):
        axes.plot(*timeline.courses[name], dashes, color=color, linewidth=1.5, zorder=4, label=name)
    limits = timeline.limits.get(names[0], {})
    axes.hlines(list(limits), 0, timeline.end, color=LIMIT, linewidth=1, linestyle=":", zorder=3)
    axes.margins(y=0.12)
    (low, high), height, half = axes.get_ylim(), 0.0, 8.5 / axes.bbox.height
    for value, labels in sorted(limits.items()):
        height = max(height + half * len(labels), (value - low) / (high - low))
        _aside(axes, "\n".join(labels), height, LIMIT)
        height += half * len(labels)
    for one in timeline.disturbances:
        if one["words"].startswith(names[0]):
            axes.plot(
                one["t"], np.interp(one["t"], *timeline.courses[names[0]]), zorder=5, **DIAMOND
            )
    words = [*names[0].split(), f"[{timeline.units[names[0]] or '-'}]"]
    axes.set_ylabel("\n".join(words), rotation=0, ha="right", va="center", labelpad=9)
    if len(names) > 1:
        axes.legend(loc="center left", bbox_to_anchor=(1, 0.5), fontsize=8)
