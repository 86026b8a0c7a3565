"""What the robot keeps between a step that was given up and the next one: what an action requires all along."""

from itertools import groupby

import pytest
from pddl_world import World, load_text
from py_trees.behaviour import Behaviour
from py_trees.common import ParallelPolicy, Status
from py_trees.composites import Parallel

from kb import ConfigurationManager, KnowledgeBase, Model
from rosa_bt import RosaAction
from rosa_pddl import ReplanningPolicy

DOMAIN = """(define (domain trip) (:requirements :typing :durative-actions)
  (:types action place)
  (:predicates (action_feasible ?a - action) (drive_action ?a - action) (at ?p - place))
  (:durative-action drive
    :parameters (?a - action ?from ?to - place)
    :duration (= ?duration 3)
    :condition (and (over all (action_feasible ?a)) (over all (drive_action ?a)) (at start (at ?from)))
    :effect (and (at start (not (at ?from))) (at end (at ?to)))))
"""
PROBLEM = """(define (problem p) (:domain trip) (:objects drive - action home goal - place)
  (:init (drive_action drive) (at home)) (:goal (at goal)))
"""


class Robot:
    """Notes what is switched."""

    def __init__(self):
        self.log = []

    def activate(self, component):
        self.log.append(f"start {component}")

    def deactivate(self, component):
        self.log.append(f"stop {component}")

    def set_parameters(self, component, parameters):
        pass


class Stay(RosaAction):
    def update(self):
        return Status.RUNNING


class Drive(RosaAction):
    """Fails once, later on succeeds."""

    fails = 1

    def initialise(self):
        self.left = 3

    def update(self):
        self.left -= 1
        if self.left:
            return Status.RUNNING
        Drive.fails -= 1
        return Status.FAILURE if Drive.fails >= 0 else Status.SUCCESS


DRIVING = "drive(drive, home, goal)"


def drive(step, world):
    return Drive(str(step), world.kb, "drive")


@pytest.fixture
def domain(tmp_path):
    return load_text(tmp_path, DOMAIN, PROBLEM)


def known(world):
    model = Model("car")
    motor, localization = (model.component(name, kind="lifecycle") for name in ("motor", "localization"))
    move, locate = model.function("move"), model.function("locate")
    move.design("by_motor", [motor, localization])
    locate.design("by_map", [localization])
    model.action("drive", requires=[move])
    model.action("stay_located", requires=[locate])
    return KnowledgeBase(model, clock=lambda: world.now_s)


def trip(domain, *, is_located=False, **settings):
    """Run the mission; returns what was switched until the goal was reached."""
    Drive.fails = 1
    world = World(domain, kb=known, task=drive, **settings)
    robot = Robot()
    manager = ConfigurationManager(world.kb, robot)
    if is_located:
        stay = Stay("stay located", world.kb, "stay_located")
        policy = ParallelPolicy.SuccessOnSelected([world.executor])
        world.root = Parallel("trip", policy, children=[stay, world.executor])
    for _ in range(40):
        status = world.tick()
        if status is not Status.RUNNING:
            break
        manager.update()
    assert status is Status.SUCCESS
    assert [record.reason for record in world.executor.plans] == ["start", "drive(drive, home, goal) failed"]
    return robot.log


def test_what_only_a_step_required_stops_when_it_is_given_up(domain):
    assert sorted(trip(domain)) == [
        *["start localization"] * 2,
        *["start motor"] * 2,
        "stop localization",
        "stop motor",
    ]


def test_what_an_action_beside_the_executor_requires_goes_on(domain):
    assert trip(domain, is_located=True) == ["start localization", "start motor", "stop motor", "start motor"]


@pytest.mark.parametrize("while_planning", ["continue", "hold"])
def test_what_is_done_meanwhile_keeps_what_the_step_required(domain, while_planning):
    kbs = []

    def keep(step):
        return Stay("keep ready", kbs[0], step.action)

    def remembered(world):
        kbs.append(known(world))
        return kbs[0]

    policy = ReplanningPolicy(while_planning=while_planning)
    Drive.fails = 1
    world = World(domain, kb=remembered, task=drive, meanwhile=keep, policy=policy)
    robot = Robot()
    manager = ConfigurationManager(world.kb, robot)
    seen = []
    while world.tick() is Status.RUNNING:
        manager.update()
        seen.append([child.name for child in world.executor.children])
        assert len(world.kb.required_actions) == (len(seen) > 2)
    assert sorted(robot.log) == ["start localization", "start motor"]
    assert [names for names, _ in groupby(seen)] == [[], [DRIVING], ["keep ready"], [DRIVING]]
    assert (world.kb.required_actions, world.executor.children) == ((), [])


class Idle(Behaviour):
    """Notes its life; ends when it is told to."""

    def __init__(self, step, log, ends=False):
        super().__init__(f"idle after {step}")
        self.log, self.ends = log, ends

    def update(self):
        self.log.append("ticked")
        return Status.SUCCESS if self.ends else Status.RUNNING

    def terminate(self, new_status):
        self.log.append(new_status.value)


def test_what_is_done_meanwhile_begins_when_a_step_is_over_and_is_let_go_of_when_the_next_has_begun(domain):
    world = World(domain, meanwhile=lambda step: Idle(step, world.log))
    world.events = {"drive": Status.FAILURE}
    assert world.run() is Status.SUCCESS
    told = [entry if isinstance(entry, str) else entry[2] for entry in world.log]
    assert told == ["begins", "FAILURE", "ticked", "ticked", "begins", "INVALID", "SUCCESS"]


def test_what_has_ended_meanwhile_is_not_done_again(domain):
    log = []
    world = World(domain, meanwhile=lambda step: Idle(step, log, ends=True))
    world.events = {"drive": Status.FAILURE}
    assert world.run() is Status.SUCCESS
    assert log == ["ticked", "SUCCESS"]


@pytest.mark.parametrize("how", ["no plan", "interrupted", "shut down"])
def test_what_is_done_meanwhile_is_let_go_of_however_the_planning_ends(domain, how):
    log = []
    world = World(domain, meanwhile=lambda step: Idle(step, log))
    world.run(until="drive")
    world.kb.unfeasible = {"drive"}
    world.tick()
    assert log == ["ticked"]
    if how == "no plan":
        assert world.run() is Status.FAILURE
    elif how == "interrupted":
        world.executor.stop(Status.INVALID)
    else:
        world.executor.shutdown()
    assert log[-1] == "INVALID"
    assert log.count("INVALID") == 1
    assert world.executor.children == []
