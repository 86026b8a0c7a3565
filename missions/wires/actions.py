"""Actions of ROS 2 servers as leaves of a tree, e.g. Nav2's NavigateToPose."""

import math
from base64 import b64encode
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, Final
from uuid import uuid4
from weakref import WeakKeyDictionary

from py_trees.common import Status

from kb import KnowledgeBase
from missions.wires.node import (
    ABORTED,
    CANCELED,
    SUCCEEDED,
    TIMEOUT_S,
    Goal,
    Message,
    Node,
    RosError,
)
from rosa_bt import RosaAction

_POLL_S: Final = 1.0
"""The period of asking whether a server is alive, and of repeating a cancel [s]."""
_nodes: WeakKeyDictionary[KnowledgeBase, Node] = WeakKeyDictionary()


def connect(kb: KnowledgeBase, node: Node) -> None:
    """Let the actions of a knowledge base's trees go over a node; a `Bridge` does this."""
    _nodes[kb] = node


class RosAction(RosaAction):
    """An action that a ROS 2 action server carries out: a goal is sent when it starts.

        RosAction("go home", kb, "go_home", "/navigate_to_pose", "nav2_msgs/action/NavigateToPose",
                  {"pose": {"header": {"frame_id": "map"}, "pose": {"orientation": {"w": 1.0}}}})

    It succeeds when the goal has succeeded. It fails, with the reason, when the goal is rejected or
    aborted, when somebody else cancels it, when nobody serves the action, and when the server dies.
    When it is interrupted, the goal is cancelled; the next action that needs one of the same
    components starts when the server has confirmed that.

    Args:
        server: name of the action server, e.g. "/navigate_to_pose".
        type: of the action, e.g. "nav2_msgs/action/NavigateToPose".
        goal: the fields of the goal as in ROS 2's JSON; or a function that is called for them at
            each start.
        accept_s: how long the server may take to accept the goal [s].
        silence_s: how long it may give no sign of life [s]; infinity for a server that answers
            nothing while it works.
        **options: those of `RosaAction`, e.g. `wait`, and `halting_timeout` for the cancel.

    Attributes:
        result: the fields of the result of the last goal that ended.
        feedback: the fields of the latest feedback.
    """

    def __init__(
        self,
        name: str,
        kb: KnowledgeBase,
        action: str,
        server: str,
        type: str,
        goal: Message | Callable[[], Message],
        *,
        accept_s: float = TIMEOUT_S,
        silence_s: float = TIMEOUT_S,
        **options: Any,  # noqa: ANN401  # those of RosaAction
    ) -> None:
        super().__init__(name, kb, action, **options)
        self.result: Message = {}
        self.feedback: Message = {}
        self._server = f"/{server.strip('/')}"
        self._type = type
        self._message = goal
        self._accept_s = accept_s
        self._silence_s = silence_s
        self._goal: Goal | None = None
        self._ping: Future[Message] | None = None
        self._sent_s = self._alive_s = self._asked_s = math.nan
        self._signs = 0

    @property
    def _node(self) -> Node:
        if self.kb not in _nodes:
            raise RosError("no robot is connected: make a Bridge with this knowledge base first")
        return _nodes[self.kb]

    def initialise(self) -> None:
        """Ask whether the server is there; the goal follows when it answers."""
        self._close()
        self.result = {}
        self.feedback = {}
        self._ask(self._accept_s)

    def update(self) -> Status:
        """Send the goal, then look how far it is."""
        goal = self._goal
        now = self._node.clock()
        if goal is None:
            return self._send(now)
        if goal.is_over:
            return self._end(goal)
        if not goal.is_accepted and now >= self._sent_s + self._accept_s:
            raise RosError(f"{self._server} has not accepted the goal: it rejects it, or is busy")
        if now >= self._last_sign(goal, now) + self._silence_s:
            raise RosError(f"{self._server} gives no sign of life for {self._silence_s:g} s")
        if goal.feedback is not self.feedback:
            self.feedback = goal.feedback
            self.feedback_message = _upper_level(goal.feedback)
        return Status.RUNNING

    def terminate(self, new_status: Status) -> None:
        """Cancel the goal if it has not ended."""
        if self._goal is not None and not self._goal.is_over:
            self._asked_s = self._node.clock()
            self._goal.cancel()

    def halting(self) -> Status:
        """Return RUNNING until the goal has ended; called after an interruption."""
        goal = self._goal
        now = self._node.clock()
        if goal is None or goal.is_over:
            self._close()
            return Status.SUCCESS
        if now >= self._asked_s + _POLL_S:
            self._asked_s = now
            goal.cancel()
        self.feedback_message = f"{self._server} has not confirmed the cancel"
        return Status.RUNNING

    def _send(self, now: float) -> Status:
        """Send the goal when the server has answered; raise `RosError` if there is none."""
        if self._ping is None or not self._ping.done():
            return Status.RUNNING
        self._ping.result()
        message = self._message() if callable(self._message) else self._message
        self._goal = self._node.send_goal(self._server, self._type, message)
        self._signs = 0
        self._sent_s = self._alive_s = now
        return Status.RUNNING

    def _end(self, goal: Goal) -> Status:
        self._close()
        self.result = goal.result
        if goal.error:
            raise RosError(goal.error)
        if goal.status == SUCCEEDED:
            self.feedback_message = _upper_level(goal.result)
            return Status.SUCCESS
        end = {CANCELED: "was cancelled", ABORTED: "was aborted"}.get(goal.status, "has ended")
        details = _upper_level(goal.result)
        raise RosError(f"the goal of {self._server} {end}: {details}".removesuffix(": "))

    def _last_sign(self, goal: Goal, now: float) -> float:
        """Return when the server last gave a sign of life [s]; ask it again when it is time."""
        if goal.signs != self._signs:
            self._signs = goal.signs
            self._alive_s = now
        if self._ping is not None and self._ping.done():
            if self._ping.exception() is None:
                self._alive_s = max(self._alive_s, self._asked_s)
            if now >= self._asked_s + _POLL_S:
                self._ask(self._silence_s)
        return self._alive_s

    def _ask(self, timeout_s: float) -> None:
        """Ask to cancel a goal that does not exist: the one harmless question to a server."""
        self._asked_s = self._node.clock()
        request = {"goal_info": {"goal_id": {"uuid": b64encode(uuid4().bytes).decode()}}}
        service = f"{self._server}/_action/cancel_goal"
        self._ping = self._node.call(service, "action_msgs/srv/CancelGoal", request, timeout_s)

    def _close(self) -> None:
        if self._goal is not None:
            self._goal.close()
        self._goal = None


def _upper_level(message: Message) -> str:
    """Return the numbers and texts of a message that say something, in words."""
    fields = []
    for name, value in message.items():
        if isinstance(value, float):
            fields.append(f"{name} {value:.4g}")
        elif isinstance(value, str | int) and value:
            fields.append(f"{name} {value}")
    return ", ".join(fields)
