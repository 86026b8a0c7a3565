"""A trace holds every tick as data, is the same for the same run, and can be decided once more."""

import json
import subprocess
import sys
import threading

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from py_trees.behaviours import Running, StatusQueue
from py_trees.common import ParallelPolicy, Status
from py_trees.composites import Parallel, Selector, Sequence
from py_trees.decorators import FailureIsSuccess, RunningIsSuccess

from kb import ConfigurationManager, KnowledgeBase, Model
from rosa_bt import (
    IsActionFeasible,
    RosaAction,
    Trace,
    TraceError,
    TraceVisitor,
    TreeRunner,
    do_until_unfeasible,
    feasible_then_act,
    read_trace,
    replay_trace,
)


def rover() -> Model:
    model = Model("rover")
    light, energy = model.environmental_attribute("light"), model.quality_attribute("energy")
    camera = model.component("camera", kind="lifecycle", always_improve=True)
    camera.configuration("day", {"exposure_s": 0.01}, priority=1, constraints=[light >= 0.5])
    camera.configuration("night", {"exposure_s": 0.2}, priority=2)
    radar = model.component("radar", kind="lifecycle")
    look = model.function("look")
    look.design("by_camera", [camera], priority=1)
    look.design("by_radar", [radar], priority=2)
    model.action("explore", requires=[look], constraints=[energy >= 0.2])
    model.action("charge")
    return model


class Act(RosaAction):
    def update(self):
        return Status.RUNNING


def act(kb):
    return do_until_unfeasible(
        Act("explore", kb, "explore", wait=True), Act("charge", kb, "charge"), name="mission"
    )


def tree(kb):
    return Sequence("root", memory=True, children=[act(kb), Running("never")])


class Robot:
    def activate(self, component):
        pass

    deactivate = activate

    def set_parameters(self, component, parameters):
        pass


TOLD = {
    "light": lambda kb, number: kb.measure("light", number / 10),
    "energy": lambda kb, number: kb.measure("energy", number / 10),
    "fail": lambda kb, number: kb.component_failed("camera", "dirt" if number % 2 else ""),
    "recover": lambda kb, number: kb.component_recovered("camera"),
    "stop": lambda kb, number: kb.component_active("radar", False, "crashed" if number % 2 else ""),
    "assert": lambda kb, number: kb.assert_status(
        kb.actions["explore"], "unfeasible", "a person says so", kb.now + 1
    ),
    "forbid": lambda kb, number: kb.assert_status("by_camera", "unfeasible"),
    "allow": lambda kb, number: kb.retract_status("by_camera"),
    "ask": lambda kb, number: kb.request_action("charge"),
    "stop asking": lambda kb, number: kb.cancel_action("charge", "failed", "a person says so"),
}
TELLING = st.lists(
    st.lists(st.tuples(st.sampled_from(sorted(TOLD)), st.integers(0, 9)), max_size=3), max_size=8
)


def run(told, path=None, keep=1000):
    """Run the rover's tree below a manager, told things between ticks; return the trace."""
    now = 0.0
    kb = KnowledgeBase(rover(), clock=lambda: now)
    kb.measure("energy", 1.0)
    manager = ConfigurationManager(kb, Robot())
    runner = TreeRunner(tree(kb), clock=lambda: now)
    with TraceVisitor(kb, path, keep=keep) as visitor:
        runner.tree.add_visitor(visitor)
        for tick, several in enumerate(told):
            now = tick * 0.5
            for what, number in several:
                TOLD[what](kb, number)
            manager.update()
            now += 0.25
            runner.tick()
        runner.shutdown()
        return visitor.trace


@settings(max_examples=60)
@given(TELLING)
def test_replay_decides_the_same_and_a_file_holds_the_same(tmp_path_factory, told):
    path = tmp_path_factory.mktemp("trace") / "run.jsonl"
    trace = run(told, path)
    assert len(trace.ticks) == len(told)
    if told:
        assert path.read_text() == str(trace)
        assert read_trace(path) == trace
        assert replay_trace(read_trace(path), rover(), tree) == trace
    assert str(run(told)) == str(trace), "the same run gives the same trace"


def test_tick_tells_what_was_ticked_what_was_told_and_what_was_decided_with_the_reason():
    first, _, third = run([[], [], [("energy", 1)]]).ticks
    assert [(node.depth, node.kind, node.name) for node in first.tree[:4]] == [
        (0, "Sequence", "root"),
        (1, "DoUntilUnfeasible", "mission"),
        (2, "Sequence", "explore if feasible"),
        (3, "IsActionFeasible", "explore feasible?"),
    ]
    shown = {first.tree[visit.node].name: visit for visit in first.visited}
    assert (shown["explore"].status, shown["explore"].feedback[:8]) == ("RUNNING", "waiting:")
    assert [one[:4] for one, place in first.events if place == -1] == [
        (1, 0.0, "measure", ("energy", 1.0))
    ]
    assert [(one.verb, one.subject) for one, place in first.events if place is None] == [
        ("request_action", "explore")
    ]
    assert first.decisions == (("explore", "requested", ""),)
    assert [one[1:4] for one, _ in third.events if one.verb == "measure"] == [
        (1.0, "measure", ("energy", 0.1))
    ]
    why = "explore is unfeasible because energy 0.1 violates >= 0.2 (measured 0.0 s ago)"
    assert third.decisions == (
        ("explore", "unfeasible", why),
        ("explore", "abandoned", why.replace("0.0 s", "0.2 s")),
        ("charge", "requested", ""),
    )


def test_trace_in_memory_is_bounded_and_says_so_when_it_cannot_be_replayed():
    trace = run([[]] * 20, keep=5)
    assert [tick.number for tick in trace.ticks] == [15, 16, 17, 18, 19]
    assert trace.ticks[0].visited, "the first tick that is left says by itself what was ticked"
    with pytest.raises(TraceError, match="begins at tick 15"):
        replay_trace(trace, rover(), tree)


def test_tree_that_has_changed_is_written_again():
    kb = KnowledgeBase(rover(), clock=lambda: 0.0)
    root = Sequence(
        "root", memory=False, children=[StatusQueue("a", queue=[], eventually=Status.SUCCESS)]
    )
    runner = TreeRunner(root, clock=lambda: 0.0)
    visitor = TraceVisitor(kb)
    runner.tree.add_visitor(visitor)
    runner.tick()
    runner.tree.insert_subtree(Running("b"), root.id, 1)
    runner.tick()
    before, after = visitor.trace.ticks
    assert [node.name for node in before.tree] == ["root", "a"]
    assert [node.name for node in after.tree] == ["root", "a", "b"]
    visitor.close()


def test_trace_that_begins_late_holds_what_was_known_already_and_is_replayed():
    now = 0.0
    kb = KnowledgeBase(rover(), clock=lambda: now)
    kb.request_action("explore")
    kb.measure("energy", 0.1)
    now = 1.0
    with TraceVisitor(kb) as visitor:
        runner = TreeRunner(tree(kb), clock=lambda: now)
        runner.tree.add_visitor(visitor)
        runner.tick()
        runner.shutdown()
    assert [one.verb for one, place in visitor.trace.ticks[0].events if place == -1] == [
        "request_action",
        "measure",
    ]
    assert (
        replay_trace(visitor.trace, rover(), tree).ticks[0].visited
        == visitor.trace.ticks[0].visited
    )


def test_trace_without_its_first_events_says_so():
    (tick,) = run([[]]).ticks
    late = Trace("rover", (tick._replace(events=tick.events[1:]),))
    with pytest.raises(TraceError, match="begins at event 2"):
        replay_trace(late, rover(), tree)


@settings(max_examples=50)
@given(
    st.text(max_size=8)
    | st.sampled_from(["a\x85b\u2028c\u2029d\x0be\x1cf", "\udc80", "a\nb\r\n", "é🤖\0"])
)
def test_any_text_is_read_as_it_was_written(tmp_path_factory, reason):
    path = tmp_path_factory.getbasetemp() / "odd.jsonl"
    kb = KnowledgeBase(rover(), clock=lambda: 0.0)
    runner = TreeRunner(Running(reason), clock=lambda: 0.0)
    with TraceVisitor(kb, path) as visitor:
        runner.tree.add_visitor(visitor)
        kb.component_failed("camera", reason)
        runner.tick()
    assert read_trace(path) == visitor.trace


HEAD = '{"rosa_bt_trace":3,"model":"x"}\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        (
            "nonsense\n",
            r":1: not a line of a trace .JSONDecodeError: Expecting value: line 1 column 1",
        ),
        ("[]\n", r":1: not a line of a trace"),
        ('{"rosa_bt_trace":1,"model":"x"}\n', "version 1; this program reads version 3"),
        (HEAD + '{"tick":0}\n', r":2: not a line of a trace"),
        (HEAD + '{"tick":0,"time":0.0,"visited":[[1]]}\n', r":2: not a line of a trace"),
        (HEAD + '"tick"\n', r":2: not a line of a trace"),
        (HEAD + '{"tick":1e999,"time":0.0}\n', r":2: not a line of a trace"),
        pytest.param("[" * 100_000, r":1: not a line of a trace \(RecursionError", id="deep"),
    ],
)
def test_file_that_is_no_trace_is_refused_with_its_line(tmp_path, text, message):
    path = tmp_path / "run.jsonl"
    path.write_text(text)
    with pytest.raises(TraceError, match=message):
        read_trace(path)


@pytest.mark.parametrize(
    ("verb", "arguments"), [("explode", []), ("measure", ["light"]), ("amend", ["declared", "x"])]
)
def test_event_that_cannot_be_told_again_is_named(tmp_path, verb, arguments):
    path = tmp_path / "run.jsonl"
    event = json.dumps({"number": 1, "time": 0.0, "verb": verb, "arguments": arguments})
    path.write_text(f'{HEAD}{{"tick":0,"time":0.0,"visited":[],"events":[[{event},-1]]}}\n')
    with pytest.raises(TraceError, match=rf"{verb}\(.*\) cannot be told again"):
        replay_trace(read_trace(path), rover(), tree)


# ---------------------------------------------------------------- facts of other threads, interrupts and kills


class Between(Running):
    """Has another thread tell something, now and then, while it is ticked; of the replay nothing."""

    def __init__(self, name, kb, told):
        super().__init__(name)
        self.kb, self.told = kb, list(told)

    def update(self):
        what = self.told.pop(0) if self.told else None
        if what is not None:
            thread = threading.Thread(target=TOLD[what[0]], args=(self.kb, what[1]))
            thread.start()
            thread.join()
        return Status.SUCCESS


def tree_between(kb, told):
    """A tree in which facts arrive before, in the midst of and after what asks for them."""
    can = [IsActionFeasible(f"can {number}?", kb, "explore") for number in (1, 2)]
    asked = Sequence(
        "asked", memory=False, children=[can[0], Between("meanwhile", kb, told[::2]), can[1]]
    )
    either = Selector("either", memory=False, children=[asked, Act("charge", kb, "charge")])
    mission = FailureIsSuccess("go on", RunningIsSuccess("go on", act(kb)))
    return Sequence(
        "root", memory=False, children=[mission, either, Between("late", kb, told[1::2])]
    )


TOLD_WITHIN = st.sampled_from(["light", "energy", "fail", "recover", "assert", "forbid", "allow"])


@settings(max_examples=60, deadline=None)
@given(st.lists(st.none() | st.tuples(TOLD_WITHIN, st.integers(0, 9)), max_size=16))
def test_facts_that_another_thread_tells_within_a_tick_are_replayed_in_their_place(
    tmp_path_factory, told
):
    path = tmp_path_factory.getbasetemp() / "within.jsonl"
    now = 0.0
    kb = KnowledgeBase(rover(), clock=lambda: now)
    kb.measure("energy", 1.0)
    runner = TreeRunner(tree_between(kb, told), clock=lambda: now)
    with TraceVisitor(kb, path) as visitor:
        runner.tree.add_visitor(visitor)
        for _ in range(10):
            now += 0.25
            runner.tick()
        runner.shutdown()
        trace = visitor.trace
    assert any(place is not None for tick in trace.ticks for _, place in tick.events)
    assert read_trace(path) == trace
    assert replay_trace(read_trace(path), rover(), lambda kb: tree_between(kb, [])) == trace


class Rude(Running):
    """Is interrupted in some of its ticks."""

    def __init__(self, name, when):
        super().__init__(name)
        self.when, self.count = when, 0

    def update(self):
        self.count += 1
        if self.count in self.when:
            raise KeyboardInterrupt
        return Status.RUNNING


@pytest.mark.parametrize("by_runner", [True, False])
def test_trace_goes_on_after_an_interrupted_tick_and_is_replayed(tmp_path, by_runner):
    kb = KnowledgeBase(rover(), clock=lambda: 0.0)
    kb.measure("energy", 1.0)

    def build(kb, when=()):
        policy = ParallelPolicy.SuccessOnAll(synchronise=False)
        return Parallel("all", policy=policy, children=[tree(kb), Rude("rude", when)])

    runner = TreeRunner(build(kb, (3, 5)), clock=lambda: 0.0)
    ticked = runner if by_runner else runner.tree
    with TraceVisitor(kb, tmp_path / "run.jsonl") as visitor:
        runner.tree.add_visitor(visitor)
        for number in range(6):
            kb.measure("light", number / 10)
            if number in (2, 4):
                with pytest.raises(KeyboardInterrupt):
                    ticked.tick()
            else:
                ticked.tick()
        trace = visitor.trace
    assert [tick.is_interrupted for tick in trace.ticks] == [False, False, True, False, True, False]
    assert [one.what for one in trace.ticks[2].decisions] == ["abandoned"]
    assert [one.what for one in trace.ticks[3].decisions] == ["requested"]
    assert [one.verb for one, place in trace.ticks[3].events if place == -1] == ["measure"]
    assert read_trace(tmp_path / "run.jsonl") == trace
    assert replay_trace(trace, rover(), build) == trace


KILLED = """
import os, signal, sys
from py_trees.behaviours import Running
from kb import KnowledgeBase, Model
from rosa_bt import TraceVisitor, TreeRunner
model = Model("rover")
model.environmental_attribute("light")
kb = KnowledgeBase(model, clock=lambda: 0.0)
runner = TreeRunner(Running("on"), clock=lambda: 0.0)
runner.tree.add_visitor(TraceVisitor(kb, sys.argv[1]))
for number in range(3):
    kb.measure("light", number)
    runner.tick()
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_program_that_is_killed_leaves_a_trace_of_every_tick(tmp_path):
    path = tmp_path / "run.jsonl"
    subprocess.run([sys.executable, "-c", KILLED, str(path)], timeout=300, check=False)
    trace = read_trace(path)
    assert [tick.events[0].event.arguments for tick in trace.ticks] == [
        ("light", number) for number in (0.0, 1.0, 2.0)
    ]
    whole = path.read_bytes()
    for cut in range(whole.rindex(b"\n", 0, -1) + 1, len(whole)):
        path.write_bytes(whole[:cut])
        assert read_trace(path).ticks == trace.ticks[:2]


class TakesTime(Running):
    """A leaf during which the clock goes on; it decides nothing."""

    def __init__(self, clock):
        super().__init__("slow")
        self.clock = clock

    def update(self):
        self.clock[0] += 0.003
        return super().update()


@pytest.mark.parametrize("declared", ["stale", "dwell"])
def test_replay_has_what_time_does_within_a_tick_in_its_place(declared):
    def model():
        model = Model("lamp")
        if declared == "stale":
            light = model.quality_attribute("light", max_age=1.0, when_stale="violated")
            bound = light >= 0.5
        else:
            light = model.quality_attribute("light")
            bound = (light >= 0.5).steady(dwell=1.0)
        model.action("inspect", constraints=[bound])
        model.action("charge")
        return model

    def build(kb, clock):
        first, later = (IsActionFeasible(name, kb, "inspect") for name in ("first", "later"))
        policy = ParallelPolicy.SuccessOnAll(synchronise=False)
        return Parallel("p", policy=policy, children=[first, TakesTime(clock), later])

    now = [0.0]
    kb = KnowledgeBase(model(), clock=lambda: now[0])
    runner = TreeRunner(build(kb, now), clock=lambda: now[0])
    visitor = TraceVisitor(kb)
    runner.tree.add_visitor(visitor)
    now[0] = 1.0
    kb.measure("light", 0.9)
    if declared == "dwell":
        kb.measure("light", 0.1)
    for now[0] in (1.1, 1.999, 2.1):
        runner.tick()
    first, _, later, _ = visitor.trace.ticks[1].visited
    assert (first.status, later.status) == ("SUCCESS", "FAILURE")
    assert replay_trace(visitor.trace, model(), lambda kb: build(kb, [0.0])) == visitor.trace
