"""What a real ROS 2 Jazzy said (data/ros2_transcripts.json), played to the product."""

import json
from pathlib import Path

import pytest
from ros_rig import rig, until
from ros_robot import NAVIGATE
from rosbridge_double import Player

from missions.wires.node import RosError
from missions.wires.rosbridge import Rosbridge

GOAL = {"pose": {"header": {"frame_id": "map"}, "pose": {"orientation": {"w": 1.0}}}}
CASES = {
    case["case"]: case["messages"]
    for case in json.loads((Path(__file__).parent / "data" / "ros2_transcripts.json").read_text())
}


@pytest.mark.parametrize(
    ("case", "status", "feedback", "result"),
    [
        ("action: succeeds, feedback true", 4, 4, {"error_code": 0, "error_msg": ""}),
        ("action: succeeds, feedback false", 4, 0, {"error_code": 0, "error_msg": ""}),
        ("action: aborted", 6, 2, {"error_code": 9002, "error_msg": "no transform map->odom"}),
        ("action: execute callback raises", 6, 2, {"error_code": 0, "error_msg": ""}),
    ],
)
def test_recorded_goal_ends_as_it_did(case, status, feedback, result):
    host = Player(CASES[case])
    node = Rosbridge(host.url)
    until(lambda: node.is_connected)
    goal = node.send_goal("/navigate_to_pose", NAVIGATE, GOAL)
    until(lambda: goal.is_over)
    assert (goal.status, goal.result, goal.error) == (status, result, "")
    assert goal.signs >= feedback + 1
    node.close()
    host.close()


@pytest.mark.parametrize(
    ("case", "status"),
    [("action: cancel accepted", 5), ("action: cancel refused by the server", 4)],
)
def test_recorded_cancel_ends_as_it_did(case, status):
    host = Player(CASES[case])
    node = Rosbridge(host.url)
    until(lambda: node.is_connected)
    goal = node.send_goal("/navigate_to_pose", NAVIGATE, GOAL)
    until(lambda: goal.signs >= 2)
    assert not goal.is_over
    goal.cancel()
    until(lambda: goal.is_over)
    assert goal.status == status
    node.close()
    host.close()


def test_recorded_refusal_of_a_type_is_told():
    host = Player(CASES["action: unknown type, wrong field, wrong kind of value, no type"])
    node = Rosbridge(host.url)
    until(lambda: node.is_connected)
    goal = node.send_goal("/navigate_to_pose", NAVIGATE, GOAL)
    until(lambda: goal.is_over)
    assert "cannot be asked so: " in goal.error
    assert "Unable to import" in goal.error
    node.close()
    host.close()


def spoken(case, **fields):
    """Yield time and content of each message of a case that has these fields."""
    for message in CASES[case]:
        content = message["json"]
        if all(content.get(name) == value for name, value in fields.items()):
            yield message["t"], content


def test_recorded_kill_and_restart_are_noticed():
    case = "lifecycle: kill -9 of an active node, restart; calls in new threads"
    answers = {one["id"]: one for _, one in spoken(case, op="service_response")}
    calls = list(spoken(case, op="call_service", service="/camera/get_state"))
    said = [(t, answers.get(one["id"])) for t, one in calls]
    ((killed, _),) = spoken(case, event="kill -9 of the active node")
    said = sorted([*said, (killed, None)], key=lambda one: one[0])
    events = list(spoken(case, op="publish", topic="/camera/transition_event"))
    with rig("rosbridge") as robot:

        def answer():
            return [one for t, one in said if t <= max(robot.now, said[0][0])][-1]

        def get_state(_):
            one = answer()
            if one is not None and not one["result"]:
                raise RosError(one["values"])
            return one and one["values"]

        def play():
            robot.camera.is_frozen = answer() is None
            while events and events[0][0] <= robot.now:
                robot.host.publish("/camera/transition_event", "", events.pop(0)[1]["msg"])

        camera = robot.kb.components["camera"]
        robot.host.serve("/camera/get_state", "", get_state)
        robot.turn(lambda: robot.bridge.managed.is_active("camera"), 2, also=play)
        robot.turn(lambda: camera.status == "failure", 6, also=play)
        assert killed < robot.now <= killed + 3.1
        robot.turn(lambda: camera.status != "failure", 25, also=play)
        assert robot.now > 23.0
        assert not robot.bridge.managed.is_active("camera")
        robot.turn(lambda: robot.bridge.managed.is_active("camera"), 5, also=play)
        assert robot.now < 28.0, "an operator has activated it"


def test_recorded_parameters_are_accepted_and_refused():
    refused = [one for _, one in spoken("parameters", op="service_response", id="A2")]
    with rig("rosbridge") as robot:
        name = "/camera/set_parameters_atomically"
        robot.host.serve(name, "", lambda _: refused[0]["values"])
        robot.kb.measure("energy", 0.9)
        robot.kb.request_action("explore")
        robot.turn(lambda: robot.kb.configurations["sharp"].status == "unfeasible", 20)
        assert "gain above 100" in str(robot.kb.explain("sharp"))


def test_recorded_diagnostic_updater_is_understood():
    arrays = [one for _, one in spoken("diagnostics: the real diagnostic_updater", op="publish")]
    levels = {one["name"]: one["level"] for one in arrays[0]["msg"]["status"]}
    assert set(levels.values()) == {0, 1, 2, 3}
    worst = next(name for name, level in levels.items() if level == 2)
    fine = next(name for name, level in levels.items() if level == 0)
    rules = {worst: "camera", fine: "radar"}
    with rig("rosbridge", diagnostics=rules) as robot:
        robot.host.publish("/diagnostics", "", arrays[0]["msg"])
        until(lambda: robot.kb.components["camera"].status == "failure")
        assert robot.kb.components["radar"].status != "failure"
        assert set(robot.bridge._rules.not_understood) == levels.keys() - rules.keys()
