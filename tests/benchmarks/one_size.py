"""What a robot of one size costs, measured in a process of its own: `python one_size.py 10000` prints it as JSON.

A robot of the smallest size is measured in turn with it, so that whatever else the machine does slows down both.
"""

import json
import resource
import sys
from collections.abc import Callable
from itertools import chain
from pathlib import Path
from random import Random
from statistics import median
from time import perf_counter

from generated import SUBSYSTEM, Happening, at_work, disturbance, robot, story, tell

from kb import KnowledgeBase, PriorityPlanner

EVENTS = ("measured", "failed", "active", "requested", "selected")
SMALLEST = 100
ROUNDS = 20
TOLD = 60
ASKED = 20

Times = dict[str, list[float]]


def state_of(kb):
    """The facts and statuses of a base."""
    with kb.reading() as state:
        return state


def time_of(call: Callable[..., object], *arguments: object) -> float:
    start = perf_counter()
    call(*arguments)
    return perf_counter() - start


def peak_memory() -> int:
    """Return the most memory that this process ever had [bytes]."""
    status = Path("/proc/self/status")
    if (
        status.exists()
    ):  # what Linux gives as resource usage begins with that of the process which started this one
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM:"))
        return int(line.split()[1]) * 1024
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def events(kb: KnowledgeBase, size: int, number: int) -> tuple[Times, dict[str, int]]:
    """Return how long each event of each kind took [s], and how many elements were consulted for all of that kind."""
    times, visited = {}, {}
    for kind in EVENTS:
        before = state_of(kb).visited
        times[kind] = [time_of(tell, kb, one) for one in story((kind,), size, TOLD, seed=number)]
        visited[kind] = state_of(kb).visited - before
    return times, visited


def adaptations(kb: KnowledgeBase, size: int, number: int) -> list[float]:
    """Return how long each plan after a failure took [s]; all is as it was afterwards."""
    draw, where, times = Random(number), Random(number), []
    for _ in range(ASKED):
        here = where.randrange(size // SUBSYSTEM)
        failed, recovered = disturbance("failed", here, draw)
        before = [one._replace(value=holds(kb, one)) for one in surroundings(here, size)]
        tell(kb, failed)
        times.append(time_of(PriorityPlanner().plan, kb))
        if kb.pending_plan:
            kb.finish_plan(kb.pending_plan, "completed")
        tell(kb, recovered)
        for one in before:
            tell(kb, one)
    return times


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


def questions(kb: KnowledgeBase, size: int, number: int) -> Times:
    """Return how long each question took [s], about places all over the robot."""
    where = Random(number)
    places = [where.randrange(size // SUBSYSTEM) for _ in range(ASKED)]
    busy = [f"action 1 of {here}" for here in places]

    def suppose(here: int) -> bool:
        measured = {f"attribute 0 of {here}": 0.3, f"attribute 1 of {here}": 0.7}
        return kb.situation(measured).is_feasible(f"action 1 of {here}")

    return {
        "situation": [time_of(suppose, here) for here in places],
        "explain": [time_of(kb.explain, kb.actions[name]) for name in busy],
        "is_feasible": [time_of(kb.is_feasible, name) for name in busy],
    }


def one_round(kb: KnowledgeBase, size: int, number: int) -> tuple[Times, dict[str, int]]:
    times, visited = events(kb, size, number)
    return {**times, "plan": adaptations(kb, size, number), **questions(kb, size, number)}, visited


def medians(rounds: list[Times]) -> dict[str, float]:
    return {
        name: median(chain.from_iterable(times[name] for times in rounds)) for name in rounds[0]
    }


def main(size: int) -> None:
    start = perf_counter()
    model = robot(size)
    declared = perf_counter()
    kb = KnowledgeBase(model)
    built, memory = perf_counter(), peak_memory()
    del kb
    here, small = at_work(model), at_work(robot(SMALLEST))
    rounds = [
        (one_round(small, SMALLEST, number)[0], one_round(here, size, number))
        for number in range(ROUNDS)
    ]
    visited = {
        kind: sum(found[1][kind] for _, found in rounds) / (ROUNDS * TOLD) for kind in EVENTS
    }
    p50, base = medians([found[0] for _, found in rounds]), medians([found for found, _ in rounds])
    found = {
        "model_s": declared - start,
        "build_s": built - start,
        "memory": memory,
        "visited": visited,
    }
    print(
        json.dumps({**found, "p50": p50, "ratio": {name: p50[name] / base[name] for name in p50}})
    )


if __name__ == "__main__":
    main(int(sys.argv[1]))
