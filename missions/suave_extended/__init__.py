"""Extended SUAVE: as SUAVE, and the battery drops to a critical level, so that the task has to change too."""

from pathlib import Path

from missions.mission import Mission
from missions.sea import SEA
from missions.suave.actions import InspectPipeline, SearchPipeline, facts
from missions.suave_extended.actions import Recharge
from missions.suave_extended.model import suave_extended_model
from missions.suave_extended.tree import suave_extended_tree

__all__ = ["MISSION"]

MISSION = Mission(
    name="suave_extended",
    summary="as suave, and the battery drops: give up the task, recharge, carry on",
    model=suave_extended_model,
    tree=suave_extended_tree,
    domain=Path(__file__).with_name("domain.pddl"),
    problem=Path(__file__).with_name("problem.pddl"),
    actions={"search_pipeline": SearchPipeline, "inspect_pipeline": InspectPipeline, "recharge": Recharge},
    facts=facts,
    world=SEA,
)
