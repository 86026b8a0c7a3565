"""Execution on systems that are slow, refuse, or say what is not so; each attempt is on record."""

import math
from itertools import pairwise
from threading import Thread

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
from models import Clock, events, models

from kb import ConfigurationManager, KnowledgeBase, Model, StagedExecutor, Status
from kb.exceptions import InvalidValue

IN_LIFE = settings(
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large], max_examples=40
)


class Life:
    """A knowledge base, a managed system, and a manager that commands it."""

    def __init__(self, script=None, *, model=None, kb=None, system=Scripted, veto=None, **options):
        self.kb = kb or base(model or rover())[0]
        self.clock = self.kb._clock
        self.managed = system(self.clock, script)
        executor = StagedExecutor(self.managed, **{"attempts": 1, **options})
        self.manager = ConfigurationManager(self.kb, self.managed, executor=executor, veto=veto)

    def explore(self, turns=None):
        self.kb.request_action("explore")
        return self.turn(turns) if turns else self.rest()

    def turn(self, times=1, seconds=1.0):
        return turn(self.manager, self.clock, times, seconds)

    def rest(self, **options):
        return come_to_rest(self.manager, self.kb, self.clock, **options)

    def attempts(self, operation, component="camera"):
        return [
            attempt
            for attempt in self.kb.history.attempts
            if (attempt.operation, attempt.component) == (operation, component)
        ]

    @property
    def camera(self):
        return self.kb.components["camera"]

    @property
    def believed(self):
        views = self.kb.components.values()
        return {view.name for view in views if view.is_active and view.kind != "plain"}


# -------------------------------------------------------------------- attempts


def test_command_that_never_ends_is_given_up():
    script = {"activate camera": [math.inf]}
    life = Life(script, timeout=5.0, attempts=2, back_off=0.0)
    life.explore()
    assert life.managed.running == {"lidar"}
    tries = life.attempts("activate")
    assert [(one.start, one.end) for one in tries] == [(100.0, 105.0), (105.0, 110.0)]
    assert {one.reason for one in tries} == {"it was not done within 5 s"}
    assert life.camera.status is Status.FAILURE


@settings(max_examples=15)
@given(st.integers(1, 4), st.sampled_from((0.0, 0.5, 3.0)))
def test_each_further_attempt_waits_twice_as_long(attempts, back_off):
    life = Life({"activate camera": [Broken("no")]}, attempts=attempts, back_off=back_off)
    life.kb.request_action("explore")
    life.turn(120, 0.25)
    tries = life.attempts("activate")
    assert [one.number for one in tries] == list(range(1, attempts + 1))
    gaps = [later.start - earlier.end for earlier, later in pairwise(tries)]
    assert gaps == [back_off * 2**number for number in range(attempts - 1)]


def test_every_attempt_is_on_record_with_what_when_and_why():
    script = {"activate camera": [(2.0, Broken("no light")), 1.0]}
    life = Life(script, attempts=2, back_off=3.0)
    (plan,) = life.explore(12)
    configure, first, second = life.kb.history.attempts
    assert all(one.plan is plan for one in (configure, first, second))
    assert (configure.configuration, dict(configure.parameters)) == ("day", {"exposure": 0.01})
    assert (first.configuration, dict(first.parameters)) == (None, {})
    assert (first.start, first.end, first.reason) == (100.0, 102.0, "no light")
    assert (second.start, second.end, second.reason) == (105.0, 106.0, "")
    assert str(first) == "activate camera, attempt 1: failed: no light"
    assert life.camera.parameters_in_force == {"exposure": 0.01}


def test_failure_says_what_was_tried_and_how_often():
    life = Life({"activate camera": [Broken("no light")]}, attempts=2)
    life.explore()
    reason = "it could not be activated: no light (attempt 2 of 2)"
    assert life.kb.explain("camera").reason == reason
    assert reason in life.kb.latest_plan.reason


def test_operation_past_its_time_out_is_cancelled():
    cancelled = []

    class Slow(Scripted):
        def activate(self, component):
            operation = Operation(self.clock, math.inf, None, None)
            operation.cancel = lambda: cancelled.append(self.clock.now)
            return operation

    Life(system=Slow, timeout=4.0).explore(6)
    assert cancelled[0] == 104.0


def test_operation_is_cancelled_while_other_threads_may_record():
    waiting = []

    class Slow(Scripted):
        def activate(self, component):
            operation = Operation(self.clock, math.inf, None, None)
            operation.cancel = record
            return operation

    def record():
        thread = Thread(target=life.kb.component_failed, args=("lidar",))
        thread.start()
        thread.join(20.0)
        waiting.append(thread.is_alive())

    life = Life(system=Slow)
    life.explore(3)
    life.kb.model.quality_attribute("new")
    life.turn()
    assert waiting == [False]


# -------------------------------------------------------------------- systems that lie


@pytest.mark.parametrize("lie", [LIE, math.inf])
def test_system_that_lies_or_never_answers_is_found_out(lie):
    script = {"activate camera": [lie]}
    life = Life(script, system=Candid, timeout=3.0, attempts=2, back_off=0.0)
    life.explore()
    assert life.managed.running == life.believed == {"lidar"}
    assert life.camera.status is Status.FAILURE
    denied = "reported done, but camera was not in that state within 3 s"
    reason = denied if lie is LIE else "not done within 3 s"
    assert reason in life.attempts("activate")[0].reason


@pytest.mark.parametrize("system", [Scripted, Candid])
def test_component_that_could_not_be_stopped_is_stopped_later(system):
    life = Life({"deactivate camera": [Broken("stuck"), None]}, system=system)
    life.explore()
    life.kb.assert_status(life.kb.designs["by camera"], "unfeasible", "fog")
    life.rest()
    assert life.managed.running == life.believed == {"camera", "lidar"}
    assert life.camera.status is Status.FAILURE
    life.kb.cancel_action("explore")
    life.rest()
    assert life.managed.running == life.believed == set()


def test_component_that_stopped_by_itself_has_failed():
    life = Life(system=Candid)
    life.explore(2)
    life.managed.running.clear()
    (plan,) = life.turn()
    assert life.camera.status is Status.FAILURE
    assert "camera is not running, though nobody has stopped it" in plan.reason
    assert life.managed.running == {"lidar"}


# -------------------------------------------------------------------- quarantine


def in_quarantine(hold=50.0, **camera):
    """Return a life in which the better configuration was refused at 100 s, and is not now."""
    script = {"configure camera": [Broken("rate too high"), None]}
    life = Life(script, model=rover(**camera), hold=hold)
    life.explore(3)
    assert life.camera.selected_configuration == "night"
    assert life.camera.status is Status.SOLVED
    return life


def test_refused_parameters_rule_out_their_configuration():
    life = in_quarantine()
    assert life.managed.parameters == {"camera": {"exposure": 0.2}}
    explanation = life.kb.explain("day")
    assert explanation.reason == ("its parameters could not be set: rate too high (attempt 1 of 1)")
    assert "until 150 s" in str(explanation)


def test_configuration_is_released_after_its_hold():
    life = in_quarantine(always_improve=True)
    life.clock.now = 149.9
    assert life.turn(1, 0.1) == []
    life.turn(2)
    assert life.camera.selected_configuration == "day"
    assert life.managed.parameters == {"camera": {"exposure": 0.01}}


@pytest.mark.parametrize("hold", [0.0, 1e-300, 1e-9])
def test_hold_that_is_over_at_once_holds_nothing(hold):
    life = Life({"configure camera": [Broken("too fast"), None]}, hold=hold)
    life.explore(5)
    assert life.camera.selected_configuration == "day"
    assert life.camera.status is Status.SOLVED


def opened(path, clock):
    return KnowledgeBase(rover(always_improve=True), clock=clock, store=path)


def test_quarantine_outlasts_a_restart(tmp_path):
    clock = Clock(100.0)
    script = {"configure camera": [Broken("too fast"), None]}
    life = Life(script, kb=opened(tmp_path / "store", clock), hold=50.0)
    life.explore(3)
    life.kb.close()
    life = Life(kb=opened(tmp_path / "store", clock))
    life.turn()
    assert "its parameters could not be set" in life.kb.explain("day").reason
    clock.now = 149.9
    life.turn(1, 0.1)
    assert life.camera.selected_configuration == "night"
    life.turn(2)
    assert life.camera.selected_configuration == "day"
    life.kb.close()


def test_what_stopped_while_nobody_was_there_is_started_again(tmp_path):
    clock = Clock(100.0)
    life = Life(kb=opened(tmp_path / "store", clock), system=Candid)
    life.explore(2)
    life.kb.close()
    life = Life(kb=opened(tmp_path / "store", clock), system=Candid)
    assert life.camera.is_active
    life.turn()
    assert life.managed.running == {"camera"}
    assert life.kb.actions["explore"].status is Status.SOLVED
    life.kb.close()


# -------------------------------------------------------------------- roll-back


def trio():
    """Return a model of an action that needs two components together, and of another."""
    model = Model("trio")
    for name in ("first", "second", "third"):
        model.component(name, kind="process")
    model.function("see").design("both", ["first", "second"])
    model.function("hear").design("ear", ["third"])
    model.action("explore", requires=["see"])
    model.action("listen", requires=["hear"])
    return model


def test_design_started_in_vain_is_not_started_again():
    life = Life({"activate second": [Broken("no")]}, model=trio())
    life.explore()
    kb = life.kb
    assert life.managed.running == life.believed == {"first"}
    assert not kb.designs["both"].is_selected
    assert kb.latest_plan.result == "failed"
    life.managed.log.clear()
    kb.request_action("listen")
    life.rest()
    assert life.managed.log == ["activate third"]  # and nothing of the design that is not possible
    kb.component_recovered("second")
    life.managed.script.clear()
    life.rest()
    assert life.managed.running == {"first", "second", "third"}
    assert kb.actions["explore"].status is Status.SOLVED


# -------------------------------------------------------------------- reasons, vetoes, bad input


@pytest.mark.parametrize(
    "options",
    [
        {"attempts": 0},
        {"attempts": 1.5},
        {"attempts": True},
        {"timeout": -1.0},
        {"timeout": math.nan},
        {"timeout": "5"},
        {"back_off": -1.0},
        {"hold": -1.0},
        {"hold": math.nan},
    ],
    ids=str,
)
def test_figure_without_meaning_is_refused(options):
    with pytest.raises(InvalidValue, match="not"):
        StagedExecutor(Scripted(None), **options)


# -------------------------------------------------------------------- laws

OUTCOMES = st.sampled_from(
    (None, 0.0, 1.0, math.inf, LIE, Broken("at once"), (1.0, Broken("later")))
)


@IN_LIFE
@given(models(), st.data())
def test_facts_and_records_are_true_after_any_trouble(model, data):
    """Random things happen to a robot whose system is random, and honest in the end."""
    verbs = ("activate", "deactivate", "configure")
    lines = [f"{verb} {name}" for verb in verbs for name in model.components]
    script = {line: [*data.draw(st.lists(OUTCOMES, max_size=3)), None] for line in lines}
    options = {"attempts": 2, "timeout": 3.0, "back_off": 1.0, "hold": 15.0}
    life = Life(script, model=model, system=Candid, **options)
    kb = life.kb
    things = events(model, asserting=False, selecting=False)
    things = things.filter(lambda event: event[0] != "active")
    for event in data.draw(st.lists(things, min_size=5, max_size=15)):
        life.clock.now += 1.0
        happen(kb, event)
        life.manager.update()
    life.rest(most=400, quiet=20)
    assert life.believed == life.managed.running
    for component in kb.components.values():
        selected = component.selected_configuration
        if component.is_active and selected and component.status is Status.SOLVED:
            assert component.parameters_in_force == kb.configurations[selected].parameters
    assert len(kb.history.attempts) == len(life.managed.log)
    for attempt in kb.history.attempts:
        assert attempt.plan in kb.plans
        assert attempt.plan.start <= attempt.start <= attempt.end
        assert attempt.result in ("completed", "failed")
        assert attempt.reason or attempt.result == "completed"
        assert 1 <= attempt.number <= 2
    life.managed.script.clear()
    for name in model.components:
        kb.component_recovered(name)
    life.rest(most=400, quiet=20)
    for design in kb.designs.values():
        if design.is_selected and kb.functions[design.function].status is Status.SOLVED:
            assert all(kb.components[name].is_active for name in design.components)
    assert life.believed == life.managed.running
    assert not kb.obsolete().components


@IN_LIFE
@given(models(), st.data())
def test_dry_run_names_exactly_what_is_commanded(model, data):
    life = Life(model=model)
    kb = life.kb
    for name in data.draw(st.lists(st.sampled_from(sorted(model.actions) or [None]), max_size=6)):
        if name is None:
            continue
        is_required = kb.actions[name].is_required
        (kb.cancel_action if is_required else kb.request_action)(name)
        plan = life.manager.dry_run()
        life.managed.log.clear()
        life.manager.update()
        commands = []
        for step in str(plan or "").split("; "):
            verb, _, names = step.partition(" ")
            if verb in ("activate", "deactivate"):
                commands += [f"{verb} {component}" for component in names.split(", ")]
        switches = [line for line in life.managed.log if not line.startswith("configure")]
        assert sorted(commands) == sorted(switches)
        if plan is not None:
            switched = (*plan.activate, *plan.deactivate)
            plain = {name for name in switched if kb.components[name].kind == "plain"}
            assert set(plan.plain) == plain


@IN_LIFE
@given(models(), st.data())
def test_facts_are_put_right_whatever_stops_by_itself(model, data):
    life = Life(model=model, system=Candid)
    for name in model.actions:
        life.kb.request_action(name)
    life.rest()
    for _ in range(3):
        running = life.managed.running
        if running:
            running -= set(data.draw(st.lists(st.sampled_from(sorted(running)))))
        life.rest()
        assert life.believed == life.managed.running
