"""Jerk-limited moves from rest to rest along a straight line."""

import math

__all__ = ["SCurve"]


class SCurve:
    """A move over a length that starts and ends at rest, within limits on speed, acceleration and jerk.

    The speed-up has three phases of constant jerk: `+J` for `tj`, 0 for `ta`, `-J` for `tj`. It reaches the peak speed
    `J tj (tj + ta)`; its length is half of the peak speed times `2 tj + ta`. After cruising, the slow-down mirrors it.
    `tj`, then `ta`, are the longest that the limits and the length allow.

    Args:
        length: Length [m], from 0.
        speed: Speed limit [m/s].
        acceleration: Acceleration limit [m/s2].
        jerk: Jerk limit [m/s3].

    Attributes:
        duration: Time of the whole move [s].
    """

    __slots__ = ("_jerk", "_length", "_peak", "_plateau", "_ramp", "_rise", "duration")

    def __init__(self, length: float, speed: float, acceleration: float, jerk: float) -> None:
        ramp = min(math.cbrt(length / (2 * jerk)), math.sqrt(speed / jerk), acceleration / jerk)
        plateau = 0.0
        if ramp == acceleration / jerk:
            # length = a (tj + ta) (2 tj + ta), solved for ta; and peak speed = a (tj + ta)
            by_length = (-3 * ramp + math.sqrt(ramp * ramp + 4 * length / acceleration)) / 2
            plateau = max(0.0, min(by_length, speed / acceleration - ramp))
        self._jerk, self._length, self._ramp, self._plateau = jerk, length, ramp, plateau
        self._rise = 2 * ramp + plateau
        self._peak = jerk * ramp * (ramp + plateau)
        cruise = max(0.0, length / self._peak - self._rise) if self._peak > 0 else 0.0
        self.duration = 2 * self._rise + cruise

    def at(self, time: float) -> tuple[float, float]:
        """Return how far along the move is [m] and how fast [m/s], at a time since its start [s]."""
        left = self.duration - time
        if left <= 0:
            return self._length, 0.0
        if left < self._rise:
            distance, speed = self._speeding_up(left)
            return self._length - distance, speed
        if time < self._rise:
            return self._speeding_up(time)
        return self._peak * (time - self._rise / 2), self._peak

    def _speeding_up(self, time: float) -> tuple[float, float]:
        ramp, jerk = self._ramp, self._jerk
        if time <= ramp:
            return jerk * time**3 / 6, jerk * time * time / 2
        top = jerk * ramp
        if time <= ramp + self._plateau:
            since = time - ramp
            return top * (ramp * ramp / 6 + ramp * since / 2 + since * since / 2), top * (ramp / 2 + since)
        # by symmetry about the middle of the speed-up: speed(t) = peak - speed(rise - t)
        left = self._rise - time
        speed = self._peak - jerk * left * left / 2
        return self._peak * (self._rise / 2 - left) + jerk * left**3 / 6, speed
