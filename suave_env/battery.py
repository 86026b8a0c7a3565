"""The battery."""

from suave_env.settings import Settings

LOW_LEVEL = 0.25
"""Level [1] below which the extended SUAVE mission recharges; kas-lab/suave v1.3.0."""


class Battery:
    """A battery that drains evenly, in steps, from full (level 1.0) at GUIDED to empty (0.0)."""

    def __init__(self, settings: Settings) -> None:
        self.level, self.recharges = 1.0, 0
        self._discharge_time = settings.discharge_time_s

    def drain(self, duration: float) -> None:
        """Take out what a duration [s] costs; never below empty.

        The level is lowered step by step, as in kas-lab/suave v1.3.0, and so carries the rounding of the steps: after
        150 steps of 1 s out of 200 s it is 0.24999999999999933.
        """
        self.level = max(0.0, self.level - duration / self._discharge_time)

    def recharge(self) -> None:
        self.level = 1.0
        self.recharges += 1
