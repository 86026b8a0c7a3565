"""The table of development effort in the ROSA paper, counted by one rule.

Each action, function, component, attribute and parameter value is an entity. Each functional
requirement (one for an action), function design, component configuration, constraint and estimation
is a relation.
"""

from kb import KnowledgeBase, Model
from missions.agv.model import agv_model
from missions.baselines import open_run
from missions.baselines.modes import FUNCTIONS, TreeManager
from missions.engine.mission import Percepts, find_mission
from missions.suave.model import suave_model
from missions.suave_extended.model import suave_extended_model
from missions.uav.model import uav_model

MODELS = {
    "suave": (suave_model(), 18, 12),
    "suave_extended": (suave_extended_model(), 22, 16),
    "agv": (agv_model(), 18, 36),
    "uav": (uav_model(), 24, 16),
}
"""Each model, and the published numbers of its entities and relations."""

TREES = {"suave": (27, 30), "suave_extended": (34, 38)}
"""Published for SUAVE's own tree: nodes that adapt, and modes with their values."""


def count(model: Model) -> tuple[int, int]:
    """Return the numbers of entities and relations of a model."""
    entities = len(model.actions) + len(model.functions)
    entities += len(model.components) + len(model.attributes)
    entities += sum(len(each.parameters) for each in model.configurations.values())
    relations = sum(bool(action.functions) for action in model.actions.values())
    relations += len(model.designs) + len(model.configurations)
    relations += len(model.constraints) + len(model.estimations)
    return entities, relations


def count_tree(name: str) -> tuple[int, int]:
    """Return the nodes that the manager `bt` adds to a tree, and its modes with their values."""
    mission = find_mission(name)
    run = open_run(mission, manager="bt")
    assert isinstance(run, TreeManager)
    assert mission.tree is not None
    model = mission.model()
    task = mission.tree(KnowledgeBase(model), Percepts())
    added = len(list(run.root.iterate())) - len(list(task.iterate()))
    used = [modes for component, modes in FUNCTIONS.values() if component in model.components]
    values = sum(2 + len(mode.parameters) for modes in used for mode in modes.values())
    run.world.close()
    return added, values


def generated_model(structural: int, parameter: int) -> Model:
    """Make the smallest model of one action with these numbers of adaptations."""
    model = Model("generated")
    quality = model.quality_attribute("quality")
    function = model.function("function")
    for number in range(structural + 1):
        component = model.component(f"node_{number}", kind="lifecycle")
        limits = [quality >= number]
        function.design(f"design_{number}", [component], priority=number, constraints=limits)
        for level in range(parameter + 1 if number == 0 else 1):
            component.configuration(
                f"node_{number}_{level}", {"value": level}, constraints=[quality >= level]
            )
    model.action("action", requires=[function])
    return model


print("model            entities + relations   published")
for name, (model, *published) in MODELS.items():
    print(f"{name:16} {count(model)!s:22} {tuple(published)}")

print("adapted by a tree   nodes + modes   published")
for name, numbers in TREES.items():
    print(f"{name:19} {count_tree(name)!s:15} {numbers}")

print("structural parameter elements   10 + 6 s + 3 p")
for structural, parameter in [(0, 0), (1, 0), (0, 1), (3, 6)]:
    size = sum(count(generated_model(structural, parameter)))
    law = 10 + 6 * structural + 3 * parameter
    print(f"{structural:10} {parameter:9} {size:8}   {law}")
