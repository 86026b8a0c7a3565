"""Model files in TypeQL are read as they are meant, in all spellings."""

import json
from pathlib import Path

import pytest

from kb import KnowledgeBase, Model, ModelFileError

FILES = Path(__file__).with_name("typeql_files")
EXPECTED = json.loads((FILES / "expected.json").read_text())
ROBOT = """insert
$a isa Action, has action-name 'go'; $f isa Function, has function-name 'move';
$c isa Component, has component-name 'motor';
$d (function: $f, required-component: $c) isa function-design, has function-design-name 'by motor';
$q isa QualityAttribute, has attribute-name 'charge';
"""
PARAMETER = "$p isa ComponentParameter, has parameter-key 'k', has parameter-value"
CONFIGURATION = """(component: $c, parameter: $p) isa component-configuration,
has component-configuration-name 'x';"""


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


def test_unknown_attribute_is_noted():
    (note,) = Model.load(FILES / "mobile_robot.tql").notes
    assert "mobile_robot.tql:38:8: unknown attribute of function-design 'colour'" in note


def test_loaded_model_answers():
    kb = KnowledgeBase(Model.load([FILES / "underwater.tql", FILES / "underwater_extended.tql"]))
    kb.measure("battery_level", 0.2)
    assert not kb.is_feasible("search_pipeline")
    assert kb.is_feasible("recharge")


@pytest.mark.parametrize(
    ("values", "latest"),
    [
        (["1", "2"], [True, True]),
        (["1, has latest true", "2"], [True, False]),
        (["1", "2, has latest false"], [True, False]),
    ],
)
def test_measurement_is_the_latest_unless_another_is_stated_to_be(load, values, latest):
    relation = "(measured-attribute: $q) isa measurement, has measurement-value"
    facts = load(ROBOT + "".join(f"{relation} {value};" for value in values)).facts
    assert [fact.latest for fact in facts] == latest


@pytest.mark.parametrize(
    ("value", "label", "expected"),
    [
        ("'true'", "boolean", True),
        ("'3'", "long", 3),
        ("'1e3'", "double", 1000.0),
        ("3.5", "string", "3.5"),
        ("'[3.0, 5]'", "double_array", [3.0, 5.0]),
        ("'[]'", "long_array", []),
        ("'[true, False]'", "boolean_array", [True, False]),
        ("'[teste, teste2]'", "string_array", ["teste", "teste2"]),
        ("'[0.10, 0x10, True]'", "string_array", ["0.10", "0x10", "True"]),
        ('"[\'a\', \\"b\\"]"', "string_array", ["a", "b"]),
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
        ("'# none'", "# none"),
    ],
)
def test_text_is_read_with_its_escapes(load, written, meant):
    assert list(load(f"insert $a isa Action, has action-name {written};").actions) == [meant]


def test_match_finds_things_by_type_and_name(load):
    found = "match $c isa Component, has component-name 'motor'; insert $c has always-improve true;"
    assert load(ROBOT, found).components["motor"].always_improve
    with pytest.raises(ModelFileError, match="`match` finds nothing: unknown component 'moto'"):
        load(ROBOT, found.replace("motor", "moto"))
