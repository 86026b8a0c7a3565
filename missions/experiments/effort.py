"""How large models are by the ROSA paper's way of counting (Silva et al., section on development effort).

One rule gives the published counts of all four models: what in TypeDB is an entity or a relation counts one. As TypeQL,
a model has a statement for each.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from kb import Model, UnknownName
from kb.elements import Attribute, Component, Function
from kb.files import SUFFIXES, read_text
from missions.agv.model import agv_model
from missions.engine.mission import Mission, MissionError
from missions.engine.registry import MISSIONS, find_mission
from missions.experiments.effort_by_hand import ByHand, TreeCount, by_hand, count_tree, is_managed_by_tree
from missions.experiments.effort_source import Written, built, code_lines, python_written, typeql_written
from missions.planning.declared import declarations_of
from rosa_pddl import DeclaredProblem

__all__ = [
    "Count",
    "LawPoint",
    "MODELS",
    "MOST_ADAPTATIONS",
    "ModelEffort",
    "Parts",
    "RULE",
    "Survey",
    "TASK_NODES",
    "TREES",
    "TreeEffort",
    "as_data",
    "count",
    "generated_model",
    "law",
    "survey",
]

RULE: Final = (
    "entities: actions, functions, components, attributes, parameter values (each key of each configuration)",
    "relations: functional requirements (one for each action), function designs, component configurations, "
    "constraints (one that is shared counts once), estimations",
)
"""What is counted, in two lines."""

MOST_ADAPTATIONS: Final = 6
"""Generated models have up to that many adaptations of each kind."""


class Parts(NamedTuple):
    """A number that is counted in two parts."""

    first: int
    second: int

    @property
    def total(self) -> int:
        return self.first + self.second

    def __str__(self) -> str:
        return f"{self.first} + {self.second} = {self.total}"


MODELS: Final[Mapping[str, Parts]] = MappingProxyType(
    {"suave": Parts(18, 12), "suave_extended": Parts(22, 16), "agv": Parts(18, 36), "uav": Parts(24, 16)}
)
"""Published: entities and relations of each model."""

TREES: Final[Mapping[str, Parts]] = MappingProxyType({"suave": Parts(27, 30), "suave_extended": Parts(34, 38)})
"""Published, for the tree that manages: nodes without those of the task, and modes with their parameters."""

TASK_NODES: Final[Mapping[str, int]] = MappingProxyType({"suave": 10, "suave_extended": 16})
"""Published: nodes of the tree with the task only, which are deducted from those of the tree that manages."""

AS_PUBLISHED: Final[Mapping[str, Callable[[], Model]]] = MappingProxyType({"agv": agv_model})
"""Missions whose model holds more than the published one, and what is counted for them."""


def law(structural: int, parameter: int) -> int:
    """Return how many elements one action needs with that many adaptations, as published."""
    return 10 + 6 * structural + 3 * parameter


@dataclass(frozen=True, slots=True)
class Count:
    """How many elements a model has.

    Attributes:
        of_entities: how many of each kind of entity.
        of_relations: how many of each kind of relation.
    """

    of_entities: Mapping[str, int]
    of_relations: Mapping[str, int]

    @property
    def entities(self) -> int:
        return sum(self.of_entities.values())

    @property
    def relations(self) -> int:
        return sum(self.of_relations.values())

    @property
    def total(self) -> int:
        return self.entities + self.relations

    def __str__(self) -> str:
        return f"{self.entities} entities + {self.relations} relations = {self.total}"


def count(model: Model) -> Count:
    """Count the entities and relations of a model; what is stated to be so from the start is not counted."""
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
    return Count(MappingProxyType(entities), MappingProxyType(relations))


def generated_model(structural: int, parameter: int, actions: int = 1) -> Model:
    """Make the smallest model for a number of adaptations (Silva et al., assumptions 1 and 2).

    Each action requires a function of its own, with one design of one component with one configuration. A structural
    adaptation is one more such design, a parameter adaptation one more configuration of the first component. Every
    design and every configuration has a priority and a constraint; every component a package, an executable and one
    parameter. All constraints are on the one quality attribute, which all actions share.

    Args:
        structural: structural adaptations of each action, from 0.
        parameter: parameter adaptations of each action, from 0.
        actions: how many, from 1.

    Raises:
        MissionError: a number is too small.
    """
    for name, number, least in (("structural", structural, 0), ("parameter", parameter, 0), ("actions", actions, 1)):
        if number < least:
            raise MissionError(f"{name} is {number}; a generated model takes a whole number from {least}")
    model = Model("generated")
    quality = model.quality_attribute("quality")
    for one in range(1, actions + 1):
        function = model.function(f"function_{one}")
        first, *_ = [
            _design(model, function, quality, f"{one}_{number}", number) for number in range(1, structural + 2)
        ]
        for number in range(2, parameter + 2):
            _configuration(first, quality, number)
        model.action(f"action_{one}", requires=[function])
    return model


def _design(model: Model, function: Function, quality: Attribute, name: str, number: int) -> Component:
    component = model.component(f"node_{name}", kind="process", package="nodes", executable=f"node_{name}")
    _configuration(component, quality, 1)
    function.design(f"design_{name}", [component], priority=number, constraints=[quality >= 1 / number])
    return component


def _configuration(component: Component, quality: Attribute, number: int) -> None:
    name = f"{component.name}_as_{number}"
    component.configuration(name, {"value": number}, priority=number, constraints=[quality >= 1 / number])


@dataclass(frozen=True, slots=True)
class ModelEffort:
    """What is counted of a model.

    Attributes:
        name: as it was given.
        count: its elements.
        published: entities and relations of the paper's; None if it has none.
        typeql: its size as TypeQL.
        python: its source; None if it is a file.
        tree: the source of the mission's tree.
        pddl: lines of the mission's domain and problem; None if it has none.
        is_declared: whether that PDDL is made of what the actions declare, so that nobody writes it.
    """

    name: str
    count: Count
    published: Parts | None
    typeql: Written
    python: Written | None = None
    tree: Written | None = None
    pddl: int | None = None
    is_declared: bool = False


class TreeEffort(NamedTuple):
    """What is counted of the tree that manages a mission, beside the paper's: None where it has none."""

    name: str
    counted: TreeCount
    published: Parts | None
    published_task: int | None


class LawPoint(NamedTuple):
    """A generated model of one action: its adaptations, and its elements as counted and as the published law says."""

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
    models = tuple(_of_mission(name, mission) if mission else _of_file(name) for name, mission in found.items())
    trees = tuple(
        TreeEffort(name, count_tree(one), TREES.get(name), TASK_NODES.get(name))
        for name, one in found.items()
        if one is not None and is_managed_by_tree(one)
    )
    steps = range(MOST_ADAPTATIONS + 1)
    points = tuple(
        LawPoint(one, two, count(generated_model(one, two)).total, law(one, two)) for one in steps for two in steps
    )
    return Survey(models, trees, by_hand() if trees else None, points)


def as_data(found: Survey) -> dict[str, Any]:
    """Return it as data for JSON."""
    hand = found.by_hand
    return {
        "rule": RULE,
        "models": [_model_data(one) for one in found.models],
        "trees": [
            {
                "name": one.name,
                "nodes": one.counted.nodes,
                "task_nodes": one.counted.task_nodes,
                "modes": one.counted.modes,
                "total": one.counted.total,
                "published": _parts_data(one.published, "nodes", "modes"),
                "published_task_nodes": one.published_task,
            }
            for one in found.trees
        ],
        "by_hand": hand
        and {
            "tree": hand.tree._asdict(),
            "kinds": hand.kinds._asdict(),
            "rest": hand.rest._asdict(),
            "modes_lines": hand.modes,
        },
        "generated": [one._asdict() for one in found.points],
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


def _parts_data(parts: Parts | None, first: str, second: str) -> dict[str, int] | None:
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
        MODELS.get(name),
        typeql_written(_typeql(model)),
        python_written(build),
        python_written(mission.tree),
        None if pddl is None else sum(code_lines(text, ";") for text in pddl),
        declarations_of(mission) is not None,
    )


def _typeql(model: Model) -> str:
    from kb.typeql.writer import typeql_text

    return typeql_text(model)


def _pddl(mission: Mission) -> list[str] | None:
    """Return domain and problem, from their files or made of declarations."""
    declared = declarations_of(mission)
    if declared is not None:
        return [declared.domain_pddl, declared.problem_pddl]
    paths = [path for path in (mission.domain, mission.problem) if path and not isinstance(path, DeclaredProblem)]
    try:
        return [path.read_text(encoding="utf-8") for path in paths] or None
    except (OSError, ValueError) as error:
        raise MissionError(f"cannot read the PDDL of {mission.name}: {error}") from error
