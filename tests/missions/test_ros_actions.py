"""Actions of ROS 2 servers as leaves: what servers do, also those that misbehave, by every wire."""

import pytest
from py_trees.common import Status
from py_trees.composites import Selector
from ros_rig import GOAL, rig, until
from ros_robot import NAVIGATE

from kb import KnowledgeBase, Model
from missions.wires.actions import RosAction
from missions.wires.node import RosError
from rosa_bt import RosaAction, TreeRunner


class Going:
    """A tree of one action, which is ticked as time passes."""

    def __init__(self, robot, leaf=None, root=None, **options):
        self.robot = robot
        self.leaf = leaf or navigation(robot, "charge", **options)
        self.runner = TreeRunner(root or self.leaf, clock=lambda: robot.now, period=0.1)

    def until(self, holds, within=10):
        return self.robot.turn(holds, within, also=self.runner.update)

    def begin(self):
        """Send the goal; its acceptance may come late by the wall clock."""
        server = self.robot.server
        self.until(lambda: self.leaf._goal is not None)
        until(lambda: server.received)
        until(lambda: server.rejects or server.is_secret or self.leaf._goal.is_accepted)

    def end(self, status):
        self.until(lambda: self.runner.status.name == status)
        return self.leaf.feedback_message


def navigation(robot, action, goal=GOAL, **options):
    return RosAction("go", robot.kb, action, robot.server.name, NAVIGATE, goal, **options)


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
    robot.server.end(6, error_code=9002, error_msg="no transform")
    assert "was aborted: error_code 9002, error_msg no transform" in go.end("FAILURE")


def test_goal_that_others_cancel_fails(robot):
    go = Going(robot)
    go.begin()
    robot.server.end(5)
    assert "was cancelled" in go.end("FAILURE")


def test_goal_rejected_fails(robot):
    robot.server.rejects = True
    go = Going(robot, accept_s=3.0)
    assert "reject" in go.end("FAILURE")
    assert robot.now < 4.5


def test_goal_rejected_as_anothers_begins_fails_when_that_ends():
    with rig("rosbridge") as robot:
        robot.server.rejects = True
        go = Going(robot)
        go.begin()
        robot.server.rejects = False
        robot.server.begin(GOAL, lambda _: None, lambda *_: None)  # of another client
        until(lambda: go.leaf._goal.is_accepted)
        go.until(lambda: robot.now > 20.0, 25)
        assert go.runner.status.name == "RUNNING"
        robot.server.end(4)
        assert "rejects the goal, or it is lost" in go.end("FAILURE")


def test_goal_goes_on_when_anothers_ends_that_began_with_it():
    with rig("rosbridge") as robot:
        robot.server.is_secret = True
        go = Going(robot)
        go.begin()
        robot.server.is_secret = False
        other = robot.server.begin(GOAL, lambda _: None, lambda *_: None)
        until(lambda: go.leaf._goal.is_accepted)
        robot.server.end(4, key=other)
        go.until(lambda: robot.now > 20.0, 25)
        assert go.runner.status.name == "RUNNING"
        robot.server.end(4, error_code=0, error_msg="")
        assert go.end("SUCCESS") == ""


def test_action_that_nobody_serves_fails(robot):
    robot.host.unserve("/navigate_to_pose/_action/cancel_goal")
    robot.server.is_dead = True
    text = Going(robot).end("FAILURE")
    assert "does not exist" in text or "nobody serves" in text
    assert not robot.server.received


def test_server_that_never_answers_fails(robot):
    robot.server.is_dead = True
    assert "has not answered in time" in Going(robot).end("FAILURE")


def test_server_that_dies_fails_its_goal(robot):
    go = Going(robot)
    go.begin()
    go.until(lambda: robot.now > 8.0)
    assert go.runner.status.name == "RUNNING", "without feedback it is alive if it answers"
    robot.server.is_dead = True
    start = robot.now
    assert "no sign of life for 5 s" in go.end("FAILURE")
    assert robot.now - start <= 5.2


def test_goal_that_cannot_be_made_fails_with_the_reason(robot):
    def fail():
        raise ValueError("no dock is known")

    assert "no dock is known" in Going(robot, navigation(robot, "charge", fail)).end("FAILURE")


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
    leaf = navigation(robot, "go", halting_timeout=20.0)
    rest = Work("rest", robot.kb, "rest")
    robot.kb.measure("charged", 0.0)
    go = Going(robot, leaf, Selector("root", memory=False, children=[rest, leaf]))
    go.rest = rest
    go.begin()
    return go


def rests(robot):
    return [request.action for request in robot.kb.required_actions] == ["rest"]


def test_next_action_waits_until_the_cancel_is_confirmed(robot, interrupted):
    robot.kb.measure("charged", 1.0)
    start = robot.now
    interrupted.until(lambda: robot.server.asked)
    interrupted.until(lambda: robot.now > start + 4.0)
    assert "waiting until go has halted" in interrupted.rest.feedback_message
    assert "has not confirmed the cancel" in interrupted.rest.feedback_message
    assert not rests(robot)
    robot.server.end(5)
    interrupted.until(lambda: rests(robot))


def test_cancel_that_is_ignored_is_repeated_and_told(robot, interrupted):
    robot.server.ignores_cancels = True
    robot.kb.measure("charged", 1.0)
    start = robot.now
    interrupted.until(lambda: len(robot.server.asked) >= 3)
    assert robot.now - start >= 2.0
    interrupted.until(lambda: rests(robot), 25)
    assert robot.now - start >= 20.0
    cancels = [event for event in robot.kb.log if event.verb == "cancel_action"]
    assert "did not halt within 20 s" in cancels[-1].text


def test_server_that_dies_while_it_cancels_is_told(robot, interrupted):
    robot.server.is_dead = True
    robot.kb.measure("charged", 1.0)
    interrupted.until(lambda: rests(robot), 25)


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
