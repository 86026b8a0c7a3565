"""A runner ticks in the time of a clock that is handed in, and leaves nothing running."""

import pytest
from py_trees.behaviour import Behaviour
from py_trees.behaviours import Success
from py_trees.common import ParallelPolicy, Status
from py_trees.composites import Parallel, Sequence
from py_trees.trees import BehaviourTree
from py_trees.visitors import VisitorBase

from rosa_bt import TreeRunner


class Probe(Behaviour):
    def __init__(self, name="probe", raises_at=None):
        super().__init__(name)
        self.ticks = 0
        self.ended = []
        self.raises_at = raises_at

    def update(self):
        self.ticks += 1
        if self.ticks == self.raises_at:
            raise RuntimeError("boom")
        return Status.RUNNING

    def terminate(self, new_status):
        self.ended.append(new_status)


def test_tree_is_ticked_at_its_period_of_the_given_clock():
    now = [10.0]
    probe = Probe()
    runner = TreeRunner(probe, clock=lambda: now[0], period=0.5)
    ticked = []
    for step in range(21):
        now[0] = 10.0 + step * 0.1
        if runner.update():
            ticked.append(step)
    assert ticked == [0, 5, 10, 15, 20]
    assert probe.ticks == 5
    assert runner.due == pytest.approx(12.5)


def test_exception_is_a_failure_and_stops_the_siblings():
    steady = Probe("steady")
    rash = Probe("rash", raises_at=2)
    root = Parallel("root", policy=ParallelPolicy.SuccessOnAll(), children=[steady, rash])
    runner = TreeRunner(root, clock=lambda: 0.0)
    runner.tick()
    runner.tick()
    assert rash.status is Status.FAILURE
    assert rash.feedback_message.startswith("RuntimeError: boom; ")
    assert rash.ended == [Status.FAILURE]
    assert steady.ended == [Status.INVALID]
    assert all(node.status is not Status.RUNNING for node in root.iterate())
    runner.tick()
    assert root.status is Status.RUNNING


def running(*children):
    root = Sequence("root", memory=True, children=children)
    return root, TreeRunner(root, clock=lambda: 0.0)


def test_tree_is_changed_between_ticks_as_in_py_trees():
    done = Probe("done")
    first = Probe("first")
    second = Probe("second")
    third = Probe("third")
    done.update = lambda: Status.SUCCESS
    root, runner = running(done, first)
    runner.tick()
    runner.tree.replace_subtree(first.id, second)
    runner.tree.insert_subtree(third, root.id, 0)
    runner.tick()
    assert root.children == [third, done, second]
    assert first.ended == [Status.INVALID]
    assert (root.current_child, third.ticks, second.ticks) == (third, 1, 0), (
        "it begins anew without the child it was at"
    )
    runner.tree.prune_subtree(third.id)
    runner.tick()
    assert (root.status, third.ended, second.ticks) == (Status.RUNNING, [Status.INVALID], 1)


def test_what_is_taken_out_of_the_list_of_children_is_stopped():
    first = Probe("first")
    root, runner = running(Success("done"), first)
    runner.tick()
    root.children.remove(first)
    runner.tick()
    assert first.ended == [Status.INVALID]


def test_visitors_and_handlers_are_called_as_by_py_trees():
    root, runner = running(Probe("first"))
    plain = BehaviourTree(Sequence("root", memory=True, children=[Probe("first")]))
    heard = {}
    for tree in (runner.tree, plain):
        calls = heard[tree] = []
        for full in (False, True):
            visitor = VisitorBase(full=full)
            visitor.initialise = lambda calls=calls: calls.append("initialise")
            visitor.run = lambda node, calls=calls, full=full: calls.append((node.name, full))
            visitor.finalise = lambda calls=calls: calls.append("finalise")
            tree.add_visitor(visitor)
        tree.add_pre_tick_handler(lambda tree, calls=calls: calls.append(("pre", tree.count)))
        tree.add_post_tick_handler(lambda tree, calls=calls: calls.append(("post", tree.count)))
        for _ in range(2):
            tree.tick(
                lambda tree, calls=calls: calls.append("once"),
                lambda tree, calls=calls: calls.append("last"),
            )
    assert heard[runner.tree] == heard[plain]
    assert heard[plain]
    assert root.status is Status.RUNNING
