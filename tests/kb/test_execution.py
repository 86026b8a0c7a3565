"""Execution that copes with systems that are slow, refuse, or say what is not so; every attempt is on record."""

import math
from itertools import pairwise

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from managed_stand_ins import (
    LIE,
    Broken,
    Candid,
    Operation,
    Scripted,
    base,
    come_to_rest,
    happen,
    rover,
    turn,
)
from models import events, models

from kb import ConfigurationManager, Model, StagedExecutor, Status, UnknownName
from kb.exceptions import InvalidValue


def start(model=None, script=None, default=None, system=Scripted, veto=None, **options):
    kb, clock = base(model or rover())
    managed = system(clock, script, default)
    executor = StagedExecutor(managed, **options)
    return kb, clock, managed, ConfigurationManager(kb, managed, executor=executor, veto=veto)


def told(attempts):
    return [(one.operation, one.component, one.number, one.result) for one in attempts]


# time-outs and back-off


def test_command_that_never_ends_is_given_up():
    kb, clock, managed, manager = start(
        script={"activate camera": [math.inf]}, timeout=5.0, attempts=2, back_off=0.0
    )
    kb.request_action("explore")
    come_to_rest(manager, kb, clock)
    assert managed.log.count("activate camera") == 2
    assert managed.running == {"lidar"}
    tries = [
        one
        for one in kb.history.attempts
        if one.component == "camera" and one.operation == "activate"
    ]
    assert [(one.start, one.end) for one in tries] == [(100.0, 105.0), (105.0, 110.0)]
    assert {one.reason for one in tries} == {"it was not done within 5 s"}
    assert kb.components["camera"].status is Status.FAILURE


@pytest.mark.parametrize("system", [Scripted, Candid])
def test_component_that_could_not_be_stopped_is_stopped_later(
    system,
):
    refusals = [Broken("stuck"), Broken("stuck"), None]
    script = {"deactivate camera": refusals}
    kb, clock, managed, manager = start(script=script, system=system, attempts=2, back_off=0.0)
    kb.request_action("explore")
    come_to_rest(manager, kb, clock)
    kb.assert_status(kb.designs["by camera"], "unfeasible", "fog")
    come_to_rest(manager, kb, clock)
    assert managed.running == {"camera", "lidar"}
    assert kb.components["camera"].is_active
    assert kb.components["camera"].status is Status.FAILURE
    assert "camera" not in kb.obsolete().components
    kb.cancel_action("explore")
    assert "camera" in kb.obsolete().components
    come_to_rest(manager, kb, clock)
    assert managed.running == set()
    assert not kb.components["camera"].is_active


@given(st.integers(1, 6), st.sampled_from((0.0, 0.5, 2.0, 3.0)))
def test_each_further_attempt_waits_twice_as_long(attempts, back_off):
    kb, clock, _, manager = start(
        script={"activate camera": [Broken("no")]}, attempts=attempts, back_off=back_off
    )
    kb.request_action("explore")
    for _ in range(1000):
        manager.update()
        clock.now += 0.25
    tries = [
        one
        for one in kb.history.attempts
        if (one.operation, one.component) == ("activate", "camera")
    ]
    assert [one.number for one in tries] == list(range(1, attempts + 1))
    gaps = [later.start - earlier.end for earlier, later in pairwise(tries)]
    assert gaps == [back_off * 2**number for number in range(attempts - 1)]


def test_operation_past_its_time_out_is_cancelled():
    cancelled = []

    class Cancellable(Operation):
        def cancel(self):
            cancelled.append(self.clock.now)
            raise Broken("and it complains")

    class Slow(Scripted):
        def activate(self, component):
            return Cancellable(self.clock, math.inf, None, None)

    kb, clock, _, manager = start(system=Slow, timeout=4.0, attempts=1)
    kb.request_action("explore")
    turn(manager, clock, 6)
    assert cancelled[0] == 104.0


# systems that say what is not so


@pytest.mark.parametrize("lie", [LIE, math.inf])
def test_system_that_lies_or_never_answers_is_found_out(lie):
    kb, clock, managed, manager = start(
        script={"activate camera": [lie]}, system=Candid, timeout=3.0, attempts=2, back_off=0.0
    )
    kb.request_action("explore")
    come_to_rest(manager, kb, clock)
    assert managed.running == {"lidar"}
    assert not kb.components["camera"].is_active
    assert kb.components["camera"].status is Status.FAILURE
    reason = (
        "reported done, but camera was not in that state within 3 s"
        if lie is LIE
        else "not done within 3 s"
    )
    assert reason in kb.history.attempts[1].reason


def test_what_is_done_counts_though_the_system_never_says_so():
    class Mute(Candid):
        def activate(self, component):
            super().activate(component)
            return Operation(self.clock, math.inf, None, None)

    kb, clock, _, manager = start(system=Mute, timeout=3.0)
    kb.request_action("explore")
    come_to_rest(manager, kb, clock)
    assert kb.actions["explore"].status is Status.SOLVED
    (switched,) = [one for one in kb.history.attempts if one.operation == "activate"]
    assert (switched.result, switched.reason) == (
        "completed",
        "it was never reported done, but it is",
    )


# configurations are put in quarantine before components are given up


def test_refused_parameters_rule_out_their_configuration():
    kb, clock, managed, manager = start(
        script={"configure camera": [Broken("rate too high"), None]}, attempts=1, hold=1000.0
    )
    kb.request_action("explore")
    come_to_rest(manager, kb, clock)
    assert kb.components["camera"].status is Status.SOLVED
    assert kb.components["camera"].selected_configuration == "night"
    assert managed.parameters == {"camera": {"exposure": 0.2}}
    assert kb.configurations["day"].status is Status.UNFEASIBLE
    assert str(kb.explain(kb.configurations["day"])).startswith(
        "day is unfeasible because it is asserted so"
    )


def in_quarantine(hold=50.0, always_improve=True):
    """A camera whose better configuration was refused at 100 s and would be accepted now."""
    kb, clock, managed, manager = start(
        rover(always_improve=always_improve),
        {"configure camera": [Broken("rate too high"), None]},
        attempts=1,
        hold=hold,
    )
    kb.request_action("explore")
    turn(manager, clock, 3)
    assert kb.components["camera"].selected_configuration == "night"
    assert (
        "its parameters could not be set, tried once: rate too high"
        in kb.explain(kb.configurations["day"]).reason
    )
    return kb, clock, managed, manager


def test_configuration_is_released_after_its_hold():
    kb, clock, managed, manager = in_quarantine(hold=50.0)
    clock.now = 149.9
    assert turn(manager, clock, 1, 0.1) == []
    turn(manager, clock, 2)
    assert kb.components["camera"].selected_configuration == "day"
    assert managed.parameters == {"camera": {"exposure": 0.01}}


def test_recovery_of_a_component_releases_configurations():
    kb, clock, _, manager = in_quarantine(hold=math.inf)
    kb.component_recovered("camera")
    turn(manager, clock, 3)
    # a component that was not in failure tells nothing new by being well
    assert kb.configurations["day"].status is Status.UNFEASIBLE
    kb.component_failed("camera")
    turn(manager, clock, 3)
    kb.component_recovered("camera")
    turn(manager, clock, 3)
    assert kb.configurations["day"].status is Status.FEASIBLE


def test_released_configuration_is_set_before_it_counts():
    kb, clock, managed, manager = in_quarantine(hold=50.0, always_improve=False)
    clock.now = 200.0
    turn(manager, clock, 3)
    assert kb.components["camera"].selected_configuration == "night"
    assert managed.parameters == {"camera": {"exposure": 0.2}}


# roll-back


def trio(others=True):
    """One action, a function by two or three components together, and perhaps a second design with one of them."""
    model = Model("trio")
    for name in ("first", "second", "third"):
        model.component(name, kind="process")
    see = model.function("see")
    see.design("both", ["first", "second"], priority=1)
    if others:
        see.design("other", ["first", "third"], priority=2)
    model.function("hear").design("ear", ["third"])
    model.action("explore", requires=[see])
    model.action("listen", requires=["hear"])
    return model


def test_component_started_in_vain_is_stopped_again():
    kb, clock, managed, manager = start(trio(others=False), {"activate second": [Broken("no")]})
    kb.request_action("explore")
    come_to_rest(manager, kb, clock)
    assert managed.running == set()
    assert not kb.components["first"].is_active
    assert not kb.designs["both"].is_selected
    assert kb.latest_plan.result == "failed"
    managed.log.clear()
    kb.request_action("listen")
    come_to_rest(manager, kb, clock)
    assert managed.log == ["activate third"]  # and nothing of the design that cannot be had
    kb.component_recovered("second")
    managed.script.clear()
    come_to_rest(manager, kb, clock)
    assert managed.running == {"first", "second", "third"}
    assert kb.actions["explore"].status is Status.SOLVED


def test_a_start_that_came_true_too_late_is_undone():
    class Late(Scripted):
        def activate(self, component):
            super().activate(component)
            return Operation(self.clock, math.inf, None, None)

    kb, clock, managed, manager = start(trio(others=False), system=Late, timeout=2.0, attempts=1)
    kb.request_action("explore")
    come_to_rest(manager, kb, clock)
    assert managed.running == set()


def test_component_stopped_by_a_failed_command_is_inactive():
    class Grumbling(Candid):
        def deactivate(self, component):
            super().deactivate(component)
            raise Broken("stopped, but not as it should")

    kb, clock, managed, manager = start(system=Grumbling)
    kb.request_action("explore")
    come_to_rest(manager, kb, clock)
    kb.cancel_action("explore")
    come_to_rest(manager, kb, clock)
    assert managed.running == set()
    assert not kb.components["camera"].is_active


# the record


def test_every_attempt_is_on_record_with_what_when_and_why():
    kb, clock, _, manager = start(
        script={"activate camera": [(2.0, Broken("no light")), 1.0]}, attempts=2, back_off=3.0
    )
    kb.request_action("explore")
    (plan,) = turn(manager, clock, 12)
    assert told(kb.history.attempts) == [
        ("configure", "camera", 1, "completed"),
        ("activate", "camera", 1, "failed"),
        ("activate", "camera", 2, "completed"),
    ]
    assert all(one.plan is plan for one in kb.history.attempts)
    configure, first, second = kb.history.attempts
    assert (configure.configuration, dict(configure.parameters)) == ("day", {"exposure": 0.01})
    assert (first.configuration, dict(first.parameters)) == (None, {})
    assert (first.start, first.end, first.reason) == (100.0, 102.0, "no light")
    assert (second.start, second.end, second.reason) == (105.0, 106.0, "")
    assert str(first) == "activate camera, attempt 1: failed: no light"
    with pytest.raises(AttributeError):
        first.result = "completed"


# bad input


@pytest.mark.parametrize(
    "options",
    [
        {"attempts": 0},
        {"attempts": 1.5},
        {"attempts": True},
        {"timeout": 0.0},
        {"timeout": math.nan},
        {"timeout": "5"},
        {"timeout_by_component": {"camera": 0}},
        {"back_off": -1.0},
        {"back_off": math.inf},
        {"hold": -1.0},
        {"hold": math.nan},
    ],
    ids=str,
)
def test_figures_without_meaning_are_refused(options):
    with pytest.raises(InvalidValue, match="not"):
        StagedExecutor(Scripted(None), **options)


def test_time_out_of_an_unknown_component_is_refused():
    _, _, _, manager = start(timeout_by_component={"camra": 1.0})
    with pytest.raises(UnknownName, match="did you mean 'camera'"):
        manager.update()
    assert manager.update() is None


# laws

OUTCOMES = st.sampled_from(
    (None, 0.0, 1.0, math.inf, LIE, Broken("at once"), (1.0, Broken("later")))
)
in_life = settings(
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large], max_examples=80
)


def lived(model, data):
    """Let random things happen to a random robot on a system that is scripted at random and honest in the end."""
    kb, clock = base(model)
    lines = [
        f"{verb} {name}"
        for verb in ("activate", "deactivate", "configure")
        for name in model.components
    ]
    script = {line: [*data.draw(st.lists(OUTCOMES, max_size=3)), None] for line in lines}
    managed = Candid(clock, script)
    executor = StagedExecutor(managed, attempts=2, timeout=3.0, back_off=1.0, hold=15.0)
    manager = ConfigurationManager(kb, managed, executor=executor)
    things = events(model, asserting=False, selecting=False).filter(lambda one: one[0] != "active")
    for event in data.draw(st.lists(things, min_size=5, max_size=15)):
        clock.now += 1.0
        happen(kb, event)
        manager.update()
    return kb, clock, managed, manager


def commanded(kb):
    return {one.name for one in kb.components.values() if one.is_active and one.kind != "plain"}


@in_life
@given(models(), st.data())
def test_facts_and_records_are_true_after_any_trouble(model, data):
    kb, clock, managed, manager = lived(model, data)
    come_to_rest(manager, kb, clock, most=400, quiet=20)
    assert commanded(kb) == managed.running
    for one in kb.components.values():
        if one.is_active and one.selected_configuration is not None and one.status is Status.SOLVED:
            assert (
                one.parameters_in_force == kb.configurations[one.selected_configuration].parameters
            )
    check_record(kb, managed)
    managed.script.clear()
    for name in model.components:
        kb.component_recovered(name)
    come_to_rest(manager, kb, clock, most=400, quiet=20)
    for design in kb.designs.values():
        if design.is_selected and kb.functions[design.function].status is Status.SOLVED:
            for name in design.components:
                assert kb.components[name].is_active
                assert name in managed.running or kb.components[name].kind == "plain"
    assert not kb.obsolete().components


def check_record(kb, managed):
    """Assert that every command is on record, with how it ended."""
    assert len(kb.history.attempts) == len(managed.log)
    for one in kb.history.attempts:
        assert one.plan in kb.plans
        assert one.plan.start <= one.start <= one.end
        assert one.result in ("completed", "failed")
        assert (one.reason != "") >= (one.result == "failed")
        assert 1 <= one.number <= 2
