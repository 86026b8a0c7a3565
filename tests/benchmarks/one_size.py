"""What a robot of one size costs, measured in a process of its own: `python one_size.py 10000` prints it as JSON."""

import json
import resource
import sys
from collections.abc import Callable
from random import Random
from statistics import median
from time import perf_counter

from generated import SUBSYSTEM, Happening, at_work, disturbance, robot, story, tell, wiring

from kb import KnowledgeBase, PriorityPlanner

EVENTS = ("measured", "failed", "active", "requested", "selected")
TOLD = 600
ASKED = 200


def time_of(call: Callable[..., object], *arguments: object) -> float:
    start = perf_counter()
    call(*arguments)
    return perf_counter() - start


def peak_memory() -> int:
    """Return the most memory that this process ever had [bytes]."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def events(kb: KnowledgeBase, size: int) -> tuple[dict[str, float], dict[str, int]]:
    """Return the median time of each kind of event [s], and how many elements all of that kind consulted."""
    times, visited = {}, {}
    for kind in EVENTS:
        before = kb._state.visited
        times[kind] = median(time_of(tell, kb, one) for one in story((kind,), size, TOLD, seed=1))
        visited[kind] = kb._state.visited - before
    return times, visited


def adaptations(kb: KnowledgeBase, size: int) -> float:
    """Return the median time of a plan after a component failed [s]; all is as it was afterwards."""
    draw, where, times, wired = Random(2), Random(2), [], wiring(0)
    for _ in range(ASKED):
        here = where.randrange(size // SUBSYSTEM)
        failed, recovered = disturbance("failed", wired, here, draw)
        before = [one._replace(value=holds(kb, one)) for one in surroundings(here, size)]
        tell(kb, failed)
        times.append(time_of(PriorityPlanner().plan, kb))
        if kb.pending_plan:
            kb.finish_plan(kb.pending_plan, "completed")
        tell(kb, recovered)
        for one in before:
            tell(kb, one)
    return median(times)


def surroundings(here: int, size: int) -> list[Happening]:
    """Return what a plan may change when something happens in a subsystem."""
    count = size // SUBSYSTEM
    kinds = (("active", "component"), ("selected", "design"), ("selected", "configuration"))
    return [
        Happening(what, f"{kind} {number} of {there % count}", False)
        for there in (here - 1, here, here + 1)
        for what, kind in kinds
        for number in range(8)
    ]


def holds(kb: KnowledgeBase, one: Happening) -> bool:
    if one.what == "active":
        return kb.components[one.name].is_active
    return (kb.designs if one.name in kb.model.designs else kb.configurations)[one.name].is_selected


def questions(kb: KnowledgeBase, size: int) -> dict[str, float]:
    """Return the median time of each question [s], about places all over the robot."""
    where = Random(3)
    places = [where.randrange(size // SUBSYSTEM) for _ in range(ASKED)]
    busy = [f"action 1 of {here}" for here in places]

    def suppose(here: int) -> bool:
        measured = {f"attribute 0 of {here}": 0.3, f"attribute 1 of {here}": 0.7}
        return kb.situation(measured).is_feasible(f"action 1 of {here}")

    return {
        "situation": median(time_of(suppose, here) for here in places),
        "explain": median(time_of(kb.explain, kb.actions[name]) for name in busy),
        "is_feasible": median(time_of(kb.is_feasible, name) for name in busy),
    }


def main(size: int) -> None:
    start = perf_counter()
    model = robot(size)
    declared = perf_counter()
    kb = KnowledgeBase(model)
    built, memory = perf_counter(), peak_memory()
    del kb
    kb = at_work(model)
    times, visited = events(kb, size)
    found = {"model_s": declared - start, "build_s": built - start, "memory": memory, "visited": visited}
    print(json.dumps({**found, "p50": {**times, "plan": adaptations(kb, size), **questions(kb, size)}}))


if __name__ == "__main__":
    main(int(sys.argv[1]))
