"""An interrupted action may take time to stop; what excludes it waits until it has."""

import pytest
from acting import Act, Clock
from py_trees.behaviours import StatusQueue
from py_trees.common import ParallelPolicy, Status
from py_trees.composites import Parallel, Selector, Sequence
from xml_leaves import wrapped

from kb import KnowledgeBase, Model
from rosa_bt import (
    BehaviourRegistry,
    ForAction,
    RosaAction,
    TreeRunner,
    do_until_unfeasible,
    load_xml,
)


class Braking(RosaAction):
    """Runs until it is interrupted, and then takes a number of calls to halt."""

    def __init__(self, kb, *, calls=3, **arguments):
        super().__init__("inspect", kb, "inspect", **arguments)
        self.calls = calls
        self.count = 0

    def update(self):
        return Status.RUNNING

    def halting(self):
        self.count += 1
        self.feedback_message = f"brakes {self.count}"
        return Status.RUNNING if self.count < self.calls else Status.SUCCESS


class Robot:
    def __init__(self):
        model = Model("rover")
        light = model.environmental_attribute("light")
        move = model.function("move")
        see = model.function("see")
        move.design("by motor", [model.component("motor")])
        see.design("by camera", [model.component("camera")])
        model.action("inspect", requires=[move], constraints=[light >= 0.5])
        model.action("go_home", requires=[move])
        model.action("look", requires=[see])
        self.clock = Clock()
        self.kb = KnowledgeBase(model, clock=self.clock)
        self.kb.measure("light", 1.0)

    def tick(self, runner, times=1):
        """Tick, and return what is required after each tick."""
        required = []
        for _ in range(times):
            self.clock.now += 1.0
            runner.tick()
            required.append([request.action for request in self.kb.required_actions])
        return required


@pytest.fixture
def robot():
    return Robot()


def interrupted(robot, task, meanwhile):
    """Return a runner whose task has just become unfeasible."""
    runner = TreeRunner(do_until_unfeasible(task, meanwhile), clock=robot.clock)
    robot.tick(runner)
    robot.kb.measure("light", 0.0)
    return runner


@pytest.mark.parametrize(
    "make", [Act, lambda kb, action: ForAction(action, kb, action, Act(kb, "look"))]
)
def test_action_that_shares_a_component_waits_until_halted(robot, make):
    task = Braking(robot.kb)
    runner = interrupted(robot, task, make(robot.kb, "go_home"))
    required = robot.tick(runner, 3)
    assert required[:2] == [["inspect"], ["inspect"]]
    assert required[2][0] == "go_home"
    assert not task.is_halting
    request = robot.kb.history.actions[0]
    assert (request.end, request.result) == (4.0, "abandoned")
    assert "light 0 violates >= 0.5" in request.reason


def test_exclusive_action_waits_for_every_halting(robot):
    look = Act(robot.kb, "look")
    look.exclusive = True
    runner = interrupted(robot, Braking(robot.kb), look)
    robot.tick(runner)
    assert look.feedback_message == "waiting until inspect has halted: brakes 1"
    assert robot.tick(runner, 2) == [["inspect"], ["look"]]


def test_action_that_takes_over_waits_for_what_it_displaces(robot):
    gate = StatusQueue("gate", [Status.FAILURE], eventually=Status.SUCCESS)
    home = Act(robot.kb, "go_home")
    urgent = Sequence("urgent", memory=False, children=[gate, home])
    root = Selector("root", memory=False, children=[urgent, Braking(robot.kb)])
    runner = TreeRunner(root, clock=robot.clock)
    assert robot.tick(runner, 4) == [["inspect"], ["inspect"], ["inspect"], ["go_home"]]


def test_actions_side_by_side_do_not_wait(robot):
    policy = ParallelPolicy.SuccessOnAll(synchronise=False)
    root = Parallel("both", policy, [Braking(robot.kb), Act(robot.kb, "go_home")])
    assert robot.tick(TreeRunner(root, clock=robot.clock)) == [["inspect", "go_home"]]


def test_action_begins_again_only_when_it_has_halted(robot):
    task = Braking(robot.kb)
    runner = interrupted(robot, task, Act(robot.kb, "look"))
    robot.tick(runner)
    robot.kb.measure("light", 1.0)
    robot.tick(runner)
    assert task.is_halting
    robot.tick(runner)
    assert [request.result for request in robot.kb.history.actions] == [
        "abandoned",
        "abandoned",
        None,
    ]
    assert task.status is Status.RUNNING


def test_halting_that_takes_too_long_ends_with_the_reason(robot, caplog):
    task = Braking(robot.kb, calls=99, halting_timeout=2.0)
    runner = interrupted(robot, task, Act(robot.kb, "go_home"))
    assert robot.tick(runner, 3) == [["inspect"], ["inspect"], ["go_home"]]
    problem = "inspect did not halt within 2 s: brakes 3"
    assert robot.kb.history.actions[0].reason.endswith(problem)
    assert caplog.messages == [problem]


@pytest.mark.parametrize("answer", [None, True])
def test_halting_that_returns_no_status_is_an_error_and_waits(robot, caplog, answer):
    task = Braking(robot.kb, halting_timeout=2.0)
    task.halting = lambda: answer
    runner = interrupted(robot, task, Act(robot.kb, "go_home"))
    assert robot.tick(runner, 3) == [["inspect"], ["inspect"], ["go_home"]]
    advice = "return Status.RUNNING until the robot has stopped, then Status.SUCCESS"
    assert f"halting returned {answer}; {advice}" in caplog.messages[0]
    assert len(caplog.messages) == 2


@pytest.mark.parametrize("node", ["NonblockingSequence", "ParallelAll"])
def test_actions_side_by_side_in_xml_do_not_wait(robot, node):
    registry = BehaviourRegistry(kb=robot.kb)
    registry.register("Brake", lambda name: Braking(robot.kb))
    registry.register("Home", lambda name: Act(robot.kb, "go_home"))
    tree = load_xml(wrapped(f"<{node}><Brake/><Home/></{node}>"), registry)
    assert robot.tick(TreeRunner(tree, clock=robot.clock)) == [["inspect", "go_home"]]


def test_shutdown_releases_what_still_halts(robot):
    runner = interrupted(robot, Braking(robot.kb), Act(robot.kb, "go_home"))
    robot.tick(runner)
    assert runner.is_halting
    runner.shutdown()
    assert not runner.is_halting
    assert robot.kb.required_actions == ()
    reason = robot.kb.history.actions[0].reason
    assert reason.endswith("the tree was shut down while inspect was halting")


def test_stopped_runner_ticks_until_all_has_halted(robot):
    runner = TreeRunner(Braking(robot.kb), clock=robot.clock)
    robot.tick(runner)
    runner.stop()
    assert runner.is_halting
    assert robot.tick(runner, 2) == [["inspect"], []]
    assert not runner.is_halting
