"""Where to turn: along a line, past whatever is seen. Pure, in the vehicle's frame: x forward, y left [m]."""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_AHEAD_M: Final = 1.0  # how far ahead on the line is aimed at
_CLEAR_M: Final = 1.1  # how far a heading has to be free
_ROOMS_M: Final = (0.34, 0.24)  # to either side of it; the second where there is no more
_STOP_M: Final = 0.28  # how near, in front, the vehicle may get
_SLOW_M: Final = 0.7  # from how far before that it slows down
_BACK_M_S: Final = 0.1  # out of where nothing is free
_OFFSETS: Final = np.radians([0, 10, -10, 20, -20, 30, -30, 40, -40, 50, -50, 60, -60, 75, -75, 90, -90])
_TURN_GAIN: Final = 2.0
_TURN_RAD_S: Final = 1.2


class Aim(NamedTuple):
    """What to do next: forward speed [m/s] and turning rate [rad/s], left positive."""

    forward: float
    turn: float


def aim_along(position: Array, start: Array, end: Array) -> Array:
    """Return the point (2,) of the line from start to end to aim at, world frame [m]."""
    line = end - start
    length = float(np.hypot(*line))
    unit = line / max(length, 1e-9)
    along = min(max(float((position - start) @ unit), 0.0), length)  # a tenth of the time that numpy takes for one
    point: Array = start + unit * min(along + _AHEAD_M, length)
    return point


def steer(bearing: float, hits: Array, speed: float) -> Aim:
    """Choose the free heading that is nearest to the one that is wanted.

    Args:
        bearing: where to, from straight ahead [rad].
        hits: (n, 2) what is seen in the way [m].
        speed: to drive at [m/s].
    """
    if not len(hits):
        return _turned_to(bearing, speed)
    ahead = hits[(hits[:, 0] > 0.0) & (np.abs(hits[:, 1]) < _ROOMS_M[0]), 0]
    room_m = float(ahead.min(initial=math.inf))
    speed *= min(max((room_m - _STOP_M) / _SLOW_M, 0.0), 1.0)
    headings, rooms = bearing + _OFFSETS, list[float]()
    x, y = hits[:, 0], hits[:, 1]
    for heading, cos, sin in zip(headings.tolist(), np.cos(headings), np.sin(headings), strict=True):
        along, aside = cos * x + sin * y, np.abs(cos * y - sin * x)
        rooms.append(float(aside[(along > 0.0) & (along < _CLEAR_M)].min(initial=math.inf)))
        if rooms[-1] >= _ROOMS_M[0]:  # mostly the first, so that the others need not be looked at
            return _turned_to(heading, speed)
    for heading, room in zip(headings.tolist(), rooms, strict=True):
        if room >= _ROOMS_M[1]:
            return _turned_to(heading, speed)
    return Aim(-_BACK_M_S, 0.0)


def _turned_to(heading: float, speed: float) -> Aim:
    error = math.remainder(heading, math.tau)
    turn = min(max(_TURN_GAIN * error, -_TURN_RAD_S), _TURN_RAD_S)
    return Aim(speed * max(0.0, math.cos(error)) ** 3, turn)


def wheel_speeds(aim: Aim, wheel_m: float, half_track_m: float) -> tuple[float, float]:
    """Return how fast the left and the right wheel turn [rad/s], for a differential drive."""
    return (aim.forward - aim.turn * half_track_m) / wheel_m, (aim.forward + aim.turn * half_track_m) / wheel_m
