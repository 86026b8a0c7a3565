"""The extended mission as a behaviour tree: search and inspect as long as that is feasible, recharge otherwise.

until inspected
└── mission (stays with what it is doing)
├── search and inspect       fails as soon as the battery makes it unfeasible
└── recharge feasible? -> recharge
"""

from py_trees.behaviour import Behaviour
from py_trees.composites import Selector, Sequence
from py_trees.decorators import SuccessIsFailure

from kb import KnowledgeBase
from missions.senses import Senses
from missions.suave.tree import search_and_inspect
from missions.suave_extended.actions import Recharge
from rosa_bt import IsActionFeasible
from rosa_bt.decorators import UntilSuccess

__all__ = ["suave_extended_tree"]


def suave_extended_tree(kb: KnowledgeBase, senses: Senses) -> Behaviour:
    """Build the tree; it runs until the whole pipeline is inspected."""
    recharge = Sequence(
        "recharge if feasible",
        memory=False,
        children=[IsActionFeasible("recharge feasible?", kb, "recharge"), Recharge(kb, senses)],
    )
    # With memory, a recharge that has begun is finished although the battery is full a moment before it ends. It is no
    # success of the mission, which then goes on with searching and inspecting in the same tick.
    mission = Selector(
        "mission",
        memory=True,
        children=[search_and_inspect(kb, senses), SuccessIsFailure("then go on", recharge)],
    )
    return UntilSuccess("until inspected", mission)
