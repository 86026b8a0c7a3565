"""Monitoring data by the /diagnostics convention: every word, every shape, and nothing lost beside what is wrong."""

import json
import math
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kb import DiagnosticProblem, KnowledgeBase, Model, Status

MEASUREMENTS = (
    "qa status",
    "qa measurement",
    "ea status",
    "ea measurement",
    "attribute measurement",
)
REPORTS = ("component status", "component")
RECOVERED = ("recovered", "ok")
FAILED = ("false", "failure", "error")


def knowledge():
    model = Model("watched")
    for name in ("light", "battery level", "x >="):
        model.quality_attribute(name)
    for name in ("camera", "lidar", "light"):
        model.component(name)
    return KnowledgeBase(model, clock=lambda: 7.0)


@pytest.fixture
def kb():
    return knowledge()


def status(message, **values):
    return {"level": 0, "name": "", "message": message, "values": values}


def spellings(word):
    return [word, word.upper(), word.title(), f"  {word}\n"]


@pytest.mark.parametrize("message", [text for word in MEASUREMENTS for text in spellings(word)])
def test_each_measurement_message_measures_attributes(kb, message):
    assert kb.receive({"status": [status(message, light="0.5")]}) == ()
    assert (kb.attributes["light"].value, kb.attributes["light"].time) == (0.5, 7.0)
    assert kb.components["light"].status is Status.FEASIBLE


@pytest.mark.parametrize("message", [text for word in REPORTS for text in spellings(word)])
@pytest.mark.parametrize("value", [text for word in FAILED for text in spellings(word)])
def test_each_word_of_failure_reports_a_component_failed(kb, message, value):
    assert kb.receive({"status": [status(message, camera=value)]}) == ()
    assert kb.components["camera"].status is Status.FAILURE


@pytest.mark.parametrize("message", [text for word in REPORTS for text in spellings(word)])
@pytest.mark.parametrize("value", [text for word in RECOVERED for text in spellings(word)])
def test_each_word_of_recovery_retracts_a_failure(kb, message, value):
    kb.component_failed("camera")
    assert kb.receive({"status": [status(message, camera=value)]}) == ()
    assert kb.components["camera"].status is Status.FEASIBLE


def test_recovery_retracts_an_asserted_failure_too(kb):
    kb.assert_status(kb.components["camera"], Status.FAILURE)
    kb.receive([status("component", camera="ok")])
    assert kb.components["camera"].status is Status.FEASIBLE


@pytest.mark.parametrize(
    "message", ["", "Temperature", "qa", "ea  status", "components", "qa status ok", "attribute"]
)
def test_a_foreign_message_is_passed_over(kb, message):
    assert (
        kb.receive({"status": [status(message, light="0.5", camera="error", nonsense="?")]}) == ()
    )
    assert kb.attributes["light"].value is None
    assert kb.components["camera"].status is Status.FEASIBLE
    assert kb.history.rejected == 0


def test_all_keys_of_all_statuses_are_read_recoveries_or_not(kb):
    kb.component_failed("camera")
    array = [
        status("component status", camera="recovered", lidar="error"),
        status("something else", light="0.1"),
        status("qa status", **{"light": "0.5", "battery level": "0.25", "x >=": "-1e3"}),
        status("component", light="FALSE"),
    ]
    assert kb.receive({"status": array}) == ()
    assert [kb.components[name].status for name in ("camera", "lidar", "light")] == [
        Status.FEASIBLE,
        Status.FAILURE,
        Status.FAILURE,
    ]
    assert [one.value for one in kb.attributes.values()] == [0.5, 0.25, -1000.0]


def test_the_last_of_two_values_for_one_key_stands(kb):
    kb.receive([{"message": "qa status", "values": [("light", "1"), ("light", "2")]}])
    assert kb.attributes["light"].value == 2.0


VALUES = {
    "mapping": {"light": "0.5", "battery level": "0.25"},
    "numbers": {"light": 0.5, "battery level": 0.25},
    "pairs": (("light", "0.5"), ("battery level", "0.25")),
    "lists": [["light", "0.5"], ["battery level", "0.25"]],
    "mappings of key and value": [
        {"key": "light", "value": "0.5"},
        {"key": "battery level", "value": "0.25"},
    ],
    "objects": [
        SimpleNamespace(key="light", value="0.5"),
        SimpleNamespace(key="battery level", value="0.25"),
    ],
    "iterator": None,
}


@pytest.mark.parametrize("values", VALUES)
@pytest.mark.parametrize(
    "whole", ["object", "mapping", "list", "tuple", "one", "object of objects", "json"]
)
def test_every_shape_of_an_array_is_taken_in(kb, whole, values):
    def given_values():
        return VALUES[values] if values != "iterator" else iter(VALUES["pairs"])

    one = {"message": "QA status", "values": given_values()}
    if whole == "json" and values in ("objects", "iterator"):
        one["values"] = VALUES["mappings of key and value"]
    shapes = {
        "object": lambda: SimpleNamespace(header=None, status=[one]),
        "mapping": lambda: {"header": {}, "status": [one]},
        "list": lambda: [one],
        "tuple": lambda: (one,),
        "one": lambda: one,
        "object of objects": lambda: SimpleNamespace(
            status=[SimpleNamespace(level=b"\x00", hardware_id="", **one)]
        ),
        "json": lambda: json.loads(json.dumps({"status": [one]})),
    }
    assert kb.receive(shapes[whole]()) == ()
    assert [kb.attributes[name].value for name in ("light", "battery level")] == [0.5, 0.25]


@pytest.mark.parametrize(
    "value",
    ["nan", "inf", "-inf", "Infinity", "", "dark", "0,5", "0.5 lx", "None", "1e999", "0x10"],
)
def test_what_is_no_finite_number_is_reported_and_the_rest_is_taken_in(kb, value, caplog):
    kb.measure("light", 0.9)
    problems = kb.receive(
        [
            status("ea status", **{"light": value, "battery level": "0.25"}),
            status("component", camera="error"),
        ]
    )
    assert [(one.key, one.value) for one in problems] == [("light", value)]
    assert "number" in problems[0].reason
    assert "light" in caplog.text
    assert kb.history.rejected == 1
    assert kb.attributes["light"].value == 0.9
    assert kb.attributes["battery level"].value == 0.25
    assert kb.components["camera"].status is Status.FAILURE


@pytest.mark.parametrize("value", [math.nan, math.inf, None, object(), [1.0], b"0.5", True])
def test_a_value_that_is_no_number_at_all_is_reported(kb, value):
    problems = kb.receive(
        [{"message": "qa status", "values": {"light": value, "battery level": 0.25}}]
    )
    assert [one.key for one in problems] == ["light"]
    assert kb.attributes["light"].value is None
    assert kb.attributes["battery level"].value == 0.25


@pytest.mark.parametrize("value", ["1_000", "٣", "1_0.5"])
def test_what_only_python_takes_for_a_number_is_none(kb, value):
    assert len(kb.receive([status("qa status", light=value)])) == 1


@pytest.mark.parametrize(
    ("message", "key", "value", "near"),
    [
        ("qa status", "ligt", "0.5", "did you mean 'light'"),
        ("component", "camra", "error", "did you mean 'camera'"),
        ("ea status", "camera", "0.5", "unknown attribute 'camera'"),
        ("qa status", "", "0.5", "unknown attribute ''"),
    ],
)
def test_an_unknown_key_is_named_with_the_nearest_and_the_rest_is_taken_in(
    kb, message, key, value, near
):
    problems = kb.receive([status(message, **{key: value}), status("qa status", light="0.25")])
    assert [one.key for one in problems] == [key]
    assert near in str(problems[0])
    assert kb.attributes["light"].value == 0.25
    assert kb.history.rejected == 1


@pytest.mark.parametrize(
    ("message", "value"), [("component", "error"), ("component", "ok"), ("qa status", "0.50")]
)
def test_a_problem_with_an_unknown_key_shows_the_value_as_it_was_given(kb, message, value):
    (problem,) = kb.receive([status(message, nothing=value)])
    assert problem.value == value


@pytest.mark.parametrize("value", ["active", "true", "", "failed", "0"])
def test_an_unknown_word_about_a_component_is_reported_and_lists_those_that_are_known(kb, value):
    (problem,) = kb.receive([status("component", camera=value, lidar="error")])
    assert isinstance(problem, DiagnosticProblem)
    assert all(
        repr(word) in problem.reason or word in problem.reason for word in (*RECOVERED, *FAILED)
    )
    assert kb.components["lidar"].status is Status.FAILURE


def test_rejected_counts_every_problem_of_every_array(kb):
    for _ in range(3):
        kb.receive([status("qa status", light="nan", nothing="1", x="?")])
    kb.receive([status("qa status", light="0.5")])
    assert kb.history.rejected == 9


@pytest.mark.parametrize(
    "array",
    [
        None,
        5,
        "qa status",
        b"",
        [],
        {},
        {"status": []},
        {"status": None},
        [None, 3, "text", [[]]],
        object(),
    ],
)
def test_what_is_no_array_says_nothing_and_breaks_nothing(kb, array):
    kb.receive(array)
    assert all(one.value is None for one in kb.attributes.values())


@pytest.mark.parametrize(
    "values", [5, None, "text", [None], [5], [("a", "b", "c")], [{}], [{"key": "light"}]]
)
def test_values_that_are_none_are_reported_or_passed_over_and_the_rest_is_taken_in(kb, values):
    kb.receive([{"message": "qa status", "values": values}, status("qa status", light="0.25")])
    assert kb.attributes["light"].value == 0.25


KEYS = st.sampled_from(("light", "battery level", "camera", "unknown", "")) | st.text(max_size=5)
JUNK = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
PAIRS = st.lists(st.tuples(KEYS, JUNK | st.sampled_from(("ok", "error", "0.5"))), max_size=4)
ANYTHING = st.recursive(
    JUNK,
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
)
ARRAYS = st.lists(
    st.fixed_dictionaries(
        {
            "message": st.sampled_from((*MEASUREMENTS, *REPORTS, "other")) | JUNK,
            "values": PAIRS | ANYTHING,
        }
    ),
    max_size=4,
)


@given(ARRAYS | ANYTHING)
def test_no_array_whatever_raises_and_facts_stay_finite(array):
    kb = knowledge()
    problems = kb.receive(array)
    assert kb.history.rejected == len(problems)
    assert all(isinstance(one, DiagnosticProblem) and one.reason for one in problems)
    for attribute in kb.attributes.values():
        assert attribute.value is None or math.isfinite(attribute.value)


@given(
    st.lists(
        st.tuples(st.sampled_from(("light", "battery level")), st.floats(allow_nan=True)),
        max_size=6,
    )
)
def test_every_pair_is_either_taken_in_or_reported(pairs):
    kb = knowledge()
    problems = kb.receive([{"message": "qa status", "values": pairs}])
    finite = [(key, value) for key, value in pairs if math.isfinite(value)]
    assert len(problems) == len(pairs) - len(finite)
    for key, value in dict(finite).items():
        assert kb.attributes[key].value == value
