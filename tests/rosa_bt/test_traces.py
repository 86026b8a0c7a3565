"""A trace holds every tick as data, is the same for the same run, and can be decided once more."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from py_trees.behaviours import Running, StatusQueue
from py_trees.common import Status
from py_trees.composites import Sequence

from kb import ConfigurationManager, KnowledgeBase, Model
from rosa_bt import RosaAction, TreeRunner, do_until_unfeasible, feasible_then_act
from rosa_bt.exceptions import TraceError
from rosa_bt.facts import Fact, Listener
from rosa_bt.replay import replay_trace
from rosa_bt.traces import Trace, read_trace
from rosa_bt.visitors import TraceVisitor


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
        assert str(read_trace(path)) == str(trace)
        assert str(replay_trace(read_trace(path), rover(), tree)) == str(trace)
    assert str(run(told)) == str(trace), "the same run gives the same trace"


def test_facts_of_one_gap_between_ticks_are_in_the_order_of_their_times_and_several_choices_are_one():
    model, now = rover(), 0.0
    kb = KnowledgeBase(model, clock=lambda: now)
    listener = Listener(kb)
    kb.request_action("explore")
    kb.finish_plan(kb.select(designs={"look": "by_camera"}, configurations={"camera": "day"}), "completed")
    now = 1.0
    kb.assert_selected("by_camera", False, "a person (who knows) says so")
    facts = listener.take_facts()
    assert [(fact.time, fact.verb) for fact in facts] == [
        (0.0, "request_action"),
        (0.0, "select"),
        (0.0, "finish_plan"),
        (1.0, "assert_selected"),
    ]
    assert facts[-1].arguments == ("by_camera", False, "a person (who knows) says so")
    kb.select(designs={"look": "by_camera"}, configurations={"camera": "day"})
    kb.cancel_action("explore")
    listener.take_facts()
    assert kb.select() is None, "both are given up, and there is nothing to do for that"
    assert listener.take_facts() == (Fact(1.0, "select", ({}, {}, "")),)


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
    assert first.facts[0] == (0.0, "measure", ("energy", 1.0))
    assert first.decisions == (("explore", "requested", ""),)
    assert [fact for fact in third.facts if fact.verb == "measure"] == [(1.0, "measure", ("energy", 0.1))]
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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("nonsense\n", r":1:1: not JSON"),
        ("[]\n", r":1: no line of a trace"),
        ('{"rosa_bt_trace":2,"model":"x"}\n', "version 2; this program reads version 1"),
        ('{"rosa_bt_trace":1,"model":"x"}\n{"tick":0}\n', r":2: no line of a trace"),
        ('{"rosa_bt_trace":1,"model":"x"}\n{"tick":0,"time":0.0,"visited":[[1]]}\n', r":2: no line of a trace"),
        ('{"rosa_bt_trace":1,"model":"x"}\n"tick"\n', r":2: no line of a trace"),
        ('{"rosa_bt_trace":1,"model":"x"}\n{"tick":1e999,"time":0.0}\n', r":2: no line of a trace"),
        pytest.param("[" * 100_000, r":1: no line of a trace \(RecursionError", id="deep"),
    ],
)
def test_file_that_is_no_trace_is_refused_with_its_line(tmp_path, text, message):
    path = tmp_path / "run.jsonl"
    path.write_text(text)
    with pytest.raises(TraceError, match=message):
        read_trace(path)


@pytest.mark.parametrize(
    ("fact", "message"),
    [
        ('[0,"explode",[]]', "'explode' is no fact; facts are measure, "),
        ('[0,"measure",["light"]]', r"measure\('light',\) cannot be told again"),
        ('[0,"finish_plan",[3,"completed"]]', "finish_plan.3, 'completed'. cannot be told again"),
    ],
)
def test_fact_that_nobody_knows_is_refused(tmp_path, fact, message):
    path = tmp_path / "run.jsonl"
    path.write_text(f'{{"rosa_bt_trace":1,"model":"x"}}\n{{"tick":0,"time":0.0,"visited":[],"facts":[{fact}]}}\n')
    with pytest.raises(TraceError, match=message):
        replay_trace(read_trace(path), rover(), tree)


def test_guarded_leaf_is_in_the_trace_as_it_ended():
    kb = KnowledgeBase(rover(), clock=lambda: 0.0)
    runner = TreeRunner(feasible_then_act(Act("charge", kb, "charge")), clock=lambda: 0.0)
    visitor = TraceVisitor(kb)
    runner.tree.add_visitor(visitor)
    runner.tick()
    assert [visit.status for visit in visitor.trace.ticks[0].visited] == ["SUCCESS", "RUNNING", "RUNNING"]
    visitor.close()
