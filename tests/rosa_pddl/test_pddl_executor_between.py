"""What the robot keeps between a step that was given up and the next one: what an action requires all along."""

import pytest
from pddl_world import Task, World, load_text
from py_trees.common import ParallelPolicy, Status
from py_trees.composites import Parallel

from kb import ConfigurationManager, KnowledgeBase, Model
from rosa_bt import ForAction, RosaAction
from rosa_pddl import PddlError, ReplanningPolicy, parse_domain

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
    motor, localization = (
        model.component(name, kind="lifecycle") for name in ("motor", "localization")
    )
    move = model.function("move")
    locate = model.function("locate")
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
    assert [record.reason for record in world.executor.plans] == [
        "start",
        "drive(drive, home, goal) failed",
    ]
    return robot.log


def test_what_only_a_step_required_stops_when_it_is_given_up(domain):
    assert sorted(trip(domain)) == [
        *["start localization"] * 2,
        *["start motor"] * 2,
        "stop localization",
        "stop motor",
    ]


def test_what_an_action_beside_the_executor_requires_goes_on(domain):
    assert trip(domain, is_located=True) == [
        "start localization",
        "start motor",
        "stop motor",
        "start motor",
    ]


@pytest.mark.parametrize("keep_required", [True, False])
def test_action_of_a_step_stays_required_until_the_next_step(extended, keep_required):
    model = Model("small")
    for name in extended.rosa_actions:
        model.action(name)
    kb = KnowledgeBase(model, clock=lambda: 0.0)
    policy = ReplanningPolicy(keep_required=keep_required)
    world = World(extended, kb=lambda _: kb, policy=policy)
    world.run(until="search_pipeline")
    world.executor.goals.add("(recharged bluerov)")
    required = set[str]()
    for _ in range(20):
        world.tick()
        required.update(name for name, view in kb.actions.items() if view.is_required)
    assert required == ({"search_pipeline"} if keep_required else set())
    assert not any(view.is_required for view in kb.actions.values())


def asks(step, world):
    return ForAction(str(step), world.kb, step.action, Task(step, world))


@pytest.mark.parametrize("task", [Task, asks])
@pytest.mark.parametrize("ticks", [4, 8, 60])
def test_what_the_executor_requires_between_steps_it_cancels_however_it_ends(domain, task, ticks):
    world = World(domain, kb=known, task=task)
    world.run(until="drive")
    world.executor.add_object("dock", "place")
    world.executor.goals.replace("(at dock)")
    required = [[]]
    for _ in range(ticks):
        if world.tick() is not Status.RUNNING:
            break
        doing = [step.arguments[2] for step in world.executor.current_steps]
        required.append(doing + [action.action for action in world.kb.required_actions])
    assert ["drive"] in required  # between the steps
    assert (["dock"] in required) == (task is Task and ticks > 4)
    world.executor.shutdown()
    assert not world.kb.required_actions


def test_no_tick_is_lost_to_a_rounding_error(domain):
    world = World(domain)
    world.tick_number = 1  # 0.1 + 0.2 is a little more than 0.3
    world.tick()
    world.tick()
    world.executor.goals.replace("(at home)", "(at goal)")
    world.tick()
    assert world.executor.feedback_message == "planning: the goals changed"


def test_a_parenthesis_too_many_has_its_place(domain):
    executor = World(domain).executor
    with pytest.raises(PddlError, match=r":1:10: unbalanced parentheses"):
        executor.goals.add("(at goal))")
    with pytest.raises(PddlError, match=r"domain.pddl:8:66: unbalanced parentheses"):
        parse_domain(DOMAIN.rstrip() + ")")
