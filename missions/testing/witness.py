"""Who hears all that a knowledge base is told while a task runs, and can say afterwards how the task has changed."""

import math
from typing import NamedTuple

from kb import Event, EventKind, KnowledgeBase, Status, StatusChange

__all__ = ["TaskChange", "Witness"]


class TaskChange(NamedTuple):
    """One action took the place of another, because that had become unfeasible, or because it is feasible again.

    Attributes:
        at: when the new action was begun [s].
        from_: the action that was given up, or has ended.
        to: the new action.
        in_force: when the robot was configured for it [s]; infinity for never.
        reason: why.
    """

    at: float
    from_: str
    to: str
    in_force: float
    reason: str

    def __str__(self) -> str:
        return f"{self.from_} -> {self.to}"


class Witness:
    """Hears a knowledge base from now on.

    Attributes:
        events: all so far.
        changes: how the task has changed so far.
    """

    def __init__(self, kb: KnowledgeBase) -> None:
        self.events: list[Event] = []
        self.changes: list[TaskChange] = []
        self._kb = kb
        self._is_waiting = False
        self._ended: tuple[str, bool] | None = None
        self._reasons: dict[str, str] = {}
        self._given_up: set[str] = set()
        kb.subscribe(self._hear)

    def _hear(self, event: Event) -> None:
        self.events.append(event)
        for change in event.changes:
            if change.kind == "action":
                self._judge(change, event.text)
        if event.kind is EventKind.ACTION_UPDATE:
            self._follow(event)
        self._settle(event.time)

    def _judge(self, change: StatusChange, news: str) -> None:
        """Remember why an action can, or cannot, be done now."""
        if change.new is Status.UNFEASIBLE:
            self._reasons[change.name] = self._kb.why(self._kb.actions[change.name])
        elif change.old is Status.UNFEASIBLE:
            self._reasons[change.name] = f"{news}: {change.name} is feasible again"

    def _follow(self, event: Event) -> None:
        record = next(one for one in reversed(self._kb.action_history) if one.action == event.subject)
        if record.end is not None:
            is_given_up = record.result == "abandoned"
            self._is_waiting = self._is_waiting and record.action != self.changes[-1].to
            self._ended = (record.action, is_given_up)
            if is_given_up:
                self._given_up.add(record.action)
            return
        before, is_given_up = self._ended or ("", False)
        if before != record.action and (is_given_up or (before and record.action in self._given_up)):
            reason = self._reasons.get(before if is_given_up else record.action, "")
            self.changes.append(TaskChange(event.time, before, record.action, math.inf, reason))
            self._is_waiting = True
        self._given_up.discard(record.action)
        self._ended = None

    def _settle(self, time: float) -> None:
        """Note when the robot is configured for the action that was begun last."""
        if self._is_waiting and self._kb.actions[self.changes[-1].to].status is Status.SOLVED:
            self.changes[-1] = self.changes[-1]._replace(in_force=time)
            self._is_waiting = False
