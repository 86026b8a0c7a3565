"""Decorators that py_trees does not have: to put any behaviour under an action, and to retry within a tick."""

import math
from collections.abc import Generator, Iterator

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.decorators import Decorator

from kb import KnowledgeBase
from rosa_bt.behaviours import ActionRequest, Careful, halt
from rosa_bt.exceptions import in_words


class ForAction(Careful, Decorator):
    """Ticks any behaviour only while a ROSA action is feasible, and requests the action while the behaviour runs.

    Each tick asks whether the action is feasible. If it is not, the child is stopped, and this fails with the reason.
    Otherwise the action is requested when the child starts, and released once, however the child ends: the result is
    "completed" after SUCCESS, "failed" after FAILURE or an exception (its text is the feedback), else "abandoned".

    Args:
        action: name of the ROSA action.
        child: a leaf or a whole subtree.
        preference: name of the attribute to favour when a configuration is chosen, or None.
        wait: tick the child only when the robot is configured for the action; RUNNING until then.
        timeout: how long to wait [s], by the clock of the knowledge base; then FAILURE, with what is missing.

    Raises:
        kb.UnknownName: no such action; the message lists the nearest ones.
    """

    def __init__(
        self,
        name: str,
        kb: KnowledgeBase,
        action: str,
        child: Behaviour,
        *,
        preference: str | None = None,
        wait: bool = False,
        timeout: float = math.inf,
    ) -> None:
        super().__init__(name, child)
        kb.is_feasible(action)  # an unknown action is found here, not in the middle of a mission
        self.kb = kb
        self.action = action
        self.preference = preference
        self.wait, self.timeout = wait, timeout
        self._request = ActionRequest(kb, timeout if wait else None)

    def advance(self) -> Generator[Behaviour, None, Status]:
        new_status = self._request.admit(self)
        if new_status is Status.SUCCESS:
            yield from self.decorated.tick()
            new_status = self.update()
        return new_status

    def update(self) -> Status:
        self.feedback_message = self.decorated.feedback_message
        return self.decorated.status

    def stop(self, new_status: Status) -> None:
        """Stop the child if it is running, and release the request, also if the child raises.

        The status changes last: after an interrupt in here, a second call does the rest.
        """
        try:
            self.terminate(new_status)
            if new_status is Status.INVALID or self.decorated.status is Status.RUNNING:
                self.decorated.stop(Status.INVALID)
        except Exception as error:
            self.feedback_message = f"{in_words(error)} (at the end)"
        finally:
            halt(self.decorated)
            self._request.close(new_status, self.feedback_message)
        self.status = new_status


class UntilSuccess(Decorator):
    """RUNNING until the child succeeds; a child that fails is ticked once more in the same tick.

    Without this second attempt there would be a tick after which no action is required: the robot would be
    deconfigured between two actions, and configured again a moment later.
    """

    def tick(self) -> Iterator[Behaviour]:
        yield from self.decorated.tick()
        if self.decorated.status is Status.FAILURE:
            yield from self.decorated.tick()
        new_status = self.update()
        if new_status is not Status.RUNNING:
            self.stop(new_status)
        self.status = new_status
        yield self

    def update(self) -> Status:
        return Status.RUNNING if self.decorated.status is Status.FAILURE else self.decorated.status
