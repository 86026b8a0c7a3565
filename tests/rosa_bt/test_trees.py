"""A runner ticks in the time of a clock that is handed in, and leaves nothing running."""

from threading import Thread

import pytest
from py_trees.behaviour import Behaviour
from py_trees.common import ParallelPolicy, Status
from py_trees.composites import Parallel, Sequence
from py_trees.decorators import Inverter
from py_trees.trees import BehaviourTree
from py_trees.visitors import VisitorBase

from rosa_bt import TreeChangeError, TreeRunner


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


def running(*children):
    root = Sequence("root", memory=True, children=children)
    return root, TreeRunner(root, clock=lambda: 0.0)


def test_changes_are_carried_out_before_the_next_tick_in_the_order_in_which_they_were_asked_for():
    first, second, third = Probe("first"), Probe("second"), Probe("third")
    root, runner = running(first)
    runner.tick()
    answers = [runner.replace(first, second), runner.insert(third, root, 0), runner.prune(second)]
    assert root.children == [first], "nothing changes before"
    runner.tick()
    assert all(answer.result(0) is None for answer in answers)
    assert root.children == [third]
    assert first.ended == [Status.INVALID]


def test_replacement_takes_the_place_that_its_parent_had_got_to():
    done, first, second = Probe("done"), Probe("first"), Probe("second")
    done.update = lambda: Status.SUCCESS
    root, runner = running(done, first)
    runner.tick()
    runner.replace(first, second)
    runner.tick()
    assert (second.ticks, root.current_child) == (1, second)
    below, other = Probe("below"), Probe("other")
    runner.insert(Inverter("not", below), root)
    runner.replace(below, other)
    runner.tick()
    assert root.children[2].decorated is other


def test_root_is_replaced_by_another_tree_which_is_guarded_from_its_first_tick():
    first = Probe("first")
    root, runner = running(first)
    runner.tick()
    other = Probe("other", raises_at=2)
    answer = runner.replace(root, other)
    runner.tick()
    assert answer.result(0) is None
    assert (runner.tree.root, other.ticks, first.ended) == (other, 1, [Status.INVALID])
    assert type(root.children) is list, "the old tree is let go"
    runner.tick()
    assert (runner.status, other.feedback_message) == (Status.FAILURE, "RuntimeError: boom")


@pytest.mark.parametrize("how", ["children", "decorated"])
def test_children_put_in_the_place_of_others_within_a_tick_are_refused(how):
    stranger, rest = Probe("stranger"), Probe("rest")

    class Rash(Probe):
        def update(self):
            if how == "children":
                root.children = [self, stranger]
            else:
                decorator.decorated = stranger
            return Status.SUCCESS

    decorator = Inverter("not", rest)
    root, runner = running(Rash("rash"), decorator)
    with pytest.raises(TreeChangeError, match="were to be changed in the middle of a tick"):
        runner.tick()
    assert root.children == [root.children[0], decorator]
    assert (decorator.decorated, decorator.children) == (rest, [rest])
    assert stranger.status is not Status.RUNNING


def test_what_the_refused_change_hid_from_its_parent_is_stopped_with_it():
    class Rash(Probe):
        def update(self):
            self.ticks += 1
            if self.ticks == 1:
                return Status.SUCCESS
            root.children = [Probe("stranger")]
            return Status.FAILURE

    steady = Probe("steady")
    root = Sequence("root", memory=False, children=[Rash("rash"), steady])
    runner = TreeRunner(root, clock=lambda: 0.0)
    runner.tick()
    assert steady.status is Status.RUNNING
    with pytest.raises(TreeChangeError):
        runner.tick()
    assert (root.status, steady.ended) == (Status.FAILURE, [Status.INVALID])


def test_change_that_is_not_possible_is_answered_with_the_reason_and_the_tree_goes_on():
    first, stranger = Probe("first"), Probe("stranger")
    root, runner = running(first)
    refused = {
        "is not in the tree of 'root', which has first, root": runner.prune(stranger),
        "is the root; shut the tree down": runner.prune(root),
        "'first' is part of a tree already": runner.replace(root, first),
        "is part of a tree already": runner.insert(first, root),
        "takes no more children": runner.insert(stranger, first),
        "has 1 children; a child is inserted at 0 to 1, not 7": runner.insert(stranger, root, 7),
        "is a py_trees behaviour, not 'x'": runner.insert("x", root),
    }
    runner.tick()
    for reason, answer in refused.items():
        assert reason in str(answer.exception(0))
        assert isinstance(answer.exception(0), TreeChangeError)
    assert root.children == [first]


def test_changes_that_were_not_carried_out_are_cancelled_at_shutdown():
    first = Probe("first")
    _, runner = running(first)
    answer = runner.prune(first)
    runner.shutdown()
    assert answer.cancelled()


@pytest.mark.parametrize(
    "change", ["add_child", "remove_child", "replace_child", "insert_child", "remove_all_children"]
)
def test_direct_change_in_the_middle_of_a_tick_is_refused_at_the_runner_and_by_the_tree(change):
    new = Probe("new")

    class Meddler(Probe):
        def update(self):
            given = {"remove_child": [self], "replace_child": [self, new], "insert_child": [new, 0]}
            getattr(self.parent, change)(*([] if change == "remove_all_children" else given.get(change, [new])))
            return Status.RUNNING

    meddler, other = Meddler("meddler"), Probe("other")
    root = Parallel("root", policy=ParallelPolicy.SuccessOnAll(), children=[meddler, other])
    runner = TreeRunner(root, clock=lambda: 0.0)
    with pytest.raises(TreeChangeError, match="the children of 'root' were to be changed in the middle of a tick"):
        runner.tick()
    assert root.children == [meddler, other]
    assert (new.ticks, new.status) == (0, Status.INVALID)
    assert meddler.status is Status.FAILURE
    meddler.update = lambda: Status.RUNNING
    runner.tick()
    assert root.status is Status.RUNNING


def test_tree_may_be_changed_directly_between_ticks_and_is_guarded_all_the_same():
    root, runner = running(Probe("first"))
    runner.tick()
    root.prepend_child(Probe("rash", raises_at=1))
    root.stop(Status.INVALID)
    runner.tick()
    assert root.status is Status.FAILURE
    assert root.children[0].feedback_message == "RuntimeError: boom"


def test_what_interrupts_a_tick_stops_everything_and_is_raised():
    class Interrupted(Probe):
        def update(self):
            raise KeyboardInterrupt

    steady = Probe("steady")
    root = Parallel("root", policy=ParallelPolicy.SuccessOnAll(), children=[steady, Interrupted("x")])
    runner = TreeRunner(root, clock=lambda: 0.0)
    with pytest.raises(KeyboardInterrupt):
        runner.tick()
    assert steady.ended == [Status.INVALID]


def test_each_behaviour_is_shut_down_although_one_of_them_raises_in_it():
    class Broken(Probe):
        def shutdown(self):
            raise OSError("no such device")

    class Closing(Probe):
        closed = False

        def shutdown(self):
            self.closed = True

    closing = Closing("closing")
    _, runner = running(Broken("broken"), closing)
    with pytest.raises(OSError, match="no such device"):
        runner.shutdown()
    assert closing.closed


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
            tree.tick(lambda tree, calls=calls: calls.append("once"), lambda tree, calls=calls: calls.append("last"))
    assert heard[runner.tree] == heard[plain]
    assert heard[plain]
    assert root.status is Status.RUNNING


def test_another_runner_may_take_a_tree_over_and_either_may_be_shut_down_first():
    rash = Probe("rash", raises_at=3)
    root, first = running(rash)
    first.tick()
    second = TreeRunner(root, clock=lambda: 0.0)
    second.tick()
    first.shutdown()
    second.tick()
    assert rash.feedback_message == "RuntimeError: boom"
    second.shutdown()
    assert root.status is not Status.RUNNING


def test_runner_needs_a_behaviour_to_run():
    with pytest.raises(TypeError, match="root node must be an instance of"):
        TreeRunner("root", clock=lambda: 0.0)


def test_composite_without_children_takes_none_in_the_middle_of_a_tick_either():
    empty = Sequence("empty", memory=False)

    class Meddler(Probe):
        def update(self):
            empty.add_child(Probe("new"))
            return Status.RUNNING

    now = [0.0]
    root = Parallel("root", policy=ParallelPolicy.SuccessOnAll(), children=[empty, Meddler("meddler")])
    runner = TreeRunner(root, clock=lambda: now[0])
    with pytest.raises(TreeChangeError, match="children of 'empty'"):
        runner.update()
    assert empty.children == []
    assert not runner.update(), "the tick that was refused is over all the same"


def test_changes_may_be_asked_for_by_several_threads_while_the_tree_is_ticked():
    root = Parallel("root", policy=ParallelPolicy.SuccessOnAll(), children=[Probe("first")])
    runner = TreeRunner(root, clock=lambda: 0.0)
    answers = []

    def ask():
        for number in range(50):
            answers.append(runner.insert(Probe(f"probe {number}"), root, 0))

    threads = [Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        runner.tick()
    runner.tick()
    assert all(answer.result(0) is None for answer in answers)
    assert len(root.children) == 201
