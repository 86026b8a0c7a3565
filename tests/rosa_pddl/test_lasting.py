"""Steps whose actions have to stay feasible for as long as they take, as far as is known."""

import pytest
from py_trees.behaviour import Behaviour
from py_trees.behaviours import Success
from py_trees.common import Status

from kb import KnowledgeBase, Model
from rosa_pddl import (
    LastingFeasibility,
    PlanExecutor,
    Planner,
    load_domain,
    parse_domain,
)

DOMAIN = """
(define (domain diver)
  (:requirements :strips :typing :durative-actions)
  (:types action)
  (:predicates (action_feasible ?a - action) (inspected) (is_inspect ?a - action) (is_charge ?a - action))
  (:durative-action inspect :parameters (?a - action) :duration (= ?duration 20)
    :condition (and (over all (is_inspect ?a)) (over all (action_feasible ?a)))
    :effect (and (at end (inspected))))
  (:durative-action charge :parameters (?a ?b - action) :duration (= ?duration 5)
    :condition (and (over all (is_charge ?a)) (over all (action_feasible ?a)) (at start (is_inspect ?b)))
    :effect (and (at end (action_feasible ?b)))))
"""
PROBLEM = """
(define (problem one) (:domain diver) (:objects inspect charge - action)
  (:init (is_inspect inspect) (is_charge charge)) (:goal (inspected)))
"""


class Diver:
    """A robot whose battery does as its model says; a step ends when its time is over."""

    def __init__(self, folder, energy, *, lasting=True, drain=-0.01):
        self.now = 0.0
        self.log = []
        self.takes = {"inspect": 20.0, "charge": 5.0}
        self.drain = drain
        model = Model("diver")
        level = model.quality_attribute("energy", low=0.0, high=1.0)
        model.action("inspect", constraints=[level >= 0.25])
        model.action("charge")
        level.changes(-0.01, while_="inspect")
        self.kb = KnowledgeBase(model, clock=lambda: self.now)
        self.kb.measure("energy", energy)
        (folder / "domain.pddl").write_text(DOMAIN)
        (folder / "problem.pddl").write_text(PROBLEM)
        domain = load_domain(folder / "domain.pddl", folder / "problem.pddl")
        self.planner = Planner()
        self.executor = PlanExecutor(
            "dive",
            kb=LastingFeasibility(self.kb, domain) if lasting else self.kb,
            domain=domain,
            behaviours=dict.fromkeys(("inspect", "charge"), lambda step: Doing(step.schema, self)),
            sense=dict,
            clock=lambda: self.now,
            planner=self.planner,
        )
        self.executor.setup()

    def run(self, seconds):
        for _ in range(seconds):
            self.now += 1.0
            doing = [action.action for action in self.kb.required_actions]
            change = self.drain * ("inspect" in doing) + 0.06 * ("charge" in doing)
            self.kb.measure(
                "energy", min(1.0, max(0.0, self.kb.attributes["energy"].value + change))
            )
            self.executor.catch_up()
            self.executor.tick_once()
            if self.executor.status is Status.SUCCESS:
                break
        return self.log


class Doing(Behaviour):
    def __init__(self, action, diver):
        super().__init__(action)
        self.diver = diver

    def initialise(self):
        self.began = self.diver.now
        self.diver.kb.request_action(self.name)
        self.diver.log.append(f"{self.name} begun")

    def update(self):
        return (
            Status.SUCCESS
            if self.diver.now - self.began >= self.diver.takes[self.name]
            else Status.RUNNING
        )

    def terminate(self, new_status):
        result = "completed" if new_status is Status.SUCCESS else "abandoned"
        self.diver.kb.cancel_action(self.name, result)
        self.diver.log.append(f"{self.name} {result}")


@pytest.fixture
def diver(tmp_path):
    made = []

    def make(*given, **named):
        made.append(Diver(tmp_path, *given, **named))
        return made[-1]

    yield make
    for one in made:
        one.executor.shutdown()
        one.planner.close()


def test_step_that_could_not_be_finished_is_not_begun(diver):
    assert diver(0.4, lasting=False).run(60)[:2] == ["inspect begun", "inspect abandoned"]
    careful = diver(0.4)
    assert careful.run(60) == [
        "charge begun",
        "charge completed",
        "inspect begun",
        "inspect completed",
    ]
    assert careful.executor.status is Status.SUCCESS


def test_step_that_can_be_finished_is_done_to_its_end_and_no_longer_looked_at_than_that(diver):
    assert diver(0.5).run(60) == ["inspect begun", "inspect completed"]


def test_running_step_is_given_up_when_the_forecast_changes_the_answer(diver):
    one = diver(0.5, drain=0.0)
    one.run(5)
    assert one.log == ["inspect begun"]
    one.kb.model.attributes["energy"].changes(-0.05, while_="inspect")
    one.run(3)
    assert one.log[:3] == ["inspect begun", "inspect abandoned", "charge begun"]
    assert one.kb.is_feasible("inspect")


SURVEY = """
(define (domain survey)
  (:requirements :strips :typing :durative-actions)
  (:types action)
  (:predicates (action_feasible ?a - action) (there) (surveyed) (waved)
    (sail_action ?a - action) (look_action ?a - action) (probe_action ?a - action))
  (:functions (total-cost))
  (:durative-action sail :parameters (?a - action) :duration (= ?duration 30)
    :condition (and (over all (sail_action ?a)) (over all (action_feasible ?a)))
    :effect (and (at end (there)) (at end (increase (total-cost) 1))))
  (:durative-action look :parameters (?a - action) :duration (= ?duration 20)
    :condition (and (over all (look_action ?a)) (over all (action_feasible ?a)) (at start (there)))
    :effect (and (at end (surveyed)) (at end (increase (total-cost) 1))))
  (:durative-action probe :parameters (?a - action) :duration (= ?duration 60)
    :condition (and (over all (probe_action ?a)) (over all (action_feasible ?a)))
    :effect (and (at end (surveyed)) (at end (increase (total-cost) 5))))
  (:action wave :parameters () :effect (waved)))
"""
BY_DAY = """
(define (problem one) (:domain survey) (:objects sail look probe - action)
  (:init (sail_action sail) (look_action look) (probe_action probe) (= (total-cost) 0))
  (:goal (surveyed)) (:metric minimize (total-cost)))
"""
TAKES = {"sail": 30.0, "look": 20.0, "probe": 60.0, "wave": 0.0}


def boat(clock):
    model = Model("boat")
    light = model.environmental_attribute("light", low=0.0, high=1.0)
    tide = model.environmental_attribute("tide")
    light.changes(-0.01)
    model.action("sail")
    model.action("look", constraints=[light >= 0.25])
    model.action("probe", constraints=[tide >= 1.0])
    return KnowledgeBase(model, clock=clock)


class Boat:
    """Surveys by daylight, which goes, once it is there, or else probes at once, which is dear."""

    def __init__(self, light, *, lasting=True, tide=1.0, sensed=()):
        self.now = 0.0
        self.log = []
        self.takes = TAKES
        self.light = light
        self.kb = boat(lambda: self.now)
        self.kb.measure("tide", tide)
        self.kb.measure("light", light)
        self.domain = parse_domain(SURVEY, BY_DAY)
        self.lasting = LastingFeasibility(self.kb, self.domain)
        self.planner = Planner()
        self.executor = PlanExecutor(
            "survey",
            kb=self.lasting if lasting else self.kb,
            domain=self.domain,
            behaviours=dict.fromkeys(
                TAKES, lambda step: Doing(step.schema, self) if step.action else Success("wave")
            ),
            sense=lambda: dict.fromkeys(sensed, True),
            clock=lambda: self.now,
            planner=self.planner,
        )
        self.executor.setup()

    def run(self, seconds, *errors):
        """Tick once a second, with light that is measured with errors."""
        for second in range(seconds):
            self.now += 1.0
            self.light -= 0.01
            self.kb.measure(
                "light", max(0.0, self.light + (errors[second % len(errors)] if errors else 0.0))
            )
            self.executor.catch_up()
            self.executor.tick_once()
            if self.executor.status is not Status.RUNNING:
                break
        return self.log

    @property
    def reasons(self):
        return [plan.reason for plan in self.executor.plans]


@pytest.fixture
def sailing():
    made = []

    def make(*given, **named):
        made.append(Boat(*given, **named))
        return made[-1]

    yield make
    for one in made:
        one.executor.shutdown()
        one.planner.close()


def done(*names):
    return [f"{name} {what}" for name in names for what in ("begun", "completed")]


def test_route_whose_second_step_would_come_too_late_is_not_taken(sailing):
    unaware = sailing(0.65, lasting=False)
    assert unaware.run(200) == [*done("sail"), "look begun", "look abandoned", *done("probe")]
    aware = sailing(0.65)
    assert aware.run(200) == done("probe")
    assert aware.now < unaware.now - 30.0
    assert sailing(0.95).run(200) == done("sail", "look")


@pytest.mark.parametrize(("light", "expected"), [(0.83, ("sail", "look")), (0.78, ("probe",))])
def test_forecast_that_wavers_changes_no_plan(sailing, light, expected):
    one = sailing(light)
    assert one.run(200, 0.0, 0.03, -0.03, 0.01) == done(*expected)
    assert one.reasons == ["start"]


def test_plan_that_cannot_be_kept_any_more_is_replaced_and_the_reason_is_the_forecast(sailing):
    one = sailing(0.85)
    one.run(10)
    one.light -= 0.1
    assert one.run(200) == ["sail begun", "sail abandoned", *done("probe")]
    start, reason = one.reasons
    assert start == "start"
    assert reason.startswith(
        "look(look) would end in 41 s, too late by 2 s, as look is unfeasible in 39 s ("
    )
    assert reason.endswith("): light falls by 0.01/s and reaches 0.25")


def test_of_a_running_step_only_what_is_left_of_it_counts(sailing):
    one = sailing(0.85)
    one.run(45)
    assert one.log[-1] == "look begun"
    one.executor.goals.add("(waved)")
    one.run(2)
    assert one.reasons == [
        "start",
        "the goals changed: the rest of the plan does not reach (waved)",
    ]
    assert {step.schema for step in one.executor.plans[1].steps} == {"look", "wave"}
    assert one.run(100) == done("sail", "look")


def test_no_plan_says_that_it_is_for_what_is_forecast_and_is_looked_for_again_once_that_lasts_a_tenth_longer(
    sailing,
):
    one = sailing(0.66, tide=0.0)
    one.run(5)
    assert one.executor.status is Status.FAILURE
    assert one.executor.feedback_message.endswith(
        "there would be a plan without what is forecast to hold no longer: (action_feasible look) for 36.4 s"
    )
    asked = len(one.reasons)
    one.light += 0.03
    one.run(1)
    assert (one.executor.status, len(one.reasons)) == (Status.FAILURE, asked)
    one.light += 0.3
    assert one.run(100) == done("sail", "look")


def test_same_events_give_the_same_times_to_plan_with(sailing):
    one = sailing(0.85)
    known = []
    last = 0
    for second in range(60):
        one.run(1, 0.02 * (second % 3))
        known.append((one.now, one.kb.log.last, one.lasting.forecasts()))
    now = 0.0
    kb = boat(lambda: now)
    lasting = LastingFeasibility(kb, one.domain)
    events = list(one.kb.log.since(0))
    for then, number, forecasts in known:
        for event in events[last:number]:
            now = event.time
            kb.replay(event)
        now = then
        last = number
        assert lasting.forecasts() == forecasts
    assert any(
        forecast.at is not None for *_, forecasts in known for forecast in forecasts.values()
    )
