"""Trees are written so that they can be read again and mean the same, or not at all."""

from random import Random

import pytest
from acting import Clock
from py_trees import behaviours, common, composites, decorators
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from xml_leaves import registry_of, trace, wrapped

from kb import KnowledgeBase, Model
from rosa_bt import (
    BehaviourRegistry,
    ExportError,
    ForAction,
    RosaAction,
    TreeRunner,
    UntilSuccess,
    XmlError,
    do_until_unfeasible,
    export_xml,
    feasible_then_act,
    first_feasible,
    load_xml,
)

LEAVES = {"a": ("A", "RS"), "b": ("A", "SF"), "c": ("C", "SSF"), "d": ("A", "S")}
ACTIONS = ("scan", "drive", "charge")


class Look(Behaviour):
    """Needs nothing but a name."""

    def update(self):
        return Status.SUCCESS


class Turn(Behaviour):
    """Takes two ticks."""

    def initialise(self):
        self.left = 2

    def update(self):
        self.left -= 1
        return Status.RUNNING if self.left else Status.SUCCESS


class Spin(Look):
    """Needs a speed."""

    def __init__(self, name, speed):
        super().__init__(name)
        self.turns = speed


class Work(RosaAction):
    """Takes three ticks; each third time it fails."""

    rounds = 0

    def initialise(self):
        self.left = 3
        self.rounds += 1

    def update(self):
        self.left -= 1
        if self.left:
            return Status.RUNNING
        return Status.FAILURE if self.rounds % 3 == 0 else Status.SUCCESS


def rover(clock):
    model = Model("rover")
    for name in ACTIONS:
        model.action(name, constraints=[model.environmental_attribute(f"for_{name}") >= 0.5])
    return KnowledgeBase(model, clock=clock)


def registered(kb):
    registry = BehaviourRegistry(kb=kb)
    for kind in (Look, Turn, Work):
        registry.register(kind.__name__, kind)
    return registry


def sequence(memory, *children):
    return composites.Sequence("s", memory=memory, children=list(children))


@pytest.mark.parametrize(
    ("tree", "message"),
    [
        (
            composites.Parallel("p", common.ParallelPolicy.SuccessOnAll(), [Look("l")]),
            "Parallel 'p' cannot be written: it is not registered",
        ),
        (decorators.Retry("r", Look("l"), num_failures=2), "Retry 'r' .* no exact counterpart"),
        (sequence(True), "Sequence 's' cannot be written: it has no children"),
        (Spin("t", 3), "Spin 't' cannot be written: it has no attribute 'speed'"),
        (Look("\x00"), "cannot be written so that it can be read again"),
        (
            type("Sequence", (Look,), {})("s"),
            "Sequence 's' .* it is not registered",
        ),
        (Work("w", rover(Clock())), "'w' cannot be written: it has no attribute 'action'"),
    ],
)
def test_tree_without_counterpart_is_refused_by_name(tree, message):
    with pytest.raises(ExportError, match=message):
        export_xml(tree)


@pytest.mark.parametrize("name", ["look around", "a/b", "Root"])
def test_name_that_the_library_refuses_is_refused(name):
    registry = BehaviourRegistry()
    registry.register(name, Look)
    with pytest.raises(ExportError, match=f"{name!r}.*write '.*' instead"):
        export_xml(Look("look"), registry)


def test_leaf_has_the_name_under_which_it_is_registered():
    registry = BehaviourRegistry()
    registry.register("look_around", Look)
    registry.register("left", lambda name: Spin(name, 90))
    text = export_xml(sequence(True, Look('"<& ä'), Spin("left", 90)), registry)
    assert '<look_around name="&quot;&lt;&amp; ä" />' in text
    assert '<left name="left" />' in text
    with pytest.raises(ExportError, match=r"Spin 'right' .* it is not registered"):
        export_xml(Spin("right", -90), registry)


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
  <TreeNodesModel>
    <Condition ID="c" /><SubTree ID="Sub"><input_port name="v" default="2" /></SubTree>
  </TreeNodesModel>
</root>
"""


def test_file_is_written_as_it_was():
    registry = registry_of(LEAVES, [])
    first = export_xml(load_xml(FULL, registry))
    assert "".join(first.split()) == "".join(FULL.split())
    assert export_xml(load_xml(first, registry)) == first


def test_tree_that_was_changed_while_it_ran_is_written_as_it_is():
    registry = registry_of(LEAVES, [])
    content = '<Sequence><SubTree ID="Sub"/><SubTree ID="Sub"/></Sequence>'
    tree = load_xml(wrapped(content, Sub="<Sequence><a/><b/></Sequence>"), registry)
    runner = TreeRunner(tree, clock=Clock())
    runner.tick()
    second = tree.child.node.children[1].child.node
    runner.tree.replace_subtree(second.children[0].id, registry.entries["d"].factory("d"))
    runner.tree.insert_subtree(behaviours.Success("yes"), second.id, 1)
    runner.tree.prune_subtree(second.children[2].id)
    runner.tick()
    text = export_xml(tree, registry)
    for part in ('<SubTree ID="Sub_2" />', '<d name="d" />', '<AlwaysSuccess name="yes" />'):
        assert part in text
    assert text.count("<b />") == 1
    load_xml(text, registry)


def test_tree_that_changes_goes_on_where_it_was():
    said = []
    registry = registry_of(LEAVES, said)
    tree = load_xml(wrapped("<Sequence><b/><a/><b/></Sequence>"), registry)
    runner = TreeRunner(tree, clock=Clock())
    runner.tick()
    for place in (0, 3):
        leaf = registry.entries["d"].factory("d")
        runner.tree.insert_subtree(leaf, tree.child.node.id, place)
    assert trace(runner.tick, tree, said, 1) == ["0| a:r:S d:s:S b:s:F => FAILURE"]


def work(kb, name="scan", **arguments):
    return Work(name, kb, name, **arguments)


def first(kb, **arguments):
    return first_feasible("first", [work(kb, name) for name in ACTIONS], **arguments)


IDIOMS = {
    "feasible": (lambda kb: feasible_then_act(work(kb)), "<IsActionFeasible"),
    "first": (first, "<ReactiveFallback"),
    "first that goes on": (lambda kb: first(kb, memory=True), "<Fallback"),
    "until": (lambda kb: do_until_unfeasible(work(kb), work(kb, "charge")), "<DoUntilUnfeasible"),
    "until, to the end": (
        lambda kb: do_until_unfeasible(work(kb), work(kb, "charge"), memory=True),
        '<DoUntilUnfeasible name="scan, or else charge" memory="true">',
    ),
    "subtree": (
        lambda kb: do_until_unfeasible(UntilSuccess("again", first(kb)), work(kb, "charge")),
        "<UntilSuccess",
    ),
    "under an action": (
        lambda kb: ForAction("for", kb, "scan", Turn("turn"), preference="for_scan", wait=True),
        'preference="for_scan" wait="true"',
    ),
    "waiting": (
        lambda kb: work(kb, preference="for_scan", wait=True),
        '<Work name="scan" action="scan" preference="for_scan" wait="true" />',
    ),
}


def run(build, seed):
    """Return what a tree did and what the knowledge base came to know, tick by tick."""
    clock = Clock()
    random = Random(seed)
    kb = rover(clock)
    runner = TreeRunner(build(kb), clock=clock)
    happened = []
    for _ in range(60):
        clock.now += 1.0
        for name in ACTIONS:
            if random.random() < 0.3:
                kb.measure(f"for_{name}", random.choice((0.0, 1.0)))
        runner.tick()
        nodes = [node for node in runner.tree.root.iterate() if isinstance(node, Turn | Work)]
        running = sorted(node.name for node in nodes if node.status is Status.RUNNING)
        events = [(event.verb, event.arguments) for event in kb.log.since(0)]
        happened.append((runner.status, running, events[-6:]))
    return happened


@pytest.mark.parametrize("name", IDIOMS)
def test_idiom_that_was_written_and_read_does_the_same(name):
    build, part = IDIOMS[name]

    def read_again(kb):
        text = export_xml(build(kb), registered(kb))
        assert part in text
        return load_xml(text, registered(kb))

    for seed in range(3):
        assert run(read_again, seed) == run(build, seed)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("<DoUntilUnfeasible><Turn/></DoUntilUnfeasible>", "<DoUntilUnfeasible>: 1; it takes 2"),
        ('<ForAction action="scann"><Turn/></ForAction>', "scann"),
    ],
)
def test_idiom_that_is_written_wrongly_is_refused(content, problem):
    with pytest.raises(XmlError, match=problem):
        load_xml(wrapped(content), registered(rover(Clock())))
