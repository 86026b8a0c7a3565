"""What asking the knowledge base adds to a tick of a tree of plain py_trees."""

from collections.abc import Callable
from statistics import median
from time import thread_time

import pytest
from py_trees.behaviour import Behaviour
from py_trees.behaviours import Failure, Running, Success
from py_trees.common import Status
from py_trees.composites import Selector, Sequence
from py_trees.trees import BehaviourTree

from kb import KnowledgeBase, Model
from missions.engine.mission import Percepts
from missions.suave_extended.model import suave_extended_model
from missions.suave_extended.tree import suave_extended_tree
from rosa_bt import IsActionFeasible, TraceVisitor, TreeRunner
from rosa_bt.composites import DoUntilUnfeasible
from rosa_bt.decorators import UntilSuccess

pytestmark = pytest.mark.benchmark(group="trees")

CONSTANT = {Status.SUCCESS: Success, Status.FAILURE: Failure, Status.RUNNING: Running}
ROUNDS, TICKS = 30, 100


def searching() -> tuple[KnowledgeBase, Percepts]:
    """Return knowledge base and percepts of a vehicle that searches, with a full battery."""
    kb = KnowledgeBase(suave_extended_model(), clock=lambda: 0.0)
    kb.measure("water_visibility", 3.5)
    kb.measure("battery_level", 1.0)
    return kb, Percepts()


def inspecting() -> tuple[KnowledgeBase, Percepts]:
    """Return the same when the pipeline is found."""
    kb, percepts = searching()
    percepts.receive(
        {"status": [{"message": "mission status", "values": {"pipeline_found": "true"}}]}
    )
    return kb, percepts


def recharging() -> tuple[KnowledgeBase, Percepts]:
    """Return the same when the battery is low."""
    kb, percepts = inspecting()
    kb.measure("battery_level", 0.2)
    return kb, percepts


def constant(node: Behaviour) -> Behaviour:
    """Return a twin of a ticked tree, of plain nodes, whose leaves repeat their status."""
    children = [constant(child) for child in node.children]
    if not children:
        return CONSTANT.get(node.status, Running)(node.name)
    if isinstance(node, Sequence):
        return Sequence(node.name, node.memory, children)
    if isinstance(node, UntilSuccess):
        return UntilSuccess(node.name, *children)
    assert isinstance(node, Selector | DoUntilUnfeasible)
    return Selector(node.name, node.memory, children)


def seconds(tick: Callable[[], object], ticks: int) -> float:
    started = thread_time()
    for _ in range(ticks):
        tick()
    return thread_time() - started


def ratio(ours: Callable[[], object], plain: Callable[[], object], ticks: int = TICKS) -> float:
    """Return how many times as much time of a processor ours takes, the two by turns."""
    seconds(ours, ticks), seconds(plain, ticks)
    pairs = [(seconds(ours, ticks), seconds(plain, ticks)) for _ in range(ROUNDS)]
    return median(one / other for one, other in pairs)


def report(what: str, found: float, limit: float) -> None:
    print(f"\n{what}: {found:.2f} times (at most {limit})")
    assert found <= limit


@pytest.mark.parametrize("situation", [searching, inspecting, recharging])
def test_tree_that_asks_ticks_nearly_as_fast_as_one_of_constants(situation):
    kb, percepts = situation()
    runner = TreeRunner(suave_extended_tree(kb, percepts), clock=lambda: 0.0)
    runner.tick()
    plain = BehaviourTree(constant(runner.tree.root))
    report(f"asking while {situation.__name__}", ratio(runner.tick, plain.tick), 1.3)
    assert runner.status is plain.root.status is Status.RUNNING


@pytest.mark.parametrize("situation", [searching, inspecting, recharging])
def test_traced_tree_ticks_at_most_three_times_as_long(situation, tmp_path):
    kb, percepts = situation()
    runner = TreeRunner(suave_extended_tree(kb, percepts), clock=lambda: 0.0)
    runner.tick()
    plain = BehaviourTree(constant(runner.tree.root))
    with TraceVisitor(kb, tmp_path / "run.jsonl") as visitor:
        runner.tree.add_visitor(visitor)
        report(f"traced while {situation.__name__}", ratio(runner.tick, plain.tick), 3.0)


def big(conditions: int, condition: Callable[[int], Behaviour]) -> Behaviour:
    """Return a tree of 1,000 nodes, all ticked each time: so many conditions, the rest constant."""
    root = Sequence("root", memory=False)
    number = 0
    for group in range(111):
        selector = Selector(f"group {group}", memory=False)
        for place in range(8):
            leaf = condition(number) if place == 7 and number < conditions else None
            number += place == 7
            selector.add_child(
                leaf or (Success if place == 7 else Failure)(f"leaf {group} {place}")
            )
        root.add_child(selector)
    return root


def test_thousand_nodes_tick_nearly_as_fast_as_plain_ones():
    model = Model("many")
    level = model.quality_attribute("level")
    for number in range(100):
        model.action(f"action_{number}", constraints=[level >= number / 1000])
    kb = KnowledgeBase(model, clock=lambda: 0.0)
    kb.measure("level", 1.0)
    asking = big(
        100, lambda number: IsActionFeasible(f"feasible {number}?", kb, f"action_{number}")
    )
    plain = BehaviourTree(big(100, lambda number: Success(f"feasible {number}?")))
    assert len(list(asking.iterate())) == 1000
    report(
        "1,000 nodes", ratio(TreeRunner(asking, clock=lambda: 0.0).tick, plain.tick, ticks=10), 1.3
    )
