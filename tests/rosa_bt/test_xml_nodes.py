"""Each node that is read, by example: one for each row of the table in docs/trees_in_xml.md."""

import re
from itertools import cycle
from pathlib import Path

import pytest
from py_trees import common, composites, decorators
from py_trees.behaviours import Running
from py_trees.common import Status
from xml_leaves import Action, Condition, registry_of, trace, wrapped

from rosa_bt import BehaviourRegistry, RosaBtError, TreeRunner, export_xml, load_xml
from rosa_bt.xml.controls import NODES

PAGE = Path(__file__).parents[2] / "docs" / "trees_in_xml.md"

EXAMPLES = {
    "Sequence": (
        "<Sequence><c/><a/><b/></Sequence>",
        "a:RS b:RF c:S",
        "c:S a:s:R | a:r:S b:s:R | b:r:F => F",
    ),
    "AsyncSequence": (
        "<AsyncSequence><c/><a/><b/></AsyncSequence>",
        "a:S b:S c:S",
        "c:S | a:s:S | b:s:S => S",
    ),
    "SequenceWithMemory": (
        "<SequenceWithMemory><a/><b/></SequenceWithMemory>",
        "a:S b:FS",
        "a:s:S | b:s:F => F | b:s:S => S | a:s:S",
    ),
    "ReactiveSequence": (
        "<ReactiveSequence><c/><a/></ReactiveSequence>",
        "a:RR c:SSF",
        "c:S a:s:R | c:S a:r:R | c:F a:halt => F",
    ),
    "Fallback": (
        "<Fallback><c/><a/><b/></Fallback>",
        "a:RF b:RS c:F",
        "c:F a:s:R | a:r:F b:s:R | b:r:S => S",
    ),
    "AsyncFallback": ("<AsyncFallback><c/><a/></AsyncFallback>", "a:S c:F", "c:F | a:s:S => S"),
    "ReactiveFallback": (
        "<ReactiveFallback><c/><a/></ReactiveFallback>",
        "a:RR c:FFS",
        "c:F a:s:R | c:F a:r:R | c:S a:halt => S",
    ),
    "Parallel": (
        '<Parallel success_count="2" failure_count="1"><a/><b/><c/></Parallel>',
        "a:SR b:RRS c:F",
        "a:s:S b:s:R c:F b:halt => F | a:s:R b:s:R c:F a:halt b:halt => F | a:s:S b:s:S => S",
    ),
    "ParallelAll": (
        '<ParallelAll max_failures="2"><a/><b/><c/></ParallelAll>',
        "a:RF b:RRS c:F",
        "a:s:R b:s:R c:F | a:r:F b:r:R | b:r:S => F",
    ),
    "IfThenElse": (
        "<IfThenElse><c/><a/><b/></IfThenElse>",
        "a:RS b:RF c:SF",
        "c:S a:s:R | a:r:S => S | c:F b:s:R | b:r:F => F",
    ),
    "WhileDoElse": (
        "<WhileDoElse><c/><a/><b/></WhileDoElse>",
        "a:R b:R c:SSFS",
        "c:S a:s:R | c:S a:r:R | c:F a:halt b:s:R | c:S b:halt a:s:R",
    ),
    "Switch2 … Switch6": (
        '<Switch2 variable="{v}" case_1="1" case_2="up"><a/><b/><c/></Switch2>',
        "a:R b:S c:F",
        "v=1.0 a:s:R | v=up a:halt b:s:S => S | v=down c:F => F",
    ),
    "Inverter": ("<Inverter><a/></Inverter>", "a:RSF", "a:s:R | a:r:S => F | a:s:F => S"),
    "ForceSuccess, ForceFailure": (
        "<Sequence><ForceSuccess><a/></ForceSuccess><ForceFailure><b/></ForceFailure></Sequence>",
        "a:RF b:S",
        "a:s:R | a:r:F b:s:S => F",
    ),
    "KeepRunningUntilFailure": (
        "<KeepRunningUntilFailure><a/></KeepRunningUntilFailure>",
        "a:SRSF",
        "a:s:S | a:s:R | a:r:S | a:s:F => F",
    ),
    "Repeat": (
        '<Repeat num_cycles="3"><a/></Repeat>',
        "a:SRSF",
        "a:s:S | a:s:R | a:r:S a:s:F => F",
    ),
    "RetryUntilSuccessful": (
        '<RetryUntilSuccessful num_attempts="-1"><a/></RetryUntilSuccessful>',
        "a:FRFS",
        "a:s:F | a:s:R | a:r:F a:s:S => S",
    ),
    "RunOnce": (
        '<Fallback><RunOnce><a/></RunOnce><RunOnce then_skip="false"><b/></RunOnce></Fallback>',
        "a:F b:RS",
        "a:s:F b:s:R | b:r:S => S | => S",
    ),
    "Delay": (
        '<Delay delay_msec="1000"><a/></Delay>',
        "a:RS",
        "t=0 | t=0.9 | t=1.0 a:s:R | t=1.1 a:r:S => S | t=1.2",
    ),
    "Timeout": (
        '<Timeout msec="1000"><a/></Timeout>',
        "a:R",
        "t=0 a:s:R | t=0.9 a:r:R | t=1.0 a:halt => F | t=1.1 a:s:R | t=2.0 a:r:R",
    ),
    "Precondition": (
        '<Precondition if="v == 1" else="SUCCESS"><a/></Precondition>',
        "a:RRS",
        "v=0 => S | v=1 a:s:R | v=0 a:r:R | v=0 a:r:S => S | v=0 => S",
    ),
    "TryCatch": (
        '<ReactiveSequence><ScriptCondition code="v == 1"/>'
        '<TryCatch catch_on_halt="true"><a/><b/><d/></TryCatch></ReactiveSequence>',
        "a:S b:RFR d:RS",
        "v=1 a:s:S b:s:R | v=1 b:r:F d:s:R | v=1 d:r:S => F | v=1 a:s:S b:s:R | v=0 b:halt d:s:R d:halt => F",
    ),
    "LoopInt, LoopDouble, LoopBool, LoopString": (
        '<Sequence><LoopInt queue="1;2" value="{n}"><a _failureIf="n == v"/></LoopInt>'
        '<LoopDouble queue="0.5" if_empty="SKIPPED"><b/></LoopDouble><LoopBool queue="true"><b/></LoopBool>'
        '<LoopString queue="x;y"><b/></LoopString></Sequence>',
        "a:RSS b:S",
        "v=0 a:s:R | v=0 a:r:S | v=0 a:s:S | v=0 b:s:S | v=0 b:s:S | v=0 b:s:S | v=0 b:s:S | v=0 => S | v=1 => F",
    ),
    "WasEntryUpdated": ('<WasEntryUpdated entry="{v}"/>', "", "=> F | v=1 => S | => F | v=1 => S"),
    "SkipUnlessUpdated, WaitValueUpdate": (
        '<Fallback><SkipUnlessUpdated entry="v"><a/></SkipUnlessUpdated>'
        '<WaitValueUpdate entry="{w}"><b/></WaitValueUpdate></Fallback>',
        "a:RF b:RS",
        "w=0 b:s:R | v=1 b:r:S => S | a:s:R | a:r:F | w=0 b:s:R",
    ),
    "SubTree": ('<SubTree ID="Other" x="1" y="{v}"/>', "a:RS", "v=7 a:s:R | v=8 a:r:S => S"),
    "AlwaysSuccess, AlwaysFailure": (
        "<Sequence><AlwaysSuccess/><AlwaysFailure/></Sequence>",
        "",
        "=> F",
    ),
    "Script": (
        '<Sequence><Script code="x := 2; x = 3"/><a _skipIf="x != 3"/></Sequence>',
        "a:S",
        "a:s:S => S",
    ),
    "ScriptCondition": (
        '<ScriptCondition code="v &gt; 1 &amp;&amp; v &lt;= 3"/>',
        "",
        "v=1 => F | v=2 => S",
    ),
    "SetBlackboard, UnsetBlackboard": (
        '<Sequence><SetBlackboard value="{v}" output_key="w"/><ScriptCondition code="w == 5"/>'
        '<UnsetBlackboard key="v"/></Sequence>',
        "",
        "v=5 => S | v=6 => F",
    ),
    "Sleep": ('<Sleep msec="500"/>', "", "t=0 | t=0.4 | t=0.5 => S | t=0.6"),
    "RecoveryNode": (
        '<RecoveryNode number_of_retries="1"><a/><b/></RecoveryNode>',
        "a:RF b:S",
        "a:s:R | a:r:F b:s:S a:s:R | a:r:F => F",
    ),
    "PipelineSequence": (
        "<PipelineSequence><a/><b/></PipelineSequence>",
        "a:SRRS b:RRF",
        "a:s:S b:s:R | b:r:R | b:r:F => F | a:s:R | a:r:R | a:r:S b:s:R",
    ),
    "RateController": (
        '<PipelineSequence><RateController hz="0.5"><a/></RateController><b/></PipelineSequence>',
        "a:RSF b:RRRRR",
        "t=0 a:s:R | t=1 a:r:S b:s:R | t=2 b:r:R | t=3 a:s:F b:halt => F",
    ),
    "SingleTrigger": (
        "<PipelineSequence><SingleTrigger><a/></SingleTrigger><b/></PipelineSequence>",
        "a:RS b:RR",
        "a:s:R | a:r:S b:s:R | b:halt => F | a:s:R",
    ),
    "GoalUpdatedController": (
        '<PipelineSequence><GoalUpdatedController goal="{g}"><a/></GoalUpdatedController><b/></PipelineSequence>',
        "a:RSS b:R",
        "g=1 a:s:R | g=1 a:r:S b:s:R | g=1 b:r:R | g=2 a:s:S b:r:R | g=2 b:r:R",
    ),
    "RoundRobin": (
        "<RoundRobin><a/><b/></RoundRobin>",
        "a:SF b:FS",
        "a:s:S => S | b:s:F => F | a:s:F b:s:S => F",
    ),
    "NonblockingSequence": (
        "<NonblockingSequence><a/><c/><b/></NonblockingSequence>",
        "a:RS b:SRRF c:S",
        "a:s:R c:S b:s:S | a:r:S c:S => S | a:s:R c:S b:s:R | a:r:S c:S b:r:R | c:S b:r:F => F",
    ),
    "PersistentSequence": (
        '<PersistentSequence current_child_idx="{i}"><a/><b/></PersistentSequence>',
        "a:SS b:RFS",
        "i=0 a:s:S b:s:R | i=1 b:r:F => F | i=1 b:s:S => S | i=0 a:s:S b:s:R",
    ),
    "PauseResumeController": (
        "<PauseResumeController><a/><b/></PauseResumeController>",
        "a:RS b:R",
        "a:s:R | a:r:S => S",
    ),
}
SHORT = {"S": "SUCCESS", "F": "FAILURE"}


class Hand:
    """A clock that is turned by hand [s]."""

    now = 0.0

    def __call__(self):
        return self.now


def leaves_of(scripts):
    """Return leaves by tag, of scripts such as `a:RS c:F`; c is a condition, the others are actions."""
    split = [leaf.split(":") for leaf in scripts.split()]
    return {name: ("C" if name == "c" else "A", script) for name, script in split}


def perform(tree, said, told, clock):
    """Tick a tree as often as is told, and return what happened in the words in which it is told."""
    happened = []
    for step in told.split(" | "):
        given = [word for word in step.split() if "=" in word and word != "=>"]
        for word in given:
            name, value = word.split("=")
            if name == "t":
                clock.now = float(value)
            else:
                tree.blackboard[name] = float(value) if value.replace(".", "").isdigit() else value
        said.clear()
        tree.tick_once()
        words = [*given, *(word.replace(":c:", ":") for word in said)]
        if tree.status is not Status.RUNNING:
            words += ["=>", tree.status.name[0] if tree.status is not Status.INVALID else "SKIPPED"]
        happened.append(" ".join(words))
    return " | ".join(happened)


@pytest.mark.parametrize("row", EXAMPLES)
def test_node_does_what_its_row_says(row):
    text, leaves, told = EXAMPLES[row]
    said, clock = [], Hand()
    other = '<Sequence><a _while="x == 1 &amp;&amp; y >= 7"/></Sequence>'
    tree = load_xml(wrapped(text, Other=other), registry_of(leaves_of(leaves), said), clock=clock)
    assert perform(tree, said, told, clock) == " ".join(told.split())


def test_every_row_of_the_page_has_an_example_and_every_node_a_row():
    rows = re.findall(r"^\| `([^|]+)` \|", PAGE.read_text(), re.MULTILINE)
    rows = [row.replace("`", "") for row in rows]
    assert sorted(rows) == sorted(EXAMPLES)
    words = [*re.findall(r"\w+", " ".join(rows)), "Switch3", "Switch4", "Switch5"]
    assert sorted(words) == sorted([*NODES, "SubTree"])


RULES = {
    "_skipIf": (
        '<Sequence><a _skipIf="v == 1"/><b/></Sequence>',
        "v=1 b:s:S => S | v=0 a:s:R | v=1 a:r:R",
    ),
    "_failureIf": ('<Sequence><a _failureIf="v == 1"/><b/></Sequence>', "v=1 => F | v=0 a:s:R"),
    "_successIf": ('<Sequence><a _successIf="v == 1"/><b/></Sequence>', "v=1 b:s:S => S"),
    "_while": (
        '<Sequence><a _while="v == 1"/><b/></Sequence>',
        "v=1 a:s:R | v=1 a:r:R | v=0 a:halt b:s:S => S",
    ),
    "_onSuccess": (
        '<Sequence><b _onSuccess="n := 1"/><ScriptCondition code="n == 1"/></Sequence>',
        "b:s:S => S",
    ),
    "_onFailure": (
        '<Fallback><c _onFailure="n := 1"/><ScriptCondition code="n == 1"/></Fallback>',
        "c:F => S",
    ),
    "_post": (
        '<Fallback><c _post="n := 1"/><ScriptCondition code="n == 1"/></Fallback>',
        "c:F => S",
    ),
    "_onHalted": (
        '<Sequence><ScriptCondition code="v == 1 || h == 1"/><SubTree ID="Other" v="{v}" h="{h}"/></Sequence>',
        "v=1 h=0 a:s:R | v=0 a:halt => F | v=0 a:s:R",
    ),
    "several": (
        '<a _failureIf="v == 1" _skipIf="v >= 1" _while="v == 0"/>',
        "v=1 => F | v=2 => SKIPPED | v=0 a:s:R",
    ),
}


@pytest.mark.parametrize("rule", RULES)
def test_condition_before_or_after_a_node_is_kept(rule):
    text, told = RULES[rule]
    said, clock = [], Hand()
    other = '<ReactiveSequence><ScriptCondition code="v == 1 || h == 1"/><a _onHalted="h := 1"/></ReactiveSequence>'
    leaves = {"a": ("A", "R"), "b": ("A", "S"), "c": ("C", "F")}
    tree = load_xml(wrapped(text, Other=other), registry_of(leaves, said))
    assert perform(tree, said, told, clock) == told


SKIPPED = {
    "Sequence": '<Sequence><a _skipIf="v == 0"/><b _skipIf="v == 0"/></Sequence>',
    "Fallback": '<Fallback><a _skipIf="v == 0"/><b _skipIf="v == 0"/></Fallback>',
    "SequenceWithMemory": '<SequenceWithMemory><a _skipIf="v == 0"/><b _skipIf="v == 0"/></SequenceWithMemory>',
    "ReactiveSequence": '<ReactiveSequence><a _skipIf="v == 0"/><b _skipIf="v == 0"/></ReactiveSequence>',
    "ReactiveFallback": '<ReactiveFallback><a _skipIf="v == 0"/><b _skipIf="v == 0"/></ReactiveFallback>',
    "Parallel": '<Parallel success_count="1"><a _skipIf="v == 0"/><b _skipIf="v == 0"/></Parallel>',
    "ParallelAll": '<ParallelAll><a _skipIf="v == 0"/><b _skipIf="v == 0"/></ParallelAll>',
    "PipelineSequence": '<PipelineSequence><a _skipIf="v == 0"/><b _skipIf="v == 0"/></PipelineSequence>',
    "RoundRobin": '<RoundRobin wrap_around="true"><a _skipIf="v == 0"/><b _skipIf="v == 0"/></RoundRobin>',
    "RecoveryNode": '<RecoveryNode><a _skipIf="v == 0"/><b/></RecoveryNode>',
    "Switch2": '<Switch2 variable="{v}" case_1="1" case_2="2"><b/><b/><a _skipIf="v == 0"/></Switch2>',
    "Repeat": '<Repeat num_cycles="3"><a _skipIf="v == 0"/></Repeat>',
    "RetryUntilSuccessful": '<RetryUntilSuccessful num_attempts="3"><a _skipIf="v == 0"/></RetryUntilSuccessful>',
    "Inverter": '<Inverter><a _skipIf="v == 0"/></Inverter>',
    "ForceSuccess": '<ForceSuccess><a _skipIf="v == 0"/></ForceSuccess>',
    "RunOnce": '<RunOnce><a _skipIf="v == 0"/></RunOnce>',
    "Timeout": '<Timeout msec="10"><a _skipIf="v == 0"/></Timeout>',
    "Delay": '<Delay delay_msec="0"><a _skipIf="v == 0"/></Delay>',
    "SubTree": '<SubTree ID="Other" _skipIf="v == 0"/>',
}


@pytest.mark.parametrize("tag", SKIPPED)
def test_node_whose_children_are_all_skipped_is_skipped_and_begins_later(tag):
    said = []
    leaves = {"a": ("A", "R"), "b": ("A", "R")}
    tree = load_xml(wrapped(SKIPPED[tag], Other="<a/>"), registry_of(leaves, said), clock=Hand())
    happened = perform(tree, said, "v=0 | v=0 | v=3", Hand()).split(" | ")
    assert happened[:2] == ["v=0 => SKIPPED", "v=0 => SKIPPED"]
    assert happened[2].startswith("v=3 a:s:R")


MIXED = {
    "Sequence": ('<Sequence><a _skipIf="true"/><b/></Sequence>', "b:S", "b:s:S => S"),
    "Fallback": ('<Fallback><a _skipIf="true"/><b/></Fallback>', "b:F", "b:s:F => F"),
    "Parallel": ('<Parallel><a _skipIf="true"/><b/></Parallel>', "b:S", "b:s:S => S"),
    "Parallel of all": (
        '<Parallel><a _skipIf="true"/><b _skipIf="true"/></Parallel>',
        "b:S",
        "=> S",
    ),
    "Parallel that counts": (
        '<Parallel success_count="2"><a _skipIf="true"/><b/></Parallel>',
        "b:S",
        "b:s:S",
    ),
    "ParallelAll": (
        '<ParallelAll><a _skipIf="true"/><b/></ParallelAll>',
        "b:RF",
        "b:s:R | b:r:F => F",
    ),
    "KeepRunningUntilFailure": (
        '<KeepRunningUntilFailure><a _skipIf="v == 0"/></KeepRunningUntilFailure>',
        "a:F",
        "v=0 | v=0 | v=1 a:s:F => F",
    ),
    "RecoveryNode": (
        '<RecoveryNode><a/><b _skipIf="true"/></RecoveryNode>',
        "a:F b:S",
        "a:s:F => F | a:s:F => F",
    ),
    "Timeout that found nothing to halt": (
        '<Timeout msec="100"><a _skipIf="v == 0"/></Timeout>',
        "a:R",
        "t=0 v=0 => SKIPPED | t=1 v=0 => SKIPPED | t=2 v=1 a:s:R | t=3 v=1 a:r:R",
    ),
    "what was skipped within is not asked whether it begins": (
        '<Sequence _failureIf="v == 1"><a _skipIf="v == 0"/></Sequence>',
        "a:R",
        "v=0 => SKIPPED | v=1 a:s:R",
    ),
    "what has finished is not asked whether it goes on": (
        '<WhileDoElse><a _while="v == 1"/><b/></WhileDoElse>',
        "a:S b:R",
        "v=1 a:s:S b:s:R | v=0 b:r:R",
    ),
}


@pytest.mark.parametrize("case", MIXED)
def test_child_that_was_skipped_counts_as(case):
    text, leaves, told = MIXED[case]
    said, clock = [], Hand()
    leaves = {"a": ("A", "S"), **leaves_of(leaves)}
    tree = load_xml(wrapped(text), registry_of(leaves, said), clock=clock)
    assert perform(tree, said, told, clock) == told


@pytest.mark.parametrize(
    "text",
    [
        "<IfThenElse><a _skipIf='true'/><b/></IfThenElse>",
        "<WhileDoElse><a _skipIf='true'/><b/></WhileDoElse>",
        "<Parallel success_count='2'><a/></Parallel>",
        "<ParallelAll max_failures='2'><a/></ParallelAll>",
        "<Script code='v = 1'/>",
        "<ScriptCondition code='nobody == 1'/>",
        "<Script code=\"v := 'x' == 1\"/>",
        "<a _skipIf=\"'x'\"/>",
    ],
)
def test_what_cannot_be_decided_raises_and_fails_in_a_runner(text):
    leaves = {"a": ("A", "S"), "b": ("A", "S")}
    tree = load_xml(wrapped(text), registry_of(leaves, []))
    with pytest.raises(RosaBtError):
        tree.tick_once()
    tree = load_xml(wrapped(text), registry_of(leaves, []))
    TreeRunner(tree, clock=lambda: 0.0).tick()
    assert tree.status is Status.FAILURE


def test_leaf_that_was_stopped_before_its_parent_is_not_halted_twice():
    said = []
    tree = load_xml(
        wrapped("<Parallel><a/><b/></Parallel>"), registry_of(leaves_of("a:R b:R"), said)
    )
    runner = TreeRunner(tree, clock=lambda: 0.0)
    runner.tick()
    said.clear()
    runner.shutdown()
    assert said == ["a:halt", "b:halt"]
    assert [one.feedback_message for one in tree.iterate()] == [""] * 4


def test_how_often_is_asked_only_when_a_child_has_ended_so_that_it_may_write_it_itself():
    text = '<RateController hz="{hz}"><Script code="hz := 1"/></RateController>'
    tree = load_xml(wrapped(text), BehaviourRegistry())
    tree.tick_once()
    assert tree.status is Status.SUCCESS


def test_action_that_failed_as_a_condition_is_not_started_again():
    said = []
    tree = load_xml(
        wrapped("<IfThenElse><a/><b/></IfThenElse>"),
        registry_of({"a": ("A", "F"), "b": ("A", "S")}, said),
    )
    assert perform(tree, said, "a | b", Hand()) == "a:s:F => F | => F"


@pytest.mark.parametrize(
    ("tag", "leaves", "namesake"),
    [
        (
            "SequenceWithMemory",
            "a:S b:FS",
            lambda a, b: composites.Sequence("s", memory=True, children=[a, b]),
        ),
        (
            'Parallel success_count="1"',
            "a:S b:R",
            lambda a, b: composites.Parallel("p", common.ParallelPolicy.SuccessOnOne(), [a, b]),
        ),
        ('Repeat num_cycles="2"', "a:RS", lambda a: decorators.Repeat("r", a, num_success=2)),
        (
            'RetryUntilSuccessful num_attempts="2"',
            "a:RF",
            lambda a: decorators.Retry("r", a, num_failures=2),
        ),
        (
            "RunOnce",
            "a:S",
            lambda a: decorators.OneShot("o", a, common.OneShotPolicy.ON_COMPLETION),
        ),
        (
            "ReactiveSequence",
            "a:S b:R",
            lambda a, b: composites.Sequence("s", memory=False, children=[a, b]),
        ),
        (
            "Sequence",
            "c:S a:RF",
            lambda c, a: composites.Sequence("s", memory=True, children=[c, a]),
        ),
        (
            "Fallback",
            "c:F a:RS",
            lambda c, a: composites.Selector("f", memory=True, children=[c, a]),
        ),
        (
            "ReactiveFallback",
            "c:FS a:R",
            lambda c, a: composites.Selector("f", memory=False, children=[c, a]),
        ),
        ("KeepRunningUntilFailure", "a:SF", lambda a: decorators.SuccessIsRunning("k", a)),
        ("ForceSuccess", "a:RF", lambda a: decorators.FailureIsSuccess("f", a)),
        ("Inverter", "a:RF", lambda a: decorators.Inverter("i", a)),
    ],
)
def test_namesake_in_py_trees_differs_where_the_page_says_so(tag, leaves, namesake):
    said, scripts = [], leaves_of(leaves)
    content = "".join(f"<{name}/>" for name in scripts)
    tree = load_xml(wrapped(f"<{tag}>{content}</{tag.split()[0]}>"), registry_of(scripts, said))
    ours = trace(tree.tick_once, tree, said, 6)
    kinds = {"A": Action, "C": Condition}
    made = {
        name: kinds[kind](name, cycle(script), said) for name, (kind, script) in scripts.items()
    }
    theirs = namesake(*made.values())
    row = next(
        line
        for line in PAGE.read_text().splitlines()
        if re.match(rf"\| `.*\b{tag.split()[0]}\b.*` \|", line)
    )
    says_same = row.split("|")[-2].strip().startswith("the same")
    assert (trace(theirs.tick_once, theirs, said, 6) == ours) == says_same


@pytest.mark.parametrize("tag", ["Sequence", "Fallback", "SequenceWithMemory"])
def test_child_that_ran_and_is_then_skipped_counts_as_skipped(tag):
    said = []
    content = f'<Sequence><Script code="n := 0"/><{tag}><a _while="n == 0"/></{tag}></Sequence>'
    tree = load_xml(wrapped(content), registry_of({"a": ("A", "R")}, said))
    tree.tick_once()
    tree.blackboard["n"] = 1
    tree.children[0].tick_once()
    assert said[-1] == "a:halt"
    (inner,) = (
        one for one in tree.iterate() if type(one).__name__ == tag and one.children[0].name == "a"
    )
    assert inner.status is Status.INVALID


def test_what_takes_the_place_of_a_child_keeps_the_rules_of_the_place():
    said = []
    registry = registry_of({"a": ("A", "R"), "b": ("A", "R")}, said)
    tree = load_xml(wrapped('<Sequence><a _skipIf="n == 1"/></Sequence>'), registry)
    tree.blackboard["n"] = 1
    runner = TreeRunner(tree, clock=lambda: 0.0)
    runner.tick()
    (leaf,) = (one for one in tree.iterate() if one.name == "a")
    runner.tree.replace_subtree(leaf.id, Running("c"))
    runner.tick()
    assert tree.status is Status.INVALID, "it is skipped as the one before was"
    assert '<keep_on name="c" _skipIf="n == 1" />' in export_xml(tree, knowing_running())
    tree.blackboard["n"] = 0
    runner.tick()
    assert tree.status is Status.RUNNING


def knowing_running():
    registry = BehaviourRegistry()
    registry.register("keep_on", Running)
    return registry


OBSERVED = {
    "Switch2 compares what its texts begin with": (
        '<Switch2 variable="{v}" case_1="2abc" case_2="1"><a/><b/><d/></Switch2>',
        "v=1.5 b:s:S => S | v=2.9 a:s:S => S | v=-1 d:s:S => S",
    ),
    "Repeat reads its port once a tick": (
        '<Repeat num_cycles="{v}"><UnsetBlackboard key="v"/></Repeat>',
        "v=2 | v=1 => S",
    ),
    "RunOnce takes what is no truth value for true": (
        '<RunOnce then_skip="{gone}"><a/></RunOnce>',
        "a:s:S => S | => SKIPPED",
    ),
    "SetBlackboard writes to the key that a number is as text": (
        '<Sequence><SetBlackboard value="word" output_key="{v}"/><WasEntryUpdated entry="2.000000"/></Sequence>',
        "v=2 => S",
    ),
    "nan is less than all, and more": (
        '<Sequence><Script code="n := 0 / 0"/><ScriptCondition code="n &lt; v &amp;&amp; n &gt;= v &amp;&amp; n != v"/>'
        '<ScriptCondition code="~1.5 == -2"/></Sequence>',
        "v=1 => S",
    ),
    "SetBlackboard copies a number over one of its kind": (
        '<Sequence><SetBlackboard value="{v}" output_key="w"/><ScriptCondition code="w == v"/></Sequence>',
        "v=1 w=2 => S",
    ),
}


@pytest.mark.parametrize("case", OBSERVED)
def test_behaviortree_cpp_was_seen_to_do(case):
    text, told = OBSERVED[case]
    said, clock = [], Hand()
    tree = load_xml(wrapped(text), registry_of(leaves_of("a:S b:S d:S"), said), clock=clock)
    assert perform(tree, said, told, clock) == told


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('<Precondition if="true" else="NEVER"><a/></Precondition>', {}),
        ('<Repeat num_cycles="{gone}"><a/></Repeat>', {}),
        ('<SetBlackboard value="{x}" output_key="y"/>', {"x": True, "y": 0.5}),
        ('<SetBlackboard value="{x}" output_key="y"/>', {"x": "word", "y": 3}),
        (
            '<Fallback><WasEntryUpdated entry="{y}"/><SetBlackboard value="7" output_key="y"/></Fallback>',
            {},
        ),
    ],
)
def test_behaviortree_cpp_was_seen_to_raise_in_the_first_tick(text, told):
    tree = load_xml(wrapped(text), registry_of({"a": ("A", "S")}, []))
    tree.blackboard.update(told)
    with pytest.raises(RosaBtError):
        tree.tick_once()


def test_branch_that_runs_is_halted_before_a_skipped_condition_is_an_error():
    said = []
    text = '<WhileDoElse><Inverter><AlwaysFailure _skipIf="v == 1"/></Inverter><a/></WhileDoElse>'
    tree = load_xml(wrapped(text), registry_of({"a": ("A", "R")}, said))
    perform(tree, said, "v=0", Hand())
    with pytest.raises(RosaBtError):
        perform(tree, said, "v=1", Hand())
    assert said == ["a:halt"]


def test_round_robin_that_wraps_goes_on_with_the_first():
    said = []
    registry = registry_of({"a": ("A", "SF"), "b": ("A", "FS")}, said)
    tree = load_xml(wrapped('<RoundRobin wrap_around="true"><a/><b/></RoundRobin>'), registry)
    assert [line.partition(" => ")[2] for line in trace(tree.tick_once, tree, said, 4)] == [
        *("SUCCESS", "FAILURE", "SUCCESS", "SUCCESS")
    ]


def test_pause_and_resume_tick_their_children_to_the_end():
    said = []
    leaves = {
        name: ("A", script) for name, script in {"a": "R", "b": "R", "c": "RS", "d": "S"}.items()
    }
    text = wrapped("<PauseResumeController><a/><b/><c/><d/></PauseResumeController>")
    tree = load_xml(text, registry_of(leaves, said))
    node = tree.child.node
    assert not node.resume()
    happened = []
    for call in (None, node.pause, None, None, node.resume, None, None):
        if call is not None:
            assert call()
        said.clear()
        tree.tick_once()
        happened.append(" ".join(said))
    assert happened == ["a:s:R", "a:halt c:s:R", "c:r:S", "b:s:R", "b:halt d:s:S", "a:s:R", "a:r:R"]
    assert not node.resume()


def test_nonblocking_sequence_cannot_skip_a_child():
    text = wrapped('<NonblockingSequence><a _skipIf="true"/></NonblockingSequence>')
    with pytest.raises(RosaBtError, match="'a' was skipped"):
        load_xml(text, registry_of({"a": ("A", "R")}, [])).tick_once()
