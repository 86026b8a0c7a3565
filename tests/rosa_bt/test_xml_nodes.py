"""The nodes of Nav2, and those that count time; a twin judges the others (test_xml_twin)."""

import re
from pathlib import Path

import pytest
from acting import Clock
from py_trees.common import Status
from xml_leaves import registry_of, wrapped

from rosa_bt import ExportError, RosaBtError, TreeRunner, export_xml, load_xml
from rosa_bt.xml.nodes import NODES

PAGE = Path(__file__).parents[2] / "docs" / "trees_in_xml.md"
EXAMPLES = {
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
        '<PipelineSequence><GoalUpdatedController goal="{g}"><a/></GoalUpdatedController>'
        "<b/></PipelineSequence>",
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
    "RoundRobin that wraps around": (
        '<RoundRobin wrap_around="true"><a/><b/></RoundRobin>',
        "a:SF b:FS",
        "a:s:S => S | b:s:F a:s:F => F | a:s:S => S",
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
    "Sleep": ('<Sleep msec="500"/>', "", "t=0 | t=0.4 | t=0.5 => S | t=0.6"),
}


def leaves_of(scripts):
    """Return leaves by tag, of scripts such as `a:RS c:F`.

    C is a condition, the others are actions.
    """
    split = [leaf.split(":") for leaf in scripts.split()]
    return {name: ("C" if name == "c" else "A", script) for name, script in split}


def perform(tree, said, script, clock):
    """Tick a tree as a script says, and return what happened in its words."""
    happened = []
    for step in script.split(" | "):
        settings = re.findall(r"(\w+)=(\S+)", step)
        for name, value in settings:
            if name == "t":
                clock.now = float(value)
            else:
                tree.blackboard[name] = float(value)
        said.clear()
        tree.tick_once()
        words = ["=".join(setting) for setting in settings]
        words += [word.replace(":c:", ":") for word in said]
        if tree.status is not Status.RUNNING:
            words += ["=>", tree.status.name[0]]
        happened.append(" ".join(words))
    return " | ".join(happened)


@pytest.mark.parametrize("row", EXAMPLES)
def test_node_does_what_its_example_says(row):
    text, leaves, script = EXAMPLES[row]
    said = []
    clock = Clock()
    tree = load_xml(wrapped(text), registry_of(leaves_of(leaves), said), clock=clock)
    assert perform(tree, said, script, clock) == script


def test_page_has_a_row_for_each_node():
    rows = re.findall(r"^\| (`[^|]+`) \|", PAGE.read_text(), re.MULTILINE)
    words = [*re.findall(r"\w+", " ".join(rows)), "Switch3", "Switch4", "Switch5"]
    assert sorted(words) == sorted([*NODES, "SubTree"])


@pytest.mark.parametrize(
    "text",
    [
        "<IfThenElse><a _skipIf='true'/><b/></IfThenElse>",
        "<Script code='v = 1'/>",
        "<Script code=\"v := 'x' == 1\"/>",
        "<a _skipIf=\"'x'\"/>",
        "<NonblockingSequence><a _skipIf='true'/></NonblockingSequence>",
        '<Repeat num_cycles="{gone}"><a/></Repeat>',
    ],
)
def test_node_that_cannot_decide_raises_and_fails_in_a_runner(text):
    tree = load_xml(wrapped(text), registry_of(leaves_of("a:S b:S"), []))
    with pytest.raises(RosaBtError):
        tree.tick_once()
    TreeRunner(tree, clock=Clock()).tick()
    assert tree.status is Status.FAILURE


def test_leaf_that_was_stopped_first_is_not_halted_twice():
    said = []
    registry = registry_of(leaves_of("a:R b:R"), said)
    runner = TreeRunner(load_xml(wrapped("<Parallel><a/><b/></Parallel>"), registry), clock=Clock())
    runner.tick()
    said.clear()
    runner.shutdown()
    assert said == ["a:halt", "b:halt"]


def test_pause_and_resume_tick_their_children_to_the_end():
    said = []
    text = wrapped("<PauseResumeController><a/><b/><d/><e/></PauseResumeController>")
    tree = load_xml(text, registry_of(leaves_of("a:R b:R d:RS e:S"), said))
    node = tree.child.node
    assert not node.resume()
    happened = []
    for call in (None, node.pause, None, None, node.resume, None, None):
        if call is not None:
            call()
        said.clear()
        tree.tick_once()
        happened.append(" ".join(said))
    assert happened == ["a:s:R", "a:halt d:s:R", "d:r:S", "b:s:R", "b:halt e:s:S", "a:s:R", "a:r:R"]


def test_pause_and_resume_before_a_tick_are_answered_as_in_nav2():
    said = []
    text = wrapped("<PauseResumeController><a/><b/><d/><e/></PauseResumeController>")
    tree = load_xml(text, registry_of(leaves_of("a:R b:R d:S e:S"), said))
    node = tree.child.node
    tree.tick_once()
    assert [node.pause(), node.resume()] == [True, False]
    tree.tick_once()
    assert node.is_paused
    assert [node.pause(), node.resume(), node.pause()] == [False, True, True]
    tree.tick_once()
    assert said == ["a:s:R", "a:halt", "d:s:S", "d:s:S"]


OLD = '<root><BehaviorTree ID="Main">{}</BehaviorTree></root>'


@pytest.mark.parametrize(
    ("kind", "value", "equal", "other"),
    [
        ("Int", "5", 5, 6),
        ("Double", "0.5", 0.5, 0.6),
        ("Bool", "true", True, False),
        ("String", "it's", "it's", "its"),
    ],
)
def test_check_of_version_3_asks_in_each_tick(kind, value, equal, other):
    said = []
    check = f"BlackboardCheck{kind}"
    ports = f'value_A="{{v}}" value_B="{value}" return_on_mismatch="RUNNING"'
    text = OLD.format(f"<{check} {ports}><a/></{check}>")
    tree = load_xml(text, registry_of(leaves_of("a:R"), said))
    runner = TreeRunner(tree, clock=Clock(), on_error="raise")
    for written in (None, equal, equal, other):
        if written is not None:
            tree.blackboard["v"] = written
        said.append(written)
        runner.tick()
    assert said == [None, equal, "a:s:R", equal, "a:r:R", other, "a:halt"]
    assert tree.status is Status.RUNNING
    with pytest.raises(ExportError, match=f"<{check}> is not in version 4"):
        export_xml(tree)
