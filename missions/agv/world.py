"""The building as a world of missions, with its incidents and the components of the vehicle."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.random import Generator

from kb import KnowledgeBase, ManagedSystem
from missions.agv.model import DRAW_W, DRIVING_W, ERROR_M, NAVIGATOR, NEEDED_LIGHT, SPEEDS, Building
from missions.agv.tree import Route
from missions.agv.vehicle import Aim, Array, Vehicle, aim_along, boxes, steer
from missions.engine.components import VERBS, NamedComponents, SimulatedComponents
from missions.engine.mission import (
    Message,
    MissionError,
    Percepts,
    Sample,
    Setting,
    Verdict,
    World,
    WorldKind,
)
from missions.engine.settings import Constants, declared, setting

_OWN: Final = "own choice"
_PAPER: Final = "ROSA paper, AGV use case; where along the corridor: own choice"

_STAND: Final = Aim(0.0, 0.0)
_ERROR_KEEPS: Final = 0.98  # of the error of the position, from one look to the next
_DARK: Final = 0.1  # where the lamps of a corridor have gone out, from 0 to 1; own choice
_CREEP_M: Final = 1e-4  # in a period; a robot that moves less stands still
_WELL_INSIDE_M: Final = 1.0  # so far from a place, the robot is in the corridor


@dataclass(frozen=True)
class Settings(Constants):
    """The constants; times count from the start of the mission."""

    incidents: bool = setting(True, "-", "whether the incidents of the map happen", _PAPER)
    capacity_j: float = setting(20_000.0, "J", "energy at the start", _OWN, 1.0)
    physics_step_s: float = setting(0.01, "s", "step of the physics engine", _OWN, 1e-3, 0.01)
    control_period_s: float = setting(0.1, "s", "period of sensing and steering", _OWN, 1e-2)
    monitor_period_s: float = setting(
        0.5, "s", "period of the monitors of light, energy and position", _OWN, 0.1
    )
    switching_s: float = setting(0.5, "s", "time to start or stop a component", _OWN, 0.0)
    parameter_s: float = setting(0.1, "s", "time to set parameters", _OWN, 0.0)
    standing_w: float = setting(2.0, "W", "power of the base while the vehicle stands", _OWN, 0.0)
    reach_m: float = setting(0.3, "m", "distance at which a place is reached", _OWN, 0.05)

    def __post_init__(self) -> None:
        super().__post_init__()
        steps = self.control_period_s / self.physics_step_s
        if round(steps) < 1 or abs(steps - round(steps)) > 1e-6:
            multiple = f"a whole multiple of physics_step_s {self.physics_step_s:g}"
            raise MissionError(f"control_period_s {self.control_period_s:g} is not {multiple}")


class Incident(NamedTuple):
    """What happens once, when the robot is within a corridor.

    A component fails; without a component, the light goes out.
    """

    corridor: str
    component: str = ""


class BuildingWorld(World):
    """A vehicle that drives where its navigator says, as long as it can localise itself.

    All chance comes from `rng`.
    """

    def __init__(
        self,
        building: Building,
        settings: Settings,
        rng: Generator,
        incidents: Sequence[Incident] = (),
    ) -> None:
        self._building = building
        self._settings = settings
        self._rng = rng
        start = building.places[building.start]
        placed = boxes(building, rng)
        pose = (*start, rng.uniform(-math.pi, math.pi))
        self._vehicle = Vehicle(building, placed, pose, settings.physics_step_s)
        self._components = _Components()
        takes = settings.switching_s, settings.switching_s, settings.parameter_s
        self._managed = SimulatedComponents(
            lambda: self.now, self._components, dict(zip(VERBS, takes, strict=True))
        )
        self._waiting = [
            (incident, rng.uniform(0.25, 0.6))  # where in its corridor, as a share of the length
            for incident in (incidents if settings.incidents else ())
        ]
        self._light = {corridor.name: corridor.light for corridor in building.corridors.values()}
        self._ticks = 0
        self._at = building.start
        self._inside = ""
        self._way = [building.start]
        self._ordered: Mapping[str, Any] = {}
        self._sensor = ""
        self._error: Array = np.zeros(2)
        self._error_m = 0.0
        self._energy_j = settings.capacity_j
        self._driven_total_m = 0.0
        self._is_moving = False
        self._news: dict[str, dict[str, str]] = {}
        self._happened: list[tuple[float, str]] = []
        self._monitor_due = 0.0
        self._say("mission status", f"at {self._at}", "true")
        self._say("QA measurement", "energy", repr(self._energy_j))

    @property
    def now(self) -> float:
        """Time since the start [s]."""
        return self._ticks * self._settings.control_period_s

    @property
    def managed(self) -> ManagedSystem:
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
        self._news = {}
        said = [
            {"name": "building", "message": kind, "values": values} for kind, values in news.items()
        ]
        return [{"time": self.now, "status": said}] if said else []

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
        x, y = self._vehicle.position
        signals = {"light [-]": self._light_here, "draws [W]": self._draws_w(self._sensor != "")}
        return Sample(
            self.now, (float(x), float(y), 0.0), {**signals, "speed set [m/s]": self._speed}
        )

    def disturbances(self) -> list[tuple[float, str]]:
        return list(self._happened)

    def scenery(self) -> Mapping[str, Any]:
        """Return the corridors, with what is special in each."""
        shown = {}
        for corridor in self._building.corridors.values():
            is_dark = self._light[corridor.name] < corridor.light or corridor.light < NEEDED_LIGHT
            words = {"obstructed": corridor.obstacles > 0, "dark": is_dark}
            start, end = (np.array(self._building.places[place]) for place in corridor.ends)
            shown[", ".join([corridor.name, *(word for word, holds in words.items() if holds)])] = (
                np.linspace(start, end, 9)
            )
        return shown

    def _step(self) -> None:
        self._ticks += 1
        before = self._vehicle.position
        self._take_orders()
        aim = self._aim()
        self._vehicle.drive(
            aim, round(self._settings.control_period_s / self._settings.physics_step_s)
        )
        self._energy_j = max(
            0.0, self._energy_j - self._draws_w(aim is not _STAND) * self._settings.control_period_s
        )
        driven_m = math.dist(before, self._vehicle.position)
        self._driven_total_m += driven_m
        self._is_moving = driven_m > _CREEP_M
        self._look_where_it_is()
        for waiting in list(self._waiting):
            incident, share = waiting
            length_m = self._building.corridors[incident.corridor].length_m
            if incident.corridor == self._inside and self._driven_m >= share * length_m:
                self._waiting.remove(waiting)
                self._happen(incident)

    def _take_orders(self) -> None:
        """Take over a new order: drive to the origin first, unless the vehicle is there."""
        ordered = self._components.orders(NAVIGATOR)
        if not ordered or ordered == self._ordered:
            return
        self._ordered = ordered
        to = self._building.corridors[ordered["corridor"]].other(ordered["origin"])
        is_on_it = self._inside == ordered["corridor"] or (
            self._at == ordered["origin"] and not self._inside
        )
        self._way = [to] if is_on_it else [ordered["origin"], to]

    def _aim(self) -> Aim:
        sensor = self._seeing()
        if sensor != self._sensor:
            self._sensor = sensor
            self._vehicle.forget()
        if not sensor or not self._way or self._speed == 0.0 or self._energy_j == 0.0:
            return _STAND
        target = np.array(self._building.places[self._way[0]])
        believed = self._vehicle.position + self._drift()
        corridor = self._building.corridors[
            self._ordered["corridor"] if len(self._way) == 1 else self._inside
        ]
        start = np.array(self._building.places[corridor.other(self._way[0])])
        to = aim_along(believed, start, target) - believed
        bearing = math.remainder(math.atan2(to[1], to[0]) - self._vehicle.yaw, math.tau)
        return steer(bearing, self._vehicle.look(sensor), self._speed)

    def _seeing(self) -> str:
        """Return the sensor by which the vehicle localises itself; empty if it cannot."""
        running = self._components.running
        for (localizer, sensor), error_m in ERROR_M.items():
            sees = sensor != "camera" or self._light_here >= NEEDED_LIGHT or "lamp" in running
            if sees and running.issuperset((localizer, sensor, "base", NAVIGATOR)):
                self._error_m = error_m
                return sensor
        return ""

    def _drift(self) -> Array:
        """Return the error of the position that the vehicle believes in, (2,) [m]; it wanders."""
        fresh = self._error_m * math.sqrt((1 - _ERROR_KEEPS**2) / 2)
        self._error = _ERROR_KEEPS * self._error + fresh * self._rng.standard_normal(2)
        return self._error

    def _look_where_it_is(self) -> None:
        position = self._vehicle.position
        if (
            self._way
            and math.dist(position, self._building.places[self._way[0]]) < self._settings.reach_m
        ):
            place = self._way.pop(0)
            if self._inside:
                self._say("mission status", f"in {self._inside}", "false")
                self._inside = ""
            if place != self._at:
                self._say("mission status", f"at {self._at}", "false")
                self._at = place
                self._say("mission status", f"at {place}", "true")
        elif not self._inside and len(self._way) == 1 and self._driven_m > _WELL_INSIDE_M:
            self._inside = str(self._ordered["corridor"])
            self._say("EA measurement", "driven", repr(self._driven_m))
            self._say("mission status", f"in {self._inside}", "true")

    def _happen(self, incident: Incident) -> None:
        name = incident.component
        if name:
            text = f"{name} failed"
            self._components.failed.add(name)
            self._say("component status", name, "failure")
            self._say("mission status", text, "true")
        else:
            light = f"light in {incident.corridor}"
            text = f"{light} goes out"
            self._light[incident.corridor] = _DARK
            self._say("EA measurement", "light", repr(_DARK))
            self._say("mission status", light, repr(_DARK))
        self._happened.append((self.now, text))

    def _monitor(self) -> None:
        self._monitor_due += self._settings.monitor_period_s
        if self._inside:
            self._say("EA measurement", "light", repr(self._light_here))
            self._say("EA measurement", "driven", repr(self._driven_m))
        self._say("QA measurement", "energy", repr(self._energy_j))

    def _say(self, kind: str, key: str, value: str) -> None:
        self._news.setdefault(kind, {})[key] = value

    @property
    def _driven_m(self) -> float:
        return math.dist(self._vehicle.position, self._building.places[self._at])

    @property
    def _light_here(self) -> float:
        return self._light[self._inside] if self._inside else 1.0

    @property
    def _speed(self) -> float:
        return float(self._components.orders("base").get("speed", 0.0))

    def _draws_w(self, is_driving: bool) -> float:
        now = self._speed
        speed = next((name for name, value in SPEEDS.items() if value == now), "")
        base_w = DRIVING_W[speed] if is_driving and speed else self._settings.standing_w
        running = self._components.running
        return base_w + sum(watts for name, watts in DRAW_W.items() if name in running)


class _Components(NamedComponents):
    """A component that has failed, or that the vehicle does not have, does not start."""

    def __init__(self) -> None:
        super().__init__()
        self.failed = set[str]()

    def activate(self, component: str, /) -> None:
        if component in self.failed or component not in (*DRAW_W, "base", NAVIGATOR):
            raise MissionError(f"the simulated vehicle has no component {component} that works")
        super().activate(component)

    def orders(self, component: str) -> Mapping[str, Any]:
        """Return the parameters of a component; none if it does not run."""
        return self.taken.get(component, {}) if self.is_active(component) else {}

    @property
    def running(self) -> set[str]:
        return self.active - self.failed

    def is_active(self, component: str, /) -> bool:
        return component in self.running


class AgvKind(WorldKind):
    """Opens a building; the weights are those of the mission, to say why there was no plan."""

    def __init__(
        self,
        building: Building,
        weights: Mapping[str, float],
        incidents: Sequence[Incident] = (),
    ) -> None:
        self._building = building
        self._weights = weights
        self._incidents = tuple(incidents)
        for incident in self._incidents:
            building.check("corridor", incident.corridor, "an incident")
            if incident.component not in ("", *DRAW_W):
                known = ", ".join(DRAW_W)
                raise MissionError(f"the vehicle has no {incident.component!r}; it has {known}")

    def settings(self) -> tuple[Setting, ...]:
        return declared(Settings)

    def open(self, values: Mapping[str, Any], rng: Generator) -> BuildingWorld:
        return BuildingWorld(self._building, Settings.read(values), rng, self._incidents)

    def verdict(
        self, percepts: Percepts, results: Mapping[str, float | None], kb: KnowledgeBase
    ) -> Verdict:
        route = Route(self._building, kb, percepts, self._weights)
        if route.is_there:
            return Verdict("arrived", f"the robot is at {self._building.goal}")
        if not route.answer.is_solved:
            where = f"within {route.inside}" if route.inside else route.at
            return Verdict("aborted", f"there is no way from {where}: {route.answer.reason}")
        return Verdict("aborted", f"time ran out on the way from {route.at}")
