"""What a running behaviour has asked of a knowledge base: its request, its progress, and whether the robot is ready.

Kept for each knowledge base, because behaviours come and go: a tree switches between two behaviours of one action, and
a plan makes a new behaviour for each step.
"""

import math
from collections import Counter
from dataclasses import dataclass, field
from weakref import WeakKeyDictionary

from py_trees.common import Status

from kb import KnowledgeBase, Reply
from kb import Status as Verdict

__all__ = ["ActionRequest", "Patience", "Progress", "Reason", "forget_progress"]

RESULTS = {Status.SUCCESS: "completed", Status.FAILURE: "failed", Status.INVALID: "abandoned"}


@dataclass(slots=True)
class _Ledger:
    """What is kept for one knowledge base.

    Attributes:
        holders: how many running behaviours hold the request of an action: when a tree switches between two of them,
            the new one starts before the old one is stopped, and the request has to outlive the switch.
        progress: what interrupted behaviours saved, by action and name of the behaviour.
    """

    holders: Counter[str] = field(default_factory=Counter)
    progress: dict[tuple[str, str], object] = field(default_factory=dict)


_ledgers: WeakKeyDictionary[KnowledgeBase, _Ledger] = WeakKeyDictionary()


def _ledger(kb: KnowledgeBase) -> _Ledger:
    return _ledgers.setdefault(kb, _Ledger())


class ActionRequest:
    """One behaviour's part in the request of an action: held from `open` to the first `close` after it."""

    def __init__(self, kb: KnowledgeBase) -> None:
        self._kb = kb
        self._held: str | None = None

    def open(self, action: str, preference: str | None) -> Reply:
        """Request an action, or join those who hold it."""
        reply = self._kb.request_action(action, preference)
        if reply:
            self._held = action
            _ledger(self._kb).holders[action] += 1
        return reply

    def close(self, result: str, reason: str = "") -> None:
        """Let go of the action; the last one who holds it tells the knowledge base how it ended, and why."""
        action, self._held = self._held, None
        if action is None:
            return
        kb, holders = self._kb, _ledger(self._kb).holders
        holders[action] -= 1
        if holders[action] or action not in kb.actions:  # one that left the model was cancelled with it
            return
        if not reason and result == RESULTS[Status.INVALID] and not kb.is_feasible(action):
            reason = kb.why(kb.actions[action])
        kb.cancel_action(action, result, reason)


class Progress:
    """What one behaviour saved of an action; a behaviour of the same action and name finds it again."""

    def __init__(self, kb: KnowledgeBase, name: str) -> None:
        self._kb = kb
        self._name = name

    def saved(self, action: str) -> object | None:
        """Return what was saved last, None for nothing."""
        return _ledger(self._kb).progress.get((action, self._name))

    def save(self, action: str, progress: object | None) -> None:
        """Keep this instead of what was saved before; None keeps nothing."""
        kept = _ledger(self._kb).progress
        if progress is None:
            kept.pop((action, self._name), None)
        else:
            kept[action, self._name] = progress

    def forget(self) -> None:
        """Drop what was saved, of whichever action."""
        kept = _ledger(self._kb).progress
        for key in [key for key in kept if key[1] == self._name]:
            del kept[key]


def forget_progress(kb: KnowledgeBase) -> None:
    """Drop what interrupted actions saved: the next mission with this knowledge base begins at the beginning."""
    _ledger(kb).progress.clear()


class Reason:
    """Why an action has its status, in words: asked for anew only when what is known has changed.

    The sentence is as of that change: a value that has moved on since without changing any status is not in it.
    """

    def __init__(self, kb: KnowledgeBase) -> None:
        self._kb = kb
        self._asked: tuple[str, int] | None = None
        self._sentence = ""

    def why(self, action: str) -> str:
        """Return the sentence."""
        asked = (action, self._kb.revision)
        if asked != self._asked:
            self._asked, self._sentence = asked, self._kb.why(self._kb.actions[action])
        return self._sentence


class Patience:
    """Waits until the robot is configured for an action, but not for ever.

    Args:
        kb: the knowledge base to ask.
        timeout: how long [s], by the clock of the knowledge base.
    """

    def __init__(self, kb: KnowledgeBase, timeout: float) -> None:
        if not timeout > 0:
            raise ValueError(f"a time-out is more than 0 s, or math.inf for none; not {timeout!r}")
        self._kb = kb
        self._timeout = timeout
        self._reason = Reason(kb)
        self._since = math.nan

    def begin(self) -> None:
        """Count the time from now."""
        self._since = self._kb.now

    def look(self, action: str) -> tuple[Status, str]:
        """Return SUCCESS when the robot is ready, RUNNING while it is not, FAILURE when it will not be; and why."""
        kb = self._kb
        if not kb.is_feasible(action):
            return Status.FAILURE, self._reason.why(action)
        lacking = self._lacking(action)
        if not lacking:
            return Status.SUCCESS, ""
        if kb.now - self._since >= self._timeout:
            return Status.FAILURE, f"not ready within {self._timeout:g} s: {lacking}"
        return Status.RUNNING, f"waiting: {lacking}"

    def _lacking(self, action: str) -> str:
        """Why it cannot start yet: its functions are not solved, or a plan is still being carried out."""
        if self._kb.actions[action].status is not Verdict.SOLVED:
            return self._reason.why(action)
        plan = self._kb.pending_plan
        return "" if plan is None else f"the robot is being reconfigured ({plan})"
