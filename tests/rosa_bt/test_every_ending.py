"""Whatever happens to a tree, nothing is left open, released twice or running."""

from contextlib import suppress
from dataclasses import dataclass

from acting import Clock, rover
from hypothesis import given, settings
from hypothesis import strategies as st
from py_trees.behaviour import Behaviour
from py_trees.common import ParallelPolicy, Status
from py_trees.composites import Parallel, Selector, Sequence
from py_trees.decorators import FailureIsRunning, Inverter

from kb import KnowledgeBase
from rosa_bt import (
    ForAction,
    IsActionFeasible,
    RosaAction,
    TraceVisitor,
    TreeRunner,
    do_until_unfeasible,
)
from rosa_bt.decorators import UntilSuccess
from rosa_bt.requests import requests_of

STEPS = ["running", "running", "success", "failure", "raise", "nonsense"]
RAISING = [*["nowhere"] * 4, "initialise", "terminate", "tick", "save", "halting"]


class Unruly:
    """Does what its script says, and raises where it is told to."""

    script: list[str]
    raising: str
    count = 0

    def tick(self):
        if self.raising == "tick" and self.count % 3 == 2:
            self.count += 1
            raise RuntimeError("in tick")
        yield from super().tick()

    def initialise(self):
        if self.raising == "initialise":
            raise RuntimeError("in initialise")

    def terminate(self, new_status):
        if self.raising == "terminate":
            raise RuntimeError("in terminate")

    def save_progress(self):
        if self.raising == "save":
            raise RuntimeError("in save_progress")

    def update(self):
        step = self.script[self.count % len(self.script)]
        self.count += 1
        if step == "raise":
            raise ValueError("in update")
        if step == "nonsense":
            return None
        return Status[step.upper()]


class Plain(Unruly, Behaviour):
    def __init__(self, name, script, raising):
        super().__init__(name)
        self.script = script
        self.raising = raising


class Rash(Sequence):
    """Raises in every third tick, after its children were ticked."""

    count = 0

    def tick(self):
        self.count += 1
        for child in self.children:
            yield from child.tick()
        if self.count % 3 == 0:
            raise RuntimeError("in tick")
        self.status = Status.RUNNING
        yield self


class Acting(Unruly, RosaAction):
    """Takes some calls to halt."""

    halted = 0

    def __init__(self, kb, action, script, raising, halts):
        super().__init__(action, kb, action)
        self.script = script
        self.raising = raising
        self.halts = halts

    def initialise(self):
        halting = [request.owner.action for request in requests_of(self.kb).halting]
        assert self.action not in halting, "it has begun before the other one has halted"
        self.halted = 0
        super().initialise()

    def halting(self):
        self.halted += 1
        if self.raising == "halting":
            raise RuntimeError("in halting")
        return Status.RUNNING if self.halted < self.halts else Status.SUCCESS


@dataclass(frozen=True)
class Plan:
    """How to build a tree: drawn once, built with a knowledge base of its own."""

    kind: str
    action: str = "rest"
    script: tuple[str, ...] = ("running",)
    raising: str = "nowhere"
    memory: bool = False
    children: tuple["Plan", ...] = ()
    halts: int = 0

    def build(self, kb):
        children = [child.build(kb) for child in self.children]
        unruly = (list(self.script), self.raising)
        policy = ParallelPolicy.SuccessOnAll(synchronise=self.memory)
        made = {
            "plain": lambda: Plain("plain", *unruly),
            "acting": lambda: Acting(kb, self.action, *unruly, self.halts),
            "condition": lambda: IsActionFeasible("feasible?", kb, self.action),
            "rash": lambda: Rash("rash", memory=False, children=children),
            "selector": lambda: Selector("selector", memory=self.memory, children=children),
            "sequence": lambda: Sequence("sequence", memory=self.memory, children=children),
            "parallel": lambda: Parallel("parallel", policy, children),
            "or else": lambda: do_until_unfeasible(*children[:2], memory=self.memory),
            "inverter": lambda: Inverter("inverter", *children),
            "until": lambda: UntilSuccess("until", *children),
            "go on": lambda: FailureIsRunning("go on", *children),
            "for": lambda: ForAction("for", kb, self.action, *children, wait=self.memory),
        }
        return made[self.kind]()


ACTIONS = st.sampled_from(["scan", "rest"])
LEAVES = st.builds(
    Plan,
    st.sampled_from(["plain", "acting", "acting", "condition"]),
    ACTIONS,
    st.lists(st.sampled_from(STEPS), min_size=1, max_size=4).map(tuple),
    st.sampled_from(RAISING),
    halts=st.sampled_from([0, 0, 1, 2, 4]),
)


def branches(children):
    def built(kinds, fewest, most):
        several = st.lists(children, min_size=fewest, max_size=most).map(tuple)
        return st.builds(
            Plan, st.sampled_from(kinds), ACTIONS, memory=st.booleans(), children=several
        )

    return st.one_of(
        built(["selector", "sequence", "parallel", "rash"], 1, 3),
        built(["or else"], 2, 2),
        built(["inverter", "until", "go on", "for"], 1, 1),
    )


TREES = st.recursive(LEAVES, branches, max_leaves=8)
HAPPENINGS = st.one_of(
    st.sampled_from([("light", 0.1), ("light", 0.9), ("interrupt", 0), ("nothing", 0)]),
    st.tuples(st.sampled_from(["prune", "replace", "insert"]), st.integers(0, 20)),
)


def happen(what, number, kb, runner, spare):
    """Have something happen between two ticks; return a subtree that may be taken out by it."""
    nodes = list(runner.tree.root.iterate())
    node = nodes[number % len(nodes)] if isinstance(number, int) else None
    if what == "light":
        kb.measure("light", number)
    elif what == "interrupt":
        runner.tree.root.stop(Status.INVALID)
    elif what == "insert":
        with suppress(TypeError):  # of a parent that is no composite
            runner.tree.insert_subtree(spare.build(kb), node.id, number % 3)
    elif what in ("prune", "replace"):
        with suppress(RuntimeError):  # of the root, or the child of a decorator
            given = [] if what == "prune" else [spare.build(kb)]
            getattr(runner.tree, f"{what}_subtree")(node.id, *given)
        return [node]
    return []


@settings(max_examples=150)
@given(TREES, st.lists(HAPPENINGS, min_size=3, max_size=10), TREES)
def test_request_is_released_exactly_once_whatever_happens(plan, happenings, spare):
    kb = KnowledgeBase(rover(), clock=Clock())
    released = []
    cancel = kb.cancel_action
    kb.cancel_action = lambda action, *how: (released.append(action), cancel(action, *how))
    runner = TreeRunner(plan.build(kb), clock=Clock())
    visitor = TraceVisitor(kb)
    runner.tree.add_visitor(visitor)
    requests = requests_of(kb)
    taken_out = []
    for what, number in happenings:
        taken_out += happen(what, number, kb, runner, spare)
        runner.tick()
        nodes = list(runner.tree.root.iterate())
        for node in nodes:
            if node.status is Status.RUNNING and node is not runner.tree.root:
                assert node.parent.status is Status.RUNNING, (
                    f"{node.name} runs, its parent does not"
                )
        shown = visitor.trace.ticks[-1]
        assert shown.tree[shown.visited[-1].node].name == runner.tree.root.name
        running = {node.action for node in nodes if is_requesting(node)}
        halting = {request.owner.action for request in requests.halting}
        assert {request.action for request in kb.required_actions} == running | halting
    runner.shutdown()
    assert kb.required_actions == ()
    assert requests.halting == {}
    assert len(released) == len(kb.history.actions)
    assert len(visitor.trace.ticks) == len(happenings)
    for root in (runner.tree.root, *taken_out):
        assert all(node.status is not Status.RUNNING for node in root.iterate())


def is_requesting(node):
    is_action = isinstance(node, RosaAction | ForAction) and node.status is Status.RUNNING
    return is_action and not node.feedback_message.startswith("waiting until")
