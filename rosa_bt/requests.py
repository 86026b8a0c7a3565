"""Who has requested which action, what still halts, and what interrupted actions saved.

All of this belongs to a knowledge base and not to behaviours, because behaviours come and go: a
tree switches between two behaviours that do the same action, and a plan makes a new one for each
step.
"""

import logging
import math
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Parallel

from kb import KnowledgeBase
from kb import Status as ElementStatus
from rosa_bt.exceptions import path_of, report

_log = logging.getLogger(__name__)
SUCCESS = Status.SUCCESS
FAILURE = Status.FAILURE
RUNNING = Status.RUNNING
INVALID = Status.INVALID
_RESULTS = {
    SUCCESS: "completed",
    FAILURE: "failed",
    INVALID: "abandoned",
}


@dataclass
class Requests:
    """The requests and the progress of behaviours, for one knowledge base."""

    open: dict["ActionRequest", str] = field(default_factory=dict)
    """The actions that behaviours request. When a tree switches between two behaviours, the new one
    begins before the old one is stopped, so an action may be there twice."""
    halting: dict["ActionRequest", str] = field(default_factory=dict)
    """Of these, the requests of interrupted actions that need time to stop, with why they were
    interrupted."""
    progress: dict[tuple[str, str], object] = field(default_factory=dict)
    """What was saved, by action and name of the behaviour."""
    reasons: dict[str, tuple[int, str]] = field(default_factory=dict)
    """Why an action has its status: the revision for which this holds, and the sentence."""
    advanced_at: float = -math.inf


_requests: WeakKeyDictionary[KnowledgeBase, Requests] = WeakKeyDictionary()


def requests_of(kb: KnowledgeBase) -> Requests:
    """Return the requests of a knowledge base; what an earlier program left open is abandoned."""
    if kb not in _requests:
        _requests[kb] = Requests()
        for action in kb.store.left if kb.store is not None else ():
            if action in kb.actions:
                kb.cancel_action(action, "abandoned", "the program that requested it has ended")
    return _requests[kb]


def forget_progress(kb: KnowledgeBase, name: str | None = None) -> None:
    """Drop the progress that interrupted actions saved: the next mission starts afresh.

    Args:
        kb: the knowledge base.
        name: of the behaviour; without it, all is dropped.
    """
    progress = requests_of(kb).progress
    for key in list(progress):
        if name in (None, key[1]):
            del progress[key]


def why(kb: KnowledgeBase, action: str) -> str:
    """Return why an action has its status; cached, with its values, until any status changes."""
    reasons = requests_of(kb).reasons
    cached = reasons.get(action)
    if cached is None or cached[0] != kb.revision:
        reasons[action] = cached = kb.revision, kb.why(kb.actions[action])
    return cached[1]


def components_of(kb: KnowledgeBase, action: str) -> set[str]:
    """Return the components of all designs of the functions that an action requires."""
    components = set[str]()
    for function in kb.actions[action].functions:
        for design in kb.functions[function].designs:
            components.update(kb.designs[design].components)
    return components


def advance_halting(kb: KnowledgeBase) -> None:
    """Call `halting` of each interrupted action that is not over yet."""
    requests = requests_of(kb)
    requests.advanced_at = kb.now
    for request in tuple(requests.halting):
        request.advance_halting()


def end_halting(kb: KnowledgeBase) -> None:
    """Release what still halts at once."""
    for request in tuple(requests_of(kb).halting):
        request.end_halting(f"the tree was shut down while {request.owner.name} was halting")


class ActionRequest:
    """The request of one behaviour, from `admit` to the first `close`.

    Args:
        owner: the behaviour; it has an `action` and a `preference`, and says whether to `wait` for
            the robot's configuration.
    """

    def __init__(self, owner: Any, kb: KnowledgeBase) -> None:  # noqa: ANN401  # a Requester
        self.owner = owner
        self._kb = kb
        self._requests = requests_of(kb)
        self._halting_since = math.nan
        self._is_ready = False

    @property
    def is_halting(self) -> bool:
        """Whether the owner was interrupted and has not halted yet."""
        return self in self._requests.halting

    def admit(self) -> Status:
        """Return SUCCESS if the owner may work, RUNNING while it waits, else FAILURE.

        The reason becomes the owner's feedback. If the action became unfeasible, the owner is
        stopped.
        """
        owner = self.owner
        is_new = self not in self._requests.open or self.is_halting
        action = owner.action if is_new else self._requests.open[self]
        objection = ""
        if is_new or not owner.even_if_unfeasible:
            objection = self._objection(action)
        if is_new and not objection:
            owner.feedback_message = self._blocking(action)
            if owner.feedback_message:
                return RUNNING
            self._requests.open[self] = action  # before the knowledge base knows of it
            reply = self._kb.request_action(action, owner.preference)
            if not reply:
                del self._requests.open[self]
                objection = reply.reason
        elif objection:
            owner.stop(INVALID)  # interrupted, not failed: the action is unfeasible
        if objection:
            owner.feedback_message = objection
            return FAILURE
        if self._is_ready:
            return SUCCESS
        owner.feedback_message = self._lacking(action)
        self._is_ready = not owner.feedback_message
        return SUCCESS if self._is_ready else RUNNING

    def _objection(self, action: str) -> str:
        """Return why an action cannot begin or go on; empty if it can."""
        return "" if self._kb.is_feasible(action) else why(self._kb, action)

    def _lacking(self, action: str) -> str:
        """Return what the owner waits for; empty if for nothing."""
        kb = self._kb
        if not self.owner.wait:
            return ""
        if kb.actions[action].status is not ElementStatus.SOLVED:
            return f"waiting: {why(kb, action)}"
        plan = kb.pending_plan
        return f"waiting: the robot is being reconfigured ({plan})" if plan else ""

    def close(self, status: Status, reason: str) -> None:
        """Release the action; the last of its requesters cancels the request, with its result.

        After an interrupt in here, a second call finishes the work; the result is reported once.
        """
        self._is_ready = False
        action = self._requests.open.get(self)
        if action is None:
            return
        is_last = [*self._requests.open.values()].count(action) == 1
        if is_last:
            if status is INVALID:
                reason = reason or self._objection(action)
            reason = "" if status is SUCCESS else reason
            self._kb.cancel_action(action, _RESULTS[status], reason)
        self._requests.open.pop(self, None)

    def _blocking(self, action: str) -> str:
        """Return what an action has to wait for before it is requested; empty if for nothing."""
        requests = self._requests
        if requests.halting and self._kb.now > requests.advanced_at:
            advance_halting(self._kb)  # no runner does it
        for request in requests.open:
            owner = request.owner
            is_leaving = request.is_halting or self._displaces(request)
            if is_leaving and (request is self or self._excludes(request, action)):
                waiting = f"waiting until {owner.name} has halted: {owner.feedback_message}"
                return waiting.removesuffix(": ")
        return ""

    def _excludes(self, other: "ActionRequest", action: str) -> bool:
        """Tell whether the action of the owner cannot begin while another one halts."""
        halting = self._requests.open[other]
        if action == halting or self.owner.exclusive or other.owner.exclusive:
            return True
        return not components_of(self._kb, action).isdisjoint(components_of(self._kb, halting))

    def _displaces(self, other: "ActionRequest") -> bool:
        """Tell whether another owner is interrupted, and halts, as soon as this one is RUNNING."""
        if other.owner.halts_at_once or other.owner.status is not RUNNING:
            return False
        mine = set(path_of(self.owner))
        for node in path_of(other.owner):
            if node in mine:
                return not is_parallel(node)
        return False

    def halt(self) -> None:
        """Begin to halt the owner, which was interrupted.

        The request stays open until that is over.
        """
        requests = self._requests
        if self in requests.open and not self.is_halting:
            self._halting_since = requests.advanced_at = self._kb.now
            requests.halting[self] = self._objection(requests.open[self])
            self.advance_halting()

    def advance_halting(self) -> None:
        """Call `halting` of the owner once; release the request if that is over, or too late."""
        owner = self.owner
        status = RUNNING
        try:
            status = owner.halting()
            if type(status) is not Status:
                advice = "return Status.RUNNING until the robot has stopped, then Status.SUCCESS"
                raise TypeError(f"halting returned {status!r}; {advice}")
        except Exception as error:
            report(owner, error, " (while halting)")
        if status in (SUCCESS, FAILURE, INVALID):
            self.end_halting("")
        elif self._kb.now - self._halting_since >= owner.halting_timeout - 1e-9:
            late = f"{owner.name} did not halt within {owner.halting_timeout:g} s"
            reason = f"{late}: {owner.feedback_message}".removesuffix(": ")
            _log.error("%s", reason)
            self.end_halting(reason)

    def end_halting(self, problem: str) -> None:
        """Release the request of an owner that halted, or that is no longer waited for."""
        reason = self._requests.halting.pop(self, "")
        self.close(INVALID, "; ".join(filter(None, [reason, problem])))


def is_parallel(node: Behaviour) -> bool:
    """Tell whether the children of a node run side by side."""
    return bool(getattr(node, "is_side_by_side", isinstance(node, Parallel)))
