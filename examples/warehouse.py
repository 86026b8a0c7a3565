"""A mobile manipulator fetches orders in a warehouse.

In a hundred lines of world lidar, arm and battery fail.

Run it with its adaptations, `rosa run warehouse:MISSION` in this folder, or as it is for a table of
managers.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from numpy.random import Generator
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Sequence

from kb import KnowledgeBase, Model
from missions.baselines import open_run
from missions.engine.components import NamedComponents, SimulatedComponents
from missions.engine.mission import (
    Condition,
    Message,
    Mission,
    Percepts,
    Sample,
    Setting,
    Verdict,
    World,
    WorldKind,
)
from missions.engine.percepts import failed, measured, sensed
from missions.engine.settings import Constants, declared, setting
from rosa_bt import RosaAction, do_until_unfeasible, feasible_then_act
from rosa_bt.decorators import UntilSuccess

# ---------------------------------------------------------------- what it is made of and can do


def build_model() -> Model:
    """Return the model: two ways to localise, two arms, a drive with two configurations."""
    model = Model("warehouse_robot")
    battery = model.quality_attribute("battery", low=0.0, high=1.0)
    people = model.environmental_attribute("people")
    light = model.environmental_attribute("light")

    lidar = model.component("lidar", kind="lifecycle")
    camera = model.component("camera", kind="lifecycle", always_improve=True)
    camera.configuration("sharp", {"exposure_s": 0.01}, priority=1, constraints=[light >= 0.4])
    camera.configuration("bright", {"exposure_s": 0.1}, priority=2)
    drive = model.component("drive", kind="lifecycle", always_improve=True)
    drive.configuration("brisk", {"speed_m_s": 1.5}, priority=1, constraints=[people <= 1])
    drive.configuration("careful", {"speed_m_s": 0.5}, priority=2)
    left = model.component("left_arm", kind="lifecycle")
    right = model.component("right_arm", kind="lifecycle")
    gripper = model.component("gripper", kind="lifecycle")

    localise = model.function("localise", always_improve=True)
    localise.design("by_lidar", [lidar], priority=1)
    localise.design("by_camera", [camera], priority=2)
    grasp = model.function("grasp", always_improve=True)
    grasp.design("with_both_arms", [left, right, gripper], priority=1)
    grasp.design("with_left_arm", [left, gripper], priority=2)
    grasp.design("with_right_arm", [right], priority=3)  # which has a suction cup
    move = model.function("move")
    look = model.function("look")
    draw_power = model.function("draw_power")
    move.design("by_drive", [drive])
    look.design("with_camera", [camera])
    draw_power.design("at_dock", [model.component("dock", kind="lifecycle")])

    model.action("navigate", requires=[localise, move], constraints=[battery >= 0.25])
    model.action("pick", requires=[grasp], constraints=[battery >= 0.25])
    model.action("inspect", requires=[look], constraints=[battery >= 0.25])
    model.action("charge", requires=[draw_power])
    return model


# ---------------------------------------------------------------- what it does


class Do(RosaAction):
    """Does its part of an order, until the world says the number of that order."""

    def __init__(self, action: str, done: str, kb: KnowledgeBase, percepts: Percepts) -> None:
        super().__init__(action, kb, action)
        self.done = done
        self.percepts = percepts
        self.order = 0.0

    def initialise(self) -> None:
        """Note which order it is; called each time the action starts."""
        self.order = self.percepts.value("order") or 1.0

    def update(self) -> Status:
        """Look whether this part of it is done."""
        return (
            Status.SUCCESS
            if (self.percepts.value(self.done) or 0.0) >= self.order
            else Status.RUNNING
        )


class Charge(Do):
    """Charges, until that is said once more."""

    def initialise(self) -> None:
        """Count from here."""
        self.order = self.percepts.count("charged") + 1.0

    def update(self) -> Status:
        """Look whether it is charged."""
        return Status.SUCCESS if self.percepts.count("charged") >= self.order else Status.RUNNING


def build_tree(kb: KnowledgeBase, percepts: Percepts) -> Behaviour:
    """Return the tree: order after order, and to the dock when the battery says so."""
    parts = {"navigate": "arrived", "pick": "picked", "inspect": "inspected"}
    order = [feasible_then_act(Do(action, done, kb, percepts)) for action, done in parts.items()]
    one = do_until_unfeasible(
        Sequence("order", memory=True, children=order),
        Charge("charge", "charged", kb, percepts),
        memory=True,
    )
    done = Condition("all fetched?", lambda: percepts.holds("all_fetched"))
    return UntilSuccess(
        "until all are fetched", Sequence("orders", memory=True, children=[one, done])
    )


# ---------------------------------------------------------------- where it happens


@dataclass(frozen=True, slots=True)
class Settings(Constants):
    """What can be set; all figures are our own choice."""

    orders: int = setting(6, "-", "how many orders there are", "own choice", low=1)
    lidar_fails_s: float = setting(5.0, "s", "when the lidar fails", "own choice")
    arm_fails_s: float = setting(60.0, "s", "when the left arm fails", "own choice")
    dark_s: float = setting(90.0, "s", "when the light goes out", "own choice")


class Warehouse(World):
    """Shelves along an aisle, with the dock at its beginning."""

    def __init__(self, settings: Settings, rng: Generator) -> None:
        self.settings = settings
        self.time = 0.0
        self.due = 0.0
        self.nodes = NamedComponents()
        self.commanded = SimulatedComponents(lambda: self.time, self.nodes, {"activate": 0.2})
        self.shelves_m = rng.uniform(10.0, 30.0, settings.orders)
        self.crowd_s = float(rng.uniform(40.0, 80.0))  # when people come, for half a minute
        self.position_m = 0.0
        self.battery = 1.0
        self.order = 1
        self.progress = 0.0
        self.part = "arrived"
        self.rest = "picked"
        self.news: dict[str, object] = {"order": 1}
        self.happened: list[tuple[float, str]] = []

    @property
    def now(self) -> float:
        """The time [s]."""
        return self.time

    @property
    def managed(self) -> SimulatedComponents:
        """Its nodes; starting one takes a fifth of a second."""
        return self.commanded

    def advance(self, until: float) -> list[Message]:
        """Let time pass to the next message, command or the end."""
        before = self.time
        self.time = max(before, min(until, self.due, self.commanded.next_event()))
        self._work(self.time - before)
        self.commanded.catch_up()
        if self.time < self.due:
            return []
        self.due += 0.5
        mishaps = [failed(self.time, name) for name in self._mishaps()]
        light = 1.0 if self.time < self.settings.dark_s else 0.1
        said = self.news
        self.news = {}
        measurements = measured(self.time, battery=self.battery, light=light, people=self.people)
        return [measurements, *mishaps, *([sensed(self.time, **said)] if said else [])]

    @property
    def people(self) -> float:
        """How many people are about."""
        return 4.0 if self.crowd_s <= self.time < self.crowd_s + 30.0 else 0.0

    def _mishaps(self) -> list[str]:
        planned = {"lidar": self.settings.lidar_fails_s, "left_arm": self.settings.arm_fails_s}
        known = [text for _, text in self.happened]
        new = [
            name
            for name, time in planned.items()
            if self.time >= time and f"{name} fails" not in known
        ]
        self.happened += [(self.time, f"{name} fails") for name in new]
        return new

    def _work(self, passed: float) -> None:
        """Do what the active components do; drawing power moves the robot to the dock first."""
        active = self.nodes.active
        broken = {text.split()[0] for _, text in self.happened}
        self.battery = max(0.0, self.battery - (0.008 if active else 0.001) * passed)
        speed = {"speed_m_s": 0.0, **self.nodes.parameters("drive")}["speed_m_s"]
        assert isinstance(speed, float)
        is_dark = (
            self.time >= self.settings.dark_s
            and self.nodes.parameters("camera").get("exposure_s") != 0.1
        )
        if self.battery == 0.0:
            return
        if "dock" in active:
            self._charge(passed)
        elif (
            self.part == "arrived" and "drive" in active and active & ({"lidar", "camera"} - broken)
        ):
            self._drive(
                speed * passed if speed < 1.0 or not self.people else 0.0
            )  # its bumper stops it in a crowd
        elif self.part == "picked" and (arms := active & ({"left_arm", "right_arm"} - broken)):
            self._progress(passed * len(arms) / 8.0)
        elif self.part == "inspected" and "camera" in active and not is_dark:
            self._progress(passed / 3.0)

    def _charge(self, passed: float) -> None:
        if self.part != "arrived":  # it has to go to the shelf again, for what is left there
            self.rest = self.part
            self.part = "arrived"
            self.news["arrived"] = 0
        self.position_m = max(0.0, self.position_m - passed)
        if self.position_m == 0.0:
            self.battery = min(1.0, self.battery + 0.05 * passed)
            self.news |= {"charged": True} if self.battery == 1.0 else {}

    def _drive(self, metres: float) -> None:
        goal_m = float(self.shelves_m[self.order - 1])
        way_m = goal_m - self.position_m
        self.position_m += max(-metres, min(metres, way_m))
        if abs(way_m) <= metres:
            self._reached(self.rest)
            self.rest = "picked"

    def _progress(self, part: float) -> None:
        self.progress += part
        if self.progress >= 1.0:
            self._reached({"picked": "inspected", "inspected": "arrived"}[self.part])

    def _reached(self, following: str) -> None:
        self.news[self.part] = self.order
        self.part = following
        self.progress = 0.0
        if following == "arrived":
            self.order += 1
            is_last = self.order > self.settings.orders
            self.order -= is_last
            self.news |= {"all_fetched": True} if is_last else {"order": self.order}

    def results(self) -> Mapping[str, float | None]:
        """Return the figures of a run."""
        return {"fetched": float(self.order - 1), "battery_left": self.battery}

    def sample(self) -> Sample:
        """Return what the picture shows."""
        return Sample(self.time, (self.position_m, 0.0, 0.0), {"battery [-]": self.battery})

    def disturbances(self) -> list[tuple[float, str]]:
        """Return what truly happened."""
        return self.happened


class WarehouseKind(WorldKind):
    """Opens a warehouse, and judges how the mission has ended."""

    def settings(self) -> tuple[Setting, ...]:
        """List what can be set."""
        return declared(Settings)

    def open(self, values: Mapping[str, object], rng: Generator) -> Warehouse:
        """Open it with these settings."""
        return Warehouse(Settings.read(values), rng)

    def verdict(self, percepts: Percepts, results: Mapping[str, Any], kb: KnowledgeBase) -> Verdict:
        """Say how it has ended."""
        if percepts.holds("all_fetched"):
            return Verdict("all_fetched", "every order is fetched and inspected")
        return Verdict("aborted", f"time ran out at order {results['fetched'] + 1:.0f}")


MISSION = Mission(
    name="warehouse",
    summary="fetch orders with two arms; lidar and arm fail, people come, the light goes out, "
    "the battery drops",
    model=build_model,
    tree=build_tree,
    world=WarehouseKind(),
)

if __name__ == "__main__":
    for manager in ("ours", "fixed", "none"):
        run = open_run(MISSION, manager=manager)
        verdict = run.run()
        print(
            f"{manager}: {verdict.outcome} after {run.world.now:.0f} s, "
            f"{len(run.adaptations)} adaptations"
        )
        for one in run.adaptations if manager == "ours" else ():
            print(f"{one.at_s:7.1f} s  {one.kind}: {one.change}")
