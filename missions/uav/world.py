"""The field in which samples lie, and the components of the vehicle that flies over it.

Each component acts 10 times a second while it is active. When a component that moves the vehicle
stops, the vehicle hovers where it is: the safe state between two actions.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import cos, dist, hypot, inf, pi, sin, tan
from typing import Any, Final

from numpy.random import Generator

from kb import KnowledgeBase
from kb.elements import Parameters
from missions.engine import mission
from missions.engine.components import NamedComponents, SimulatedComponents
from missions.engine.mission import (
    MISSION_STATUS,
    Message,
    MissionError,
    Percepts,
    Setting,
    Verdict,
    WorldKind,
)
from missions.engine.settings import declared
from missions.uav.model import ANALYSE_LEVEL, PICK_UP_LEVEL, SEARCH_LEVEL
from missions.uav.tree import analysed, is_all_analysed
from missions.uav.vehicle import ON_GROUND_M, SUBSTEPS, Quadrotor, Settings

PERIOD_S: Final = 0.1  # period of the components
GRIP_M: Final = 0.12  # height of the legs from which the gripper reaches the ground
LIFT_M: Final = 2.5  # height at which a held sample is analysed
LOOK_M: Final = 2.0  # height from which the infra-red camera looks
FOLDED_RAD: Final = 0.15  # out of the camera's view; folded at half of this, for gusts
FULL: Final = 0.99
MOVERS: Final = (
    "search_planner",
    "pick_up_planner",
    "hover_planner",
    "return_planner",
    "landing_planner",
)
OFF_LANE_M: Final = 2.0  # how far from the middle of its lane a sample may lie
LEVELS: Final = {
    PICK_UP_LEVEL: "picking up a sample needs",
    SEARCH_LEVEL: "searching needs",
    ANALYSE_LEVEL: "analysing on site needs",
}


@dataclass(slots=True)
class Sample:
    """Something to be analysed."""

    name: str  # "sample_1" and so on
    place: tuple[float, float]  # (x, y) [m], world frame
    wanted_s: float = 0.0  # from when on it is wanted [s]
    is_reported: bool = False  # reported by an operator; it goes before those that the camera found
    is_wanted: bool = False
    is_found: bool = False  # its place is known
    quality: float | None = None  # of its analysis, up to 1; None before it


class UavWorld(mission.World):
    """The vehicle over its field, and the state that its components share.

    Time moves only in `advance`; the same settings and seed give the same floats. Random are the
    places of the samples, the wind, the phase of the battery monitor, and the jam. The field
    consists of lanes along the x axis; samples lie in two patches, and the middle third of the
    lanes has none.

    Attributes:
        level: charge of the battery, 0 to 1.
        samples: all samples, also those that are not wanted yet.
        target: the sample to analyse next; None while none waits.
        jams_s: when the gripper jams [s].
        pick_ups: how many samples were lifted.
        recharges: how often the battery was charged until it was full.
        qualities: worth of each analysis that was done.
        messages: what was published, until it is taken away.
    """

    now = 0.0

    def __init__(self, settings: Settings, rng: Generator) -> None:
        self.settings = settings
        self.rng = rng
        bearing = rng.uniform(0, 2 * pi)
        self._battery_due = float(rng.uniform(0, settings.battery_period_s))
        self.vehicle = Quadrotor(
            settings, (settings.wind_m_s * cos(bearing), settings.wind_m_s * sin(bearing))
        )
        self._steps = 0
        self._step_s = SUBSTEPS * settings.physics_step_s
        self._nodes_due = 0.0
        self._flown_m = 0.0
        self._least = 1.0
        self.level = 1.0
        self.jams_s = inf
        self.target: Sample | None = None
        self.held: Sample | None = None
        self.is_jammed = self.is_charging = False
        self.pick_ups = self.recharges = 0
        self.qualities: list[float] = []
        self.messages: list[Message] = []
        self._happened: list[tuple[float, str]] = []
        every = int(settings.lanes)
        count = int(settings.samples)
        lanes = [index for index in range(every) if not every // 3 <= index < every - every // 3]
        places = [self._place(lanes[number * len(lanes) // count]) for number in range(count)]
        self.samples = [
            Sample(f"sample_{number}", place) for number, place in enumerate(places, start=1)
        ]
        added = Sample(
            f"sample_{count + 1}", self._place(lanes[0]), settings.added_s, is_reported=True
        )
        self.samples += [added] if settings.added_s > 0 else []
        self._places = {sample.name: [sample.place] for sample in self.samples}
        self._nodes = Nodes(self)
        takes = {"activate": settings.activation_s, "deactivate": settings.deactivation_s}
        self._managed = SimulatedComponents(lambda: self.now, self._nodes, takes)
        self.want()
        self.say("gripper_folded")
        self.publish("QA measurement", "battery_level", "1.0")

    @property
    def managed(self) -> SimulatedComponents:
        return self._managed

    def publish(self, message: str, key: str, value: str) -> None:
        """Publish a key and its value, in a message with this text."""
        status = {"name": "uav", "message": message, "values": {key: value}}
        self.messages.append({"time": self.now, "status": [status]})

    def say(self, key: str, holds: bool = True) -> None:
        """Publish whether something holds."""
        self.publish(MISSION_STATUS, key, str(holds).lower())

    def disturb(self, text: str) -> None:
        """Record what truly happened, for `disturbances`."""
        self._happened.append((self.now, text))

    def _lane_y(self, lane: int) -> float:
        return (lane + 0.5) * self.settings.lane_m

    def _place(self, lane: int) -> tuple[float, float]:
        x = self.rng.uniform(0.1, 0.95) * self.settings.field_x_m
        off = self.rng.uniform(-OFF_LANE_M, OFF_LANE_M)
        return float(x), self._lane_y(lane) + float(off)

    @property
    def path(self) -> list[tuple[float, float]]:
        """Corners (x, y) of the way along all lanes, to and fro [m], world frame."""
        ends = (0.0, self.settings.field_x_m)
        lanes = range(int(self.settings.lanes))
        return [
            (x, self._lane_y(lane))
            for lane in lanes
            for x in (ends if lane % 2 == 0 else ends[::-1])
        ]

    def want(self) -> None:
        """Mark and publish the samples that are wanted from now on."""
        for sample in self.samples:
            if sample.is_wanted or sample.wanted_s > self.now:
                continue
            sample.is_wanted = True
            self.say(f"{sample.name}_wanted")
            if sample.is_reported:
                sample.is_found = True
                self.disturb(f"an operator reports {sample.name}")
                self.say(f"{sample.name}_found")

    def aim(self) -> None:
        """Choose the next target if there is none: reported ones first, then the nearest."""
        if self.target is not None:
            return
        place = self.vehicle.position[:2]
        waiting = [sample for sample in self.samples if sample.is_found and sample.quality is None]
        if waiting:
            self.target = min(
                waiting, key=lambda sample: (not sample.is_reported, dist(sample.place, place))
            )
            self.say(f"{self.target.name}_target")

    def approach(self, height: float) -> None:
        """Fly to where the legs are at a height above the target [m], if there is one."""
        if self.target is not None:
            self.vehicle.go_to(self.over(self.target, height))

    def over(self, sample: Sample, height: float) -> tuple[float, float, float]:
        """Return the place where the legs are at a height above a sample [m], world frame."""
        return (*sample.place, ON_GROUND_M + height)

    def let_go(self) -> None:
        """Drop the held sample, if any; it lies where it falls."""
        if self.held is not None:
            self.held.place = self.vehicle.position[:2]
            self.held = None
            self.vehicle.carry(0.0)

    def analysed(self, quality: float) -> None:
        """Record that the target is analysed, with a quality up to 1."""
        if self.target is not None:
            self.target.quality = quality
            self.qualities.append(quality)
            self.say(f"{self.target.name}_analysed")
            self.say(f"{self.target.name}_target", False)
            self.target = None

    def advance(self, until: float) -> list[Message]:
        """Simulate until something is published or switched, at most to the time `until` [s]."""
        is_changed = bool(self.messages)
        while not is_changed and (self._steps + 1) * self._step_s <= until + 1e-9:
            self._steps += 1
            self.now = self._steps * self._step_s
            self._step()
            is_changed = self._managed.catch_up() or bool(self.messages)
        if not is_changed:
            self.now = until
        messages = self.messages
        self.messages = []
        return messages

    def _step(self) -> None:
        before = self.vehicle.position
        self.vehicle.step()
        self._flown_m += dist(before, self.vehicle.position)
        self._drain()
        if self.now >= self._nodes_due - 1e-9:
            self._nodes_due += PERIOD_S
            self.want()
            self._nodes.act()
            self.aim()
        if self.now >= self._battery_due - 1e-9:
            self._battery_due += self.settings.battery_period_s
            self.publish("QA measurement", "battery_level", repr(self.level))

    def _drain(self) -> None:
        """Charge and discharge the battery for one step; record each level that it falls below."""
        settings = self.settings
        before = self.level
        step_s = self._step_s
        watts = self.vehicle.rotor_w + settings.avionics_w + self._nodes.watts
        gained = step_s / settings.charge_s if self.is_charging else 0.0
        level = before + gained - watts * step_s / settings.capacity_j
        self.level = level = 0.0 if level < 0.0 else 1.0 if level > 1.0 else level
        if level < self._least:
            self._least = level
        for least, what in LEVELS.items():
            if before >= least > level:
                self.disturb(f"the battery fell below {least:g}, which {what}")
        if level == 0.0 and before > 0.0:
            self.vehicle.has_power = False
            self.disturb("the battery is empty")
            self.say("battery_empty")

    @property
    def is_still(self) -> bool:
        """Whether nothing more can happen: the battery is empty, and all samples are wanted."""
        return not (self.vehicle.has_power or self.is_charging) and all(
            sample.is_wanted for sample in self.samples
        )

    def results(self) -> dict[str, float | None]:
        return {
            "analysed_samples": float(len(self.qualities)),
            "quality_points": sum(self.qualities),
            "wanted_samples": float(sum(sample.is_wanted for sample in self.samples)),
            "lifted_samples": float(self.pick_ups),
            "recharged_times": float(self.recharges),
            "flown_m": self._flown_m,
            "least_charge_percent": 100 * self._least,
        }

    def sample(self) -> mission.Sample:
        signals = {
            "battery level [-]": self.level,
            "height [m]": self.vehicle.altitude,
            "rotors [W]": self.vehicle.rotor_w,
            "gripper [deg]": self.vehicle.arm_rad * 180 / pi,
        }
        return mission.Sample(self.now, self.vehicle.position, signals)

    def disturbances(self) -> list[tuple[float, str]]:
        return list(self._happened)

    def scenery(self) -> Mapping[str, Any]:
        return {
            "base": [(0.0, 0.0)],
            **{name.replace("_", " "): place for name, place in self._places.items()},
        }


class Nodes(NamedComponents):
    """The components, and what each does while it is active; a change takes effect at once.

    Attributes:
        watts: power of the active components [W].
    """

    def __init__(self, robot: UavWorld) -> None:
        super().__init__()
        self._robot = robot
        self._ahead = robot.path
        half_w = robot.settings.pick_up_w / 2
        self._acts: dict[str, Callable[[], None]] = {
            "search_planner": self._search,
            "sample_camera": self._see_samples,
            "pick_up_planner": self._pick_up,
            "gripper": self._grip,
            "analyser": self._analyse,
            "hover_planner": lambda: robot.approach(LOOK_M),
            "infrared_camera": self._look,
            "return_planner": self._return,
            "landing_planner": lambda: None,
            "folding_servo": self._fold,
        }
        self._powers_w = {
            "gripper": half_w,
            "analyser": half_w,
            "infrared_camera": robot.settings.infrared_w,
        }
        self.watts = 0.0
        self._worked_s = dict.fromkeys(self._acts, 0.0)
        self._done: set[str] = (
            set()
        )  # components that have reported, since they became active, that they are

    def act(self) -> None:
        """Let the active components act; called once a period."""
        for name, act in self._acts.items():
            if name in self.active:
                act()

    def check(self, component: str, parameters: Parameters, /) -> None:
        """Raise MissionError unless the component exists; none has parameters."""
        if component not in self._acts or parameters:
            known = f"there are {', '.join(self._acts)}, which have no parameters"
            raise MissionError(
                f"{component!r} with parameters {dict(parameters)} is unknown; {known}"
            )

    def activate(self, component: str, /) -> None:
        if component in self.active:
            return
        super().activate(component)
        self._count_watts()
        self._done.discard(component)
        if component == "gripper":
            self._worked(component, False)
            self._robot.vehicle.fold(False)
            self._robot.say("gripper_folded", False)
        elif component == "landing_planner":
            self._robot.vehicle.land()

    def deactivate(self, component: str, /) -> None:
        if component not in self.active:
            return
        super().deactivate(component)
        self._count_watts()
        robot = self._robot
        if component == "search_planner":
            self._ahead = [robot.vehicle.position[:2], *self._ahead]  # to go on where it stopped
        elif component == "gripper":
            robot.let_go()
        elif component == "return_planner":
            robot.is_charging = False
        if component in MOVERS and not self.active.intersection(MOVERS):
            robot.vehicle.hold()

    def _count_watts(self) -> None:
        self.watts = sum([watts for name, watts in self._powers_w.items() if name in self.active])

    def _worked(self, component: str, works: bool) -> float:
        """Return how long a component has worked without a break [s].

        `works` tells whether it does in this period.
        """
        self._worked_s[component] = self._worked_s[component] + PERIOD_S if works else 0.0
        return self._worked_s[component]

    def _search(self) -> None:
        """Fly along the lanes."""
        robot = self._robot
        x, y = self._ahead[0]
        robot.vehicle.go_to((x, y, ON_GROUND_M + robot.settings.cruise_m))
        if dist((x, y), robot.vehicle.position[:2]) < 1.0:
            self._ahead = self._ahead[1:] or robot.path

    def _see_samples(self) -> None:
        """Find the samples in the camera's circle below, whose radius grows with altitude."""
        robot = self._robot
        vehicle = self._robot.vehicle
        radius = vehicle.altitude * tan(robot.settings.half_view_rad)
        for sample in robot.samples:
            if (
                not (sample.is_found or sample.is_reported)
                and dist(sample.place, vehicle.position[:2]) <= radius
            ):
                sample.is_found = True
                robot.say(f"{sample.name}_found")

    def _pick_up(self) -> None:
        """Fly down to the target, and up again once it is in the gripper."""
        self._robot.approach(GRIP_M if self._robot.held is None else LIFT_M)

    def _grip(self) -> None:
        """Grip the target when it is within reach.

        A worn gripper jams while it lifts, and drops the sample.
        """
        robot = self._robot
        target = self._robot.target
        settings = self._robot.settings
        if robot.held is not None and robot.now >= robot.jams_s:
            robot.is_jammed = True
            robot.jams_s = inf
            robot.let_go()
            robot.disturb("the gripper jammed")
            robot.publish("component status", "gripper", "FALSE")
        if robot.is_jammed or robot.held is not None or target is None:
            return
        reached = (
            robot.vehicle.is_near(robot.over(target, GRIP_M), 0.15) and robot.vehicle.arm_rad > 1.2
        )
        if self._worked("gripper", reached) >= settings.grip_s:
            robot.held = target
            robot.pick_ups += 1
            robot.vehicle.carry(settings.sample_kg)
            if 0 < settings.gripper_worn_s <= robot.now:
                robot.jams_s = robot.now + float(robot.rng.uniform(0.1, settings.jam_delay_s))

    def _analyse(self) -> None:
        """Analyse the held sample once it is lifted."""
        robot = self._robot
        is_lifted = robot.held is not None and robot.vehicle.altitude > LIFT_M - 0.5
        if self._worked("analyser", is_lifted) >= robot.settings.analysis_s:
            robot.analysed(1.0)
            robot.let_go()

    def _look(self) -> None:
        """Analyse the target from above; an unfolded gripper would block the view."""
        robot = self._robot
        target = self._robot.target
        settings = self._robot.settings
        sees = target is not None and robot.vehicle.is_near(robot.over(target, LOOK_M), 0.4)
        if (
            self._worked("infrared_camera", sees and robot.vehicle.arm_rad < FOLDED_RAD)
            >= settings.infrared_s
        ):
            robot.analysed(settings.infrared_quality)

    def _return(self) -> None:
        """Land at the base, which is the origin, and charge.

        While the battery is full, report this every period.

        So an action that begins with a full battery receives the report too. The level is published
        with it, so that nothing is decided by an older measurement.
        """
        robot = self._robot
        vehicle = self._robot.vehicle
        if not (vehicle.is_landed and hypot(*vehicle.position[:2]) < 1.0):
            vehicle.land((0.0, 0.0))
            return
        robot.is_charging = True
        if robot.level >= FULL:
            robot.recharges += "return_planner" not in self._done
            self._done.add("return_planner")
            robot.publish("QA measurement", "battery_level", repr(robot.level))
            robot.say("battery_recharged")

    def _fold(self) -> None:
        """Fold the gripper once the vehicle stands."""
        vehicle = self._robot.vehicle
        if vehicle.is_landed:
            vehicle.fold(True)
            if vehicle.arm_rad < FOLDED_RAD / 2 and "folding_servo" not in self._done:
                self._done.add("folding_servo")
                self._robot.say("gripper_folded")


class _SkyKind(WorldKind):
    def settings(self) -> tuple[Setting, ...]:
        return declared(Settings)

    def open(self, values: Mapping[str, Any], rng: Generator) -> UavWorld:
        return UavWorld(Settings.read(values), rng)

    def verdict(
        self, percepts: Percepts, results: Mapping[str, float | None], kb: KnowledgeBase
    ) -> Verdict:
        """Judge by the goal: all wanted samples are analysed, and the battery never ran empty."""
        done = analysed(percepts)
        wanted = results.get("wanted_samples") or 0
        if percepts.holds("battery_empty"):
            return Verdict(
                "aborted", f"the battery ran empty, {done} of {wanted:g} samples were analysed"
            )
        if is_all_analysed(percepts):
            return Verdict("analysed_all", f"all {wanted:g} samples are analysed")
        return Verdict("aborted", f"time ran out, {done} of {wanted:g} samples were analysed")


SKY = _SkyKind()
