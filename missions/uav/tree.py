"""The actions and the behaviour tree: find samples and analyse them, as feasible.

until all are analysed └── one after another ├── one sample │   ├── find and analyse      fails as
soon as the battery makes it unfeasible │   │   ├── find: a sample waiting?, or else search if
feasible │   │   └── analyse: pick up if feasible, or else on site if feasible │   └── meanwhile:
return and recharge └── all analysed?

After a pick-up, it lands and folds the gripper before it analyses on site, whatever happened in
between.

Each action says when it is finished; the components that it needs do the flying. The tree and the
plan executor run the same behaviours. Every action waits until the robot is configured for it, so
one behaviour follows another only in a safe state.
"""

from collections.abc import Mapping
from typing import ClassVar, Final

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Selector, Sequence

from kb import KnowledgeBase
from missions.engine.mission import Condition, Percepts
from missions.uav.model import MOST_SAMPLES
from rosa_bt import (
    RosaAction,
    do_until_unfeasible,
    feasible_then_act,
    first_feasible,
    switch_safely,
)
from rosa_bt.decorators import UntilSuccess

SAMPLES: Final = tuple(f"sample_{number}" for number in range(1, MOST_SAMPLES + 1))


def analysed(percepts: Percepts) -> int:
    return sum(percepts.holds(f"{sample}_analysed") for sample in SAMPLES)


def target(percepts: Percepts) -> str:
    """Return the name of the sample to analyse next; empty if there is none."""
    return next((sample for sample in SAMPLES if percepts.holds(f"{sample}_target")), "")


def is_all_analysed(percepts: Percepts) -> bool:
    """Tell whether at least one sample is wanted now, and all wanted ones are analysed."""
    wanted = [sample for sample in SAMPLES if percepts.holds(f"{sample}_wanted")]
    return bool(wanted) and all(percepts.holds(f"{name}_analysed") for name in wanted)


def facts(kb: KnowledgeBase, percepts: Percepts) -> Mapping[str, bool]:
    """Return what was sensed, as facts of the PDDL problem."""
    kinds = ("wanted", "analysed", "target")
    known = {
        f"({what} {sample})": percepts.holds(f"{sample}_{what}")
        for what in kinds
        for sample in SAMPLES
    }
    is_folded = percepts.holds("gripper_folded")
    if (
        is_folded and kb.pending_plan is not None
    ):  # the pending plan may unfold it soon, even for an action given up
        is_folded = "gripper" not in kb.pending_plan.activate
    return known | {"(looking drone)": not target(percepts), "(gripper_folded drone)": is_folded}


class UavAction(RosaAction):
    """An action with the name of its behaviour; works when all that it needs runs."""

    action_name: ClassVar[str]
    title: ClassVar[str]

    def __init__(self, kb: KnowledgeBase, percepts: Percepts) -> None:
        super().__init__(self.title, kb, self.action_name, wait=True)
        self.percepts = percepts


class SearchForSamples(UavAction):
    """Search until there is a sample to be analysed."""

    title: ClassVar = "search"
    action_name: ClassVar = "search_for_samples"

    def update(self) -> Status:
        return Status.SUCCESS if target(self.percepts) else Status.RUNNING


class _Analyse(UavAction):
    """Analyse one sample; it succeeds when the sample for which it began is the target no more."""

    def initialise(self) -> None:
        self._sample = target(self.percepts)

    def update(self) -> Status:
        return Status.RUNNING if self.percepts.holds(f"{self._sample}_target") else Status.SUCCESS


class PickUpAndAnalyse(_Analyse):
    """Pick up a sample and analyse it in the gripper: the better analysis."""

    title: ClassVar = "pick up"
    action_name: ClassVar = "pick_up_and_analyse"


class AnalyseOnSite(_Analyse):
    """Analyse a sample from above with the infra-red camera; the gripper has to be folded."""

    title: ClassVar = "analyse on site"
    action_name: ClassVar = "analyse_on_site"


class LandAndFoldGripper(UavAction):
    """Land and fold the gripper."""

    title: ClassVar = "land and fold"
    action_name: ClassVar = "land_and_fold_gripper"

    def update(self) -> Status:
        return Status.SUCCESS if self.percepts.holds("gripper_folded") else Status.RUNNING


class ReturnAndRecharge(UavAction):
    """Return to the base and recharge.

    Plans do so only when no sample waits that can be analysed on site.

    It costs more than analysing every sample on site, so no plan recharges only for a better
    analysis.
    """

    title: ClassVar = "recharge"
    action_name: ClassVar = "return_and_recharge"

    def initialise(self) -> None:
        self._before = self.percepts.count("battery_recharged")

    def update(self) -> Status:
        return (
            Status.SUCCESS
            if self.percepts.count("battery_recharged") > self._before
            else Status.RUNNING
        )


def uav_tree(kb: KnowledgeBase, percepts: Percepts) -> Behaviour:
    """Build the tree; it runs until all wanted samples are analysed."""
    search = feasible_then_act(SearchForSamples(kb, percepts))
    waiting = Condition("sample waiting?", lambda: bool(target(percepts)))
    find = Selector("find", memory=True, children=[waiting, search])
    analyse = first_feasible(
        "analyse", [PickUpAndAnalyse(kb, percepts), AnalyseOnSite(kb, percepts)]
    )
    # With memory: after a sample is found, the search does not start again while the sample is
    # analysed.
    work = Sequence("find and analyse", memory=True, children=[find, analyse])
    recharge = ReturnAndRecharge(kb, percepts)
    sample = do_until_unfeasible(work, recharge, memory=True, name="one sample")
    done = Condition("all analysed?", lambda: is_all_analysed(percepts))
    every = Sequence("one after another", memory=True, children=[sample, done])
    tree = UntilSuccess("until all are analysed", every)
    fold = LandAndFoldGripper(kb, percepts)
    return switch_safely(tree, {("pick_up_and_analyse", "analyse_on_site"): fold})
