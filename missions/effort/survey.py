"""Everything that is counted of a mission or a model file, beside what is published."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from kb import Model, UnknownName
from kb.files import SUFFIXES, read_text
from missions.agv.model import agv_model
from missions.effort import published
from missions.effort.baseline import ByHand, TreeCount, by_hand, count_tree, is_managed_by_tree
from missions.effort.counting import RULE, Count, count
from missions.effort.generated import generated_model
from missions.effort.source import Written, built, code_lines, python_written, typeql_written
from missions.engine.mission import Mission, MissionError
from missions.engine.registry import MISSIONS, find_mission
from missions.planning.declared import declarations_of
from rosa_pddl import DeclaredProblem

__all__ = ["LawPoint", "ModelEffort", "Survey", "TreeEffort", "as_data", "survey"]

AS_PUBLISHED: Final[Mapping[str, Callable[[], Model]]] = MappingProxyType({"agv": agv_model})
"""Missions whose model holds more than the published one, and what is counted for them."""

MOST_ADAPTATIONS: Final = 6
"""Generated models have up to that many adaptations of each kind."""


@dataclass(frozen=True, slots=True)
class ModelEffort:
    """What is counted of a model.

    Attributes:
        name: as it was given.
        count: its elements.
        published: entities and relations of the paper's; None if it has none.
        python: its source; None if it is a file.
        typeql: the same as TypeQL.
        tree: the source of the mission's tree.
        pddl: lines of the mission's domain and problem; None if it has none.
        is_declared: whether that PDDL is made of what the actions declare, so that nobody writes it.
    """

    name: str
    count: Count
    published: published.Parts | None
    typeql: Written
    python: Written | None = None
    tree: Written | None = None
    pddl: int | None = None
    is_declared: bool = False


@dataclass(frozen=True, slots=True)
class TreeEffort:
    """What is counted of the tree that manages a mission.

    Attributes:
        name: of the mission, as it was given.
        count: its nodes and modes.
        published: nodes without the task's, and modes, of the paper's; None if it has none.
        published_task: nodes of the paper's tree with the task only.
    """

    name: str
    count: TreeCount
    published: published.Parts | None
    published_task: int | None


@dataclass(frozen=True, slots=True)
class LawPoint:
    """A generated model of one action.

    Attributes:
        structural: its structural adaptations.
        parameter: its parameter adaptations.
        total: elements, as counted.
        law: elements, as the published law says.
    """

    structural: int
    parameter: int
    total: int
    law: int


@dataclass(frozen=True, slots=True)
class Survey:
    """All that is counted.

    Attributes:
        models: in the order in which they were asked for.
        trees: of those missions that the manager `bt` can run.
        by_hand: what was written for that manager; None if there is no such mission.
        points: generated models with up to `MOST_ADAPTATIONS` of each kind.
    """

    models: tuple[ModelEffort, ...]
    trees: tuple[TreeEffort, ...]
    by_hand: ByHand | None
    points: tuple[LawPoint, ...]


def survey(names: Iterable[str] = ()) -> Survey:
    """Count missions and model files.

    Args:
        names: missions of the registry or given as module:NAME, and files of models (.tql, .owl), those of one model
            joined by commas; by default all missions of the registry.

    Raises:
        MissionError, KnowledgeBaseError, RosaPddlError: one is unknown, or cannot be read or built.
    """
    asked = dict.fromkeys(names) or dict.fromkeys(MISSIONS)
    found = {name: None if Path(name).suffix.lower() in SUFFIXES else _mission(name) for name in asked}
    models = [_of_mission(name, mission) if mission else _of_file(name) for name, mission in found.items()]
    trees = [_tree(name, one) for name, one in found.items() if one is not None and is_managed_by_tree(one)]
    steps = range(MOST_ADAPTATIONS + 1)
    points = [
        LawPoint(
            structural,
            parameter,
            count(generated_model(structural, parameter)).total,
            published.law(structural, parameter),
        )
        for structural in steps
        for parameter in steps
    ]
    return Survey(tuple(models), tuple(trees), by_hand() if trees else None, tuple(points))


def as_data(found: Survey) -> dict[str, Any]:
    """Return it as data for JSON."""
    return {
        "rule": RULE,
        "models": [_model_data(one) for one in found.models],
        "trees": [
            {
                "name": one.name,
                "nodes": one.count.nodes,
                "task_nodes": one.count.task_nodes,
                "modes": one.count.modes,
                "total": one.count.total,
                "published": _parts_data(one.published, "nodes", "modes"),
                "published_task_nodes": one.published_task,
            }
            for one in found.trees
        ],
        "by_hand": found.by_hand
        and {
            **{part: getattr(found.by_hand, part)._asdict() for part in ("tree", "kinds", "rest")},
            "modes_lines": found.by_hand.modes,
        },
        "generated": [
            {"structural": one.structural, "parameter": one.parameter, "total": one.total, "law": one.law}
            for one in found.points
        ],
    }


def _model_data(one: ModelEffort) -> dict[str, Any]:
    return {
        "name": one.name,
        "entities": one.count.entities,
        "relations": one.count.relations,
        "total": one.count.total,
        "of_entities": dict(one.count.of_entities),
        "of_relations": dict(one.count.of_relations),
        "published": _parts_data(one.published, "entities", "relations"),
        "written": {
            "python": one.python and one.python._asdict(),
            "typeql": one.typeql._asdict(),
            "tree": one.tree and one.tree._asdict(),
            "pddl_lines": one.pddl,
            "pddl_is_declared": one.is_declared,
        },
    }


def _parts_data(parts: published.Parts | None, first: str, second: str) -> dict[str, int] | None:
    return None if parts is None else {first: parts.first, second: parts.second, "total": parts.total}


def _mission(name: str) -> Mission:
    if ":" not in name and name not in MISSIONS:
        how = f"one of your own is given as module:NAME, a model as a file ({', '.join(SUFFIXES)})"
        raise MissionError(f"{UnknownName('mission', name, MISSIONS)}; {how}")
    return find_mission(name)


def _of_file(name: str) -> ModelEffort:
    paths = [Path(part) for part in name.split(",")]
    model = Model.load(paths)
    texts = [read_text(path) for path in paths] if paths[0].suffix.lower() == ".tql" else [_typeql(model)]
    return ModelEffort(name, count(model), None, typeql_written("\n".join(texts)))


def _of_mission(name: str, mission: Mission) -> ModelEffort:
    build = AS_PUBLISHED.get(name, mission.model)
    model = built(f"the model of {name}", Model, build)
    pddl = _pddl(mission)
    return ModelEffort(
        name,
        count(model),
        published.MODELS.get(name),
        typeql_written(_typeql(model)),
        python_written(build),
        python_written(mission.tree),
        None if pddl is None else sum(code_lines(text, ";") for text in pddl),
        declarations_of(mission) is not None,
    )


def _typeql(model: Model) -> str:
    from kb.typeql import typeql_text

    return typeql_text(model)


def _pddl(mission: Mission) -> list[str] | None:
    """Return domain and problem, from their files or made of declarations."""
    declared = declarations_of(mission)
    if declared is not None:
        return [declared.domain_pddl, declared.problem_pddl]
    files = [path for path in (mission.domain, mission.problem) if path is not None]
    paths = [path for path in files if not isinstance(path, DeclaredProblem)]
    try:
        return [path.read_text(encoding="utf-8") for path in paths] or None
    except (OSError, ValueError) as error:
        raise MissionError(f"cannot read the PDDL of {mission.name}: {error}") from error


def _tree(name: str, mission: Mission) -> TreeEffort:
    return TreeEffort(name, count_tree(mission), published.TREES.get(name), published.TASK_NODES.get(name))
