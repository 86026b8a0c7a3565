"""A trace holds every tick as data, is the same for the same run, and can be decided once more."""

import threading

import pytest
from acting import Act, Managed
from hypothesis import given, settings
from hypothesis import strategies as st
from py_trees.behaviours import Running
from py_trees.common import ParallelPolicy, Status
from py_trees.composites import Parallel, Selector, Sequence
from py_trees.decorators import FailureIsSuccess, RunningIsSuccess

from kb import ConfigurationManager, KnowledgeBase, Model
from rosa_bt import (
    IsActionFeasible,
    TraceError,
    TraceVisitor,
    TreeRunner,
    do_until_unfeasible,
    read_trace,
    replay_trace,
)


def rover() -> Model:
    model = Model("rover")
    light = model.environmental_attribute("light")
    energy = model.quality_attribute("energy")
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


def act(kb):
    return do_until_unfeasible(Act(kb, "explore", wait=True), Act(kb, "charge"), name="mission")


def tree(kb):
    return Sequence("root", memory=True, children=[act(kb), Running("never")])


TOLD = {
    "light": lambda kb, number: kb.measure("light", number / 10),
    "energy": lambda kb, number: kb.measure("energy", number / 10),
    "fail": lambda kb, number: kb.component_failed("camera", "dirt" if number % 2 else ""),
    "recover": lambda kb, number: kb.component_recovered("camera"),
    "assert": lambda kb, number: kb.assert_status(
        kb.actions["explore"], "unfeasible", "a person says so", kb.now + 1
    ),
    "forbid": lambda kb, number: kb.assert_status("by_camera", "unfeasible"),
    "allow": lambda kb, number: kb.retract_status("by_camera"),
}
TELLING = st.lists(
    st.lists(st.tuples(st.sampled_from(sorted(TOLD)), st.integers(0, 9)), max_size=3), max_size=8
)


def run(told, path=None, keep=1000):
    """Run the rover's tree below a manager, told things between ticks; return the trace."""
    now = 0.0
    kb = KnowledgeBase(rover(), clock=lambda: now)
    kb.measure("energy", 1.0)
    manager = ConfigurationManager(kb, Managed())
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
        assert read_trace(path) == trace
        assert replay_trace(read_trace(path), rover(), tree) == trace
    assert run(told) == trace, "the same run gives the same trace"


def test_tick_has_what_was_ticked_told_and_decided():
    first, _, third = run([[], [], [("energy", 1)]]).ticks
    assert first.tree[:2] == ((0, "Sequence", "root"), (1, "DoUntilUnfeasible", "mission"))
    shown = {first.tree[visit.node].name: visit for visit in first.visited}
    assert (shown["explore"].status, shown["explore"].feedback[:8]) == ("RUNNING", "waiting:")
    told = [(event.verb, event.subject, place) for event, place in first.events if place != 0]
    assert told == [("measure", "energy", -1), ("request_action", "explore", None)]
    why = "explore is unfeasible because energy 0.1 violates >= 0.2 (measured 0.2 s ago)"
    assert [event.text for event, place in third.events if place is None] == [
        f"explore is abandoned: {why}",
        "charge is requested",
    ]


def test_trace_without_its_first_ticks_is_not_replayed():
    trace = run([[]] * 20, keep=5)
    assert [tick.number for tick in trace.ticks] == [15, 16, 17, 18, 19]
    assert trace.ticks[0].visited, "the first tick that is left says by itself what was ticked"
    with pytest.raises(TraceError, match="lacks its first ticks"):
        replay_trace(trace, rover(), tree)


HEAD = '{"rosa_bt_trace":4,"model":"x"}\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r":1: not a line of a trace"),
        (
            "nonsense\n",
            r":1: not a line of a trace .JSONDecodeError: Expecting value: line 1 column 1",
        ),
        ("[]\n", r":1: not a line of a trace"),
        ('{"rosa_bt_trace":1,"model":"x"}\n', "version 1; this program reads version 4"),
        (HEAD + '{"tick":0}\n', r":2: not a line of a trace"),
        (HEAD + '{"tick":0,"time":0.0,"visited":[[1]]}\n', r":2: not a line of a trace"),
        (HEAD + '"tick"\n', r":2: not a line of a trace"),
        (HEAD + '{"tick":1e999,"time":0.0}\n', r":2: not a line of a trace"),
    ],
)
def test_file_that_is_no_trace_is_refused_with_its_line(tmp_path, text, message):
    path = tmp_path / "run.jsonl"
    path.write_text(text)
    with pytest.raises(TraceError, match=message):
        read_trace(path)


class Between(Running):
    """Has another thread tell something, now and then, while it is ticked.

    Of the replay nothing.
    """

    def __init__(self, name, kb, told):
        super().__init__(name)
        self.kb = kb
        self.told = list(told)

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
    either = Selector("either", memory=False, children=[asked, Act(kb, "charge")])
    mission = FailureIsSuccess("go on", RunningIsSuccess("go on", act(kb)))
    return Sequence(
        "root", memory=False, children=[mission, either, Between("late", kb, told[1::2])]
    )


TOLD_WITHIN = st.sampled_from(["light", "energy", "fail", "recover", "assert", "forbid", "allow"])


@settings(max_examples=60, deadline=None)
@given(st.lists(st.none() | st.tuples(TOLD_WITHIN, st.integers(0, 9)), max_size=16))
def test_facts_of_another_thread_are_replayed_in_their_place(tmp_path_factory, told):
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


class TakesTime(Running):
    """A leaf during which the clock goes on; it decides nothing."""

    def __init__(self, clock):
        super().__init__("slow")
        self.clock = clock

    def update(self):
        self.clock[0] += 0.003
        return super().update()


def test_what_time_does_within_a_tick_is_replayed_in_its_place():
    def build(kb, clock):
        first, later = (IsActionFeasible(name, kb, "inspect") for name in ("first", "later"))
        policy = ParallelPolicy.SuccessOnAll(synchronise=False)
        return Parallel("p", policy=policy, children=[first, TakesTime(clock), later])

    model = Model("lamp")
    light = model.quality_attribute("light")
    model.action("inspect", constraints=[(light >= 0.5).steady(dwell=1.0)])
    now = [1.0]
    kb = KnowledgeBase(model, clock=lambda: now[0])
    runner = TreeRunner(build(kb, now), clock=lambda: now[0])
    with TraceVisitor(kb) as visitor:
        runner.tree.add_visitor(visitor)
        kb.measure("light", 0.9)
        kb.measure("light", 0.1)
        for now[0] in (1.1, 1.999, 2.1):
            runner.tick()
        trace = visitor.trace
    first, _, later, _ = trace.ticks[1].visited
    assert (first.status, later.status) == ("SUCCESS", "FAILURE")
    assert replay_trace(trace, model, lambda kb: build(kb, [0.0])) == trace
