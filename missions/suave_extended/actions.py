"""What the extended mission does besides searching and inspecting."""

from py_trees.common import Status

from kb import KnowledgeBase
from missions.senses import Senses
from rosa_bt import RosaAction

__all__ = ["Recharge"]


class Recharge(RosaAction):
    """Go to the station and recharge; finished at the first recharge after it was begun."""

    def __init__(self, kb: KnowledgeBase, senses: Senses) -> None:
        super().__init__("recharge", kb, "recharge")
        self._senses = senses
        self._before = 0

    def initialise(self) -> None:
        """Remember how many recharges there were."""
        self._before = self._senses.count("battery_recharged")

    def update(self) -> Status:
        """Look whether there was one more."""
        return Status.SUCCESS if self._senses.count("battery_recharged") > self._before else Status.RUNNING
