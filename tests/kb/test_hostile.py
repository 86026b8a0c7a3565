"""Input that is broken or hostile: refused or ignored with a clear word, and no fact changed by what is refused."""

import math

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from kept import answers
from models import Clock

from kb import KnowledgeBase, KnowledgeBaseError, Model, ModelFileError
from kb.elements import shown


def robot():
    model = Model("robot")
    voltage = model.quality_attribute("v", low=0, high=1, unit="V", agreement=(2, 3), max_age=9.0)
    camera = model.component("c")
    camera.configuration("k", {"r": 1, "l": [1.0]}, constraints=[voltage >= 0.2], priority=1.5)
    see = model.function("f")
    see.design("d", [camera], constraints=[(voltage >= 0.5).steady(hysteresis=0.1, dwell=2.0)])
    model.action("a", requires=[see])
    camera.estimate(voltage, 0.1)
    return model


class Breaks:
    def __getattr__(self, name):
        raise RuntimeError("broken")

    def __str__(self):
        raise RuntimeError("broken")

    __repr__ = __str__


def within_itself():
    endless = []
    endless.append(endless)
    return endless


LEAVES = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=5)
    | st.binary(max_size=4)
    | st.sampled_from(
        ("v", "c", "nan", "1e400", "0.5", "OK", "error", "QA status", "component status")
    )
    | st.builds(lambda: 10**5000)
    | st.builds(Breaks)
    | st.builds(within_itself)
)
NAMES = st.sampled_from(("status", "message", "values", "key", "value", "v", "c"))
ANYTHING = st.recursive(
    LEAVES,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.tuples(inner, inner)
        | st.dictionaries(NAMES, inner, max_size=4)
        | st.dictionaries(NAMES, inner, max_size=4).map(lambda given: type("Message", (), given)())
    ),
    max_leaves=12,
)
STATUSES = st.fixed_dictionaries(
    {"message": st.sampled_from(("QA status", "component status")) | LEAVES, "values": ANYTHING}
)


@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    ANYTHING
    | st.lists(STATUSES, max_size=3)
    | st.fixed_dictionaries({"status": st.lists(STATUSES, max_size=3)})
)
def test_diagnostics_of_any_form_are_taken_or_told(given):
    kb = KnowledgeBase(robot(), clock=Clock(1.0))
    problems = kb.receive(given)
    assert all(isinstance(str(problem), str) and problem.reason for problem in problems)
    told = {"measure", "component_failed", "component_recovered"}
    assert {event.verb for event in kb.log} <= told
    value = kb.attributes["v"].value
    assert value is None or 0.0 <= value <= 1.0


HUGE = 10**5000


BASE = 'insert $a isa Attribute, has attribute-name "v"; $b isa Action, has action-name "go"; '
NODE = 'insert $c isa Component, has component-name "c"; '


@pytest.mark.parametrize(
    "text",
    [
        "insert " + "(" * 100_000,
        "match " + "{" * 100_000,
        "x" * 10_000_000,
        "\0\0\0",
        "define a sub b; b sub c; c sub a; insert $x isa a;",
        f'{BASE} $c isa Attribute, has attribute-name "v";',
        f"{BASE} (constrained: $b, attribute: $a) isa constraint, has constraint-value nan;",
        f"{BASE} (constrained: $b, attribute: $a) isa constraint, has constraint-value 1e999;",
        f"{BASE} (constrained: $b, attribute: $a) isa constraint, has constraint-value {'9' * 5000};",
        f'insert $a isa Attribute, has attribute-name "v", has agreement "{"9" * 6000} of 3";',
        'insert $a isa Attribute, has attribute-name "v", has attribute-low 2, has attribute-high 1;',
        f'{NODE} $d isa ROSNode, has component-name "d", has pid {"9" * 40};',
    ],
    ids=range(12),
)
def test_hostile_files_are_refused_with_their_place(text, tmp_path):
    file = tmp_path / "hostile.tql"
    file.write_text(text)
    with pytest.raises(ModelFileError, match=r"hostile\.tql:\d+:\d+: ") as refused:
        Model.load(file)
    assert len(str(refused.value)) < 1000


HOSTILE = st.one_of(
    st.sampled_from(
        (
            math.nan,
            math.inf,
            -math.inf,
            "",
            None,
            "x" * 100_000,
            b"v",
            10**400,
            -1,
            0,
            2.5,
            True,
            object,
        )
    ),
    st.sampled_from(
        ("v", "c", "k", "f", "d", "a", "camera", "failure", "no status", ("action", "a"), ("c", 1))
    ),
    st.sampled_from(
        (
            {},
            {"v": math.nan},
            {"f": "k"},
            {"c": "d"},
            {1: 2},
            [],
            ["c"],
            (None,),
            "completed",
            "lost",
        )
    ),
    st.builds(within_itself),
)
TOLD = {
    "measure": (("v", 0.5), 2),
    "component_failed": (("c", "rain"), 2),
    "component_recovered": (("c",), 1),
    "component_active": (("c", True, "on"), 3),
    "component_started": (("c", 7), 2),
    "component_ended": (("c", 7), 2),
    "assert_status": (("a", "unfeasible", "seen", 99.0), 4),
    "retract_status": (("a",), 1),
    "assert_required": (("f", True), 2),
    "assert_selected": (("d", True, "told"), 3),
    "request_action": (("a", {"v": 1.0}), 2),
    "cancel_action": (("a", "failed", "dark"), 3),
    "select": (({"f": "d"}, {"c": "k"}, "told"), 3),
    "finish_plan": ((1, "completed"), 2),
    "record_attempt": ((1, "c", "configure", "k", {"r": 1}, 1), 6),
    "finish_attempt": ((1, "completed", "done"), 3),
    "record_answer": ((1, True, "no"), 3),
    "is_feasible": (("a",), 1),
    "selectable_designs": (("f",), 1),
    "selectable_configurations": (("c",), 1),
    "best_configuration": (("a",), 1),
    "adaptable_components": ((["d"],), 1),
    "explain": (("a",), 1),
    "why": (("a",), 1),
    "explain_choice": (("f",), 1),
    "situation": (({"v": 0.5},), 1),
    "replay": ((None,), 1),
    "subscribe": ((print,), 1),
}
"""Calls that are right, with as many arguments as can be wrong."""


@settings(suppress_health_check=list(HealthCheck))
@given(st.sampled_from(sorted(TOLD)), st.data())
def test_refused_call_changes_nothing_and_says_why(verb, data):
    kb = KnowledgeBase(robot(), clock=Clock(1.0))
    kb.request_action("a")
    kb.select({"f": "d"}, {"c": "k"})
    kb.record_attempt(1, "c", "activate")
    arguments = list(TOLD[verb][0])
    for place in data.draw(st.sets(st.integers(0, TOLD[verb][1] - 1), min_size=1, max_size=2)):
        arguments[place] = data.draw(HOSTILE)
    before = answers(kb), list(kb.log), kb.revision
    words = refusal(getattr(kb, verb), *arguments)
    if words:
        assert (answers(kb), list(kb.log), kb.revision) == before
        assert len(words) > 20
        assert any(
            shown(one)[:20] in words or str(one)[:20] in words for one in spread(arguments)
        ), words


def refusal(call, *arguments):
    try:
        call(*arguments)
    except KnowledgeBaseError as error:
        return str(error)
    except TypeError as error:  # of a name that is a list or the like, as everywhere in Python
        if "unhashable" in str(error):
            return f"{error}: {arguments!r}"
        raise
    return ""


def spread(values):
    """Yield what was given, and what is in it."""
    for value in values:
        yield value
        if isinstance(value, dict):
            yield from (*value, *value.values())
        elif isinstance(value, list | tuple):
            yield from value
