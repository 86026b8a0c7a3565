"""The pictures of a report, and the style of all of them; the same data gives the same bytes."""

from collections.abc import Sequence
from io import BytesIO
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from missions.experiments.comparison import Comparison, Group
from missions.experiments.statistics import Array, two_clusters

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH, ROW, EDGES, DPI = 9.0, 0.8, 1.1, 130  # [inch], [inch], [inch], [px/inch]
INK, MUTED, FAINT = "#222222", "#666666", "#b5b5b5"
EARLY, LATE, PLAIN, PAPER = "#0072b2", "#e69f00", "#7d8790", "#d55e00"
CLUSTERS: Final = (("earlier cluster", EARLY), ("later cluster", LATE), ("never found", PLAIN))
BINS, LOG_BINS = 40, 36
STYLE: Final[dict[Any, Any]] = {
    **{"font.family": "DejaVu Sans", "font.size": 8.5, "text.color": INK, "text.parse_math": False},
    **{"axes.edgecolor": FAINT, "axes.linewidth": 0.7, "axes.spines.top": False, "axes.spines.right": False},
    **{"axes.titlesize": 9, "axes.titlelocation": "left", "hatch.linewidth": 0.6},
    **{"figure.constrained_layout.w_pad": 0.1},
    **{"svg.hashsalt": "rosa", "legend.frameon": False, "legend.handlelength": 1.2, "legend.borderaxespad": 0},
}


def distribution(comparison: Comparison, figure: str, label: str, *, clusters: bool) -> dict[str, bytes]:
    """Draw a histogram of a figure for each manager, one above the other; returns it by suffix: "png", "svg".

    Of search times two clusters are shown, and apart those that never succeeded.
    """
    from matplotlib import rc_context

    samples = {group: group.values(figure)[1] for group in comparison.groups}
    ends = [end for values in samples.values() if values.size for end in (values.min(), values.max())] or [0.0]
    bins = np.linspace(min(ends), max(ends) + (max(ends) == min(ends)), BINS + 1).tolist()
    with rc_context(STYLE):
        drawing, axes = _rows(len(samples), 1)
        for row, (group, values) in zip(axes[:, 0], samples.items(), strict=True):
            _name(row, group.label, len(values))
            if clusters:
                _stack(row, values, group.searches, bins)
            else:
                row.hist(values, bins=bins, color=PLAIN)
            _mark(row, group.published.figures.get(figure))
        axes[-1, 0].set_xlabel(label)
        _explain(drawing, comparison.groups, CLUSTERS if clusters else (), "published mean ± sd")
        return {suffix: written(drawing, suffix) for suffix in ("png", "svg")}


def reaction_histograms(comparison: Comparison) -> dict[str, bytes]:
    """Draw how soon each manager reacted to each uncertainty, over a logarithmic axis [s]; returns it by suffix."""
    from matplotlib import rc_context

    names = comparison.uncertainties
    groups = [group for group in comparison.groups if any(group.of("delay", name).size for name in names)]
    found = [group.of("delay", name) for group in groups for name in names if group.of("delay", name).size]
    least = max(min(float(delays.min()) for delays in found), 1e-3)
    bins = np.geomspace(least * 0.9, max(least, *(delays.max() for delays in found)) * 1.1, LOG_BINS + 1).tolist()
    with rc_context(STYLE):
        drawing, axes = _rows(len(groups), len(names))
        for row, group in zip(axes, groups, strict=True):
            for cell, name in zip(row, names, strict=True):
                delays = group.of("delay", name)
                cell.set(xscale="log")
                _name(cell, group.label if cell is row[0] else "", len(delays))
                cell.hist(np.maximum(delays, least), bins=bins, color=PLAIN)
                published = group.published.reactions_s.get(name)
                _mark(cell, None if published is None else (published, 0.0))
                cell.xaxis.set_major_formatter("{x:g}")
                cell.xaxis.set_minor_formatter("")
        for cell, name in zip(axes[-1], names, strict=True):
            cell.set_xlabel(f"reaction to {name} [s]")
        _explain(drawing, groups, (), "published mean" + (" ± sd" if len(names) == 1 else ""))
        return {suffix: written(drawing, suffix) for suffix in ("png", "svg")}


def written(drawing: "Figure", suffix: str) -> bytes:
    """Return a picture as a file, "png" or "svg", without the time and the versions that made it."""
    content, metadata = BytesIO(), {"png": {"Software": None}, "svg": {"Date": None}}
    drawing.savefig(content, format=suffix, metadata=metadata[suffix])
    return content.getvalue()


def _rows(rows: int, columns: int) -> "tuple[Figure, Any]":
    drawing = blank(WIDTH, rows * ROW + EDGES)
    return drawing, drawing.subplots(rows, columns, sharex=True, squeeze=False)


def blank(width: float, height: float) -> "Figure":
    """Return an empty picture of a width and a height [inch]."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(width, height), dpi=DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(drawing)
    return drawing


def _name(axes: "Axes", label: str, count: int) -> None:
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.set_ylabel(label, rotation=0, ha="right", va="center")
    axes.text(1, 1, f"n = {count}", transform=axes.transAxes, ha="right", va="bottom", color=MUTED, fontsize=7.5)


def _stack(axes: "Axes", values: Array, searches: Array, bins: Sequence[float]) -> None:
    """Draw the two clusters of those searches that succeeded, and apart from them the others."""
    found = two_clusters(searches)
    if found is None:
        axes.hist(values, bins=bins, color=PLAIN)
        return
    parts = [searches[searches < found.cut], searches[searches > found.cut]]
    others = np.full(len(values) - len(searches), values.max())
    axes.hist([*parts, others], bins=bins, color=[EARLY, LATE, PLAIN], stacked=True)
    axes.margins(y=0.35)
    for mean, share, color in ((found.low, found.share_low, EARLY), (found.high, 1 - found.share_low, LATE)):
        text = axes.text(mean, 0.99, f"{share:.0%} around {mean:.0f}", transform=axes.get_xaxis_transform())
        text.set(ha="center", va="top", color=color, fontsize=7.5, fontweight="bold")


def _mark(axes: "Axes", published: tuple[float, float] | None) -> None:
    """Mark a published mean, and one standard deviation to both sides."""
    if published is not None:
        bar = axes.errorbar(published[0], 0, xerr=published[1] or None, fmt="D", color=PAPER, markersize=4.5, capsize=3)
        bar[0].set(clip_on=False, zorder=6)


def _explain(drawing: "Figure", groups: Sequence[Group], colors: Sequence[tuple[str, str]], mark: str) -> None:
    from matplotlib.lines import Line2D

    entries = [Line2D([], [], color=color, linewidth=5, label=name) for name, color in colors]
    if any(group.published.figures for group in groups):
        entries.append(Line2D([], [], color=PAPER, marker="D", markersize=4.5, linestyle="", label=mark))
    if any(group.inputs for group in groups):
        entries.append(Line2D([], [], linestyle="", label="* figures of the paper are put in"))
    if entries:
        drawing.legend(handles=entries, loc="outside upper left", ncols=len(entries), columnspacing=1.4)
