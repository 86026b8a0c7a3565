"""Broken or hostile input is refused with a clear word, and changes no fact."""

import math

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from kept import answers
from models import Clock

from kb import KnowledgeBase, KnowledgeBaseError, Model
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


def within_itself():
    endless = []
    endless.append(endless)
    return endless


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
