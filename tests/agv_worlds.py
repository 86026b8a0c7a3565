"""Random buildings of any size."""

import math
from typing import Final

from numpy.random import Generator

from missions.agv.model import Building, Corridor
from missions.engine.mission import MissionError

_GRID_M: Final = 12.0


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
        obstacles = float(rng.choice([0.0, 0.0, rng.uniform(0.01, 0.1), rng.uniform(0.11, 0.4)]))
        light = float(rng.choice([1.0, 1.0, 1.0, 0.1]))
        made[f"c{number}"] = Corridor((f"p{one}", f"p{two}"), obstacles, light)
    named = {f"p{number}": (float(x), float(y)) for number, (x, y) in enumerate(points)}
    return Building(named, made, "p0", f"p{places - 1}")


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
