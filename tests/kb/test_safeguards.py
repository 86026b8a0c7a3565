"""A plan may be vetoed before it is executed, and can be seen without being made."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from managed_stand_ins import Broken, Scripted, base, rover, turn
from models import Twins, events, models

from kb import ConfigurationManager, Status


def start(veto=None, model=None, **options):
    kb, clock = base(model or rover())
    managed = Scripted(clock)
    return kb, clock, managed, ConfigurationManager(kb, managed, veto=veto, **options)


class Guard:
    """Answers as told, and keeps what it was shown."""

    def __init__(self, answer=None):
        self.answer = answer
        self.shown = []

    def __call__(self, plan):
        self.shown.append((str(plan), plan.reason, plan.end))
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


def selection(kb):
    return [
        view.name
        for views in (kb.designs, kb.configurations)
        for view in views.values()
        if view.is_selected
    ]


# veto


@pytest.mark.parametrize("answer", [None, True])
def test_allowed_plan_is_executed_and_recorded(answer):
    guard = Guard(answer)
    kb, _, managed, manager = start(guard)
    kb.request_action("explore")
    plan = manager.update()
    assert plan.result == "completed"
    assert managed.running == {"camera"}
    assert guard.shown == [(str(plan), plan.reason, None)]
    assert plan.reason
    (given_answer,) = kb.history.answers
    assert (given_answer.plan, given_answer.time, given_answer.is_vetoed) == (plan, 100.0, False)


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        ("too near to the quay", "too near to the quay"),
        (False, "no reason was given"),
        ("", "no reason was given"),
        (Broken("guard is broken"), "guard is broken"),
        (Broken(), "Broken"),
    ],
)
def test_vetoed_plan_is_abandoned_and_taken_back(answer, reason):
    guard = Guard(answer)
    kb, clock, managed, manager = start(guard)
    kb.request_action("explore")
    (plan,) = turn(manager, clock, 10)
    assert plan.result == "abandoned"
    assert managed.log == []
    assert kb.history.attempts == ()
    assert selection(kb) == []
    assert kb.functions["see"].status is Status.UNSOLVED
    (given_answer,) = kb.history.answers
    assert (given_answer.is_vetoed, given_answer.reason) == (True, reason)


def test_vetoed_plan_is_proposed_again_after_news_only():
    guard = Guard("not now")
    kb, clock, managed, manager = start(guard)
    kb.request_action("explore")
    turn(manager, clock, 10)
    kb.measure("light", 0.8)
    kb.measure("light", 0.7)
    assert len(turn(manager, clock, 10)) == 1  # the first measurement ever changes a status
    kb.measure("light", 0.6)
    assert turn(manager, clock, 10) == []
    guard.answer = None
    kb.measure("light", 0.1)
    turn(manager, clock, 10)
    assert managed.running == {"camera"}
    assert [answer.is_vetoed for answer in kb.history.answers] == [True, True, False]


def test_veto_restores_the_earlier_selection():
    guard = Guard()
    kb, clock, managed, manager = start(guard)
    kb.request_action("explore")
    turn(manager, clock, 3)
    before = selection(kb)
    guard.answer = "leave it"
    kb.measure("light", 0.1)
    (plan,) = turn(manager, clock, 5)
    assert plan.parameters == ("night",)
    assert selection(kb) == before == ["by camera", "day"]
    assert kb.components["camera"].status is Status.CONFIGURATION_ERROR
    assert managed.parameters == {"camera": {"exposure": 0.01}}
    kb.cancel_action("explore")
    (plan,) = turn(manager, clock, 5)
    assert plan.result == "abandoned"
    assert managed.running == {"camera"}
    assert kb.components["camera"].is_active
    assert selection(kb) == before


def test_plan_of_somebody_else_can_be_vetoed():
    guard = Guard()
    kb, clock, managed, manager = start(guard)
    kb.request_action("explore")
    turn(manager, clock, 3)
    guard.answer = "leave it"
    plan = kb.select({"see": "by lidar"})
    turn(manager, clock, 5)
    assert plan.result == "abandoned"
    assert managed.running == {"camera"}
    assert selection(kb) == ["by camera", "day"]
    assert kb.actions["explore"].status is Status.SOLVED


# dry run


# laws

in_life = settings(
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large], max_examples=80
)


def steps(plan):
    return (
        None
        if plan is None
        else (plan.activate, plan.deactivate, plan.parameters, plan.reason, plan.start)
    )


@in_life
@given(models(), st.data())
def test_dry_run_is_the_plan_and_changes_nothing(model, data):
    twins = Twins(model)
    manager = ConfigurationManager(twins.kb, Scripted(twins.clock))
    for event in data.draw(st.lists(events(model, selecting=False), min_size=5, max_size=15)):
        twins.happen(event)
        before = (twins.statuses(), selection(twins.kb), len(twins.kb.plans), twins.kb.revision)
        foreseen = manager.dry_run()
        assert steps(manager.dry_run()) == steps(foreseen)
        assert (
            twins.statuses(),
            selection(twins.kb),
            len(twins.kb.plans),
            twins.kb.revision,
        ) == before
        made = manager.update()
        if made is not None:
            assert steps(foreseen) == steps(made)
