"""AGV: a ground vehicle drives through a building.

Corridors and the configuration in each are planned together.
"""

from collections.abc import Mapping, Sequence
from functools import cache, lru_cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import Final

from kb import KnowledgeBase
from missions import SUMMARIES
from missions.agv.joint import Modes
from missions.agv.model import NAVIGATE, PAPER, Building, building_model
from missions.agv.tree import PddlNames, PlanningState, Route, agv_tree
from missions.agv.world import AgvKind, Incident
from missions.engine.mission import Mission, Percepts

__all__ = ["Incident", "MISSION", "PAPER", "WEIGHTS", "agv_mission"]

WEIGHTS: Final[Mapping[str, float]] = MappingProxyType(
    {"time": 1.0, "energy": 0.02, "collisions": 10.0}
)
"""Default weights of what is minimised: seconds, joules, expected collisions; own choice."""

LIMITED: Final = ("energy",)
"""The resources of which a plan may use no more than there is."""


def agv_mission(
    name: str,
    summary: str,
    building: Building,
    weights: Mapping[str, float] = WEIGHTS,
    incidents: Sequence[Incident] = (),
) -> Mission:
    """Make a mission of a map and what happens there.

    The weights are those of `missions.agv.joint.Question`.
    """

    @cache  # takes time to make, and a mission that is only listed does not need it
    def pddl() -> PddlNames:
        kb = KnowledgeBase(building_model(building), clock=lambda: 0.0)
        return PddlNames(building, Modes(kb, NAVIGATE).under({}), LIMITED)

    @lru_cache(maxsize=8)  # takes time to make; the behaviours of a run share it
    def planning_state(kb: KnowledgeBase, percepts: Percepts) -> PlanningState:
        return PlanningState(Route(building, kb, percepts, weights), pddl())

    def why_not(kb: KnowledgeBase, percepts: Percepts) -> str:
        answer = planning_state(kb, percepts).route.answer
        return "" if answer.is_solved else answer.reason

    return Mission(
        name=name,
        summary=summary,
        model=partial(building_model, building),
        tree=partial(agv_tree, building, weights),
        domain=Path(__file__).with_name("domain.pddl"),
        problem=lambda: pddl().problem,
        actions={
            "switch": lambda kb, percepts, step: planning_state(kb, percepts).switch(step),
            "cross": lambda kb, percepts, step: planning_state(kb, percepts).cross(step),
        },
        facts=lambda kb, percepts: planning_state(kb, percepts).facts,
        world=AgvKind(building, weights, incidents),
        why_not=why_not,
        selects=True,
    )


MISSION = agv_mission(
    "agv", SUMMARIES["agv"], PAPER, incidents=(Incident("c1", "kinect"), Incident("c3"))
)
