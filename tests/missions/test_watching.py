"""Nodes that die, freeze, restart or refuse, noticed by every wire."""

import time

import pytest
from ros_rig import WIRES, rig

pytestmark = pytest.mark.parametrize("wire", WIRES)


def has_failed(robot, name="camera"):
    return robot.kb.components[name].status == "failure"


def test_killed_node_is_failed_within_three_seconds(wire):
    with rig(wire) as robot:
        robot.explore()
        robot.turn(lambda: robot.now > 2.0, 3)
        robot.camera.kill()
        assert robot.turn(lambda: has_failed(robot), 4) <= 3.0
        assert not robot.kb.components["camera"].is_active
        robot.turn(lambda: robot.radar.state == 3, 5)
        assert not has_failed(robot, "radar"), "its calls are not held up by those to the camera"


def test_node_that_left_the_graph_is_failed_at_once(wire):
    with rig(wire) as robot:
        robot.explore()
        robot.camera.vanish()
        assert robot.turn(lambda: has_failed(robot), 3) <= 1.3


def test_silent_node_is_asked_once_at_a_time(wire):
    with rig(wire) as robot:
        robot.explore()
        robot.camera.kill()
        before, end = robot.camera.asked, robot.now + 2.5
        robot.turn(lambda: robot.now > end, 4)
        assert robot.camera.asked == before + 1


def test_restarted_node_is_brought_back(wire):
    with rig(wire) as robot:
        robot.explore()
        robot.camera.start()
        robot.camera.parameters.clear()
        robot.turn(lambda: not robot.kb.components["camera"].is_active, 1.3)
        robot.turn(lambda: robot.camera.state == 3 and robot.camera.parameters, 5)
        assert not has_failed(robot)


def test_restarted_node_stays_failed_if_chosen(wire):
    with rig(wire, restarted="fail") as robot:
        robot.explore()
        robot.camera.start()
        robot.turn(lambda: has_failed(robot) and robot.radar.state == 3, 5)
        assert robot.camera.state == 1


def test_node_killed_and_restarted_later_is_recovered(wire):
    with rig(wire) as robot:
        robot.explore()
        robot.camera.kill()
        robot.turn(lambda: robot.radar.state == 3, 8)
        robot.camera.start()
        robot.turn(lambda: not has_failed(robot), 5)
        assert not robot.kb.components["camera"].is_active


def test_frozen_node_fails_its_command(wire):
    with rig(wire) as robot:
        robot.camera.is_frozen = True
        robot.kb.measure("energy", 0.9)
        robot.kb.request_action("explore")
        robot.turn(lambda: robot.radar.state == 3, 20)
        assert has_failed(robot)
        assert robot.camera.transitions == []


def test_frozen_node_that_goes_on_is_used_again(wire):
    with rig(wire) as robot:
        robot.explore()
        robot.camera.is_frozen = True
        robot.turn(lambda: has_failed(robot), 4)
        robot.camera.is_frozen = False
        robot.turn(lambda: not has_failed(robot), 5)


def test_transition_is_sent_only_if_the_state_allows_it(wire):
    with rig(wire) as robot:
        robot.turn(lambda: robot.bridge.managed.is_active("camera") is False, 1)
        for transition in (1, 3):
            robot.camera.go(transition)  # by an operator
        robot.explore()
        assert robot.camera.transitions == []
        robot.kb.component_failed("camera")
        robot.radar.state = 4  # finalized
        robot.turn(lambda: has_failed(robot, "radar"), 10)
        assert robot.radar.transitions == []


def test_node_that_refuses_is_tried_again_then_done_without(wire):
    with rig(wire) as robot:
        robot.camera.refused.add(1)
        robot.kb.measure("energy", 0.9)
        robot.kb.request_action("explore")
        robot.turn(lambda: robot.radar.state == 3, 20)
        assert robot.camera.transitions == [1, 1, 1]
        assert "refuses the transition" in str(robot.kb.explain("camera"))


def test_refused_parameters_are_explained(wire):
    with rig(wire) as robot:
        robot.camera.refused.add("gain")
        robot.kb.measure("energy", 0.9)
        robot.kb.request_action("explore")
        robot.turn(lambda: robot.kb.configurations["sharp"].status == "unfeasible", 20)
        assert "gain above 100" in str(robot.kb.explain("sharp"))


def test_node_that_an_operator_stops_is_noticed(wire):
    with rig(wire) as robot:
        robot.explore()
        robot.camera.go(4)
        robot.turn(lambda: robot.radar.state == 3, 5)


def test_late_events_of_own_commands_mislead_nobody(wire):
    with rig(wire) as robot:
        robot.explore()
        robot.turn(lambda: robot.now > 1.0, 2)
        for start, goal in ((1, 10), (10, 2)):
            states = {
                "start_state": {"id": start, "label": ""},
                "goal_state": {"id": goal, "label": ""},
            }
            robot.host.publish(
                "/camera/transition_event", "lifecycle_msgs/msg/TransitionEvent", states
            )
        end = robot.now + 0.8
        robot.turn(lambda: robot.now > end, 1)
        assert not has_failed(robot)
        assert robot.bridge.managed.is_active("camera")


def test_last_nodes_that_leave_are_failed_too(wire):
    with rig(wire) as robot:
        robot.explore()
        robot.turn(lambda: robot.now > 1.0, 3)
        for node in (robot.camera, robot.radar):
            node.vanish()
        robot.host.unadvertise("/battery_state")
        robot.turn(lambda: has_failed(robot), 60, also=lambda: time.sleep(0.01))
