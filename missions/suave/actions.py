"""What the mission does: each action says when it is finished; the nodes that it needs do the moving.

The tree and the plan executor run the same behaviours.
"""

from collections.abc import Mapping

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from kb import KnowledgeBase
from missions.senses import Senses
from rosa_bt import RosaAction

__all__ = ["InspectPipeline", "PipelineFound", "SearchPipeline", "facts"]


class PipelineFound(Behaviour):
    """Condition: SUCCESS once the camera has seen the pipeline."""

    def __init__(self, name: str, senses: Senses) -> None:
        super().__init__(name)
        self._senses = senses

    def update(self) -> Status:
        """Look at what was sensed."""
        return Status.SUCCESS if self._senses.holds("pipeline_found") else Status.FAILURE


class SearchPipeline(RosaAction):
    """Search until the camera has seen the pipeline."""

    def __init__(self, kb: KnowledgeBase, senses: Senses) -> None:
        super().__init__("search", kb, "search_pipeline")
        self._senses = senses

    def update(self) -> Status:
        """Look at what was sensed."""
        return Status.SUCCESS if self._senses.holds("pipeline_found") else Status.RUNNING


class InspectPipeline(RosaAction):
    """Follow the pipeline until all of it is inspected."""

    def __init__(self, kb: KnowledgeBase, senses: Senses) -> None:
        super().__init__("inspect", kb, "inspect_pipeline")
        self._senses = senses

    def update(self) -> Status:
        """Look at what was sensed."""
        return Status.SUCCESS if self._senses.holds("pipeline_inspected") else Status.RUNNING


def facts(senses: Senses) -> Mapping[str, bool]:
    """Return what was sensed as facts of the PDDL problem."""
    return {
        "(pipeline_found pipeline)": senses.holds("pipeline_found"),
        "(pipeline_inspected pipeline)": senses.holds("pipeline_inspected"),
    }
