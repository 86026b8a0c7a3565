"""What the mission does: each action says when it is finished; the nodes that it needs do the moving.

The tree and the plan executor run the same behaviours; their schemas are what the PDDL is made of.
"""

from collections.abc import Mapping
from typing import ClassVar, Final

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from kb import KnowledgeBase
from missions.senses import Senses
from rosa_bt import RosaAction
from rosa_pddl.generation import ActionSchema, DeclaredProblem

__all__ = ["InspectPipeline", "PROBLEM", "PipelineFound", "SearchPipeline", "facts"]

PROBLEM: Final = DeclaredProblem(
    objects={"pipeline": "pipeline", "bluerov": "robot"}, goal=("(pipeline_inspected pipeline)",)
)


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

    schema: ClassVar = ActionSchema(
        "search_pipeline",
        parameters=("?p - pipeline", "?r - robot"),
        end_effects=("(pipeline_found ?p)",),
        duration_s=60,
    )

    def __init__(self, kb: KnowledgeBase, senses: Senses) -> None:
        super().__init__("search", kb, self.schema.rosa_action)
        self._senses = senses

    def update(self) -> Status:
        """Look at what was sensed."""
        return Status.SUCCESS if self._senses.holds("pipeline_found") else Status.RUNNING


class InspectPipeline(RosaAction):
    """Follow the pipeline until all of it is inspected."""

    schema: ClassVar = ActionSchema(
        "inspect_pipeline",
        parameters=("?p - pipeline", "?r - robot"),
        start=("(pipeline_found ?p)",),
        end_effects=("(pipeline_inspected ?p)",),
        duration_s=60,
    )

    def __init__(self, kb: KnowledgeBase, senses: Senses) -> None:
        super().__init__("inspect", kb, self.schema.rosa_action)
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
