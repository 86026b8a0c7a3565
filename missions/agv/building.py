"""A building as a graph: places, and corridors between them with what is known of each; read from files and judged."""

import json
import math
import re
import sys
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from missions.engine.mission import MissionError
from rosa_pddl.search import distances

_NAME: Final = re.compile(r"[a-z][a-z0-9_]*")
_NEEDED: Final = ("start", "goal", "places", "corridors")
_KEYS: Final = ("from", "to", "length_m", "obstacles", "light")


class BuildingError(MissionError):
    """A map means nothing, or nothing that can be driven; the message says where and what to do."""


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

    def check(self) -> None:
        """Raise BuildingError unless its numbers can be so."""
        where = f"of corridor {self.name} is"
        is_long, is_finite = 0.0 < self.length_m < math.inf, 0.0 <= self.obstacles < math.inf
        _need(is_long, f"length_m {where} {self.length_m:g}; it must be more than 0 and finite")
        _need(is_finite, f"obstacles {where} {self.obstacles:g}; it must be 0 or more and finite")
        _need(0.0 <= self.light <= 1.0, f"light {where} {self.light:g}; it must be from 0 to 1")


@dataclass(frozen=True)
class Building:
    """Places and corridors.

    Attributes:
        places: x and y of each place [m], world frame.

    Raises:
        BuildingError: something in it makes no sense, or not every place can be reached.
    """

    name: str
    places: Mapping[str, tuple[float, float]]
    corridors: Mapping[str, Corridor]
    start: str
    goal: str

    def __post_init__(self) -> None:
        for place, point in self.places.items():
            _need(all(map(math.isfinite, point)), f"place {place} is at {point}; x and y [m] are finite numbers")
        for name, corridor in self.corridors.items():
            _need(name == corridor.name, f"corridor {corridor.name} is listed as {name!r}; give it one name")
            for end in corridor.ends:
                self.check_place(end, f"corridor {name}")
            one, two = corridor.ends
            _need(one != two, f"corridor {name} leads from {one} to itself; take it out")
            corridor.check()
        self.check_place(self.start, "start")
        self.check_place(self.goal, "goal")
        self._check_connected()

    @cached_property
    def exits(self) -> Mapping[str, tuple[Corridor, ...]]:
        """The corridors at each place, in order of declaration."""
        corridors = self.corridors.values()
        return {place: tuple(one for one in corridors if place in one.ends) for place in self.places}

    def check_place(self, place: str, what: str) -> None:
        if place not in self.places:
            near = _near(place, self.places)
            raise BuildingError(f"{what} names the place {place!r}, which map {self.name} lacks; near: {near}")

    def check_corridor(self, corridor: str) -> None:
        if corridor not in self.corridors:
            near = _near(corridor, self.corridors)
            raise BuildingError(f"map {self.name} has no corridor {corridor!r}; near: {near}")

    def _check_connected(self) -> None:
        ways = [(*ends, 1) for one in self.corridors.values() for ends in (one.ends, one.ends[::-1])]
        reached = distances(ways, [self.start])
        lost = [place for place in self.places if place not in reached]
        named = ", ".join(lost[:5]) + (f" and {len(lost) - 5} more" if len(lost) > 5 else "")
        _need(not lost, f"map {self.name} is disconnected: no way from {self.start} to {named}; add a corridor")


def load_building(path: str | Path) -> Building:
    """Read a map, a file of TOML or JSON such as `missions/agv/maps/paper.toml`.

    Raises:
        BuildingError: it cannot be read, or it is no map.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
        data = json.loads(text, object_pairs_hook=_once) if path.suffix == ".json" else tomllib.loads(text)
    except (OSError, ValueError, RecursionError) as error:
        allowed = "a map is a file of TOML, or of JSON if so named"
        raise BuildingError(f"map {path} cannot be read: {error}; {allowed}") from error
    return building_from(data, path.stem)


def _once(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Return what stands in braces in a file of JSON, which by itself would take the last of a name."""
    for name, count in Counter(name for name, _ in pairs).items():
        if count > 1:
            raise ValueError(f"{name!r} stands {count} times within the same braces")
    return dict(pairs)


def building_from(data: Any, name: str = "unnamed") -> Building:  # noqa: ANN401  # whatever stands in a file
    """Make a building of what a map file says: name, start, goal, places (x, y) and corridors.

    A corridor without `length_m` is as long as its places are apart; without `obstacles` it has none, and without
    `light` it is light.

    Raises:
        BuildingError: it is no map.
    """
    given = data if isinstance(data, Mapping) else {}
    name = str(given.get("name", name))
    for key in _NEEDED:
        _need(key in given, f"map {name} says no {key}; it needs start, goal, places and corridors")
    _check_keys(f"map {name} says", given, ("name", *_NEEDED))
    for key in ("places", "corridors"):
        things = given[key]
        _need(isinstance(things, Mapping) and bool(things), f"{key} of map {name} are given by name, at least one")
        for one in things:
            is_name = isinstance(one, str) and bool(_NAME.fullmatch(one))
            allowed = "a letter, then letters, digits, '_', all small"
            _need(is_name, f"{one!r} in {key} of map {name} is no name; {allowed}")
    places = {place: _point(place, point) for place, point in given["places"].items()}
    corridors = {one: _corridor(one, said, places) for one, said in given["corridors"].items()}
    return Building(name, places, corridors, str(given["start"]), str(given["goal"]))


def _point(place: str, given: Any) -> tuple[float, float]:  # noqa: ANN401  # whatever stands in a file
    is_point = isinstance(given, list | tuple) and len(given) == 2
    _need(is_point, f"place {place} is {given!r}; a place is x and y [m], such as [2.0, 5.0]")
    return _number(f"x of place {place}", given[0]), _number(f"y of place {place}", given[1])


def _corridor(name: str, given: Any, places: Mapping[str, tuple[float, float]]) -> Corridor:  # noqa: ANN401  # whatever stands in a file
    is_corridor = isinstance(given, Mapping) and {"from", "to"} <= given.keys()
    _need(is_corridor, f"corridor {name} is {given!r}; it needs from and to")
    _check_keys(f"corridor {name} has", given, _KEYS)
    ends = str(given["from"]), str(given["to"])
    apart = math.dist(*(places[end] for end in ends)) if all(end in places for end in ends) else 1.0
    numbers = {"length_m": apart, "obstacles": 0.0, "light": 1.0}
    values = {key: _number(f"{key} of corridor {name}", given.get(key, value)) for key, value in numbers.items()}
    return Corridor(name, ends, **values)


def _number(what: str, given: object) -> float:
    if isinstance(given, bool) or not isinstance(given, int | float) or not abs(given) <= sys.float_info.max:
        raise BuildingError(f"{what} is {given!r:.40}; a finite number is needed")
    return float(given)


def _check_keys(what: str, given: Iterable[str], known: tuple[str, ...]) -> None:
    for key in given:
        _need(key in known, f"{what} an unknown {key!r}; known are {', '.join(known)}")


def _near(name: object, known: Iterable[str]) -> str:
    return ", ".join(get_close_matches(str(name), known, n=3) or list(known)[:8])


def _need(holds: bool, message: str) -> None:
    if not holds:
        raise BuildingError(message)
