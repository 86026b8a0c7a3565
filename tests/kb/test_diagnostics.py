"""Facts in arrays of diagnostics: ROSA's own texts, and everybody's by rules."""

import json
import math
from types import SimpleNamespace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from kb import (
    DiagnosticProblem,
    DiagnosticRules,
    InvalidValue,
    KnowledgeBase,
    Model,
    Status,
    UnknownName,
)

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
OK, WARN, ERROR, STALE = range(4)


def make_kb():
    model = Model("watched")
    for name in ("light", "battery level", "x >="):
        model.quality_attribute(name)
    for name in ("camera", "lidar", "light"):
        model.component(name)
    return KnowledgeBase(model, clock=lambda: 7.0)


@pytest.fixture
def kb():
    return make_kb()


def status(message, level=OK, name="", **values):
    return {"level": level, "name": name, "message": message, "values": values}


def spellings(words):
    return [spelling for word in words for spelling in (word, word.title(), f"  {word.upper()}\n")]


# -------------------------------------------------------------------- ROSA's own texts


@pytest.mark.parametrize("message", spellings(MEASUREMENTS))
def test_measurement_message_measures_attributes(kb, message):
    assert kb.receive({"status": [status(message, light="0.5")]}) == ()
    assert (kb.attributes["light"].value, kb.attributes["light"].time) == (0.5, 7.0)
    assert kb.components["light"].status is Status.FEASIBLE


@pytest.mark.parametrize("message", spellings(REPORTS))
@pytest.mark.parametrize("value", spellings((*FAILED, *RECOVERED)))
def test_component_report_fails_or_recovers_it(kb, message, value):
    is_failed = value.strip().casefold() in FAILED
    kb.component_recovered("camera") if is_failed else kb.component_failed("camera")
    assert kb.receive({"status": [status(message, camera=value)]}) == ()
    assert (kb.components["camera"].status is Status.FAILURE) is is_failed


@pytest.mark.parametrize("message", ["", "Temperature", "ea  status", "components", "qa status ok"])
def test_foreign_message_without_rules_is_passed_over(kb, message):
    before = kb.log.last
    assert kb.receive([status(message, ERROR, light="0.5", camera="error", nonsense="?")]) == ()
    assert (kb.log.last, kb.history.rejected) == (before, 0)


def test_all_keys_are_read_though_one_recovers(kb):
    kb.assert_status(kb.components["camera"], Status.FAILURE)
    measured = {"light": "0.5", "battery level": "0.25", "x >=": "-1e3"}
    array = [
        status("component status", camera="recovered", lidar="error"),
        status("qa status", **measured),
        status("component", light="FALSE"),
    ]
    assert kb.receive({"status": array}) == ()
    assert kb.components["camera"].status is Status.FEASIBLE
    assert kb.components["lidar"].status is Status.FAILURE
    assert kb.components["light"].status is Status.FAILURE
    assert [view.value for view in kb.attributes.values()] == [0.5, 0.25, -1000.0]


def test_worse_of_what_contradicts_itself_wins(kb):
    kb.measure("light", 0.9)
    array = [
        status("component status", camera="ok", lidar="ok"),
        status("component status", camera="error"),
        status("component status", ERROR, light="ok"),
        status("qa status", STALE, light="0.5"),
        status("qa status", ERROR, **{"battery level": "0.1"}),
    ]
    assert kb.receive(array) == ()
    assert kb.components["camera"].status is Status.FAILURE
    assert kb.components["lidar"].status is Status.FEASIBLE
    assert kb.components["light"].status is Status.FAILURE
    assert kb.attributes["light"].is_stale
    assert kb.attributes["battery level"].value == 0.1


def test_array_that_breaks_while_it_is_read_is_a_problem(kb):
    def statuses():
        yield status("qa status", light="0.5")
        raise RuntimeError("connection lost")

    (problem,) = kb.receive({"status": statuses()})
    assert problem.reason == "it cannot be read: connection lost"
    assert kb.attributes["light"].value == 0.5


# -------------------------------------------------------------------- the forms of an array

PAIRS = (("light", "0.5"), ("battery level", "0.25"))
VALUES = {
    "mapping": lambda: dict(PAIRS),
    "numbers": lambda: {"light": 0.5, "battery level": 0.25},
    "mappings of key and value": lambda: [{"key": key, "value": value} for key, value in PAIRS],
    "objects": lambda: [SimpleNamespace(key=key, value=value) for key, value in PAIRS],
}
SHAPES = {
    "object": lambda entry: SimpleNamespace(header=None, status=[entry]),
    "mapping": lambda entry: {"header": {}, "status": [entry]},
    "list": lambda entry: [entry],
    "single": lambda entry: entry,
    "rclpy": lambda entry: SimpleNamespace(status=[SimpleNamespace(level=b"\x00", **entry)]),
}


@pytest.mark.parametrize("values", VALUES)
@pytest.mark.parametrize("shape", SHAPES)
def test_every_shape_of_an_array_is_read(kb, shape, values):
    entry = {"message": "QA status", "values": VALUES[values]()}
    assert kb.receive(SHAPES[shape](entry)) == ()
    assert [kb.attributes[name].value for name, _ in PAIRS] == [0.5, 0.25]


@pytest.mark.parametrize(
    "value",
    ["nan", "-inf", "", "dark", "0,5", "0.5 lx", "1e999", "0x10", None, [1.0], True],
)
def test_no_finite_number_is_reported_the_rest_is_read(kb, value, caplog):
    kb.measure("light", 0.9)
    measured = {"light": value, "battery level": "0.25"}
    problems = kb.receive([status("ea status", **measured), status("component", camera="error")])
    assert [(problem.key, problem.value) for problem in problems] == [("light", str(value))]
    assert "float" in problems[0].reason or "number" in problems[0].reason
    assert "light" in caplog.text
    assert kb.history.rejected == 1
    assert [kb.attributes[name].value for name, _ in PAIRS] == [0.9, 0.25]
    assert kb.components["camera"].status is Status.FAILURE


@pytest.mark.parametrize(
    ("message", "key", "value", "reason"),
    [
        ("qa status", "ligt", "0.50", "did you mean 'light'"),
        ("component", "camra", "error", "did you mean 'camera'"),
        ("component", "camra", "ok", "did you mean 'camera'"),
        ("ea status", "camera", "0.5", "unknown attribute 'camera'"),
        ("component", "camera", "active", "one of ok, recovered, error, failure, false"),
    ],
)
def test_unknown_key_or_word_is_named_the_rest_is_read(kb, message, key, value, reason):
    problems = kb.receive([status(message, **{key: value}), status("qa status", light="0.25")])
    assert [(problem.key, problem.value) for problem in problems] == [(key, value)]
    assert reason in str(problems[0])
    assert kb.attributes["light"].value == 0.25


RULES = {
    "camera: *": "camera",
    "battery: charge": {"attributes": {"Charge": "battery level"}},
    "battery: *": {"component": "light", "attributes": {"Lux": "light"}, "warn": "failed"},
    "lidar*": {"component": "lidar", "warn": "recovered", "stale": "failed"},
}
KEYS = st.sampled_from(("light", "battery level", "camera", "unknown", "Charge", "Lux"))
JUNK = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
ANYTHING = st.recursive(
    JUNK,
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
)
STATUSES = st.fixed_dictionaries(
    {
        "message": st.sampled_from((*MEASUREMENTS, *REPORTS, "other")) | JUNK,
        "name": st.sampled_from(("camera: x", "battery: charge", "battery: y", "lidar", "z"))
        | JUNK,
        "level": st.sampled_from((OK, WARN, ERROR, STALE)) | JUNK,
        "values": st.lists(st.tuples(KEYS, st.sampled_from(("ok", "error", "0.5")) | JUNK))
        | ANYTHING,
    }
)


@given(st.lists(STATUSES, max_size=4) | ANYTHING, st.booleans())
@example(None, False)
@example("qa status", False)
@example([None, [[]]], False)
def test_no_array_raises_and_facts_stay_finite(array, has_rules):
    kb = make_kb()
    problems = kb.receive(array, rules=DiagnosticRules(RULES) if has_rules else None)
    assert kb.history.rejected == len(problems)
    assert all(isinstance(problem, DiagnosticProblem) and problem.reason for problem in problems)
    for attribute in kb.attributes.values():
        assert attribute.value is None or math.isfinite(attribute.value)


# -------------------------------------------------------------------- by rules

UPDATER = """{"header": {"stamp": {"sec": 1795837572, "nanosec": 709228094}, "frame_id": ""},
"status": [
{"level": 0, "name": "camera_driver: connection", "message": "connected", "hardware_id": "cam0",
 "values": [{"key": "port", "value": "/dev/video0"}, {"key": "temperature", "value": "41.5"}]},
{"level": 1, "name": "camera_driver: lens", "message": "dirty lens", "hardware_id": "cam0",
 "values": [{"key": "clean", "value": "False"}]},
{"level": 3, "name": "camera_driver: calibration", "message": "no calibration heard",
 "hardware_id": "cam0", "values": []}]}"""
"""A message of the real diagnostic_updater, by rosbridge."""


@pytest.mark.parametrize(
    ("level", "warn", "stale", "before", "after"),
    [
        (OK, "ignored", "not measured", Status.FAILURE, Status.FEASIBLE),
        (ERROR, "ignored", "not measured", Status.FEASIBLE, Status.FAILURE),
        (WARN, "ignored", "not measured", Status.FAILURE, Status.FAILURE),
        (WARN, "ignored", "not measured", Status.FEASIBLE, Status.FEASIBLE),
        (WARN, "recovered", "not measured", Status.FAILURE, Status.FEASIBLE),
        (WARN, "failed", "not measured", Status.FEASIBLE, Status.FAILURE),
        (STALE, "ignored", "not measured", Status.FEASIBLE, Status.FEASIBLE),
        (STALE, "ignored", "failed", Status.FEASIBLE, Status.FAILURE),
    ],
)
def test_level_means_what_its_rule_says(kb, level, warn, stale, before, after):
    if before is Status.FAILURE:
        kb.component_failed("camera")
    rule = {"component": "camera", "warn": warn, "stale": stale}
    kb.receive(
        [status("text", level, "camera: frame rate")], rules=DiagnosticRules({"camera: *": rule})
    )
    assert kb.components["camera"].status is after


def test_stale_status_makes_its_attributes_not_measured(kb):
    rules = DiagnosticRules(RULES)
    kb.receive([status("full", OK, "battery: charge", Charge="0.8")], rules=rules)
    assert kb.attributes["battery level"].value == 0.8
    both = [
        status("full", OK, "battery: charge", Charge="0.7"),
        status("", STALE, "battery: charge"),
    ]
    for array in (both, both[::-1]):
        kb.measure("battery level", 0.8)
        kb.receive(array, rules=rules)
        assert kb.attributes["battery level"].is_stale


def test_component_recovers_when_none_of_its_names_fails(kb):
    rules = DiagnosticRules(RULES)
    kb.receive([status("no data", ERROR, "camera: frame rate")], rules=rules)
    kb.receive([status("connected", OK, "camera: connection")], rules=rules)
    assert kb.components["camera"].status is Status.FAILURE
    assert "camera: frame rate: no data" in kb.why("camera")
    kb.receive([status("30 Hz", OK, "camera: frame rate")], rules=rules)
    assert kb.components["camera"].status is Status.FEASIBLE


def test_failure_repeated_in_other_words_is_one_event(kb):
    rules = DiagnosticRules(RULES)
    kb.receive([status("4.3 Hz", ERROR, "camera: frame rate")], rules=rules)
    before = kb.log.last
    kb.receive([status("4.2 Hz", ERROR, "camera: frame rate")], rules=rules)
    assert kb.log.last == before


def test_real_updater_message_is_understood_or_counted(kb):
    rules = DiagnosticRules(
        {
            "camera_driver: connection": {
                "component": "camera",
                "attributes": {"temperature": "x >="},
            },
            "*: lens": {"component": "lidar", "warn": "failed"},
        }
    )
    for _ in range(2):
        assert kb.receive(json.loads(UPDATER), rules=rules) == ()
    assert kb.attributes["x >="].value == 41.5
    assert kb.components["lidar"].status is Status.FAILURE
    assert rules.not_understood == {"camera_driver: calibration": 2}


@pytest.mark.parametrize(
    ("table", "reason"),
    [
        ({"c": 5}, "the name of a component, or a table of component, .*; not 5"),
        ({"c": {"components": "camera"}}, "of component, attributes, warn, stale; not {'comp"),
        (
            {"c": {"component": "camera", "warn": "maybe"}},
            "ignored, recovered, failed; not 'maybe'",
        ),
        ({"c": {"component": "camera", "stale": "ok"}}, "not measured, failed; not 'ok'"),
    ],
)
def test_malformed_rule_is_refused_with_what_to_write(table, reason):
    with pytest.raises(InvalidValue, match=reason):
        DiagnosticRules(table)


def test_rule_for_an_unknown_name_is_found_by_check(kb):
    DiagnosticRules(RULES).check(kb)
    with pytest.raises(UnknownName, match="did you mean 'camera'"):
        DiagnosticRules({"c": "camra"}).check(kb)
    with pytest.raises(UnknownName, match="did you mean 'light'"):
        DiagnosticRules({"c": {"attributes": {"Lux": "ligt"}}}).check(kb)
