"""What holds for every tree that is read, whatever is in it."""

from collections import Counter

from hypothesis import given, settings
from hypothesis import strategies as st
from py_trees.behaviour import Behaviour
from py_trees.behaviours import Failure, Success
from py_trees.common import Status
from py_trees.composites import Selector, Sequence
from py_trees.decorators import FailureIsSuccess, Inverter, SuccessIsFailure
from xml_leaves import Action, Condition, registry_of, trace, wrapped

from rosa_bt import TreeRunner, export_xml, load_xml

TICKS = 12
MANY = (
    *("Sequence", "AsyncSequence", "SequenceWithMemory", "ReactiveSequence"),
    *("Fallback", "AsyncFallback", "ReactiveFallback"),
    *(
        'Parallel success_count="1" failure_count="1"',
        'ParallelAll max_failures="1"',
        "PipelineSequence",
        "RoundRobin",
    ),
)
ONE = (
    *(
        "Inverter",
        "ForceSuccess",
        "ForceFailure",
        "KeepRunningUntilFailure",
        "RunOnce",
        'RunOnce then_skip="false"',
    ),
    *(
        'Repeat num_cycles="2"',
        'RetryUntilSuccessful num_attempts="2"',
        'RetryUntilSuccessful num_attempts="-1"',
    ),
    *('Delay delay_msec="1500"', 'Timeout msec="2500"'),
)
scripts = st.lists(st.sampled_from("SFR"), min_size=1, max_size=6).map("".join)


class Grower:
    """Draws the text of a tree, and its leaves, each with a tag of its own."""

    def __init__(self, draw):
        self.draw, self.leaves = draw, {}

    def leaf(self, rules=("", "", "", ' _while="go"', ' _skipIf="!go"', ' _onSuccess="go := !go"')):
        tag = f"L{len(self.leaves)}"
        script = self.draw(scripts)
        kind = self.draw(st.sampled_from("AAC"))
        self.leaves[tag] = (kind, script if kind == "A" else script.replace("R", "F"))
        rule = self.draw(st.sampled_from(rules))
        return f"<{tag}{rule}/>"

    def node(self, depth):
        kind = (
            self.draw(st.sampled_from(["leaf", "many", "many", "one", "choice"]))
            if depth
            else "leaf"
        )
        if kind == "leaf":
            return self.leaf()
        if kind == "one":
            return self.around(self.draw(st.sampled_from(ONE)), self.node(depth - 1))
        if kind == "choice":
            return self.choice(depth - 1)
        tag = self.draw(st.sampled_from(MANY))
        children = [self.node(depth - 1) for _ in range(self.draw(st.integers(1, 3)))]
        if tag == "ReactiveSequence":  # which takes one asynchronous child only
            children = [child.replace("AsyncSequence", "AsyncFallback") for child in children]
        return self.around(tag, "".join(children))

    def choice(self, depth):
        tag = self.draw(
            st.sampled_from(["WhileDoElse", "IfThenElse", 'RecoveryNode number_of_retries="2"'])
        )
        most = 1 if tag.startswith("RecoveryNode") else 2
        rest = [self.node(depth) for _ in range(self.draw(st.integers(1, most)))]
        return self.around(
            tag, self.leaf(rules=[""]) + "".join(rest)
        )  # a condition cannot be skipped

    @staticmethod
    def around(tag, content):
        return f"<{tag}>{content}</{tag.split()[0]}>"


@st.composite
def files(draw):
    """Draw a file with two trees, one in the other, and the leaves of both."""
    grower = Grower(draw)
    inner = grower.node(2)
    content = grower.around("Sequence", '<SubTree ID="Inner" _autoremap="true"/>' + grower.node(3))
    return wrapped(content, Inner=inner), grower.leaves


class Seconds:
    """A clock that is turned by hand [s]."""

    now = 0.0

    def __call__(self):
        return self.now


def loaded(file):
    text, leaves = file
    said = []
    clock = Seconds()
    tree = load_xml(text, registry_of(leaves, said), clock=clock)
    tree.blackboard["go"] = True
    return tree, said, clock


def each_second(clock, tick):
    """Return what turns the clock by a second and ticks."""

    def turn():
        clock.now += 1.0
        tick()

    return turn


def run(file):
    tree, said, clock = loaded(file)
    return trace(each_second(clock, tree.tick_once), tree, said, TICKS)


@given(files())
@settings(max_examples=100)
def test_every_start_is_followed_by_an_end_or_a_halt(file):
    tree, said, clock = loaded(file)
    lines = trace(each_second(clock, tree.tick_once), tree, said, TICKS)
    open_ones = Counter()
    for item in " ".join(lines).split():
        leaf, *rest = item.split(":")
        if rest in (["s", "R"], ["s", "S"], ["s", "F"]):
            assert not open_ones[leaf]
            open_ones[leaf] = rest[1] == "R"
        elif rest and rest[0] == "r":
            assert open_ones[leaf]
            open_ones[leaf] = rest[1] == "R"
        elif rest == ["halt"]:
            assert open_ones[leaf]
            open_ones[leaf] = False
    running = [
        one.name
        for one in tree.iterate()
        if isinstance(one, Action) and one.status is Status.RUNNING
    ]
    assert sorted(running) == sorted(leaf for leaf, is_open in open_ones.items() if is_open)


@given(files(), st.integers(1, TICKS))
def test_nothing_runs_in_a_tree_that_was_stopped_and_only_what_ran_was_halted(file, ticks):
    tree, said, _ = loaded(file)
    trace(tree.tick_once, tree, said, ticks)
    running = {
        one.name
        for one in tree.iterate()
        if isinstance(one, Action) and one.status is Status.RUNNING
    }
    said.clear()
    tree.stop(Status.INVALID)
    assert sorted(said) == sorted(f"{name}:halt" for name in running)
    assert all(one.status is not Status.RUNNING for one in tree.iterate())


@given(files())
def test_nothing_runs_below_a_root_that_does_not(file):
    tree, said, clock = loaded(file)
    for _ in range(TICKS):
        trace(each_second(clock, tree.tick_once), tree, said, 1)
        if tree.status is not Status.RUNNING:
            assert all(one.status is not Status.RUNNING for one in tree.iterate())


@given(files())
def test_same_file_gives_the_same_trace_also_beside_another_tree_of_it(file):
    (one, said, clock), (other, _, _) = loaded(file), loaded(file)

    def both():
        one.tick_once()
        other.blackboard["go"] = False
        other.tick_once()

    assert trace(each_second(clock, both), one, said, TICKS) == run(file)


@given(files())
def test_exported_tree_is_the_tree(file):
    exported = export_xml(loaded(file)[0])
    again = (exported, file[1])
    assert run(again) == run(file)
    assert export_xml(loaded(again)[0]) == exported


@given(files())
def test_runner_does_what_ticking_by_hand_does(file):
    tree, said, clock = loaded(file)
    runner = TreeRunner(tree, clock=clock)
    assert trace(each_second(clock, runner.tick), tree, said, TICKS) == run(file)


@given(files(), st.sampled_from(["initialise", "update", "terminate"]), st.integers(1, 5))
def test_leaf_that_raises_ends_alone_and_the_tree_goes_on(file, hook, at):
    tree, _, clock = loaded(file)
    count = 0

    def burst(*_):
        nonlocal count
        count += 1
        if count % at == 0:
            raise RuntimeError("burst")

    for leaf in tree.iterate():
        if isinstance(leaf, Action | Condition):
            own = getattr(leaf, hook)
            setattr(leaf, hook, lambda *given, own=own: (own(*given), burst())[0])
    runner = TreeRunner(tree, clock=clock)
    for _ in range(TICKS):
        each_second(clock, runner.tick)()
        if tree.status is not Status.RUNNING:
            assert all(one.status is not Status.RUNNING for one in tree.iterate())
    runner.shutdown()
    assert all(one.status is not Status.RUNNING for one in tree.iterate())


@st.composite
def py_trees_trees(draw):
    """Draw a function that makes a tree of what py_trees shares with BehaviorTree.CPP, and its leaves."""
    leaves = {}

    def node(depth):
        kind = (
            draw(st.sampled_from(["leaf", "composite", "composite", "decorator", "constant"]))
            if depth
            else "leaf"
        )
        if kind == "leaf":
            name = f"L{len(leaves)}"
            leaves[name] = (draw(st.sampled_from("AAC")), draw(scripts))
            return lambda made: made(name)
        if kind == "constant":
            constant = draw(st.sampled_from([Success, Failure]))
            return lambda made: constant("constant")
        if kind == "decorator":
            decorator = draw(st.sampled_from([Inverter, FailureIsSuccess, SuccessIsFailure]))
            child = node(depth - 1)
            return lambda made: decorator("decorated", child(made))
        composite, memory = draw(st.sampled_from([Sequence, Selector])), draw(st.booleans())
        children = [node(depth - 1) for _ in range(draw(st.integers(1, 3)))]
        return lambda made: composite(
            "composite", memory=memory, children=[child(made) for child in children]
        )

    return node(3), leaves


@given(py_trees_trees())
@settings(max_examples=100)
def test_exported_py_trees_tree_behaves_as_it_did(drawn):
    make, leaves = drawn
    said = []
    own = registry_of(leaves, said)
    classes = {"A": Action, "C": Condition}
    tree: Behaviour = make(
        lambda name: classes[leaves[name][0]](name, iter(leaves[name][1] * 1000), said)
    )
    before = trace(tree.tick_once, tree, said, TICKS)
    after = load_xml(export_xml(tree, own), own)
    assert trace(after.tick_once, after, said, TICKS) == before
