"""What is told of one adaptation, and how a change of action is told until it is in force."""

from dataclasses import dataclass, field

from kb import KnowledgeBase, ReconfigurationPlan, Status
from missions.adaptations.headlines import News

__all__ = ["Adaptation", "TaskChange"]


@dataclass(slots=True)
class Adaptation:
    """One change of the robot or of what it does, made because of something that was measured.

    Attributes:
        at_s: when it was decided [s].
        kind: "parameter", "structural" (components switched) or "task" (another action, and what that needs).
        trigger: the news that set it off.
        reason: why that called for a change.
        change: what was changed.
        reaction_s: from the news to the change being in force [s]; None if it never was.
    """

    at_s: float
    kind: str
    trigger: str
    reason: str
    change: str
    reaction_s: float | None = None
    news_s: float = field(default=0.0, repr=False)

    @property
    def why(self) -> str:
        """The reason, and the news where the reason does not speak of it."""
        subject = self.trigger.split(" ")[0]
        return self.reason if subject in self.reason else f"{self.trigger}: {self.reason}"


class TaskChange:
    """A change of action, until the robot is configured for the new one.

    Attributes:
        adaptation: what is told of it.
    """

    def __init__(self, cause: News, before: str, action: str, time: float) -> None:
        self._action, self._begun = action, time
        self._change = f"{before} -> {action}"
        self._plans: list[tuple[str, ReconfigurationPlan]] = []
        reason = cause.reason or f"{action} is chosen, though {before} is still feasible"
        self.adaptation = Adaptation(time, "task", cause.text, reason, self._change, None, cause.time)

    def add(self, words: str, plan: ReconfigurationPlan) -> None:
        """Take in a plan that belongs to it."""
        self._plans.append((words, plan))
        self._write()

    def is_over(self, kb: KnowledgeBase, last_tick: float) -> bool:
        """Whether the robot is configured for the action, or nobody does anything about it any more."""
        if all(one.action != self._action for one in kb.required_actions):
            return True
        latest = kb.latest_plan
        acted = self._begun if latest is None or latest.end is None else max(self._begun, latest.end)
        return kb.actions[self._action].status is Status.SOLVED or last_tick >= acted

    def close(self) -> None:
        """Note when it was in force, if it was."""
        last = self._plans[-1][1] if self._plans else None
        if last is None:
            self.adaptation.reaction_s = self._begun - self.adaptation.news_s
        elif last.result == "completed" and last.end is not None:
            self.adaptation.reaction_s = max(self._begun, last.end) - self.adaptation.news_s
        self._write()

    def _write(self) -> None:
        told = [
            words + ("" if plan.result in (None, "completed") else f" ({plan.result})") for words, plan in self._plans
        ]
        self.adaptation.change = "; ".join([self._change, *told])
