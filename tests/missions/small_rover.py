"""A small robot for tests of the tests: its model, its tree, and streams that it hears."""

from py_trees.common import Status

from kb import Model
from missions.engine.percepts import failed, measured, recovered, sensed
from rosa_bt import RosaAction, do_until_unfeasible


def rover_model() -> Model:
    model = Model("rover")
    light = model.environmental_attribute("light")
    energy = model.quality_attribute("energy")
    camera = model.component("camera", kind="lifecycle", always_improve=True)
    camera.configuration("day", {"exposure_s": 0.01}, priority=1, constraints=[light >= 0.5])
    camera.configuration("night", {"exposure_s": 0.2}, priority=2)
    radar = model.component("radar", kind="lifecycle")
    look = model.function("look", always_improve=True)
    look.design("by_camera", [camera], priority=1)
    look.design("by_radar", [radar], priority=2)
    dock = model.component("dock", kind="lifecycle")
    draw = model.function("draw_power")
    draw.design("at_dock", [dock])
    model.action("explore", requires=[look], constraints=[energy >= 0.2])
    model.action("charge", requires=[draw])
    return model


class Sensing(RosaAction):
    """Works until the percepts hold what it is after."""

    def __init__(self, name, kb, percepts, until):
        super().__init__(name, kb, name)
        self.percepts = percepts
        self.until = until

    def update(self):
        return Status.SUCCESS if self.percepts.holds(self.until) else Status.RUNNING


def rover_tree(kb, percepts):
    explore = Sensing("explore", kb, percepts, "explored")
    charge = Sensing("charge", kb, percepts, "charged")
    return do_until_unfeasible(explore, charge, memory=True, name="mission")


ENERGY_DROP = [
    measured(0.5, light=0.9, energy=1.0),
    measured(10.0, light=0.3),
    failed(15.0, "camera"),
    recovered(18.0, "camera"),
    measured(20.0, energy=0.1),
    measured(30.0, energy=1.0),
    sensed(30.0, charged=True),
    sensed(40.0, explored=True),
]
