"""Whatever a tree does and whatever happens to it, nothing is left open, released twice or running."""

from contextlib import suppress
from dataclasses import dataclass, replace

from hypothesis import given, settings
from hypothesis import strategies as st
from py_trees.behaviour import Behaviour
from py_trees.common import ParallelPolicy, Status
from py_trees.composites import Parallel, Selector, Sequence
from py_trees.decorators import FailureIsRunning, Inverter

from kb import KnowledgeBase, Model
from rosa_bt import (
    ForAction,
    IsActionFeasible,
    RosaAction,
    TraceVisitor,
    TreeRunner,
    do_until_unfeasible,
    feasible_then_act,
)
from rosa_bt.decorators import UntilSuccess
from rosa_bt.requests import requests_of

STEPS = ["running", "running", "success", "failure", "raise", "nonsense"]
RAISING = ["nowhere", "nowhere", "nowhere", "initialise", "terminate", "tick", "save"]


def rover() -> KnowledgeBase:
    model = Model("rover")
    light = model.environmental_attribute("light")
    model.action("scan", constraints=[light >= 0.5])
    model.action("rest")
    return KnowledgeBase(model, clock=lambda: 0.0)


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
        self.script, self.raising = script, raising


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
    def __init__(self, kb, action, script, raising):
        super().__init__(action, kb, action)
        self.script, self.raising = script, raising


class Braking(Acting):
    """Takes some calls to halt."""

    halts = halted = 0

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
        if self.kind == "plain":
            return Plain("plain", list(self.script), self.raising)
        if self.kind == "acting":
            return Acting(kb, self.action, list(self.script), self.raising)
        if self.kind == "braking":
            action = Braking(kb, self.action, list(self.script), self.raising)
            action.halts = self.halts
            return action
        if self.kind == "guarded":
            return feasible_then_act(Acting(kb, self.action, list(self.script), self.raising))
        if self.kind == "rash":
            return Rash("rash", memory=False, children=children)
        if self.kind == "condition":
            return IsActionFeasible("feasible?", kb, self.action)
        if self.kind == "selector":
            return Selector("selector", memory=self.memory, children=children)
        if self.kind == "sequence":
            return Sequence("sequence", memory=self.memory, children=children)
        if self.kind == "parallel":
            return Parallel(
                "parallel",
                policy=ParallelPolicy.SuccessOnAll(synchronise=self.memory),
                children=children,
            )
        if self.kind == "or else":
            return (
                do_until_unfeasible(children[0], children[-1], memory=self.memory)
                if children[1:]
                else children[0]
            )
        decorators = {"inverter": Inverter, "until": UntilSuccess, "go on": FailureIsRunning}
        if self.kind in decorators:
            return decorators[self.kind](self.kind, children[0])
        return ForAction("for", kb, self.action, children[0], wait=self.memory)


ACTIONS = st.sampled_from(["scan", "rest"])
LEAVES = st.builds(
    Plan,
    st.sampled_from(["plain", "acting", "acting", "condition"]),
    ACTIONS,
    st.lists(st.sampled_from(STEPS), min_size=1, max_size=4).map(tuple),
    st.sampled_from(RAISING),
)
SLOW_LEAVES = st.builds(
    Plan,
    st.sampled_from(["braking", "braking", "braking", "condition"]),
    ACTIONS,
    st.lists(st.sampled_from(STEPS), min_size=1, max_size=4).map(tuple),
    st.sampled_from([*RAISING, "halting"]),
    halts=st.integers(0, 4),
)


def branches(children):
    composites = st.sampled_from(["selector", "sequence", "parallel", "or else", "rash"])
    many = st.lists(children, min_size=1, max_size=3).map(tuple)
    one = st.tuples(children)
    decorators = st.sampled_from(["inverter", "until", "go on", "for"])
    return st.one_of(
        st.builds(Plan, composites, ACTIONS, memory=st.booleans(), children=many),
        st.builds(Plan, decorators, ACTIONS, memory=st.booleans(), children=one),
    )


TREES = st.recursive(LEAVES, branches, max_leaves=8)
SLOW_TREES = st.recursive(SLOW_LEAVES, branches, max_leaves=8)
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


@settings(max_examples=100)
@given(TREES, st.lists(HAPPENINGS, min_size=3, max_size=10), TREES)
def test_no_request_is_open_or_released_twice_and_nothing_runs_whatever_happened(
    plan, happenings, spare
):
    kb = rover()
    released = []
    cancel = kb.cancel_action
    kb.cancel_action = lambda action, *how: (released.append(action), cancel(action, *how))
    runner = TreeRunner(plan.build(kb), clock=lambda: 0.0)
    visitor = TraceVisitor(kb)
    runner.tree.add_visitor(visitor)
    taken_out = []
    for what, number in happenings:
        taken_out += happen(what, number, kb, runner, spare)
        runner.tick()
        nodes = list(runner.tree.root.iterate())
        for node in nodes:
            if node.status is Status.RUNNING and node is not runner.tree.root:
                assert node.parent.status is Status.RUNNING, (
                    f"{node.name} runs, {node.parent.name} does not"
                )
        shown = visitor.trace.ticks[-1]
        assert [shown.tree[visit.node].name for visit in shown.visited][-1] == runner.tree.root.name
        held = {node.action for node in nodes if is_holding(node)}
        assert {one.action for one in kb.required_actions} == held
    runner.shutdown()
    assert kb.required_actions == ()
    assert len(released) == len(kb.history.actions)
    assert len(visitor.trace.ticks) == len(happenings)
    left = [
        *runner.tree.root.iterate(),
        *(node for subtree in taken_out for node in subtree.iterate()),
    ]
    assert all(node.status is not Status.RUNNING for node in left)


@settings(max_examples=150)
@given(SLOW_TREES, st.lists(HAPPENINGS, min_size=3, max_size=10), SLOW_TREES)
def test_actions_that_halt_slowly_are_released_exactly_once(plan, happenings, spare):
    kb = rover()
    released = []
    cancel = kb.cancel_action
    kb.cancel_action = lambda action, *how: (released.append(action), cancel(action, *how))
    runner = TreeRunner(plan.build(kb), clock=lambda: 0.0)
    requests = requests_of(kb)
    for what, number in happenings:
        happen(what, number, kb, runner, spare)
        runner.tick()
        open_ = {action for action, requesters in requests.requesters.items() if requesters}
        assert {request.action for request in kb.required_actions} == open_
        for requesters in requests.requesters.values():
            for request in requesters:
                assert request.owner.status is Status.RUNNING or request.is_halting
    runner.shutdown()
    assert kb.required_actions == ()
    assert requests.halting == {}
    assert len(released) == len(kb.history.actions)


def is_holding(node):
    return isinstance(node, RosaAction | ForAction) and node.status is Status.RUNNING


@settings(max_examples=80)
@given(TREES, st.lists(st.sampled_from([0.1, 0.9]), min_size=2, max_size=10))
def test_no_guarded_action_runs_after_the_tick_that_follows_its_becoming_unfeasible(plan, light):
    kb = rover()
    guarded = guard_actions(plan).build(kb)
    runner = TreeRunner(guarded, clock=lambda: 0.0)
    for value in light:
        kb.measure("light", value)
        runner.tick()
        running = {node.action for node in guarded.iterate() if is_holding(node)}
        assert kb.is_feasible("scan") or "scan" not in running
    runner.shutdown()


def guard_actions(plan):
    """Return the same plan with every action asked for where it is done."""
    children = tuple(guard_actions(child) for child in plan.children)
    if plan.kind == "acting" and plan.script[0] != "success":
        return replace(plan, kind="guarded", children=children)
    if plan.kind in ("plain", "acting"):
        return replace(plan, kind="for", children=(replace(plan, kind="plain"),))
    return replace(plan, children=children)
