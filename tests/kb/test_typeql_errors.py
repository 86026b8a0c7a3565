"""What is wrong in a model file is one clear error with its place; what is only odd is noted."""

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kb import DuplicateName, Model, ModelError
from kb.files import ModelFileError

FILES = sorted(Path(__file__).with_name("typeql_files").glob("*.tql"))
ROBOT = """insert
$a isa Action, has action-name 'go';
$f isa Function, has function-name 'move';
$c isa Component, has component-name 'motor';
$q isa QualityAttribute, has attribute-name 'charge';
"""  # what follows begins in line 6
DESIGN = "(function: $f, required-component: $c) isa function-design"
PARAMETER = (
    "(component: $c, parameter: $p) isa component-configuration; "
    "$p isa ComponentParameter, has parameter-key 'k'"
)
CONSTRAINT = "(attribute: $q, constrained: $a) isa constraint"


def load(path, text):
    path = path / "robot.tql"
    path.write_text(text)
    return Model.load(path)


SYNTAX = {
    "$a isa Action;": "1:1: unexpected `$a`; expected define, insert, match",
    "insert $a isa Action\n$b isa Action;": "2:1: unexpected `$b`; expected comma, semicolon",
    "insert $a isa;": "1:14: unexpected `;`; expected name",
    "insert $a has name;": "1:19: unexpected `;`; expected boolean, date, number, text",
    "insert ($a, ) isa x;": "1:13: unexpected `)`; expected name, variable",
    "insert $a isa Action, has n 'x;": "1:29: unexpected `'`; expected",
    "insert $a isa Action": "1:21: the file ends here; expected comma, semicolon",
    "match $a isa Action;": "1:21: the file ends here; expected",
    "define rule r: when { } then { };": "1:23: unexpected `}`; expected",
    "": "1:1: the file ends here; expected define, insert, match",
    "match $a isa Action; get $a;": "1:22: `get` reads a database; a model file only states",
    "match $a isa Action; delete $a isa Action;": "1:22: `delete` changes a database",
    "undefine Action sub entity;": "1:1: `undefine` changes a database",
}
MEANING = [
    (
        "(funktion: $f) isa function-design;",
        "6:2: unknown role of function-design 'funktion'; did you mean 'function'.*"
        r"roles: function \(function\), required-component \(component\)",
    ),
    (
        "(function: $c) isa function-design;",
        "6:2: function-design has no clear role for type Component; roles: function",
    ),
    (
        "($a, $c) isa function-design;",
        "6:2: function-design has no clear role for type Action",
    ),
    (
        "$x (action: $a) isa Component;",
        "6:5: unknown role of Component 'action'.*roles: none",
    ),
    (
        "(required-component: $c) isa function-design;",
        "6:30: this function-design has no function",
    ),
    (
        "(function: $f, function: $f) isa function-design;",
        "6:16: a second function",
    ),
    (
        "(component: $x) isa component-configuration;",
        r"6:13: unknown variable '\$x'.*`\$x isa ...`",
    ),
    (
        "$x isa Componnt;",
        "6:8: unknown type 'Componnt'; did you mean 'Component'",
    ),
    (
        "$x isa Component;",
        "6:8: this Component has no name; write `has component-name ...`",
    ),
    (
        "$x isa Component, has component-name ' ';",
        "6:8: the name of a component is a non-empty text",
    ),
    (
        "$a isa Function;",
        "6:8: `.a` has a type already",
    ),
    (
        "$x isa Component, has component-name 'x', has component-name 'y';",
        "6:47: component-name is 'y' here, and .* 'x' at",
    ),
    (
        "$a sub thing;",
        "6:4: unexpected `sub`; expected bracket, has, isa",
    ),
    (
        f"{DESIGN}, has priority 'one';",
        "6:65: priority is a number, not 'one'",
    ),
    (
        f"{DESIGN}, has priority 1e999;",
        "6:65: priority is a finite number, not inf",
    ),
    (
        f"{DESIGN}, has priority true;",
        "6:65: priority is a number, not True",
    ),
    (
        "$c has pid 1.5;",
        "6:8: pid is a whole number, not 1.5",
    ),
    (
        "(action: $a) isa required-action, has start-time 5;",
        "6:39: start-time is a date and time such as .*, not 5",
    ),
    (
        "(action: $a) isa required-action, has start-time 2024-13-01;",
        "6:50: `2024-13-01` is not a value: month",
    ),
    (
        f"{CONSTRAINT}, has constraint-value 1, has operator '=>';",
        "6:38: '=>' is no comparison; there are >=, >, <=, <",
    ),
    (
        f"{CONSTRAINT};",
        "6:38: this constraint has no value",
    ),
    (
        "(constrained: $a) isa constraint, has constraint-value 1;",
        "6:23: this constraint has no attribute",
    ),
    (
        f"{PARAMETER};",
        "6:68: this ComponentParameter has no value",
    ),
    (
        f"{PARAMETER}, has parameter-value 'a', has parameter-type 'double';",
        "6:68: 'a' cannot be read as double",
    ),
    (
        f"{PARAMETER}, has parameter-value '1.5', has parameter-type 'long';",
        "'1.5' cannot be read as long",
    ),
    (
        f"{PARAMETER}, has parameter-value '[1', has parameter-type 'long_array';",
        "cannot be read as long_array",
    ),
    (
        f"{PARAMETER}, has parameter-value '1', has parameter-type 'duble';",
        "unknown parameter type 'duble'; did you",
    ),
    (
        "(causer: $c, affected: $q) isa estimation, has value 1, has estimation-type 'plus';",
        "6:32: unknown estimation kind 'plus'; known: 'positive', 'negative', 'absolute'",
    ),
    (
        "(measured-attribute: $q) isa measurement;",
        "6:30: this measurement has no value",
    ),
    (
        "match $x isa Component, has component-name 'moter'; insert $x has is-active true;",
        "6:7: `match` finds nothing: unknown component 'moter'; did you mean 'motor'",
    ),
]


@pytest.mark.parametrize("text", SYNTAX, ids=repr)
def test_syntax_error_says_what_stands_there_and_what_was_expected(tmp_path, text):
    with pytest.raises(ModelFileError) as caught:
        load(tmp_path, text)
    place, _, message = SYNTAX[text].partition(": ")
    assert str(caught.value).startswith(f"{caught.value.file}:{place}: {message}")


@pytest.mark.parametrize(("text", "message"), MEANING)
def test_wrong_statement_is_an_error_with_its_place(tmp_path, text, message):
    with pytest.raises(ModelFileError, match=message) as caught:
        load(tmp_path, ROBOT + text)
    assert caught.value.line == 6
    assert caught.value.column is not None


@pytest.mark.parametrize(
    "text",
    [
        "$b isa Action, has action-name 'go';",
        "$b isa ROSNode, has component-name 'motor';",
        f"{DESIGN}, has function-design-name 'd'; {DESIGN}, has function-design-name 'd';",
    ],
)
def test_key_given_twice_is_a_duplicate_name(tmp_path, text):
    with pytest.raises(
        DuplicateName, match=r"is declared already at .*robot\.tql:\d:\d+"
    ) as caught:
        load(tmp_path, ROBOT + text)
    assert isinstance(caught.value, ModelFileError)


@pytest.mark.parametrize(
    "opening", ["(", "{", "[", "()", "{}", "insert (", "define rule r: when {", "match {"]
)
def test_file_of_brackets_is_an_error(tmp_path, opening):
    with pytest.raises(ModelFileError):
        load(tmp_path, opening + opening[-1] * 10_000)


def test_failed_load_leaves_nothing_behind_for_the_next(tmp_path):
    with pytest.raises(ModelFileError):
        load(tmp_path, ROBOT + "$a isa;")
    assert list(load(tmp_path, ROBOT).actions) == ["go"]


PIECES = st.sampled_from(
    (
        "(",
        ")",
        "{",
        "}",
        ";",
        ",",
        ":",
        "$x",
        "isa",
        "has",
        "insert",
        "match",
        "'",
        '"',
        "#",
        "3",
        "-",
        "true",
        "define",
    )
)


@given(data=st.data())
def test_spoilt_file_is_a_model_or_a_model_error(tmp_path_factory, data):
    text = data.draw(st.sampled_from([path.read_text() for path in FILES]))
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        end = data.draw(st.integers(start, min(start + 30, len(text))))
        text = text[:start] + data.draw(PIECES | st.text(max_size=3)) + text[end:]
    path = tmp_path_factory.mktemp("spoilt") / "spoilt.tql"
    path.write_bytes(text.encode())
    try:
        loaded = Model.load(path)
    except ModelError as error:
        loaded = error
    assert isinstance(loaded, Model) or str(loaded).startswith(str(path))


@pytest.mark.parametrize(
    ("text", "note"),
    [
        (
            "$c has component-status 'failur';",
            "6:8: unknown status of a Component 'failur'; did you mean 'failure'",
        ),
        ("$c has component-status 'odd';", "known: 'failure', 'unfeasible'"),
        (
            "$c has compnent-nme 'x';",
            "6:8: unknown attribute of Component 'compnent-nme'; did you mean",
        ),
        ("$c has is-activ true;", "did you mean 'is-active'"),
        (f"{DESIGN};", "6:44: this function-design has no name; it is called 'move design 1'"),
        ("(component: $c) isa component-configuration;", "it is called 'motor configuration 1'"),
        ("(action: $a) isa required-action, has result 'dunno';", "'dunno' is not a result"),
        ("$c has node-name 'x';", "node-name is ignored: component-name is .*:4:"),
    ],
    ids=repr,
)
def test_odd_statement_is_noted_and_the_rest_is_loaded(tmp_path, text, note):
    model = load(tmp_path, ROBOT + text)
    (noted,) = model.notes
    assert re.search(note, noted), noted
    assert list(model.actions) == ["go"]
