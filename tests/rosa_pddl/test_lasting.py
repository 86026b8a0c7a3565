"""Steps whose actions have to stay feasible for as long as they take, as far as is known."""

import pytest
from py_trees.behaviour import Behaviour
from py_trees.common import Status

from kb import KnowledgeBase, Model
from rosa_pddl import LastingFeasibility, PlanExecutor, Planner, load_domain

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
        self.now, self.log, self.takes, self.drain = 0.0, [], {"inspect": 20.0, "charge": 5.0}, drain
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
            doing = [one.action for one in self.kb.required_actions]
            change = self.drain * ("inspect" in doing) + 0.06 * ("charge" in doing)
            self.kb.measure("energy", min(1.0, max(0.0, self.kb.attributes["energy"].value + change)))
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
        return Status.SUCCESS if self.diver.now - self.began >= self.diver.takes[self.name] else Status.RUNNING

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
    assert careful.run(60) == ["charge begun", "charge completed", "inspect begun", "inspect completed"]
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


def test_what_was_too_short_has_to_last_a_tenth_longer(diver):
    one = diver(0.449)
    lasting = LastingFeasibility(one.kb, one.executor._domain)
    assert not lasting.is_feasible("inspect")
    assert lasting.why("inspect").startswith(
        "inspect takes 20 s and is unfeasible in 19.9 s (how exactly is not known): energy falls"
    )
    for energy, is_enough in ((0.46, False), (0.475, True), (0.46, True)):
        one.now += 1.0
        one.kb.measure("energy", energy)
        assert lasting.is_feasible("inspect") is is_enough
    assert lasting.is_feasible("charge")
    assert lasting.log is one.kb.log
