"""The building as a world of missions, with its incidents and the components of the vehicle."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.random import Generator

from kb import KnowledgeBase
from missions.agv.joint import SET_S, SWITCH_S
from missions.agv.model import (
    BASE,
    DESIGNS,
    DRAW_W,
    NAVIGATOR,
    NEEDED_LIGHT,
    SPEEDS,
    UNLIT,
    Building,
)
from missions.agv.tree import Route
from missions.agv.vehicle import PERIOD_S, Aim, Array, Vehicle, aim_along, boxes, steer
from missions.engine import mission
from missions.engine.components import VERBS, NamedComponents, SimulatedComponents
from missions.engine.mission import MISSION_STATUS, Message, Percepts, Sample, Setting, Verdict
from missions.engine.settings import Constants, declared, setting

# The constants below are own choices; where along the corridor something happens, too.
MONITOR_PERIOD_S: Final = 0.5  # of the monitors of light, energy and position
STANDING_BASE_W: Final = 2.0  # power of the base while the vehicle stands
REACH_M: Final = 0.3  # distance at which a place is reached
_STAND: Final = Aim(0.0, 0.0)
_ERROR_KEEPS: Final = 0.98  # of the error of the position, from one look to the next
_DARK: Final = 0.1  # where the lamps of a corridor have gone out, from 0 to 1
_CREEP_M: Final = 1e-4  # in a period; a robot that moves less stands still
_WELL_INSIDE_M: Final = 1.0  # so far from a place, the robot is in the corridor


@dataclass(frozen=True, slots=True)
class Settings(Constants):
    """What can be set."""

    capacity_j: float = setting(20_000.0, "J", "energy at the start", "own choice", 1.0)


class Incident(NamedTuple):
    """What happens once, when the robot is within a corridor.

    A component fails; without a component, the light goes out.
    """

    corridor: str
    component: str = ""


class BuildingWorld(NamedComponents, mission.World):
    """A vehicle that drives where its navigator says, as long as it can localise itself.

    All chance comes from `rng`.
    """

    now = 0.0

    def __init__(
        self,
        building: Building,
        settings: Settings,
        rng: Generator,
        incidents: Sequence[Incident] = (),
    ) -> None:
        super().__init__()
        self._building = building
        self._settings = settings
        self._rng = rng
        placed = boxes(building, rng)
        pose = (*building.places[building.start], rng.uniform(-math.pi, math.pi))
        self._vehicle = Vehicle(building, placed, pose)
        takes = dict(zip(VERBS, (SWITCH_S, SWITCH_S, SET_S), strict=True))
        self._managed = SimulatedComponents(lambda: self.now, self, takes)
        self._waiting: list[tuple[Incident, float]] = []
        for incident in incidents:
            share = rng.uniform(0.25, 0.6)  # where in its corridor it happens
            length_m = building.corridors[incident.corridor].length_m
            self._waiting.append((incident, share * length_m))
        self._light = {name: part.light for name, part in building.corridors.items()}
        self._ticks = 0
        self._at = building.start
        self._inside = ""
        self._way: list[tuple[str, str]] = []  # corridors to drive along, and to which place
        self._ordered: Mapping[str, Any] = {}
        self._sensor = ""
        self._error: Array = np.zeros(2)
        self._energy_j = settings.capacity_j
        self._driven_total_m = 0.0
        self._is_moving = False
        self._news: list[dict[str, Any]] = []
        self._happened: list[tuple[float, str]] = []
        self._monitor_due = 0.0
        self._say(MISSION_STATUS, f"at {self._at}", "true")
        self._say("QA measurement", "energy", repr(self._energy_j))

    @property
    def managed(self) -> SimulatedComponents:
        return self._managed

    def advance(self, until: float) -> list[Message]:
        """Drive until something is published or switched, at most to the time `until` [s]."""
        was_still = self.is_still
        while self.now < until:
            self._step()
            switched = self._managed.catch_up()
            if self.now >= self._monitor_due - 1e-9:
                self._monitor()
            if self._news or switched or self.is_still is not was_still:
                break
        news = self._news
        self._news = []
        return [{"time": self.now, "status": news}] if news else []

    @property
    def is_still(self) -> bool:
        """Whether it stands for good: incidents happen only to a vehicle that drives."""
        waits = self._energy_j > 0.0 and (self._sensor or self._managed.next_event() < math.inf)
        return not (waits or self._is_moving)

    def results(self) -> Mapping[str, float | None]:
        return {
            "driven_m": self._driven_total_m,
            "energy_used_j": self._settings.capacity_j - self._energy_j,
            "collisions": float(self._vehicle.collisions),
        }

    def sample(self) -> Sample:
        signals = {"light [-]": self._light_here, "speed set [m/s]": self._speed}
        return Sample(self.now, (*self._vehicle.position.tolist(), 0.0), signals)

    def disturbances(self) -> list[tuple[float, str]]:
        return list(self._happened)

    def scenery(self) -> Mapping[str, Any]:
        """Return the corridors as lines."""
        lines = {}
        for name, corridor in self._building.corridors.items():
            start, end = (self._building.places[place] for place in corridor.ends)
            lines[name] = np.linspace(start, end, 3)  # the name stands in the middle
        return lines

    def _step(self) -> None:
        self._ticks += 1
        self.now = self._ticks * PERIOD_S
        before = self._vehicle.position
        self._take_orders()
        aim = self._aim()
        self._vehicle.drive(aim)
        base_w = STANDING_BASE_W
        for speed, watts, _ in SPEEDS.values():
            if aim is not _STAND and speed == self._speed:
                base_w = watts
        draws_w = base_w + sum(watts for name, watts in DRAW_W.items() if name in self.active)
        self._energy_j = max(0.0, self._energy_j - draws_w * PERIOD_S)
        driven_m = math.dist(before, self._vehicle.position)
        self._driven_total_m += driven_m
        self._is_moving = driven_m > _CREEP_M
        self._look_where_it_is()
        for waiting in list(self._waiting):
            incident, after_m = waiting
            if incident.corridor == self._inside and self._driven_m >= after_m:
                self._waiting.remove(waiting)
                self._happen(incident)

    def _take_orders(self) -> None:
        """Take over a new order: drive to the origin first, unless the vehicle is there."""
        ordered = self._orders(NAVIGATOR)
        if not ordered or ordered == self._ordered:
            return
        self._ordered = ordered
        corridor = ordered["corridor"]
        origin = ordered["origin"]
        to = self._building.corridors[corridor].other(origin)
        is_on_it = self._inside == corridor or (self._at == origin and not self._inside)
        self._way = [(corridor, to)] if is_on_it else [(self._inside, origin), (corridor, to)]

    def _aim(self) -> Aim:
        self._sensor, error_m = self._seeing()
        if not self._sensor or not self._way or self._speed == 0.0 or self._energy_j == 0.0:
            return _STAND
        corridor, place = self._way[0]
        origin = self._building.corridors[corridor].other(place)
        start, end = (np.array(self._building.places[name]) for name in (origin, place))
        believed = self._vehicle.position + self._drift(error_m)
        to = aim_along(believed, start, end) - believed
        bearing = math.remainder(math.atan2(to[1], to[0]) - self._vehicle.yaw, math.tau)
        return steer(bearing, self._vehicle.look(self._sensor), self._speed)

    def _seeing(self) -> tuple[str, float]:
        """Return the sensor by which it localises itself, empty if it cannot, and its error [m]."""
        for name, (components, error_m, _) in DESIGNS.items():
            sees = name != UNLIT or self._light_here >= NEEDED_LIGHT
            if sees and self.active.issuperset((*components, BASE, NAVIGATOR)):
                return components[1], error_m
        return "", 0.0

    def _drift(self, error_m: float) -> Array:
        """Return the error of the position that the vehicle believes in, (2,) [m]; it wanders."""
        fresh = error_m * math.sqrt((1 - _ERROR_KEEPS**2) / 2)
        self._error = _ERROR_KEEPS * self._error + fresh * self._rng.standard_normal(2)
        return self._error

    def _look_where_it_is(self) -> None:
        if not self._way:
            return
        corridor, place = self._way[0]
        if math.dist(self._vehicle.position, self._building.places[place]) < REACH_M:
            del self._way[0]
            if self._inside:
                self._say(MISSION_STATUS, f"in {self._inside}", "false")
                self._inside = ""
            if place != self._at:
                self._say(MISSION_STATUS, f"at {self._at}", "false")
                self._at = place
                self._say(MISSION_STATUS, f"at {place}", "true")
        elif not self._inside and self._driven_m > _WELL_INSIDE_M:
            self._inside = corridor
            self._say("EA measurement", "driven", repr(self._driven_m))
            self._say(MISSION_STATUS, f"in {corridor}", "true")

    def _happen(self, incident: Incident) -> None:
        name = incident.component
        if name:
            text = f"{name} failed"
            self.active.discard(name)
            self._managed.script(name, "activate", fail_first=math.inf)
            self._say("component status", name, "failure")
        else:
            light = f"light in {incident.corridor}"
            text = f"{light} goes out"
            self._light[incident.corridor] = _DARK
            self._say("EA measurement", "light", repr(_DARK))
            self._say(MISSION_STATUS, light, repr(_DARK))
        self._happened.append((self.now, text))

    def _monitor(self) -> None:
        self._monitor_due += MONITOR_PERIOD_S
        if self._inside:
            self._say("EA measurement", "light", repr(self._light_here))
            self._say("EA measurement", "driven", repr(self._driven_m))
        self._say("QA measurement", "energy", repr(self._energy_j))

    def _say(self, kind: str, key: str, value: str) -> None:
        self._news.append({"name": "building", "message": kind, "values": {key: value}})

    @property
    def _driven_m(self) -> float:
        return math.dist(self._vehicle.position, self._building.places[self._at])

    @property
    def _light_here(self) -> float:
        return self._light[self._inside] if self._inside else 1.0

    @property
    def _speed(self) -> float:
        return float(self._orders(BASE).get("speed", 0.0))

    def _orders(self, component: str) -> Mapping[str, Any]:
        """Return the parameters of a component; none if it does not run."""
        return self.parameters(component) if component in self.active else {}


@dataclass(frozen=True)
class AgvKind(mission.WorldKind):
    """Opens a building; `route` returns where the robot is and what is planned."""

    building: Building
    route: Callable[[KnowledgeBase, Percepts], Route]
    incidents: Sequence[Incident]

    def settings(self) -> tuple[Setting, ...]:
        return declared(Settings)

    def open(self, values: Mapping[str, Any], rng: Generator) -> BuildingWorld:
        return BuildingWorld(self.building, Settings.read(values), rng, self.incidents)

    def verdict(
        self, percepts: Percepts, results: Mapping[str, float | None], kb: KnowledgeBase
    ) -> Verdict:
        route = self.route(kb, percepts)
        answer = route.answer
        if answer.cost is None:
            return Verdict("aborted", answer.reason)
        if answer.legs:
            return Verdict("aborted", f"time ran out on the way from {route.place}")
        return Verdict("arrived", f"the robot is at {route.place}")
