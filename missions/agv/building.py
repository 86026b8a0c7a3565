"""A building as a graph: places, and corridors between them with what is known of each."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

from missions.engine.mission import MissionError
from missions.engine.settings import near
from rosa_pddl.search import distances

_NAME: Final = re.compile(r"[a-z][a-z0-9_]*")
_MOST: Final = 1e12  # limit of every given number, so that sums and products are finite


@dataclass(frozen=True, slots=True)
class Corridor:
    """A corridor between two places, the same in both directions.

    Attributes:
        ends: the two places.
        length_m: its length [m]; by default the distance between its places.
        obstacles: obstacles per metre [1/m].
        light: from 0 (dark) to 1.
        name: its name in the building.
    """

    ends: tuple[str, str]
    length_m: float = 0.0
    obstacles: float = 0.0
    light: float = 1.0
    name: str = ""

    def other(self, place: str) -> str:
        return self.ends[1] if self.ends[0] == place else self.ends[0]


@dataclass(frozen=True)
class Building:
    """Places and corridors by their names, in lower snake_case.

    Attributes:
        places: x and y of each place [m], world frame.

    Raises:
        MissionError: something in it makes no sense, or not every place can be reached.
    """

    name: str
    places: Mapping[str, tuple[float, float]]
    corridors: Mapping[str, Corridor]
    start: str
    goal: str

    def __post_init__(self) -> None:
        for name in (*self.places, *self.corridors):
            if not _NAME.fullmatch(name):
                raise MissionError(f"{name!r} in map {self.name} is no name: a letter, then letters, digits or '_'")
        for place, point in self.places.items():
            for axis, value in zip("xy", point, strict=True):
                checked(f"{axis} of place {place}", value, -_MOST)
        object.__setattr__(self, "corridors", {name: self._judged(name, one) for name, one in self.corridors.items()})
        self.check("place", self.start, "start")
        self.check("place", self.goal, "goal")
        ways = [(*ends, 1) for one in self.corridors.values() for ends in (one.ends, one.ends[::-1])]
        reached = distances(ways, [self.start])
        if lost := [place for place in self.places if place not in reached]:
            problem = f"map {self.name} is disconnected: no way from {self.start} to {', '.join(lost)}"
            raise MissionError(f"{problem}; add a corridor")

    def _judged(self, name: str, corridor: Corridor) -> Corridor:
        """Return a corridor with its name and length."""
        for end in corridor.ends:
            self.check("place", end, f"corridor {name}")
        if corridor.ends[0] == corridor.ends[1]:
            raise MissionError(f"corridor {name} leads from {corridor.ends[0]} to itself; take it out")
        length_m = corridor.length_m or math.dist(*(self.places[end] for end in corridor.ends))
        checked(f"length_m of corridor {name}", length_m, 1e-3)
        checked(f"obstacles of corridor {name}", corridor.obstacles)
        checked(f"light of corridor {name}", corridor.light, most=1.0)
        return replace(corridor, name=name, length_m=length_m)

    @cached_property
    def exits(self) -> Mapping[str, tuple[Corridor, ...]]:
        """The corridors at each place, in order of declaration."""
        corridors = self.corridors.values()
        return {place: tuple(one for one in corridors if place in one.ends) for place in self.places}

    def check(self, kind: str, name: str, who: str) -> None:
        """Raise MissionError unless there is a "place" or "corridor" (`kind`) of that name; `who` names it."""
        known = list(self.places if kind == "place" else self.corridors)
        if name not in known:
            lacks = f"{who} names the {kind} {name!r}, which map {self.name} lacks"
            raise MissionError(f"{lacks}; near: {', '.join(near(name, known) or known[:8])}")


def checked(what: str, value: object, least: float = 0.0, most: float = _MOST) -> float:
    """Return a value; MissionError unless it is a number within bounds."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
        raise MissionError(f"{what} is {value!r}; it must be a number from {least:g} to {most:g}")
    return value


PAPER: Final = Building(
    "paper",
    places={"a": (0.0, 0.0), "d": (0.0, -8.0), "e": (20.0, -8.0), "b": (20.0, 0.0)},
    corridors={
        "c1": Corridor(("a", "b"), obstacles=0.25),
        "c2": Corridor(("e", "b")),
        "c3": Corridor(("d", "e")),
        "c4": Corridor(("a", "d")),
    },
    start="a",
    goal="b",
)
"""The map of the ROSA paper, from a to b: straight on through the obstructed corridor c1, or round by c4, c3 and c2.

The corridors and their obstacles are the paper's; lengths and light are our own choice.
"""
