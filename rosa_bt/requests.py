"""Who has requested which action, what still halts, and what interrupted actions saved.

All of this belongs to a knowledge base and not to behaviours, because behaviours come and go: a
tree switches between two behaviours that do the same action, and a plan makes a new one for each
step.
"""

import json
import logging
import math
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Parallel

from kb import Event, KnowledgeBase, UnknownName
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


class Requester(Behaviour):
    """A behaviour that requests an action while it runs: `RosaAction` and `ForAction`.

    Attributes:
        exclusive: wait until every interrupted action has halted, and let every other action wait.
        even_if_unfeasible: go on when the action becomes unfeasible while it runs.
        halting_timeout: how long an interrupted action may take to halt [s].
    """

    exclusive: bool = False
    even_if_unfeasible: bool = False
    halting_timeout: float = 10.0

    def halting(self) -> Status:
        """Return RUNNING until the robot has stopped doing the action; anything else ends halting.

        Called after an interruption, once `terminate` has returned, and then once in each tick. The
        action stays requested meanwhile, so its components stay configured. An action that is next
        waits for it if it is exclusive, or shares a component or its name with this one. The
        default ends at once. When `halting_timeout` has passed, the others wait no longer; the log
        says so, and so does the result of the request, with `feedback_message`.
        """
        return SUCCESS


@dataclass(slots=True)
class Requests:
    """The requests and the progress of behaviours, for one knowledge base."""

    requesters: dict[str, dict["ActionRequest", str | None]] = field(default_factory=dict)
    """For each action, the requests of behaviours, with their preferences. When a tree switches
    between two behaviours, the new one begins before the old one is stopped."""
    halting: dict["ActionRequest", str] = field(default_factory=dict)
    """The requests of interrupted actions that need time to stop, with why they were
    interrupted."""
    progress: dict[tuple[str, str], object] = field(default_factory=dict)
    """What was saved, by action and name of the behaviour."""
    earlier: set[tuple[str, str]] = field(default_factory=set)
    """The keys of what an earlier program left in the store, and that is not restored yet."""
    reasons: dict[str, tuple[int, str]] = field(default_factory=dict)
    """Why an action has its status: the revision for which this holds, and the sentence."""
    advanced_at: float = -math.inf


_requests: WeakKeyDictionary[KnowledgeBase, Requests] = WeakKeyDictionary()


def requests_of(kb: KnowledgeBase) -> Requests:
    """Return the requests of a knowledge base; what an earlier program left open is abandoned."""
    requests = _requests.get(kb)
    if requests is None:
        requests = _requests.setdefault(kb, Requests())
        for key, saved in kb.history.progress.items():
            requests.progress[key] = json.loads(saved)
        requests.earlier.update(requests.progress)
        for action in kb.store.left if kb.store is not None else ():
            if action in kb.actions:
                ended = "the program that requested it has ended"
                kb.cancel_action(action, "abandoned", ended)
    return requests


def forget_progress(
    kb: KnowledgeBase, name: str | None = None, *, keeps_earlier: bool = False
) -> None:
    """Drop the progress that interrupted actions saved: the next mission starts afresh.

    Args:
        kb: the knowledge base.
        name: of the behaviour; without it, all is dropped.
        keeps_earlier: keep what an earlier program left.
    """
    requests = requests_of(kb)
    kept = requests.earlier if keeps_earlier else set()
    for key in {*requests.progress, *kb.history.progress} - kept:
        if name in (None, key[1]):
            requests.progress.pop(key, None)
            requests.earlier.discard(key)
            if key in kb.history.progress:
                store_progress(kb, *key, "")


def store_progress(kb: KnowledgeBase, action: str, name: str, saved: str) -> None:
    """Record the progress of a behaviour, as JSON, for the next program; empty for none."""
    kb.replay(Event(0, kb.now, "progress", (action, name, saved)))


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
    for function in kb.actions[action].functions if action in kb.actions else ():
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
            the robot's configuration, and for how long (`timeout` [s]).
    """

    def __init__(self, owner: Any, kb: KnowledgeBase) -> None:  # noqa: ANN401  # a Requester
        if not owner.timeout > 0:
            problem = f"a time-out is more than 0 s, or math.inf for none; not {owner.timeout!r}"
            raise ValueError(problem)
        self.owner = owner
        self._kb = kb
        self._since = math.nan
        self._halting_since = math.nan
        self._action: str | None = None
        self._is_ready = False
        requests_of(kb)

    @property
    def is_halting(self) -> bool:
        """Whether the owner was interrupted and has not halted yet."""
        return self in requests_of(self._kb).halting

    def admit(self) -> Status:
        """Return SUCCESS if the owner may work, RUNNING while it waits, else FAILURE.

        The reason becomes the owner's feedback. If the action became unfeasible, the owner is
        stopped.
        """
        owner = self.owner
        objection = ""
        if self._action is None or self.is_halting:
            action = owner.action
            if not self._kb.is_feasible(action):
                objection = why(self._kb, action)
            elif blocking := self._blocking(action):
                owner.feedback_message = blocking
                return RUNNING
            else:
                objection = self._open(action, owner.preference)
        elif not owner.even_if_unfeasible:
            objection = self._objection(self._action)
            if objection:
                owner.stop(INVALID)  # interrupted, not failed: the action is unfeasible
        if objection:
            owner.feedback_message = objection
            return FAILURE
        lacking = "" if self._is_ready else self._lacking()
        if lacking and self._kb.now - self._since >= owner.timeout:
            owner.feedback_message = f"not ready within {owner.timeout:g} s: {lacking}"
            return FAILURE
        if lacking:
            owner.feedback_message = f"waiting: {lacking}"
            return RUNNING
        if not self._is_ready:
            owner.feedback_message = ""
        self._is_ready = True
        return SUCCESS

    def _open(self, action: str, preference: str | None) -> str:
        """Request an action; return why it is refused. It is registered before it is requested."""
        kb = self._kb
        requesters = requests_of(kb).requesters.setdefault(action, {})
        self._since = kb.now
        self._action = action
        requesters[self] = preference
        reply = kb.request_action(action, preference)
        if reply:
            return ""
        del requesters[self]
        self._action = None
        return reply.reason

    def _objection(self, action: str) -> str:
        """Return why a requested action cannot go on; empty if it can."""
        try:
            return "" if self._kb.is_feasible(action) else why(self._kb, action)
        except UnknownName:
            return f"{action} is no longer in the model"

    def _lacking(self) -> str:
        """Return why the robot is not configured for the action; empty if it is."""
        kb = self._kb
        action = str(self._action)
        if not self.owner.wait:
            return ""
        if kb.actions[action].status is not ElementStatus.SOLVED:
            return why(kb, action)
        return f"the robot is being reconfigured ({kb.pending_plan})" if kb.pending_plan else ""

    def close(self, status: Status, reason: str) -> None:
        """Release the action; the last of its requesters cancels the request, with its result.

        After an interrupt in here, a second call finishes the work; the result is reported once.
        """
        action = self._action
        kb = self._kb
        if action is None:
            return
        others = requests_of(kb).requesters.setdefault(action, {})
        others.pop(self, None)
        if not others and action in kb.actions:  # removing an action cancels its request
            if status is INVALID and not reason and not kb.is_feasible(action):
                reason = kb.why(kb.actions[action])
            kb.cancel_action(action, _RESULTS[status], "" if status is SUCCESS else reason)
        self._action = None
        self._is_ready = False

    def _blocking(self, action: str) -> str:
        """Return what an action has to wait for before it is requested; empty if for nothing."""
        requests = requests_of(self._kb)
        if requests.halting and self._kb.now > requests.advanced_at:
            advance_halting(self._kb)  # no runner does it
        for request in requests.halting:
            if request is self or self._excludes(request, action):
                owner = request.owner
                detail = f": {owner.feedback_message}" if owner.feedback_message else ""
                return f"waiting until {owner.name} has halted{detail}"
        for requesters in requests.requesters.values():
            for request in requesters:
                owner = request.owner
                if not (owner.status is RUNNING and needs_halting(owner)):
                    continue
                if self._displaces(request) and self._excludes(request, action):
                    return f"waiting until {owner.name} has halted"
        return ""

    def _excludes(self, other: "ActionRequest", action: str) -> bool:
        """Tell whether the action of the owner cannot begin while another one halts."""
        halting = str(other._action)
        if action == halting or self.owner.exclusive or other.owner.exclusive:
            return True
        return not components_of(self._kb, action).isdisjoint(components_of(self._kb, halting))

    def _displaces(self, other: "ActionRequest") -> bool:
        """Tell whether the other owner will be interrupted as soon as this one is RUNNING."""
        mine = set(path_of(self.owner))
        for node in path_of(other.owner):
            if node in mine:
                return not is_parallel(node)
        return False

    def halt(self) -> None:
        """Begin to halt the owner, which was interrupted.

        The request stays open until that is over.
        """
        if self._action is None or self.is_halting:
            return
        kb = self._kb
        action = self._action
        is_unfeasible = action in kb.actions and not kb.is_feasible(action)
        reason = kb.why(kb.actions[action]) if is_unfeasible else ""
        requests = requests_of(kb)
        self._halting_since = requests.advanced_at = kb.now
        requests.halting[self] = reason
        self.advance_halting()

    def advance_halting(self) -> None:
        """Call `halting` of the owner once; release the request if that is over, or too late."""
        owner = self.owner
        try:
            is_over = owner.halting() is not RUNNING
        except Exception as error:
            report(self.owner, error, " (while halting)")
            is_over = True
        if is_over:
            self.end_halting("")
        elif self._kb.now - self._halting_since >= owner.halting_timeout - 1e-9:
            detail = f": {owner.feedback_message}" if owner.feedback_message else ""
            reason = f"{owner.name} did not halt within {owner.halting_timeout:g} s{detail}"
            _log.error("%s", reason)
            self.end_halting(reason)

    def end_halting(self, problem: str) -> None:
        """Release the request of an owner that halted, or that is no longer waited for."""
        reason = requests_of(self._kb).halting.pop(self, "")
        self.close(INVALID, "; ".join(filter(None, [reason, problem])))


def needs_halting(owner: Requester) -> bool:
    """Tell whether a behaviour may take time to halt."""
    return getattr(owner.halting, "__func__", None) is not Requester.halting


def is_parallel(node: Behaviour) -> bool:
    """Tell whether the children of a node run side by side."""
    return bool(getattr(node, "is_side_by_side", isinstance(node, Parallel)))
