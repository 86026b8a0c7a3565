"""UAV: a quadrotor searches samples and analyses them, as battery and gripper allow."""

from pathlib import Path

from missions import SUMMARIES
from missions.engine.mission import Mission
from missions.uav.model import uav_model
from missions.uav.tree import (
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
    domain=Path(__file__).with_name("domain.pddl"),
    problem=Path(__file__).with_name("problem.pddl"),
    actions={
        "search_for_samples": SearchForSamples,
        "pick_up_and_analyse": PickUpAndAnalyse,
        "analyse_on_site": AnalyseOnSite,
        "return_and_recharge": ReturnAndRecharge,
        "land_and_fold_gripper": LandAndFoldGripper,
    },
    facts=facts,
    world=SKY,
    why_not=lambda kb, percepts: "the battery is empty" if percepts.holds("battery_empty") else "",
)
