"""What `rosa effort` prints and draws."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from missions.experiments.effort import MOST_ADAPTATIONS, RULE, LawPoint, ModelEffort, Parts, Survey, TreeEffort, law
from missions.experiments.figures import INK, MUTED, STYLE, blank, written

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH: Final = 160
"""Of what is no terminal [letters]."""

AGV: Final = (
    "agv: the vehicle's model, as in the paper; in the mission, each corridor of the building is an action of its own."
)
DIFFERS: Final = "* differs from the published count: nothing is fitted to it"
TREES: Final = (
    "nodes: of the tree of `--manager bt`, less those of the mission's own, which has the task only (published)\n"
    "modes: each mode and each value in it, `active` too, of the functions whose component the mission has"
)
TREES_DIFFER: Final = (
    "* nodes: the published tree is one of BehaviorTree.CPP, whose nodes also arm, abort and unground. Ours is of "
    "py_trees and the same for both missions, so that suave has the branch that recharges, too.\n"
    "* modes: recharging adds 8, as published; what the 2 more in each published count are is not known."
)
LAW: Final = "linear law: 10 + 6 for each structural + 3 for each parameter adaptation of an action"


def print_survey(found: Survey) -> None:
    """Print it all."""
    console = Console(emoji=False, highlight=False, soft_wrap=False)
    if not console.is_terminal:
        console.width = WIDTH
    about = [*RULE, *([AGV] if any(one.name == "agv" for one in found.models) else [])]
    _print_table(console, _models(found.models), about, DIFFERS)
    if found.trees:
        _print_table(console, _trees(found.trees), [TREES], TREES_DIFFER)
    on_it = sum(one.total == one.law for one in found.points)
    console.print(f"{LAW}; of {len(found.points)} generated models, {on_it} have just that\n", markup=False)


def _print_table(console: Console, rows: list[list[str]], about: list[str], differs: str) -> None:
    table = Table(box=None, pad_edge=False)
    head, *body = rows
    for number, column in enumerate(head):
        table.add_column(column, justify="left" if number in (0, len(head) - 1) else "right", no_wrap=True)
    for row in body:
        table.add_row(*row)
    console.print(table)
    console.print("\n".join([*about, *([differs] if any(row[-1].endswith("*") for row in body) else [])]), markup=False)
    console.print()


def _models(models: tuple[ModelEffort, ...]) -> list[list[str]]:
    rows = [["model", "entities", "relations", "total", "published"]]
    for one in models:
        numbers = one.counted.entities, one.counted.relations
        rows.append([_short(one.name), *map(str, (*numbers, one.counted.total)), _published(one, numbers)])
    return rows


def _trees(trees: tuple[TreeEffort, ...]) -> list[list[str]]:
    rows = [["managed by a tree", "nodes", "of the task", "left", "modes", "total", "published"]]
    for one in trees:
        numbers = one.counted.adaptation_nodes, one.counted.modes
        task = f"{one.counted.task_nodes}" + ("" if one.published_task is None else f" ({one.published_task})")
        left = map(str, (*numbers, one.counted.total))
        rows.append([_short(one.name), str(one.counted.nodes), task, *left, _published(one, numbers)])
    return rows


def _published(one: ModelEffort | TreeEffort, counted: tuple[int, int]) -> str:
    if one.published is None:
        return "-"
    return str(one.published) if one.published == counted else f"{one.published} *"


def _short(name: str) -> str:
    """Return a name without the folders of its files."""
    return escape(",".join(Path(part).name for part in name.split(",")))


BAR, GAP, HEADROOM, HATCH = 0.38, 0.015, 1.45, "/////"


class _Bars(NamedTuple):
    """Bars of two parts each: ours, and the published ones where there are any."""

    title: str
    parts: tuple[str, str]
    hues: tuple[str, str]  # Okabe and Ito's, dark and light
    ours: Mapping[str, Parts]
    published: Mapping[str, Parts | None]


def picture(found: Survey) -> "Figure":
    """Draw how large models and trees are, and how a generated model grows."""
    from matplotlib import rc_context

    models = {one.name: Parts(one.counted.entities, one.counted.relations) for one in found.models}
    trees = {one.name: Parts(one.counted.adaptation_nodes, one.counted.modes) for one in found.trees}
    titles = ("model of ROSA", ("entities", "relations")), ("tree that manages", ("nodes", "modes and values"))
    hues = ("#0072b2", "#56b4e9"), ("#d55e00", "#e69f00")
    both = (
        _Bars(*titles[0], hues[0], models, {one.name: one.published for one in found.models}),
        _Bars(*titles[1], hues[1], trees, {one.name: one.published for one in found.trees}),
    )
    with rc_context(STYLE):
        left = max(3.2, 0.82 * (len(models) + len(trees)))
        drawing = blank(left + 4.0, 3.6)
        sizes, scaling = drawing.subplots(1, 2, width_ratios=(left, 3.3))
        _draw_sizes(sizes, [one for one in both if one.ours])
        _draw_law(scaling, found.points)
    return drawing


def draw(found: Survey, suffix: str = "png") -> bytes:
    """Return the picture as a file, "png" or "svg"."""
    from matplotlib import rc_context

    with rc_context(STYLE):
        return written(picture(found), suffix)


def _draw_sizes(axes: "Axes", every: Sequence[_Bars]) -> None:
    from matplotlib.patches import Patch

    names = [(bars, name) for bars in every for name in bars.ours]
    for place, (bars, name) in enumerate(names):
        published = bars.published[name]
        _bar(axes, place - (BAR / 2 + GAP if published else 0), bars.ours[name], bars.hues, is_published=False)
        if published is not None:
            _bar(axes, place + BAR / 2 + GAP, published, bars.hues, is_published=True)
    axes.set_xticks(range(len(names)), [_broken(name) for _, name in names])
    axes.tick_params(axis="x", length=0)
    axes.margins(x=0.02)
    tallest = max(one.total for bars in every for one in (*bars.ours.values(), *bars.published.values()) if one)
    axes.set(ylim=(0, HEADROOM * max(tallest, 1)), ylabel="elements", title="what is modelled")
    for bars in every:
        patches = [Patch(color=hue, label=label) for hue, label in zip(bars.hues, bars.parts, strict=True)]
        if any(bars.published.values()):
            patches.append(Patch(facecolor="white", edgecolor=bars.hues[0], hatch=HATCH, label="published"))
        corner = 2 if bars is every[0] else 1  # upper left, upper right
        legend = axes.legend(handles=patches, loc=corner, title=bars.title, alignment="left")
        legend.get_title().set_fontweight("bold")
        axes.add_artist(legend)


def _bar(axes: "Axes", x: float, parts: Parts, hues: tuple[str, str], *, is_published: bool) -> None:
    """Draw a bar of two parts, with its numbers."""
    bottom, back = 0, {"facecolor": "white", "edgecolor": "none", "pad": 0.8} if is_published else None
    for height, hue, ink in zip(parts, hues, ("white", INK), strict=True):
        face, hatch = ("white", HATCH) if is_published else (hue, None)
        bar = axes.bar(x, height, BAR, bottom=bottom, linewidth=0.7, facecolor=face, edgecolor=hue, hatch=hatch)
        color = MUTED if is_published else ink
        axes.bar_label(bar, [str(height or "")], label_type="center", fontsize=7, color=color, bbox=back)
        bottom += height
    weight, color = ("normal", MUTED) if is_published else ("bold", INK)
    axes.bar_label(bar, [str(bottom)], padding=2, fontweight=weight, color=color)


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
    axes.set(ylim=(0, None), xlabel="adaptations of an action, n", ylabel="elements", title="how a model grows")
    axes.set_xticks(steps)
    axes.legend(loc="upper left")


def _broken(name: str) -> str:
    """Return a name in lines short enough to stand beside others."""
    parts = [Path(part).name for part in name.split(",")]
    return "\n".join(parts).replace(":", ":\n").replace("_", "\n")
