"""The field in which samples lie, and the components of the vehicle; each acts while it is active, 10 times a second.

What moves the vehicle leaves it hovering where it is when it is stopped: that is the safe state between two actions.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import dist, hypot, inf, tan
from typing import ClassVar, Final

from numpy.random import Generator

from kb.elements import Parameters
from missions.engine.components import NamedComponents
from missions.engine.mission import MissionError
from missions.uav.settings import PERIOD_S, Settings
from missions.uav.vehicle import ON_GROUND_M, Quadrotor

GRIP_M: Final = 0.12  # height of the legs from which the gripper reaches the ground
LIFT_M: Final = 2.5  # height at which a held sample is analysed
LOOK_M: Final = 2.0  # height from which the infra-red camera looks
FOLDED_RAD: Final = 0.15  # out of the view; it has folded at half of that, so that a gust does not bring it back
FULL: Final = 0.99
OFF_LANE_M: Final = 2.0  # how far from the middle of its lane a sample may lie


@dataclass(slots=True)
class Sample:
    """Something to be analysed."""

    name: str  # "sample_1" and so on
    place: tuple[float, float]  # (x, y) [m], world frame
    wanted_s: float = 0.0  # from when on it is wanted [s]
    is_reported: bool = False  # an operator reported it; it goes before those that were found
    is_found: bool = False  # it is known where it is
    quality: float | None = None  # worth of its analysis, up to 1; None before


class Robot:
    """What the components share: the vehicle, the field, and what is known and held.

    The field is lanes along the x axis; samples lie in two patches, and between them is a third of the lanes without
    any. `publish` takes the text of the message, key and value, `disturb` notes what truly happened.

    Attributes:
        now: [s].
        level: charge of the battery, 0 to 1.
        samples: all of them, those included that nobody wants yet.
        target: the one to be analysed next; None while none is waiting.
        held: by the gripper.
        jams_s: when the gripper jams [s].
        pick_ups: how many samples were lifted.
        recharges: how often the battery was charged until it was full.
        qualities: worth of each analysis that was done.
    """

    def __init__(
        self,
        settings: Settings,
        vehicle: Quadrotor,
        rng: Generator,
        publish: Callable[[str, str, str], None],
        disturb: Callable[[str], None],
    ) -> None:
        self.settings, self.vehicle, self.rng, self.publish, self.disturb = settings, vehicle, rng, publish, disturb
        self.now, self.level, self.jams_s = 0.0, 1.0, inf
        self.target: Sample | None = None
        self.held: Sample | None = None
        self.is_jammed = self.is_charging = False
        self.pick_ups = self.recharges = 0
        self.qualities: list[float] = []
        every, count = int(settings.lanes), int(settings.samples)
        lanes = [one for one in range(every) if not every // 3 <= one < every - every // 3]
        places = [self._place(lanes[number * len(lanes) // count]) for number in range(count)]
        self.samples = [Sample(f"sample_{number}", place) for number, place in enumerate(places, start=1)]
        added = Sample(f"sample_{count + 1}", self._place(lanes[0]), settings.added_s, is_reported=True)
        self.samples += [added] if settings.added_s > 0 else []

    def _lane_y(self, lane: int) -> float:
        return (lane + 0.5) * self.settings.lane_m

    def _place(self, lane: int) -> tuple[float, float]:
        x, off = self.rng.uniform(0.1, 0.95) * self.settings.field_x_m, self.rng.uniform(-OFF_LANE_M, OFF_LANE_M)
        return float(x), self._lane_y(lane) + float(off)

    @property
    def path(self) -> list[tuple[float, float]]:
        """Corners of the way along all lanes, to and fro: (x, y) [m], world frame."""
        ends = (0.0, self.settings.field_x_m)
        lanes = range(int(self.settings.lanes))
        return [(x, self._lane_y(lane)) for lane in lanes for x in (ends if lane % 2 == 0 else ends[::-1])]

    def aim(self) -> None:
        """Choose the next target if there is none: reported ones first, then the nearest."""
        if self.target is not None:
            return
        place = self.vehicle.position[:2]
        waiting = [one for one in self.samples if one.is_found and one.quality is None]
        if waiting:
            self.target = min(waiting, key=lambda one: (not one.is_reported, dist(one.place, place)))
            self.publish("mission status", f"{self.target.name}_target", "true")

    def over(self, sample: Sample, height: float) -> tuple[float, float, float]:
        """Return the place with the legs that high above a sample [m], world frame."""
        return (*sample.place, ON_GROUND_M + height)

    def let_go(self) -> None:
        """Drop what is held, if anything; from then on it lies where it fell."""
        if self.held is not None:
            self.held.place, self.held = self.vehicle.position[:2], None
            self.vehicle.carry(0.0)

    def analysed(self, quality: float) -> None:
        target = self.target
        if target is not None:
            target.quality, self.target = quality, None
            self.qualities.append(quality)
            self.publish("mission status", f"{target.name}_analysed", "true")
            self.publish("mission status", f"{target.name}_target", "false")


class Node:
    """A component that can be active or inactive; it `moves` if it steers the vehicle."""

    name: ClassVar[str]
    moves: ClassVar[bool] = False

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._worked_s = 0.0

    def worked_s(self, works: bool) -> float:
        """Return for how long it has worked without a break [s], this period included if it works in it."""
        self._worked_s = self._worked_s + PERIOD_S if works else 0.0
        return self._worked_s

    def begin(self) -> None:
        """Begin; called when it has become active."""

    def end(self) -> None:
        """End; called when it has become inactive."""

    def update(self) -> None:
        """Act; called while it is active."""


class SearchPlanner(Node):
    """Flies along the lanes, and goes on where it was stopped."""

    name, moves = "search_planner", True

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self._ahead = robot.path

    def end(self) -> None:
        x, y, _ = self.robot.vehicle.position
        self._ahead = [(x, y), *self._ahead]

    def update(self) -> None:
        robot = self.robot
        x, y = self._ahead[0]
        robot.vehicle.go_to((x, y, ON_GROUND_M + robot.settings.cruise_m))
        if dist((x, y), robot.vehicle.position[:2]) < 1.0:
            self._ahead = self._ahead[1:] or robot.path


class SampleCamera(Node):
    """Sees the samples below, in a circle as wide as the vehicle is high."""

    name = "sample_camera"

    def update(self) -> None:
        robot, vehicle = self.robot, self.robot.vehicle
        radius = vehicle.altitude * tan(robot.settings.half_view_rad)
        for one in robot.samples:
            if not (one.is_found or one.is_reported) and dist(one.place, vehicle.position[:2]) <= radius:
                one.is_found = True
                robot.publish("mission status", f"{one.name}_found", "true")


class PickUpPlanner(Node):
    """Flies down to the target, and up again when it is held."""

    name, moves = "pick_up_planner", True

    def update(self) -> None:
        robot, target = self.robot, self.robot.target
        if target is not None:
            robot.vehicle.go_to(robot.over(target, GRIP_M if robot.held is None else LIFT_M))


class Gripper(Node):
    """Unfolds, and grips the target when it is within reach; a worn one jams while it lifts, and drops the sample."""

    name = "gripper"

    def begin(self) -> None:
        self.worked_s(False)
        self.robot.vehicle.fold(False)
        self.robot.publish("mission status", "gripper_folded", "false")

    def end(self) -> None:
        self.robot.let_go()

    def update(self) -> None:
        robot, target = self.robot, self.robot.target
        if robot.held is not None and robot.now >= robot.jams_s:
            robot.is_jammed, robot.jams_s = True, inf
            robot.let_go()
            robot.disturb("the gripper jammed")
            robot.publish("component status", "gripper", "FALSE")
        if robot.is_jammed or robot.held is not None or target is None:
            return
        reached = robot.vehicle.is_near(robot.over(target, GRIP_M), 0.15) and robot.vehicle.arm_rad > 1.2
        if self.worked_s(reached) >= robot.settings.grip_s:
            self._close(target)

    def _close(self, target: Sample) -> None:
        robot, settings = self.robot, self.robot.settings
        robot.held = target
        robot.pick_ups += 1
        robot.vehicle.carry(settings.sample_kg)
        if 0 < settings.gripper_worn_s <= robot.now:
            robot.jams_s = robot.now + float(robot.rng.uniform(0.1, settings.jam_delay_s))


class Analyser(Node):
    """Analyses what is held, once it is lifted."""

    name = "analyser"

    def update(self) -> None:
        robot = self.robot
        is_lifted = robot.held is not None and robot.vehicle.altitude > LIFT_M - 0.5
        if self.worked_s(is_lifted) >= robot.settings.analysis_s:
            robot.analysed(1.0)
            robot.let_go()


class HoverPlanner(Node):
    """Hovers above the target."""

    name, moves = "hover_planner", True

    def update(self) -> None:
        robot, target = self.robot, self.robot.target
        if target is not None:
            robot.vehicle.go_to(robot.over(target, LOOK_M))


class InfraredCamera(Node):
    """Analyses the target from above; an unfolded gripper would be in its view."""

    name = "infrared_camera"

    def update(self) -> None:
        robot, target = self.robot, self.robot.target
        sees = target is not None and robot.vehicle.is_near(robot.over(target, LOOK_M), 0.4)
        if self.worked_s(sees and robot.vehicle.arm_rad < FOLDED_RAD) >= robot.settings.infrared_s:
            robot.analysed(robot.settings.infrared_quality)


class ReturnPlanner(Node):
    """Lands at the base, which is the origin, and charges there; reports that it is full as long as it stays.

    Whoever begins to listen when the battery is full already hears it, too; and what else depends on the battery is
    not decided by a measurement of before.
    """

    name, moves = "return_planner", True

    def begin(self) -> None:
        self._is_full = False

    def end(self) -> None:
        self.robot.is_charging = False

    def update(self) -> None:
        robot = self.robot
        x, y, _ = robot.vehicle.position
        if not (robot.vehicle.is_landed and hypot(x, y) < 1.0):
            robot.vehicle.land((0.0, 0.0))
            return
        robot.is_charging = True
        if robot.level >= FULL:
            robot.recharges += not self._is_full
            self._is_full = True
            robot.publish("QA measurement", "battery_level", repr(robot.level))
            robot.publish("mission status", "battery_recharged", "true")


class LandingPlanner(Node):
    """Lands right below."""

    name, moves = "landing_planner", True

    def begin(self) -> None:
        self.robot.vehicle.land()


class FoldingServo(Node):
    """Folds the gripper once the vehicle stands."""

    name = "folding_servo"

    def begin(self) -> None:
        self._is_told = False

    def update(self) -> None:
        vehicle = self.robot.vehicle
        if vehicle.is_landed:
            vehicle.fold(True)
            if vehicle.arm_rad < FOLDED_RAD / 2 and not self._is_told:
                self._is_told = True
                self.robot.publish("mission status", "gripper_folded", "true")


class Nodes(NamedComponents):
    """All of them; a change is carried out at once, see `missions.engine.components`."""

    def __init__(self, robot: Robot) -> None:
        super().__init__()
        kinds = (SearchPlanner, SampleCamera, PickUpPlanner, Gripper, Analyser, HoverPlanner, InfraredCamera)
        self._nodes = {one.name: one(robot) for one in (*kinds, ReturnPlanner, LandingPlanner, FoldingServo)}
        self._hold, half_w = robot.vehicle.hold, robot.settings.pick_up_w / 2
        self._powers_w = {"gripper": half_w, "analyser": half_w, "infrared_camera": robot.settings.infrared_w}
        self.acting: tuple[Node, ...] = ()
        self.watts = 0.0  # of those that act

    def _note(self) -> None:
        self.acting = tuple(one for name, one in self._nodes.items() if name in self.active)
        self.watts = sum(self._powers_w.get(one.name, 0.0) for one in self.acting)

    def check(self, component: str, parameters: Parameters, /) -> None:
        """Raise MissionError unless there is that component; none has parameters."""
        if component not in self._nodes or parameters:
            known = f"there are {', '.join(self._nodes)}, which have no parameters"
            raise MissionError(f"{component} with {dict(parameters)} cannot be; {known}")

    def activate(self, component: str, /) -> None:
        if component not in self.active:
            super().activate(component)
            self._note()
            self._nodes[component].begin()

    def deactivate(self, component: str, /) -> None:
        if component in self.active:
            super().deactivate(component)
            self._note()
            self._nodes[component].end()
            if self._nodes[component].moves and not any(other.moves for other in self.acting):
                self._hold()
