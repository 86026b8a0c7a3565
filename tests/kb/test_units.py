"""Attributes with a unit and a range: what is outside is refused, and reasons show the unit."""

import math

import pytest
from models import Clock

from kb import InvalidValue, KnowledgeBase, Model, ModelError
from kb.elements import MeasurementFact
from kb.events import Event


def boat(**attribute):
    model = Model("boat")
    voltage = model.quality_attribute(
        "battery_voltage", **{"unit": "V", "low": 0, "high": 17, **attribute}
    )
    model.action("sail", requires=[model.function("steer")], constraints=[voltage >= 11.5])
    model.functions["steer"].design("by rudder", [model.component("rudder")])
    return model


def base(**attribute):
    return KnowledgeBase(boat(**attribute), clock=Clock(10.0))


@pytest.mark.parametrize("value", [-0.1, 17.5, 1e300, -3])
@pytest.mark.parametrize(
    "tell",
    [
        lambda kb, value: kb.measure("battery_voltage", value),
        lambda kb, value: kb.situation(battery_voltage=value),
        lambda kb, value: kb.replay(Event(9, 10.0, "measure", ("battery_voltage", value))),
        lambda kb, value: kb.model.add_fact(MeasurementFact("battery_voltage", value)),
    ],
)
def test_a_value_out_of_range_is_refused_with_the_range(tell, value):
    kb = base()
    kb.measure("battery_voltage", 12.0)
    revision = kb.revision
    with pytest.raises(InvalidValue, match="battery_voltage is from 0 to 17 V"):
        tell(kb, value)
    assert (kb.attributes["battery_voltage"].value, kb.revision, kb.model.facts) == (
        12.0,
        revision,
        (),
    )


def test_diagnostics_out_of_range_are_a_problem_with_the_range():
    kb = base()
    (problem,) = kb.receive({"message": "QA status", "values": {"battery_voltage": "24"}})
    assert "battery_voltage is from 0 to 17 V" in problem.reason
    assert kb.attributes["battery_voltage"].value is None


@pytest.mark.parametrize("value", [0, 17, 0.0, 17.0, -0.0])
def test_the_ends_belong_to_the_range(value):
    kb = base()
    kb.measure("battery_voltage", value)
    assert kb.attributes["battery_voltage"].value == value


def test_reasons_remedies_and_events_show_the_unit():
    kb = base()
    heard = []
    kb.subscribe(lambda event: heard.append(event.text))
    kb.measure("battery_voltage", 11.2)
    said = str(kb.explain("sail"))
    assert "battery_voltage 11.2 V violates >= 11.5 V" in said
    assert "battery_voltage >= 11.5 V" in said.partition("violates >= 11.5 V")[2]
    assert "battery_voltage is 11.2 V" in str(kb.explain("battery_voltage"))
    assert "battery_voltage is 11.2 V" in heard[0]
    kb.measure("battery_voltage", math.nextafter(11.5, 0.0))
    assert "just below 11.5 V violates >= 11.5 V" in str(kb.explain("sail"))
    view = kb.attributes["battery_voltage"]
    assert (view.unit, view.low, view.high) == ("V", 0.0, 17.0)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"low": math.nan}, "low end of the range of 'battery_voltage' is a number, not nan"),
        ({"high": "17"}, "high end"),
        ({"low": True}, "low end"),
        ({"low": math.inf, "high": math.inf}, "holds no number"),
        ({"low": 18}, "holds no number: from 18.0 to 17.0"),
        ({"unit": 3}, "the unit of 'battery_voltage' is a text, not 3"),
    ],
)
def test_what_is_no_unit_or_range_is_refused(given, said):
    model = Model("empty")
    with pytest.raises(ModelError, match=said):
        model.quality_attribute("battery_voltage", **{"low": 0, "high": 17, **given})
    assert not model.attributes


def test_units_and_ranges_survive_a_file(tmp_path):
    model = boat(low=-1e-300, high=math.inf, unit="°C \U0001f321")
    model.save(tmp_path / "boat.owl")
    assert Model.load(tmp_path / "boat.owl") == model
