"""A robot as real ones behave: lifecycle nodes and an action server that can misbehave.

They answer what was recorded from ROS 2 Jazzy (data/ros2_transcripts.json). A `host` carries
them: the double of a rosbridge, or that of rclpy. A function that returns None never answers.
"""

from base64 import b64encode
from itertools import count

STATE, CHANGE = "lifecycle_msgs/srv/GetState", "lifecycle_msgs/srv/ChangeState"
SET = "rcl_interfaces/srv/SetParametersAtomically"
EVENT = "lifecycle_msgs/msg/TransitionEvent"
CANCEL, STATUS = "action_msgs/srv/CancelGoal", "action_msgs/msg/GoalStatusArray"
NAVIGATE = "nav2_msgs/action/NavigateToPose"
_TRANSITIONS = {(1, 1): (10, 2), (2, 3): (13, 3), (3, 4): (14, 2)}
"""Passing and final state, by state and transition."""


class LifecycleNode:
    """Answers as an rclpy node does; a transition that the state does not allow ends it."""

    def __init__(self, host, name):
        self.host = host
        self.name = name
        self.state = 1
        self.parameters = {}
        self.transitions = []
        self.refused = set()
        self.is_frozen = False
        self.asked = 0
        self.start()

    def start(self):
        """Start the process: the node is unconfigured, and sends no event."""
        self.state = 1
        self.is_frozen = False
        for service, kind, answer in (
            ("get_state", STATE, self.get_state),
            ("change_state", CHANGE, self.change_state),
            ("set_parameters_atomically", SET, self.set_parameters),
        ):
            self.host.serve(
                f"{self.name}/{service}", kind, lambda request, a=answer: self.answer(a, request)
            )
        self.host.advertise(f"{self.name}/transition_event", EVENT)

    def answer(self, answer, request):
        self.asked += 1
        return None if self.is_frozen else answer(request)

    def kill(self):
        """End the process as kill -9 does: for 9 s, calls are not answered, and nobody is told."""
        self.is_frozen = True

    def vanish(self):
        """End what is left of it in the graph, as 9 s later, or at once after a tidy end."""
        self.is_frozen = False
        for service in ("get_state", "change_state", "set_parameters_atomically"):
            self.host.unserve(f"{self.name}/{service}")
        self.host.unadvertise(f"{self.name}/transition_event")

    def get_state(self, _):
        return {"current_state": {"id": self.state, "label": ""}}

    def change_state(self, request):
        transition = request["transition"]["id"]
        self.transitions.append(transition)
        if (self.state, transition) not in _TRANSITIONS:
            self.vanish()
            return None
        if transition in self.refused:
            return {"success": False}
        self.go(transition)
        return {"success": True}

    def go(self, transition):
        """Make a transition and send its two events, as an operator's command does too."""
        passing, final = _TRANSITIONS[self.state, transition]
        for start, goal in ((self.state, passing), (passing, final)):
            states = {
                "start_state": {"id": start, "label": ""},
                "goal_state": {"id": goal, "label": ""},
            }
            self.state = goal
            self.host.publish(f"{self.name}/transition_event", EVENT, states)

    def set_parameters(self, request):
        values = {entry["name"]: entry["value"] for entry in request["parameters"]}
        if self.refused & values.keys():
            return {"result": {"successful": False, "reason": "gain above 100"}}
        self.parameters |= values
        return {"result": {"successful": True, "reason": ""}}


class ActionServer:
    """An action server whose goals go on until a test ends them.

    Attributes:
        goals: those that are under way, by key: their fields, and what hears of feedback and end.
        asked: the cancels that arrived.
    """

    def __init__(self, host, name="/navigate_to_pose"):
        self.host = host
        self.name = name
        self.goals = {}
        self.asked = []
        self.received = []
        self._statuses = {}
        self.rejects = self.ignores_cancels = self.confirms_cancels = self.is_dead = False
        self.is_secret = False  # whether its new goals are on the status topic later only
        self._numbers = count(1)
        host.serve(f"{name}/_action/cancel_goal", CANCEL, self.cancel_goal)
        host.advertise(f"{name}/_action/status", STATUS, is_latched=True)
        host.actions[name] = self

    def begin(self, goal, on_feedback, on_end):
        """Return a key if it accepts the goal, "" if it rejects it, None if it does not answer."""
        if self.is_dead:
            return None
        self.received.append(goal)
        if self.rejects:
            return ""
        uuid = b64encode(next(self._numbers).to_bytes(16, "big")).decode()
        self.goals[uuid] = (on_feedback, on_end)
        self._show(uuid, 2)
        return uuid

    def cancel(self, uuid):
        """Return whether it cancels a goal; None if it does not answer."""
        if self.is_dead:
            return None
        self.asked.append(uuid)
        if self.ignores_cancels or uuid not in self.goals:
            return False
        self._show(uuid, 3)
        if self.confirms_cancels:
            self.end(5)
        return True

    def cancel_goal(self, request):
        if self.is_dead:
            return None
        uuid = request["goal_info"]["goal_id"]["uuid"]
        return {"return_code": 0 if uuid in self.goals else 2, "goals_canceling": []}

    def feedback(self, **values):
        for on_feedback, _ in self.goals.values():
            on_feedback(values)

    def end(self, status, key="", **values):
        """End a goal, by default the oldest."""
        uuid = key or next(iter(self.goals))
        _, on_end = self.goals.pop(uuid)
        self._show(uuid, status)
        on_end(status, values)

    def _show(self, uuid, status):
        self._statuses[uuid] = status
        if self.is_secret:
            return
        entries = [
            {
                "goal_info": {"goal_id": {"uuid": uuid}, "stamp": {"sec": 1, "nanosec": 0}},
                "status": status,
            }
            for uuid, status in self._statuses.items()
        ]
        self.host.publish(f"{self.name}/_action/status", STATUS, {"status_list": entries})
