"""Leaves: conditions that ask a knowledge base, and actions that tell it what is being done."""

import logging
import math
from collections.abc import Iterator

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.ports import PortInformation, PortsMixin

from kb import KnowledgeBase
from kb.status import OPERATORS
from rosa_bt.elements import StatusView, find_element, status_of_kind
from rosa_bt.endings import told
from rosa_bt.requests import RESULTS, ActionRequest, Patience, Progress, Reason

__all__ = [
    "ActionBehaviour",
    "HasStatus",
    "IsActionFeasible",
    "KbBehaviour",
    "Measurement",
    "RosaAction",
    "WaitForArchitecture",
]

_log = logging.getLogger(__name__)


class KbBehaviour(PortsMixin, Behaviour):
    """A leaf that knows a knowledge base; what its constructor is not given, its ports carry.

    An exception in it is its FAILURE, with the text as feedback.
    """

    INPUT_PORTS: dict[str, PortInformation] = {}  # noqa: RUF012  # py_trees declares it so
    OUTPUT_PORTS: dict[str, PortInformation] = {}  # noqa: RUF012  # py_trees declares it so

    def __init_subclass__(cls, *, tag: str | None = None, register: bool = False) -> None:
        """Leave py_trees' process-wide registry of tags alone unless asked: names of classes need not be unique."""
        super().__init_subclass__(tag=tag, register=register)

    def __init__(self, name: str, kb: KnowledgeBase, *, behaviour_class_name: str | None = None) -> None:
        super().__init__(name, behaviour_class_name=behaviour_class_name)
        self.kb = kb

    def tick(self) -> Iterator[Behaviour]:
        """Do what py_trees does at a tick; an exception is a failure."""
        try:
            new_status = self._advance()
        except Exception as error:
            self.feedback_message = told(error)
            _log.debug("%s failed", self.name, exc_info=True)
            new_status = Status.FAILURE
        if new_status is Status.RUNNING:
            self.status = new_status
        else:
            self.stop(new_status)
        yield self

    def stop(self, new_status: Status) -> None:
        """Terminate the round; an exception in that turns success into failure, an interruption stays one."""
        try:
            self.terminate(new_status)
        except Exception as error:
            self.feedback_message = f"{told(error)} (at the end)"
            new_status = Status.FAILURE if new_status is Status.SUCCESS else new_status
        self.status = new_status
        self.iterator = self.tick()

    def _advance(self) -> Status:
        if self.status is not Status.RUNNING:
            self.initialise()
        return self._updated()

    def _updated(self) -> Status:
        status = self.update()
        if type(status) is not Status:
            raise TypeError(f"update returned {status!r}, which is no py_trees.common.Status")
        return status


class ActionBehaviour(KbBehaviour):
    """A behaviour about one ROSA action, named directly or through the port `action`."""

    INPUT_PORTS: dict[str, PortInformation] = {  # noqa: RUF012  # py_trees declares it so
        "action": PortInformation(str, required=False, description="name of the ROSA action")
    }

    def __init__(
        self, name: str, kb: KnowledgeBase, action: str | None = None, *, behaviour_class_name: str | None = None
    ) -> None:
        super().__init__(name, kb, behaviour_class_name=behaviour_class_name)
        self._action = action
        if action is not None:
            kb.is_feasible(action)  # an unknown action is found here, not in the middle of a mission

    @property
    def action(self) -> str:
        """Name of the ROSA action: as constructed, or else what the port `action` carries."""
        if self._action is None:
            return str(self.get_input("action"))
        return self._action


class IsActionFeasible(ActionBehaviour):
    """Condition: SUCCESS while the action's status is not "unfeasible", FAILURE with the reason otherwise.

    Args:
        name: what the behaviour is called in pictures of the tree.
        kb: the knowledge base to ask.
        action: name of the ROSA action; without it, the port `action` gives it.

    Raises:
        kb.UnknownName: no such action; the message lists the nearest ones.
    """

    def __init__(
        self, name: str, kb: KnowledgeBase, action: str | None = None, *, behaviour_class_name: str | None = None
    ) -> None:
        super().__init__(name, kb, action, behaviour_class_name=behaviour_class_name)
        self._reason = Reason(kb)

    def update(self) -> Status:
        """Ask the knowledge base."""
        action = self.action
        if self.kb.is_feasible(action):
            self.feedback_message = ""
            return Status.SUCCESS
        self.feedback_message = self._reason.why(action)
        return Status.FAILURE


class HasStatus(KbBehaviour):
    """Condition: SUCCESS while an element of the model has a status, FAILURE with the reason otherwise.

    Whether an action can be done is the question of `IsActionFeasible`: one that is being done is not "feasible" but
    "solved".

    Args:
        name: what the behaviour is called in pictures of the tree.
        kb: the knowledge base to ask.
        element: name of an action, function, component, design or configuration, or a view such as
            `kb.components["camera"]` where elements of several kinds share the name; also a port, for names.
        status: one that an element of this kind can have, e.g. "failure"; also a port.

    Raises:
        kb.UnknownName, kb.AmbiguousName, kb.InvalidValue: there is no such element, several, or never that status.
    """

    INPUT_PORTS: dict[str, PortInformation] = {  # noqa: RUF012  # py_trees declares it so
        "element": PortInformation(str, required=False, description="name of an element of the model"),
        "status": PortInformation(str, required=False, description="a status that it can have"),
    }

    def __init__(
        self,
        name: str,
        kb: KnowledgeBase,
        element: str | StatusView | None = None,
        status: str | None = None,
        *,
        behaviour_class_name: str | None = None,
    ) -> None:
        super().__init__(name, kb, behaviour_class_name=behaviour_class_name)
        self._element = None if element is None else find_element(kb, element)
        self._status = status
        if self._element is not None and status is not None:
            status_of_kind(self._element, status)

    def update(self) -> Status:
        """Ask the knowledge base."""
        element = self._element or find_element(self.kb, str(self.get_input("element")))
        wanted = status_of_kind(element, self._status or str(self.get_input("status")))
        if element.status is wanted:
            self.feedback_message = ""
            return Status.SUCCESS
        self.feedback_message = f"{element.name} is not {wanted} but {element.status}"
        return Status.FAILURE


class Measurement(KbBehaviour):
    """Condition: SUCCESS while the latest measurement of an attribute compares as asked, FAILURE otherwise.

    Args:
        name: what the behaviour is called in pictures of the tree.
        kb: the knowledge base to ask.
        attribute: its name; also a port.
        operator: one of `>=`, `>`, `<=`, `<`; also a port.
        value: what to compare with, in the attribute's unit; also a port.
        unknown: what to return while the attribute is not measured, or was too long ago.

    Raises:
        kb.UnknownName: no such attribute; the message lists the nearest ones.
        ValueError: no such operator.
    """

    INPUT_PORTS: dict[str, PortInformation] = {  # noqa: RUF012  # py_trees declares it so
        "attribute": PortInformation(str, required=False, description="name of what is measured"),
        "operator": PortInformation(str, required=False, description="one of >=, >, <=, <"),
        "value": PortInformation(float, required=False, description="what to compare with"),
    }

    def __init__(
        self,
        name: str,
        kb: KnowledgeBase,
        attribute: str | None = None,
        operator: str | None = None,
        value: float | None = None,
        *,
        unknown: Status = Status.FAILURE,
        behaviour_class_name: str | None = None,
    ) -> None:
        super().__init__(name, kb, behaviour_class_name=behaviour_class_name)
        self._attribute = None if attribute is None else kb.attributes[attribute]
        self._operator = None if operator is None else _operator(operator)
        self._value = value
        self._unknown = unknown

    def update(self) -> Status:
        """Ask the knowledge base."""
        attribute = self._attribute or self.kb.attributes[str(self.get_input("attribute"))]
        sign = self._operator or _operator(str(self.get_input("operator")))
        threshold = float(self.get_input("value")) if self._value is None else self._value
        measured = attribute.value
        if measured is None or attribute.is_stale:
            self.feedback_message = f"{attribute.name} is not measured{'' if measured is None else ' any more'}"
            return self._unknown
        if OPERATORS[sign](measured, threshold):
            self.feedback_message = ""
            return Status.SUCCESS
        self.feedback_message = f"{attribute.name} {measured:.6g} is not {sign} {threshold:.6g}"
        return Status.FAILURE


class WaitForArchitecture(ActionBehaviour):
    """Condition that waits: SUCCESS once the robot is configured for an action that somebody has requested.

    That is when every function of the action is solved (a design and configurations are selected, the components are
    active) and no reconfiguration plan is open. RUNNING before that, with what is lacking as feedback; FAILURE with
    the reason when the action is unfeasible, or when the time is over.

    Args:
        name: what the behaviour is called in pictures of the tree.
        kb: the knowledge base to ask.
        action: name of the ROSA action; without it, the port `action` gives it.
        timeout: how long to wait [s], by the clock of the knowledge base.

    Raises:
        kb.UnknownName: no such action; the message lists the nearest ones.
    """

    def __init__(
        self,
        name: str,
        kb: KnowledgeBase,
        action: str | None = None,
        *,
        timeout: float = math.inf,
        behaviour_class_name: str | None = None,
    ) -> None:
        super().__init__(name, kb, action, behaviour_class_name=behaviour_class_name)
        self._patience = Patience(kb, timeout)

    def initialise(self) -> None:
        """Begin to wait."""
        self._patience.begin()

    def update(self) -> Status:
        """Ask the knowledge base."""
        status, self.feedback_message = self._patience.look(self.action)
        return status


class RosaAction(ActionBehaviour):
    """Action: what a mission does while the robot is configured for it; a mission subclasses this.

    A subclass implements `update`, and `initialise` and `terminate` if it needs them, as for any py_trees behaviour;
    it need not call them on its base. The action is requested before `initialise` and released after `terminate`,
    exactly once, however the behaviour ends: SUCCESS is "completed", FAILURE "failed", an interruption or the tree's
    shutdown "abandoned". An exception in the subclass is FAILURE, with its text as feedback. A refused request is
    FAILURE with the reason, and the subclass is not called at all.

    An action that can be continued says where it is, in `save_progress`, and goes on from there in `restore_progress`.

    Args:
        name: what the behaviour is called in pictures of the tree.
        kb: the knowledge base to tell.
        action: name of the ROSA action; without it, the port `action` gives it.
        preference: name of the attribute to favour when a configuration is chosen, or None; also a port.
        wait: start working only when the robot is configured for the action; RUNNING before that, with what is lacking
            as feedback. By default it starts in the tick in which it requests.
        timeout: how long to wait [s], by the clock of the knowledge base; then FAILURE with what is lacking.

    Raises:
        kb.UnknownName: no such action; the message lists the nearest ones.
    """

    INPUT_PORTS: dict[str, PortInformation] = {  # noqa: RUF012  # py_trees declares it so
        **ActionBehaviour.INPUT_PORTS,
        "preference": PortInformation(str, required=False, default_value="", description="attribute to favour"),
    }

    def __init__(
        self,
        name: str,
        kb: KnowledgeBase,
        action: str | None = None,
        preference: str | None = None,
        *,
        wait: bool = False,
        timeout: float = math.inf,
        behaviour_class_name: str | None = None,
    ) -> None:
        super().__init__(name, kb, action, behaviour_class_name=behaviour_class_name)
        self._preference = preference
        self._request = ActionRequest(kb)
        self._progress = Progress(kb, name)
        self._patience = Patience(kb, timeout) if wait else None
        self._has_begun = False

    @property
    def preference(self) -> str | None:
        """Name of the attribute to favour: as constructed, or else what the port `preference` carries, if anything."""
        if self._preference is None and self._blackboard_client is not None:
            return str(self.get_input("preference")) or None
        return self._preference

    def save_progress(self) -> object | None:
        """Return where the action is, or None (the default) if it starts afresh next time.

        Called before `terminate` when the action is interrupted or has failed. What is returned is kept by action and
        name of the behaviour until the action succeeds or the mission begins anew: when a `TreeRunner` takes the tree
        over or shuts it down, when its root has succeeded, or at `forget_progress(kb)`.
        """
        return None

    def restore_progress(self, progress: object) -> None:
        """Go on from what `save_progress` returned; called after `initialise`, and only if something was saved."""

    def forget_progress(self) -> None:
        """Drop what was saved: the next start is at the beginning."""
        self._progress.forget()

    def stop(self, new_status: Status) -> None:
        """Save progress, terminate the round and release the request, also when the subclass raises."""
        has_begun, self._has_begun = self._has_begun, False
        if has_begun:
            self._keep(new_status)
            super().stop(new_status)
        else:
            self.status = new_status
        self._request.close(RESULTS[self.status], self.feedback_message if self.status is Status.FAILURE else "")

    def shutdown(self) -> None:
        """Stop if still running; called when the tree is shut down."""
        if self.status is Status.RUNNING:
            self.stop(Status.INVALID)

    def _advance(self) -> Status:
        """Request the action when a round begins, wait if asked to, then work."""
        if self.status is not Status.RUNNING and not self._ask():
            return Status.FAILURE
        if not self._has_begun:
            if self._patience is not None:
                status, self.feedback_message = self._patience.look(self.action)
                if status is not Status.SUCCESS:
                    return status
            self._begin()
        return self._updated()

    def _ask(self) -> bool:
        reply = self._request.open(self.action, self.preference)
        self.feedback_message = "" if reply else reply.reason
        if self._patience is not None:
            self._patience.begin()
        return bool(reply)

    def _begin(self) -> None:
        self._has_begun = True
        self.initialise()
        saved = self._progress.saved(self.action)
        if saved is not None:
            self.restore_progress(saved)

    def _keep(self, new_status: Status) -> None:
        try:
            self._progress.save(self.action, None if new_status is Status.SUCCESS else self.save_progress())
        except Exception as error:
            self.feedback_message = f"{told(error)} (progress is not saved)"


def _operator(sign: str) -> str:
    if sign not in OPERATORS:
        raise ValueError(f"{sign!r} compares nothing; an operator is one of {', '.join(OPERATORS)}")
    return sign
