"""The field in which samples lie, and the components of the vehicle that flies over it.

Each component acts 10 times a second while it is active. When a component that moves the vehicle
stops, the vehicle hovers where it is: the safe state between two actions.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import cos, dist, hypot, inf, pi, sin, tan
from typing import Any, Final

from numpy.random import Generator

from kb import KnowledgeBase
from kb.elements import Parameters
from missions.engine import mission
from missions.engine.components import NamedComponents, SimulatedComponents
from missions.engine.mission import (
    Message,
    MissionError,
    Percepts,
    Setting,
    Verdict,
    WorldKind,
)
from missions.engine.percepts import failed, measured, sensed
from missions.engine.settings import Constants, declared, setting
from missions.uav.model import ANALYSE_LEVEL, MOST_SAMPLES, PICK_UP_LEVEL, SEARCH_LEVEL
from missions.uav.tree import analysed, is_all_analysed
from missions.uav.vehicle import CRUISE_M, ON_GROUND_M, STEP_S, Quadrotor

_OWN: Final = "own choice"
_SCENARIO: Final = "own choice, so that the paper's three scenarios occur"

# The constants below are own choices, too.
PERIOD_S: Final = 0.1  # of the components
BATTERY_PERIOD_S: Final = 0.5  # of the battery monitor

FIELD_M: Final = 36.0  # length of the field, eastward from the base, which is the origin
LANE_M: Final = 6.0  # distance between the lanes of the search
PATCHES: Final = (0, 1, 4, 5)  # the lanes in which samples lie
OFF_LANE_M: Final = 2.0  # how far from the middle of its lane a sample may lie
HALF_VIEW_RAD: Final = 0.66  # half of the sample camera's field of view

GRIP_M: Final = 0.12  # height of the legs from which the gripper reaches the ground
GRIP_S: Final = 1.0  # time to grip a sample
JAM_DELAY_S: Final = 3.0  # longest time from the grip of a worn gripper to its jam
SAMPLE_KG: Final = 0.2
LIFT_M: Final = 2.5  # height at which a held sample is analysed
ANALYSIS_S: Final = 6.0  # time to analyse it
LOOK_M: Final = 2.0  # height from which the infra-red camera looks
LOOK_S: Final = 4.0  # time to analyse a sample in the infra-red
LOOK_QUALITY: Final = 0.6  # worth of this analysis; of a held sample it is 1
UNFOLDED_RAD: Final = 1.2
FOLDED_RAD: Final = 0.15  # out of the camera's view; folded at half of this, for gusts

FULL: Final = 0.99
CHARGE_S: Final = 10.0  # time to charge an empty battery; short, as a mission takes minutes
AVIONICS_W: Final = 5.0  # power of the electronics that always run
POWERS_W: Final = {"gripper": 20.0, "analyser": 20.0, "infrared_camera": 5.0}
LEVELS: Final = {
    PICK_UP_LEVEL: "picking up a sample needs",
    SEARCH_LEVEL: "searching needs",
    ANALYSE_LEVEL: "analysing on site needs",
}
MOVERS: Final = {
    "search_planner",
    "pick_up_planner",
    "hover_planner",
    "return_planner",
    "landing_planner",
}  # the components that move the vehicle


@dataclass(frozen=True, slots=True)
class Settings(Constants):
    """What can be set. Times since the start."""

    samples: float = setting(
        7, "-", "number of samples that are wanted from the start", _OWN, 1, MOST_SAMPLES - 1
    )
    added_s: float = setting(
        60.0, "s", "when an operator reports one more sample; 0: never", _SCENARIO
    )
    gripper_worn_s: float = setting(120.0, "s", "time after which a grip jams; 0: never", _SCENARIO)
    wind_m_s: float = setting(1.0, "m/s", "steady wind, from a random direction", _OWN, 0, 4)
    capacity_j: float = setting(28000.0, "J", "energy of a full battery", _OWN, 1000)
    switching_s: float = setting(
        0.03, "s", "time to activate or deactivate a component", "typical of ROS 2"
    )


@dataclass(slots=True)
class Sample:
    """Something to be analysed.

    Attributes:
        place: (x, y) [m], world frame.
        is_reported: by an operator; it goes before those that the camera found.
        is_found: whether its place is known.
    """

    name: str
    place: tuple[float, float]
    is_reported: bool
    is_found: bool
    is_analysed: bool = False


class UavWorld(NamedComponents, mission.World):
    """The vehicle over its field, and what its components do while they are active.

    Time moves only in `advance`; the same settings and seed give the same floats. Random are the
    places of the samples, the wind, the phase of the battery monitor, and the jam. The field
    consists of lanes along the x axis; samples lie in two patches.

    Attributes:
        level: charge of the battery, 0 to 1.
        samples: all samples that are wanted by now.
        target: the sample to analyse next; None while none waits.
        held: the sample in the gripper.
        messages: what is published next.
        is_jammed: whether the gripper is.
    """

    now = 0.0

    def __init__(self, settings: Settings, rng: Generator) -> None:
        super().__init__()
        self._settings = settings
        self._rng = rng
        bearing = rng.uniform(0, 2 * pi)
        self._battery_due = rng.uniform(0, BATTERY_PERIOD_S)
        self._components_due = 0.0
        wind = settings.wind_m_s
        self.vehicle = Quadrotor((wind * cos(bearing), wind * sin(bearing)))
        self._acts = {
            "search_planner": self._search,
            "sample_camera": self._see_samples,
            "pick_up_planner": lambda: self._approach(LIFT_M if self.held else GRIP_M),
            "gripper": self._grip,
            "analyser": self._analyse,
            "hover_planner": lambda: self._approach(LOOK_M),
            "infrared_camera": self._look,
            "return_planner": self._return,
            "landing_planner": lambda: None,
            "folding_servo": self._fold,
        }
        takes = dict.fromkeys(("activate", "deactivate"), settings.switching_s)
        self._managed = SimulatedComponents(lambda: self.now, self, takes)
        self._path: list[tuple[float, float]] = []
        self._flown_m = 0.0
        self._least = 1.0
        self._is_charging = False
        self._recharges = 0
        self._worked_s = 0.0
        self._pick_ups = 0
        self._qualities: list[float] = []
        self.messages: list[Message] = []
        self._happened: list[tuple[float, str]] = []
        self.level = 1.0
        self.is_jammed = False
        self._jams_s = inf
        self._is_folded = True
        self.samples: list[Sample] = []
        self.target: Sample | None = None
        self.held: Sample | None = None
        count = int(settings.samples)
        for number in range(count):
            self.want(self._place(PATCHES[number * len(PATCHES) // count]))
        self._added = self._place(PATCHES[0])
        self._added_s = settings.added_s or inf
        self._say("gripper_folded")
        self._measure_battery()

    @property
    def managed(self) -> SimulatedComponents:
        return self._managed

    @property
    def is_still(self) -> bool:
        """Whether nothing more can happen: the battery is empty, and no sample will be added."""
        return not (self.vehicle.has_power or self._is_charging) and self._added_s == inf

    def results(self) -> dict[str, float | None]:
        return {
            "analysed_samples": float(len(self._qualities)),
            "quality_points": sum(self._qualities),
            "wanted_samples": float(len(self.samples)),
            "lifted_samples": float(self._pick_ups),
            "recharged_times": float(self._recharges),
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
        x, y, z = self.vehicle.position.tolist()
        return mission.Sample(self.now, (x, y, z), signals)

    def disturbances(self) -> list[tuple[float, str]]:
        return list(self._happened)

    def scenery(self) -> Mapping[str, Any]:
        places = {sample.name.replace("_", " "): [sample.place] for sample in self.samples}
        return {"base": [(0.0, 0.0)], **places}

    # ------------------------------------------------------------ what happens

    def advance(self, until: float) -> list[Message]:
        """Simulate until something is published or switched, at most to the time `until` [s]."""
        while not self.messages:
            if self.now + STEP_S > until + 1e-9:
                self.now = until
                break
            self.now += STEP_S
            self._step()
            if self._managed.catch_up():
                break
        messages = self.messages
        self.messages = []
        return messages

    def _say(self, key: str, holds: bool = True) -> None:
        self.messages.append(sensed(self.now, **{key: holds}))

    def _measure_battery(self) -> None:
        self.messages.append(measured(self.now, battery_level=self.level))

    def _disturb(self, text: str) -> None:
        self._happened.append((self.now, text))

    def _place(self, lane: int) -> tuple[float, float]:
        x = self._rng.uniform(0.1, 0.95) * FIELD_M
        off = self._rng.uniform(-OFF_LANE_M, OFF_LANE_M)
        return x, (lane + 0.5) * LANE_M + off

    def want(self, place: tuple[float, float], *, is_reported: bool = False) -> None:
        """Add a sample; an operator who reports it knows its place."""
        name = f"sample_{len(self.samples) + 1}"
        self.samples.append(Sample(name, place, is_reported, is_found=is_reported))
        self._say(f"{name}_wanted")
        if is_reported:
            self._disturb(f"an operator reports {name}")
            self._say(f"{name}_found")

    def _step(self) -> None:
        before = self.vehicle.position
        self.vehicle.step()
        self._flown_m += dist(before, self.vehicle.position)
        self._drain()
        if self.now >= self._components_due - 1e-9:
            self._components_due += PERIOD_S
            self._act()
        if self.now >= self._battery_due - 1e-9:
            self._battery_due += BATTERY_PERIOD_S
            self._measure_battery()

    def _drain(self) -> None:
        """Charge and discharge the battery for one step; record each level that it falls below."""
        before = self.level
        active_w = sum(watts for name, watts in POWERS_W.items() if name in self.active)
        watts = self.vehicle.rotor_w + AVIONICS_W + active_w
        charged = STEP_S / CHARGE_S if self._is_charging else 0.0
        level = before + charged - watts * STEP_S / self._settings.capacity_j
        self.level = max(0.0, min(1.0, level))
        self._least = min(self._least, self.level)
        self._recharges += before < FULL <= self.level
        for least, what in LEVELS.items():
            if before >= least > self.level:
                self._disturb(f"the battery fell below {least:g}, which {what}")
        if before > self.level == 0.0:
            self.vehicle.has_power = False
            self._disturb("the battery is empty")
            self._say("battery_empty")

    def _act(self) -> None:
        """Let the active components act; then choose the next target if there is none."""
        if self.now >= self._added_s:
            self._added_s = inf
            self.want(self._added, is_reported=True)
        for component, act in self._acts.items():
            if component in self.active:
                act()
        waiting = [sample for sample in self.samples if sample.is_found and not sample.is_analysed]
        if self.target is None and waiting:
            here = self.vehicle.position[:2]
            self.target = min(
                waiting, key=lambda sample: (not sample.is_reported, dist(sample.place, here))
            )
            self._say(f"{self.target.name}_target")

    # ------------------------------------------------------------ the components

    def check(self, component: str, parameters: Parameters, /) -> None:
        """Raise MissionError unless the component exists; none has parameters."""
        if component not in self._acts or parameters:
            known = f"there are {', '.join(self._acts)}, which have no parameters"
            raise MissionError(
                f"{component!r} with parameters {dict(parameters)} is unknown; {known}"
            )

    def activate(self, component: str, /) -> None:
        super().activate(component)
        if component == "gripper":
            self.vehicle.is_folding = False
            self._is_folded = False
            self._say("gripper_folded", False)
        elif component == "landing_planner":
            self.vehicle.land()

    def deactivate(self, component: str, /) -> None:
        super().deactivate(component)
        if component == "search_planner":
            x, y, _ = self.vehicle.position.tolist()
            self._path.insert(0, (x, y))  # to go on where it stopped
        elif component == "gripper":
            self.let_go()
        elif component == "return_planner":
            self._is_charging = False
        if component in MOVERS and not self.active & MOVERS:
            self.vehicle.hold()

    def let_go(self) -> None:
        """Drop the held sample, if any; it lies where it falls."""
        if self.held is not None:
            x, y, _ = self.vehicle.position.tolist()
            self.held.place = (x, y)
            self.held = None
            self.vehicle.carry(0.0)

    def _search(self) -> None:
        """Fly along all lanes, to and fro."""
        if not self._path:
            self._path = [
                (x, (lane + 0.5) * LANE_M)
                for lane in range(max(PATCHES) + 1)
                for x in ((FIELD_M, 0.0) if lane % 2 else (0.0, FIELD_M))
            ]
        x, y = self._path[0]
        self.vehicle.go_to((x, y, ON_GROUND_M + CRUISE_M))
        if dist((x, y), self.vehicle.position[:2]) < 1.0:
            self._path.pop(0)

    def _see_samples(self) -> None:
        """Find the samples in the camera's circle below, whose radius grows with altitude."""
        radius = self.vehicle.altitude * tan(HALF_VIEW_RAD)
        for sample in self.samples:
            is_in_view = dist(sample.place, self.vehicle.position[:2]) <= radius
            if is_in_view and not sample.is_found:
                sample.is_found = True
                self._say(f"{sample.name}_found")

    def _over_target(self, height: float) -> tuple[float, float, float]:
        """Return the place where the legs are at a height above the target [m], world frame."""
        assert self.target is not None
        return (*self.target.place, ON_GROUND_M + height)

    def _approach(self, height: float) -> None:
        if self.target is not None:
            self.vehicle.go_to(self._over_target(height))

    def _is_over_target(self, height: float, within: float) -> bool:
        return self.target is not None and self.vehicle.is_near(self._over_target(height), within)

    def _has_worked(self, is_at_work: bool, needed_s: float) -> bool:
        """Count a period of work at the target, or a break; tell whether it was enough."""
        self._worked_s = self._worked_s + PERIOD_S if is_at_work else 0.0
        return self._worked_s >= needed_s

    def _grip(self) -> None:
        """Grip the target when it is within reach.

        A worn gripper jams while it lifts, and drops the sample.
        """
        if self.held is not None and self.now >= self._jams_s:
            self.is_jammed = True
            self.let_go()
            self._disturb("the gripper jammed")
            self.messages.append(failed(self.now, "gripper"))
        if self.is_jammed or self.held is not None:
            return
        is_unfolded = self.vehicle.arm_rad > UNFOLDED_RAD
        if self._has_worked(self._is_over_target(GRIP_M, 0.15) and is_unfolded, GRIP_S):
            self.held = self.target
            self._pick_ups += 1
            self.vehicle.carry(SAMPLE_KG)
            if 0 < self._settings.gripper_worn_s <= self.now:
                self._jams_s = self.now + self._rng.uniform(0.1, JAM_DELAY_S)

    def _analyse(self) -> None:
        """Analyse the held sample once it is lifted."""
        is_lifted = self.vehicle.altitude > LIFT_M - 0.5
        if self.held is not None and self._has_worked(is_lifted, ANALYSIS_S):
            self._record_analysis(1.0)
            self.let_go()

    def _look(self) -> None:
        """Analyse the target from above; an unfolded gripper would block the view."""
        is_folded = self.vehicle.arm_rad < FOLDED_RAD
        if self._has_worked(self._is_over_target(LOOK_M, 0.4) and is_folded, LOOK_S):
            self._record_analysis(LOOK_QUALITY)

    def _record_analysis(self, quality: float) -> None:
        if self.target is not None:
            self.target.is_analysed = True
            self._qualities.append(quality)
            self._say(f"{self.target.name}_analysed")
            self._say(f"{self.target.name}_target", False)
            self.target = None

    def _return(self) -> None:
        """Land at the base and charge; while the battery is full, report this every period.

        So an action that begins with a full battery receives the report too. The level is published
        with it, so that nothing is decided by an older measurement.
        """
        if not (self.vehicle.is_landed and hypot(*self.vehicle.position[:2]) < 1.0):
            self.vehicle.land((0.0, 0.0))
            return
        self._is_charging = True
        if self.level >= FULL:
            self._measure_battery()
            self._say("battery_recharged")

    def _fold(self) -> None:
        """Fold the gripper once the vehicle stands."""
        if self.vehicle.is_landed:
            self.vehicle.is_folding = True
            if self.vehicle.arm_rad < FOLDED_RAD / 2 and not self._is_folded:
                self._is_folded = True
                self._say("gripper_folded")


class _SkyKind(WorldKind):
    def settings(self) -> tuple[Setting, ...]:
        return declared(Settings)

    def open(self, values: Mapping[str, Any], rng: Generator) -> UavWorld:
        return UavWorld(Settings.read(values), rng)

    def verdict(
        self, percepts: Percepts, results: Mapping[str, float | None], kb: KnowledgeBase
    ) -> Verdict:
        """Judge by the goal: all wanted samples are analysed, and the battery never ran empty."""
        wanted = results.get("wanted_samples") or 0
        if is_all_analysed(percepts) and not percepts.holds("battery_empty"):
            return Verdict("analysed_all", f"all {wanted:g} samples are analysed")
        cause = "the battery ran empty" if percepts.holds("battery_empty") else "time ran out"
        done = f"{analysed(percepts)} of {wanted:g} samples were analysed"
        return Verdict("aborted", f"{cause}, {done}")


SKY = _SkyKind()
