"""A rover in ROS 2: what it is made of, what it can do, and the tree that decides what it does."""

from py_trees.behaviour import Behaviour
from py_trees.behaviours import Running

from kb import KnowledgeBase, Model
from missions.engine.mission import Percepts
from rosa_bt import ForAction, first_feasible


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

    see = rover.function("see")
    see.design("with_camera", [camera], priority=1)
    see.design("with_lidar", [lidar], priority=2)
    drive = rover.function("drive")
    drive.design("by_navigator", [navigator], priority=1)

    rover.action("patrol", requires=[see, drive], constraints=[battery >= 0.3])
    rover.action("return_to_dock", requires=[drive])
    return rover


def tree(kb: KnowledgeBase, percepts: Percepts) -> Behaviour:
    """Return the tree: patrol as long as that can be done, or else return to the dock."""
    names = ("patrol", "return_to_dock")
    return first_feasible(
        "what to do", [ForAction(name, kb, name, Running(name)) for name in names]
    )
