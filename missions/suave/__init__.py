"""SUAVE: an underwater vehicle searches for a pipeline and inspects it, through murky water and a thruster failure."""

from missions import SUMMARIES
from missions.engine.mission import Mission
from missions.engine.task_layer import by_schema
from missions.suave.model import suave_model
from missions.suave.tree import PROBLEM, InspectPipeline, SearchPipeline, facts, suave_tree
from missions.suave.world import SEA

__all__ = ["MISSION"]

MISSION = Mission(
    name="suave",
    summary=SUMMARIES["suave"],
    model=suave_model,
    tree=suave_tree,
    problem=PROBLEM,
    actions=by_schema(SearchPipeline, InspectPipeline),
    facts=facts,
    world=SEA,
    fixed={"battery": "false"},
)
