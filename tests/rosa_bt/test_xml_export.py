"""Trees are written so that they can be read again and mean the same, or not at all."""

import pytest
from py_trees import behaviours, common, composites, decorators
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.ports import PortsMixin
from xml_leaves import registry_of, trace, wrapped

from kb import KnowledgeBase, Model
from rosa_bt import (
    BehaviourRegistry,
    ExportError,
    IsActionFeasible,
    RosaAction,
    TreeRunner,
    export_xml,
    load_xml,
)

LEAVES = {"a": ("A", "RS"), "b": ("A", "SF"), "c": ("C", "SSF")}


class Look(Behaviour):
    """Needs nothing but a name."""

    def update(self):
        return Status.SUCCESS


class Turn(Behaviour):
    """Needs an angle."""

    def __init__(self, name, angle):
        super().__init__(name)
        self.turned = angle

    def update(self):
        return Status.SUCCESS


class Scan(RosaAction):
    """Scans for ever."""

    def update(self):
        return Status.RUNNING


class Zoom(Scan):
    """Hands on what it is made with."""

    def __init__(self, name, kb, action=None, **more):
        super().__init__(name, kb, action, **more)


class Remember(Zoom):
    """Keeps what it was made with where nobody looks."""

    def __init__(self, name, kb, action=None, memory=0):
        super().__init__(name, kb, action)
        self._kept = memory


@pytest.mark.parametrize(
    ("tree", "written"),
    [
        (
            lambda: composites.Sequence("s", memory=True, children=[Look("l")]),
            '<Sequence name="s">',
        ),
        (
            lambda: composites.Sequence("s", memory=False, children=[Look("l")]),
            '<ReactiveSequence name="s">',
        ),
        (
            lambda: composites.Selector("s", memory=True, children=[Look("l")]),
            '<Fallback name="s">',
        ),
        (
            lambda: composites.Selector("s", memory=False, children=[Look("l")]),
            '<ReactiveFallback name="s">',
        ),
        (lambda: decorators.Inverter("d", Look("l")), '<Inverter name="d">'),
        (lambda: decorators.FailureIsSuccess("d", Look("l")), '<ForceSuccess name="d">'),
        (lambda: decorators.SuccessIsFailure("d", Look("l")), '<ForceFailure name="d">'),
        (lambda: behaviours.Success("yes"), '<AlwaysSuccess name="yes" />'),
        (lambda: behaviours.Failure("no"), '<AlwaysFailure name="no" />'),
        (lambda: Look('look "<& ä'), '<Look name="look &quot;&lt;&amp; ä" />'),
    ],
)
def test_what_py_trees_shares_with_it_is_written_and_read_again(tree, written):
    text = export_xml(tree())
    assert written in text
    registry = BehaviourRegistry()
    registry.register("Look", Look)
    again = load_xml(text, registry)
    before = tree()
    before.tick_once()
    again.tick_once()
    assert again.status is before.status
    assert [one.name for one in again.iterate()][:-1] == [one.name for one in before.iterate()]


@pytest.mark.parametrize(
    ("tree", "message"),
    [
        (
            lambda: composites.Parallel("p", common.ParallelPolicy.SuccessOnAll(), [Look("l")]),
            "Parallel 'p' has no exact",
        ),
        (lambda: decorators.Repeat("r", Look("l"), num_success=2), "Repeat 'r' has no exact"),
        (lambda: decorators.Retry("r", Look("l"), num_failures=2), "Retry 'r' has no exact"),
        (lambda: decorators.Timeout("t", Look("l"), duration=1.0), "Timeout 't' has no exact"),
        (lambda: decorators.SuccessIsRunning("k", Look("l")), "SuccessIsRunning 'k' has no exact"),
        (
            lambda: composites.Sequence("s", memory=True),
            "Sequence 's' without children has no exact",
        ),
        (lambda: Turn("t", 3.0), "Turn 't' was made with angle, which cannot be written"),
        (
            lambda: behaviours.TickCounter("t", 3, Status.SUCCESS),
            "TickCounter 't' was made with duration",
        ),
        (lambda: Look("\x00"), "cannot be written so that it can be read again"),
        (
            lambda: type("Sequence", (Look,), {})("s"),
            "'Sequence' is a node of BehaviorTree.CPP itself",
        ),
    ],
)
def test_what_has_no_exact_counterpart_is_refused_by_name(tree, message):
    with pytest.raises(ExportError, match=message):
        export_xml(tree())


def test_leaves_have_the_names_under_which_they_are_registered():
    registry = BehaviourRegistry()
    registry.register("look_around", Look)
    registry.register("left", lambda name: Turn(name, 90.0))
    tree = composites.Sequence("s", memory=True, children=[Look("l"), Turn("left", 90.0)])
    text = export_xml(tree, registry)
    assert '<look_around name="l" />' in text
    assert '<left name="left" />' in text
    for name in ("right", "look_around"):
        with pytest.raises(ExportError, match=f"Turn '{name}' is not registered"):
            export_xml(Turn(name, -90.0), registry)


class Beep(PortsMixin, Behaviour):
    """Takes the name of its tag, as all that have ports of py_trees can, and has none."""

    INPUT_PORTS = {}  # noqa: RUF012  # as py_trees has it
    OUTPUT_PORTS = {}  # noqa: RUF012  # as py_trees has it

    def update(self):
        return Status.SUCCESS


def test_leaf_that_takes_the_name_of_its_tag_is_written():
    registry = BehaviourRegistry()
    registry.register("Beep", Beep)
    text = export_xml(Beep("horn"), registry)
    assert '<Beep name="horn" />' in text
    assert export_xml(load_xml(text, registry=registry), registry) == text


def test_actions_are_written_with_what_they_do():
    model = Model("rover")
    model.environmental_attribute("light")
    model.action("scan")
    kb = KnowledgeBase(model, clock=lambda: 0.0)
    registry = BehaviourRegistry(kb=kb)
    registry.register("Scan", Scan)
    children = [IsActionFeasible("can?", kb, "scan"), Scan("do", kb, "scan", "light")]
    text = export_xml(composites.Sequence("s", memory=False, children=children), registry)
    load_xml(text, registry).tick_once()
    assert [(one.action, one.preference) for one in kb.required_actions] == [("scan", "light")]
    written = export_xml(Scan("do", kb, "scan", wait=True, timeout=2.5), registry)
    assert '<Scan name="do" action="scan" wait="true" timeout="2.5" />' in written
    again = load_xml(written, registry).child.node
    assert (again.wait, again.timeout) == (True, 2.5)
    registry.register("Zoom", Zoom)
    assert load_xml(
        export_xml(Zoom("in", kb, "scan", preference="light"), registry), registry
    ).child.node.preference
    with pytest.raises(ExportError, match="was made with memory"):
        export_xml(Remember("in", kb, "scan", 3))
    with pytest.raises(ExportError, match="'do' names no action"):
        export_xml(Scan("do", kb), registry)


FULL = """
<root BTCPP_format="4" main_tree_to_execute="Main">
  <BehaviorTree ID="Main">
    <Sequence>
      <SubTree ID="Sub" v="{w}" _autoremap="true" _skipIf="w == 3" name="first" />
      <SubTree ID="Sub" v="1" />
      <Parallel success_count="1" _onSuccess="done := 1"><a /><b /></Parallel>
    </Sequence>
  </BehaviorTree>
  <BehaviorTree ID="Sub"><Condition ID="c" _while="v == 1 || v == 2" /></BehaviorTree>
  <TreeNodesModel><Condition ID="c" /><SubTree ID="Sub"><input_port name="v" default="2" /></SubTree></TreeNodesModel>
</root>
"""


def test_all_that_is_written_in_a_file_is_written_again():
    said = []
    registry = registry_of(LEAVES, said)
    first = export_xml(load_xml(FULL, registry))
    assert "".join(first.split()) == "".join(FULL.split())
    assert export_xml(load_xml(first, registry)) == first


def test_tree_that_was_changed_while_it_ran_is_written_as_it_is_now():
    said = []
    registry = registry_of({**LEAVES, "d": ("A", "S")}, said)
    content = '<Sequence><SubTree ID="Sub"/><SubTree ID="Sub"/></Sequence>'
    tree = load_xml(wrapped(content, Sub="<Sequence><a/><b/></Sequence>"), registry)
    runner = TreeRunner(tree, clock=lambda: 0.0)
    runner.tick()
    second = tree.child.node.children[1].child.node
    runner.tree.replace_subtree(
        second.children[0].id, registry.entries["d"].make("d", {}, [], tree.blackboard)
    )
    runner.tree.insert_subtree(behaviours.Success("yes"), second.id, 1)
    runner.tree.prune_subtree(second.children[2].id)
    runner.tick()
    text = export_xml(tree, registry)
    assert '<SubTree ID="Sub_2" />' in text
    assert '<d name="d" />' in text
    assert '<AlwaysSuccess name="yes" />' in text
    assert text.count("<b />") == 1
    load_xml(text, registry)


def test_part_of_a_tree_can_be_written():
    registry = registry_of(LEAVES, [])
    tree = load_xml(wrapped("<Sequence><a/><Inverter><b/></Inverter></Sequence>"), registry)
    part = load_xml(export_xml(tree.child.node.children[1]), registry)
    assert [type(one).__name__ for one in part.iterate()] == ["Exact", "Inverter", "SubTree"]


def test_tree_that_changes_goes_on_where_it_was():
    said = []
    registry = registry_of({**LEAVES, "d": ("A", "S")}, said)
    tree = load_xml(wrapped("<Sequence><b/><a/><b/></Sequence>"), registry)
    runner = TreeRunner(tree, clock=lambda: 0.0)
    sequence = tree.child.node
    runner.tick()
    for place in (0, 3):
        runner.tree.insert_subtree(
            registry.entries["d"].make("d", {}, [], tree.blackboard), sequence.id, place
        )
    assert trace(runner.tick, tree, said, 1) == ["0| a:r:S d:s:S b:s:F => FAILURE"]
