"""Nothing is swallowed, durations follow the runner's clock, `setup` reaches everybody."""

import logging

import pytest
from acting import Clock
from py_trees import decorators, timers
from py_trees.behaviour import Behaviour
from py_trees.behaviours import Running, StatusQueue
from py_trees.common import Status
from py_trees.composites import Selector, Sequence

from kb import KnowledgeBase, Model
from rosa_bt import (
    BehaviourRegistry,
    ClockError,
    Delay,
    ForAction,
    Retry,
    Timeout,
    Timer,
    TraceVisitor,
    TreeChangeError,
    TreeRunner,
    export_xml,
    load_xml,
    read_trace,
)

RAISING = ("initialise", "update", "terminate")


class Slip(Behaviour):
    """Raises in one of its hooks."""

    def __init__(self, hook, name="slip"):
        super().__init__(name)
        self.hook = hook

    def initialise(self):
        self._raise("initialise")

    def update(self):
        self._raise("update")
        return Status.FAILURE

    def terminate(self, new_status):
        self._raise("terminate")

    def _raise(self, hook):
        if hook == self.hook:
            raise AttributeError("no spnge")


def slipping(hook, **arguments):
    root = Selector("clean", memory=False, children=[Slip(hook), Running("wait for help")])
    return TreeRunner(root, clock=Clock(), **arguments)


# ---------------------------------------------------------------- errors


@pytest.mark.parametrize("hook", RAISING)
def test_exception_is_logged_once_with_its_traceback(hook, caplog):
    runner = slipping(hook)
    for _ in range(3):
        runner.tick()
    assert runner.status is Status.RUNNING
    (record,) = caplog.records
    assert record.levelno == logging.ERROR
    assert record.exc_info[0] is AttributeError
    assert "Slip 'slip': AttributeError: no spnge" in record.getMessage()


@pytest.mark.parametrize("hook", RAISING)
def test_exception_is_raised_when_the_tree_is_stopped(hook):
    runner = slipping(hook, on_error="raise")
    with pytest.raises(AttributeError, match="no spnge"):
        runner.tick()
    assert all(node.status is not Status.RUNNING for node in runner.tree.root.iterate())


def test_exception_of_new_tries_of_a_step_is_logged_once(caplog):
    runner = slipping("update")
    for _ in range(3):
        runner.tick()
        runner.replace_subtree(runner.root.children[0].id, Slip("update"))
    assert len(caplog.records) == 1


def test_exception_is_in_the_trace_and_in_its_file(tmp_path):
    kb = KnowledgeBase(Model("rover"), clock=Clock())
    runner = slipping("terminate")
    with TraceVisitor(kb, tmp_path / "run.jsonl") as visitor:
        runner.tree.add_visitor(visitor)
        runner.tick()
    ((name, text),) = visitor.trace.ticks[0].errors
    assert (name, text.partition(";")[0]) == ("slip", "AttributeError: no spnge")
    assert read_trace(tmp_path / "run.jsonl") == visitor.trace


# ---------------------------------------------------------------- time


def run(root, clock, until, period=1.0, **arguments):
    """Return the statuses of the root at each second from 0 on."""
    runner = TreeRunner(root, clock=clock, period=period, **arguments)
    statuses = []
    while clock.now <= until:
        runner.update()
        statuses.append(runner.status.name[0])
        clock.now += 1.0
    return "".join(statuses)


def child(*statuses):
    return StatusQueue("child", [Status[name] for name in statuses], eventually=Status.RUNNING)


TIMED = {
    "timer": (lambda: Timer("wait", 3.0), "RRRSRR"),
    "timeout": (lambda: Timeout("at most", child(), 3.0), "RRRFRR"),
    "timeout in time": (lambda: Timeout("at most", child("RUNNING", "SUCCESS"), 3.0), "RSRRRF"),
    "delay": (lambda: Delay("later", child("SUCCESS"), 2.0), "RRSRRR"),
    "retry": (lambda: Retry("again", child("FAILURE", "SUCCESS"), 3, pause=2.0), "RRSRRR"),
    "retry in vain": (lambda: Retry("again", child("FAILURE", "FAILURE"), 2, pause=2.0), "RRFRRR"),
    "retry at once": (lambda: Retry("again", child("FAILURE", "SUCCESS"), 3), "RSRRRR"),
    "py_trees timer": (lambda: timers.Timer("wait", 3.0), "RRRSRR"),
    "py_trees timeout": (lambda: decorators.Timeout("at most", child(), 3.0), "RRRFRR"),
}


@pytest.mark.parametrize("case", TIMED)
def test_duration_is_counted_by_the_clock_of_the_runner(case):
    make, expected = TIMED[case]
    assert run(make(), Clock(), 5.0) == expected


@pytest.mark.parametrize("case", [name for name in TIMED if "py_trees" not in name])
def test_timed_behaviour_that_is_written_and_read_does_the_same(case):
    make, expected = TIMED[case]
    registry = BehaviourRegistry()
    registry.register("child", lambda name: make_child())

    def make_child():
        leaf = next(node for node in make().iterate() if isinstance(node, StatusQueue))
        leaf.parent = None
        return leaf

    tree = load_xml(export_xml(make(), registry), registry)
    assert run(tree, Clock(), 5.0) == expected


@pytest.mark.parametrize("base", [timers.Timer, decorators.Timeout])
def test_subclass_that_reads_the_computers_clock_is_refused(base):
    class Mine(base):
        def update(self):
            return super().update()

    root = Mine("m", 3.0) if base is timers.Timer else Mine("m", child(), 3.0)
    with pytest.raises(TreeChangeError, match=r"derive it from rosa_bt\.Timeout or"):
        TreeRunner(root, clock=Clock())


@pytest.mark.parametrize(
    "make",
    [
        lambda: Timer("t", -1),
        lambda: Timeout("t", Running("r"), float("nan")),
        lambda: Delay("t", Running("r"), "x"),
        lambda: Retry("t", Running("r"), 3, pause=-2),
        lambda: Retry("t", Running("r"), 0),
    ],
)
def test_duration_or_number_that_is_too_small_is_refused(make):
    with pytest.raises(ValueError, match=r"'t': \w+ is at least [01], not "):
        make()


def test_xml_tree_follows_the_runner_unless_it_has_a_clock():
    text = '<root BTCPP_format="4"><BehaviorTree><Sleep msec="3000"/></BehaviorTree></root>'
    assert run(load_xml(text, BehaviourRegistry()), Clock(), 4.0) == "RRRSR"
    stopped = load_xml(text, BehaviourRegistry(), clock=lambda: 0.0)
    assert run(stopped, Clock(), 4.0) == "RRRRR"


@pytest.mark.parametrize("make", [lambda: Timer("t", 5.0), lambda: timers.Timer("t", 5.0)])
def test_clock_that_is_set_back_is_logged_and_followed(make, caplog):
    clock = Clock()
    runner = TreeRunner(make(), clock=clock, period=1.0)
    statuses = []
    for clock.now in (100.0, 101.0, 102.0, 0.0, 1.0, 2.0, 3.0):  # the clock is set
        assert runner.update()
        statuses.append(runner.status.name[0])
    assert "".join(statuses) == "RRRRRRS"[: len(statuses)]
    assert caplog.messages == [
        f"the clock of {runner.tree.root.name!r} was set back from 102 s to 0 s; "
        "the tree goes on from there"
    ]


def test_clock_that_is_set_back_is_refused_if_chosen():
    clock = Clock()
    runner = TreeRunner(Running("r"), clock=clock, on_clock_set_back="refuse")
    clock.now = 5.0
    runner.update()
    clock.now = 1.0
    with pytest.raises(ClockError, match="set back from 5 s to 1 s; make a new TreeRunner"):
        runner.update()
    assert runner.status is Status.INVALID


def test_timer_that_runs_already_begins_anew_with_a_runner():
    timer = timers.Timer("t", 2.0)
    list(timer.tick())
    clock = Clock()
    clock.now = 100.0
    assert run(timer, clock, 103.0) == "RRSR"


def test_knowledge_base_of_a_tree_follows_its_clock(caplog):
    model = Model("rover")
    model.action("drive")
    clock = Clock()
    clock.now = 100.0
    kb = KnowledgeBase(model, clock=clock)
    runner = TreeRunner(ForAction("drive", kb, "drive", Running("r")), clock=clock)
    runner.tick()
    clock.now = 2.0
    runner.tick()
    assert (runner.status, kb.now) == (Status.RUNNING, 100.0)
    clock.now = 3.0
    assert kb.now == 101.0


# ---------------------------------------------------------------- setup


class Horn(Behaviour):
    sound = "none"

    def setup(self, **kwargs):
        assert [*kwargs] == ["sound"]
        self.sound = kwargs["sound"]

    def update(self):
        return Status.RUNNING


def test_setup_reaches_a_behaviour_inserted_later():
    first = Horn("first")
    second = Horn("second")
    root = Sequence("root", memory=True, children=[first])
    runner = TreeRunner(root, clock=Clock())
    runner.setup(timeout=1.0, sound="toot")
    runner.tick()
    runner.tree.insert_subtree(second, root.id, 1)
    runner.tick()
    assert (first.sound, second.sound) == ("toot", "toot")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"clock": float, "on_error": "rais"}, "'rais' is none of fail, raise"),
        ({"clock": float, "on_clock_set_back": "go"}, "'go' is none of follow, refuse"),
        ({"clock": float, "period": 0.0}, "the period of a tree is more than 0 s"),
    ],
)
def test_runner_with_a_wrong_argument_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        TreeRunner(Running("rest"), **arguments)
