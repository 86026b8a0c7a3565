"""What holds for every tree that is read or written, whatever is in it."""

from acting import Clock
from hypothesis import given, settings
from hypothesis import strategies as st
from py_trees.behaviours import Failure, Success
from py_trees.common import Status
from py_trees.composites import Selector, Sequence
from py_trees.decorators import FailureIsSuccess, Inverter, SuccessIsFailure
from test_xml_twin import ENUMS, START, Grower
from xml_leaves import Action, Condition, registry_of, trace

from rosa_bt import TreeRunner, export_xml, load_xml

TICKS = 12


class Case:
    """A random tree, and what it is ticked by."""

    def __init__(self, seed, text=None):
        self.grower = Grower(seed, 0.1, has_ports=False)
        self.text = self.grower.file()
        self.said = []
        self.clock = Clock()
        registry = registry_of(self.grower.leaves, self.said)
        self.tree = load_xml(text or self.text, registry, clock=self.clock, enums=ENUMS)
        self.tree.blackboard.update(START)

    def lines(self, tick=None):
        """Return what is done in each tick, until it raises."""

        def step():
            self.clock.now += 1.0
            (tick or self.tree.tick_once)()

        lines = []
        try:
            for _ in range(TICKS):
                lines += trace(step, self.tree, self.said, 1)
        except ValueError:
            lines.append("raised")
        return lines


seeds = st.integers(0, 2**32)


@given(seeds)
def test_exported_tree_is_the_tree(seed):
    text = export_xml(Case(seed).tree)
    again = Case(seed, text)
    assert again.lines() == Case(seed).lines()
    assert export_xml(again.tree) == text


@given(seeds, st.sampled_from(["initialise", "update", "terminate"]), st.integers(1, 5))
def test_leaf_that_raises_ends_alone(seed, hook, at):
    case = Case(seed)
    calls = []

    def raising(own):
        def call(*arguments):
            result = own(*arguments)
            calls.append(own)
            if len(calls) % at == 0:
                raise RuntimeError("burst")
            return result

        return call

    for leaf in case.tree.iterate():
        if isinstance(leaf, Action | Condition):
            vars(leaf)[hook] = raising(getattr(leaf, hook))
    runner = TreeRunner(case.tree, clock=case.clock)
    for _ in range(TICKS):
        case.lines(runner.tick)
        if case.tree.status is not Status.RUNNING:
            assert all(node.status is not Status.RUNNING for node in case.tree.iterate())
    runner.shutdown()
    assert all(node.status is not Status.RUNNING for node in case.tree.iterate())


@st.composite
def py_trees_trees(draw):
    """Draw a function that makes a tree that BehaviorTree.CPP can have, and its leaves."""
    leaves = {}

    def node(depth):
        kinds = ["leaf", "composite", "composite", "decorator", "constant"] if depth else ["leaf"]
        kind = draw(st.sampled_from(kinds))
        if kind == "leaf":
            name = f"L{len(leaves)}"
            script = "".join(draw(st.lists(st.sampled_from("SFR"), min_size=1, max_size=6)))
            leaves[name] = (draw(st.sampled_from("AAC")), script)
            return lambda make: make(name)
        if kind == "constant":
            constant = draw(st.sampled_from([Success, Failure]))
            return lambda make: constant("constant")
        if kind == "decorator":
            decorator = draw(st.sampled_from([Inverter, FailureIsSuccess, SuccessIsFailure]))
            child = node(depth - 1)
            return lambda make: decorator("decorator", child(make))
        composite = draw(st.sampled_from([Sequence, Selector]))
        memory = draw(st.booleans())
        children = [node(depth - 1) for _ in range(draw(st.integers(1, 3)))]
        return lambda make: composite(
            "composite", memory=memory, children=[child(make) for child in children]
        )

    return node(3), leaves


@given(py_trees_trees())
@settings(max_examples=100)
def test_exported_py_trees_tree_behaves_as_it_did(drawn):
    build, leaves = drawn
    said = []
    registry = registry_of(leaves, said)
    kinds = {"A": Action, "C": Condition}
    tree = build(lambda name: kinds[leaves[name][0]](name, iter(leaves[name][1] * 1000), said))
    before = trace(tree.tick_once, tree, said, TICKS)
    after = load_xml(export_xml(tree, registry), registry)
    assert trace(after.tick_once, after, said, TICKS) == before
