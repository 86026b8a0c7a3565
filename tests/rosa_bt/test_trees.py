"""A runner ticks in the time of a clock that is handed in, and leaves nothing running."""

import pytest
from py_trees.behaviour import Behaviour
from py_trees.common import ParallelPolicy, Status
from py_trees.composites import Parallel

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


def test_missed_ticks_are_not_made_up_for():
    now = [0.0]
    probe = Probe()
    runner = TreeRunner(probe, clock=lambda: now[0], period=0.1)
    assert runner.update()
    now[0] = 5.05
    assert runner.update()
    assert not runner.update()
    assert probe.ticks == 2
    assert runner.due == pytest.approx(5.1)


def test_exception_of_a_plain_behaviour_is_its_failure_with_the_text_and_stops_its_running_siblings():
    steady, rash = Probe("steady"), Probe("rash", raises_at=2)
    root = Parallel("root", policy=ParallelPolicy.SuccessOnAll(), children=[steady, rash])
    runner = TreeRunner(root, clock=lambda: 0.0)
    runner.tick()
    runner.tick()
    assert rash.status is Status.FAILURE
    assert rash.feedback_message == "RuntimeError: boom"
    assert rash.ended == [Status.FAILURE]
    assert steady.ended == [Status.INVALID]
    assert all(node.status is not Status.RUNNING for node in root.iterate())
    runner.tick()
    assert root.status is Status.RUNNING


def test_all_are_stopped_although_one_of_them_cannot_be():
    class Stubborn(Probe):
        def terminate(self, new_status):
            raise OSError("stuck")

    stubborn, gentle = Stubborn("stubborn"), Probe("gentle")
    root = Parallel("root", policy=ParallelPolicy.SuccessOnAll(), children=[stubborn, gentle])
    runner = TreeRunner(root, clock=lambda: 0.0)
    runner.tick()
    runner.shutdown()
    assert gentle.ended == [Status.INVALID]
    assert stubborn.status is Status.INVALID
    assert stubborn.feedback_message == "OSError: stuck (at the end)"


@pytest.mark.parametrize("period", [0.0, -1.0, float("nan")])
def test_period_is_more_than_zero(period):
    with pytest.raises(ValueError, match="more than 0 s"):
        TreeRunner(Probe(), clock=lambda: 0.0, period=period)
