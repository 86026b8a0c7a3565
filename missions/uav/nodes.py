"""The components of the vehicle; each acts only while it is active, ten times a second.

What moves the vehicle leaves it hovering where it is when it is stopped: that is the safe state between two actions.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from math import dist, hypot, inf, tan
from typing import ClassVar, Final

from numpy.random import Generator

from kb.elements import Parameters
from missions.engine.mission import MissionError
from missions.uav.field import Field, Sample
from missions.uav.settings import Settings
from missions.uav.vehicle import ON_GROUND_M, Quadrotor

PERIOD_S: Final = 0.1
GRIP_M: Final = 0.12  # height of the legs from which the gripper reaches the ground
LIFT_M: Final = 2.5  # height at which a held sample is analysed
LOOK_M: Final = 2.0  # height from which the infra-red camera looks
FOLDED_RAD: Final = 0.15  # out of the view; it has folded at half of that, so that a gust does not bring it back
FULL: Final = 0.99


@dataclass
class Robot:
    """What the components share.

    Attributes:
        settings: the constants.
        vehicle: what flies.
        field: where the samples are.
        rng: all chance.
        tell: publishes: text of the message, key, value.
        disturb: notes what truly happened.
        now: the time [s].
        level: charge of the battery, 0 to 1.
        held: the sample that is in the gripper.
        jams_s: when the gripper jams [s].
        is_jammed: whether it has.
        is_charging: whether the vehicle stands at its charger.
        pick_ups: how many samples were lifted.
        recharges: how often the battery was charged until it was full.
        qualities: worth of each analysis that was done.
    """

    settings: Settings
    vehicle: Quadrotor
    field: Field
    rng: Generator
    tell: Callable[[str, str, str], None]
    disturb: Callable[[str], None]
    now: float = 0.0
    level: float = 1.0
    held: Sample | None = None
    jams_s: float = inf
    is_jammed: bool = False
    is_charging: bool = False
    pick_ups: int = 0
    recharges: int = 0
    qualities: list[float] = dataclasses.field(default_factory=list)

    def over(self, sample: Sample, height: float) -> tuple[float, float, float]:
        """Return the place with the legs that high above a sample [m], world frame."""
        return (*sample.place, ON_GROUND_M + height)

    def let_go(self) -> None:
        """Drop what is held, if anything; from then on it lies where it fell."""
        if self.held is not None:
            x, y, _ = self.vehicle.position
            self.held.place, self.held = (x, y), None
            self.vehicle.carry(0.0)

    def analysed(self, quality: float) -> None:
        """Take down that the target is analysed."""
        target = self.field.target
        if target is not None:
            target.quality, self.field.target = quality, None
            self.qualities.append(quality)
            self.tell("mission status", f"{target.name}_analysed", "true")
            self.tell("mission status", f"{target.name}_target", "false")


class Node:
    """A component that can be active or inactive.

    Args:
        robot: what it shares with the others.

    Attributes:
        name: its identity.
        moves: whether it tells the vehicle where to go.
        is_active: whether it acts.
    """

    name: ClassVar[str]
    moves: ClassVar[bool] = False

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.is_active = False

    def begin(self) -> None:
        """Begin; called when it has become active."""

    def end(self) -> None:
        """End; called when it has become inactive."""

    def update(self) -> None:
        """Act; called while it is active."""

    @property
    def watts(self) -> float:
        """Its power while it is active [W]."""
        return 0.0


class SearchPlanner(Node):
    """Flies along the lanes, and goes on where it was stopped."""

    name, moves = "search_planner", True

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self._ahead = robot.field.path

    def end(self) -> None:
        """Remember where to go on."""
        x, y, _ = self.robot.vehicle.position
        self._ahead = [(x, y), *self._ahead]

    def update(self) -> None:
        """Fly to the next corner; after the last one from the beginning."""
        robot = self.robot
        x, y = self._ahead[0]
        robot.vehicle.go_to((x, y, ON_GROUND_M + robot.settings.cruise_m))
        if dist((x, y), robot.vehicle.position[:2]) < 1.0:
            self._ahead = self._ahead[1:] or robot.field.path


class SampleCamera(Node):
    """Sees the samples below, in a circle as wide as the vehicle is high."""

    name = "sample_camera"

    def update(self) -> None:
        robot, vehicle = self.robot, self.robot.vehicle
        x, y, _ = vehicle.position
        for one in robot.field.seen((x, y), vehicle.altitude * tan(robot.settings.half_view_rad)):
            one.is_found = True
            robot.tell("mission status", f"{one.name}_found", "true")


class PickUpPlanner(Node):
    """Flies down to the target, and up again when it is held."""

    name, moves = "pick_up_planner", True

    def update(self) -> None:
        robot, target = self.robot, self.robot.field.target
        if target is not None:
            robot.vehicle.go_to(robot.over(target, GRIP_M if robot.held is None else LIFT_M))


class Gripper(Node):
    """Unfolds, and grips the target when it is within reach; a worn one jams while it lifts, and drops the sample."""

    name = "gripper"

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self._closing_s = 0.0

    def begin(self) -> None:
        self._closing_s = 0.0
        self.robot.vehicle.fold(False)
        self.robot.tell("mission status", "gripper_folded", "false")

    def end(self) -> None:
        self.robot.let_go()

    def update(self) -> None:
        robot, target = self.robot, self.robot.field.target
        if robot.held is not None and robot.now >= robot.jams_s:
            robot.is_jammed, robot.jams_s = True, inf
            robot.let_go()
            robot.disturb("the gripper jammed")
            robot.tell("component status", "gripper", "FALSE")
        if robot.is_jammed or robot.held is not None or target is None:
            return
        reached = robot.vehicle.is_near(robot.over(target, GRIP_M), 0.15) and robot.vehicle.arm_rad > 1.2
        self._closing_s = self._closing_s + PERIOD_S if reached else 0.0
        if self._closing_s >= robot.settings.grip_s:
            self._close(target)

    def _close(self, target: Sample) -> None:
        robot, settings = self.robot, self.robot.settings
        robot.held = target
        robot.pick_ups += 1
        robot.vehicle.carry(settings.sample_kg)
        if 0 < settings.gripper_worn_s <= robot.now:
            robot.jams_s = robot.now + float(robot.rng.uniform(0.1, settings.jam_delay_s))

    @property
    def watts(self) -> float:
        return self.robot.settings.pick_up_w / 2


class Analyser(Node):
    """Analyses what is held, once it is lifted."""

    name = "analyser"

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self._worked_s = 0.0

    def update(self) -> None:
        robot = self.robot
        is_lifted = robot.held is not None and robot.vehicle.altitude > LIFT_M - 0.5
        self._worked_s = self._worked_s + PERIOD_S if is_lifted else 0.0
        if self._worked_s >= robot.settings.analysis_s:
            robot.analysed(1.0)
            robot.let_go()

    @property
    def watts(self) -> float:
        return self.robot.settings.pick_up_w / 2


class HoverPlanner(Node):
    """Hovers above the target."""

    name, moves = "hover_planner", True

    def update(self) -> None:
        robot, target = self.robot, self.robot.field.target
        if target is not None:
            robot.vehicle.go_to(robot.over(target, LOOK_M))


class InfraredCamera(Node):
    """Analyses the target from above; an unfolded gripper would be in its view."""

    name = "infrared_camera"

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self._worked_s = 0.0

    def update(self) -> None:
        robot, target = self.robot, self.robot.field.target
        sees = target is not None and robot.vehicle.is_near(robot.over(target, LOOK_M), 0.4)
        sees = sees and robot.vehicle.arm_rad < FOLDED_RAD
        self._worked_s = self._worked_s + PERIOD_S if sees else 0.0
        if self._worked_s >= robot.settings.infrared_s:
            robot.analysed(robot.settings.infrared_quality)

    @property
    def watts(self) -> float:
        return self.robot.settings.infrared_w


class ReturnPlanner(Node):
    """Lands at the base, which is the origin, and charges there; tells that it is full as long as it stays.

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
            robot.tell("QA measurement", "battery_level", repr(robot.level))
            robot.tell("mission status", "battery_recharged", "true")


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
                self.robot.tell("mission status", "gripper_folded", "true")


class Nodes(dict[str, Node]):
    """All of them by name; a change is carried out at once, see `missions.engine.components`."""

    def __init__(self, robot: Robot) -> None:
        kinds = (SearchPlanner, SampleCamera, PickUpPlanner, Gripper, Analyser, HoverPlanner, InfraredCamera)
        nodes = [kind(robot) for kind in (*kinds, ReturnPlanner, LandingPlanner, FoldingServo)]
        super().__init__((one.name, one) for one in nodes)
        self._hold = robot.vehicle.hold

    @property
    def acting(self) -> list[Node]:
        return [one for one in self.values() if one.is_active]

    def check(self, component: str, parameters: Parameters, /) -> None:
        """Raise MissionError unless there is that component; none has parameters."""
        if component not in self:
            near = get_close_matches(component, self, n=3) or list(self)
            raise MissionError(f"there is no component {component!r}; the nearest are {', '.join(near)}")
        if parameters:
            raise MissionError(f"{component} has no parameters; {', '.join(parameters)} cannot be set")

    def activate(self, component: str, /) -> None:
        node = self[component]
        if not node.is_active:
            node.is_active = True
            node.begin()

    def deactivate(self, component: str, /) -> None:
        node = self[component]
        if node.is_active:
            node.is_active = False
            node.end()
            if node.moves and not any(other.moves for other in self.acting):
                self._hold()

    def set_parameters(self, component: str, parameters: Parameters, /) -> None:
        self.check(component, parameters)

    def is_active(self, component: str, /) -> bool:
        self.check(component, {})
        return self[component].is_active

    def parameters(self, component: str, /) -> Parameters:
        self.check(component, {})
        return {}
