"""Extended SUAVE: as SUAVE, with a battery that drops, so the task has to change too."""

from pathlib import Path

from missions import SUMMARIES
from missions.engine.mission import Mission
from missions.suave.tree import InspectPipeline, SearchPipeline, facts
from missions.suave.world import SEA
from missions.suave_extended.model import suave_extended_model
from missions.suave_extended.tree import Recharge, suave_extended_tree

__all__ = ["MISSION"]

MISSION = Mission(
    name="suave_extended",
    summary=SUMMARIES["suave_extended"],
    model=suave_extended_model,
    tree=suave_extended_tree,
    domain=Path(__file__).with_name("domain.pddl"),
    problem=Path(__file__).with_name("problem.pddl"),
    actions={
        "search_pipeline": SearchPipeline,
        "inspect_pipeline": InspectPipeline,
        "recharge": Recharge,
    },
    facts=facts,
    world=SEA,
)
