"""Putting it together: missions that run, are recorded, replayed and reported."""

from typing import Final

__all__ = ["SUMMARIES"]

SUMMARIES: Final = {
    "suave": "search for a pipeline and inspect it; the water turns murky and a thruster fails",
    "suave_extended": "as suave, and the battery drops: give up the task, recharge, carry on",
    "agv": "drive through a building; the Kinect fails on the way, and a corridor goes dark",
    "uav": "fly over a field and analyse samples; the battery runs low and the gripper fails",
}
"""The missions, each with what happens in it; they are imported only when they are asked for."""
