"""Attributes that state a unit and a range: what is outside is refused, and every reason shows the unit."""

import math

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from models import Clock

from kb import InvalidValue, KnowledgeBase, Model
from kb.events import Event
from kb.facts import MeasurementFact


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


BOUNDS = st.floats(allow_nan=False) | st.integers(-(10**6), 10**6)


@settings(max_examples=60, deadline=None)
@given(
    st.text(st.characters(exclude_categories=["Cs"]), max_size=12),
    BOUNDS,
    BOUNDS,
)
def test_units_and_ranges_survive_a_file(tmp_path_factory, unit, one, other):
    low, high = sorted((float(one), float(other)))
    assume(low < math.inf and high > -math.inf)
    unit = unit if unit.isprintable() else ""  # no XML has control characters
    model = Model("boat")
    model.quality_attribute("voltage", unit=unit, low=low, high=high)
    path = tmp_path_factory.mktemp("units") / "boat.owl"
    model.save(path)
    loaded = Model.load(path)
    assert loaded == model
    assert (loaded.attributes["voltage"].unit, loaded.attributes["voltage"].low) == (unit, low)
