"""The field with the vehicle above it as a world of missions; MuJoCo is imported when it is opened."""

from collections.abc import Mapping
from math import cos, dist, pi, sin
from typing import Any

from numpy.random import Generator

from kb import KnowledgeBase
from missions.engine.components import SimulatedComponents
from missions.engine.mission import Message, Percepts, Sample, Setting, Verdict, World, WorldKind
from missions.engine.settings import declared
from missions.uav.model import ANALYSE_LEVEL, PICK_UP_LEVEL, SEARCH_LEVEL
from missions.uav.settings import PERIOD_S, Settings
from missions.uav.tree import analysed, is_all_analysed

STATUS = "mission status"
LEVELS = {
    PICK_UP_LEVEL: "picking up a sample needs",
    SEARCH_LEVEL: "searching needs",
    ANALYSE_LEVEL: "analysing on site needs",
}


class UavWorld(World):
    """Time moves only in `advance`; the same settings and seed give the same floats.

    Chance is where the samples lie, the wind, the phase of the battery monitor, and the jam.
    """

    def __init__(self, settings: Settings, rng: Generator) -> None:
        self._settings = settings
        self._now, self._steps, self._nodes_due = 0.0, 0, 0.0
        self._outbox: list[Message] = []
        self._disturbances: list[tuple[float, str]] = []
        self._flown_m, self._least, self._between = 0.0, 1.0, (1.0, 1.0)
        bearing, phase = rng.uniform(0, 2 * pi), rng.uniform(0, settings.battery_period_s)
        self._battery_due = float(phase)
        wind = (settings.wind_m_s * cos(bearing), settings.wind_m_s * sin(bearing))
        from missions.uav.nodes import Nodes, Robot
        from missions.uav.vehicle import SUBSTEPS, Quadrotor

        self._robot = Robot(settings, Quadrotor(settings, wind), rng, self._publish, self._disturb)
        self._places = {one.name: [one.place] for one in self._robot.samples}
        self._nodes = Nodes(self._robot)
        takes = {"activate": settings.activation_s, "deactivate": settings.deactivation_s}
        self._managed = SimulatedComponents(lambda: self._now, self._nodes, takes)
        self._step_s = SUBSTEPS * settings.physics_step_s
        self._not_wanted = list(self._robot.samples)
        self._want()
        self._publish(STATUS, "gripper_folded", "true")
        self._publish("QA measurement", "battery_level", "1.0")

    @property
    def now(self) -> float:
        return self._now

    @property
    def managed(self) -> SimulatedComponents:
        return self._managed

    def advance(self, until: float) -> list[Message]:
        """Simulate until something is published or switched, at most to the time `until` [s]."""
        is_changed = bool(self._outbox)
        while not is_changed and (self._steps + 1) * self._step_s <= until + 1e-9:
            self._steps += 1
            self._now = self._steps * self._step_s
            self._step()
            is_changed = self._managed.catch_up() or bool(self._outbox)
        if not is_changed:
            self._now = until
        said, self._outbox = self._outbox, []
        return said

    def _step(self) -> None:
        robot, vehicle, before = self._robot, self._robot.vehicle, self._robot.vehicle.position
        robot.now = self._now
        vehicle.step()
        self._flown_m += dist(before, vehicle.position)
        self._drain()
        if self._now >= self._nodes_due - 1e-9:
            self._nodes_due += PERIOD_S
            self._want()
            for node in self._nodes.acting:
                node.update()
            robot.aim()
        if self._now >= self._battery_due - 1e-9:
            self._battery_due += self._settings.battery_period_s
            self._publish("QA measurement", "battery_level", repr(robot.level))

    def _drain(self) -> None:
        robot, settings, before, step_s = self._robot, self._settings, self._robot.level, self._step_s
        watts = robot.vehicle.rotor_w + settings.avionics_w + self._nodes.watts
        gained = step_s / settings.charge_s if robot.is_charging else 0.0
        after = before + gained - watts * step_s / settings.capacity_j
        if self._between[0] < after < self._between[1]:  # mostly
            robot.level = after
            self._least = after if after < self._least else self._least
        else:
            self._cross(before, max(0.0, min(1.0, after)))

    def _cross(self, before: float, after: float) -> None:
        """Take in a charge on the other side of a level, and note what that means."""
        robot, levels = self._robot, (0.0, *LEVELS, 1.0)
        self._between = max(one for one in levels if one <= after), min(one for one in levels if one >= after)
        robot.level, self._least = after, min(self._least, after)
        for level, what in LEVELS.items():
            if before >= level > after:
                self._disturb(f"the battery fell below {level:g}, which {what}")
        if after == 0.0 and before > 0.0:
            robot.vehicle.has_power = False
            self._disturb("the battery is empty")
            self._publish(STATUS, "battery_empty", "true")

    def _want(self) -> None:
        for one in [one for one in self._not_wanted if one.wanted_s <= self._now]:
            self._not_wanted.remove(one)
            self._publish(STATUS, f"{one.name}_wanted", "true")
            if one.is_reported:
                one.is_found = True
                self._disturb(f"an operator reports {one.name}")
                self._publish(STATUS, f"{one.name}_found", "true")

    def _publish(self, message: str, key: str, value: str) -> None:
        status = {"name": "uav", "message": message, "values": {key: value}}
        self._outbox.append({"time": self._now, "status": [status]})

    def _disturb(self, text: str) -> None:
        self._disturbances.append((self._now, text))

    @property
    def is_still(self) -> bool:
        """Whether the battery has run empty, after which it does not fly again, and nobody wants anything more."""
        return not (self._robot.vehicle.has_power or self._robot.is_charging or self._not_wanted)

    def results(self) -> dict[str, float | None]:
        robot = self._robot
        return {
            "analysed_samples": float(len(robot.qualities)),
            "quality_points": sum(robot.qualities),
            "wanted_samples": float(len(robot.samples) - len(self._not_wanted)),
            "lifted_samples": float(robot.pick_ups),
            "recharged_times": float(robot.recharges),
            "flown_m": self._flown_m,
            "least_charge_percent": 100 * self._least,
        }

    def sample(self) -> Sample:
        robot = self._robot
        signals = {
            "battery level [-]": robot.level,
            "height [m]": robot.vehicle.altitude,
            "rotors [W]": robot.vehicle.rotor_w,
            "gripper [deg]": robot.vehicle.arm_rad * 180 / pi,
        }
        return Sample(self._now, robot.vehicle.position, signals)

    def disturbances(self) -> list[tuple[float, str]]:
        return list(self._disturbances)

    def scenery(self) -> Mapping[str, Any]:
        return {"base": [(0.0, 0.0)], **{name.replace("_", " "): place for name, place in self._places.items()}}


class _SkyKind(WorldKind):
    def settings(self) -> tuple[Setting, ...]:
        return declared(Settings)

    def open(self, values: Mapping[str, str], rng: Generator) -> UavWorld:
        return UavWorld(Settings.read(values), rng)

    def verdict(self, percepts: Percepts, results: Mapping[str, float | None], kb: KnowledgeBase) -> Verdict:
        """Judge by the goal: every sample that is wanted is analysed, and the battery never ran empty."""
        done, wanted = analysed(percepts), results.get("wanted_samples") or 0
        if percepts.holds("battery_empty"):
            return Verdict("aborted", f"the battery ran empty, {done} of {wanted:g} samples were analysed")
        if is_all_analysed(percepts):
            return Verdict("analysed_all", f"all {wanted:g} samples are analysed")
        return Verdict("aborted", f"time ran out, {done} of {wanted:g} samples were analysed")


SKY = _SkyKind()
