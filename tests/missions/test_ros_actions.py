"""Actions of ROS 2 servers as leaves: what servers do, also those that misbehave, by every wire."""

import pytest
from py_trees.common import Status
from py_trees.composites import Selector
from ros_rig import rig, until
from ros_robot import NAVIGATE

from kb import KnowledgeBase, Model
from missions.wires.actions import RosAction
from missions.wires.node import RosError
from rosa_bt import RosaAction, TreeRunner

GOAL = {"pose": {"header": {"frame_id": "map"}, "pose": {"orientation": {"w": 1.0}}}}


class Going:
    """A tree of one action, which is ticked as time passes."""

    def __init__(self, robot, root=None, **options):
        self.robot = robot
        self.leaf = RosAction(
            "go", robot.kb, "charge", robot.server.name, NAVIGATE, GOAL, **options
        )
        self.runner = TreeRunner(root or self.leaf, clock=lambda: robot.now, period=0.1)

    def until(self, holds, within=10):
        return self.robot.turn(holds, within, also=self.runner.update)

    def begin(self):
        self.until(lambda: self.leaf._goal is not None and self.robot.server.received)

    def end(self, status):
        self.until(lambda: self.runner.status.name == status)
        return self.leaf.feedback_message


def test_goal_succeeds_with_its_feedback_shown(robot):
    go = Going(robot)
    go.begin()
    assert robot.server.received[0]["pose"]["header"]["frame_id"] == "map"
    robot.server.feedback(distance_remaining=0.75, number_of_recoveries=2)
    go.until(lambda: go.leaf.feedback.get("distance_remaining") == 0.75)
    assert "distance_remaining 0.75" in go.leaf.feedback_message
    assert "number_of_recoveries 2" in go.leaf.feedback_message
    robot.server.end(4, error_code=0, error_msg="")
    assert go.end("SUCCESS") == ""
    assert not robot.kb.required_actions


def test_goal_aborted_fails_with_its_result(robot):
    go = Going(robot)
    go.begin()
    robot.server.end(6, error_code=9002, error_msg="no transform map->odom")
    said = go.end("FAILURE")
    assert "was aborted: error_code 9002, error_msg no transform map->odom" in said


def test_goal_rejected_fails(robot):
    robot.server.rejects = True
    go = Going(robot, accept_s=3.0)
    assert "reject" in go.end("FAILURE")
    assert robot.now < 4.5


def test_action_that_nobody_serves_fails(robot):
    robot.host.unserve("/navigate_to_pose/_action/cancel_goal")
    robot.server.is_dead = True
    said = Going(robot).end("FAILURE")
    assert "does not exist" in said or "nobody serves" in said
    assert not robot.server.received


def test_server_that_never_answers_fails(robot):
    robot.server.is_dead = True
    assert "has not answered in time" in Going(robot).end("FAILURE")


def test_server_that_dies_fails_its_goal(robot):
    go = Going(robot)
    go.begin()
    go.until(lambda: robot.now > 8.0)
    assert go.runner.status.name == "RUNNING", (
        "a server without feedback is alive as long as it answers"
    )
    robot.server.is_dead = True
    start = robot.now
    assert "no sign of life for 5 s" in go.end("FAILURE")
    assert robot.now - start <= 5.2


def test_goal_that_others_cancel_fails(robot):
    go = Going(robot)
    go.begin()
    robot.server.end(5)
    assert "was cancelled" in go.end("FAILURE")


def test_goal_that_cannot_be_made_fails_with_the_reason(robot):
    def fail():
        raise ValueError("no dock is known")

    leaf = RosAction("go", robot.kb, "charge", robot.server.name, NAVIGATE, fail)
    go = Going(robot, root=leaf)
    go.until(lambda: go.runner.status.name == "FAILURE")
    assert "no dock is known" in leaf.feedback_message


def test_robot_that_is_not_connected_fails_the_action():
    kb = KnowledgeBase(Model("m"), clock=lambda: 0.0)
    kb.model.action("go")
    leaf = RosAction("go", kb, "go", "/navigate_to_pose", NAVIGATE, GOAL)
    leaf.tick_once()
    assert "no robot is connected" in leaf.feedback_message


# ------------------------------------------------------------ interrupted: the next one waits


class Work(RosaAction):
    def update(self):
        return Status.RUNNING


@pytest.fixture
def interrupted(robot):
    """A tree that leaves its goal for another action of the same component."""
    model = robot.kb.model
    model.function("drive").design("by_base", [model.component("base")])
    charged = model.quality_attribute("charged")
    model.action("go", requires=["drive"])
    model.action("rest", requires=["drive"], constraints=[charged >= 1.0])
    leaf = RosAction("go", robot.kb, "go", robot.server.name, NAVIGATE, GOAL, halting_timeout=20.0)
    rest = Work("rest", robot.kb, "rest")
    root = Selector("root", memory=False, children=[rest, leaf])
    robot.kb.measure("charged", 0.0)
    go = Going(robot, root=root)
    go.leaf, go.rest = leaf, rest
    go.begin()
    go.until(lambda: leaf._goal.is_accepted)
    return go


def test_next_action_waits_until_the_cancel_is_confirmed(robot, interrupted):
    robot.kb.measure("charged", 1.0)
    start = robot.now
    interrupted.until(lambda: robot.server.asked)
    interrupted.until(lambda: robot.now > start + 4.0)
    assert "waiting until go has halted" in interrupted.rest.feedback_message
    assert "has not confirmed the cancel" in interrupted.rest.feedback_message
    assert "rest" not in [one.action for one in robot.kb.required_actions]
    robot.server.end(5)
    interrupted.until(lambda: [one.action for one in robot.kb.required_actions] == ["rest"])


def test_cancel_that_is_ignored_is_repeated_and_told(robot, interrupted):
    robot.server.ignores_cancels = True
    robot.kb.measure("charged", 1.0)
    start = robot.now
    interrupted.until(lambda: len(robot.server.asked) >= 3)
    assert robot.now - start >= 2.0
    interrupted.until(lambda: [one.action for one in robot.kb.required_actions] == ["rest"], 25)
    assert robot.now - start >= 20.0
    cancelled = [one for one in robot.kb.log if one.verb == "cancel_action" and one.subject == "go"]
    assert "did not halt within 20 s" in cancelled[-1].text


def test_server_that_dies_while_it_cancels_is_told(robot, interrupted):
    robot.server.is_dead = True
    robot.kb.measure("charged", 1.0)
    interrupted.until(lambda: [one.action for one in robot.kb.required_actions] == ["rest"], 25)


def test_rosbridge_that_is_killed_ends_the_goal():
    with rig("rosbridge") as robot:
        go = Going(robot)
        go.begin()
        robot.host.cut()
        until(lambda: go.leaf._goal.error)
        assert "the goal may go on" in go.end("FAILURE")


def test_unknown_action_is_refused_by_rclpy():
    with rig("rclpy") as robot, pytest.raises(RosError, match="source the workspace"):
        robot.node.send_goal("/x", "no_msgs/action/Such", {})
