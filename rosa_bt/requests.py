"""What a running behaviour has asked of a knowledge base: its request, its progress, and whether the robot is ready.

Kept for each knowledge base, because behaviours come and go: a tree switches between two behaviours of one action, and
a plan makes a new behaviour for each step.
"""

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Final
from weakref import WeakKeyDictionary

from py_trees.common import Status

from kb import KnowledgeBase, Reply
from kb import Status as ElementStatus

__all__ = ["ActionRequest", "Readiness", "forget_progress", "saved_progress", "why"]

_RESULTS: Final = {Status.SUCCESS: "completed", Status.FAILURE: "failed", Status.INVALID: "abandoned"}


@dataclass(slots=True)
class _Ledger:
    """What is kept for one knowledge base.

    Attributes:
        holders: how many running behaviours hold the request of an action: when a tree switches between two of them,
            the new one starts before the old one is stopped, and the request has to outlive the switch.
        progress: what interrupted behaviours saved, by action and name of the behaviour.
        reasons: why an action has its status, by action: the revision of the knowledge base, and the sentence.
    """

    holders: Counter[str] = field(default_factory=Counter)
    progress: dict[tuple[str, str], object] = field(default_factory=dict)
    reasons: dict[str, tuple[int, str]] = field(default_factory=dict)


_ledgers: WeakKeyDictionary[KnowledgeBase, _Ledger] = WeakKeyDictionary()


def _ledger(kb: KnowledgeBase) -> _Ledger:
    return _ledgers.setdefault(kb, _Ledger())


def saved_progress(kb: KnowledgeBase) -> dict[tuple[str, str], object]:
    """Return what interrupted behaviours saved, by action and name of the behaviour; to be changed by them."""
    return _ledger(kb).progress


def forget_progress(kb: KnowledgeBase) -> None:
    """Drop what interrupted actions saved: the next mission with this knowledge base begins at the beginning."""
    saved_progress(kb).clear()


def why(kb: KnowledgeBase, action: str) -> str:
    """Return why an action has its status: made anew only when what is known has changed.

    The sentence is as of that change: a value that has moved on since without changing any status is not in it.
    """
    reasons = _ledger(kb).reasons
    found = reasons.get(action)
    if found is None or found[0] != kb.revision:
        reasons[action] = found = kb.revision, kb.why(kb.actions[action])
    return found[1]


class Readiness:
    """Whether the robot is configured for an action; waited for, but not for ever.

    Args:
        kb: the knowledge base to ask.
        timeout: how long to wait [s], by the clock of the knowledge base.
    """

    def __init__(self, kb: KnowledgeBase, timeout: float) -> None:
        if not timeout > 0:
            raise ValueError(f"a time-out is more than 0 s, or math.inf for none; not {timeout!r}")
        self._kb = kb
        self._timeout = timeout
        self._since = math.nan

    def begin(self) -> None:
        """Count the time from now."""
        self._since = self._kb.now

    def look(self, action: str) -> tuple[Status, str]:
        """Return SUCCESS when the robot is ready, RUNNING while it is not, FAILURE when it will not be; and why."""
        if not self._kb.is_feasible(action):
            return Status.FAILURE, why(self._kb, action)
        lacking = self._lacking(action)
        if not lacking:
            return Status.SUCCESS, ""
        if self._kb.now - self._since >= self._timeout:
            return Status.FAILURE, f"not ready within {self._timeout:g} s: {lacking}"
        return Status.RUNNING, f"waiting: {lacking}"

    def _lacking(self, action: str) -> str:
        """Why it cannot start yet: its functions are not solved, or a plan is still being executed."""
        if self._kb.actions[action].status is not ElementStatus.SOLVED:
            return why(self._kb, action)
        plan = self._kb.pending_plan
        return "" if plan is None else f"the robot is being reconfigured ({plan})"


class ActionRequest:
    """One behaviour's part in the request of an action: held from `open` to the first `close` after it.

    Args:
        kb: the knowledge base to tell.
        wait: whether the behaviour waits until the robot is configured for the action.
        timeout: for how long [s].

    Attributes:
        waits: the same.
    """

    def __init__(self, kb: KnowledgeBase, *, wait: bool, timeout: float) -> None:
        self._kb = kb
        self._held: str | None = None
        self._readiness = Readiness(kb, timeout) if wait else None

    @property
    def waits(self) -> bool:
        return self._readiness is not None

    def open(self, action: str, preference: str | None) -> Reply:
        """Request an action, or join those who hold it."""
        reply = self._kb.request_action(action, preference)
        if reply:
            self._held = action
            _ledger(self._kb).holders[action] += 1
        if self._readiness is not None:
            self._readiness.begin()
        return reply

    def look(self, action: str) -> tuple[Status, str]:
        """Return SUCCESS when the behaviour may start working, RUNNING before, FAILURE if it never will; and why."""
        return (Status.SUCCESS, "") if self._readiness is None else self._readiness.look(action)

    def close(self, status: Status, reason: str) -> None:
        """Let go of the action; the last one who holds it tells the knowledge base how it ended.

        Args:
            status: of the behaviour at its end.
            reason: why it failed.
        """
        action, self._held = self._held, None
        if action is None:
            return
        kb, holders = self._kb, _ledger(self._kb).holders
        holders[action] -= 1
        if holders[action] or action not in kb.actions:  # one that left the model was cancelled with it
            return
        if status is Status.INVALID and not kb.is_feasible(action):
            kb.cancel_action(action, _RESULTS[status], kb.why(kb.actions[action]))
        else:
            kb.cancel_action(action, _RESULTS[status], reason if status is Status.FAILURE else "")
