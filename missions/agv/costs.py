"""What it takes to cross a corridor in a mode, and to change modes: time, energy and expected collisions.

All amounts are whole: milliseconds, millijoules and millionths of a collision, rounded once for each corridor and mode
(by at most half of one). From there on nothing is rounded, so that limits are kept to the unit.
"""

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Final, NamedTuple

from missions.agv.modes import Mode
from missions.engine.mission import MissionError

__all__ = ["Amounts", "Costs", "GOALS", "check_number", "weighing"]

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

    def __post_init__(self) -> None:
        """Check the numbers."""
        for one in fields(self):
            check_number(one.name, getattr(self, one.name))

    def crossing(self, mode: Mode, length_m: float, passed: float) -> Amounts:
        """Return what it takes to drive.

        Args:
            mode: how the robot is configured.
            length_m: how far [m].
            passed: how many obstacles are passed on the way.

        Raises:
            MissionError: the model does not say how fast the mode is or what it takes, or nothing that can be so.
        """
        speed = mode.parameters.get("speed", math.nan)
        if not speed > 0.0:
            given = f"sets speed to {speed:g}" if "speed" in mode.parameters else "sets no speed"
            raise MissionError(f"{mode.name or 'a mode'} {given}; give its configurations a speed above 0 [m/s]")
        collisions = passed * _taken(mode, "safety")
        time_s = length_m / speed + collisions * self.collision_s
        energy_j = time_s * _taken(mode, "energy")
        try:
            return Amounts(round(time_s * 1e3), round(energy_j * 1e3), round(collisions * 1e6))
        except (OverflowError, ValueError):
            told = f"{length_m:g} m and {passed:g} obstacles take {mode.name} {time_s:g} s, {energy_j:g} J"
            raise MissionError(f"{told}, {collisions:g} collisions; finite numbers are needed") from None

    def switching(self, before: Mode, after: Mode) -> Amounts:
        """Return what it takes to change from one mode to another."""
        had, has = before.choice.configurations, after.choice.configurations
        time_s = self.switch_s * len(before.components ^ after.components)
        time_s += self.set_s * sum(had.get(part) != name for part, name in has.items())
        return Amounts(round(time_s * 1e3), round(time_s * self.standing_w * 1e3), 0)


def weighing(weights: Mapping[str, float]) -> Callable[[Amounts], int]:
    """Return what makes a weighted sum of amounts, in whole thousandths; raises MissionError if that is infinite."""
    per_ms, per_mj, per_millionth = (weights.get(goal, 0.0) * _PER_THOUSANDTH[goal] for goal in GOALS)

    def weighed(amounts: Amounts) -> int:
        time, energy, collisions = amounts
        try:
            return round(per_ms * time + per_mj * energy + per_millionth * collisions)
        except OverflowError:
            raise MissionError(f"weights {dict(weights)} are too great to count with; give smaller ones") from None

    return weighed


def check_number(what: str, value: object, most: float = math.inf) -> None:
    """Raise MissionError unless a value is a finite number from 0, and no more than the most there may be."""
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or not 0.0 <= value <= min(most, sys.float_info.max)
    ):
        allowed = "a finite number from 0" + (f" to {most:g}" if most < math.inf else "")
        raise MissionError(f"{what} is {value!r}; it must be {allowed}")


def _taken(mode: Mode, attribute: str) -> float:
    """Return how much a mode is estimated to take from an attribute."""
    adds = mode.estimates.get(attribute)
    if adds is None:
        known = ", ".join(mode.estimates) or "nothing"
        raise MissionError(
            f"nothing estimates what {mode.name} takes from {attribute}; estimated is {known}; give its "
            f"designs, components or configurations an estimation of {attribute}, 0 if it takes nothing"
        )
    if adds > 0.0:
        raise MissionError(
            f"{mode.name} is estimated to add {adds:g} to {attribute}; what is planned with takes from it: estimate a "
            "number from 0 of the kind 'negative'"
        )
    return 0.0 - adds
