"""A building as a graph: places, and corridors between them with what is known of each; read from files and judged."""

import math
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from missions.engine.mission import MissionError
from missions.engine.settings import near
from rosa_pddl.search import distances

_NAME: Final = re.compile(r"[a-z][a-z0-9_]*")
_MOST: Final = 1e12  # of any number that is given: sums and products of such are finite


@dataclass(frozen=True, slots=True)
class Corridor:
    """A corridor between two places, the same in both directions.

    Attributes:
        name: lower snake_case.
        ends: the two places.
        length_m: how far it is [m].
        obstacles: obstacles per metre [1/m].
        light: from 0 (dark) to 1.
    """

    name: str
    ends: tuple[str, str]
    length_m: float
    obstacles: float
    light: float

    def other(self, place: str) -> str:
        return self.ends[1] if self.ends[0] == place else self.ends[0]


@dataclass(frozen=True)
class Building:
    """Places and corridors.

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
        for name, corridor in self.corridors.items():
            for end in corridor.ends:
                self.check_place(end, f"corridor {name}")
        self.check_place(self.start, "start")
        self.check_place(self.goal, "goal")
        ways = [(*ends, 1) for one in self.corridors.values() for ends in (one.ends, one.ends[::-1])]
        reached = distances(ways, [self.start])
        if lost := [place for place in self.places if place not in reached]:
            problem = f"map {self.name} is disconnected: no way from {self.start} to {', '.join(lost)}"
            raise MissionError(f"{problem}; add a corridor")

    @cached_property
    def exits(self) -> Mapping[str, tuple[Corridor, ...]]:
        """The corridors at each place, in order of declaration."""
        corridors = self.corridors.values()
        return {place: tuple(one for one in corridors if place in one.ends) for place in self.places}

    def check_place(self, place: str, what: str) -> None:
        """Raise MissionError unless there is that place."""
        _check_known(place, self.places, f"{what} names the place {place!r}, which map {self.name} lacks")

    def check_corridor(self, corridor: str) -> None:
        """Raise MissionError unless there is that corridor."""
        _check_known(corridor, self.corridors, f"map {self.name} has no corridor {corridor!r}")


def _check_known(name: str, known: Iterable[str], problem: str) -> None:
    if name not in known:
        raise MissionError(f"{problem}; near: {', '.join(near(str(name), known) or list(known)[:8])}")


def check_number(what: str, value: object, least: float = 0.0, most: float = _MOST) -> None:
    """Raise MissionError unless a value is a number within bounds."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not least <= value <= most:  # type: ignore[operator]  # is a number
        raise MissionError(f"{what} is {value!r}; it must be a number from {least:g} to {most:g}")


def load_building(path: str | Path) -> Building:
    """Read a map, a file of TOML such as `missions/agv/maps/paper.toml`.

    Raises:
        MissionError: it cannot be read, or it is no map.
    """
    path = Path(path)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise MissionError(f"map {path} cannot be read: {error}; a map is a file of TOML") from error
    return building_from(data, path.stem)


def building_from(data: Mapping[str, Any], name: str = "unnamed") -> Building:
    """Make a building of what a map file says: name, start, goal, places (x, y) and corridors.

    A corridor without `length_m` is as long as its places are apart; without `obstacles` it has none, and without
    `light` it is light.

    Raises:
        MissionError: it is no map.
    """
    name = str(data.get("name", name))
    _check_keys(f"map {name}", data, ("start", "goal", "places", "corridors"), ("name",))
    for key in ("places", "corridors"):
        _check_keys(f"{key} of map {name}", data[key])
        if wrong := [one for one in data[key] if not _NAME.fullmatch(one)]:
            raise MissionError(f"{wrong[0]!r} in {key} of map {name} is no name: a letter, then letters, digits or '_'")
    places = {place: _point(place, point) for place, point in data["places"].items()}
    corridors = {one: _corridor(one, said, places) for one, said in data["corridors"].items()}
    return Building(name, places, corridors, data["start"], data["goal"])


def _point(place: str, given: Any) -> tuple[float, float]:  # noqa: ANN401  # whatever stands in a file
    if not isinstance(given, list) or len(given) != 2:
        raise MissionError(f"place {place} is {given!r}; a place is x and y [m], such as [2.0, 5.0]")
    for axis, value in zip("xy", given, strict=True):
        check_number(f"{axis} of place {place}", value, -_MOST)
    return float(given[0]), float(given[1])


def _corridor(name: str, given: Any, places: Mapping[str, tuple[float, float]]) -> Corridor:  # noqa: ANN401  # whatever stands in a file
    _check_keys(f"corridor {name}", given, ("from", "to"), ("length_m", "obstacles", "light"))
    ends = str(given["from"]), str(given["to"])
    if ends[0] == ends[1]:
        raise MissionError(f"corridor {name} leads from {ends[0]} to itself; take it out")
    apart = math.dist(*(places[end] for end in ends)) if places.keys() >= set(ends) else 1.0
    numbers = {"length_m": apart, "obstacles": 0.0, "light": 1.0, **given}
    for key, least, most in (("length_m", 1e-3, _MOST), ("obstacles", 0.0, _MOST), ("light", 0.0, 1.0)):
        check_number(f"{key} of corridor {name}", numbers[key], least, most)
    return Corridor(name, ends, float(numbers["length_m"]), float(numbers["obstacles"]), float(numbers["light"]))


def _check_keys(what: str, given: Any, needed: Sequence[str] = (), optional: Sequence[str] = ()) -> None:  # noqa: ANN401  # whatever stands in a file
    """Refuse what is not given by name, lacks what is needed, or says what nobody reads."""
    if not isinstance(given, Mapping) or not given:
        raise MissionError(f"{what} is {given!r:.40}; it is given by name, at least one")
    if needed and not set(needed) <= given.keys() <= {*needed, *optional}:
        allowed = f"it needs {', '.join(needed)}, and may say {', '.join(optional)}"
        raise MissionError(f"{what} says {', '.join(given)}; {allowed}")
