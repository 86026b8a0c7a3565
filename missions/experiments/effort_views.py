"""What `rosa effort` prints and draws."""

from collections.abc import Iterable, Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from missions.experiments.effort import MOST_ADAPTATIONS, RULE, LawPoint, ModelEffort, Parts, Survey, TreeEffort, law

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH: Final = 160
"""Of what is no terminal [letters]."""

AGV: Final = (
    "agv: the vehicle's model, as in the paper; in the mission, each corridor of the building is an action of its own."
)
DIFFERS: Final = "* differs from the published count: nothing is fitted to it"
TREE_DIFFERS: Final = (
    "* nodes: the published tree is one of BehaviorTree.CPP, whose nodes also arm, abort and unground. Ours is of "
    "py_trees and the same for both missions, so that suave has the branch that recharges, too.\n"
    "* modes: recharging adds 8, as published; what the 2 more in each published count are is not known."
)


def print_survey(found: Survey) -> None:
    """Print it all."""
    console = Console(emoji=False, highlight=False, soft_wrap=False)
    if not console.is_terminal:
        console.width = WIDTH
    parts = [
        _models(found.models),
        "\n".join(_about_models(found.models)),
        *([_trees(found.trees), "\n".join(_about_trees(found.trees))] if found.trees else []),
        _law(found),
    ]
    for part in parts:
        if isinstance(part, str):
            console.print(f"{part}\n" if part else "", markup=False)
        else:
            console.print(part)


def _table(first: str, *columns: str) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column(first, no_wrap=True)
    for column in columns:
        table.add_column(column, justify="left" if "published" in column else "right", no_wrap=True)
    return table


def _models(models: tuple[ModelEffort, ...]) -> Table:
    table = _table("model", "entities", "relations", "total", "published")
    for one in models:
        count = one.counted
        published = "-" if one.published is None else f"{one.published}{'' if _is_published(one) else ' *'}"
        table.add_row(_short(one.name), str(count.entities), str(count.relations), str(count.total), published)
    return table


def _about_models(models: tuple[ModelEffort, ...]) -> Iterator[str]:
    yield from RULE
    if any(one.name == "agv" for one in models):
        yield AGV
    if any(one.published and not _is_published(one) for one in models):
        yield DIFFERS


def _is_published(one: ModelEffort) -> bool:
    return one.published == (one.counted.entities, one.counted.relations)


def _trees(trees: tuple[TreeEffort, ...]) -> Table:
    table = _table("managed by a tree", "nodes", "of the task", "left", "modes", "total", "published")
    for one in trees:
        count = one.counted
        task = f"{count.task_nodes}" if one.published_task is None else f"{count.task_nodes} ({one.published_task})"
        published = "-" if one.published is None else f"{one.published}{'' if _is_published_tree(one) else ' *'}"
        numbers = (count.adaptation_nodes, count.modes, count.total)
        table.add_row(_short(one.name), str(count.nodes), task, *map(str, numbers), published)
    return table


def _about_trees(trees: tuple[TreeEffort, ...]) -> Iterator[str]:
    yield "nodes: of the tree of `--manager bt`, less those of the mission's own, which has the task only (published)"
    yield "modes: each mode and each value in it, `active` too, of the functions whose component the mission has"
    if any(one.published and not _is_published_tree(one) for one in trees):
        yield TREE_DIFFERS


def _is_published_tree(one: TreeEffort) -> bool:
    return one.published == (one.counted.adaptation_nodes, one.counted.modes)


def _short(name: str) -> str:
    """Return a name without the folders of its files."""
    return escape(",".join(Path(part).name for part in name.split(",")))


def _law(found: Survey) -> str:
    on_it = sum(one.total == one.law for one in found.points)
    return (
        "linear law: 10 + 6 for each structural + 3 for each parameter adaptation of an action; "
        f"of {len(found.points)} generated models, {on_it} have just that"
    )


DPI: Final = 160  # [px/inch]
INK, MUTED, FAINT = "#222222", "#666666", "#b5b5b5"
MODEL_HUES, TREE_HUES = ("#0072b2", "#56b4e9"), ("#d55e00", "#e69f00")  # Okabe and Ito's, dark and light
BAR, GAP, HEADROOM = 0.38, 0.015, 1.45
HATCH: Final = "/////"
LEGENDS: Final = (
    ("model of ROSA", MODEL_HUES, ("entities", "relations")),
    ("tree that manages", TREE_HUES, ("nodes", "modes and values")),
)
STYLE: Final[dict[Any, Any]] = {
    **{"font.family": "DejaVu Sans", "font.size": 8.5, "text.color": INK, "text.parse_math": False},
    **{
        "axes.edgecolor": FAINT,
        "axes.labelcolor": INK,
        "axes.linewidth": 0.7,
        "axes.spines.top": False,
        "axes.spines.right": False,
    },
    **{"xtick.color": FAINT, "xtick.labelcolor": INK, "ytick.color": FAINT, "ytick.labelcolor": INK},
    **{
        "svg.hashsalt": "rosa",
        "legend.frameon": False,
        "legend.handlelength": 1.2,
        "legend.borderaxespad": 0,
        "hatch.linewidth": 0.6,
    },
}


class _Pair(NamedTuple):
    """Two bars side by side: ours and the published one, if there is one."""

    name: str
    ours: Parts
    published: Parts | None
    hues: tuple[str, str]


def draw(found: Survey, suffix: str = "png") -> bytes:
    """Return the picture as a file; the same survey gives the same bytes.

    Args:
        found: what was counted.
        suffix: "png" or "svg".
    """
    from matplotlib import rc_context

    content = BytesIO()
    with rc_context(STYLE):
        picture(found).savefig(
            content, format=suffix, metadata={"svg": {"Date": None}, "png": {"Software": None}}[suffix]
        )
    return content.getvalue()


def picture(found: Survey) -> "Figure":
    """Return what `draw` writes."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    pairs = [*_model_pairs(found), *_tree_pairs(found)]
    with rc_context(STYLE):
        left = max(3.2, 0.82 * len(pairs))
        drawing = Figure(figsize=(left + 4.0, 3.6), dpi=DPI, facecolor="white", layout="constrained")
        FigureCanvasAgg(drawing)
        sizes, scaling = drawing.subplots(1, 2, width_ratios=(left, 3.3))
        _draw_pairs(sizes, pairs)
        _draw_law(scaling, found.points)
    return drawing


def _model_pairs(found: Survey) -> Iterable[_Pair]:
    for one in found.models:
        yield _Pair(one.name, Parts(one.counted.entities, one.counted.relations), one.published, MODEL_HUES)


def _tree_pairs(found: Survey) -> Iterable[_Pair]:
    for one in found.trees:
        yield _Pair(one.name, Parts(one.counted.adaptation_nodes, one.counted.modes), one.published, TREE_HUES)


def _draw_pairs(axes: "Axes", pairs: Sequence[_Pair]) -> None:
    from matplotlib.patches import Patch

    for place, pair in enumerate(pairs):
        both = pair.published is not None
        _bar(axes, place - (BAR / 2 + GAP if both else 0), pair.ours, pair.hues, is_published=False)
        if pair.published is not None:
            _bar(axes, place + BAR / 2 + GAP, pair.published, pair.hues, is_published=True)
    axes.set_xticks(range(len(pairs)), [_broken(pair.name) for pair in pairs])
    axes.tick_params(axis="x", length=0)
    axes.margins(x=0.02)
    tallest = max(parts.total for pair in pairs for parts in (pair.ours, pair.published) if parts)
    axes.set_ylim(0, HEADROOM * max(tallest, 1))
    axes.set_ylabel("elements")
    axes.set_title("what is modelled", fontsize=9, loc="left")
    for title, hues, labels in LEGENDS:
        shown = [pair for pair in pairs if pair.hues == hues]
        patches = [Patch(color=hue, label=label) for hue, label in zip(hues, labels, strict=True)]
        if any(pair.published for pair in shown):
            patches.append(Patch(facecolor="white", edgecolor=hues[0], hatch=HATCH, linewidth=0.7, label="published"))
        if shown:
            legend = axes.legend(
                handles=patches, loc="upper left" if hues is MODEL_HUES else "upper right", title=title
            )
            legend.set_alignment("left")
            legend.get_title().set_fontweight("bold")
            axes.add_artist(legend)


def _bar(axes: "Axes", x: float, parts: Parts, hues: tuple[str, str], *, is_published: bool) -> None:
    """Draw a bar of two parts, with its numbers."""
    bottom = 0
    for height, hue, ink in zip(parts, hues, ("white", INK), strict=True):
        face, hatch = ("white", HATCH) if is_published else (hue, None)
        axes.bar(x, height, BAR, bottom=bottom, linewidth=0.7, facecolor=face, edgecolor=hue, hatch=hatch)
        middle = axes.text(x, bottom + height / 2, str(height or ""), ha="center", va="center", fontsize=7, color=ink)
        if is_published:
            middle.set(color=MUTED, bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8})
        bottom += height
    over = axes.annotate(str(bottom), (x, bottom), (0, 2), textcoords="offset points", ha="center")
    over.set(color=MUTED if is_published else INK, fontweight="normal" if is_published else "bold")


def _draw_law(axes: "Axes", points: Sequence[LawPoint]) -> None:
    steps = range(MOST_ADAPTATIONS + 1)
    series = (
        ("structural: 10 + 6 n", "#0072b2", "o", 1, 0),
        ("parameter: 10 + 3 n", "#009e73", "s", 0, 1),
        ("both: 10 + 9 n", "#cc79a7", "D", 1, 1),
    )
    totals = {(one.structural, one.parameter): one.total for one in points}
    for label, hue, marker, structural, parameter in series:
        axes.plot(steps, [law(structural * n, parameter * n) for n in steps], color=hue, linewidth=1.1, label=label)
        counted = [totals[structural * n, parameter * n] for n in steps]
        axes.plot(steps, counted, marker, color=hue, markersize=4.5, markeredgecolor="white", markeredgewidth=0.5)
    axes.plot([], [], "o", color=MUTED, markersize=4.5, label="generated model, counted")
    axes.set(ylim=(0, None), xlabel="adaptations of an action, n", ylabel="elements")
    axes.set_xticks(steps)
    axes.legend(loc="upper left")
    axes.set_title("how a model grows", fontsize=9, loc="left")


def _broken(name: str) -> str:
    """Return a name in lines short enough to stand beside others."""
    parts = [Path(part).name for part in name.split(",")]
    return "\n".join(parts).replace(":", ":\n").replace("_", "\n")
