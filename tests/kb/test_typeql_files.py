"""Model files in the style of ROSA's are read as they are meant."""

from pathlib import Path

import pytest

from kb import KnowledgeBase, Model, Status
from kb.facts import (
    ActiveFact,
    MeasurementFact,
    PlanFact,
    ProcessFact,
    RequiredActionFact,
    RequiredFact,
    SelectedFact,
    StatusFact,
)

FILES = Path(__file__).with_name("typeql_files")
NOON = 1714564800.0  # 2024-05-01T12:00:00 UTC


def load(*names):
    return Model.load([FILES / f"{name}.tql" for name in names])


def test_model_is_called_like_its_first_file_unless_a_name_is_given():
    assert load("underwater", "underwater_extended").name == "underwater"
    assert Model.load(str(FILES / "underwater.tql"), "other").name == "other"


def test_elements_have_what_the_file_says():
    model = load("underwater")
    assert list(model.actions) == ["search_pipeline", "inspect_pipeline"]
    assert model.actions["search_pipeline"].functions == ("generate_search_path", "maintain_motion")
    assert list(model.functions) == ["generate_search_path", "maintain_motion", "follow_pipeline"]
    assert [function.always_improve for function in model.functions.values()] == [
        True,
        False,
        False,
    ]
    spiral = model.components["spiral_search"]
    assert (spiral.kind, spiral.package, spiral.executable) == (
        "lifecycle",
        "vehicle_nodes",
        "spiral_search",
    )
    assert spiral.always_improve
    kinds = [component.kind for component in model.components.values()]
    assert kinds == ["lifecycle", "process", "lifecycle", "plain", "plain"]
    assert model.designs["all_thrusters"].components == ("c_thruster_1", "c_thruster_2")
    assert [design.priority for design in model.designs.values()] == [1, 1, 2, None]
    assert model.attributes["water_visibility"].kind == "environmental"
    assert [str(constraint) for constraint in model.constraints] == [
        "water_visibility >= 3.25",
        "water_visibility >= 1.25",
    ]
    assert not model.notes


def test_parameters_are_typed_and_may_be_shared():
    configurations = load("underwater").configurations
    assert dict(configurations["high altitude"].parameters) == {
        "spiral_altitude": 3.0,
        "topics": ["teste", "teste2"],
    }
    assert dict(configurations["low altitude"].parameters) == {
        "spiral_altitude": 1.0,
        "topics": ["teste", "teste2"],
    }


def test_later_file_extends_an_earlier_one():
    model = load("underwater", "underwater_extended")
    assert model.actions["recharge"].functions == ("maintain_motion", "recharge")
    (shared,) = (
        constraint for constraint in model.constraints if constraint.attribute == "battery_level"
    )
    assert [one.name for one in shared.constrained] == ["search_pipeline", "inspect_pipeline"]
    (estimation,) = model.estimations
    assert (estimation.causer.name, estimation.value, estimation.kind) == (
        "recover",
        0.1,
        "negative",
    )
    improved = {name for name, one in model.components.items() if one.always_improve}
    assert improved == {"spiral_search", "recharge"}
    assert not model.facts


def test_loaded_model_answers():
    kb = KnowledgeBase(load("underwater", "underwater_extended"))
    kb.measure("battery_level", 0.2)
    assert not kb.is_feasible("search_pipeline")
    assert kb.is_feasible("recharge")


def test_extension_without_what_it_extends_is_an_error():
    with pytest.raises(
        ValueError, match=r"underwater_extended.tql:3:5: `match` finds nothing: .*'maintain_motion'"
    ):
        load("underwater_extended")


def test_facts_are_told_in_the_order_of_the_file():
    model = load("asserted")
    explore = model.actions["explore"]
    camera = model.components["camera"]
    design = model.designs["by camera"]
    config = model.configurations["day"]
    assert model.facts == (
        RequiredFact(explore),
        StatusFact(model.actions["stuck"], Status.UNFEASIBLE),
        StatusFact(model.functions["see"], Status.CONFIGURATION_ERROR),
        ActiveFact("camera"),
        StatusFact(camera, Status.FAILURE),
        RequiredFact(model.components["lidar"]),
        SelectedFact(design),
        StatusFact(design, Status.UNFEASIBLE),
        SelectedFact(config),
        MeasurementFact("light", 0.25, NOON, latest=False),
        MeasurementFact("light", -0.01, NOON + 0.25, latest=True),
        StatusFact(model.constraints[0], Status.VIOLATED),
        StatusFact(model.constraints[1], Status.SATISFIED),
        RequiredActionFact("explore", {"light": 1.0}, NOON + 1.0),
        RequiredActionFact("stuck", None, NOON - 3600.0, NOON - 1800.0, "failed"),
        RequiredActionFact("explore"),
        ProcessFact("camera", 4711, NOON + 1.5),
        PlanFact(("camera",), ("lidar",), ("day",), NOON + 2.0, None, "completed"),
    )


def test_constraint_that_only_carries_a_status_is_given_an_attribute_and_noted():
    model = load("asserted")
    assert model.constraints[1].attribute == "unnamed attribute 1"
    (note,) = model.notes
    assert "asserted.tql:20:28" in note


def test_types_of_the_file_are_understood():
    model = load("mobile_robot")
    assert {name: one.kind for name, one in model.components.items()} == {
        "kinect": "plain",
        "drive": "lifecycle",
    }
    assert model.designs["by kinect"].function == "see"
    assert model.designs["by kinect"].components == ("kinect", "drive")
    assert model.actions["go"].functions == ("see",)


def test_values_without_quotes_are_taken_as_they_are():
    parameters = load("mobile_robot").configurations["fast"].parameters
    assert dict(parameters) == {"speed": 2.5, "safe": True}


def test_attribute_that_nobody_declares_is_noted():
    (note,) = load("mobile_robot").notes
    assert "mobile_robot.tql:38:8" in note
    assert "'colour'" in note
