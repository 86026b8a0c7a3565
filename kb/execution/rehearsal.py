"""What a planner would do now, without doing it."""

from collections.abc import Mapping

from kb.exceptions import InvalidValue
from kb.explanation.reasons import why_selected
from kb.inference.network import Node
from kb.knowledge_base import KnowledgeBase
from kb.reconfiguration import ReconfigurationPlan, planned, reselect
from kb.requests import RequiredAction
from kb.situation import Situation

__all__ = ["Rehearsal"]


class Rehearsal(Situation):
    """A knowledge base on which a planner can be tried: what it selects is selected here only.

    Args:
        kb: which stays as it is.
    """

    def __init__(self, kb: KnowledgeBase) -> None:
        super().__init__(kb, ())
        self._kb = kb
        self.model = kb.model

    @property
    def required_actions(self) -> tuple[RequiredAction, ...]:
        """The actions that are required now."""
        return self._kb.required_actions

    @property
    def action_history(self) -> tuple[RequiredAction, ...]:
        """Every action that was ever required."""
        return self._kb.action_history

    @property
    def plans(self) -> tuple[ReconfigurationPlan, ...]:
        """Every plan that was really made."""
        return self._kb.plans

    @property
    def latest_plan(self) -> ReconfigurationPlan | None:
        """The plan that was really made last."""
        return self._kb.latest_plan

    @property
    def pending_plan(self) -> ReconfigurationPlan | None:
        """The latest plan that has not ended."""
        return self._kb.pending_plan

    @property
    def revision(self) -> int:
        """How many facts have changed so far that can matter to a planner."""
        return self._kb.revision

    def select(
        self,
        designs: Mapping[str, str] | None = None,
        configurations: Mapping[str, str] | None = None,
        reason: str = "",
    ) -> ReconfigurationPlan | None:
        """Return the plan that the knowledge base would make of this selection; it does not get to know it."""
        with self._lock:
            chosen = [_owned(self.designs.node(name), self.functions.node(of)) for of, name in (designs or {}).items()]
            given = [
                _owned(self.configurations.node(name), self.components.node(of))
                for of, name in (configurations or {}).items()
            ]
            now, state = self._clock(), self._state
            why_these = why_selected(state, [*chosen, *given], now, reason, self._kb._ended)
            selection = reselect(state, chosen, given)
            return planned(state, selection, why_these, now) if selection else None


def _owned(node: Node, owner: Node) -> Node:
    if node.wholes[0] is not owner:
        raise InvalidValue(f"{node.kind} {node.name!r} is of {node.wholes[0].name!r}, not of {owner.name!r}")
    return node
