"""A trace decided once more: the recorded facts are told at their times, and the tree is ticked as it was."""

from collections.abc import Callable

from py_trees.behaviour import Behaviour

from kb import KnowledgeBase, Model
from rosa_bt.exceptions import TraceError
from rosa_bt.facts import tell
from rosa_bt.traces import Trace
from rosa_bt.trees import TreeRunner
from rosa_bt.visitors import TraceVisitor

__all__ = ["replay_trace"]


def replay_trace(trace: Trace, model: Model, build: Callable[[KnowledgeBase], Behaviour]) -> Trace:
    """Return the trace of a tree that is told what another one was told.

    It equals the recorded one as long as model and tree are the same and every leaf decides by the knowledge base.

    Args:
        trace: from the first tick on.
        model: what the robot is made of and can do.
        build: makes the tree, for the knowledge base of the replay.

    Raises:
        TraceError: the first ticks are missing.
        kb.KnowledgeBaseError: the model does not know what was told.
    """
    if trace.ticks and trace.ticks[0].number:
        raise TraceError(f"the trace begins at tick {trace.ticks[0].number}; keep all ticks, or write them to a file")
    now = trace.ticks[0].time if trace.ticks else 0.0

    def clock() -> float:
        return now

    kb = KnowledgeBase(model, clock=clock)
    runner = TreeRunner(build(kb), clock=clock)
    with TraceVisitor(kb, keep=len(trace.ticks) or 1) as visitor:
        runner.tree.add_visitor(visitor)
        for tick in trace.ticks:
            for fact in tick.facts:
                now = fact.time
                tell(kb, fact)
            now = tick.time
            runner.tick()
        runner.shutdown()
        return visitor.trace
