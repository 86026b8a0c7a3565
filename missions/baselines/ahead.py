"""Ours, looking ahead: it recharges when that is worth most, and searches as high as is worth most.

It knows what is published, the model, the deadline, how far it is from the station and how its own nodes move it;
nothing of the water, the pipeline or the battery but what it is told.
"""

from collections import deque
from math import pi, tan

from py_trees.behaviour import Behaviour

from kb import ConfigurationManager
from missions.baselines.manager import Robot
from missions.baselines.rosa import OwnTree
from missions.engine.mission import Message
from missions.suave.tree import InspectPipeline
from rosa_bt import Errand, Gain, Lookahead, WhatNext, Worth, WorthPlanner

FOLLOWING_M_S = 0.27
"""Metres inspected in a second: half a metre at each tick of the follower, and more where points are closer."""
TRANSIT_SHARE = 0.85
"""Mean speed of a drive to the station, as a share of the speed limit."""
CLIMBING_S = 1.5
"""By how much a step of the spiral takes longer when its altitude changes by a metre."""
SEEN_POINTS = 6
"""By how many points reached it is judged whether the pipeline leads to the station; before, that it leads away."""
SETTLING_S = 10.0
"""From the end of a drive back until the follower counts again."""


class AheadManager(OwnTree):
    """Ticks the tree of the mission below a lookahead, which also decides how to be configured."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self._manager = ConfigurationManager(self.kb, robot, planner=WorthPlanner(self._lookahead))

    def tree(self) -> Behaviour:
        mission, kb, settings = super().tree(), self.kb, self.robot.settings
        self._inspect = next(one for one in mission.iterate() if isinstance(one, InspectPipeline))
        self._seen = deque([(0.0, self.robot.way_m())], SEEN_POINTS)
        turns_s = settings.spiral_angle_step_rad / (2 * pi) / settings.spiral_period_s
        views = (kb.configurations[name] for name in kb.components["spiral_search"].configurations)
        heights = {one.name: float(str(one.parameters["spiral_altitude"])) for one in views}
        widths = {name: 2 * height * tan(settings.half_view_angle_rad) * turns_s for name, height in heights.items()}
        self._search = Gain("search_pipeline", widths, 0.5, switching_s=CLIMBING_S)
        drive_s = self._drive_s
        recharge = Errand("recharge", {"battery_level": 1.0}, drive_s, lambda away: drive_s(away) + SETTLING_S, 0.2)
        self._errands: tuple[Errand, ...] = (recharge,) if recharge.action in kb.actions else ()
        self._lookahead = Lookahead(kb, self._worth, period=2.0)
        return WhatNext("what next", self._lookahead, [mission])

    def receive(self, message: Message) -> None:
        self.percepts.receive(message)
        self.kb.receive(message)
        self._manager.update()

    def update(self) -> None:
        super().update()
        self._manager.update()

    def _worth(self) -> Worth:
        """Return what the mission is worth: metres inspected, or before these metres by which the search widens.

        With each turn the spiral widens by what the camera sees across from its altitude; it makes a step in a period.
        No search is cut short for a recharge before it has to be: nobody knows how near it is to its end.
        """
        gain, way_m = self._search, self.robot.way_m()
        errands: tuple[Errand, ...] = ()
        if self.percepts.holds("pipeline_found"):
            if self._inspect.inspected_m > self._seen[-1][0]:
                self._seen.append((self._inspect.inspected_m, way_m))
            (before_m, before), (now_m, now) = self._seen[0], self._seen[-1]
            away = (now - before) / (now_m - before_m) if len(self._seen) == SEEN_POINTS else 1.0
            gain, errands = Gain("inspect_pipeline", FOLLOWING_M_S, 0.1, away * FOLLOWING_M_S), self._errands
        return Worth(self.robot.deadline_s, (gain,), errands, away=way_m, unit="m")

    def _drive_s(self, away: float) -> float:
        settings = self.robot.settings
        return settings.recharge_period_s + away / (TRANSIT_SHARE * settings.speed_limit_m_s)
