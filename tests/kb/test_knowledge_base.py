"""Facts in, questions out: requests, events, views, and what a knowledge base withstands."""

import math
import sys
import threading
import tracemalloc
from collections.abc import Mapping
from contextlib import suppress

import pytest
from hypothesis import HealthCheck, given, settings
from models import Clock, Twins, state_of, stories

from kb import (
    AmbiguousName,
    EventKind,
    InvalidValue,
    KnowledgeBase,
    KnowledgeBaseError,
    Model,
    Status,
    StatusChange,
    UnknownName,
)


def rover():
    model = Model("rover")
    light = model.environmental_attribute("light")
    model.quality_attribute("battery")
    camera = model.component("camera", kind="lifecycle", package="eyes", executable="camera_node")
    camera.configuration("day", {"exposure": 0.01}, priority=1, constraints=[light >= 0.5])
    camera.configuration("night", {"exposure": 0.2})
    see = model.function("see")
    see.design("by camera", [camera], priority=2)
    model.action("explore", requires=[see], constraints=[light >= 0.25])
    model.action("rest")
    return model


@pytest.fixture
def clock():
    return Clock(10.0)


@pytest.fixture
def kb(clock):
    return KnowledgeBase(rover(), clock=clock)


@pytest.fixture
def told(kb):
    events = []
    kb.subscribe(events.append)
    return events


# requests


def test_a_feasible_action_is_required_once_requested(kb, clock):
    reply = kb.request_action("explore", preference="battery")
    assert reply
    assert reply.accepted
    (required,) = kb.required_actions
    assert (required.action, required.preference, required.start) == ("explore", "battery", 10.0)
    assert (required.end, required.result) == (None, None)
    assert kb.actions["explore"].is_required
    assert kb.functions["see"].is_required
    assert not kb.actions["rest"].is_required


def test_an_unfeasible_action_is_refused_with_the_reason_and_nothing_changes(kb, told):
    kb.measure("light", 0.24)
    told.clear()
    revision = kb.revision
    reply = kb.request_action("explore")
    assert not reply
    assert reply.accepted is False
    assert (
        reply.reason
        == "explore is unfeasible because light 0.24 violates >= 0.25 (measured 0.0 s ago)"
    )
    assert kb.required_actions == kb.history.actions == ()
    with pytest.raises(AttributeError):
        kb.history.actions = ("rest",)
    assert not kb.functions["see"].is_required
    assert told == []
    assert kb.revision == revision


def test_requesting_what_is_required_already_changes_nothing(kb, clock, told):
    kb.request_action("explore", preference="battery")
    clock.now = 11.0
    count, before, revision = len(told), kb.required_actions, kb.revision
    for _ in range(3):
        assert kb.request_action("explore", preference="light")
    assert kb.required_actions == before
    assert before[0].start == 10.0
    assert before[0].preference == "battery"
    assert len(told) == count
    assert kb.revision == revision


@pytest.mark.parametrize("result", ["completed", "failed", "abandoned"])
def test_cancelling_closes_the_required_action_with_its_result(kb, clock, result):
    kb.request_action("explore")
    (required,) = kb.required_actions
    clock.now = 12.0
    kb.cancel_action("explore", result)
    assert (required.end, required.result) == (12.0, result)
    assert kb.required_actions == ()
    assert kb.history.actions == (required,)
    assert not kb.actions["explore"].is_required
    assert kb.actions["explore"].status is Status.FEASIBLE


def test_cancelling_is_abandoning_by_default_and_twice_is_once(kb, clock, told):
    kb.request_action("explore")
    kb.cancel_action("explore")
    clock.now += 1
    count = len(told)
    kb.cancel_action("explore", "completed")
    kb.cancel_action("rest")
    assert [one.result for one in kb.history.actions] == ["abandoned"]
    assert len(told) == count


@pytest.mark.parametrize("result", ["done", "", None, "Completed"])
def test_cancelling_with_a_word_that_is_no_result_changes_nothing(kb, result):
    kb.request_action("explore")
    with pytest.raises(InvalidValue, match="completed, failed, abandoned"):
        kb.cancel_action("explore", result)
    assert [one.action for one in kb.required_actions] == ["explore"]


def test_a_running_action_is_feasible_and_stays_required_when_it_becomes_unfeasible(kb):
    kb.request_action("explore")
    assert kb.is_feasible("explore")
    kb.measure("light", 0.1)
    assert not kb.is_feasible("explore")
    assert kb.actions["explore"].is_required
    assert kb.selectable_actions() == ("rest",)
    kb.measure("light", 0.9)
    assert kb.is_feasible("explore")


def test_an_asserted_false_hides_no_inferred_requirement(kb):
    kb.request_action("explore")
    for element in (kb.actions["explore"], kb.functions["see"]):
        kb.assert_required(element, False)
        assert element.is_required


def test_required_actions_stand_in_the_order_of_their_requests(kb):
    kb.request_action("rest")
    kb.request_action("explore")
    assert [one.action for one in kb.required_actions] == ["rest", "explore"]
    kb.cancel_action("rest")
    kb.request_action("rest")
    assert [one.action for one in kb.required_actions] == ["explore", "rest"]
    assert [one.action for one in kb.history.actions] == ["rest", "explore", "rest"]


def test_a_required_action_is_read_only(kb):
    kb.request_action("explore")
    (required,) = kb.required_actions
    for name in ("action", "preference", "start", "end", "result"):
        with pytest.raises(AttributeError):
            setattr(required, name, None)


# events


def test_events_come_in_order_with_the_three_kinds(kb, told, clock):
    kb.measure("light", 0.9)
    kb.request_action("explore")
    clock.now = 11.0
    plan = kb.select({"see": "by camera"}, {"camera": "day"})
    kb.component_active("camera", True)
    kb.component_failed("camera")
    kb.component_recovered("camera")
    kb.cancel_action("explore", "completed")
    assert [(one.kind, one.subject, one.time) for one in told] == [
        ("monitoring data", "light", 10.0),
        ("action update", "explore", 10.0),
        ("reconfiguration plan", "", 11.0),
        ("monitoring data", "camera", 11.0),
        ("monitoring data", "camera", 11.0),
        ("monitoring data", "camera", 11.0),
        ("action update", "explore", 11.0),
    ]
    assert [one.plan for one in told if one.kind is EventKind.RECONFIGURATION_PLAN] == [plan]
    assert told[0].text == "light is 0.9"
    assert told[1].text == "explore is requested"
    assert told[3].text == "camera is active"
    assert told[4].text == "camera has failed"
    assert told[6].text == "explore is completed"


def test_an_event_says_which_statuses_changed(kb, told):
    kb.measure("light", 0.24)
    assert set(told[0].changes) == {
        StatusChange("constraint", "light >= 0.5", Status.NOT_EVALUATED, Status.VIOLATED),
        StatusChange("constraint", "light >= 0.25", Status.NOT_EVALUATED, Status.VIOLATED),
        StatusChange("configuration", "day", Status.FEASIBLE, Status.UNFEASIBLE),
        StatusChange("action", "explore", Status.FEASIBLE, Status.UNFEASIBLE),
    }
    kb.measure("light", 0.24)
    assert told[1].changes == ()


def test_a_listener_is_told_until_it_unsubscribes(kb):
    one, other = [], []
    leave = kb.subscribe(one.append)
    kb.subscribe(other.append)
    kb.measure("light", 0.9)
    leave()
    leave()
    kb.measure("light", 0.8)
    assert (len(one), len(other)) == (1, 2)


def test_a_listener_may_leave_while_it_is_told(kb):
    seen = []
    leave = None

    def once(event):
        seen.append(event)
        leave()

    leave = kb.subscribe(once)
    after = []
    kb.subscribe(after.append)
    kb.measure("light", 0.9)
    kb.measure("light", 0.8)
    assert (len(seen), len(after)) == (1, 2)


def test_a_listener_may_ask_and_finds_what_it_was_told(kb):
    answers = []
    kb.subscribe(
        lambda event: answers.append((kb.is_feasible("explore"), kb.attributes["light"].value))
    )
    kb.measure("light", 0.1)
    kb.measure("light", 0.3)
    assert answers == [(False, 0.1), (True, 0.3)]


def test_a_listener_may_tell_something_itself(kb):
    def abandon(event):
        if event.kind is EventKind.MONITORING_DATA and not kb.is_feasible("explore"):
            kb.cancel_action("explore", "failed")

    kb.subscribe(abandon)
    kb.request_action("explore")
    kb.measure("light", 0.1)
    assert [one.result for one in kb.history.actions] == ["failed"]


def test_every_listener_is_told_in_the_order_in_which_things_happened(kb):
    def react(event):
        if event.subject == "light":
            kb.component_failed("camera")

    seen = []
    kb.subscribe(react)
    kb.subscribe(seen.append)
    kb.measure("light", 0.9)
    assert [one.subject for one in seen] == ["light", "camera"]


def test_a_listener_that_raises_hurts_neither_the_teller_nor_the_other_listeners(kb):
    def broken(event):
        raise RuntimeError("broken listener")

    seen = []
    kb.subscribe(broken)
    kb.subscribe(seen.append)
    kb.measure("light", 0.1)
    assert len(seen) == 1


def test_a_listener_that_raises_leaves_facts_and_statuses_in_agreement(kb):
    def broken(event):
        raise RuntimeError("broken listener")

    leave = kb.subscribe(broken)
    for tell in (lambda: kb.measure("light", 0.1), lambda: kb.component_failed("camera")):
        try:
            tell()
        except RuntimeError:
            continue
    leave()
    assert kb.attributes["light"].value == 0.1
    assert kb.actions["explore"].status is Status.UNFEASIBLE
    assert kb.components["camera"].status is Status.FAILURE
    assert kb.request_action("rest")


# facts


@pytest.mark.parametrize(
    "value", [math.nan, math.inf, -math.inf, True, "0.5", None, [0.5], 1j, object(), b"1"]
)
def test_what_is_no_finite_number_is_refused_and_the_facts_are_as_they_were(kb, told, clock, value):
    kb.measure("light", 0.3)
    clock.now = 11.0
    with pytest.raises(InvalidValue, match="light cannot be measured as"):
        kb.measure("light", value)
    assert (kb.attributes["light"].value, kb.attributes["light"].time) == (0.3, 10.0)
    assert kb.actions["explore"].status is Status.FEASIBLE
    assert len(told) == 1


class Array:
    """Has `__float__`, like an array, and cannot use it, like one with several numbers."""

    def __float__(self):
        raise TypeError("only one number can be converted")


@pytest.mark.parametrize(
    "value",
    [
        pytest.param(10**400, id="beyond float"),
        pytest.param(
            Array(),
            id="array",
        ),
    ],
)
def test_what_cannot_become_a_number_is_refused_in_our_words(kb, value):
    with pytest.raises(InvalidValue):
        kb.measure("light", value)


@pytest.mark.parametrize("given", ["yes", 0, 1.0, 2])
def test_what_is_so_or_not_is_a_boolean(kb, given):
    kb.select({"see": "by camera"})
    plan, before = kb.latest_plan, kb.log.last
    for what, tell in {
        "active": lambda: kb.component_active("camera", given),
        "required": lambda: kb.assert_required("camera", given),
        "selected": lambda: kb.assert_selected("night", given),
        "is_vetoed": lambda: kb.record_answer(plan, given),
    }.items():
        with pytest.raises(InvalidValue, match=f"^{what} is True or False, not {given!r}$"):
            tell()
    with pytest.raises(InvalidValue, match="active is True or False, not None"):
        kb.component_active("camera", None)
    assert kb.log.last == before


UNKNOWN = [
    (lambda kb: kb.measure("ligt", 1.0), "did you mean 'light'"),
    (lambda kb: kb.component_failed("camra"), "did you mean 'camera'"),
    (lambda kb: kb.component_recovered("camra"), "did you mean 'camera'"),
    (lambda kb: kb.component_active("camra", True), "did you mean 'camera'"),
    (lambda kb: kb.request_action("explor"), "did you mean 'explore'"),
    (lambda kb: kb.request_action("explore", "batery"), "did you mean 'battery'"),
    (lambda kb: kb.cancel_action("explor"), "did you mean 'explore'"),
    (lambda kb: kb.is_feasible("explor"), "did you mean 'explore'"),
    (lambda kb: kb.is_feasible(None), "known: 'explore', 'rest'"),
    (lambda kb: kb.selectable_designs("sea"), "did you mean 'see'"),
    (lambda kb: kb.selectable_configurations("camra"), "did you mean 'camera'"),
    (lambda kb: kb.adaptable_components(["by camra"]), "did you mean 'by camera'"),
    (lambda kb: kb.assert_status("explor", "unfeasible"), "did you mean 'explore'"),
    (lambda kb: kb.retract_status("explor"), "did you mean 'explore'"),
    (lambda kb: kb.assert_required("explor", True), "did you mean 'explore'"),
    (lambda kb: kb.assert_selected("dy", True), "did you mean 'day'"),
    (lambda kb: kb.actions["explor"], "did you mean 'explore'"),
    (lambda kb: kb.functions["sea"], "did you mean 'see'"),
    (lambda kb: kb.components["camra"], "did you mean 'camera'"),
    (lambda kb: kb.designs["by camra"], "did you mean 'by camera'"),
    (lambda kb: kb.configurations["nigt"], "did you mean 'night'"),
    (lambda kb: kb.attributes["ligt"], "did you mean 'light'"),
]


@pytest.mark.parametrize(("ask", "near"), UNKNOWN)
def test_an_unknown_name_is_a_key_error_that_says_what_is_near(kb, told, ask, near):
    with pytest.raises(KeyError, match=near) as caught:
        ask(kb)
    assert type(caught.value) is UnknownName
    assert told == []


def test_a_name_that_cannot_be_hashed_is_unknown_everywhere(kb):
    with pytest.raises(UnknownName):
        kb.explain(["explore"])


@pytest.mark.parametrize("status", ["broken", "", None, 5, "FEASIBLE", ["feasible"]])
def test_a_status_is_one_of_those_that_exist(kb, status):
    with pytest.raises(InvalidValue, match="is no status; a status is one of 'not evaluated'"):
        kb.assert_status("explore", status)
    assert kb.actions["explore"].status is Status.FEASIBLE


@pytest.mark.parametrize(
    ("kind", "name", "status"),
    [
        ("actions", "explore", "satisfied"),
        ("actions", "explore", "configuration error"),
        ("configurations", "day", "solved"),
        ("components", "camera", "implicit configuration error"),
        ("designs", "by camera", "failure"),
    ],
)
def test_an_asserted_status_is_one_of_the_kind_of_the_element(kb, kind, name, status):
    with pytest.raises(InvalidValue):
        kb.assert_status(getattr(kb, kind)[name], status)


def test_an_ambiguous_bare_name_is_refused_where_something_would_change():
    model = Model("recharge")
    part = model.component("recharge")
    model.function("recharge").design("recharge", [part])
    model.action("recharge", requires=["recharge"])
    kb = KnowledgeBase(model)
    for tell in (
        lambda: kb.assert_status("recharge", "unfeasible"),
        lambda: kb.retract_status("recharge"),
        lambda: kb.assert_required("recharge", True),
    ):
        with pytest.raises(
            AmbiguousName, match="'recharge' names several things: an action, a function"
        ):
            tell()
    kb.assert_status(kb.functions["recharge"], "unfeasible")
    assert not kb.is_feasible("recharge")
    assert kb.components["recharge"].status is Status.FEASIBLE
    kb.assert_selected("recharge", True)
    assert kb.designs["recharge"].is_selected


def test_the_hint_of_an_ambiguous_name_is_a_view_of_that_very_name():
    model = Model("recharge")
    model.function("recharge")
    model.action("recharge")
    kb = KnowledgeBase(model)
    with pytest.raises(AmbiguousName) as caught:
        kb.assert_required("recharge", True)
    assert "kb.actions['recharge']" in str(caught.value)


WRONG_KIND = [
    (lambda kb: kb.assert_status(kb.attributes["light"], "feasible")),
    (lambda kb: kb.retract_status(kb.attributes["light"])),
    (lambda kb: kb.assert_required(kb.designs["by camera"], True)),
    (lambda kb: kb.assert_required(kb.attributes["light"], True)),
    (lambda kb: kb.assert_selected(kb.actions["explore"], True)),
    (lambda kb: kb.assert_selected(kb.model.components["camera"], True)),
]


@pytest.mark.parametrize("tell", WRONG_KIND)
def test_a_view_of_a_kind_for_which_it_means_nothing_is_refused(kb, tell):
    with pytest.raises(KnowledgeBaseError):
        tell(kb)


@pytest.mark.parametrize("foreign", ["view", "element"])
def test_what_belongs_to_another_knowledge_base_is_refused(kb, foreign):
    larger = Model("larger")
    for name in ("a", "b", "explore"):
        larger.action(name)
    given = (
        KnowledgeBase(larger).actions["explore"] if foreign == "view" else larger.actions["explore"]
    )
    with pytest.raises(KnowledgeBaseError):
        kb.assert_status(given, "unfeasible")


@pytest.mark.parametrize(
    "tell",
    [
        lambda kb: kb.select(["by camera"]),
        lambda kb: kb.finish_plan(None, "completed"),
        lambda kb: kb.adaptable_components(5),
        lambda kb: KnowledgeBase(None),
        lambda kb: KnowledgeBase(kb.model, clock=5),
        lambda kb: kb.subscribe(None),
    ],
)
def test_a_wrong_type_is_refused_in_our_words(kb, tell):
    with pytest.raises(KnowledgeBaseError):
        tell(kb)


# views


@pytest.mark.parametrize(
    "table", ["actions", "functions", "components", "designs", "configurations", "attributes"]
)
def test_views_are_a_read_only_mapping_in_order_of_declaration(kb, table):
    views = getattr(kb, table)
    elements = getattr(kb.model, table)
    assert isinstance(views, Mapping)
    assert list(views) == list(elements)
    assert len(views) == len(elements) > 0
    assert [view.name for view in views.values()] == list(elements)
    assert all(name in views and views[name] == view for name, view in views.items())
    assert "nothing" not in views
    assert views.get("nothing") is None
    with pytest.raises(TypeError):
        views["new"] = None
    with pytest.raises(TypeError):
        del views[next(iter(views))]


@pytest.mark.parametrize(
    "table", ["actions", "functions", "components", "designs", "configurations", "attributes"]
)
def test_nothing_can_be_changed_through_a_view(kb, table):
    for view in getattr(kb, table).values():
        named = [name for name in dir(view) if not name.startswith("_")]
        assert "name" in named
        for name in [*named, "something_new"]:
            with pytest.raises(AttributeError):
                setattr(view, name, None)


def test_a_view_answers_for_the_moment_in_which_it_is_asked(kb, clock):
    light, explore = kb.attributes["light"], kb.actions["explore"]
    assert (light.value, light.time) == (None, None)
    kb.measure("light", 0.1)
    assert (light.value, light.time, explore.status) == (0.1, 10.0, Status.UNFEASIBLE)
    clock.now = 11.0
    kb.measure("light", 0.3)
    assert (light.value, light.time, explore.status) == (0.3, 11.0, Status.FEASIBLE)


def test_views_give_what_the_model_says(kb):
    camera = kb.components["camera"]
    assert (camera.kind, camera.package, camera.executable) == ("lifecycle", "eyes", "camera_node")
    assert (camera.always_improve, camera.stops_to_configure, camera.is_active) == (
        False,
        False,
        False,
    )
    assert camera.configurations == ("day", "night")
    assert kb.configurations["day"].parameters == {"exposure": 0.01}
    assert (kb.configurations["day"].priority, kb.configurations["night"].priority) == (1, None)
    assert kb.configurations["day"].component == "camera"
    design = kb.designs["by camera"]
    assert (design.function, design.components, design.priority) == ("see", ("camera",), 2)
    assert kb.functions["see"].designs == ("by camera",)
    assert kb.actions["explore"].functions == ("see",)
    (constraint,) = kb.actions["explore"].constraints
    assert (constraint.attribute, constraint.operator, constraint.value) == ("light", ">=", 0.25)
    assert constraint.status is Status.NOT_EVALUATED


def test_two_views_of_one_element_are_equal_and_of_others_are_not(kb):
    assert kb.actions["explore"] == kb.actions["explore"]
    assert len({kb.actions["explore"], kb.actions["explore"], kb.actions["rest"]}) == 2
    assert kb.actions["explore"] != KnowledgeBase(kb.model).actions["explore"]
    assert kb.actions["explore"] != "explore"


# time, memory, threads


def test_the_clock_handed_in_is_the_only_time(kb, clock, told, monkeypatch):
    def forbidden():
        raise AssertionError("the wall clock was read")

    for name in ("time", "monotonic", "perf_counter"):
        monkeypatch.setattr(f"time.{name}", forbidden)
    kb.measure("light", 0.9)
    kb.request_action("explore")
    clock.now = 12.0
    plan = kb.select({"see": "by camera"}, {"camera": "day"})
    kb.explain("explore")
    kb.receive([{"message": "qa status", "values": {"battery": "1"}}])
    clock.now = 13.0
    kb.finish_plan(plan, "completed")
    kb.cancel_action("explore")
    monkeypatch.undo()
    assert (plan.start, plan.end) == (12.0, 13.0)
    assert {one.time for one in told} == {10.0, 12.0, 13.0}


def test_a_clock_that_raises_leaves_facts_and_statuses_in_agreement(kb, clock, monkeypatch):
    def stopped():
        raise RuntimeError("no time")

    monkeypatch.setattr(Clock, "__call__", lambda self: stopped())
    for tell in (lambda: kb.component_failed("camera"), lambda: kb.measure("light", 0.1)):
        with pytest.raises(RuntimeError):
            tell()
    monkeypatch.undo()
    kb.component_active("camera", True)
    assert kb.components["camera"].status is Status.FEASIBLE
    assert kb.is_feasible("explore")


def test_measuring_again_and_again_holds_no_memory_but_its_history(kb):
    def live(times):
        for number in range(times):
            kb.measure("light", 0.3 + (number % 7) / 10)
            kb.component_active("camera", number % 2 == 0)
            kb.component_failed("camera") if number % 3 else kb.component_recovered("camera")
            kb.adaptable_components(["by camera"])

    live(50)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    live(2000)
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    measurements = 2000 * 2 * 16 * 1.25  # two numbers each, in arrays that grow ahead of need
    events = 2000 * 2 * 1100  # of these the newest 100,000 are kept
    assert grown < 50_000 + measurements + events


@settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large], max_examples=40)
@given(stories(max_size=20, asserting=False))
def test_a_planner_has_nothing_to_look_at_once_nothing_is_required_and_all_is_carried_out(story):
    model, happenings = story
    twins = Twins(model)
    for event in happenings:
        twins.happen(event)
    for action in model.actions:
        twins.happen(("cancel", action))
    twins.happen(("select", ({}, {})))
    for name in model.components:
        twins.happen(("active", name, False))
    state = state_of(twins.kb)
    assert (state.adaptable, state.obsolete(), state.inactive_required()) == (set(), [], [])


def test_facts_told_from_several_threads_are_all_there():
    model = Model("busy")
    loads = [model.quality_attribute(f"load {number}") for number in range(4)]
    for number, load in enumerate(loads):
        part = model.component(f"part {number}")
        model.function(f"function {number}").design(f"design {number}", [part])
        model.action(f"action {number}", requires=[f"function {number}"], constraints=[load <= 0.5])
    model.action("all", requires=list(model.functions))
    kb = KnowledgeBase(model, clock=Clock(1.0))
    told, troubles = [], []
    kb.subscribe(told.append)
    together = threading.Barrier(6)

    def run(job):
        try:
            together.wait()
            job()
        except Exception as error:
            troubles.append(error)

    def monitor(number):
        for turn in range(300):
            kb.measure(f"load {number}", float(turn % 2))
            if turn % 5 == 0:
                kb.component_failed(f"part {number}")
                kb.component_recovered(f"part {number}")

    def ask():
        for _ in range(300):
            assert len(kb.selectable_actions()) <= 5
            str(kb.explain("all"))
            kb.adaptable_components(["design 0"])
            kb.obsolete()

    def act():
        for turn in range(150):
            if kb.request_action("all"):
                with suppress(InvalidValue):  # a part may have failed meanwhile
                    plan = kb.select(
                        {f"function {number}": f"design {number}" for number in range(4)}
                    )
                    if plan is not None:
                        kb.finish_plan(plan, "completed")
            kb.cancel_action("all", "completed" if turn % 2 else "failed")

    jobs = [*[lambda number=number: monitor(number) for number in range(4)], ask, act]
    threads = [threading.Thread(target=run, args=(job,)) for job in jobs]
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(interval)
    assert troubles == []
    measured = [
        one
        for one in told
        if one.kind is EventKind.MONITORING_DATA and one.subject.startswith("load")
    ]
    assert len(measured) == 1200
    updates = [one for one in told if one.kind is EventKind.ACTION_UPDATE]
    assert len(updates) == 2 * len(kb.history.actions)
    kb.cancel_action("all")
    for number in range(4):
        assert kb.attributes[f"load {number}"].value == 1.0
        assert kb.actions[f"action {number}"].status is Status.UNFEASIBLE
        kb.measure(f"load {number}", 0.0)
        assert kb.actions[f"action {number}"].status is Status.FEASIBLE
    assert kb.actions["all"].status is Status.FEASIBLE


def test_telling_again_that_a_component_is_active_changes_nothing(kb, told):
    kb.component_active("camera", True)
    count, revision = len(told), kb.revision
    kb.component_active("camera", True)
    assert (len(told), kb.revision) == (count, revision)
    kb.component_active("camera", False)
    assert len(told) == count + 1


def test_an_interrupted_subscriber_silences_nobody(kb, told):
    def interrupted(event):
        unsubscribe()
        raise KeyboardInterrupt

    unsubscribe = kb.subscribe(interrupted)
    with pytest.raises(KeyboardInterrupt):
        kb.measure("light", 0.3)
    before = len(told)
    kb.measure("light", 0.4)
    assert len(told) == before + 1
