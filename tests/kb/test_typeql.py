"""Model files in TypeQL are read as they are meant, in all spellings."""

import json
from pathlib import Path

import pytest

from kb import KnowledgeBase, Model, ModelFileError

FILES = Path(__file__).with_name("typeql_files")
EXPECTED = json.loads((FILES / "expected.json").read_text())
ROBOT = """insert
$a isa Action, has action-name 'go'; $f isa Function, has function-name 'move';
$c isa Component, has component-name 'motor'; $d (function: $f, component: $c) isa function-design,
has function-design-name 'by motor'; $q isa QualityAttribute, has attribute-name 'charge';
"""
PARAMETER = "$p isa ComponentParameter, has parameter-key 'k', has parameter-value"
CONFIGURATION = "(component: $c, parameter: $p) isa component-configuration, has name 'x';"


@pytest.fixture
def load(tmp_path):
    def loaded(*texts):
        paths = [tmp_path / f"robot{number}.tql" for number in range(len(texts))]
        for path, text in zip(paths, texts, strict=True):
            path.write_text(text)
        return Model.load(paths)

    return loaded


@pytest.mark.parametrize("names", EXPECTED)
def test_files_become_the_expected_models(names):
    model = Model.load([FILES / f"{name}.tql" for name in names.split()])
    assert json.loads(json.dumps(model.plain())) == EXPECTED[names]


@pytest.mark.parametrize(
    ("name", "place"), [("asserted", "20:28: this attribute has no name"), ("mobile_robot", "38:8")]
)
def test_odd_statement_of_a_file_is_noted(name, place):
    (note,) = Model.load(FILES / f"{name}.tql", "other").notes
    assert f"{name}.tql:{place}" in note


def test_loaded_model_answers():
    kb = KnowledgeBase(Model.load([FILES / "underwater.tql", FILES / "underwater_extended.tql"]))
    kb.measure("battery_level", 0.2)
    assert not kb.is_feasible("search_pipeline")
    assert kb.is_feasible("recharge")


CONSTRAINT = ["constraint", {"attribute": "charge", "operator": "<", "value": 0.5}]
ESTIMATION = {"attribute": "charge", "value": -3.0, "kind": "positive"}
CAUSED = ["estimation", {**ESTIMATION, "causer": ["function design", "by motor"]}]
MOTOR = {"name": "driver", "kind": "process"}
ADDED = [
    *(
        (f"$c2 isa {label}, has component-name 'driver';", ["component", {**MOTOR, "kind": kind}])
        for label, kind in (
            *((label, "process") for label in ("ROSNode", "RosNode", "ros_node", "ros-node")),
            *((label, "lifecycle") for label in ("LifeCycleNode", "lifecyclenode")),
        )
    ),
    *(
        (f"$q2 isa {label}, has name 'x';", ["attribute", {"name": "x"}])
        for label in ("Attribute", "Measure", "measure", "quality_attribute")
    ),
    (
        "$q2 isa EnvironmentAttribute, has name 'x';",
        ["attribute", {"name": "x", "kind": "environmental"}],
    ),
    *(
        (
            f"{relation} isa constraint, has value 0.5, has operator '<';",
            ["constraint", {**CONSTRAINT[1], "constrained": [["action", "go"]]}],
        )
        for relation in (
            "(attribute: $q, constrained: $a)",
            "(constraint: $q, constrained-element: $a)",
            "(measured-attribute: $q, constrained-action: $a)",
            "(constraining_attribute: $q, CONSTRAINED: $a)",
            "(constraint:attribute: $q, constraint:constrained: $a)",
            "(quality-attribute: $q, action: $a)",
            "($q, constrained: $a)",
            "($a, $q)",
            "($role: $q, constrained: $a)",
        )
    ),
    *(
        (f"{relation} isa estimation, has estimation-value -3;", CAUSED)
        for relation in (
            "(causer: $d, affected: $q)",
            "(impacting-element: $d, impacted-attribute: $q)",
            "(source: $d, estimated-attribute: $q)",
            "(function-design: $d, measure: $q)",
            "(estimation: $q, estimation: $d)",
            "(element: $q, element: $d)",
        )
    ),
    (
        "$g isa Function, has name 'see'; (actions: $a, required-functions: $f) isa "
        "functional-requirement; (action: $a, function: $g) isa functional-requirement;",
        ["action", {"name": "go", "functions": ["move", "see"]}],
    ),
    ("$c has pid 12;", ["component process", {"component": "motor", "pid": 12}]),
]


@pytest.mark.parametrize(("text", "row"), ADDED)
def test_statement_in_any_spelling_becomes_its_row(load, text, row):
    assert row in json.loads(json.dumps(load(ROBOT + text).plain()))


@pytest.mark.parametrize(
    ("values", "latest"),
    [
        (["1", "2"], [False, True]),
        (["1, has time 2024-01-02", "2, has time 2024-01-01"], [True, False]),
        (["1, has latest true", "2"], [True, False]),
        (["1", "2, has latest false"], [True, False]),
        (["1, has latest false"], [False]),
    ],
)
def test_newest_measurement_is_the_latest_unless_the_file_says_which(load, values, latest):
    relation = "(measured-attribute: $q) isa measurement, has measurement-value"
    facts = load(ROBOT + "".join(f"{relation} {value};" for value in values)).facts
    assert [fact.latest for fact in facts] == latest


@pytest.mark.parametrize(
    ("value", "label", "expected"),
    [
        ("'true'", "boolean", True),
        ("false", "bool", False),
        ("'3'", "long", 3),
        ("3.0", "integer", 3),
        ("'1e3'", "PARAMETER_DOUBLE", 1000.0),
        ("3.5", "string", "3.5"),
        ("'[3.0, 5]'", "double_array", [3.0, 5.0]),
        ("'[]'", "long_array", []),
        ("'[true, False]'", "bool-array", [True, False]),
        ("'[teste, teste2]'", "string_array", ["teste", "teste2"]),
        ("'[0.10, 0x10, True]'", "string_array", ["0.10", "0x10", "True"]),
        ('"[\'a\', \\"b\\"]"', "string[]", ["a", "b"]),
        ("'[\"a, b\"]'", "string_array", ["a, b"]),
        ("'3.0'", None, "3.0"),
        ("3.0", None, 3.0),
    ],
)
def test_parameter_is_read_as_its_type_says(load, value, label, expected):
    sort = f", has parameter-type '{label}'" if label else ""
    model = load(f"{ROBOT}{CONFIGURATION}{PARAMETER} {value}{sort};")
    read = model.configurations["x"].parameters["k"]
    assert (type(read), read) == (type(expected), expected)


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("'a\"b'", 'a"b'),
        (r"'a\'b'", "a'b"),
        (r"'a\\n'", "a\\n"),
        (r"'a\n'", "a\n"),
        (r"'\d'", "\\d"),
        ("'two\nlines'", "two\nlines"),
        (r"'\u00e9'", "é"),
        ("'# none'", "# none"),
    ],
)
def test_text_is_read_with_its_escapes(load, written, meant):
    assert list(load(f"insert $a isa Action, has action-name {written};").actions) == [meant]


def test_match_finds_things_by_type_and_name(load):
    found = "match $c isa Component, has component-name 'motor'; insert $c has always-improve true;"
    assert load(ROBOT, found).components["motor"].always_improve
    for pattern in ("$c isa Component", "$c has name 'motor'", "($c) isa function-design"):
        with pytest.raises(ModelFileError, match="`match` finds things by type and name"):
            load(ROBOT, f"match {pattern}; insert $c has always-improve true;")
