"""What `rosa effort` prints: tables of what is counted, and under each the rule and what differs."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from missions.effort.counting import RULE
from missions.effort.survey import ModelEffort, Survey, TreeEffort

__all__ = ["print_survey"]

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
        _sources(found.models),
        "\n".join(_about_sources(found)),
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
        count = one.count
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
    return one.published == (one.count.entities, one.count.relations)


def _trees(trees: tuple[TreeEffort, ...]) -> Table:
    table = _table("managed by a tree", "nodes", "of the task", "left", "modes", "total", "published")
    for one in trees:
        count = one.count
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
    return one.published == (one.count.adaptation_nodes, one.count.modes)


def _sources(models: tuple[ModelEffort, ...]) -> Table:
    table = _table("statements / lines", "model: Python", "TypeQL", "task: tree", "PDDL")
    for one in models:
        pddl = "-" if one.pddl is None else f"{one.pddl}{' +' if one.is_declared else ''}"
        table.add_row(_short(one.name), str(one.python or "-"), str(one.typeql), str(one.tree or "-"), pddl)
    return table


def _about_sources(found: Survey) -> Iterator[str]:
    yield "no docstrings, imports, comments and blank lines; PDDL: lines only"
    if any(one.is_declared for one in found.models):
        yield "+ made of what the actions declare: nobody writes it"
    hand = found.by_hand
    if hand is not None:
        yield (
            f"by hand, for `--manager bt`: tree {hand.tree}, kinds of nodes {hand.kinds}, what ticks it {hand.rest}, "
            f"modes {hand.modes} lines"
        )


def _short(name: str) -> str:
    """Return a name without the folders of its files."""
    return escape(",".join(Path(part).name for part in name.split(",")))


def _law(found: Survey) -> str:
    on_it = sum(one.total == one.law for one in found.points)
    return (
        "linear law: 10 + 6 for each structural + 3 for each parameter adaptation of an action; "
        f"of {len(found.points)} generated models, {on_it} have just that"
    )
