"""Extended SUAVE: as SUAVE, and the battery drops to a critical level, so that the task has to change too."""

from missions import SUMMARIES
from missions.engine.mission import Mission
from missions.engine.task_layer import by_schema
from missions.suave.tree import PROBLEM, InspectPipeline, SearchPipeline, facts
from missions.suave.world import SEA
from missions.suave_extended.model import suave_extended_model
from missions.suave_extended.tree import Recharge, suave_extended_tree

__all__ = ["MISSION"]

MISSION = Mission(
    name="suave_extended",
    summary=SUMMARIES["suave_extended"],
    model=suave_extended_model,
    tree=suave_extended_tree,
    problem=PROBLEM,
    actions=by_schema(SearchPipeline, InspectPipeline, Recharge),
    facts=facts,
    world=SEA,
)
