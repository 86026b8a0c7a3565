"""A finished run as one picture: where the robot went, what it measured, and how it adapted."""

import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby, product
from typing import Any, BinaryIO, Final

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import IdentityTransform
from numpy.typing import NDArray

from kb import Constraint
from missions.runner import MissionRun

__all__ = ["draw", "picture"]

Array = NDArray[np.float64]
WIDTH, HEIGHT, DPI = 1600, 1200, 125  # [px], [px], [px/inch]
LEFT, RIGHT = 150, 1425  # ends of the time axis [px]
PANEL, LANE, ROW = 104, 18, 25  # heights of a signal, of a bar and of a row of events [px]
STYLE: Final[dict[Any, Any]] = {"font.family": "DejaVu Sans", "font.size": 8.5, "text.parse_math": False}
INK, MUTED, FAINT, ALARM = "#222222", "#666666", "#b5b5b5", "#d55e00"
HUES = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#8c6d31", "#b8ac00")  # Okabe and Ito, but the alarm's
TASKS = {"bt": "behaviour tree", "pddl": "PDDL plans"}
BADGES: Final = {  # how the number of an adaptation looks: diameter [px], face, edge, digits
    "task": (25, INK, INK, "white"),
    "structural": (23, "white", INK, INK),
    "parameter": (19, "#e2e2e2", "#9a9a9a", INK),
}


@dataclass(frozen=True)
class _Seen:
    """What was seen, as columns of n samples.

    Attributes:
        end: of the time axis [s].
        times: (n,) [s].
        xy: (n, 2) [m], world frame, x east, y north.
        actions, configurations: n each, names joined by commas.
        signals: (n,) each, the unit in the name; NaN where there was none.

    """

    end: float
    times: Array
    xy: Array
    actions: list[str]
    configurations: list[str]
    signals: dict[str, Array]


def draw(run: MissionRun, data: Mapping[str, Any], out: BinaryIO) -> None:
    """Write the picture of a finished run as PNG, 1600 x 1200 px; the same run gives the same bytes.

    Args:
        run: the run, ended.
        data: what `report.summary` returned for it.
        out: a file that is open for writing bytes.

    """
    with rc_context(STYLE):
        FigureCanvasAgg(picture(run, data)).print_png(out, metadata={"Software": None})


def picture(run: MissionRun, data: Mapping[str, Any]) -> Figure:
    """Return the picture that `draw` writes: a map and the list of adaptations over lines of time.

    Args:
        run: the run, ended.
        data: what `report.summary` returned for it.

    """
    figure = Figure(figsize=(WIDTH / DPI, HEIGHT / DPI), dpi=DPI, facecolor="white")
    seen, adaptations = _columns(run, float(data["duration_s"])), data["adaptations"]
    hues = {name: HUES[index % len(HUES)] for index, name in enumerate(_names(seen.actions))}
    _title(figure, data, run.world.results())
    _legend(figure, hues, adaptations, data["disturbances"])
    top = _timelines(figure, seen, data, run.kb.model.constraints, hues)
    split = 40
    if len(seen.times):
        split = 950 if len(adaptations) > 4 else 1100
        _map(_axes(figure, 75, 108, split - 75, top - 175), seen, run.world.scenery(), adaptations, hues)
    _list(_axes(figure, split + 25, 108, WIDTH - split - 45, top - 145), adaptations)
    return figure


def _columns(run: MissionRun, end: float) -> _Seen:
    samples = [sample for sample, _, _ in run.trace.samples]
    signals = dict.fromkeys(name for sample in samples for name in sample.signals)
    return _Seen(
        end,
        np.array([sample.time for sample in samples], dtype=float),
        np.array([sample.position[:2] for sample in samples], dtype=float).reshape(-1, 2),
        [action for _, action, _ in run.trace.samples],
        [configuration for _, _, configuration in run.trace.samples],
        {name: np.array([one.signals.get(name, np.nan) for one in samples], dtype=float) for name in signals},
    )


def _names(column: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(name for names in column for name in names.split(", ") if name))


def _spans(seen: _Seen, column: Sequence[str]) -> Iterator[tuple[str, float, float]]:
    """Yield each name of a column with the times from and to which it stood there [s]."""
    edges = np.append(seen.times, seen.end)
    for names, group in groupby(range(len(column)), key=lambda index: column[index]):
        held = list(group)
        for name in _names([names]):
            yield name, float(edges[held[0]]), float(edges[held[-1] + 1])


def _axes(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Add axes by their place in [px], counted from the upper left corner."""
    axes = figure.add_axes((left / WIDTH, 1 - (top + height) / HEIGHT, width / WIDTH, height / HEIGHT))
    axes.tick_params(length=3, width=0.6, color=FAINT, labelcolor=INK, labelsize=8)
    axes.spines[:].set(color=FAINT, linewidth=0.7)
    return axes


def _tidy(text: str) -> str:
    """Shorten numbers and arrows."""
    return re.sub(r"\d+\.\d{4,}", lambda found: f"{float(found[0]):.3g}", text).replace("->", "→").replace(">=", "≥")


def _badge(axes: Axes, x: float, y: float, number: int, kind: str) -> None:
    """Put the number of an adaptation at a pixel of the figure."""
    size, face, edge, digits = BADGES.get(kind, BADGES["parameter"])
    pixels = IdentityTransform()
    circle = Line2D([x], [y], marker="o", markersize=size * 72 / DPI, markerfacecolor=face, markeredgecolor=edge)
    axes.add_artist(circle).set(transform=pixels, zorder=8, clip_on=False, markeredgewidth=1.2)
    style = {"fontsize": 0.39 * size * 72 / DPI * 1.5, "fontweight": "bold", "color": digits, "zorder": 9}
    axes.text(x, y, str(number), transform=pixels, ha="center", va="center_baseline", **style)
