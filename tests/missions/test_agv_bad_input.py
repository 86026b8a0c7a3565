"""Maps and models that make no sense end in one message that says what was given and what to do; nothing is planned."""

import math
import sys

import pytest
from agv_worlds import building_from

from kb import KnowledgeBase, Model, UnknownName
from missions import cli
from missions.agv.joint import JointPlanner, Place, Question
from missions.agv.model import agv_model
from missions.engine.mission import MissionError

HALL = {
    "start": "a",
    "goal": "b",
    "places": {"a": [0, 0], "b": [8, 0], "c": [8, 6]},
    "corridors": {
        "c1": {"from": "a", "to": "b"},
        "c2": {"from": "b", "to": "c"},
        "c3": {"from": "b", "to": "c"},
    },
}


def cart(speed=0.5, energy=20.0, safety=0.1, kind="negative"):
    """Return the model of a robot with one design and one configuration; what is None is left out."""
    model = Model("cart")
    for name in ("light", "obstacles"):
        model.environmental_attribute(name)
    base = model.component("base", kind="lifecycle")
    base.configuration("set", {"gain": 1.0} if speed is None else {"speed": speed})
    design = model.function("navigate").design("drive", [base])
    for name, value in (("energy", energy), ("safety", safety)):
        model.quality_attribute(name)
        if value is not None:
            design.estimate(name, value, kind)
    return model


def planner(model):
    return JointPlanner(building_from(HALL), KnowledgeBase(model, clock=lambda: 0.0))


def test_cart_without_faults_is_planned_for():
    answer = planner(cart()).plan(Question())
    assert [leg.corridor for leg in answer.legs] == ["c1"]
    assert answer.takes[:2] == (16_600, 326_000)  # 0.6 s at 10 W to start and set it


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"speed": None},
            r"speed .m/s., a parameter of the configurations of drive set, is None; it must be a number from 1e-06 to",
        ),
        ({"speed": "quick"}, "of drive set, is 'quick'"),
        ({"speed": True}, "of drive set, is True"),
        ({"speed": 0.0}, "of drive set, is 0.0"),
        ({"speed": -0.5}, "of drive set, is -0.5"),
        (
            {"energy": None},
            "what drive set takes from energy, by estimations of the kind 'negative', is None; it must",
        ),
        ({"safety": None}, "takes from safety, by estimations of the kind 'negative', is None"),
        (
            {"energy": -3.0},
            "takes from energy, by estimations of the kind 'negative', is -3.0; it must be a number",
        ),
        (
            {"kind": "positive"},
            "takes from energy, by estimations of the kind 'negative', is -20.0",
        ),
    ],
)
def test_model_that_cannot_be_planned_with_is_refused(changes, words):
    with pytest.raises(MissionError, match=words):
        planner(cart(**changes)).plan(Question())


def test_model_without_what_corridors_demand_is_refused():
    model = cart()
    model.remove(model.attributes["light"])
    with pytest.raises(UnknownName, match="light"):
        planner(model).plan(Question())


def test_model_that_cannot_navigate_is_refused():
    with pytest.raises(UnknownName, match="'navigate'"):
        planner(Model("cart"))


def test_another_function_of_the_robot_changes_nothing():
    model = cart()
    model.function("look").design("see", [model.components["base"]])
    model.action("inspect", requires=[model.functions["look"], model.functions["navigate"]])
    answer, alone = planner(model).plan(Question()), planner(cart()).plan(Question())
    assert (answer.reason, answer.takes) == (alone.reason, alone.takes)


@pytest.mark.parametrize("kind", ["designs", "configurations"])
def test_constraints_that_contradict_each_other_are_told_as_the_reason(kind):
    model = cart()
    light = model.attributes["light"]
    for one in getattr(model, kind).values():
        one.constrain(light >= 0.5, light <= 0.2)
    answer = planner(model).plan(Question())
    assert not answer.is_solved
    assert answer.legs == ()
    assert (
        "is constrained by light >= 0.5 and light <= 0.2, which no value satisfies both"
        in answer.reason
    )
    assert "correct one of the constraints" in answer.reason


def test_contradiction_in_one_design_leaves_the_others():
    model = agv_model()
    light = model.attributes["light"]
    model.designs["amcl_kinect"].constrain(light >= 0.5, light <= 0.2)
    answer = planner(model).plan(Question())
    assert answer.is_solved
    assert "amcl_kinect" not in str(answer.legs)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"light": {"c1": math.nan}},
            "light of corridor c1 is nan; it must be a number from 0 to 1",
        ),
        ({"light": {"c1": 2.0}}, "light of corridor c1 is 2.0"),
        ({"weights": {"time": "much"}}, "the weight of time is 'much'"),
        ({"weights": {"time": math.inf}}, "the weight of time is inf"),
        ({"weights": {"time": 1e306, "energy": 1e306}}, "the weight of time is 1e.306"),
        ({"limits": {"time": -1.0}}, "the limit of time is -1.0"),
        (
            {"limits": {"light": 1.0}},
            "there is no limit 'light'; there are time, energy, collisions",
        ),
        ({"start": Place("z")}, "start names the place 'z', which map unnamed lacks"),
    ],
)
def test_question_that_makes_no_sense_is_refused(changes, words):
    with pytest.raises(MissionError, match=words):
        planner(agv_model()).plan(Question(**changes))


def test_robot_that_is_at_the_goal_is_said_to_be_there():
    for start in (Place("b"), Place("b", "", 3.0)):
        answer = planner(cart()).plan(Question(start))
        assert (answer.is_solved, answer.legs, answer.reason) == (True, (), "already at b")


def test_parallel_corridors_are_two_ways():
    hall = {
        **HALL,
        "goal": "c",
        "corridors": {**HALL["corridors"], "c3": {"from": "c", "to": "b", "obstacles": 0.05}},
    }
    task = JointPlanner(building_from(hall), KnowledgeBase(cart(), clock=lambda: 0.0))
    assert [leg.corridor for leg in task.plan(Question()).legs] == ["c1", "c2"]


MODULE = """
import dataclasses
from agv_worlds import building_from
from missions.agv import agv_mission
from missions.agv.model import building_model

HALL = {hall}
HALL.update({changes})
BUILDING = building_from(HALL)


def model():
    made = building_model(BUILDING)
    light = made.attributes["light"]
    for speed in (made.configurations[name] for name in ("slow", "medium", "fast")):
        {line}
    return made


MISSION = dataclasses.replace(agv_mission("hall", "drive to b", BUILDING), model=model)
"""


def run_hall(tmp_path, monkeypatch, capsys, changes, line):
    """Run a mission of one's own by command line; returns the exit code and what was said, in one line."""
    (tmp_path / "hall_of_mine.py").write_text(MODULE.format(hall=HALL, changes=changes, line=line))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "hall_of_mine", raising=False)
    options = ["--set", "incidents=", "--no-progress"]
    monkeypatch.setattr("sys.argv", ["rosa", "run", "hall_of_mine:MISSION", *options])
    code = 0
    try:
        cli.main()
    except SystemExit as end:
        code = end.code
    finally:
        sys.modules.pop("hall_of_mine", None)
    captured = capsys.readouterr()
    assert "Traceback" not in captured.out + captured.err
    return code, " ".join((captured.out + captured.err).split())


def test_mission_of_ones_own_is_run_if_nothing_is_wrong(tmp_path, monkeypatch, capsys):
    code, said = run_hall(tmp_path, monkeypatch, capsys, {}, "pass")
    assert (code, said[-26:]) == (0, "arrived: the robot is at b")


def test_component_that_the_simulated_vehicle_lacks_has_failed_and_it_drives_with_another(
    tmp_path, monkeypatch, capsys, caplog
):
    gps = "made.component('gps', kind='lifecycle')"
    line = (
        f"'gps' in made.components or made.functions['navigate'].design('by_gps', [{gps}, 'base'])"
    )
    code, said = run_hall(tmp_path, monkeypatch, capsys, {}, line)
    assert (code, said[-26:]) == (0, "arrived: the robot is at b")
    assert (
        "activate gps failed, tried 3 times: the simulated vehicle has no component gps"
        in caplog.text
    )


@pytest.mark.parametrize(
    ("changes", "line", "code", "words"),
    [
        (
            {"corridors": {"c1": {"from": "a", "to": "b", "length_m": -2}}},
            "pass",
            2,
            "length_m of corridor c1 is -2; it must be",
        ),
        (
            {"places": {**HALL["places"], "z": [9, 9]}},
            "pass",
            2,
            "disconnected: no way from a to z; add a corridor",
        ),
        (
            {},
            "made.change(speed, parameters={'gain': 1.0})",
            2,
            "rosa: speed [m/s], a parameter of the configurations of aruco_camera slow, is None",
        ),
        (
            {},
            "made.change(speed, parameters={'speed': 0.0})",
            2,
            "rosa: speed [m/s], a parameter of the configurations of aruco_camera slow, is 0.0",
        ),
        (
            {},
            "speed.constrain(light >= 0.5, light <= 0.2)",
            1,
            "from a: no corridor can be crossed in any configuration; configuration slow is constrained",
        ),
    ],
)
def test_mission_that_makes_no_sense_ends_in_one_message(
    tmp_path, monkeypatch, capsys, changes, line, code, words
):
    ended, said = run_hall(tmp_path, monkeypatch, capsys, changes, line)
    assert ended == code
    assert words in said
    assert "arrived" not in said
