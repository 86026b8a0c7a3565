"""What it takes to cross a corridor in a mode, and to change modes: time, energy and expected collisions.

All amounts are whole: milliseconds, millijoules and millionths of a collision, rounded once for each corridor and mode
(by at most half of one). From there on nothing is rounded, so that limits are kept to the unit.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Final, NamedTuple

from missions.agv.modes import Mode

__all__ = ["Amounts", "Costs", "GOALS", "weighed"]

GOALS: Final = ("time", "energy", "collisions")
"""What can be weighed: seconds, joules, and collisions expected."""

_PER_THOUSANDTH: Final = {"time": 1.0, "energy": 1.0, "collisions": 1e-3}


class Amounts(NamedTuple):
    """Time [ms], energy [mJ], expected collisions [millionths]."""

    time: int
    energy: int
    collisions: int

    @property
    def time_s(self) -> float:
        """Time [s]."""
        return self.time / 1e3

    @property
    def energy_j(self) -> float:
        """Energy [J]."""
        return self.energy / 1e3

    @property
    def expected_collisions(self) -> float:
        """How many collisions are expected."""
        return self.collisions / 1e6


@dataclass(frozen=True)
class Costs:
    """What the estimations of the knowledge base come to.

    A collision is a matter of chance; what it costs, it costs as often as it is expected: the robot stands for a while.
    Whatever is switched, is switched one after the other while the robot stands.

    Attributes:
        collision_s: for how long a collision keeps the robot [s]; own choice.
        switch_s: to start or stop a component [s]; own choice.
        set_s: to give a component another configuration [s]; own choice.
        standing_w: what the robot draws while it switches [W]; own choice.
    """

    collision_s: float = 30.0
    switch_s: float = 0.5
    set_s: float = 0.1
    standing_w: float = 10.0

    def crossing(self, mode: Mode, length_m: float, passed: float) -> Amounts:
        """Return what it takes to drive.

        Args:
            mode: how the robot is configured.
            length_m: how far [m].
            passed: how many obstacles are passed on the way.
        """
        collisions = passed * max(0.0, -mode.estimates["safety"])
        time_s = length_m / mode.parameters["speed"] + collisions * self.collision_s
        energy_j = time_s * max(0.0, -mode.estimates["energy"])
        return Amounts(round(time_s * 1e3), round(energy_j * 1e3), round(collisions * 1e6))

    def switching(self, before: Mode, after: Mode) -> Amounts:
        """Return what it takes to change from one mode to another."""
        had, has = before.choice.configurations, after.choice.configurations
        time_s = self.switch_s * len(before.components ^ after.components)
        time_s += self.set_s * sum(had.get(part) != name for part, name in has.items())
        return Amounts(round(time_s * 1e3), round(time_s * self.standing_w * 1e3), 0)


def weighed(amounts: Amounts, weights: Mapping[str, float]) -> int:
    """Return a weighted sum, in whole thousandths."""
    factors = _factors(tuple(weights.get(goal, 0.0) for goal in GOALS))
    return round(sum(factor * amount for factor, amount in zip(factors, amounts, strict=True)))


@cache
def _factors(weights: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(weight * _PER_THOUSANDTH[goal] for goal, weight in zip(GOALS, weights, strict=True))
