"""What execution leaves in the knowledge base: attempts, answers, reasons and holds, also after it is opened again."""

import math
from itertools import chain

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from managed_stand_ins import Broken, Candid, Scripted, base, come_to_rest, rover, turn
from models import Clock, models

from kb import ConfigurationManager, KnowledgeBase, StagedExecutor, Status

in_life = settings(
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large], max_examples=60
)


def start(script=None, *, kb=None, system=Scripted, veto=None, **options):
    kb = kb or base(rover())[0]
    managed = system(kb._clock, script)
    executor = StagedExecutor(managed, **{"attempts": 1, **options})
    return (
        kb,
        kb._clock,
        managed,
        ConfigurationManager(kb, managed, executor=executor, veto=veto),
    )


def opened(path, clock):
    return KnowledgeBase(rover(always_improve=True), clock=clock, store=path)


# reasons


def test_a_failure_says_what_was_tried_and_how_often():
    kb, clock, _, manager = start({"activate camera": [Broken("no light")]}, attempts=2)
    kb.request_action("explore")
    come_to_rest(manager, kb, clock)
    reason = "it could not be activated, tried twice: no light"
    assert kb.explain(kb.components["camera"]).reason == reason
    assert reason in kb.latest_plan.reason


def test_configuration_ruled_out_says_why_and_until_when():
    kb, clock, _, manager = start({"configure camera": [Broken("too fast"), None]}, hold=50.0)
    kb.request_action("explore")
    come_to_rest(manager, kb, clock)
    explained = kb.explain(kb.configurations["day"])
    assert explained.reason == "its parameters could not be set, tried once: too fast"
    assert "until 150 s" in str(explained)


@given(st.sampled_from((0.0, 1e-300, 1e-9)))
def test_a_hold_that_is_over_at_once_holds_nothing(hold):
    kb, clock, _, manager = start({"configure camera": [Broken("too fast"), None]}, hold=hold)
    kb.request_action("explore")
    turn(manager, clock, 5)
    assert kb.components["camera"].selected_configuration == "day"
    assert kb.components["camera"].status is Status.SOLVED


def test_plan_that_starts_something_again_says_so():
    kb, clock, _, manager = start()
    kb.request_action("explore")
    turn(manager, clock)
    kb.component_active("camera", False, "somebody pulled the plug")
    plan = manager.dry_run()
    assert plan.reason == "somebody pulled the plug; camera is needed by explore"
    assert manager.update().reason == plan.reason
    assert kb.designs["by camera"].reason == kb.configurations["day"].reason == ""
    kb.component_active("camera", False)
    assert manager.update().reason == "camera is not active, and is needed by explore"
    kb.cancel_action("explore")
    assert "no longer needed" in manager.update().reason


# what is not commanded


@in_life
@given(models(), st.data())
def test_dry_run_names_exactly_what_is_commanded(model, data):
    kb, clock = base(model)
    managed = Scripted(clock)
    manager = ConfigurationManager(kb, managed)
    actions = sorted(model.actions)
    for name in (
        data.draw(st.lists(st.sampled_from(actions), min_size=1, max_size=6)) if actions else ()
    ):
        if kb.actions[name].is_required:
            kb.cancel_action(name)
        else:
            kb.request_action(name)
        plan = manager.dry_run()
        managed.log.clear()
        manager.update()
        told = [] if plan is None else str(plan).split("; ")
        for verb in ("activate", "deactivate"):
            named = [
                one.removeprefix(f"{verb} ").split(", ")
                for one in told
                if one.startswith(f"{verb} ")
            ]
            commanded = [
                one.removeprefix(f"{verb} ") for one in managed.log if one.startswith(f"{verb} ")
            ]
            assert sorted(chain.from_iterable(named)) == sorted(commanded)
        if plan is not None:
            booked = {
                name
                for name in (*plan.activate, *plan.deactivate)
                if kb.components[name].kind == "plain"
            }
            assert set(plan.plain) == booked


# attempts and answers


def test_parameters_of_a_completed_attempt_are_in_force():
    kb, clock, _, manager = start()
    kb.request_action("explore")
    turn(manager, clock, 3)
    assert kb.components["camera"].parameters_in_force == {"exposure": 0.01}
    asked = "SELECT ?key ?value { ?p a :ParametersInForce ; :hasParameter ?v . ?v :key ?key ; :parameterValue ?value }"
    assert kb.query(asked) == [("exposure", "0.01")]


def test_a_veto_can_be_asked_for_with_its_plan():
    kb, _, _, manager = start(veto=lambda plan: "no lamps at night")
    kb.request_action("explore")
    plan = manager.update()
    (answer,) = kb.history.answers
    assert (answer.plan, answer.is_vetoed, answer.reason) == (plan, True, "no lamps at night")
    rows = kb.query(
        "SELECT ?why ?result { ?a a :VetoAnswer ; :isVetoed true ; :reason ?why ; :ofPlan ?p . ?p :result ?result }"
    )
    assert rows == [("no lamps at night", "abandoned")]


def test_a_command_to_what_left_the_model_is_abandoned():
    kb, clock, _, manager = start({"activate camera": [math.inf]})
    kb.request_action("explore")
    turn(manager, clock)
    kb.cancel_action("explore")
    for element in (
        kb.model.designs["by camera"],
        *kb.model.configurations.values(),
        kb.model.components["camera"],
    ):
        kb.model.remove(element)
    turn(manager, clock)
    last = kb.history.attempts[-1]
    assert (last.component, last.result, last.reason) == (
        "camera",
        "abandoned",
        "it is no longer in the model",
    )
    assert kb.plans[0].end is not None


# after the knowledge base was opened again


def test_quarantine_outlasts_a_restart(
    tmp_path,
):
    clock = Clock(100.0)
    kb, _, _, manager = start(
        {"configure camera": [Broken("too fast"), None]},
        kb=opened(tmp_path / "store", clock),
        hold=50.0,
    )
    kb.request_action("explore")
    turn(manager, clock, 3)
    kb.close()
    kb, _, _, manager = start(kb=opened(tmp_path / "store", clock))
    turn(manager, clock)
    assert [one.operation for one in kb.history.attempts][:3] == [
        "configure",
        "configure",
        "activate",
    ]
    assert "its parameters could not be set" in kb.explain(kb.configurations["day"]).reason
    clock.now = 149.9
    turn(manager, clock, 1, 0.1)
    assert kb.components["camera"].selected_configuration == "night"
    turn(manager, clock, 2)
    assert kb.components["camera"].selected_configuration == "day"
    kb.close()


# what stops by itself


def test_component_that_stopped_by_itself_has_failed():
    kb, clock, managed, manager = start(system=Candid)
    kb.request_action("explore")
    turn(manager, clock, 2)
    managed.running.clear()
    (plan,) = turn(manager, clock)
    assert kb.components["camera"].status is Status.FAILURE
    assert "camera is not running, though nobody has stopped it" in plan.reason
    assert managed.running == {"lidar"}


def test_what_stopped_while_nobody_was_there_is_started_again(tmp_path):
    clock = Clock(100.0)
    kb, _, _, manager = start(kb=opened(tmp_path / "store", clock), system=Candid)
    kb.request_action("explore")
    turn(manager, clock, 2)
    kb.close()
    kb, _, managed, manager = start(kb=opened(tmp_path / "store", clock), system=Candid)
    assert kb.components["camera"].is_active
    turn(manager, clock)
    assert managed.running == {"camera"}
    assert kb.actions["explore"].status is Status.SOLVED
    kb.close()


def test_late_news_that_a_component_runs_is_no_failure():
    kb, clock, _, manager = start(system=Candid)
    kb.request_action("explore")
    turn(manager, clock, 2)
    kb.cancel_action("explore")
    turn(manager, clock, 2)
    kb.component_active("camera", True)
    turn(manager, clock)
    assert not kb.components["camera"].is_active
    assert kb.components["camera"].status is Status.FEASIBLE


@in_life
@given(models(), st.data())
def test_the_facts_are_put_right_whatever_stops_by_itself(model, data):
    kb, clock = base(model)
    managed = Candid(clock)
    manager = ConfigurationManager(kb, managed)
    for name in model.actions:
        kb.request_action(name)
    come_to_rest(manager, kb, clock)
    for _ in range(3):
        if managed.running:
            managed.running -= set(data.draw(st.lists(st.sampled_from(sorted(managed.running)))))
        come_to_rest(manager, kb, clock)
        believed = {
            one.name for one in kb.components.values() if one.is_active and one.kind != "plain"
        }
        assert believed == managed.running
