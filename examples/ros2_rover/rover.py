"""A rover in ROS 2: what it is made of, what it can do, and the tree that decides what it does."""

from itertools import cycle

from py_trees.behaviour import Behaviour

from kb import KnowledgeBase, Model
from missions.engine.mission import Percepts
from missions.wires.actions import RosAction
from rosa_bt import first_feasible

NAVIGATE = "nav2_msgs/action/NavigateToPose"


def model() -> Model:
    """Return the model; its lifecycle components are the nodes of the launch file, by name."""
    rover = Model("rover")
    battery = rover.quality_attribute("battery_level", max_age=5.0)
    light = rover.environmental_attribute("light")

    camera = rover.component("camera", kind="lifecycle", always_improve=True)
    camera.configuration(
        "by_day", {"exposure": 0.01, "gain": 1.0}, priority=1, constraints=[light >= 0.5]
    )
    camera.configuration("by_night", {"exposure": 0.05, "gain": 8.0}, priority=2)
    lidar = rover.component("lidar", kind="lifecycle")
    navigator = rover.component("navigator", kind="lifecycle")

    see = rover.function("see", always_improve=True)
    see.design("with_camera", [camera], priority=1)
    see.design("with_lidar", [lidar], priority=2)
    drive = rover.function("drive")
    drive.design("by_navigator", [navigator], priority=1)

    rover.action("patrol", requires=[see, drive], constraints=[battery >= 0.3])
    rover.action("return_to_dock", requires=[drive])
    return rover


def pose(x: float, y: float) -> dict[str, object]:
    """Return a goal of Nav2: a place on the map [m]."""
    place = {"position": {"x": x, "y": y}, "orientation": {"w": 1.0}}
    return {"pose": {"header": {"frame_id": "map"}, "pose": place}}


def tree(kb: KnowledgeBase, percepts: Percepts) -> Behaviour:
    """Return the tree: patrol from place to place while that is feasible, or else dock."""
    places = cycle([pose(4.0, 0.0), pose(4.0, 3.0), pose(0.0, 3.0)])
    server = "/navigate_to_pose"
    patrol = RosAction("patrol", kb, "patrol", server, NAVIGATE, lambda: next(places), wait=True)
    dock = RosAction("dock", kb, "return_to_dock", server, NAVIGATE, pose(0.0, 0.0), wait=True)
    return first_feasible("what to do", [patrol, dock])
