"""The mission as a behaviour tree: find the pipeline, then inspect it.

And the actions of the tree and of plans.

until inspected └── search and inspect ├── find: pipeline found?, or else search if feasible └──
inspect if feasible

Each action says when it is finished; the nodes that it needs move the vehicle.
"""

from collections.abc import Mapping

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Selector, Sequence

from kb import KnowledgeBase
from missions.engine.mission import Condition, Percepts
from rosa_bt import RosaAction, feasible_then_act
from rosa_bt.decorators import UntilSuccess


class SearchPipeline(RosaAction):
    """Search until the camera has seen the pipeline.

    After an interruption the spiral continues by itself where it stopped; the search time over all
    interruptions is kept here.
    """

    def __init__(self, kb: KnowledgeBase, percepts: Percepts) -> None:
        super().__init__("search", kb, "search_pipeline")
        self._percepts = percepts
        self._since_s = 0.0

    @property
    def searched_s(self) -> float:
        """Time spent searching so far [s]."""
        return self.kb.now - self._since_s

    def initialise(self) -> None:
        self._since_s = self.kb.now

    def save_progress(self) -> float:
        return self.searched_s

    def restore_progress(self, progress: object) -> None:
        if isinstance(progress, float):
            self._since_s -= progress

    def update(self) -> Status:
        if not self._percepts.holds("pipeline_found"):
            return Status.RUNNING
        self.feedback_message = f"found after {self.searched_s:.0f} s of searching"
        return Status.SUCCESS


class InspectPipeline(RosaAction):
    """Follow the pipeline until all of it is inspected.

    After an interruption the follower continues by itself where it stopped, but counts its metres
    from 0 again; the sum of the metres is kept here.

    Attributes:
        inspected_m: inspected length of the pipeline [m].
    """

    def __init__(self, kb: KnowledgeBase, percepts: Percepts) -> None:
        super().__init__("inspect", kb, "inspect_pipeline")
        self._percepts = percepts
        self.inspected_m = 0.0
        self._reported_m = 0.0
        self._heard = 0

    def initialise(self) -> None:
        self.inspected_m = 0.0
        self._reported_m = 0.0
        self._heard = 0

    def save_progress(self) -> tuple[float, float]:
        return self.inspected_m, self._reported_m

    def restore_progress(self, progress: object) -> None:
        if isinstance(progress, tuple):
            self.inspected_m, self._reported_m = progress

    def update(self) -> Status:
        heard = self._percepts.count("distance_inspected")
        if heard != self._heard:
            self._heard = heard
            self._count(self._percepts.value("distance_inspected") or 0.0)
        return Status.SUCCESS if self._percepts.holds("pipeline_inspected") else Status.RUNNING

    def _count(self, reported_m: float) -> None:
        self.inspected_m += (
            reported_m - self._reported_m if reported_m >= self._reported_m else reported_m
        )
        self._reported_m = reported_m
        self.feedback_message = f"{self.inspected_m:.1f} m inspected"


def facts(kb: KnowledgeBase, percepts: Percepts) -> Mapping[str, bool]:
    """Return what was sensed, as facts of the PDDL problem."""
    return {
        "(pipeline_found pipeline)": percepts.holds("pipeline_found"),
        "(pipeline_inspected pipeline)": percepts.holds("pipeline_inspected"),
    }


def suave_tree(kb: KnowledgeBase, percepts: Percepts) -> Behaviour:
    """Build the tree; it runs until the whole pipeline is inspected."""
    return UntilSuccess("until inspected", search_and_inspect(kb, percepts))


def search_and_inspect(kb: KnowledgeBase, percepts: Percepts) -> Behaviour:
    """Build the subtree that searches and inspects.

    It fails as soon as its current action becomes unfeasible.
    """
    search = feasible_then_act(SearchPipeline(kb, percepts))
    found = Condition("pipeline found?", lambda: percepts.holds("pipeline_found"))
    # With memory, a search under way ends by itself as a success; the condition does not interrupt
    # it.
    find = Selector("find", memory=True, children=[found, search])
    inspect = feasible_then_act(InspectPipeline(kb, percepts))
    return Sequence("search and inspect", memory=False, children=[find, inspect])
