"""AGV: a ground vehicle drives through a building.

Corridors and the configuration in each are planned together.
"""

from collections.abc import Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Final

from kb import KnowledgeBase
from missions import SUMMARIES
from missions.agv import tree
from missions.agv.joint import Weights
from missions.agv.model import PAPER, Building, building_model
from missions.agv.world import AgvKind, Incident
from missions.engine.mission import Mission, Percepts

__all__ = ["Incident", "MISSION", "PAPER", "WEIGHTS", "Weights", "agv_mission"]

WEIGHTS: Final = Weights(time=1.0, energy=0.02, collisions=10.0)
"""Default weights of what is minimised: seconds, joules, expected collisions; own choice."""


def agv_mission(
    name: str,
    summary: str,
    building: Building,
    weights: Weights = WEIGHTS,
    incidents: Sequence[Incident] = (),
) -> Mission:
    """Make a mission of a map and what happens there."""

    @lru_cache(maxsize=8)  # takes time to make; the behaviours of a run share it
    def route(kb: KnowledgeBase, percepts: Percepts) -> tree.Route:
        return tree.Route(building, kb, percepts, weights)

    def why_not(kb: KnowledgeBase, percepts: Percepts) -> str:
        answer = route(kb, percepts).answer
        return answer.reason if answer.cost is None else ""

    return Mission(
        name=name,
        summary=summary,
        model=partial(building_model, building),
        tree=lambda kb, percepts: tree.agv_tree(route(kb, percepts)),
        domain=Path(__file__).with_name("domain.pddl"),
        problem=partial(tree.problem, building),
        actions={
            "switch": lambda kb, percepts, step: tree.switch(route(kb, percepts), step),
            "cross": lambda kb, percepts, step: tree.cross(route(kb, percepts), step),
        },
        facts=lambda kb, percepts: tree.facts(route(kb, percepts)),
        world=AgvKind(building, route, incidents),
        why_not=why_not,
        selects=True,
    )


MISSION = agv_mission(
    "agv", SUMMARIES["agv"], PAPER, incidents=(Incident("c1", "kinect"), Incident("c3"))
)
