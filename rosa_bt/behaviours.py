"""The two behaviours of the pattern "feasible, then act": a condition that asks, and an action that requests."""

import logging
from collections import Counter
from collections.abc import Iterator
from weakref import WeakKeyDictionary

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.ports import PortInformation, PortsMixin

from kb import KnowledgeBase

__all__ = ["IsActionFeasible", "RosaAction"]

_log = logging.getLogger(__name__)

_RESULTS = {Status.SUCCESS: "completed", Status.FAILURE: "failed", Status.INVALID: "abandoned"}

# How many running behaviours hold the request of an action: when a tree switches between two behaviours of one action,
# the new one starts before the old one is stopped, and the request has to outlive the switch.
_holders: WeakKeyDictionary[KnowledgeBase, Counter[str]] = WeakKeyDictionary()


class _ActionBehaviour(PortsMixin, Behaviour):
    """A behaviour about one ROSA action, named directly or through the port `action`."""

    def __init_subclass__(cls, *, tag: str | None = None, register: bool = False) -> None:
        """Leave py_trees' process-wide registry of tags alone unless asked: names of classes need not be unique."""
        super().__init_subclass__(tag=tag, register=register)

    def __init__(
        self, name: str, kb: KnowledgeBase, action: str | None = None, *, behaviour_class_name: str | None = None
    ) -> None:
        super().__init__(name, behaviour_class_name=behaviour_class_name)
        self.kb = kb
        self._action = action
        if action is not None:
            kb.is_feasible(action)  # an unknown action is found here, not in the middle of a mission

    @property
    def action(self) -> str:
        """Name of the ROSA action: as constructed, or else what the port `action` carries."""
        if self._action is None:
            return str(self.get_input("action"))
        return self._action


class IsActionFeasible(_ActionBehaviour):
    """Condition: SUCCESS while the action's status is not "unfeasible", FAILURE with the reason otherwise.

    Args:
        name: what the behaviour is called in pictures of the tree.
        kb: the knowledge base to ask.
        action: name of the ROSA action; without it, the port `action` gives it.

    Raises:
        kb.UnknownName: no such action; the message lists the nearest ones.
    """

    INPUT_PORTS: dict[str, PortInformation] = {  # noqa: RUF012  # py_trees declares it so
        "action": PortInformation(str, required=False, description="name of the ROSA action")
    }
    OUTPUT_PORTS: dict[str, PortInformation] = {}  # noqa: RUF012  # py_trees declares it so

    def update(self) -> Status:
        """Ask the knowledge base."""
        action = self.action
        if self.kb.is_feasible(action):
            self.feedback_message = ""
            return Status.SUCCESS
        self.feedback_message = self.kb.why(self.kb.actions[action])
        return Status.FAILURE


class RosaAction(_ActionBehaviour):
    """Action: what a mission does while the robot is configured for it; a mission subclasses this.

    A subclass implements `update`, and `initialise` and `terminate` if it needs them, as for any py_trees behaviour;
    it need not call them on its base. The action is requested before `initialise` and released after `terminate`,
    exactly once, however the behaviour ends: SUCCESS is "completed", FAILURE "failed", an interruption or the tree's
    shutdown "abandoned". An exception in the subclass is FAILURE, with its text as feedback. A refused request is
    FAILURE with the reason, and the subclass is not called at all.

    Args:
        name: what the behaviour is called in pictures of the tree.
        kb: the knowledge base to tell.
        action: name of the ROSA action; without it, the port `action` gives it.
        preference: name of the attribute to favour when a configuration is chosen, or None; also a port.

    Raises:
        kb.UnknownName: no such action; the message lists the nearest ones.
    """

    INPUT_PORTS: dict[str, PortInformation] = {  # noqa: RUF012  # py_trees declares it so
        "action": PortInformation(str, required=False, description="name of the ROSA action"),
        "preference": PortInformation(str, required=False, default_value="", description="attribute to favour"),
    }
    OUTPUT_PORTS: dict[str, PortInformation] = {}  # noqa: RUF012  # py_trees declares it so

    def __init__(
        self,
        name: str,
        kb: KnowledgeBase,
        action: str | None = None,
        preference: str | None = None,
        *,
        behaviour_class_name: str | None = None,
    ) -> None:
        super().__init__(name, kb, action, behaviour_class_name=behaviour_class_name)
        self._preference = preference
        self._held: str | None = None

    @property
    def preference(self) -> str | None:
        """Name of the attribute to favour: as constructed, or else what the port `preference` carries, if anything."""
        if self._preference is None and self._blackboard_client is not None:
            return str(self.get_input("preference")) or None
        return self._preference

    def tick(self) -> Iterator[Behaviour]:
        """Request the action when a round begins, then tick as every behaviour does; an exception is a failure."""
        try:
            if self.status is Status.RUNNING or self._request():
                yield from super().tick()
                return
        except Exception as error:
            self.feedback_message = f"{type(error).__name__}: {error}"
            _log.debug("%s failed", self.name, exc_info=True)
        self.stop(Status.FAILURE)
        yield self

    def stop(self, new_status: Status) -> None:
        """Terminate the round and release the request, also when `terminate` raises."""
        try:
            super().stop(new_status)
        except Exception as error:
            self.feedback_message = f"{type(error).__name__} in terminate: {error}"
            self.status = new_status
        finally:
            self._release(_RESULTS[new_status])

    def shutdown(self) -> None:
        """Stop if still running; called when the tree is shut down."""
        if self.status is Status.RUNNING:
            self.stop(Status.INVALID)

    def _request(self) -> bool:
        action = self.action
        reply = self.kb.request_action(action, self.preference)
        if reply:
            self._held = action
            _holders.setdefault(self.kb, Counter())[action] += 1
        else:
            self.feedback_message = reply.reason
        return bool(reply)

    def _release(self, result: str) -> None:
        action, self._held = self._held, None
        if action is None:
            return
        holders = _holders[self.kb]
        holders[action] -= 1
        if not holders[action]:
            self.kb.cancel_action(action, result, self.feedback_message if result == "failed" else "")
