"""What the extended mission does besides searching and inspecting."""

from typing import ClassVar

from py_trees.common import Status

from kb import KnowledgeBase
from missions.engine.mission import Percepts
from rosa_bt import RosaAction
from rosa_pddl.generation import ActionSchema

__all__ = ["Recharge"]


class Recharge(RosaAction):
    """Go to the station and recharge; finished at the first recharge after it was begun."""

    schema: ClassVar = ActionSchema(
        "recharge",
        parameters=("?r - robot",),
        end_effects=("(recharged ?r)",),
        duration_s=30,
        makes_feasible=("search_pipeline", "inspect_pipeline"),
    )

    def __init__(self, kb: KnowledgeBase, percepts: Percepts) -> None:
        super().__init__("recharge", kb, self.schema.rosa_action)
        self._percepts = percepts
        self._before = 0

    def initialise(self) -> None:
        self._before = self._percepts.count("battery_recharged")

    def update(self) -> Status:
        return Status.SUCCESS if self._percepts.count("battery_recharged") > self._before else Status.RUNNING
