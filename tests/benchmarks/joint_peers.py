"""Other ways to plan corridors and configurations: exhaustively, by axioms of PDDL, and by generating and testing.

The first two read model and map by themselves: they share neither situations nor sums with the planner they judge.
"""

import subprocess
import sys
from collections.abc import Iterator, Mapping
from heapq import heappop, heappush
from itertools import product
from math import inf, prod
from pathlib import Path
from typing import NamedTuple

from kb import Model
from kb.status import OPERATORS
from missions.agv.joint import Place, Question, Task
from missions.agv.model import Building, Corridor
from rosa_pddl.search import distances
from rosa_pddl.worker import fast_downward_command

GOALS = {"time": 1e3, "energy": 1e3, "collisions": 1e6}
WORTH = {"time": 1.0, "energy": 1.0, "collisions": 1e-3}
OFF = ("", "")
_TRIALS = 20_000
Setup = tuple[str, str]
"""A design and a setting of the base; both empty while nothing runs."""


class Robot(NamedTuple):
    """A vehicle with a base of several settings, in a building."""

    building: Building
    model: Model
    failed: tuple[str, ...]

    @property
    def setups(self) -> list[Setup]:
        return list(product(self.model.designs, self.model.configurations))

    def violated(self, corridor: Corridor) -> list[int]:
        """Return the numbers of the constraints that a corridor violates."""
        demands = {"light": corridor.light, "obstacles": corridor.obstacles}
        return [
            number
            for number, one in enumerate(self.model.constraints)
            if not OPERATORS[one.operator](demands[one.attribute], one.value)
        ]

    def possible(self, corridor: Corridor) -> list[Setup]:
        forbidden = {
            each.name
            for one in self.violated(corridor)
            for each in self.model.constraints[one].constrained
        }
        return [
            (design, setting)
            for design, setting in self.setups
            if not forbidden & {design, setting, *self.parts(design)}
            and not self.parts(design) & set(self.failed)
        ]

    def parts(self, design: str) -> set[str]:
        return set(self.model.designs[design].components) if design else set()

    def taken(self, setup: Setup, attribute: str) -> float:
        names = {*setup, *self.parts(setup[0])}
        return sum(
            one.value
            for one in self.model.estimations
            if one.attribute == attribute and one.causer.name in names
        )

    def crossing(self, corridor: Corridor, setup: Setup) -> dict[str, int]:
        collisions = corridor.obstacles * corridor.length_m * self.taken(setup, "safety")
        time_s = (
            corridor.length_m / self.model.configurations[setup[1]].parameters["speed"]
            + collisions * 30.0
        )
        amounts = {
            "time": time_s,
            "energy": time_s * self.taken(setup, "energy"),
            "collisions": collisions,
        }
        return {name: round(amount * GOALS[name]) for name, amount in amounts.items()}

    def switching(self, before: Setup, after: Setup) -> dict[str, int]:
        time_s = 0.5 * len(self.parts(before[0]) ^ self.parts(after[0])) + 0.1 * (
            before[1] != after[1]
        )
        return {"time": round(time_s * 1e3), "energy": round(time_s * 10.0 * 1e3), "collisions": 0}


def cost_of(amounts: Mapping[str, int], weights: Mapping[str, float]) -> int:
    return round(
        sum(weights.get(name, 0.0) * WORTH[name] * amount for name, amount in amounts.items())
    )


def simple_ways(building: Building, start: str, goal: str) -> Iterator[tuple[Corridor, ...]]:
    """Yield every way that visits no place twice."""
    waiting: list[tuple[tuple[Corridor, ...], tuple[str, ...]]] = [((), (start,))]
    while waiting:
        corridors, places = waiting.pop()
        if places[-1] == goal:
            yield corridors
            continue
        for one in building.exits[places[-1]]:
            if one.other(places[-1]) not in places:
                waiting.append(((*corridors, one), (*places, one.other(places[-1]))))


def by_exhaustion(robot: Robot, question: Question, most: int = 20_000) -> tuple[bool, int | None]:
    """Try every way in every sequence of setups; returns whether that could be finished, and the least cost."""
    possible = {name: robot.possible(one) for name, one in robot.building.corridors.items()}
    ways = list(simple_ways(robot.building, question.start.name, question.goal))
    if sum(prod(len(possible[one.name]) for one in way) for way in ways) > most:
        return False, None
    crossing = {
        (name, one): robot.crossing(robot.building.corridors[name], one)
        for name in possible
        for one in possible[name]
    }
    switching = {
        pair: robot.switching(*pair) for pair in product([OFF, *robot.setups], robot.setups)
    }
    best: int | None = None
    for way in ways:
        for chosen in product(*(possible[one.name] for one in way)):
            parts = []
            for before, setup, one in zip((OFF, *chosen), chosen, way, strict=False):
                there = crossing[one.name, setup]
                parts.append(
                    {
                        name: amount + there[name]
                        for name, amount in switching[before, setup].items()
                    }
                )
            used = {
                name: sum(part[name] for part in parts) / scale for name, scale in GOALS.items()
            }
            if any(used[name] > limit for name, limit in question.limits.items()):
                continue
            cost = sum(
                cost_of(switching[before, setup], question.weights)
                + cost_of(crossing[one.name, setup], question.weights)
                for before, setup, one in zip((OFF, *chosen), chosen, way, strict=False)
            )
            best = cost if best is None else min(best, cost)
    return True, best


DOMAIN = """(define (domain joint)
(:requirements :adl :typing :derived-predicates :action-costs)
(:types place way component constraint level state - object design - state setting - level)
(:predicates (at ?p - place) (runs ?d - state) (set ?s - level) (leads ?w - way ?a ?b - place)
  (part ?c - component ?d - design) (failed ?c - component) (violates ?w - way ?r - constraint)
  (constrains ?r - constraint ?d - design) (works ?d - design) (admits ?w - way ?d - design))
(:functions (total-cost) (switching ?d - state ?s - level ?e - design ?t - setting)
  (crossing ?w - way ?d - design ?s - setting))
(:derived (works ?d - design) (not (exists (?c - component) (and (part ?c ?d) (failed ?c)))))
(:derived (admits ?w - way ?d - design)
  (and (works ?d) (not (exists (?r - constraint) (and (violates ?w ?r) (constrains ?r ?d))))))
(:action switch :parameters (?d - state ?s - level ?e - design ?t - setting)
  :precondition (and (runs ?d) (set ?s) (works ?e))
  :effect (and (not (runs ?d)) (not (set ?s)) (runs ?e) (set ?t) (increase (total-cost) (switching ?d ?s ?e ?t))))
(:action cross :parameters (?w - way ?a ?b - place ?d - design ?s - setting)
  :precondition (and (at ?a) (leads ?w ?a ?b) (runs ?d) (set ?s) (admits ?w ?d))
  :effect (and (not (at ?a)) (at ?b) (increase (total-cost) (crossing ?w ?d ?s)))))
"""


def problem_pddl(robot: Robot, question: Question) -> str:
    """Return a question without limits as PDDL, in which what is possible has to be derived."""
    model, corridors = robot.model, robot.building.corridors
    objects = {
        "place": robot.building.places,
        "way": corridors,
        "component": model.components,
        "design": model.designs,
    }
    objects |= {"setting": model.configurations, "state": ["none"], "level": ["unset"]}
    objects["constraint"] = [f"r{number}" for number in range(len(model.constraints))]
    facts = [
        f"(at {question.start.name})",
        "(runs none)",
        "(set unset)",
        *(f"(failed {one})" for one in robot.failed),
    ]
    facts += [
        f"(part {part} {one})" for one in model.designs for part in model.designs[one].components
    ]
    for number, one in enumerate(model.constraints):
        facts += [f"(constrains r{number} {each.name})" for each in one.constrained]
    for name, one in corridors.items():
        facts += [f"(leads {name} {origin} {one.other(origin)})" for origin in one.ends]
        facts += [f"(violates {name} r{number})" for number in robot.violated(one)]
        for setup in robot.setups:
            cost = cost_of(robot.crossing(one, setup), question.weights)
            facts.append(f"(= (crossing {name} {' '.join(setup)}) {cost})")
    for before, after in product([OFF, *robot.setups], robot.setups):
        now = " ".join(before) if before != OFF else "none unset"
        cost = cost_of(robot.switching(before, after), question.weights)
        facts.append(f"(= (switching {now} {' '.join(after)}) {cost})")
    declared = "\n".join(f"{' '.join(names)} - {kind}" for kind, names in objects.items())
    written = "\n".join(["(= (total-cost) 0)", *facts])
    return (
        f"(define (problem joint) (:domain joint)\n(:objects {declared})\n(:init {written})\n"
        f"(:goal (at {question.goal}))\n(:metric minimize (total-cost)))"
    )


def by_axioms(robot: Robot, question: Question, folder: Path) -> int | None:
    """Have Fast Downward prove the least cost by A*; None if there is no plan. No planner of ours has a part in it."""
    (folder / "domain.pddl").write_text(DOMAIN)
    (folder / "problem.pddl").write_text(problem_pddl(robot, question))
    command = [
        sys.executable,
        "-m",
        "fast_downward.translate",
        "domain.pddl",
        "problem.pddl",
        "--sas-file",
        "task.sas",
    ]
    subprocess.run(command, cwd=folder, capture_output=True, check=True)
    folder = Path(fast_downward_command()[1]).parent
    program = folder / "builds" / "release" / "bin" / "downward"
    search = [str(program), "--search", "astar(blind())"]
    task = (folder / "task.sas").read_text()
    done = subprocess.run(
        search, cwd=folder, input=task, capture_output=True, text=True, check=False
    )
    costs = [int(line.split(": ")[1]) for line in done.stdout.splitlines() if "Plan cost: " in line]
    assert costs or "no plan exists" in done.stdout, done.stdout
    return costs[0] if costs else None


def shortest_ways(
    building: Building, start: str, goal: str, count: int
) -> Iterator[tuple[Corridor, ...]]:
    """Yield the shortest ways by length that visit no place twice; fewer if that takes too many trials."""
    arcs = [(one.ends[0], one.ends[1], one.length_m) for one in building.corridors.values()]
    left = distances(arcs + [(b, a, length) for a, b, length in arcs], [goal])
    queue: list[tuple[float, int, float, tuple[Corridor, ...], tuple[str, ...]]]
    queue, number = [(left.get(start, inf), 0, 0.0, (), (start,))], 0
    while queue and count and number < _TRIALS:
        _, _, length, corridors, places = heappop(queue)
        if places[-1] == goal:
            count -= 1
            yield corridors
            continue
        for one in building.exits[places[-1]]:
            to = one.other(places[-1])
            if to not in places:
                number += 1
                far = length + one.length_m
                heappush(queue, (far + left[to], number, far, (*corridors, one), (*places, to)))


def generate_and_test(task: Task, count: int = 10) -> int | None:
    """Take the shortest ways, find the best modes along each, return the least cost of all; None if none can be driven.

    As the published method does: ways first, by length alone, then the configurations for each.
    """
    found: list[int] = []
    for corridors in shortest_ways(task.building, task.start[0].name, task.goal, count):
        front, place = {task.start[1]: 0}, task.start[0]
        for one in corridors:
            after = {}
            for leg, cost in task.crossings(place):
                if leg.corridor == one.name:
                    switched = min(
                        spent + task.switching(was, leg.mode)[1] for was, spent in front.items()
                    )
                    after[leg.mode] = cost + switched
            front, place = after, Place(one.other(place.name))
            if not front:
                break
        found += front.values()
    return min(found, default=None)


def part_of(building: Building, centre: str, count: int) -> Building:
    """Return the places nearest to one by number of corridors, with the corridors between them."""
    near = [centre]
    for place in near:
        near += [to for to in (one.other(place) for one in building.exits[place]) if to not in near]
        if len(near) >= count:
            break
    kept = dict.fromkeys(near[:count])
    inside = {
        name: one
        for name, one in building.corridors.items()
        if all(end in kept for end in one.ends)
    }
    return Building(
        "part", {place: building.places[place] for place in kept}, inside, near[0], near[count - 1]
    )
