"""Random buildings of any size, and questions about them as PDDL."""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from numpy.random import Generator

from missions import agv
from missions.agv.joint import Place, Task
from missions.agv.model import Building, Corridor
from missions.agv.tree import SWITCH, PddlNames, left_of, used
from missions.engine.mission import MissionError
from rosa_pddl import Domain, Planner, PlanningResult, Problem, initial_state, parse_domain

_GRID_M: Final = 12.0


def building_from(said) -> Building:
    """Make a building of plain data: start, goal, places (x, y) and corridors."""
    corridors = {
        name: Corridor(
            (one["from"], one["to"]), **{key: one[key] for key in one if key not in ("from", "to")}
        )
        for name, one in said["corridors"].items()
    }
    places = {name: tuple(map(float, point)) for name, point in said["places"].items()}
    return Building(said.get("name", "unnamed"), places, corridors, said["start"], said["goal"])


def generated_building(rng: Generator, places: int = 58, corridors: int = 70) -> Building:
    """Make a connected building on a jittered grid, so of random lengths.

    By default it has 58 places and 70 corridors, as the published one.

    A quarter of the corridors are obstructed, a quarter have a few obstacles, and a quarter are
    dark.

    Raises:
        MissionError: too few corridors to connect the places, or more than a grid has.
    """
    columns = math.ceil(math.sqrt(places))
    cells = [(number % columns, number // columns) for number in range(places)]
    index = {cell: number for number, cell in enumerate(cells)}
    steps = [((x, y), (x + dx, y + dy)) for x, y in cells for dx, dy in ((1, 0), (0, 1))]
    pairs = [(index[one], index[two]) for one, two in steps if two in index]
    if not places - 1 <= corridors <= len(pairs) or places < 2:
        raise MissionError(
            f"{places} places take {places - 1} to {len(pairs)} corridors, not {corridors}"
        )
    chosen = sorted(
        _chosen([pairs[number] for number in rng.permutation(len(pairs))], places, corridors)
    )
    points = [tuple(_GRID_M * (axis + rng.uniform(-0.25, 0.25)) for axis in cell) for cell in cells]
    made = {}
    for number, (one, two) in enumerate(chosen, start=1):
        length_m = math.dist(points[one], points[two])
        obstacles = float(rng.choice([0.0, 0.0, rng.uniform(0.01, 0.1), rng.uniform(0.11, 0.4)]))
        light = float(rng.choice([1.0, 1.0, 1.0, 0.1]))
        made[f"c{number}"] = Corridor((f"p{one}", f"p{two}"), float(length_m), obstacles, light)
    named = {f"p{number}": (float(x), float(y)) for number, (x, y) in enumerate(points)}
    return Building(f"generated_{places}", named, made, "p0", f"p{places - 1}")


def _chosen(pairs: list[tuple[int, int]], places: int, corridors: int) -> list[tuple[int, int]]:
    """Take a spanning tree first, in the order given, and then what comes first of the rest."""
    root = list(range(places))

    def find(place: int) -> int:
        while root[place] != place:
            root[place] = root[root[place]]
            place = root[place]
        return place

    tree = []
    rest = []
    for one, two in pairs:
        ends = find(one), find(two)
        if ends[0] == ends[1]:
            rest.append((one, two))
        else:
            root[ends[0]] = ends[1]
            tree.append((one, two))
    return tree + rest[: corridors - len(tree)]


def domain_of_task(task: Task) -> Domain:
    """Return a question as PDDL by itself, with its limits."""
    start = task.start[0]
    places = [*map(Place, task.building.places), *([start] if start.corridor else [])]
    modes = {leg.mode.name: leg.mode for place in places for leg, _ in task.crossings(place)}
    pddl = PddlNames(task.building, modes.values(), task.limited)
    facts = pddl.facts(task)
    init = [fact for fact, is_so in facts.items() if is_so is True]
    init += [f"(action_feasible {action})" for action in (SWITCH, *pddl.actions.values())]
    numbers = {name: value for name, value in facts.items() if not isinstance(value, bool)}
    used_up = {f"({used(name)})" for name in task.limited}
    init += [f"(= {name} {value})" for name, value in numbers.items() if name not in used_up]
    problem = pddl.problem.replace("(:init ", f"(:init {' '.join(init)} ", 1)
    goal = f"(at {pddl.places[task.building.goal]})"
    problem = problem.replace(f"(and {goal}", f"(and (at {pddl.places[task.goal]})", 1)
    return parse_domain(domain_text(task.limited), problem)


def domain_text(limited: Iterable[str]) -> str:
    """Return the domain of the mission with these resources in the place of energy."""
    lines = list[str]()
    for line in (Path(agv.__file__).with_name("domain.pddl")).read_text().splitlines():
        if "energy" not in line:
            lines.append(line)
            continue
        for name in limited:
            changed = line.replace("energy_used_mj", used(name)).replace(
                "energy_left_mj", left_of(name)
            )
            lines.append(changed.replace("_energy", f"_{name}"))
    return "\n".join(lines)


def asked_of(planner: Planner, task: Task) -> PlanningResult:
    """Have a planner answer a question; the cost is in whole thousandths."""
    domain = domain_of_task(task)
    return planner.plan(Problem(domain, initial_state(domain)))
