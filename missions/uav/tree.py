"""The mission as a behaviour tree: find samples and analyse them one by one, as well as is feasible.

until all are analysed
└── one after another
    ├── one sample
    │   ├── find and analyse      fails as soon as the battery makes it unfeasible
    │   │   ├── find: a sample waiting?, or else search if feasible
    │   │   └── analyse: pick up if feasible, or else on site if feasible
    │   └── meanwhile: return and recharge
    └── all analysed?

Before it analyses on site after a pick-up, it lands and folds the gripper, whatever happened in between.
"""

from py_trees.behaviour import Behaviour
from py_trees.composites import Selector, Sequence

from kb import KnowledgeBase
from missions.engine.mission import Percepts
from missions.uav.actions import (
    AnalyseOnSite,
    LandAndFoldGripper,
    PickUpAndAnalyse,
    ReturnAndRecharge,
    SearchForSamples,
    Sensed,
    is_all_analysed,
    is_waiting,
)
from rosa_bt import do_until_unfeasible, feasible_then_act, first_feasible, switch_safely
from rosa_bt.decorators import UntilSuccess


def uav_tree(kb: KnowledgeBase, percepts: Percepts) -> Behaviour:
    """Build the tree; it runs until all samples are analysed that are wanted."""
    search = feasible_then_act(SearchForSamples(kb, percepts))
    find = Selector("find", memory=True, children=[Sensed("sample waiting?", percepts, is_waiting), search])
    analyse = first_feasible("analyse", [PickUpAndAnalyse(kb, percepts), AnalyseOnSite(kb, percepts)])
    # With memory: what was found stays found while it is analysed, also in the moment in which it is no longer waiting.
    work = Sequence("find and analyse", memory=True, children=[find, analyse])
    one = do_until_unfeasible(work, ReturnAndRecharge(kb, percepts), memory=True, name="one sample")
    every = Sequence(
        "one after another", memory=True, children=[one, Sensed("all analysed?", percepts, is_all_analysed)]
    )
    tree = UntilSuccess("until all are analysed", every)
    fold = LandAndFoldGripper(kb, percepts)
    return switch_safely(tree, {("pick_up_and_analyse", "analyse_on_site"): fold})
