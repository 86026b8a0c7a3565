"""Measure the calls of a knowledge base of one size; prints microseconds a call as JSON.

It runs in a process of its own with the checkout that is to be measured first on the path.
"""

import json
import sys
from collections.abc import Callable
from time import process_time

from generated import CALM, at_work, robot

from kb import KnowledgeBase, PriorityPlanner


def alternating(*calls: Callable[[], object]) -> Callable[[], None]:
    def run() -> None:
        for call in calls:
            call()

    return run


def plan(kb: KnowledgeBase) -> None:
    """Deselect a design, and plan anew."""
    kb.assert_selected(kb.designs["design 2 of 0"], False)
    made = PriorityPlanner().plan(kb)
    if made is not None:
        kb.finish_plan(made, "completed")


def operations(kb: KnowledgeBase) -> dict[str, tuple[Callable[[], object], int]]:
    """Return what is measured, and how many calls one run of it makes."""
    name = "attribute 0 of 0"

    def measure(value: float) -> Callable[[], None]:
        return lambda: kb.measure(name, value)

    failure = alternating(
        lambda: kb.component_failed("component 0 of 0"),
        lambda: kb.component_recovered("component 0 of 0"),
    )
    return {
        "measure, no change": (measure(CALM), 1),
        "measure, across a threshold": (alternating(measure(0.3), measure(CALM)), 2),
        "is_feasible": (lambda: kb.is_feasible("action 0 of 0"), 1),
        "failure": (failure, 2),
        "plan": (lambda: plan(kb), 1),
        "situation": (lambda: kb.situation({name: 0.3}).is_feasible("action 0 of 0"), 1),
    }


def microseconds(call: Callable[[], object], seconds: float) -> float:
    """Return the time of the quickest of ten rounds."""
    call()
    begin = process_time()
    call()
    rounds = max(1, int(seconds / 10 / (process_time() - begin + 1e-9)))
    best = float("inf")
    for _ in range(10):
        begin = process_time()
        for _ in range(rounds):
            call()
        best = min(best, (process_time() - begin) / rounds)
    return best * 1e6


if __name__ == "__main__":
    base = at_work(robot(int(sys.argv[1])))
    figures = {
        title: microseconds(call, 0.3) / count for title, (call, count) in operations(base).items()
    }
    print(json.dumps(figures))
