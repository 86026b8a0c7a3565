"""The building as a graph of places and corridors, and the ground vehicle in it.

The vehicle has three ways to localise itself, three sensors, a lamp, and a base with three speeds.
"""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

from kb import Model
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
                form = "a letter, then letters, digits or '_'"
                raise MissionError(f"{name!r} in map {self.name} is not a name: {form}")
        corridors = {name: self._completed(name, part) for name, part in self.corridors.items()}
        object.__setattr__(self, "corridors", corridors)
        self.check("place", self.start, "start")
        self.check("place", self.goal, "goal")
        ways = [
            (*ends, 1)
            for corridor in self.corridors.values()
            for ends in (corridor.ends, corridor.ends[::-1])
        ]
        reached = distances(ways, [self.start])
        lost = ", ".join(place for place in self.places if place not in reached)
        if lost:
            problem = f"no way from {self.start} to {lost}; add a corridor"
            raise MissionError(f"map {self.name} is disconnected: {problem}")

    def _completed(self, name: str, corridor: Corridor) -> Corridor:
        """Return a corridor with its name and length."""
        for end in corridor.ends:
            self.check("place", end, f"corridor {name}")
        if corridor.ends[0] == corridor.ends[1]:
            raise MissionError(
                f"corridor {name} leads from {corridor.ends[0]} to itself; remove it"
            )
        length_m = corridor.length_m or math.dist(*(self.places[end] for end in corridor.ends))
        checked(f"length_m of corridor {name}", length_m, 1e-3)
        checked(f"obstacles of corridor {name}", corridor.obstacles)
        checked(f"light of corridor {name}", corridor.light, most=1.0)
        return replace(corridor, name=name, length_m=length_m)

    @cached_property
    def exits(self) -> Mapping[str, tuple[Corridor, ...]]:
        """The corridors at each place, in order of declaration."""
        corridors = self.corridors.values()
        return {
            place: tuple(corridor for corridor in corridors if place in corridor.ends)
            for place in self.places
        }

    def check(self, kind: str, name: str, who: str) -> None:
        """Raise MissionError unless there is a "place" or "corridor" (`kind`) of that name.

        `who` names it.
        """
        names = list(self.places if kind == "place" else self.corridors)
        if name not in names:
            lacks = f"{who} names the {kind} {name!r}, which map {self.name} lacks"
            raise MissionError(f"{lacks}; near: {', '.join(near(name, names) or names[:8])}")


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
"""The map of the ROSA paper, from a to b: straight on through the obstructed corridor c1, or round
by c4, c3 and c2.

The corridors and their obstacles are the paper's; lengths and light are our own choice.
"""

NAVIGATE: Final = "navigate"
FOLLOW: Final = "follow_route"
NAVIGATOR: Final = "navigator"

SPEEDS: Final = {"slow": 0.24, "medium": 0.35, "fast": 0.68}
"""Speeds of the base [m/s]; the figures are those of the ROSA paper's source (Camara et al.)."""

DRAW_W: Final = {
    "amcl": 3.0,
    "mrpt": 4.0,
    "aruco": 1.0,
    "lidar": 8.0,
    "kinect": 5.0,
    "camera": 2.0,
    "lamp": 4.0,
}
"""Power of each component while it runs [W]; own choice, of the order of such devices."""

DRIVING_W: Final = {"slow": 8.0, "medium": 11.0, "fast": 30.0}
"""Power of the base at each speed [W]; own choice."""

MISHAPS: Final = {"slow": 0.002, "medium": 0.005, "fast": 0.02}
"""Expected collisions for each obstacle that is passed at a speed; own choice."""

ERROR_M: Final = {
    ("aruco", "camera"): 0.15,
    ("amcl", "kinect"): 0.03,
    ("amcl", "lidar"): 0.06,
    ("mrpt", "kinect"): 0.08,
    ("mrpt", "lidar"): 0.09,
}
"""Error of the position by algorithm and sensor [m]; the pairs are the paper's, the figures our own
choice."""

_DESIGNS: Final = (  # name, components, collisions expected for each obstacle passed; own choice
    ("aruco_camera", ("aruco", "camera"), 0.05),
    ("aruco_camera_lamp", ("aruco", "camera", "lamp"), 0.05),
    ("amcl_kinect", ("amcl", "kinect"), 0.004),
    ("amcl_lidar", ("amcl", "lidar"), 0.01),
    ("mrpt_kinect", ("mrpt", "kinect"), 0.02),
    ("mrpt_lidar", ("mrpt", "lidar"), 0.025),
)
OBSTRUCTED_PER_M: Final = 0.1
"""Obstacles per metre beyond which only AMCL with the Kinect is accurate enough; the paper says
that only it is."""

NEEDED_LIGHT: Final = 0.3
"""Light, 0 to 1, that the camera needs without the lamp; own choice."""


def agv_model(name: str = "agv", actions: Iterable[str] = (NAVIGATE,)) -> Model:
    """Build the model: 18 entities and 36 relations by the ROSA paper's counting.

    Every call gives a new one.

    Estimations: `energy` is the power drawn [J/s], `safety` the expected collisions for each
    obstacle that is passed, `accuracy` the error of the position [m]. Measured are `light` [0 to 1]
    and `obstacles` [1/m] of the corridor to cross, and the `energy` that is left [J]. Each of the
    actions requires the function to navigate.
    """
    model = Model(name)
    energy = model.quality_attribute("energy", unit="J")
    safety = model.quality_attribute("safety")
    accuracy = model.quality_attribute("accuracy", unit="m", low=0.0)
    light = model.environmental_attribute("light", low=0.0, high=1.0)
    obstacles = model.environmental_attribute("obstacles", unit="1/m", low=0.0)

    for component in DRAW_W:
        model.component(component, kind="lifecycle")
    base = model.component("base", kind="lifecycle")
    for priority, (speed, metres_per_second) in enumerate(SPEEDS.items(), start=1):
        configuration = base.configuration(speed, {"speed": metres_per_second}, priority=priority)
        configuration.estimate(energy, DRIVING_W[speed], "negative")
        configuration.estimate(safety, MISHAPS[speed], "negative")

    navigate = model.function(NAVIGATE)
    for priority, (design_name, components, mishaps) in enumerate(_DESIGNS, start=1):
        design = navigate.design(design_name, [*components, base], priority=priority)
        design.estimate(energy, sum(DRAW_W[component] for component in components), "negative")
        design.estimate(safety, mishaps, "negative")
        design.estimate(accuracy, ERROR_M[components[0], components[1]], "absolute")
    imprecise = [design for design, *_ in _DESIGNS if design != "amcl_kinect"]
    model.constrain([model.designs[name] for name in imprecise], obstacles <= OBSTRUCTED_PER_M)
    model.designs["aruco_camera"].constrain(light >= NEEDED_LIGHT)
    for action in actions:
        model.action(action, requires=[navigate])
    return model


def building_model(building: Building) -> Model:
    """Build the model of the vehicle in a building: corridors are actions, headings configurations.

    To `switch`, which changes the configuration before it drives on, is an action too.

    The demands of the corridors are not in the model: they are measured. `driven` is how far the
    robot is from where it entered the corridor [m], and `way` the number of the heading to take,
    from 1, in the order of `headings`.
    """
    model = agv_model("agv", actions=())
    driven = model.environmental_attribute("driven", unit="m")
    navigator = model.component(NAVIGATOR, kind="lifecycle")
    way = model.environmental_attribute("way")
    for number, (corridor, origin) in enumerate(headings(building), start=1):
        navigator.configuration(
            heading(corridor, origin),
            {"corridor": corridor, "origin": origin},
            priority=number,
            constraints=[way >= number, way <= number],
        )
    follow = model.function(FOLLOW)
    follow.design("by_navigator", [navigator], constraints=[driven >= 0.0])
    for name in building.corridors:
        model.action(f"cross_{name}", requires=[NAVIGATE, follow])
    model.action("switch", requires=[NAVIGATE])
    return model


def headings(building: Building) -> tuple[tuple[str, str], ...]:
    """Return (corridor, origin) for every corridor and each of its two ends, in order."""
    return tuple(
        (corridor.name, origin)
        for corridor in building.corridors.values()
        for origin in corridor.ends
    )


def heading(corridor: str, origin: str) -> str:
    """Return the name of the configuration for driving a corridor from one of its ends."""
    return f"{corridor}_from_{origin}"
