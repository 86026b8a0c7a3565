"""The spellings in which types, roles, attributes and values may come, and what `match` finds."""

import pytest

from kb import Model
from kb.facts import MeasurementFact, ProcessFact
from kb.files import ModelFileError

ROBOT = """insert
$a isa Action, has action-name 'go'; $f isa Function, has function-name 'move';
$c isa Component, has component-name 'motor'; $d (function: $f, component: $c) isa function-design,
has function-design-name 'by motor'; $q isa QualityAttribute, has attribute-name 'charge';
"""


@pytest.fixture
def load(tmp_path):
    def loaded(*texts):
        paths = [tmp_path / f"robot{number}.tql" for number in range(len(texts))]
        for path, text in zip(paths, texts, strict=True):
            path.write_text(text)
        return Model.load(paths)

    return loaded


@pytest.mark.parametrize(
    "label", ["ROSNode", "RosNode", "ros_node", "ros-node", "LifeCycleNode", "lifecyclenode"]
)
def test_type_is_known_in_other_spellings(load, label):
    model = load(f"insert $c isa {label}, has component-name 'driver';")
    assert model.components["driver"].kind in ("process", "lifecycle")


@pytest.mark.parametrize(
    "label", ["Attribute", "Measure", "measure", "QualityAttribute", "quality_attribute"]
)
def test_attribute_is_of_the_robot_unless_it_is_environmental(load, label):
    assert load(f"insert $q isa {label}, has attribute-name 'x';").attributes["x"].kind == "quality"
    assert (
        load("insert $q isa EnvironmentalAttribute, has name 'x';").attributes["x"].kind
        == "environmental"
    )


@pytest.mark.parametrize(
    "relation",
    [
        "(attribute: $q, constrained: $a)",
        "(constraint: $q, constrained-element: $a)",
        "(measured-attribute: $q, constrained-action: $a)",
        "(constraining_attribute: $q, CONSTRAINED: $a)",
        "(constraint:attribute: $q, constraint:constrained: $a)",
        "(quality-attribute: $q, action: $a)",
        "($q, constrained: $a)",
        "($a, $q)",
        "($role: $q, constrained: $a)",
    ],
)
def test_roles_of_a_constraint_are_known_in_other_spellings(load, relation):
    model = load(ROBOT + f"{relation} isa constraint, has value 0.5, has operator '<';")
    (constraint,) = model.constraints
    assert (str(constraint), [one.name for one in constraint.constrained]) == (
        "charge < 0.5",
        ["go"],
    )


@pytest.mark.parametrize(
    "relation",
    [
        "(causer: $d, affected: $q)",
        "(impacting-element: $d, impacted-attribute: $q)",
        "(source: $d, estimated-attribute: $q)",
        "(function-design: $d, measure: $q)",
        "(estimation: $q, estimation: $d)",
        "(element: $q, element: $d)",
    ],
)
def test_roles_of_an_estimation_are_known_in_other_spellings(load, relation):
    (estimation,) = load(ROBOT + f"{relation} isa estimation, has estimation-value -3;").estimations
    assert (estimation.causer.name, estimation.attribute, estimation.value) == (
        "by motor",
        "charge",
        -3,
    )
    assert estimation.kind == "positive"


@pytest.mark.parametrize(
    ("written", "meant"), [("2", 2), ("-3", -3), ("1.5", 1.5), ("2.0", 2.0), ("1e3", 1000.0)]
)
def test_priority_is_any_finite_number(load, written, meant):
    model = load(f"{ROBOT}($f, $c) isa function-design, has name 'other', has priority {written};")
    assert model.designs["other"].priority == meant


def test_requirements_of_one_action_add_up(load):
    more = (
        "$g isa Function, has function-name 'see'; "
        "(actions: $a, required-functions: $f) isa functional-requirement;"
    )
    model = load(
        ROBOT + more + "(action: $a, function: $f, function: $g) isa functional-requirement;"
    )
    assert model.actions["go"].functions == ("move", "see")


def measurement(value, rest=""):
    return f"(measured-attribute: $q) isa measurement, has measurement-value {value}{rest};"


@pytest.mark.parametrize(
    ("told", "latest"),
    [
        ([measurement(1), measurement(2)], [False, True]),
        (
            [measurement(1, ", has time 2024-01-02"), measurement(2, ", has time 2024-01-01")],
            [True, False],
        ),
        ([measurement(1, ", has latest true"), measurement(2)], [True, False]),
        ([measurement(1), measurement(2, ", has latest false")], [True, False]),
        ([measurement(1, ", has latest false")], [False]),
        (["$q has attribute-value 1;"], [True]),
    ],
)
def test_newest_measurement_is_the_latest_unless_the_file_says_which(load, told, latest):
    facts = load(ROBOT + "".join(told)).facts
    assert [fact.value for fact in facts] == [1, 2][: len(told)]
    assert all(isinstance(fact, MeasurementFact) for fact in facts)
    assert [fact.latest for fact in facts] == latest


def test_component_with_a_pid_is_a_process(load):
    assert load(ROBOT + "$c has pid 12;").facts == (ProcessFact("motor", 12),)


@pytest.mark.parametrize(
    ("value", "type_name", "expected"),
    [
        ("'true'", "boolean", True),
        ("false", "bool", False),
        ("'3'", "long", 3),
        ("3.0", "integer", 3),
        ("'3'", "double", 3.0),
        ("'1e3'", "PARAMETER_DOUBLE", 1000.0),
        ("'3.0'", "string", "3.0"),
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
def test_parameter_is_read_as_its_type_says(load, value, type_name, expected):
    kind = f", has parameter-type '{type_name}'" if type_name else ""
    model = load(
        f"{ROBOT}(component: $c, parameter: $p) isa component-configuration, has name 'x';"
        f"$p isa ComponentParameter, has parameter-key 'k', has parameter-value {value}{kind};"
    )
    read = model.configurations["x"].parameters["k"]
    assert (type(read), read) == (type(expected), expected)


def test_parameter_with_two_values_in_one_configuration_is_an_error(load):
    text = (
        "$p isa ComponentParameter, has key 'k', has value 1; "
        "$r isa ComponentParameter, has key 'k', has value 2;"
    )
    with pytest.raises(ModelFileError, match="parameter 'k' has two values"):
        load(f"{ROBOT}{text}($c, $p, $r) isa component-configuration;")


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("'a\"b'", 'a"b'),
        ('"a\\"b"', 'a"b'),
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
    for pattern in (
        "$c isa Component",
        "$c has component-name 'motor'",
        "($c) isa function-design",
    ):
        with pytest.raises(ModelFileError, match="`match` finds things by type and name"):
            load(ROBOT, f"match {pattern}; insert $c has always-improve true;")


def test_schema_that_declares_what_rosa_has_changes_nothing(load):
    schema = """define
        name sub attribute, abstract, value string; component-name sub name;
        Constrainable sub entity, abstract, plays constraint:constrained;
        Component sub Constrainable, owns component-name @key,
            plays function-design:required-component;
        ROSNode sub Component; Measure sub entity, abstract;
        Attribute sub Measure, owns attribute-name @key;
        QualityAttribute sub Attribute; EnvironmentalAttribute sub Attribute;
        function-design sub relation, owns priority, relates function, relates required-component;
        constraint sub relation, relates constrained, relates attribute;
        rule one: when { $c isa! Component, has status $s; $s like 'a|b'; }
            then { $c has status 'x'; };
    """
    model = load(
        schema, ROBOT + "(attribute: $q, constrained: $c) isa constraint, has constraint-value 1;"
    )
    assert [str(constraint) for constraint in model.constraints] == ["charge >= 1"]
    assert list(model.components) == ["motor"]
