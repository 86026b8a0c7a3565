"""The extended mission as a behaviour tree: search and inspect while feasible, else recharge.

until inspected └── mission ├── search and inspect       fails as soon as the battery makes it
unfeasible └── meanwhile: recharge if feasible
"""

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from kb import KnowledgeBase
from missions.engine.mission import Percepts
from missions.suave.tree import search_and_inspect
from rosa_bt import RosaAction, do_until_unfeasible
from rosa_bt.decorators import UntilSuccess


class Recharge(RosaAction):
    """Go to the station and recharge; finished at the first recharge after it was begun."""

    def __init__(self, kb: KnowledgeBase, percepts: Percepts) -> None:
        super().__init__("recharge", kb, "recharge")
        self._percepts = percepts
        self._before = 0

    def initialise(self) -> None:
        self._before = self._percepts.count("battery_recharged")

    def update(self) -> Status:
        return (
            Status.SUCCESS
            if self._percepts.count("battery_recharged") > self._before
            else Status.RUNNING
        )


def suave_extended_tree(kb: KnowledgeBase, percepts: Percepts) -> Behaviour:
    """Build the tree; it runs until the whole pipeline is inspected."""
    # With memory, a recharge that has begun is finished although the battery is full a moment
    # before it ends.
    mission = do_until_unfeasible(
        search_and_inspect(kb, percepts), Recharge(kb, percepts), memory=True, name="mission"
    )
    return UntilSuccess("until inspected", mission)
