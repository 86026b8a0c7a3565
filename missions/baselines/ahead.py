"""Ours, looking ahead: it recharges when that is worth most, and searches as high as is worth most.

It knows what is published, the model, the deadline, where it began, where the station is and how its own nodes move it;
nothing of the water, the pipeline or the battery but what it is told.
"""

from functools import partial
from math import hypot, pi, tan

from py_trees.behaviour import Behaviour

from kb import ConfigurationManager, Model
from missions.baselines.manager import Robot
from missions.baselines.rosa import OwnTree
from missions.engine.mission import Message
from missions.suave.tree import InspectPipeline
from rosa_bt import Errand, Gain, Lookahead, WhatNext, Worth, WorthPlanner

FOLLOWING_M_S = 0.27
"""Metres inspected in a second: half a metre at each tick of the follower, and more where points are closer."""
TRANSIT_SHARE = 0.85
"""Mean speed of a drive to the station, as a share of the speed limit."""
DRAIN_1_S = -1 / 200
"""How fast the battery is said to drain, until enough is known of how it does."""
CLIMBING_S = 3.0
"""For how long the spiral stands still when its altitude changes."""
SETTLING_S = 10.0
"""From the end of a drive back until the follower counts again."""


class AheadManager(OwnTree):
    """Ticks the tree of the mission below a lookahead, which also decides how to be configured."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self._manager = ConfigurationManager(self.kb, robot, planner=WorthPlanner(self._lookahead))

    def model(self) -> Model:
        model = super().model()
        model.attributes["water_visibility"].forecast("periodic")
        if "battery_level" in model.attributes:
            model.attributes["battery_level"].changes(DRAIN_1_S, learns=True)
        return model

    def tree(self) -> Behaviour:
        mission = super().tree()
        self._lookahead = Lookahead(self.kb, self._worth(mission), period=2.0)
        return WhatNext("what next", self._lookahead, [mission])

    def receive(self, message: Message) -> None:
        self.percepts.receive(message)
        self.kb.receive(message)
        self._manager.update()

    def update(self) -> None:
        super().update()
        self._manager.update()

    def _worth(self, mission: Behaviour) -> Worth:
        """Return what the mission is worth: metres inspected, or before these metres by which the search widens.

        With each turn the spiral widens by what the camera sees across from its altitude; it makes a step in a period.
        """
        kb, settings = self.kb, self.robot.settings
        inspect = next(one for one in mission.iterate() if isinstance(one, InspectPipeline))
        home_m = hypot(settings.start_x_m - settings.station_x_m, settings.start_y_m - settings.station_y_m)
        turns_s = settings.spiral_angle_step_rad / (2 * pi) / settings.spiral_period_s
        views = (kb.configurations[name] for name in kb.components["spiral_search"].configurations)
        heights = {one.name: float(str(one.parameters["spiral_altitude"])) for one in views}
        search = {name: 2 * height * tan(settings.half_view_angle_rad) * turns_s for name, height in heights.items()}

        def drive_s(away: float) -> float:
            return settings.recharge_period_s + away / (TRANSIT_SHARE * settings.speed_limit_m_s)

        is_found = partial(self.percepts.holds, "pipeline_found")
        gains = (
            Gain("search_pipeline", search, 0.5, switching_s=CLIMBING_S, possible=lambda: not is_found()),
            Gain("inspect_pipeline", FOLLOWING_M_S, 0.1, away=FOLLOWING_M_S, possible=is_found),
        )
        recharge = Errand("recharge", {"battery_level": 1.0}, drive_s, lambda away: drive_s(away) + SETTLING_S, 0.2)
        errands = (recharge,) if recharge.action in kb.actions else ()
        return Worth(self.robot.deadline_s, gains, errands, away=lambda: home_m + inspect.inspected_m, unit="m")
