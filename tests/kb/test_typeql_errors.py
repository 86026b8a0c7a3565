"""What is wrong in a model file is one clear error with its place; what is only odd is noted."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kb import Model, ModelError
from kb.files import ModelFileError

FILES = sorted(Path(__file__).with_name("typeql_files").glob("*.tql"))
ROBOT = """insert
$a isa Action, has action-name 'go';
$f isa Function, has function-name 'move';
$c isa Component, has component-name 'motor';
$q isa QualityAttribute, has attribute-name 'charge';
"""  # what follows begins in line 6
DESIGN = "(function: $f) isa function-design, has function-design-name 'd'"
PARAMETER = (
    "(component: $c, parameter: $p) isa component-configuration, "
    "has component-configuration-name 'x'; "
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
    "insert ($a, $b) isa x;": "1:9: unexpected `$a`; expected name",
    "insert $a isa Action, has n 'x;": "1:29: unexpected `'`; expected",
    "insert $a isa Action": "1:15: the file ends here; expected comma, semicolon",
    "define rule r: when { } then { };": "1:23: unexpected `}`; expected",
    "": "1:1: the file ends here; expected define, insert, match",
    "match $a isa Action; delete $a isa Action;": "1:22: unexpected `delete`; expected",
}
MEANING = [
    ("(funktion: $f) isa function-design;", "6:2: unknown role of .* 'funktion'; did you mean"),
    (f"(function: $a) isa {DESIGN[19:]};", "6:20: a function-design has no role for a action"),
    ("$x (action: $a) isa Component;", "6:5: unknown role of component 'action'"),
    (f"(required-component: $c) isa {DESIGN[19:]};", "6:30: .* is not complete: .* 'function'"),
    ("(component: $x) isa component-process;", r"6:13: unknown variable '\$x'.*`\$x isa ...`"),
    ("$x isa Componnt;", "6:8: unknown type 'Componnt'; did you mean 'Component'"),
    (
        "$x isa Component;",
        "6:8: the component's name is a non-empty text of printable characters, not ''",
    ),
    ("$a isa Function;", "6:8: `.a` has a type already"),
    ("$c has component-name 'other';", "6:8: a second component-name; a component has one"),
    (f"{DESIGN}, has priority 'one';", "6:20: the priority of 'd' is a finite number or None"),
    ("$c has is-required 1;", "4:8: is-required is True or False, not 1"),
    ("$c has component-status 'failur';", "4:8: a component is never failur; it can be failure"),
    (
        "(action: $a) isa required-action, has start-time 2024-13-01;",
        "6:50: `2024-13-01` is not a value: month",
    ),
    (
        f"{CONSTRAINT}, has constraint-value 1, has constraint-operator '=>';",
        "6:38: '=>' is no comparison; there are >=, >, <=, <",
    ),
    (f"{CONSTRAINT};", "6:38: this constraint is not complete: .*'value'"),
    (f"{PARAMETER};", "6:106: a parameter has a parameter-key and a parameter-value"),
    (
        f"{PARAMETER}, has parameter-value 'a', has parameter-type 'double';",
        "6:106: 'a' cannot be read as double",
    ),
    (
        f"{PARAMETER}, has parameter-value '1', has parameter-type 'duble';",
        "unknown parameter type 'duble'; did you",
    ),
    (
        "(causer: $c, affected: $q) isa estimation, has estimation-value 1, "
        "has estimation-type 'plus';",
        "6:32: unknown estimation kind 'plus'; known: 'positive', 'negative', 'absolute'",
    ),
    ("(measured-attribute: $q) isa measurement;", "6:30: this measurement is not complete"),
    ("$unheard has priority 1;", r"6:1: unknown variable '\$unheard'; known: '\$"),
    (
        "match $x isa Component, has component-name 'moter'; insert $x has is-active true;",
        "6:14: `match` finds nothing: unknown component 'moter'; did you mean 'motor'",
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
    assert caught.value.line is not None
    assert caught.value.column is not None


def test_key_given_twice_is_a_duplicate_name(tmp_path):
    with pytest.raises(ModelError, match=r"robot\.tql:6:8: action 'go' is declared") as caught:
        load(tmp_path, ROBOT + "$b isa Action, has action-name 'go';")
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
