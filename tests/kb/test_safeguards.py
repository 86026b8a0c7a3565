"""What is shown before it is executed may be forbidden, and what would be done can be seen without doing it."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from managed_stand_ins import Broken, Scripted, base, come_to_rest, rover, turn
from models import Twins, events, models

from kb import Choice, ConfigurationManager, KnowledgeBase, Model, Status, UnknownName
from kb.exceptions import InvalidValue


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
        one.name
        for views in (kb.designs, kb.configurations)
        for one in views.values()
        if one.is_selected
    ]


# veto


@pytest.mark.parametrize("answer", [None, True])
def test_a_plan_that_may_pass_is_executed_and_the_answer_is_on_record(answer):
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
        (
            3,
            "the veto function answered 3; it is to answer None or True to let a plan pass, else a reason",
        ),
    ],
)
def test_a_vetoed_plan_is_abandoned_and_nothing_of_it_is_done_or_selected(answer, reason):
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


def test_a_vetoed_plan_is_proposed_again_when_there_is_news_and_not_before():
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
    assert [one.is_vetoed for one in kb.history.answers] == [True, True, False]


def test_what_was_selected_before_a_vetoed_plan_is_selected_after_it():
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


def test_a_plan_that_somebody_else_made_is_asked_about_too_and_taken_back():
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


class ShineOnly:
    """A planner that leaves the rest to somebody else."""

    def plan(self, kb):
        return kb.select({"shine": "by lamp"}) if "shine" in kb.adaptable_functions() else None


def test_what_was_selected_without_a_plan_is_not_taken_back_with_another():
    model = Model("two")
    model.component("lamp")
    model.function("shine").design("by lamp", ["lamp"])
    model.component("horn", kind="process")
    model.function("warn").design("by horn", ["horn"])
    model.action("light", requires=["shine", "warn"])
    kb, clock, _, manager = start(Guard("no"), model, planner=ShineOnly())
    kb.component_active("lamp", True)
    kb.request_action("light")
    assert turn(manager, clock, 2) == []
    assert selection(kb) == ["by lamp"]
    heard = []
    kb.subscribe(lambda event: heard.append(event.text))
    plan = kb.select({"warn": "by horn"})
    turn(manager, clock, 2)
    assert plan.result == "abandoned"
    assert "by horn is not selected (vetoed: no)" in heard
    assert not any(text.startswith("by lamp is not selected") for text in heard)
    assert selection(kb) == ["by lamp"]


def test_what_stays_without_a_design_is_explained_by_the_veto_until_one_is_selected():
    model = Model("one")
    model.component("lamp", kind="process")
    model.function("shine").design("by lamp", ["lamp"])
    model.action("light", requires=["shine"])
    guard = Guard("not at night")
    kb, clock, _, manager = start(guard, model)
    kb.request_action("light")
    turn(manager, clock, 2)
    vetoed = "shine is unsolved because none of its designs is selected (vetoed: not at night)"
    assert kb.why("shine") == vetoed
    assert kb.why("light").endswith(vetoed)
    assert "for priority" in (told := str(kb.explain_choice("shine"))) or "no other design" in told
    kb.assert_selected("by lamp", True, "it is dark")
    assert kb.explain("by lamp").choice == "it is dark"
    kb.assert_selected("by lamp", False)
    assert kb.why("shine") == "shine is unsolved because none of its designs is selected"


def test_a_plan_under_way_is_asked_about_once():
    guard = Guard()
    kb, clock = base(rover())
    manager = ConfigurationManager(kb, Scripted(clock, default=5.0), veto=guard)
    kb.request_action("explore")
    come_to_rest(manager, kb, clock)
    assert len(guard.shown) == 1


def test_a_veto_that_cannot_be_called_is_refused():
    with pytest.raises(InvalidValue, match="cannot be called"):
        start("no")


def test_without_a_veto_there_are_no_answers():
    assert start()[0].history.answers == ()


# dry run


def test_a_dry_run_tells_the_plan_and_does_nothing():
    kb, _, managed, manager = start()
    assert manager.dry_run() is None
    kb.request_action("explore")
    heard = []
    kb.subscribe(heard.append)
    revision = kb.revision
    plan = manager.dry_run()
    assert (plan.activate, plan.deactivate, plan.parameters) == (("camera", "lamp"), (), ("day",))
    assert str(plan) == "activate camera; configure day; note as active: lamp"
    assert "explore" in plan.reason
    assert (plan.start, plan.end) == (100.0, None)
    assert (kb.plans, kb.pending_plan, selection(kb), managed.log, heard) == ((), None, [], [], [])
    assert kb.revision == revision


def test_a_dry_run_can_be_asked_of_any_planner_that_has_a_choice():
    class Choosy:
        def plan(self, kb):
            return kb.select(*self.choose(kb))

        def choose(self, kb):
            assert kb.required_actions[0].action == "explore"
            return Choice({"see": "by lidar"}, {}, "to spare the camera")

    kb, _, _, manager = start(planner=Choosy())
    kb.request_action("explore")
    plan = manager.dry_run()
    assert plan.activate == ("lidar",)
    assert plan.reason.endswith("to spare the camera")


def test_a_planner_without_a_choice_cannot_be_tried():
    with pytest.raises(InvalidValue, match="ShineOnly cannot be tried"):
        start(planner=ShineOnly())[3].dry_run()


@pytest.mark.parametrize(
    ("selected", "error"),
    [
        (({"see": "by radar"},), UnknownName),
        (({"sea": "by lidar"},), UnknownName),
        (({}, {"lidar": "day"}), InvalidValue),
    ],
)
def test_a_planner_is_told_in_a_dry_run_of_the_mistakes_that_it_would_make(selected, error):
    class Mistaken:
        def choose(self, kb):
            return selected

        def plan(self, kb):
            return kb.select(*selected)

    for plan in (lambda manager: manager.dry_run(), lambda manager: manager.update()):
        with pytest.raises(error):
            plan(start(planner=Mistaken())[3])


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
def test_a_dry_run_is_the_plan_that_is_made_and_leaves_everything_as_it_was(model, data):
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


@in_life
@given(models(), st.data())
def test_under_a_veto_on_everything_nothing_is_ever_commanded(model, data):
    twins = Twins(model)
    kb, managed = twins.kb, Scripted(twins.clock)
    planned = []
    manager = ConfigurationManager(kb, managed, veto=lambda plan: "no")
    for event in data.draw(
        st.lists(events(model, asserting=False, selecting=False), min_size=5, max_size=15)
    ):
        twins.happen(event)
        planned += turn(manager, twins.clock, 3)
    assert managed.log == []
    assert all(plan.result == "abandoned" for plan in planned)
    assert [one.plan for one in kb.history.answers] == list(kb.plans) == planned
    come_to_rest(manager, kb, twins.clock)


@in_life
@given(models(), st.data())
def test_a_veto_that_lets_everything_pass_changes_nothing(model, data):
    lives = []
    things = data.draw(
        st.lists(events(model, asserting=False, selecting=False), min_size=5, max_size=15)
    )
    for veto in (None, lambda plan: None):
        twins = Twins(model)
        managed = Scripted(twins.clock)
        manager = ConfigurationManager(twins.kb, managed, veto=veto)
        for event in things:
            twins.happen(event)
            manager.update()
        lives.append((managed.log, [steps(plan) for plan in twins.kb.plans], twins.statuses()))
    assert lives[0] == lives[1]


def test_a_base_that_begins_with_an_open_plan_has_it_asked_about():
    kb = KnowledgeBase(rover(), clock=lambda: 1.0)
    kb.request_action("explore")
    plan = kb.select({"see": "by camera"}, {"camera": "day"})
    manager = ConfigurationManager(kb, Scripted(None), veto=lambda plan: "no")
    manager.update()
    assert plan.result == "abandoned"
