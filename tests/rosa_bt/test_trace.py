"""A trace holds every tick as data, is the same for the same run, and can be decided once more."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from py_trees.behaviours import Running, StatusQueue
from py_trees.common import Status
from py_trees.composites import Sequence

from kb import ConfigurationManager, KnowledgeBase, Model
from rosa_bt import (
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


def tree(kb):
    act = do_until_unfeasible(Act("explore", kb, "explore", wait=True), Act("charge", kb, "charge"), name="mission")
    return Sequence("root", memory=True, children=[act, Running("never")])


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
    "assert": lambda kb, number: kb.assert_status(kb.actions["explore"], "unfeasible", "a person says so", kb.now + 1),
    "condemn": lambda kb, number: kb.assert_status("by_camera", "unfeasible"),
    "acquit": lambda kb, number: kb.retract_status("by_camera"),
    "ask": lambda kb, number: kb.request_action("charge"),
    "stop asking": lambda kb, number: kb.cancel_action("charge", "failed", "a person says so"),
}
TELLING = st.lists(st.lists(st.tuples(st.sampled_from(sorted(TOLD)), st.integers(0, 9)), max_size=3), max_size=8)


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
    assert [one[:4] for one in first.events] == [(1, 0.0, "measure", ("energy", 1.0))]
    assert [(one.verb, one.subject) for one in first.own_events] == [("request_action", "explore")]
    assert first.decisions == (("explore", "requested", ""),)
    assert [one[1:4] for one in third.events if one.verb == "measure"] == [(1.0, "measure", ("energy", 0.1))]
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


def test_tick_that_is_like_the_one_before_takes_few_bytes(tmp_path):
    path = tmp_path / "run.jsonl"
    run([[]] * 50, path)
    assert [line for line in path.read_text().splitlines() if json.loads(line).keys() == {"tick", "time"}][40:]


def test_tree_that_has_changed_is_written_again():
    kb = KnowledgeBase(rover(), clock=lambda: 0.0)
    root = Sequence("root", memory=False, children=[StatusQueue("a", queue=[], eventually=Status.SUCCESS)])
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


def test_what_is_told_after_a_trace_is_closed_is_not_heard():
    kb = KnowledgeBase(rover(), clock=lambda: 0.0)
    visitor = TraceVisitor(kb)
    visitor.close()
    kb.measure("light", 0.5)
    visitor.initialise()
    assert visitor.trace == Trace("rover", ())


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
    assert [one.verb for one in visitor.trace.ticks[0].events] == ["request_action", "measure"]
    assert replay_trace(visitor.trace, rover(), tree).ticks[0].visited == visitor.trace.ticks[0].visited


def test_trace_without_its_first_events_says_so():
    (tick,) = run([[]]).ticks
    late = Trace("rover", (tick._replace(events=tick.events[1:]),))
    with pytest.raises(TraceError, match="begins at event 2"):
        replay_trace(late, rover(), tree)


@settings(max_examples=50)
@given(st.text(max_size=8) | st.sampled_from(["a\x85b\u2028c\u2029d\x0be\x1cf", "\udc80", "a\nb\r\n", "é🤖\0"]))
def test_any_text_is_read_as_it_was_written(tmp_path_factory, reason):
    path = tmp_path_factory.getbasetemp() / "odd.jsonl"
    kb = KnowledgeBase(rover(), clock=lambda: 0.0)
    runner = TreeRunner(Running(reason), clock=lambda: 0.0)
    with TraceVisitor(kb, path) as visitor:
        runner.tree.add_visitor(visitor)
        kb.component_failed("camera", reason)
        runner.tick()
    assert read_trace(path) == visitor.trace


HEAD = '{"rosa_bt_trace":2,"model":"x"}\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("nonsense\n", r":1:1: not JSON"),
        ("[]\n", r":1: no line of a trace"),
        ('{"rosa_bt_trace":1,"model":"x"}\n', "version 1; this program reads version 2"),
        (HEAD + '{"tick":0}\n', r":2: no line of a trace"),
        (HEAD + '{"tick":0,"time":0.0,"visited":[[1]]}\n', r":2: no line of a trace"),
        (HEAD + '"tick"\n', r":2: no line of a trace"),
        (HEAD + '{"tick":1e999,"time":0.0}\n', r":2: no line of a trace"),
        pytest.param("[" * 100_000, r":1: no line of a trace \(RecursionError", id="deep"),
    ],
)
def test_file_that_is_no_trace_is_refused_with_its_line(tmp_path, text, message):
    path = tmp_path / "run.jsonl"
    path.write_text(text)
    with pytest.raises(TraceError, match=message):
        read_trace(path)


@pytest.mark.parametrize(("verb", "arguments"), [("explode", []), ("measure", ["light"]), ("amend", ["declared", "x"])])
def test_event_that_cannot_be_told_again_is_named(tmp_path, verb, arguments):
    path = tmp_path / "run.jsonl"
    event = json.dumps({"number": 1, "time": 0.0, "verb": verb, "arguments": arguments})
    path.write_text(f'{HEAD}{event}\n{{"tick":0,"time":0.0,"visited":[]}}\n')
    with pytest.raises(TraceError, match=rf"{verb}\(.*\) cannot be told again"):
        replay_trace(read_trace(path), rover(), tree)


def test_guarded_leaf_is_in_the_trace_as_it_ended():
    kb = KnowledgeBase(rover(), clock=lambda: 0.0)
    runner = TreeRunner(feasible_then_act(Act("charge", kb, "charge")), clock=lambda: 0.0)
    visitor = TraceVisitor(kb)
    runner.tree.add_visitor(visitor)
    runner.tick()
    assert [visit.status for visit in visitor.trace.ticks[0].visited] == ["SUCCESS", "RUNNING", "RUNNING"]
    visitor.close()
