"""Nodes that die, freeze, restart or refuse, noticed by every wire."""

import time

import pytest
from ros_rig import WIRES, rig
from ros_robot import EVENT


def has_failed(robot, name="camera"):
    return robot.kb.components[name].status == "failure"


def test_node_killed_is_failed_within_three_seconds(robot):
    robot.explore()
    robot.turn(lambda: robot.now > 2.0, 30)
    robot.camera.kill()
    before = robot.camera.asked
    assert robot.turn(lambda: has_failed(robot), 4) <= 3.0
    assert robot.camera.asked <= before + 2, "a silent node is asked once at a time"
    assert not robot.kb.components["camera"].is_active
    robot.turn(lambda: robot.radar.state == 3, 30)
    assert not has_failed(robot, "radar"), "its calls are not held up by those to the camera"
    robot.camera.start()
    robot.turn(lambda: not has_failed(robot), 30)
    assert not robot.kb.components["camera"].is_active


def test_node_that_left_the_graph_is_failed_at_once(robot):
    robot.explore()
    robot.camera.vanish()
    assert robot.turn(lambda: has_failed(robot), 3) <= 1.3


def test_last_nodes_that_leave_are_failed_too(robot):
    robot.explore()
    robot.turn(lambda: robot.now > 1.0, 3)
    for node in (robot.camera, robot.radar):
        node.vanish()
    robot.host.unadvertise("/battery_state")
    robot.turn(lambda: has_failed(robot), 60, also=lambda: time.sleep(0.01))


def test_node_restarted_is_brought_back(robot):
    robot.explore()
    robot.camera.start()
    robot.camera.parameters.clear()
    robot.turn(lambda: not robot.kb.components["camera"].is_active, 1.3)
    robot.turn(lambda: robot.camera.state == 3 and robot.camera.parameters, 5)
    assert not has_failed(robot)


@pytest.mark.parametrize("wire", WIRES)
def test_node_restarted_stays_failed_if_chosen(wire):
    with rig(wire, restarted="fail") as robot:
        robot.explore()
        robot.camera.start()
        robot.turn(lambda: has_failed(robot) and robot.radar.state == 3, 5)
        assert robot.camera.state == 1


def test_node_frozen_fails_its_command(robot):
    robot.camera.is_frozen = True
    robot.request()
    robot.turn(lambda: robot.radar.state == 3, 20)
    assert has_failed(robot)
    assert robot.camera.transitions == []
    robot.camera.is_frozen = False
    robot.turn(lambda: not has_failed(robot), 8)


def test_transition_is_sent_only_if_the_state_allows_it(robot):
    robot.turn(lambda: robot.bridge.managed.is_active("camera") is False, 1)
    for transition in (1, 3):
        robot.camera.go(transition)  # by an operator
    robot.explore()
    assert robot.camera.transitions == []
    robot.kb.component_failed("camera")
    robot.radar.state = 4  # finalized
    robot.turn(lambda: has_failed(robot, "radar"), 10)
    assert robot.radar.transitions == []


def test_node_that_refuses_is_tried_again_then_done_without(robot):
    robot.camera.refused.add(1)
    robot.request()
    robot.turn(lambda: robot.radar.state == 3, 20)
    assert robot.camera.transitions == [1, 1, 1]
    assert "refuses the transition" in str(robot.kb.explain("camera"))


def test_parameters_refused_are_explained(robot):
    robot.camera.refused.add("gain")
    robot.request()
    robot.turn(lambda: robot.kb.configurations["sharp"].status == "unfeasible", 20)
    assert "gain above 100" in str(robot.kb.explain("sharp"))


def test_node_that_an_operator_stops_is_noticed(robot):
    robot.explore()
    robot.camera.go(4)
    robot.turn(lambda: robot.radar.state == 3, 5)


def test_events_of_own_commands_mislead_nobody_when_late(robot):
    robot.explore()
    for start, goal in ((1, 10), (10, 2)):
        states = {
            "start_state": {"id": start, "label": ""},
            "goal_state": {"id": goal, "label": ""},
        }
        robot.host.publish("/camera/transition_event", EVENT, states)
    end = robot.now + 0.8
    robot.turn(lambda: robot.now > end, 1)
    assert not has_failed(robot)
    assert robot.bridge.managed.is_active("camera")
