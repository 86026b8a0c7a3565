"""The building as a graph of places and corridors, and the ground vehicle in it.

The vehicle has three ways to localise itself, three sensors, a lamp, and a base with three speeds.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final

from kb import Model
from kb.elements import ByName


@dataclass(frozen=True, slots=True)
class Corridor:
    """A straight corridor between two places, the same in both directions.

    Attributes:
        ends: the two places.
        obstacles: obstacles per metre [1/m].
        light: from 0 (dark) to 1.
        name, length_m: its name and length [m]; the building sets them.
    """

    ends: tuple[str, str]
    obstacles: float = 0.0
    light: float = 1.0
    name: str = ""
    length_m: float = 0.0

    def other(self, place: str) -> str:
        return self.ends[1] if self.ends[0] == place else self.ends[0]


@dataclass(frozen=True)
class Building:
    """Places and corridors by their names, which are names in PDDL, too.

    Attributes:
        places: x and y of each place [m], world frame.

    Raises:
        UnknownName: a corridor, the start or the goal names a place that there is not.
    """

    places: Mapping[str, tuple[float, float]]
    corridors: Mapping[str, Corridor]
    start: str
    goal: str

    def __post_init__(self) -> None:
        places = ByName("place", self.places)
        _ = places[self.start], places[self.goal]  # raises for a place that there is not
        corridors = ByName[Corridor]("corridor")
        for name, corridor in self.corridors.items():
            start, end = (places[place] for place in corridor.ends)
            corridors[name] = replace(corridor, name=name, length_m=math.dist(start, end))
        object.__setattr__(self, "places", places)
        object.__setattr__(self, "corridors", corridors)

    def exits(self, place: str) -> list[Corridor]:
        """Return the corridors at a place, in order of declaration."""
        return [corridor for corridor in self.corridors.values() if place in corridor.ends]


PAPER: Final = Building(
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
BASE: Final = "base"


SPEEDS: Final = {
    "slow": (0.24, 8.0, 0.002),
    "medium": (0.35, 11.0, 0.005),
    "fast": (0.68, 30.0, 0.02),
}
"""Each speed of the base [m/s], its power [W], and the collisions expected for each obstacle.

The speeds are those of the ROSA paper's source (Camara et al.), the other figures own choice.
"""

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


UNLIT: Final = "aruco_camera"
"""The design that needs light in the corridor."""
PRECISE: Final = "amcl_kinect"
"""The only design that is accurate enough among obstacles, as the paper says."""
DESIGNS: Final = {
    UNLIT: (("aruco", "camera"), 0.15, 0.05),
    "aruco_camera_lamp": (("aruco", "camera", "lamp"), 0.15, 0.05),
    PRECISE: (("amcl", "kinect"), 0.03, 0.004),
    "amcl_lidar": (("amcl", "lidar"), 0.06, 0.01),
    "mrpt_kinect": (("mrpt", "kinect"), 0.08, 0.02),
    "mrpt_lidar": (("mrpt", "lidar"), 0.09, 0.025),
}
"""The components of each design, first the algorithm, then the sensor; the error of the position
[m]; and the collisions expected for each obstacle.

The pairs are the paper's, the figures our own choice.
"""
OBSTRUCTED_PER_M: Final = 0.1
"""Obstacles per metre beyond which only one design is accurate enough."""
NEEDED_LIGHT: Final = 0.3
"""Light, 0 to 1, that the camera needs without the lamp; own choice."""


def agv_model(actions: Iterable[str] = (NAVIGATE,)) -> Model:
    """Build the model: 18 entities and 36 relations by the ROSA paper's counting.

    Every call gives a new one.

    Estimations: `energy` is the power drawn [J/s], `safety` the expected collisions for each
    obstacle that is passed, `accuracy` the error of the position [m]. Measured are `light` [0 to 1]
    and `obstacles` [1/m] of the corridor to cross, and the `energy` that is left [J]. Each of the
    actions requires the function to navigate.
    """
    model = Model("agv")
    energy = model.quality_attribute("energy", unit="J")
    safety = model.quality_attribute("safety")
    accuracy = model.quality_attribute("accuracy", unit="m", low=0.0)
    light = model.environmental_attribute("light", low=0.0, high=1.0)
    obstacles = model.environmental_attribute("obstacles", unit="1/m", low=0.0)

    for component in DRAW_W:
        model.component(component, kind="lifecycle")
    base = model.component(BASE, kind="lifecycle")
    for priority, (name, (speed, watts, mishaps)) in enumerate(SPEEDS.items(), start=1):
        configuration = base.configuration(name, {"speed": speed}, priority=priority)
        configuration.estimate(energy, watts, "negative")
        configuration.estimate(safety, mishaps, "negative")

    navigate = model.function(NAVIGATE)
    for priority, (name, (components, error_m, mishaps)) in enumerate(DESIGNS.items(), start=1):
        design = navigate.design(name, [*components, base], priority=priority)
        design.estimate(energy, sum(DRAW_W[component] for component in components), "negative")
        design.estimate(safety, mishaps, "negative")
        design.estimate(accuracy, error_m, "absolute")
    imprecise = [model.designs[name] for name in DESIGNS if name != PRECISE]
    model.constrain(imprecise, obstacles <= OBSTRUCTED_PER_M)
    model.designs[UNLIT].constrain(light >= NEEDED_LIGHT)
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
    model = agv_model(actions=())
    driven = model.environmental_attribute("driven", unit="m")
    navigator = model.component(NAVIGATOR, kind="lifecycle")
    way = model.environmental_attribute("way")
    for number, (name, parameters) in enumerate(headings(building).items(), start=1):
        constraints = [way >= number, way <= number]
        navigator.configuration(name, parameters, priority=number, constraints=constraints)
    follow = model.function(FOLLOW)
    follow.design("by_navigator", [navigator], constraints=[driven >= 0.0])
    for name in building.corridors:
        model.action(f"cross_{name}", requires=[NAVIGATE, follow])
    model.action("switch", requires=[NAVIGATE])
    return model


def heading(corridor: str, origin: str) -> str:
    """Return the name of the configuration for driving a corridor from one of its ends."""
    return f"{corridor}_from_{origin}"


def headings(building: Building) -> dict[str, dict[str, str]]:
    """Return the parameters of the navigator for every corridor from each of its two ends."""
    return {
        heading(corridor, origin): {"corridor": corridor, "origin": origin}
        for corridor, part in building.corridors.items()
        for origin in part.ends
    }
