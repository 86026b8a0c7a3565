"""The report on a campaign: our figures beside the published ones, tests, distributions and reaction times."""

import base64
import html
import re
from collections.abc import Mapping, Sequence
from io import BytesIO
from itertools import combinations, product
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from missions.baselines import OURS
from missions.engine.mission import MissionError
from missions.experiments.campaign import Kept, PlannedRun
from missions.experiments.comparison import (
    SEARCH,
    Array,
    Comparison,
    Group,
    comparisons,
    holm,
    interval_of_mean,
    interval_of_sd,
    paired,
    two_clusters,
)
from missions.views.output import OutputFile, files_tried

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


CSS = """
:root {
  color-scheme: light dark;
  --line: light-dark(#d3d9e0, #2c353e); --panel: light-dark(#ffffff, #151a1f);
  --ink: light-dark(#171c21, #e4e9ed); --muted: light-dark(#525d68, #a0acb8);
  --accent: light-dark(#0b5cad, #79b8ff);
}
body {
  font: 14px/1.45 system-ui, "DejaVu Sans", sans-serif; font-variant-numeric: tabular-nums;
  color: var(--ink); background: light-dark(#eceff2, #0d1114);
  max-width: 76rem; margin: 1rem auto; padding: 0 1rem; overflow-wrap: anywhere;
}
h1 { font-size: 20px; } h2 { font-size: 15px; margin-top: 2rem; } a { color: var(--accent); }
table {
  display: block; overflow-x: auto; border-collapse: collapse; margin: 1rem 0; padding: 8px;
  background: var(--panel); border: 1px solid var(--line); border-radius: 7px;
}
th, td { border-bottom: 1px solid var(--line); padding: .25rem .7rem; text-align: right; }
th { color: var(--muted); font-weight: 600; } th:first-child, td:first-child { text-align: left; }
img { max-width: 100%; background: #ffffff; border: 1px solid var(--line); border-radius: 7px; }
code { font-family: ui-monospace, "DejaVu Sans Mono", monospace; font-size: 12px; }
"""
"""The look of the page of a run, see `missions/views/page/src/theme.css`."""


class Document:
    """A Markdown document, built of headings, paragraphs, lists, tables and figures in order."""

    def __init__(self, title: str) -> None:
        self._title, self._parts = title, [f"# {title}"]
        self.pictures: dict[str, bytes] = {}  # by the names of their files

    def heading(self, text: str, level: int = 2) -> None:
        self._parts.append(f"{'#' * level} {text}")

    def text(self, text: str) -> None:
        self._parts.append(text)

    def items(self, texts: Sequence[str]) -> None:
        self._parts.append("\n".join(f"- {text}" for text in texts))

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Add a table without its empty columns; the first column names the rows."""
        full = [at for at in range(len(head)) if at == 0 or any(row[at] != NONE for row in rows)]
        head, rows = [head[at] for at in full], [[row[at] for at in full] for row in rows]
        marks = ["---", *["---:"] * (len(head) - 1)]
        lines = [
            f"| {' | '.join(cell.replace('|', '&#124;') for cell in row)} |"
            for row in (head, marks, *rows)
        ]
        self._parts.append("\n".join(lines))

    def figure(self, name: str, caption: str, drawn: bytes) -> None:
        """Add a picture (SVG); the HTML page embeds it."""
        self._parts.append(f"![{caption}]({name}.svg)")
        self.pictures[f"{name}.svg"] = drawn

    def as_markdown(self) -> str:
        return "\n\n".join(self._parts) + "\n"

    def as_html(self) -> str:
        """Return the document as a web page that needs no other file."""
        from markdown_it import MarkdownIt

        body = MarkdownIt("commonmark", {"html": False}).enable("table").render(self.as_markdown())
        for name in [one for one in self.pictures if one.endswith(".svg")]:
            data = f"data:image/svg+xml;base64,{base64.b64encode(self.pictures[name]).decode()}"
            body = body.replace(f'src="{name}"', f'src="{data}"')
        head = (
            '<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{html.escape(self._title)}</title><style>{CSS}</style>"
        )
        return (
            f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head>\n<body>\n{body}</body></html>\n'
        )


HEADLINES = {SEARCH: "search time [s]", "distance_inspected_m": "distance inspected [m]"}
NONE = "-"
LEAST_PAIRS = 5
"""Fewer pairs of runs are not compared: their interval would say nothing."""
CLEAR = 3.5
"""Two clusters are clear above this separation, which the halves of a uniform distribution have."""


def write_report(
    kept: Kept, folder: Path, *, pages: bool = False, figures: Sequence[str] = ()
) -> list[Path]:
    """Write the report on a campaign as report.md and report.html with their pictures, and return the files.

    With `pages`, the runs that stand out are done again, and each gets a page to click through. Managers are compared
    by `figures`; by default the published ones, or else the first two.

    Raises:
        MissionError: no run is done, or no run has such a figure.
    """
    parts, crashed = comparisons(kept), kept.crashed
    if not parts:
        ended = f"all of its {len(crashed)} runs crashed" if crashed else "none of its runs is done"
        raise MissionError(f"there is nothing to report of {kept.campaign.name}: {ended}")
    known = dict.fromkeys(name for one in parts for name in one.figures)
    for name in figures:
        if name not in known:
            raise MissionError(f"no run has a figure {name!r}; there are {', '.join(known)}")
    document = Document(f"Campaign {kept.campaign.name}")
    _introduce(document, kept, len(crashed))
    for comparison in parts:
        document.heading(comparison.title)
        _add_comparison(document, comparison, _headlines(comparison, figures))
    if pages:
        _add_standouts(document, parts, figures)
    _add_crashes(document, crashed)
    _add_method(document, searches=any(map(_is_search, parts)))
    texts = {
        "report.md": document.as_markdown().encode(),
        "report.html": document.as_html().encode(),
    }
    with files_tried(f"make {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
    contents = {**document.pictures, **texts}
    for name, content in contents.items():
        OutputFile(folder / name).finish(content)
    return [folder / name for name in contents]


def _introduce(document: Document, kept: Kept, crashed: int) -> None:
    total, done = kept.campaign.size, len(kept.done())
    document.text(
        f"{done} of {total} runs are done, {crashed} of them crashed. "
        f"Made by {', '.join(f'{name} {version}' for name, version in kept.provenance.items())}."
    )
    if done < total:
        document.text(
            f"{total - done} runs are still to be done: what follows is of those that are done."
        )


def _headlines(comparison: Comparison, asked: Sequence[str]) -> Mapping[str, str]:
    """Return the figures by which managers are compared, each with its label."""
    names = [
        name for name in asked or HEADLINES if name in comparison.figures
    ] or comparison.figures[:2]
    return {name: HEADLINES.get(name, name) for name in names}


def _add_comparison(
    document: Document, comparison: Comparison, headlines: Mapping[str, str]
) -> None:
    stem = re.sub(r"\W+", "_", comparison.title).strip("_")
    _add_headlines(document, comparison, headlines)
    for name, label in headlines.items():
        document.heading(f"Distribution: {label}", 3)
        if name == SEARCH:
            _add_clusters(document, comparison)
        drawn = distribution(comparison, name, label, clusters=name == SEARCH)
        document.figure(f"{stem}_{name}", f"{label} under each manager, {comparison.title}", drawn)
    if comparison.uncertainties:
        _add_reactions(document, comparison)
        caption = f"reaction times, {comparison.title}"
        document.figure(f"{stem}_reactions", caption, reaction_histograms(comparison))
    _add_contrasts(document, comparison, headlines)
    _add_all(document, comparison)


def _add_headlines(
    document: Document, comparison: Comparison, headlines: Mapping[str, str]
) -> None:
    head = ["manager", "runs", "goal reached"]
    for label in headlines.values():
        head += [f"{label}: published", f"{label}: mean [95 %]", "sd [95 %]"]
    found = _is_search(comparison)
    rows = []
    for group in comparison.groups:
        row = [group.label, str(group.runs), NONE if found else str(group.successes)]
        for name in headlines:
            published, (_, values) = group.published.figures.get(name), group.values(name)
            row += [
                f"{published[0]:.2f} ± {published[1]:.2f}" if published else NONE,
                *_estimates(values),
            ]
        rows.append([*row, str(group.not_found)] if found else row)
    document.table([*head, "never found"] if found else head, rows)
    for group in comparison.groups:
        if group.inputs:
            given = ", ".join(f"{name} = {value:g}" for name, value in group.inputs.items())
            source = "is an input taken from the paper's own figures"
            document.text(
                f"{group.label}: {given} {source}; its reaction times are reproduced, not predicted."
            )


def _is_search(comparison: Comparison) -> bool:
    return SEARCH in comparison.figures or any(group.not_found for group in comparison.groups)


def _add_clusters(document: Document, comparison: Comparison) -> None:
    rows = []
    for group in comparison.groups:
        found = two_clusters(group.searches)
        if found is None:
            rows.append([group.label, *[NONE] * 4])
            continue
        parts = (
            f"{found.low:.0f} ({found.share_low:.0%})",
            f"{found.high:.0f} ({1 - found.share_low:.0%})",
        )
        clear = "clear" if found.separation > CLEAR else "not clear"
        rows.append([group.label, *parts, f"{found.cut:.1f}", f"{found.separation:.1f}, {clear}"])
    document.table(
        ["manager", "earlier cluster, mean (share)", "later cluster", "cut", "separation"], rows
    )


def _add_reactions(document: Document, comparison: Comparison) -> None:
    document.heading("Reaction times", 3)
    document.text(
        "Delay is simulated time: periods of monitors and managers, ticks, switching. Computing is time of the machine "
        "that ran it, measured apart."
    )
    rows = []
    for uncertainty, group in product(comparison.uncertainties, comparison.groups):
        if (delays := group.of("delay", uncertainty)).size:
            thought = group.of("thought", uncertainty)
            published = group.published.reactions_s.get(uncertainty)
            shown = NONE if published is None else f"{published:.2f}"
            found = _mean(delays, ".3f"), f"{np.median(delays):.3f}", f"{delays.max():.3f}"
            computing = f"{1000 * fmean(thought):.2f}" if thought.size else NONE
            rows.append(
                [f"{uncertainty}, {group.label}", str(len(delays)), shown, *found, computing]
            )
    head = [
        "to, manager",
        "events",
        "published mean [s]",
        "delay, mean [95 %] [s]",
        "median",
        "longest",
    ]
    document.table([*head, "computing, mean [ms]"], rows)


def _add_contrasts(
    document: Document, comparison: Comparison, headlines: Mapping[str, str]
) -> None:
    """Compare ours with each other manager, or, without ours, all pairs, by runs with the same seed."""
    pairs = [(later, earlier) for earlier, later in combinations(comparison.groups, 2)][::-1]
    pairs = [pair for pair in pairs if OURS in (pair[0].manager, pair[1].manager)] or pairs
    rows = []
    ps = []
    for name, label in headlines.items():
        for group, other in pairs:
            seeds, first = group.values(name)
            others, second = other.values(name)
            both, ours, theirs = np.intersect1d(
                seeds, others, assume_unique=True, return_indices=True
            )
            if both.size >= LEAST_PAIRS:
                difference, p = paired(first[ours], second[theirs])
                ps.append(p)
                title = f"{label}: {group.label} - {other.label}"
                rows.append([title, str(both.size), difference.shown("+.2f")])
    if not rows:
        return
    document.heading("Differences", 3)
    for row, p in zip(rows, holm(ps), strict=True):
        row.append("< 0.001" if p < 0.001 else f"{p:.3f}")
    head = ["figure: one - other", "pairs", "mean difference [95 %]", "p, corrected"]
    document.table(head, rows)


def _add_all(document: Document, comparison: Comparison) -> None:
    document.heading("All figures", 3)
    document.text(
        "Mean ± standard deviation; with the number of runs, where not all of them have the figure."
    )
    figures = [name for name in comparison.figures if not name.startswith("reaction_")]
    rows = [
        [key, *(_mean_sd(group.values(key)[1], group.runs) for group in comparison.groups)]
        for key in figures
    ]
    document.table(["figure", *(group.label for group in comparison.groups)], rows)


def _add_standouts(document: Document, parts: Sequence[Comparison], figures: Sequence[str]) -> None:
    """Add a page of the runs with the lowest and the highest figure of each group, with links."""
    from missions.views.recorder import RunRecorder
    from missions.views.report import report

    document.heading("Runs that stand out")
    links = []
    for comparison, group in [(one, group) for one in parts for group in one.groups]:
        figure = next(
            (name for name in _headlines(comparison, figures) if group.values(name)[1].size), ""
        )
        seeds, values = group.values(figure)
        for word, choose in (("lowest", np.argmin), ("highest", np.argmax)) if values.size else ():
            at, settings = choose(values), comparison.settings
            run = PlannedRun(
                comparison.mission, group.manager, group.task, int(seeds[at]), (*settings.items(),)
            )
            opened = run.open()
            page = RunRecorder(opened, run.seed, settings)
            page.end(opened.run())
            name = re.sub(r"\W+", "_", run.name) + ".html"
            document.pictures[name] = report(page.recorder.recorded).encode()
            links.append(
                f"[{run.name}]({name}): {figure} {values[at]:.2f}, the {word} of {group.label}"
            )
    document.items(list(dict.fromkeys(links)))


def _add_crashes(document: Document, crashed: Sequence[Mapping[str, Any]]) -> None:
    if crashed:
        document.heading("Runs that crashed")
        document.items([f"{record['run']}: {record['error']}" for record in crashed])
        document.text("Each can be run again alone; the campaign's file has their tracebacks:")
        document.text("\n".join(["```sh", *(record["rerun"] for record in crashed), "```"]))


def _add_method(document: Document, *, searches: bool) -> None:
    document.heading("How it was computed")
    said = [
        "Intervals: 95 %, percentiles of 10,000 bootstrap resamples, or of a normal distribution for more than 10,000 "
        "values.",
        "Differences: of runs with the same seed, with the interval and p of Student's paired test; p is corrected by "
        f"Holm's method for all tests of one table. Fewer than {LEAST_PAIRS} pairs are not compared.",
    ]
    of_searches = [
        "A search that never succeeds counts as long as the mission, as in SUAVE; clusters are of those that did.",
        "Two clusters: the cut that leaves the least variance within the parts. Separation is the distance of "
        f"their means over the root of the mean of their variances; clear above {CLEAR}, that of an even spread.",
        "Published: the table of the ROSA paper, 100 runs each.",
    ]
    document.items([*said, *(of_searches if searches else [])])


def _estimates(values: Array) -> list[str]:
    sd = interval_of_sd(values, _chance()).shown(".2f") if values.size > 1 else NONE
    return [_mean(values, ".2f") if values.size else NONE, sd]


def _mean(values: Array, format_: str) -> str:
    return interval_of_mean(values, _chance()).shown(format_)


def _mean_sd(values: Array, runs: int) -> str:
    if not (n := values.size):
        return NONE
    return (
        f"{values.mean():.2f}"
        + (f" ± {values.std(ddof=1):.2f}" if n > 1 else "")
        + f" ({n})" * (n < runs)
    )


def _chance() -> np.random.Generator:
    """Return a generator with a fixed seed for one estimate, so that a report is always the same to the byte."""
    return np.random.default_rng(0)


WIDTH, ROW, EDGES = 9.0, 0.8, 1.1  # [inch]
INK, MUTED, FAINT = "#222222", "#666666", "#b5b5b5"
EARLY, LATE, PLAIN, PAPER = "#0072b2", "#e69f00", "#7d8790", "#d55e00"
CLUSTERS: Final = {"earlier cluster": EARLY, "later cluster": LATE, "never found": PLAIN}
BINS, LOG_BINS = 40, 36
STYLE: Final[dict[Any, Any]] = {
    **{"font.family": "DejaVu Sans", "font.size": 8.5, "text.color": INK, "text.parse_math": False},
    **{
        "axes.edgecolor": FAINT,
        "axes.linewidth": 0.7,
        "axes.spines.top": False,
        "axes.spines.right": False,
    },
    **{"axes.titlesize": 9, "axes.titlelocation": "left", "hatch.linewidth": 0.6},
    **{"figure.constrained_layout.w_pad": 0.1},
    **{
        "svg.hashsalt": "rosa",
        "legend.frameon": False,
        "legend.handlelength": 1.2,
        "legend.borderaxespad": 0,
    },
}

Rows = Mapping[Group, Sequence[tuple[Array, tuple[float, float] | None]]]
"""By manager, the cells of its row: values, and the published mean and standard deviation if there are any."""


def distribution(comparison: Comparison, figure: str, label: str, *, clusters: bool) -> bytes:
    """Draw a histogram of a figure for each manager, one above the other; return it as SVG.

    With `clusters`, for search times, show two clusters, and apart from them the runs that never found anything.
    """
    rows = {
        one: [(one.values(figure)[1], one.published.figures.get(figure))]
        for one in comparison.groups
    }
    found = np.concatenate([values for cells in rows.values() for values, _ in cells])
    low, high = (found.min(), found.max()) if found.size else (0.0, 0.0)
    bins = np.linspace(low, high + (high == low), BINS + 1).tolist()
    return _drawn(rows, [label], bins, CLUSTERS if clusters else {}, "published mean ± sd")


def reaction_histograms(comparison: Comparison) -> bytes:
    """Draw the reaction times of each manager to each uncertainty over a logarithmic axis [s]; return it as SVG."""
    names, rows = comparison.uncertainties, {}
    for group in comparison.groups:
        means = (group.published.reactions_s.get(name) for name in names)
        paper = [None if mean is None else (mean, 0.0) for mean in means]
        delays = [np.maximum(group.of("delay", name), 1e-3) for name in names]
        if any(one.size for one in delays):
            rows[group] = list(zip(delays, paper, strict=True))
    found = np.concatenate([delays for cells in rows.values() for delays, _ in cells])
    bins = np.geomspace(found.min() * 0.9, found.max() * 1.1, LOG_BINS + 1).tolist()
    return _drawn(
        rows, [f"reaction to {name} [s]" for name in names], bins, {}, "published mean", scale="log"
    )


def _drawn(
    rows: Rows,
    labels: Sequence[str],
    bins: list[float],
    clusters: Mapping[str, str],
    mark: str,
    scale: str = "linear",
) -> bytes:
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        size = WIDTH, len(rows) * ROW + EDGES
        drawing = Figure(figsize=size, facecolor="white", layout="constrained")
        axes = drawing.subplots(len(rows), len(labels), sharex=True, squeeze=False)
        for row, (group, cells) in zip(axes, rows.items(), strict=True):
            row[0].set_ylabel(group.label, rotation=0, ha="right", va="center")
            for cell, (values, published) in zip(row, cells, strict=True):
                cell.set(xscale=scale, yticks=[])
                cell.spines["left"].set_visible(False)
                count = {"ha": "right", "va": "bottom", "color": MUTED, "fontsize": 7.5}
                cell.text(1, 1, f"n = {len(values)}", transform=cell.transAxes, **count)
                if not (clusters and _stack(cell, values, group.searches, bins)):
                    cell.hist(values, bins=bins, color=PLAIN, histtype="stepfilled")
                if published is not None:
                    bar = {"fmt": "D", "color": PAPER, "markersize": 4.5, "capsize": 3}
                    point, *_ = cell.errorbar(published[0], 0, xerr=published[1] or None, **bar)
                    point.set(clip_on=False, zorder=6)
                if scale == "log":
                    cell.xaxis.set_major_formatter("{x:g}")
                    cell.xaxis.set_minor_formatter("")
        for cell, label in zip(axes[-1], labels, strict=True):
            cell.set_xlabel(label)
        _explain(drawing, list(rows), clusters, mark)
        content = BytesIO()
        drawing.savefig(content, format="svg", metadata={"Date": None})  # the same bytes each time
        return content.getvalue()


def _stack(axes: "Axes", values: Array, searches: Array, bins: list[float]) -> bool:
    """Draw two clusters of the searches that succeeded, and the others apart; False if there are not two."""
    found = two_clusters(searches)
    if found is None:
        return False
    parts = [searches[searches < found.cut], searches[searches > found.cut]]
    others = np.full(len(values) - len(searches), values.max())
    axes.hist(
        [*parts, others], bins=bins, color=[EARLY, LATE, PLAIN], stacked=True, histtype="stepfilled"
    )
    axes.margins(y=0.35)
    for mean, share, color in (
        (found.low, found.share_low, EARLY),
        (found.high, 1 - found.share_low, LATE),
    ):
        text = axes.text(
            mean, 0.99, f"{share:.0%} around {mean:.0f}", transform=axes.get_xaxis_transform()
        )
        text.set(ha="center", va="top", color=color, fontsize=7.5, fontweight="bold")
    return True


def _explain(
    drawing: "Figure", groups: Sequence[Group], clusters: Mapping[str, str], mark: str
) -> None:
    from matplotlib.lines import Line2D

    entries = [
        Line2D([], [], color=color, linewidth=5, label=name) for name, color in clusters.items()
    ]
    if any(group.published.figures for group in groups):
        entries.append(
            Line2D([], [], color=PAPER, marker="D", markersize=4.5, linestyle="", label=mark)
        )
    if any(group.inputs for group in groups):
        entries.append(Line2D([], [], linestyle="", label="* figures of the paper are put in"))
    if entries:
        drawing.legend(
            handles=entries, loc="outside upper left", ncols=len(entries), columnspacing=1.4
        )
