"""Facts in, questions out: requests, events, views, and what a knowledge base refuses."""

import math
from collections.abc import Mapping

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


def test_feasible_action_is_required_once_requested(kb):
    assert kb.request_action("explore", preference="battery")
    (required,) = kb.required_actions
    assert (required.action, required.preference, required.start) == ("explore", "battery", 10.0)
    assert (required.end, required.result) == (None, None)
    assert kb.functions["see"].is_required
    assert not kb.actions["rest"].is_required
    with pytest.raises(AttributeError):
        required.end = 3.0


def test_unfeasible_action_is_refused_with_the_reason(kb, told):
    kb.measure("light", 0.24)
    told.clear()
    revision = kb.revision
    reply = kb.request_action("explore")
    assert not reply
    reason = "explore is unfeasible because light 0.24 violates >= 0.25 (measured 0.0 s ago)"
    assert reply.reason == reason
    assert kb.required_actions == kb.history.actions == ()
    assert told == []
    assert kb.revision == revision


@pytest.mark.parametrize("result", ["completed", "failed", "abandoned"])
def test_cancelled_action_ends_once_with_its_result(kb, clock, told, result):
    kb.request_action("explore", preference="battery")
    kb.request_action("explore", preference="light")
    (required,) = kb.required_actions
    assert required.preference == "battery"
    clock.now = 12.0
    kb.cancel_action("explore", result)
    kb.cancel_action("explore", "completed")
    kb.cancel_action("rest")
    assert (required.end, required.result) == (12.0, result)
    assert kb.required_actions == ()
    assert kb.history.actions == (required,)
    assert [event.verb for event in told] == ["request_action", "cancel_action"]
    with pytest.raises(InvalidValue, match="completed, failed, abandoned"):
        kb.cancel_action("explore", "done")


def test_running_action_stays_required_when_unfeasible(kb):
    kb.request_action("rest")
    kb.request_action("explore")
    kb.measure("light", 0.1)
    assert not kb.is_feasible("explore")
    assert kb.actions["explore"].is_required
    assert kb.selectable_actions() == ("rest",)
    assert [request.action for request in kb.required_actions] == ["rest", "explore"]
    kb.measure("light", 0.9)
    assert kb.is_feasible("explore")


# events


def test_events_come_in_order_with_the_three_kinds(kb, told, clock):
    kb.measure("light", 0.9)
    kb.request_action("explore")
    clock.now = 11.0
    plan = kb.select({"see": "by camera"}, {"camera": "day"})
    kb.component_active("camera", True)
    kb.component_active("camera", True)
    kb.component_failed("camera")
    kb.cancel_action("explore", "completed")
    assert [(event.kind, event.text, event.time) for event in told] == [
        ("monitoring data", "light is 0.9", 10.0),
        ("action update", "explore is requested", 10.0),
        ("reconfiguration plan", "activate camera; configure day", 11.0),
        ("monitoring data", "camera is active", 11.0),
        ("monitoring data", "camera has failed", 11.0),
        ("action update", "explore is completed", 11.0),
    ]
    assert told[2].plan is plan


def test_event_says_which_statuses_changed(kb, told):
    kb.measure("light", 0.24)
    assert set(told[0].changes) == {
        StatusChange("constraint", "light >= 0.5", Status.NOT_EVALUATED, Status.VIOLATED),
        StatusChange("constraint", "light >= 0.25", Status.NOT_EVALUATED, Status.VIOLATED),
        StatusChange("configuration", "day", Status.FEASIBLE, Status.UNFEASIBLE),
        StatusChange("action", "explore", Status.FEASIBLE, Status.UNFEASIBLE),
    }
    kb.measure("light", 0.24)
    assert told[1].changes == ()


def test_subscriber_is_called_until_it_leaves(kb):
    seen = []
    after = []

    def once(event):
        seen.append(event)
        leave()

    leave = kb.subscribe(once)
    kb.subscribe(after.append)
    kb.measure("light", 0.9)
    kb.measure("light", 0.8)
    leave()
    assert (len(seen), len(after)) == (1, 2)


def test_subscriber_may_ask_and_record(kb):
    def abandon(event):
        if event.kind is EventKind.MONITORING_DATA and not kb.is_feasible("explore"):
            kb.cancel_action("explore", "failed")

    seen = []
    kb.subscribe(abandon)
    kb.subscribe(lambda event: seen.append((event.verb, kb.attributes["light"].value)))
    kb.request_action("explore")
    kb.measure("light", 0.1)
    assert [request.result for request in kb.history.actions] == ["failed"]
    assert seen == [("request_action", None), ("measure", 0.1), ("cancel_action", 0.1)]


def test_subscriber_that_raises_hurts_nobody(kb):
    def broken(event):
        raise RuntimeError("broken subscriber")

    seen = []
    kb.subscribe(broken)
    kb.subscribe(seen.append)
    kb.measure("light", 0.1)
    assert len(seen) == 1
    assert kb.actions["explore"].status is Status.UNFEASIBLE


# facts


class Array:
    """Has `__float__`, like an array, and cannot use it, like one with several numbers."""

    def __float__(self):
        raise TypeError("only one number can be converted")


@pytest.mark.parametrize(
    "value",
    [math.nan, math.inf, True, "0.5", None, 1j, b"1", Array(), pytest.param(10**400, id="")],
)
def test_what_is_no_finite_number_changes_nothing(kb, told, value):
    kb.measure("light", 0.3)
    with pytest.raises(InvalidValue, match="light cannot be measured as"):
        kb.measure("light", value)
    assert kb.attributes["light"].value == 0.3
    assert len(told) == 1


@pytest.mark.parametrize("value", ["yes", 1.0])
def test_what_is_so_or_not_is_a_boolean(kb, value):
    kb.select({"see": "by camera"})
    before = kb.log.last
    for what, record in {
        "active": lambda: kb.component_active("camera", value),
        "required": lambda: kb.assert_required("camera", value),
        "selected": lambda: kb.assert_selected("night", value),
    }.items():
        with pytest.raises(InvalidValue, match=f"^{what} is True or False, not {value!r}$"):
            record()
    assert kb.log.last == before


UNKNOWN = [
    (lambda kb: kb.measure("ligt", 1.0), "did you mean 'light'"),
    (lambda kb: kb.component_failed("camra"), "did you mean 'camera'"),
    (lambda kb: kb.component_active("camra", True), "did you mean 'camera'"),
    (lambda kb: kb.request_action("explore", "batery"), "did you mean 'battery'"),
    (lambda kb: kb.is_feasible(None), "known: 'explore', 'rest'"),
    (lambda kb: kb.selectable_designs("sea"), "did you mean 'see'"),
    (lambda kb: kb.adaptable_components(["by camra"]), "did you mean 'by camera'"),
    (lambda kb: kb.assert_status("explor", "unfeasible"), "did you mean 'explore'"),
    (lambda kb: kb.designs["by camra"], "did you mean 'by camera'"),
    (lambda kb: kb.explain(["explore"]), "explore"),
]


@pytest.mark.parametrize(("ask", "near"), UNKNOWN)
def test_unknown_name_is_a_key_error_that_says_what_is_near(kb, told, ask, near):
    with pytest.raises(KeyError, match=near) as caught:
        ask(kb)
    assert type(caught.value) is UnknownName
    assert told == []


@pytest.mark.parametrize(
    ("element", "status", "words"),
    [
        ("explore", "broken", "a action is never broken; it can be unfeasible"),
        ("explore", None, "never None"),
        ("explore", "satisfied", "a action is never satisfied"),
        ("day", "solved", "a configuration is never solved"),
        ("camera", "implicit configuration error", "a component is never"),
        ("by camera", "failure", "a function design is never failure"),
    ],
)
def test_asserted_status_is_one_of_the_elements_kind(kb, element, status, words):
    with pytest.raises(InvalidValue, match=words):
        kb.assert_status(element, status)


@pytest.mark.parametrize("keep", [-1, 0, 2.5, "all"])
def test_base_is_made_only_with_a_number_of_measurements_to_keep(keep):
    with pytest.raises(InvalidValue, match="measurements to keep is a whole number from 1"):
        KnowledgeBase(Model("rover"), keep=keep)


def test_subscriber_that_cannot_be_called_is_refused(kb):
    with pytest.raises(InvalidValue, match="5 cannot be"):
        kb.subscribe(5)


def test_ambiguous_name_is_refused_where_something_would_change():
    model = Model("recharge")
    part = model.component("recharge")
    model.function("recharge").design("recharge", [part])
    model.action("recharge", requires=["recharge"])
    kb = KnowledgeBase(model)
    words = r"'recharge' names several things: an action, a function.*kb\.actions\['recharge'\]"
    for record in (
        lambda: kb.assert_status("recharge", "unfeasible"),
        lambda: kb.retract_status("recharge"),
        lambda: kb.assert_required("recharge", True),
    ):
        with pytest.raises(AmbiguousName, match=words):
            record()
    kb.assert_status(kb.functions["recharge"], "unfeasible")
    assert not kb.is_feasible("recharge")
    kb.assert_selected("recharge", True)
    assert kb.designs["recharge"].is_selected


OTHER = KnowledgeBase(rover())


@pytest.mark.parametrize(
    "record",
    [
        lambda kb: kb.assert_status(kb.attributes["light"], "feasible"),
        lambda kb: kb.assert_required(kb.designs["by camera"], True),
        lambda kb: kb.assert_selected(kb.model.components["camera"], True),
        lambda kb: kb.assert_status(OTHER.actions["explore"], "unfeasible"),
        lambda kb: kb.assert_status(OTHER.model.actions["explore"], "unfeasible"),
        lambda kb: kb.finish_plan(None, "completed"),
        lambda kb: kb.adaptable_components(5),
        lambda kb: KnowledgeBase(None),
    ],
)
def test_what_means_nothing_is_refused(kb, record):
    with pytest.raises(KnowledgeBaseError):
        record(kb)
    assert kb.log.last == 0


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
    with pytest.raises(TypeError):
        views["new"] = None
    for view in views.values():
        for name in [name for name in dir(view) if not name.startswith("_")]:
            with pytest.raises(AttributeError):
                setattr(view, name, None)


def test_view_answers_for_the_moment_in_which_it_is_asked(kb, clock):
    light = kb.attributes["light"]
    explore = kb.actions["explore"]
    assert (light.value, light.time) == (None, None)
    kb.measure("light", 0.1)
    clock.now = 11.0
    assert (light.value, light.time, explore.status) == (0.1, 10.0, Status.UNFEASIBLE)
    kb.measure("light", 0.3)
    assert (light.value, light.time, explore.status) == (0.3, 11.0, Status.FEASIBLE)
    assert light.history == ((10.0, 0.1), (11.0, 0.3))


def test_views_give_what_the_model_says(kb):
    camera = kb.components["camera"]
    assert (camera.kind, camera.package, camera.executable) == ("lifecycle", "eyes", "camera_node")
    assert camera.configurations == ("day", "night")
    assert kb.configurations["day"].parameters == {"exposure": 0.01}
    assert (kb.configurations["day"].priority, kb.configurations["night"].priority) == (1, None)
    design = kb.designs["by camera"]
    assert (design.function, design.components, design.priority) == ("see", ("camera",), 2)
    assert kb.functions["see"].designs == ("by camera",)
    assert kb.actions["explore"].functions == ("see",)
    (constraint,) = kb.actions["explore"].constraints
    assert (constraint.attribute, constraint.operator, constraint.value) == ("light", ">=", 0.25)
    assert kb.actions["explore"] == kb.actions["explore"] != OTHER.actions["explore"]


def test_parameters_in_force_are_those_last_given_and_a_copy(kb):
    assert kb.components["camera"].parameters_in_force == {}
    kb.request_action("explore")
    plan = kb.select({"see": "by camera"}, {"camera": "day"})
    values = {"exposure": 0.5}
    attempt = kb.record_attempt(plan, "camera", "configure", "day", values)
    values["exposure"] = 0.7
    kb.finish_attempt(attempt, "completed")
    assert kb.components["camera"].parameters_in_force == {"exposure": 0.5}
    with pytest.raises(TypeError):
        kb.components["camera"].parameters_in_force["exposure"] = 1.0


# time


@settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large], max_examples=40)
@given(stories(max_size=20, asserting=False))
def test_nothing_is_left_to_choose_once_nothing_is_required(story):
    model, happenings = story
    twins = Twins(model, happenings)
    for action in model.actions:
        twins.happen(("cancel", action))
    twins.happen(("select", ({}, {})))
    for name in model.components:
        twins.happen(("active", name, False))
    state = state_of(twins.kb)
    assert (state.adaptable, state.obsolete(), state.inactive_required()) == (set(), [], [])
