"""The extended mission as a behaviour tree: search and inspect as long as that is feasible, recharge otherwise.

until inspected
└── mission
    ├── search and inspect       fails as soon as the battery makes it unfeasible
    └── meanwhile: recharge if feasible
"""

from py_trees.behaviour import Behaviour

from kb import KnowledgeBase
from missions.engine.mission import Percepts
from missions.suave.tree import search_and_inspect
from missions.suave_extended.actions import Recharge
from rosa_bt import do_until_unfeasible
from rosa_bt.decorators import UntilSuccess

__all__ = ["suave_extended_tree"]


def suave_extended_tree(kb: KnowledgeBase, percepts: Percepts) -> Behaviour:
    """Build the tree; it runs until the whole pipeline is inspected."""
    # With memory, a recharge that has begun is finished although the battery is full a moment before it ends.
    mission = do_until_unfeasible(search_and_inspect(kb, percepts), Recharge(kb, percepts), memory=True, name="mission")
    return UntilSuccess("until inspected", mission)
