"""The size of models, counted as in the ROSA paper (Silva et al., section on development effort).

One rule gives the published counts of all four models: each entity and each relation in TypeDB counts one. As TypeQL, a
model has a statement for each.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, Final

from py_trees.behaviour import Behaviour

from kb import KnowledgeBase, Model
from kb.files import SUFFIXES
from missions.agv.model import agv_model
from missions.baselines import open_run
from missions.baselines.manager import BaselineRun
from missions.baselines.modes import FUNCTIONS, TreeManager
from missions.engine.mission import MISSIONS, Mission, MissionError, Percepts, built, find_mission
from missions.suave.world import SEA

RULE: Final = (
    "entities: actions, functions, components, attributes, parameter values (each key of each configuration)",
    "relations: functional requirements (one for each action), function designs, component configurations, "
    "constraints (one that is shared counts once), estimations",
)
"""What is counted, in two lines."""

MOST_ADAPTATIONS: Final = 6
"""Generated models have up to this many adaptations of each kind."""

MODELS: Final = {"suave": (18, 12), "suave_extended": (22, 16), "agv": (18, 36), "uav": (24, 16)}
"""Published: numbers of entities and relations of each model."""

TREES: Final = {"suave": (27, 30), "suave_extended": (34, 38)}
"""Published, for the tree of the manager `bt`: nodes without those of the task, and modes with parameters."""

TASK_NODES: Final = {"suave": 10, "suave_extended": 16}
"""Published: nodes of the tree with the task only, which are subtracted."""

AS_PUBLISHED: Final = {"agv": agv_model}
"""Missions whose model has more than the published one, each with the model that is counted instead."""


def law(structural: int, parameter: int) -> int:
    """Return the published number of elements for one action with this many adaptations."""
    return 10 + 6 * structural + 3 * parameter


def count(model: Model) -> dict[str, Any]:
    """Count the entities and relations of a model, by kind and in total, without the initial facts."""
    entities = {
        "actions": len(model.actions),
        "functions": len(model.functions),
        "components": len(model.components),
        "attributes": len(model.attributes),
        "parameter values": sum(len(one.parameters) for one in model.configurations.values()),
    }
    relations = {
        "functional requirements": sum(bool(one.functions) for one in model.actions.values()),
        "function designs": len(model.designs),
        "component configurations": len(model.configurations),
        "constraints": len(model.constraints),
        "estimations": len(model.estimations),
    }
    first, second = sum(entities.values()), sum(relations.values())
    totals = {"entities": first, "relations": second, "total": first + second}
    return {**totals, "of_entities": entities, "of_relations": relations}


def generated_model(structural: int, parameter: int, actions: int = 1) -> Model:
    """Make the smallest model with these numbers of adaptations of each action (Silva et al., assumptions 1 and 2).

    Each action requires a function of its own, with one design of one component with one configuration. A structural
    adaptation is one more such design, a parameter adaptation one more configuration of the first component. Every
    design and every configuration has a priority and a constraint; every component a package, an executable and one
    parameter. All constraints are on the one quality attribute, which all actions share.

    Raises:
        MissionError: a number is too small.
    """
    for name, number, least in (
        ("structural", structural, 0),
        ("parameter", parameter, 0),
        ("actions", actions, 1),
    ):
        if number < least:
            raise MissionError(
                f"{name} is {number}; a generated model takes a whole number from {least}"
            )
    model = Model("generated")
    quality = model.quality_attribute("quality")
    for one in range(1, actions + 1):
        function = model.function(f"function_{one}")
        for design in range(1, structural + 2):
            name = f"{one}_{design}"
            component = model.component(
                f"node_{name}", kind="process", package="nodes", executable=f"node_{name}"
            )
            function.design(
                f"design_{name}", [component], priority=design, constraints=[quality >= 1 / design]
            )
            for number in range(1, parameter + 2 if design == 1 else 2):
                as_ = f"node_{name}_as_{number}"
                component.configuration(
                    as_, {"value": number}, priority=number, constraints=[quality >= 1 / number]
                )
        model.action(f"action_{one}", requires=[function])
    return model


def survey(names: Iterable[str] = ()) -> dict[str, Any]:
    """Count missions and model files, trees of missions that the manager `bt` can run, and generated models.

    Args:
        names: missions of the registry or given as module:NAME, and files of models (.tql, .owl), those of one model
            joined by commas; by default all missions of the registry.

    Returns:
        Plain data; `published` is None if the paper has no such count.

    Raises:
        MissionError, KnowledgeBaseError, RosaPddlError: one is unknown, or cannot be read or built.
    """
    asked = dict.fromkeys(names) or dict.fromkeys(MISSIONS)
    found = {
        name: None if Path(name).suffix.lower() in SUFFIXES else find_mission(name)
        for name in asked
    }
    made = {
        name: _model(name, one) if one else Model.load(name.split(","))
        for name, one in found.items()
    }
    models, trees = [], []
    for name, one in found.items():
        paper = _published(MODELS, name, "entities", "relations")
        models.append({"name": name, **count(made[name]), "published": paper})
        if one is not None and one.world is SEA:
            paper, own = _published(TREES, name, "nodes", "modes"), TASK_NODES.get(name)
            trees.append(
                {"name": name, **count_tree(one), "published_task_nodes": own, "published": paper}
            )
    points = [
        {
            "structural": one,
            "parameter": two,
            "total": count(generated_model(one, two))["total"],
            "law": law(one, two),
        }
        for one, two in product(range(MOST_ADAPTATIONS + 1), repeat=2)
    ]
    return {"rule": RULE, "models": models, "trees": trees, "generated": points}


def _published(
    table: Mapping[str, tuple[int, int]], name: str, *keys: str
) -> dict[str, int] | None:
    parts = table.get(name)
    return parts and {**dict(zip(keys, parts, strict=True)), "total": sum(parts)}


def count_tree(mission: Mission) -> dict[str, int]:
    """Count the nodes and modes of the tree that the manager `bt` builds for a mission in the sea.

    `nodes` is of the whole tree, `task_nodes` of the mission's own tree, which has the task only; `modes` counts modes
    and the values in them, for functions whose component the mission has; `total` is all without the task.
    """
    run = open_run(mission, manager=TreeManager)
    assert isinstance(run, BaselineRun)
    try:
        tree = TreeManager(run.robot).root
    finally:
        run.world.close()
    model = _model(mission.name, mission)
    given = KnowledgeBase(model), Percepts()
    task = built(f"the tree of {mission.name}", Behaviour, mission.tree, *given)  # type: ignore[type-abstract,arg-type]  # only for isinstance; each mission in the sea has one
    needed = [
        modes.values() for component, modes in FUNCTIONS.values() if component in model.components
    ]
    modes = sum(
        2 + len(mode.parameters) for means in needed for mode in means
    )  # itself, `active`, and each value
    nodes, task_nodes = (sum(1 for _ in root.iterate()) for root in (tree, task))
    return {
        "nodes": nodes,
        "task_nodes": task_nodes,
        "modes": modes,
        "total": nodes - task_nodes + modes,
    }


def _model(name: str, mission: Mission) -> Model:
    return built(f"the model of {name}", Model, AS_PUBLISHED.get(name, mission.model))


AGV: Final = "agv: the vehicle's model, as in the paper; in the mission, each corridor of the building is an action of its own."
DIFFERS: Final = "* differs from the published count: nothing is fitted to it"
TREE_RULE: Final = (
    "nodes: of the tree of `--manager bt`, less those of the mission's own, which has the task only (published)\n"
    "modes: each mode and each value in it, `active` too, of the functions whose component the mission has"
)
TREES_DIFFER: Final = (
    "* nodes: the published tree is one of BehaviorTree.CPP, whose nodes also arm, abort and unground. Ours is of "
    "py_trees and the same for both missions, so that suave has the branch that recharges, too.\n"
    "* modes: recharging adds 8, as published; what the 2 more in each published count are is not known."
)


def lines_of(found: Mapping[str, Any]) -> Iterator[str]:
    """Yield a survey as lines for people: a table of models, one of trees, and the law."""
    about = [*RULE, *([AGV] if any(one["name"] == "agv" for one in found["models"]) else [])]
    rows = [["model", "entities", "relations", "total", "published"]]
    for one in found["models"]:
        rows.append([_short(one["name"]), *_numbers(one, one["entities"], one["relations"])])
    yield from _table(rows, about, DIFFERS)
    rows = [["managed by a tree", "nodes", "of the task", "left", "modes", "total", "published"]]
    for one in found["trees"]:
        published = (
            "" if one["published_task_nodes"] is None else f" ({one['published_task_nodes']})"
        )
        numbers = _numbers(one, one["nodes"] - one["task_nodes"], one["modes"])
        rows.append(
            [_short(one["name"]), str(one["nodes"]), f"{one['task_nodes']}{published}", *numbers]
        )
    if found["trees"]:
        yield from _table(rows, [TREE_RULE], TREES_DIFFER)
    points = found["generated"]
    on_it = sum(one["total"] == one["law"] for one in points)
    law_in_words = (
        "linear law: 10 + 6 for each structural + 3 for each parameter adaptation of an action"
    )
    yield f"{law_in_words}; of {len(points)} generated models, {on_it} have just that\n"


def _numbers(one: Mapping[str, Any], *parts: int) -> list[str]:
    """Return two parts, their sum, and what is published of them, with a star if that differs."""
    shown = "-"
    if published := one["published"]:
        *theirs, total = published.values()
        shown = f"{theirs[0]} + {theirs[1]} = {total}{'' if theirs == [*parts] else ' *'}"
    return [*map(str, (*parts, one["total"])), shown]


def _table(rows: Sequence[Sequence[str]], about: Sequence[str], differs: str) -> Iterator[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for name, *numbers, published in rows:
        shown = [number.rjust(width) for number, width in zip(numbers, widths[1:-1], strict=True)]
        yield "  ".join([name.ljust(widths[0]), *shown, published])
    yield from (*about, *([differs] if any(row[-1].endswith("*") for row in rows) else []), "")


def _short(name: str) -> str:
    return ",".join(Path(part).name for part in name.split(","))
