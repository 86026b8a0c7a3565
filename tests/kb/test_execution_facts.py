"""What execution leaves in the knowledge base: attempts, answers, reasons and holds, also after it is opened again."""

import math
from itertools import chain

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from managed_stand_ins import Broken, Candid, Scripted, base, come_to_rest, rover, turn
from models import Clock, models

from kb import ConfigurationManager, KnowledgeBase, Model, StagedExecutor, Status, UnknownName

in_life = settings(
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large], max_examples=60
)


def start(script=None, *, kb=None, system=Scripted, veto=None, **options):
    kb = kb or base(rover())[0]
    managed = system(kb._knowledge.clock, script)
    executor = StagedExecutor(managed, **{"attempts": 1, **options})
    return (
        kb,
        kb._knowledge.clock,
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


def test_a_configuration_that_was_ruled_out_says_why_and_until_when():
    kb, clock, _, manager = start({"configure camera": [Broken("too fast"), None]}, hold=50.0)
    kb.request_action("explore")
    come_to_rest(manager, kb, clock)
    explained = kb.explain(kb.configurations["day"])
    assert explained.reason == "its parameters could not be set, tried once: too fast"
    assert "until 150 s" in str(explained)


def test_a_hold_ends_by_the_clock_though_no_turn_is_taken():
    kb, clock, _, manager = start({"configure camera": [Broken("too fast"), None]}, hold=50.0)
    kb.request_action("explore")
    turn(manager, clock, 3)
    clock.now = 149.9
    assert kb.configurations["day"].status is Status.UNFEASIBLE
    clock.now = 150.0
    assert kb.configurations["day"].status is Status.FEASIBLE


@given(st.sampled_from((0.0, 1e-300, 1e-9)))
def test_a_hold_that_is_over_at_once_holds_nothing(hold):
    kb, clock, _, manager = start({"configure camera": [Broken("too fast"), None]}, hold=hold)
    kb.request_action("explore")
    turn(manager, clock, 5)
    assert kb.components["camera"].selected_configuration == "day"
    assert kb.components["camera"].status is Status.SOLVED


def test_a_plan_that_starts_again_what_is_not_active_says_so_and_leaves_the_reasons_of_choices_alone():
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


def test_a_plan_for_many_actions_names_a_few():
    model = rover()
    for number in range(9):
        model.action(f"explore {number}", requires=["see"])
    kb, clock, _, manager = start(kb=KnowledgeBase(model, clock=Clock(0.0)))
    for number in range(9):
        kb.request_action(f"explore {number}")
    turn(manager, clock)
    kb.component_active("camera", False)
    named = ", ".join(f"explore {number}" for number in range(4))
    assert manager.update().reason == f"camera is not active, and is needed by {named}, others"


# what is not commanded


@in_life
@given(models(), st.data())
def test_a_dry_run_tells_to_activate_and_deactivate_exactly_what_is_commanded(model, data):
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
            assert plan.plain == booked


def test_what_is_only_noted_is_told_apart_also_after_the_knowledge_base_is_opened_again(tmp_path):
    clock = Clock(100.0)
    kb, _, _, manager = start(kb=opened(tmp_path / "store", clock))
    kb.request_action("explore")
    foreseen = str(manager.dry_run())
    assert foreseen == "activate camera; configure day; note as active: lamp"
    assert str(manager.update()) == foreseen
    kb.cancel_action("explore")
    assert str(manager.dry_run()) == "deactivate camera; note as inactive: lamp"
    kb.close()
    kb = opened(tmp_path / "store", clock)
    assert [str(plan) for plan in kb.plans] == [foreseen]
    kb.close()


# attempts and answers


def test_attempts_can_be_asked_for_with_their_plans():
    kb, clock, _, manager = start({"activate camera": [Broken("no light")]})
    kb.request_action("explore")
    come_to_rest(manager, kb, clock)
    rows = kb.query("""
        SELECT ?component ?result ?reason ?planned {
            ?attempt a :Attempt ; :operation "activate" ; :about ?c ; :result ?result ; :ofPlan ?plan .
            ?c :name ?component . ?plan :result ?planned .
            OPTIONAL { ?attempt :reason ?reason } }
    """)
    assert sorted(rows) == [
        ("camera", "failed", "no light", "failed"),
        ("lidar", "completed", None, "completed"),
    ]


def test_parameters_of_an_attempt_that_succeeded_are_in_force_and_can_be_asked_for():
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


def test_parameters_of_a_configuration_that_left_the_model_are_not_tried_again():
    kb, clock, _, manager = start(
        {"configure camera": [Broken("busy"), None]}, attempts=9, back_off=5.0
    )
    kb.request_action("explore")
    turn(manager, clock)
    kb.model.remove(kb.model.configurations["day"])
    come_to_rest(manager, kb, clock)
    assert [one.configuration for one in kb.history.attempts].count("day") == 1


# after the knowledge base was opened again


def test_what_was_ruled_out_stays_so_until_its_time_after_the_knowledge_base_is_opened_again(
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


def test_a_hold_that_ended_while_nobody_was_there_is_over(tmp_path):
    clock = Clock(100.0)
    kb, _, _, manager = start(
        {"configure camera": [Broken("too fast"), None]},
        kb=opened(tmp_path / "store", clock),
        hold=50.0,
    )
    kb.request_action("explore")
    turn(manager, clock, 3)
    kb.close()
    clock.now = 1000.0
    kb, _, _, manager = start(kb=opened(tmp_path / "store", clock))
    assert kb.configurations["day"].status is Status.FEASIBLE
    turn(manager, clock, 3)
    assert kb.components["camera"].selected_configuration == "day"
    kb.close()


def test_a_recovery_forgives_what_was_ruled_out_before_the_knowledge_base_was_opened_again(
    tmp_path,
):
    clock = Clock(100.0)
    kb, _, _, manager = start(
        {"configure camera": [Broken("too fast"), None]},
        kb=opened(tmp_path / "store", clock),
        hold=math.inf,
    )
    kb.request_action("explore")
    turn(manager, clock, 3)
    kb.component_failed("camera")
    kb.close()
    kb, _, _, manager = start(kb=opened(tmp_path / "store", clock))
    turn(manager, clock)
    assert kb.configurations["day"].status is Status.UNFEASIBLE
    kb.component_recovered("camera")
    turn(manager, clock)
    assert kb.configurations["day"].status is Status.FEASIBLE
    kb.close()


# what stops by itself


def test_what_stopped_by_itself_has_failed_and_the_next_best_takes_over():
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


def test_late_news_that_something_runs_is_put_right_and_no_failure():
    kb, clock, _, manager = start(system=Candid)
    kb.request_action("explore")
    turn(manager, clock, 2)
    kb.cancel_action("explore")
    turn(manager, clock, 2)
    kb.component_active("camera", True)
    turn(manager, clock)
    assert not kb.components["camera"].is_active
    assert kb.components["camera"].status is Status.FEASIBLE


@pytest.mark.parametrize("answer", [None, Broken("no idea"), "stranger"])
def test_what_nobody_can_tell_is_believed(answer):
    class Vague(Scripted):
        is_active_now = True

        def is_active(self, component):
            if self.is_active_now:
                return True
            if answer == "stranger":
                raise UnknownName("component", component, [])
            if isinstance(answer, Exception):
                raise answer
            return answer

    kb, clock, managed, manager = start(system=Vague)
    kb.request_action("explore")
    turn(manager, clock, 2)
    managed.is_active_now = False
    turn(manager, clock, 3)
    assert kb.actions["explore"].status is Status.SOLVED


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


def test_a_model_without_anything_to_watch_is_no_trouble():
    model = Model("empty")
    kb = KnowledgeBase(model, clock=Clock(0.0))
    assert ConfigurationManager(kb, Candid(Clock(0.0))).update() is None
