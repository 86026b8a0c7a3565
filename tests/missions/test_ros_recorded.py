"""What a real ROS 2 Jazzy said (data/ros2_transcripts.json), played to the product."""

import json
from contextlib import contextmanager
from pathlib import Path

import pytest
from ros_rig import GOAL, rig, until
from ros_robot import NAVIGATE
from rosbridge_double import Player

from missions.wires.rosbridge import Rosbridge

DATA = Path(__file__).parent / "data" / "ros2_transcripts.json"
CASES = {case["case"]: case["messages"] for case in json.loads(DATA.read_text())}
DONE = {"error_code": 0, "error_msg": ""}
NO_WAY = {"error_code": 9002, "error_msg": "no transform map->odom"}


@contextmanager
def recorded_goal(case):
    host = Player(CASES[case])
    node = Rosbridge(host.url)
    until(lambda: node.is_connected)
    yield node.send_goal("/navigate_to_pose", NAVIGATE, GOAL)
    node.close()
    host.close()


@pytest.mark.parametrize(
    ("case", "status", "feedback", "result"),
    [
        ("action: succeeds, feedback true", 4, 4, DONE),
        ("action: succeeds, feedback false", 4, 0, DONE),
        ("action: aborted", 6, 2, NO_WAY),
        ("action: execute callback raises", 6, 2, DONE),
    ],
)
def test_goal_recorded_ends_as_it_did(case, status, feedback, result):
    with recorded_goal(case) as goal:
        until(lambda: goal.is_over)
        assert (goal.status, goal.result, goal.error) == (status, result, "")
        assert goal.signs >= feedback + 1


@pytest.mark.parametrize(
    ("case", "status"),
    [("action: cancel accepted", 5), ("action: cancel refused by the server", 4)],
)
def test_cancel_recorded_ends_as_it_did(case, status):
    with recorded_goal(case) as goal:
        until(lambda: goal.signs >= 2)
        assert not goal.is_over
        goal.cancel()
        until(lambda: goal.is_over)
        assert goal.status == status


def test_type_refused_in_a_recording_is_told():
    with recorded_goal("action: unknown type, wrong field, wrong kind of value, no type") as goal:
        until(lambda: goal.is_over)
        assert "cannot be asked so: " in goal.error
        assert "Unable to import" in goal.error


def messages_of(case, **fields):
    """Yield time and content of each message of a case that has these fields."""
    for message in CASES[case]:
        content = message["json"]
        if fields.items() <= content.items():
            yield message["t"], content


def test_kill_and_restart_recorded_are_noticed():
    case = "lifecycle: kill -9 of an active node, restart; calls in new threads"
    responses = {answer["id"]: answer for _, answer in messages_of(case, op="service_response")}
    calls = messages_of(case, op="call_service", service="/camera/get_state")
    answers = [(t, responses.get(call["id"])) for t, call in calls]
    ((killed, _),) = messages_of(case, event="kill -9 of the active node")
    answers = sorted([*answers, (killed, None)], key=lambda answer: answer[0])
    events = list(messages_of(case, op="publish", topic="/camera/transition_event"))
    with rig("rosbridge") as robot:

        def get_state(_=None):
            return [answer for t, answer in answers if t <= max(robot.now, answers[0][0])][-1]

        def play():
            robot.camera.is_frozen = get_state() is None
            while events and events[0][0] <= robot.now:
                robot.host.publish("/camera/transition_event", "", events.pop(0)[1]["msg"])

        camera = robot.kb.components["camera"]
        is_active = robot.bridge.managed.is_active
        robot.host.serve("/camera/get_state", "", get_state)
        robot.turn(lambda: is_active("camera"), 2, also=play)
        robot.turn(lambda: camera.status == "failure", 6, also=play)
        assert killed < robot.now <= killed + 3.1
        robot.turn(lambda: camera.status != "failure", 25, also=play)
        assert robot.now > 23.0
        assert not is_active("camera")
        robot.turn(lambda: is_active("camera"), 6, also=play)  # an operator has activated it


def test_parameters_refused_in_a_recording_are_explained():
    ((_, refused),) = messages_of("parameters", op="service_response", id="A2")
    with rig("rosbridge") as robot:
        robot.host.serve("/camera/set_parameters_atomically", "", lambda _: refused)
        robot.request()
        robot.turn(lambda: robot.kb.configurations["sharp"].status == "unfeasible", 20)
        assert "gain above 100" in str(robot.kb.explain("sharp"))


def test_diagnostic_updater_recorded_is_understood():
    case = "diagnostics: the real diagnostic_updater"
    array = next(content["msg"] for _, content in messages_of(case, op="publish"))
    names = {status["level"]: status["name"] for status in array["status"]}
    assert set(names) == {0, 1, 2, 3}
    rules = {names[2]: "camera", names[0]: "radar"}
    with rig("rosbridge", diagnostics=rules) as robot:
        robot.host.publish("/diagnostics", "", array)
        until(lambda: robot.kb.components["camera"].status == "failure")
        assert robot.kb.components["radar"].status != "failure"
