"""SUAVE: find and inspect a pipeline, in murky water and with a failing thruster."""

from pathlib import Path

from missions import SUMMARIES
from missions.engine.mission import Mission
from missions.suave.model import suave_model
from missions.suave.tree import InspectPipeline, SearchPipeline, facts, suave_tree
from missions.suave.world import SEA

__all__ = ["MISSION"]

MISSION = Mission(
    name="suave",
    summary=SUMMARIES["suave"],
    model=suave_model,
    tree=suave_tree,
    domain=Path(__file__).with_name("domain.pddl"),
    problem=Path(__file__).with_name("problem.pddl"),
    actions={
        "search_pipeline": SearchPipeline,
        "inspect_pipeline": InspectPipeline,
    },
    facts=facts,
    world=SEA,
    fixed={"battery": "false"},
)
