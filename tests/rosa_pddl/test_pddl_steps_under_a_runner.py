"""Steps of a plan are behaviours of the tree: a `TreeRunner` guards, times and sets them up."""

import py_trees
import pytest
from py_trees.behaviour import Behaviour
from py_trees.common import Status

import rosa_bt
from kb import KnowledgeBase, Model
from rosa_bt import TreeRunner
from rosa_pddl import PlanExecutor, parse_domain

DOMAIN = """(define (domain d) (:requirements :strips :typing) (:types action tag)
  (:predicates (action_feasible ?a - action) (scan_action ?a - action) (done ?t - tag))
  (:action scan :parameters (?a - action ?t - tag)
    :precondition (and (scan_action ?a) (action_feasible ?a)) :effect (done ?t)))"""
PROBLEM = """(define (problem p) (:domain d) (:objects scan - action t - tag)
  (:init (scan_action scan)) (:goal (done t)))"""


class Mission:
    def __init__(self, make, **options):
        model = Model("rover")
        model.action("scan")
        self.now = 0.0
        self.kb = KnowledgeBase(model, clock=lambda: self.now)
        self.executor = PlanExecutor(
            "plan",
            kb=self.kb,
            domain=parse_domain(DOMAIN, PROBLEM),
            behaviours={"scan": make},
            sense=dict,
            clock=lambda: self.kb.now,
        )
        self.runner = TreeRunner(self.executor, clock=lambda: self.now, **options)
        self.runner.setup(wheels=4)

    def run(self, until_s):
        """Tick each 0.1 s until the executor ends, or a time is reached."""
        while self.now < until_s and self.executor.status in (Status.INVALID, Status.RUNNING):
            self.executor.catch_up()
            self.runner.tick()
            self.now = round(self.now + 0.1, 6)
        return self.executor.status


class Scan(Behaviour):
    def __init__(self, raises_in="", ends=Status.SUCCESS):
        super().__init__("scan")
        self.raises_in = raises_in
        self.ends = ends
        self.calls = []

    def note(self, hook):
        self.calls.append(hook)
        if hook == self.raises_in:
            raise KeyError("no lens")

    def setup(self, wheels):
        self.note(f"setup {wheels}")

    def update(self):
        self.note("update")
        return self.ends

    def terminate(self, new_status):
        self.note("terminate")

    def shutdown(self):
        self.note("shutdown")


@pytest.mark.parametrize("hook", ["update", "terminate"])
def test_exception_in_the_first_tick_of_a_step_is_logged(hook, caplog):
    mission = Mission(lambda step: Scan(hook))
    mission.run(1.0)
    assert [record.exc_info[0] for record in caplog.records] == [KeyError]
    assert "Scan 'scan': KeyError: 'no lens'" in caplog.text


@pytest.mark.parametrize("hook", ["update", "terminate"])
def test_exception_in_the_first_tick_of_a_step_is_let_out(hook):
    mission = Mission(lambda step: Scan(hook), on_error="raise")
    with pytest.raises(KeyError, match="no lens"):
        mission.run(1.0)


def test_step_is_set_up_and_shut_down_once():
    scan = Scan()
    mission = Mission(lambda step: scan)
    assert mission.run(5.0) is Status.SUCCESS
    mission.runner.shutdown()
    assert scan.calls == ["setup 4", "update", "terminate", "shutdown"]


@pytest.mark.parametrize(
    "make",
    [
        lambda step: py_trees.timers.Timer("timer", 3.0),
        lambda step: rosa_bt.Timer("timer", 3.0),
        lambda step: rosa_bt.Delay("delay", Scan(), 3.0),
    ],
)
def test_step_counts_by_the_clock_of_the_runner(make):
    mission = Mission(make)
    assert mission.run(10.0) is Status.SUCCESS
    assert 3.0 <= mission.now <= 3.6


def test_step_goes_on_when_the_clock_is_set_back(caplog):
    mission = Mission(
        lambda step: rosa_bt.ForAction("a", mission.kb, "scan", rosa_bt.Timer("t", 3))
    )
    mission.now = 100.0
    mission.run(102.0)
    mission.now = 1.0
    assert mission.run(10.0) is Status.SUCCESS
    assert 2.0 <= mission.now <= 3.0
    assert "was set back from 101.9 s to 1 s" in caplog.text
