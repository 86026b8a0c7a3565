"""The report on a campaign: our figures beside the published ones, and tests."""

import base64
import html
import re
from collections.abc import Mapping, Sequence
from io import BytesIO
from itertools import combinations, product
from pathlib import Path
from typing import Final

import numpy as np

from missions.baselines import OURS
from missions.engine.mission import MissionError
from missions.experiments.comparison import (
    SEARCH,
    Comparison,
    Values,
    comparisons,
    holm,
    mean_of,
)
from missions.experiments.results import Results
from missions.views.output import OutputFile, files_tried

CSS: Final = """
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
HEADLINES: Final = {SEARCH: "search time [s]", "distance_inspected_m": "distance inspected [m]"}
NONE = "-"
LEAST_RUNS: Final = 5
"""Fewer runs have no interval and are not compared: it would say nothing."""
METHOD: Final = (
    "Intervals: 95 %, Student's.",
    "Differences: of runs with the same seed, with the interval and p of Student's paired test; "
    "p is corrected by Holm's method for all tests of a table. "
    f"Fewer than {LEAST_RUNS} runs are not compared.",
    "A search that never succeeds counts as long as the mission, as in SUAVE.",
    "Published: the table of the ROSA paper, 100 runs each.",
)


class Document:
    """A Markdown document, built of headings, paragraphs, lists, tables and pictures in order."""

    def __init__(self, title: str) -> None:
        self.parts = [f"# {title}"]
        self.pictures: dict[str, bytes] = {}  # by the names of their files
        self._title = title

    def items(self, texts: Sequence[str]) -> None:
        """Add a list."""
        self.parts.append("\n".join(f"- {text}" for text in texts))

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Add a table without its empty columns; the first column names the rows."""
        full = [at for at in range(len(head)) if any(row[at] != NONE for row in rows)]
        marks = ["---", *["---:"] * (len(head) - 1)]
        lines = []
        for row in (head, marks, *rows):
            cells = [row[at].replace("|", "&#124;") for at in full]
            lines.append(f"| {' | '.join(cells)} |")
        self.parts.append("\n".join(lines))

    def picture(self, name: str, caption: str, drawn: bytes) -> None:
        """Add a picture (SVG); the HTML page embeds it."""
        self.parts.append(f"![{caption}]({name}.svg)")
        self.pictures[f"{name}.svg"] = drawn

    def as_markdown(self) -> str:
        """Return the document as text."""
        return "\n\n".join(self.parts) + "\n"

    def as_html(self) -> str:
        """Return the document as a web page that needs no other file."""
        from markdown_it import MarkdownIt

        body = MarkdownIt("commonmark", {"html": False}).enable("table").render(self.as_markdown())
        for name, picture in self.pictures.items():
            body = body.replace(
                f'src="{name}"',
                f'src="data:image/svg+xml;base64,{base64.b64encode(picture).decode()}"',
            )
        return (
            "<!DOCTYPE html>\n"
            '<html lang="en"><head>'
            '<meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{html.escape(self._title)}</title><style>{CSS}</style>"
            f"</head>\n<body>\n{body}</body></html>"
            "\n"
        )


def write_report(results: Results, folder: Path, *, figures: Sequence[str] = ()) -> list[Path]:
    """Write the report as report.md and report.html with pictures; return the files.

    Managers are compared by `figures`; by default the published ones, or else the first two.

    Raises:
        MissionError: no run is done, or no run has such a figure.
    """
    parts = comparisons(results)
    crashed = results.crashed
    name = results.campaign.name
    if not parts:
        raise MissionError(f"there is nothing to report of {name}: no run is done without a crash")
    existing = dict.fromkeys(figure for part in parts for figure in part.figures)
    for figure in figures:
        if figure not in existing:
            raise MissionError(f"no run has a figure {figure!r}; there are {', '.join(existing)}")
    document = Document(f"Campaign {name}")
    document.parts.append(
        f"{len(results.outcomes)} of {results.campaign.size} runs are done"
        f", {len(crashed)} of them crashed."
    )
    for comparison in parts:
        document.parts.append(f"## {comparison.title}")
        _add_comparison(document, comparison, figures)
    if crashed:
        document.parts.append("## Runs that crashed")
        document.items([f"{record['run']}: {record['error']}" for record in crashed])
        document.parts.append("\n".join(["```sh", *(record["rerun"] for record in crashed), "```"]))
    document.parts.append("## How it was computed")
    is_published = any(group.published for part in parts for group in part.groups)
    document.items(METHOD if is_published else METHOD[:2])
    texts = {"report.md": document.as_markdown(), "report.html": document.as_html()}
    with files_tried(f"make {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
    contents = {**document.pictures, **{name: text.encode() for name, text in texts.items()}}
    for file, content in contents.items():
        OutputFile(folder / file).finish(content)
    return [folder / file for file in contents]


def _add_comparison(document: Document, comparison: Comparison, asked: Sequence[str]) -> None:
    chosen = [name for name in asked or HEADLINES if name in comparison.figures]
    names = chosen or comparison.figures[:2]
    headlines = {name: HEADLINES.get(name, name) for name in names}
    _add_headlines(document, comparison, headlines)
    stem = re.sub(r"\W+", "_", comparison.title).strip("_")
    for name, label in headlines.items():
        caption = f"{label} under each manager, {comparison.title}"
        document.picture(f"{stem}_{name}", caption, distribution(comparison, name, label))
    if comparison.uncertainties:
        _add_reactions(document, comparison)
    _add_differences(document, comparison, headlines)
    document.parts.append("### All figures: mean ± standard deviation (runs)")
    figures = [name for name in comparison.figures if not name.startswith("reaction_")]
    rows = [
        [name, *(_spread([*group.values(name).values()]) for group in comparison.groups)]
        for name in figures
    ]
    document.table(["figure", *(group.label for group in comparison.groups)], rows)


def _add_headlines(
    document: Document, comparison: Comparison, headlines: Mapping[str, str]
) -> None:
    head = ["manager", "runs", "goal reached"]
    for label in headlines.values():
        head += [f"{label}: published", f"{label}: mean [95 %]", "sd"]
    rows = []
    for group in comparison.groups:
        row = [group.label, str(len(group.records)), str(group.successes)]
        for name in headlines:
            published = group.published.get(name)
            values = [*group.values(name).values()]
            sd = f"{np.std(values, ddof=1):.2f}" if len(values) >= LEAST_RUNS else NONE
            row += [
                f"{published[0]:.2f} ± {published[1]:.2f}" if published else NONE,
                _mean(values),
                sd,
            ]
        rows.append(row)
    document.table(head, rows)
    for group in comparison.groups:
        for name, value in group.inputs.items():
            document.parts.append(
                f"{group.label}: {name} = {value:g} is an input taken from the paper's own figures."
            )


def _add_reactions(document: Document, comparison: Comparison) -> None:
    document.parts.append("### Reaction times")
    rows = []
    for uncertainty, group in product(comparison.uncertainties, comparison.groups):
        delays = group.delays(uncertainty)
        if delays.size:
            published = group.published.get(uncertainty)
            rows.append(
                [
                    f"{uncertainty}, {group.label}",
                    str(delays.size),
                    f"{published[0]:.2f}" if published else NONE,
                    _mean(delays, ".3f"),
                    f"{delays.max():.3f}",
                ]
            )
    document.table(
        ["to, manager", "events", "published [s]", "mean [95 %] [s]", "longest [s]"], rows
    )


def _add_differences(
    document: Document, comparison: Comparison, headlines: Mapping[str, str]
) -> None:
    """Compare ours with each other manager, or else all pairs, by runs with one seed."""
    pairs = [(later, earlier) for earlier, later in combinations(comparison.groups, 2)]
    pairs = [pair for pair in pairs if OURS in (pair[0].manager, pair[1].manager)] or pairs
    rows = []
    ps = []
    for (name, label), (group, other) in product(headlines.items(), pairs):
        first = group.values(name)
        second = other.values(name)
        differences = [first[seed] - second[seed] for seed in first if seed in second]
        if len(differences) >= LEAST_RUNS:
            mean = mean_of(differences)
            ps.append(mean.p)
            title = f"{label}: {group.label} - {other.label}"
            rows.append([title, str(len(differences)), f"{mean:+.2f}"])
    if rows:
        for row, p in zip(rows, holm(ps), strict=True):
            row.append("< 0.001" if p < 0.001 else f"{p:.3f}")
        document.parts.append("### Differences")
        document.table(["figure: one - other", "pairs", "mean [95 %]", "p, corrected"], rows)


def _mean(values: Values, spec: str = ".2f") -> str:
    if not len(values):
        return NONE
    return format(mean_of(values) if len(values) >= LEAST_RUNS else np.mean(values), spec)


def _spread(values: Sequence[float]) -> str:
    sd = f" ± {np.std(values, ddof=1):.2f}" if len(values) > 1 else ""
    return f"{np.mean(values):.2f}{sd} ({len(values)})" if values else NONE


def distribution(comparison: Comparison, figure: str, label: str) -> bytes:
    """Draw a histogram of a figure for each manager, one above the other; return it as SVG."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    samples = [[*group.values(figure).values()] for group in comparison.groups]
    bins = np.histogram_bin_edges([value for sample in samples for value in sample] or [0.0], 40)
    with rc_context({"svg.hashsalt": "rosa", "font.size": 8.5, "text.parse_math": False}):
        height = 0.8 * len(samples) + 0.8
        drawing = Figure(figsize=(9.0, height), facecolor="white", layout="constrained")
        axes = drawing.subplots(len(samples), 1, sharex=True, squeeze=False)[:, 0]
        for cell, group, sample in zip(axes, comparison.groups, samples, strict=True):
            cell.hist(sample, bins=bins, color="#7d8790", histtype="stepfilled")
            cell.set(yticks=[])
            cell.set_ylabel(group.label, rotation=0, ha="right", va="center")
            cell.spines[["left", "top", "right"]].set_visible(False)
            if figure in group.published:
                mean, sd = group.published[figure]
                cell.errorbar(mean, 0, xerr=sd, fmt="D", color="#d55e00", capsize=3, clip_on=False)
        axes[-1].set_xlabel(f"{label}; orange: published mean ± sd")
        content = BytesIO()
        drawing.savefig(content, format="svg", metadata={"Date": None})  # the same bytes each time
        return content.getvalue()
