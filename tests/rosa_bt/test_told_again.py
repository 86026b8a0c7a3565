"""What a knowledge base was told, written to a trace and told again from there, makes another one equal to it."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kb import AmbiguousName, KnowledgeBase, Model, UnknownName
from rosa_bt.exceptions import TraceError
from rosa_bt.facts import Fact, Listener, tell
from rosa_bt.traces import Node, Tick, Trace, Visit, read_trace

ODD = (
    "dirt",
    "",
    "it said: (no)",
    "x) until 3 s (",
    " is active",
    "a\nb\r\n",
    "a\x85b\u2028c\u2029d\x0be\x1cf",
    "\udc80",
    "é🤖\0",
)
REASONS = st.sampled_from(ODD) | st.text(max_size=8)
NAMES = ("look", "camera", "radar", "day", "night", "by camera", "by radar", "explore", "charge")
NUMBERS = st.floats(-1.0, 2.0)


def rover() -> Model:
    """A robot of which an action, a function, a component and a design share their name."""
    model = Model("rover")
    light = model.environmental_attribute("light", max_age=3.0, when_stale="violated")
    energy = model.quality_attribute("energy", agreement=(2, 3))
    look = model.component("look", kind="lifecycle", always_improve=True)
    look.configuration("day", {"exposure_s": 0.01}, priority=1, constraints=[(light >= 0.5).steady(hysteresis=0.1)])
    look.configuration("night", {"exposure_s": 0.2}, priority=2)
    radar = model.component("radar")
    see = model.function("look")
    see.design("look", [look], priority=1)
    see.design("by radar", [radar], priority=2, constraints=[(energy >= 0.3).steady(dwell=2.0)])
    explore = model.action("look", requires=[see], constraints=[energy >= 0.2])
    model.action("charge")
    model.constrain([explore, look], light >= 0.1)
    return model


def elements(kb, *tables):
    return [view for table in tables for view in getattr(kb, table).values()]


def constrained(kb):
    return [
        one for view in elements(kb, "actions", "components", "designs", "configurations") for one in view.constraints
    ]


def pick(listed, number):
    return listed[number % len(listed)]


def choose(kb, number, reason):
    designs = {"look": pick(["look", "by radar"], number)} if number % 3 else {}
    configurations = {"look": pick(["day", "night"], number)} if number % 4 else {}
    return kb.select(designs, configurations, reason)


def assert_one(kb, number, reason, until):
    views = elements(kb, "actions", "functions", "components", "designs", "configurations")
    kb.assert_status(pick(views, number), "unfeasible", reason, until)


def finish(kb, number):
    if kb.open_plans:
        kb.finish_plan(pick(kb.open_plans, number), pick(["completed", "failed", "abandoned"], number))


TELLINGS = {
    "measure": lambda kb, n, x, why: kb.measure(pick(["light", "energy"], n), x),
    "fail": lambda kb, n, x, why: kb.component_failed(pick(["look", "radar"], n), why),
    "recover": lambda kb, n, x, why: kb.component_recovered(pick(["look", "radar"], n)),
    "active": lambda kb, n, x, why: kb.component_active(pick(["look", "radar"], n), n % 3 == 0, why),
    "receive": lambda kb, n, x, why: kb.receive(
        [("ea measurement", {"light": str(x)}), ("component", {"radar": pick(["ok", "error"], n)})]
    ),
    "assert": lambda kb, n, x, why: assert_one(kb, n, why, pick([None, float("inf"), kb.now + 1.0 + abs(x) / 3], n)),
    "assert failure": lambda kb, n, x, why: kb.assert_status(kb.components["radar"], "failure", why),
    "assert constraint": lambda kb, n, x, why: kb.assert_status(pick(constrained(kb), n), "violated", why),
    "retract": lambda kb, n, x, why: kb.retract_status(
        pick([*elements(kb, "actions", "designs"), *constrained(kb)], n)
    ),
    "require": lambda kb, n, x, why: kb.assert_required(
        pick(elements(kb, "actions", "functions", "components"), n), pick([True, False, None], n)
    ),
    "mark": lambda kb, n, x, why: kb.assert_selected(
        pick(elements(kb, "designs", "configurations"), n), pick([True, False, None], n), why
    ),
    "request": lambda kb, n, x, why: kb.request_action(
        pick(["look", "charge"], n), pick([None, "energy", {"energy": x, "light": 1.0}], n)
    ),
    "cancel": lambda kb, n, x, why: kb.cancel_action(pick(["look", "charge"], n), "failed", why),
    "select": lambda kb, n, x, why: choose(kb, n, why),
    "finish": lambda kb, n, x, why: finish(kb, n),
}
OFTEN = ("request", "request", "select", "select", "select", "finish", "finish", "active", "measure")
STORIES = st.lists(
    st.tuples(
        st.sampled_from((0.0, 0.1, 1 / 3, 1.7)),
        st.sampled_from((*sorted(TELLINGS), *OFTEN)),
        st.integers(0, 11),
        NUMBERS,
        REASONS,
    ),
    min_size=8,
    max_size=25,
)
CHOICES = ("selected", "unselected")


def known(kb, *, with_reasons_of_choices):
    """All that is known: facts, why, and until when; what was measured, asked for and planned, with its end."""
    state = kb._state
    said = {key: reason for key, reason in state.reasons.items() if with_reasons_of_choices or key[0] not in CHOICES}
    requests = [(one.action, one.preference, one.start, one.end, one.result, one.reason) for one in kb.action_history]
    plans = [(str(one), one.start, one.end, one.result, one.reason) for one in kb.plans]
    histories = [one.history for one in kb.attributes.values()]
    return [list(column) for column, _ in state._columns], said, requests, plans, histories


def through_a_file(path, facts):
    Trace("rover", (Tick(0, 0.0, (Node(0, "X", "x"),), (Visit(0, "RUNNING", ""),), facts),)).write(path)
    (tick,) = read_trace(path).ticks
    assert tick.facts == facts
    return tick.facts


@settings(max_examples=200)
@given(STORIES, st.booleans())
def test_traced_and_told_again_gives_an_equal_knowledge_base(tmp_path_factory, story, obeys):
    now, heard = 0.0, []
    kb = KnowledgeBase(rover(), clock=lambda: now)
    kb.subscribe(heard.append)
    if obeys:  # somebody who carries plans out as soon as they are told, before the trace hears of them
        kb.subscribe(lambda event: carry_out(kb, event.plan) if event.plan else None)
    listener = Listener(kb)
    is_quiet = False
    for seconds, verb, number, value, reason in story:
        now += seconds
        before, said = len(heard), dict(kb._state.reasons)
        TELLINGS[verb](kb, number, value, reason)
        is_quiet |= verb == "select" and len(heard) == before and kb._state.reasons != said  # a new reason is no event
    end, facts = now, through_a_file(tmp_path_factory.getbasetemp() / "told.jsonl", listener.take_facts())
    again = KnowledgeBase(rover(), clock=lambda: now)
    for fact in facts:
        now = fact.time
        tell(again, fact)
    now = end
    expected = known(kb, with_reasons_of_choices=not is_quiet)
    assert known(again, with_reasons_of_choices=not is_quiet) == expected


def carry_out(kb, plan):
    for name in plan.activate:
        kb.component_active(name, True)
    kb.finish_plan(plan, "completed")


def test_trace_that_begins_late_begins_with_what_is_known_and_counts_plans_from_there():
    kb = KnowledgeBase(rover(), clock=lambda: 5.0)
    kb.request_action("look", "energy")
    kb.finish_plan(kb.select({"look": "look"}, {"look": "day"}, "as ever"), "failed")
    kb.component_active("look", True)
    kb.component_failed("radar", "dirt (much)")
    kb.measure("light", 0.9)
    listener = Listener(kb)
    kb.finish_plan(kb.select({"look": "by radar"}, reason="for once"), "completed")
    facts = listener.take_facts()
    assert facts == (
        (5.0, "measure", ("light", 0.9)),
        (5.0, "request_action", ("look", "energy")),
        (5.0, "component_active", ("look", True, "")),
        (5.0, "component_failed", ("radar", "dirt (much)")),
        (5.0, "assert_selected", (["function design", "look"], True, "as ever")),
        (5.0, "assert_selected", ("day", True, "as ever")),
        (5.0, "select", ({"look": "by radar"}, {}, "for once")),
        (5.0, "finish_plan", (0, "completed")),
    )
    again = KnowledgeBase(rover(), clock=lambda: 5.0)
    for fact in facts:
        tell(again, fact)
    assert [one.result for one in again.plans] == ["completed"]
    assert str(again.latest_plan) == str(kb.latest_plan) != ""
    tables = ("actions", "functions", "components", "designs", "configurations")
    statuses = [view.status for view in elements(kb, *tables)]
    assert [view.status for view in elements(again, *tables)] == statuses


def test_facts_as_they_were_written_before_are_told_as_well():
    kb = KnowledgeBase(rover(), clock=lambda: 0.0)
    kb.assert_required("charge", True)
    before = (
        Fact(0.0, "assert_status", ("by radar", "unfeasible", "a person says so", 1.5)),
        Fact(0.0, "assert_required", ("radar", None)),
        Fact(0.0, "select", ({"look": "by radar"}, {"look": "day"})),
        Fact(0.0, "assert_selected", ("by radar", True, "")),
    )
    for fact in before:
        tell(kb, fact)
    assert kb.designs["by radar"].is_selected
    assert kb.why("by radar") == "by radar is unfeasible because it is asserted so until 1.5 s (a person says so)"


@pytest.mark.parametrize(
    ("element", "error", "message"),
    [
        (["robot", "look"], TraceError, "no element; one is .kind, name., kinds are action, function, component, "),
        ([], TraceError, "no element"),
        ({"a": 1}, UnknownName, "unknown action or function"),
        (["action", "lok"], UnknownName, "did you mean 'look'"),
        (["action", "look", 9], TraceError, "cannot be told again"),
        (["action", "look", "light"], TraceError, "cannot be told again"),
        ("look", AmbiguousName, "names several things"),
    ],
)
def test_element_that_is_not_there_is_refused(element, error, message):
    kb = KnowledgeBase(rover(), clock=lambda: 0.0)
    with pytest.raises(error, match=message):
        tell(kb, Fact(0.0, "retract_status", (element,)))
