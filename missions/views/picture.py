"""A finished run as one picture: where the robot went, what it measured, and how it adapted."""

import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from io import BytesIO
from itertools import pairwise, product
from typing import Any, Final

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.transforms import IdentityTransform

from missions.engine.runner import MissionRun
from missions.views.output import figure_in_words
from missions.views.timeline import Array, Events, RunTimeline, bare, brief, listed, panels_of, timeline_of

WIDTH, HEIGHT, DPI = 1600, 1200, 125  # [px], [px], [px/inch]
LEFT, RIGHT = 150, 1395  # ends of the time axis, where names are short [px]
LETTER = 9  # width of a letter of a name, about [px]
PANELS, LANE, EVENT, GAP = 320, 18, 26, 7  # heights of all signals, a bar, a row of events and between rows [px]
REACH = (0, 8, 18, 30, 45, 65, 90)  # how far from its place a label may go [px]
LINE = 1.22 * DPI / 72  # from one line of text to the next [px] for each point of its size
INK, MUTED, FAINT, ALARM, LIMIT = "#222222", "#666666", "#b5b5b5", "#d55e00", "#0f6b78"
BADGES: Final = {  # how the number of an adaptation looks: diameter [px], face, edge, digits
    "task": (25, INK, INK, "white"),
    "structural": (23, "white", INK, INK),
    "parameter": (20, "#e2e2e2", "#9a9a9a", INK),
}
DIAMOND: Final[dict[str, Any]] = {"marker": "D", "markersize": 4.5, "color": ALARM}
STAYS: Final[dict[str, Any]] = {"scalex": False, "scaley": False}
ROUND: Final[dict[str, Any]] = {"marker": "o", "linestyle": ""}
SIDES: Final = np.array([-1, 1])
LONELY_M: Final = 1.0  # so far from the way, a name is in nobody's way
CROWDED, CROWD_PX = 5, 40.0  # so many marks, so near to one of them [px], are told apart by a lens
CROWD: Final = 20  # of more places, only those that the way leads along are named
LONGEST, FACTS = 420, 3  # letters of a reason, and figures in the title, that there is room for; the JSON has all
PIXELS: Final = IdentityTransform()
TICKS = {"color": FAINT, "labelcolor": INK, "labelsize": 8, "major.size": 3}
STYLE: Final[dict[Any, Any]] = {
    **{"font.family": "DejaVu Sans", "font.size": 8.5, "text.color": INK, "text.parse_math": False},
    **{"axes.edgecolor": FAINT, "axes.linewidth": 0.7, "axes.labelpad": 1, "legend.frameon": False},
    **{f"{side}tick.{key}": value for side in "xy" for key, value in TICKS.items()},
}


def draw(run: MissionRun, data: Mapping[str, Any]) -> bytes:
    """Draw a finished run and its summary as PNG, 1600 x 1200 px; the same run gives the same bytes."""
    png = BytesIO()
    picture(run, data).savefig(png, format="png", dpi=DPI, metadata={"Software": None})
    return png.getvalue()


@rc_context(STYLE)
def picture(run: MissionRun, data: Mapping[str, Any]) -> Figure:
    """Return what `draw` writes: a map and the list of adaptations over lines of time."""
    figure = Figure(figsize=(WIDTH / DPI, HEIGHT / DPI), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    timeline, split = timeline_of(run, data), 12.0
    _title(figure, data, run)
    _legend(figure, timeline)
    top = _timelines(figure, timeline)
    if np.isfinite(timeline.xy).any():
        places = {name: np.asarray(points, dtype=float) for name, points in run.world.scenery().items() if len(points)}
        near = [points[[np.argmin(np.hypot(*(points - timeline.xy[0]).T))]] for points in places.values()]
        shown = np.vstack([timeline.xy, *near])
        is_listed = bool(timeline.adaptations or timeline.planned)
        split = _split(shown, top) if is_listed else 1420 if _is_ours(data) else WIDTH - 34
        _map(_axes(figure, 72, 106, split - 72, top - 162), timeline, places, shown)
    if _is_ours(data):  # how others adapt is not known, only what they switch
        _list(_axes(figure, split + 22, 106, WIDTH - split - 30, top - 120), timeline.planned, timeline.adaptations)
    return figure


def _split(shown: Array, top: float) -> float:
    """Return where the map ends and the list begins [px]: a map that is no wider than it need be leaves room."""
    wide, tall = np.ptp(shown, axis=0) + 3.0
    return float(np.clip(72 + (top - 162) * wide / tall * 1.15, 640, 960))


def _is_ours(data: Mapping[str, Any]) -> bool:
    return bool(data.get("manager", "ours") == "ours")


def _axes(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Add axes by their place in [px], counted from the upper left corner."""
    return figure.add_axes((left / WIDTH, 1 - (top + height) / HEIGHT, width / WIDTH, height / HEIGHT))


def _badge(axes: Axes, at: Array, number: int, kind: str) -> None:
    size, face, edge, digits = BADGES.get(kind, BADGES["parameter"])
    circle = Line2D(at[:1], at[1:], marker="o", markersize=size * 72 / DPI, markerfacecolor=face, markeredgecolor=edge)
    axes.add_artist(circle).set(transform=PIXELS, zorder=8, clip_on=False)
    digit = axes.text(at[0], at[1], str(number), ha="center", va="center_baseline", color=digits, fontsize=size / 3)
    digit.set(transform=PIXELS, zorder=9, fontweight="bold")


def _title(figure: Figure, data: Mapping[str, Any], run: MissionRun) -> None:
    task = {"bt": "behaviour tree", "pddl": "PDDL plans"}.get(data["task"], data["task"])
    if not _is_ours(data):
        task = f"manager: {data['manager']}"
    name = f"{data['mission']}  ·  {task}  ·  seed {data['seed']}"
    figure.text(0.015, 1 - 32 / HEIGHT, name, fontsize=13, fontweight="bold", va="center")
    facts = [f"{data['outcome'].replace('_', ' ')} after {data['duration_s']:.0f} s"]
    for key, value in list(run.results().items())[:FACTS]:
        words, unit, shown = figure_in_words(key, value, run.model)
        facts.append(" ".join(filter(None, (words, shown, unit))))
    figure.text(0.988, 1 - 32 / HEIGHT, "   ·   ".join(facts), fontsize=9.5, ha="right", va="center")


def _legend(figure: Figure, timeline: RunTimeline) -> None:
    styles: dict[str, dict[str, Any]] = {name: {"color": hue, "linewidth": 4} for name, hue in timeline.hues.items()}
    for kind in dict.fromkeys(one["kind"] for one in timeline.adaptations):
        size, face, edge, _ = BADGES.get(kind, BADGES["parameter"])
        styles[f"{kind} adaptation"] = {**ROUND, "ms": size * 0.42, "mfc": face, "mec": edge}
    if timeline.disturbances:
        styles["disturbance"] = {"linewidth": 1, "linestyle": "--", **DIAMOND}
    if timeline.completed:
        styles["completed"] = {**ROUND, "ms": 8, "color": MUTED, "mfc": "none", "mew": 1.6}
    entries = [Line2D([], [], label=label, **style) for label, style in styles.items()]
    letters = 9 * min(1.0, WIDTH / max(sum(78 + 9.4 * len(label) for label in styles), 1.0))
    columns = max(len(entries), 1)
    legend = figure.legend(handles=entries, loc="center left", ncols=columns, borderaxespad=0, fontsize=letters)
    legend.set_bbox_to_anchor((0.01, 1 - 76 / HEIGHT))


class _Room:
    """Finds room on a map, its axes, for what is written there, near what it names and off the path; in [px]."""

    def __init__(self, axes: Axes, xy: Array) -> None:
        self.axes, self._path = axes, axes.transData.transform(xy)
        self._taken: Array = np.empty((0, 2, 2))

    def keep_off(self, box: Array) -> None:
        """Write nothing in a box, given by its corners (2, 2)."""
        self._taken = np.vstack([self._taken, [box]])

    def hidden(self, box: Array, other: Array) -> float:
        """Return how much of the path a box would hide, and more if it would hide another one."""
        path = np.all((self._path > box[0]) & (self._path < box[1]), axis=1).sum()
        return float(path) + 1e6 * bool(np.all((box[0] < other[1]) & (other[0] < box[1])))

    def name(self, xy: Array, text: str, marker: str, size: float, color: str = INK) -> None:
        self.axes.plot(*xy, marker, color=color, markersize=size, zorder=6, mec="white", mew=0.7)
        x, y = self.lead(xy, 8.8 * len(text) + 4, 18)
        label = self.axes.text(x, y, text, ha="center", va="center", color=color)
        label.set(transform=PIXELS, zorder=7, path_effects=[withStroke(linewidth=2.5, foreground="white")])

    @property
    def scale(self) -> float:
        """How long a metre is [px]."""
        return float(np.ptp(self.axes.bbox.intervalx) / np.ptp(self.axes.get_xlim()))

    def note(self, xy: Array, text: str, color: str) -> None:
        x, y = self.lead(xy, LETTER * len(text) + 12, 24)
        label = self.axes.text(x, y, text, ha="center", va="center", fontsize=8)
        frame = {"boxstyle": "round,pad=0.25", "facecolor": "white", "edgecolor": color, "linewidth": 1.4}
        label.set(transform=PIXELS, zorder=7, bbox=frame)

    def lead(self, xy: Array, width: float, height: float) -> Array:
        """Take a box of a size near a point [m], draw a line from there to its edge, and return its centre."""
        anchor, half = self.axes.transData.transform(xy), np.array([width, height]) / 2
        turns = np.arange(0.25, 6.5, np.pi / 8)
        tries = [anchor + (half + 6 + far) * (np.cos(turn), np.sin(turn)) for far in REACH for turn in turns]
        centre = min(tries, key=lambda centre: self._cost(anchor, centre, half))
        self._taken = np.vstack([self._taken, [[centre - half, centre + half], [anchor - 5, anchor + 5]]])
        edge = centre + (anchor - centre) * min(1.0, *(half / np.maximum(np.abs(anchor - centre), 1e-9)))
        self.axes.plot(*np.stack([anchor, edge]).T, transform=PIXELS, color=MUTED, linewidth=0.8, zorder=5)
        return np.asarray(centre)

    def _cost(self, anchor: Array, centre: Array, half: Array) -> float:
        low, high, lead = centre - half - 2, centre + half + 2, np.linspace(anchor, centre, 9)[2:-1, None]
        hidden = np.all((self._path > low) & (self._path < high), axis=1).sum()
        met = np.all((low < self._taken[:, 1]) & (high > self._taken[:, 0]), axis=1).sum()
        crossed = np.all((lead > self._taken[:, 0]) & (lead < self._taken[:, 1]), axis=2).sum()
        outside = np.any((low < self.axes.bbox.min) | (high > self.axes.bbox.max))
        return float(np.hypot(*(centre - anchor)) + 5 * hidden + 20 * crossed + 300 * met + 1000 * outside)


def _map(axes: Axes, timeline: RunTimeline, places: Mapping[str, Array], shown: Array) -> None:
    box = axes.bbox.size
    half = np.ptp(shown, axis=0) * 0.55 + 0.8
    middle, half = (shown.min(axis=0) + shown.max(axis=0)) / 2, np.maximum(half, half[::-1] * box / box[::-1])
    axes.set(xlim=middle[0] + half[0] * SIDES, ylim=middle[1] + half[1] * SIDES, facecolor="#f6f9fb")
    axes.set(aspect="equal", xlabel="east x [m]", ylabel="north y [m]")
    _way(axes, timeline, places)
    room = _Room(axes, timeline.xy)
    marks = _marks(timeline, 1 / room.scale)
    crowd = _crowd(axes, [xy for _, xy in marks])
    if crowd is not None:
        lens = _lens(room, crowd)
        _way(lens, timeline, places)
        _mark(_Room(lens, timeline.xy), timeline, [one for one in marks if _is_within(crowd, one[1])])
        marks = [one for one in marks if not _is_within(crowd, one[1])]
    for name, points in places.items():
        inside = points[np.all(np.abs(points - middle) < half, axis=1)]
        lonely = [np.hypot(*(timeline.xy - point).T).min() for point in inside]
        if len(places) > CROWD and np.median(lonely) > LONELY_M:
            continue
        centred = -np.hypot(*(inside - inside[len(inside) // 2]).T)  # if the way leads along all of it
        named = inside[np.argmax(lonely if max(lonely) > LONELY_M else centred)]
        room.name(named, name, "" if len(points) > 1 else "s", 9)
    room.name(timeline.xy[0], "start", "o", 8)
    _choices(room, timeline)
    _mark(room, timeline, marks)


def _way(axes: Axes, timeline: RunTimeline, places: Mapping[str, Array]) -> None:
    links, hues = np.stack([timeline.xy[:-1], timeline.xy[1:]], axis=1), timeline.hues
    turns = np.cumsum([before != after for before, after in pairwise(timeline.actions)])
    lines = LineCollection(list(links), capstyle="round", zorder=4)
    lines.set(color=[hues.get(names.split(", ")[0], FAINT) for names in timeline.actions[:-1]])
    lines.set(linewidth=1.8 + 2.8 * (1 - turns / max([1, *turns[-1:]])))  # an earlier passage stays in sight below
    axes.add_collection(lines, autolim=False)
    for points in places.values():
        axes.plot(*points.T, color="#c9ced3", linewidth=10, solid_capstyle="round", zorder=2, **STAYS)


def _marks(timeline: RunTimeline, least_m: float) -> list[tuple[int | str, Array]]:
    """Return what is marked along the way, and where (2,) [m]: adaptations by their number, then times."""
    step = next(one for one in (5, 10, 30, 60, 120, 300, 600, 1800, 7200, 10**9) if timeline.end / one <= 10)
    marks: list[tuple[int | str, Array]] = []
    for number, one in enumerate(timeline.adaptations, start=1):
        marks.append((number, timeline.where(one["at_s"])))
    marked = timeline.xy[0]
    for time in range(step, int(timeline.times[-1]) + 1, step):
        if np.hypot(*(timeline.where(time) - marked)) > least_m:  # where it stands, one mark is enough
            marked = timeline.where(time)
            marks.append((f"{time} s", marked))
    return marks


def _mark(room: _Room, timeline: RunTimeline, marks: Sequence[tuple[int | str, Array]]) -> None:
    for what, xy in marks:
        if isinstance(what, int):
            kind = timeline.adaptations[what - 1]["kind"]
            size = BADGES.get(kind, BADGES["parameter"])[0]
            _badge(room.axes, room.lead(xy, size, size), what, kind)
        else:
            room.name(xy, what, "o", 4.5, MUTED)


def _crowd(axes: Axes, marked: Sequence[Array]) -> Array | None:
    """Return the corners (2, 2) [m] of where marks crowd so that a lens is needed to tell them apart, if they do."""
    at = axes.transData.transform(np.reshape(marked, (-1, 2)))
    near = np.hypot(*(at[:, None] - at[None]).T) < CROWD_PX
    if not len(at) or near.sum(axis=1).max() < CROWDED:
        return None
    inside = at[near[np.argmax(near.sum(axis=1))]]
    corners = np.stack([inside.min(axis=0) - CROWD_PX / 4, inside.max(axis=0) + CROWD_PX / 4])
    return np.asarray(axes.transData.inverted().transform(corners))


def _is_within(corners: Array, xy: Array) -> bool:
    return bool(np.all((corners[0] <= xy) & (xy <= corners[1])))


def _lens(room: _Room, corners: Array) -> Axes:
    """Return axes in the emptiest corner of a map that show a part of it larger."""
    axes, size = room.axes, np.array([0.4, 0.5])
    places = [np.array([x, y]) for x in (0.01, 0.99 - size[0]) for y in (0.01, 0.99 - size[1])]
    boxes = [axes.transAxes.transform(np.stack([place, place + size])) for place in places]
    chosen = min(range(4), key=lambda one: room.hidden(boxes[one], axes.transData.transform(corners)))
    lens = axes.inset_axes((*places[chosen], *size), facecolor="white", zorder=5)
    middle, half = corners.mean(axis=0), np.ptp(corners, axis=0) / 2
    shape = np.ptp(boxes[chosen], axis=0)
    half = np.maximum(half, half[::-1] * shape / shape[::-1])
    lens.set(xlim=middle[0] + half[0] * SIDES, ylim=middle[1] + half[1] * SIDES, xticks=[], yticks=[])
    axes.indicate_inset_zoom(lens, edgecolor=MUTED, zorder=4.5)
    room.keep_off(boxes[chosen])
    return lens


def _choices(room: _Room, timeline: RunTimeline) -> None:
    long = [leg for leg in timeline.legs if leg.length_m * room.scale > 0.8 * LETTER * len(leg.choice)]
    for leg in long if len({leg.choice for leg in long}) > 1 else []:
        room.note(leg.middle, leg.choice, timeline.hues[listed([leg.action])[0]])
    for action, time in timeline.completed:
        hue = timeline.hues.get(action, FAINT)
        room.axes.plot(*timeline.where(time), "o", color=hue, markersize=13, zorder=5.5, mfc="none", mew=2)


def _list(axes: Axes, planned: Events, adaptations: Events) -> None:
    """Write the plan, what set each adaptation off and what was changed, as large and as fully as there is room."""
    axes.set_axis_off()
    axes.set(xlim=(0, axes.bbox.width), ylim=(axes.bbox.height, 0))
    head = "adaptations: what set them off → what was changed" if adaptations else "no adaptation"
    entries = [*planned, *adaptations]
    axes.text(0, 0, head, fontsize=10, fontweight="bold", va="top")
    for size, full in (*product((10, 9, 8.5, 8, 7.5, 7), (True,)), *product((9, 8.5, 8, 7.5, 7, 6.5, 6), (False,))):
        line, left = size * LINE, 18 + size * 13
        texts = [_lines(one, full, (axes.bbox.width - left) / (0.47 * line)) for one in entries]
        starts = 32 + np.cumsum([0, *(line * (len(text) + 0.3) for text in texts)])
        if starts[-1] <= axes.bbox.height:
            break
    for index, (one, text, y) in enumerate(zip(entries, texts, starts, strict=False)):
        if starts[-1] > axes.bbox.height < starts[index + 1] + line:
            axes.text(left, y, f"… and {len(texts) - index} more", fontsize=size, color=MUTED, va="top")
            break
        if index >= len(planned):
            _badge(axes, axes.transData.transform((13, y + line * 0.8)), index + 1 - len(planned), one["kind"])
        axes.text(32, y, f"{one['at_s']:.1f} s", fontsize=size, fontweight="bold", va="top")
        axes.text(32, y + line, one["kind"], fontsize=size - 0.5, color=MUTED, va="top")
        for below, part in enumerate(text):
            axes.text(left, y + below * line, part, fontsize=size, va="top")


def _lines(one: Mapping[str, Any], full: bool, width: float) -> list[str]:
    reaction = one.get("reaction_s")
    how = one.get("found", "not in force") if reaction is None else f"in\u00a0{reaction:.2f}\u00a0s"
    why = re.sub(r" \(measured [^)]*\)", "", f": {one['reason']}") if full else ""
    texts = one["trigger"] + brief(why, LONGEST), f"-> {one['change']} [{how}]"
    return [part for text in texts for part in textwrap.wrap(brief(text, 500), int(width), subsequent_indent="    ")]


def _timelines(figure: Figure, timeline: RunTimeline) -> float:
    """Draw everything over time, one row above the other; return where the rows begin [px from the top]."""
    panels = panels_of(timeline)
    told = {"active action": timeline.actions, "design": timeline.designs, "configuration": timeline.configurations}
    lanes = {title: column for title, column in told.items() if listed(column)}
    limits = [label for name in panels for labels in timeline.limits.get(bare(name), {}).values() for label in labels]
    left, right = _margins(lanes, limits)
    others = [one for one in timeline.disturbances if not any(one["what"].startswith(bare(name)) for name in panels)]
    rows = [_events(timeline, "disturbances", others, 8.4, right - left)] if others else []
    most, each = PANELS, 150
    if not np.isfinite(timeline.xy).any():  # there is no map, and room for more than the list needs
        most, each = max(PANELS, 2 * PANELS - 60 * (len(timeline.planned) + len(timeline.adaptations))), 280
    tall = min(each, most // max(1, len(panels)))
    rows += [(tall, partial(_panel, timeline=timeline, names=[name, *others])) for name, others in panels.items()]
    rows += [_events(timeline, "adaptations", timeline.adaptations, 0, right - left)] if timeline.adaptations else []
    rows += [
        (LANE * len(listed(column)) + 4, partial(_bars, timeline=timeline, title=title, column=column))
        for title, column in lanes.items()
    ]
    start = top = HEIGHT - 46.0 - sum(height + GAP for height, _ in rows)
    for number, (height, show) in enumerate(rows, start=1):
        axes = _axes(figure, left, top, right - left, height)
        axes.set_xlim(0, timeline.end)
        show(axes)
        for one in timeline.adaptations:
            axes.axvline(one["at_s"], color="#999999", linewidth=0.7, zorder=1.5)
        for one in others:
            axes.axvline(one["at_s"], color=ALARM, linewidth=0.8, dashes=(4, 3), alpha=0.7, zorder=1.6)
        axes.tick_params(labelbottom=number == len(rows), bottom=number == len(rows))
        axes.set_xlabel("time [s]" if number == len(rows) else "")
        top += height + GAP
    return start


def _margins(lanes: Mapping[str, Sequence[str]], labels: Sequence[str]) -> tuple[float, float]:
    """Return where the time axis begins and ends [px], so that what stands beside it has room."""
    names = [len(brief(name)) for column in lanes.values() for name in listed(column)]
    beside = LETTER * max(map(len, labels), default=0)
    return max(LEFT, 16.0 + LETTER * max(names, default=0)), min(RIGHT, WIDTH - beside)


def _events(
    timeline: RunTimeline, title: str, events: Events, letter: float, wide: float
) -> tuple[int, Callable[[Axes], None]]:
    """Return the height [px] of a row of events, `wide` px long, and what draws it.

    A letter of their texts is `letter` px wide; 0 is for numbers instead.
    """
    ends: list[float] = []
    levels, sides = [], []
    for one in events:
        x, width = one["at_s"] / timeline.end * wide, 26 + letter * len(one.get("what", ""))
        sides.append("right" if letter and x + width > wide else "left")
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
            gap = timeline.end * (0.007 if side == "left" else -0.007)
            text = axes.text(one["at_s"] + gap, level, one["what"], color=ALARM, ha=side, va="center")
            text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0})

    return EVENT * len(ends), show


def _aside(axes: Axes, text: str, y: float, color: str = MUTED) -> None:
    axes.text(1.006, y, text, transform=axes.transAxes, va="center", color=color, fontsize=8)


def _bars(axes: Axes, timeline: RunTimeline, title: str, column: Sequence[str]) -> None:
    names = listed(column)
    axes.set(ylim=(len(names) - 0.45, -0.55))
    axes.set_yticks(range(len(names)), [brief(name) for name in names])
    axes.tick_params(left=False)
    _aside(axes, title, 0.5)
    for name, start, end in timeline.spans(column):
        hue = timeline.hues[name] if column is timeline.actions else "#7d8790"
        axes.barh(names.index(name), end - start, left=start, height=0.76, color=hue, zorder=2)


def _panel(axes: Axes, timeline: RunTimeline, names: list[str]) -> None:
    for name, start, end in timeline.spans(timeline.actions):
        axes.axvspan(start, end, color=timeline.hues[name], alpha=0.09, linewidth=0, zorder=0.5)
    for name, color, dashes in zip(names, (INK, "#7b3294", "#0f6b78"), ("-", "--", ":"), strict=False):
        line = axes.plot(timeline.times, timeline.signals[name], dashes, color=color, linewidth=1.5, zorder=4)[0]
        line.set(label=bare(name), drawstyle="default" if name == names[0] else "steps-post")
    limits = timeline.limits.get(bare(names[0]), {})
    axes.hlines(list(limits), 0, timeline.end, color=LIMIT, linewidth=1, linestyle=":", zorder=3)
    axes.margins(y=0.12)
    (low, high), height, half = axes.get_ylim(), 0.0, 8.5 / axes.bbox.height
    for value, labels in sorted(limits.items()):
        height = max(height + half * len(labels), (value - low) / (high - low))
        _aside(axes, "\n".join(labels), height, LIMIT)
        height += half * len(labels)
    for one in timeline.disturbances:
        if one["what"].startswith(bare(names[0])):
            height = np.interp(one["at_s"], timeline.times, timeline.signals[names[0]])
            axes.plot(one["at_s"], height, zorder=5, **DIAMOND)
    axes.set_ylabel(names[0].replace(" ", "\n"), rotation=0, ha="right", va="center", labelpad=6)
    if len(names) > 1:
        axes.legend(loc="center left", bbox_to_anchor=(1, 0.5), fontsize=8)
