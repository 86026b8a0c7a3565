"""What is read from XML does what a plain twin of BehaviorTree.CPP does."""

from random import Random
from xml.sax.saxutils import quoteattr

import pytest
from btcpp_twin import KINDS, Thrown, Twin
from hypothesis import given, settings
from hypothesis import strategies as st
from py_trees.common import Status
from test_xml_traces import RANDOM
from test_xml_traces_2 import registry_for, subtrees_of
from xml_leaves import wrapped

from rosa_bt import load_xml
from rosa_bt.xml.blackboard import NodeError

TICKS = 20
ENUMS = {"RED": 1}
START = {"x": True, "y": False, "n": 3, "d": 0.5, "t": "a", "g": 0}
MANY = (
    "Sequence",
    "AsyncSequence",
    "SequenceWithMemory",
    "ReactiveSequence",
    "Fallback",
    "AsyncFallback",
)
COUNTED = {"Parallel": ("success_count", "failure_count"), "ParallelAll": ("max_failures",)}
ONE = {
    **dict.fromkeys(("Inverter", "ForceSuccess", "ForceFailure", "KeepRunningUntilFailure"), ("",)),
    "RunOnce": ["", ' then_skip="false"'],
    "Repeat": [f' num_cycles="{number}"' for number in (-1, 0, 1, 2, 3)],
    "RetryUntilSuccessful": [f' num_attempts="{number}"' for number in (-1, 0, 1, 2, 3)],
    "Delay": [f' delay_msec="{number}"' for number in (500, 1500, 3000)],
    "Timeout": [f' msec="{number}"' for number in (1000, 2500, 4000)],
    "LoopInt": [
        f' queue="1;2" if_empty="{word}"' for word in ("SUCCESS", "FAILURE", "RUNNING", "SKIPPED")
    ],
    "LoopDouble": [
        f' queue="1;0.5;2e1" value="{{vd}}" if_empty="{word}"' for word in ("SUCCESS", "FAILURE")
    ],
    "LoopBool": [' queue="true;false" value="{vb}" if_empty="SUCCESS"'],
    "LoopString": [
        ' queue="a;7" value="{vs}" if_empty="FAILURE"',
        ' queue="a;b" if_empty="RUNNING"',
    ],
    "SkipUnlessUpdated": [f' entry="{{{key}}}"' for key in ("n", "d", "c", "vd", "never")],
    "WaitValueUpdate": [f' entry="{key}"' for key in ("n", "t", "c")],
    "Precondition": [
        f' if="!x" else="{word}"' for word in ("SUCCESS", "FAILURE", "RUNNING", "SKIPPED")
    ],
}
ENTRIES = (
    '<WasEntryUpdated entry="{n}"/>',
    '<WasEntryUpdated entry="c"/>',
    '<SetBlackboard value="{n}" output_key="c"/>',
    '<SetBlackboard value="{vd}" output_key="c2"/>',
    '<SetBlackboard value="word" output_key="l"/>',
    '<UnsetBlackboard key="c"/>',
    '<Script code="w := n &amp; 3"/>',
)
CONSTANT = (
    "<AlwaysSuccess/>",
    "<AlwaysFailure/>",
    '<ScriptCondition code="x"/>',
    '<Script code="y := !y"/>',
)
AUTO = '_autoremap="true"'
REMAPPED = {
    "n": ("{n}", "{d}", "4"),
    "d": ("{n}", "0.25"),
    "t": ("{=}", "b"),
    "c": ("{c}", "{=}"),
    "y": ("{x}",),
}
PORTS = (*[""] * 5, ' p="5"', ' p="{g}"', ' p="{never}"', ' o="{o}"', ' p="{o}" o="{o}"')
RULES = (
    "_failureIf",
    "_successIf",
    "_skipIf",
    "_while",
    "_onSuccess",
    "_onFailure",
    "_onHalted",
    "_post",
)


class Grower:
    """Writes a random file, and names its leaves."""

    def __init__(self, seed, rules, *, has_ports=True):
        self.random = Random(seed)
        self.often = rules
        self.has_ports = has_ports
        self.leaves = {}
        self.trees = {}
        self.ports = {}

    def file(self):
        main = self.node(self.random.randint(1, 4))
        return wrapped(main, **self.trees)

    def rules(self):
        chosen = (
            self.random.sample(RULES, self.random.randint(1, 2))
            if self.random.random() < self.often
            else []
        )
        said = {rule: self.script() if rule in RULES[4:] else self.condition() for rule in chosen}
        return "".join(f" {rule}={quoteattr(code)}" for rule, code in said.items())

    def condition(self):
        return self.random.choice(("x", "!x", "y", "!y", "n == 3", "n < 5", "d >= 1.5"))

    def script(self):
        statements = (
            *("x := !x", "y = !y", "@g += 1", "n += 1"),
            *("n := n & 7", "d += 0.25", "d = n", "n = 3", "y = x", "w := n & 3"),
        )
        return "; ".join(self.random.choices(statements, k=self.random.randint(1, 3)))

    def leaf(self):
        tag = f"L{len(self.leaves)}"
        kind = self.random.choice("AAC")
        script = "".join(
            self.random.choices("SF" if kind == "C" else "SFR", k=self.random.randint(1, 6))
        )
        self.leaves[tag] = (kind, script)
        ports = self.random.choice(PORTS) if self.has_ports else ""
        outs = {"o": ["int", range(1, 1000)]} if " o=" in ports else {}
        self.ports[tag] = {"in": {"p": "int"} if " p=" in ports else {}, "out": outs}
        return f"<{tag}{ports}{self.rules()}/>"

    def around(self, tag, ports, children):
        return f"<{tag}{ports}{self.rules()}>{''.join(children)}</{tag}>"

    def node(self, depth):
        if depth == 0:
            return self.leaf()
        grow = (
            self.leaf,
            self.constant,
            self.many,
            self.many,
            self.many,
            self.one,
            self.one,
            self.choice,
            self.tree,
        )
        chosen = self.random.choice(grow)
        return chosen() if chosen in grow[:2] else chosen(depth - 1)

    def constant(self):
        asked = quoteattr(self.condition())
        done = quoteattr(self.script())
        return self.random.choice(
            (*CONSTANT, *ENTRIES, f"<ScriptCondition code={asked}/>", f"<Script code={done}/>")
        )

    def many(self, depth):
        tag = self.random.choice((*MANY, "ReactiveFallback", *COUNTED))
        count = self.random.randint(1, 4)
        ports = [
            f' {port}="{self.random.randint(-count - 1, count)}"' for port in COUNTED.get(tag, ())
        ]
        children = [self.node(depth) for _ in range(count)]
        if (
            tag == "ReactiveSequence"
            and sum(child.startswith("<AsyncSequence") for child in children) > 1
        ):
            children = children[:1]  # which takes one asynchronous child only
        return self.around(tag, "".join(ports[: self.random.randint(0, 2)]), children)

    def one(self, depth):
        tag = self.random.choice(list(ONE))
        return self.around(tag, self.random.choice(ONE[tag]), [self.node(depth)])

    def choice(self, depth):
        tag = self.random.choice(
            ("IfThenElse", "WhileDoElse", "Switch2", "Switch3", "Switch4", "TryCatch")
        )
        count = int(tag[6:]) + 1 if tag.startswith("Switch") else self.random.randint(2, 3)
        cases = self.random.sample(("1", "01", "2.0", "RED", "3", "other"), count - 1)
        ports = "".join(f' case_{number}="{case}"' for number, case in enumerate(cases, start=1))
        ports = f' variable="{{w}}"{ports}' if tag.startswith("Switch") else ""
        ports += ' catch_on_halt="true"' if tag == "TryCatch" and count == 3 else ""
        return self.around(tag, ports, [self.node(depth) for _ in range(count)])

    def tree(self, depth):
        name = f"Tree{len(self.trees)}"
        self.trees[name] = ""
        self.trees[name] = self.node(depth)
        some = {
            key: self.random.choice(texts)
            for key, texts in REMAPPED.items()
            if self.random.random() < 0.3
        }
        all_but = {**dict.fromkeys("xyndtw", "{=}"), **some}
        is_auto = self.random.random() < 0.6
        ports = "".join(f' {key}="{text}"' for key, text in (some if is_auto else all_but).items())
        return f'<SubTree ID="{name}"{ports}{chr(32) + AUTO if is_auto else ""}{self.rules()}/>'


def ours_and_theirs(text, leaves, told, ports=None):
    """Tick both as often as something is told; return what happened, up to the first exception."""
    said = []
    now = 0.0
    twin = Twin(text, leaves, ENUMS, ports)
    tree = load_xml(
        text,
        registry_for({"leaves": leaves, "ports": ports or {}}, said),
        clock=lambda: now,
        enums=ENUMS,
    )
    happened = []
    for values in told:
        said.clear()
        now = twin.world.now = now + 1.0
        twin.world.board.update(values)
        tree.blackboard.update(values)
        try:
            expected = twin.tick()
        except Thrown:
            with pytest.raises(NodeError):
                tree.tick_once()
            assert said == twin.world.said, text
            break
        tree.tick_once()
        outcome = "SKIPPED" if tree.status is Status.INVALID else tree.status.name
        ours = [
            entry
            for subtree in (tree, *subtrees_of(tree))
            for entry in ("|", *entries(subtree.blackboard))
        ]
        theirs = [entry for board in twin.world.boards for entry in ("|", *entries(board.data))]
        happened.append(([*said, outcome, *ours], [*expected, *theirs]))
    return happened


@pytest.mark.parametrize("case", RANDOM, ids=range(len(RANDOM)))
def test_twin_does_what_behaviortree_cpp_recorded_of_itself(case):
    twin = Twin(case["xml"], case["leaves"])
    for number, line in enumerate(case["trace"]):
        *said, outcome = twin.tick()
        assert f"{number}| {' '.join([*said, ''])}=> {outcome}" == line


def entries(board):
    """Return what a blackboard holds in words, with the kind of each number."""
    return [
        f"{key}={type(board[key]).__name__} {board[key]}"
        for key in sorted(board)
        if board[key] is not None
    ]


def lived(seed, rules, news):
    """Return how long a random tree was ticked until it raised, if it did.

    It does what its twin does.
    """
    grower = Grower(seed, rules)
    said = Random(news)
    text = grower.file()
    told = [
        START,
        *(
            {"x": said.random() < 0.5} if rules and said.random() < 0.5 else {}
            for _ in range(TICKS)
        ),
    ]
    happened = ours_and_theirs(text, grower.leaves, told, grower.ports)
    for ours, theirs in happened:
        assert ours == theirs, text
    return len(happened)


@settings(max_examples=150)
@given(st.integers(0, 2**32), st.sampled_from([0.0, 0.1, 0.3]), st.integers(0, 2**32))
def test_tree_that_is_read_does_what_its_twin_does(seed, rules, news):
    lived(seed, rules, news)


@pytest.mark.benchmark
def test_ten_thousand_random_trees_do_what_their_twins_do():
    lives = [lived(seed, (0.0, 0.1, 0.3)[seed % 3], seed + 1) for seed in range(10_000)]
    print(len(lives), "trees,", sum(lives), "ticks")
    assert sum(life > TICKS for life in lives) > 5_000


def test_random_trees_hold_every_node_that_the_twin_knows():
    texts = "".join(Grower(seed, 0.3).file() for seed in range(200))
    assert [tag for tag in (*KINDS, *RULES) if tag not in texts] == []
