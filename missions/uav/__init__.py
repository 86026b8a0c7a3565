"""UAV: an aerial vehicle searches a field for samples and analyses them, as its battery and its gripper allow."""

from missions import SUMMARIES
from missions.engine.mission import Mission
from missions.engine.task_layer import by_schema
from missions.uav.model import uav_model
from missions.uav.tree import (
    PROBLEM,
    AnalyseOnSite,
    LandAndFoldGripper,
    PickUpAndAnalyse,
    ReturnAndRecharge,
    SearchForSamples,
    facts,
    uav_tree,
)
from missions.uav.world import SKY

__all__ = ["MISSION"]

MISSION = Mission(
    name="uav",
    summary=SUMMARIES["uav"],
    model=uav_model,
    tree=uav_tree,
    problem=PROBLEM,
    actions=by_schema(
        SearchForSamples, PickUpAndAnalyse, AnalyseOnSite, ReturnAndRecharge, LandAndFoldGripper
    ),
    facts=facts,
    world=SKY,
    why_not=lambda kb, percepts: "the battery is empty" if percepts.holds("battery_empty") else "",
)
