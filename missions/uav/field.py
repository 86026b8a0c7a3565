"""The field in which samples lie, and what the vehicle has found out about each."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import hypot

from numpy.random import Generator

from missions.uav.settings import Settings

OFF_LANE_M = 2.0
"""How far from the middle of its lane a sample may lie."""


@dataclass(slots=True)
class Sample:
    """Something to be analysed.

    Attributes:
        name: "sample_1" and so on.
        place: (x, y) [m], world frame.
        wanted_s: from when on it is wanted [s].
        is_reported: whether an operator told where it is; it goes before those that were found.
        is_found: whether it is known where it is.
        quality: worth of its analysis, up to 1; None before.
    """

    name: str
    place: tuple[float, float]
    wanted_s: float = 0.0
    is_reported: bool = False
    is_found: bool = False
    quality: float | None = None


class Field:
    """Lanes along the x axis; samples lie in two patches, and between them is a third of the lanes without any.

    Args:
        settings: the constants.
        rng: where the samples lie.

    Attributes:
        samples: all of them, those included that nobody wants yet.
        target: the one to be analysed next; None while none is waiting.
    """

    def __init__(self, settings: Settings, rng: Generator) -> None:
        self.target: Sample | None = None
        self._settings = settings
        every = int(settings.lanes)
        lanes = [one for one in range(every) if not every // 3 <= one < every - every // 3]
        count = int(settings.samples)
        self.samples = [
            Sample(f"sample_{number + 1}", self._place(lanes[number * len(lanes) // count], rng))
            for number in range(count)
        ]
        added = Sample(f"sample_{count + 1}", self._place(lanes[0], rng), settings.added_s, is_reported=True)
        if settings.added_s > 0:
            self.samples.append(added)

    def _lane_y(self, lane: int) -> float:
        return (lane + 0.5) * self._settings.lane_m

    def _place(self, lane: int, rng: Generator) -> tuple[float, float]:
        x, off = rng.uniform(0.1, 0.95) * self._settings.field_x_m, rng.uniform(-OFF_LANE_M, OFF_LANE_M)
        return float(x), self._lane_y(lane) + float(off)

    @property
    def path(self) -> list[tuple[float, float]]:
        """Corners of the way along all lanes, to and fro: (x, y) [m], world frame."""
        ends = (0.0, self._settings.field_x_m)
        lanes = range(int(self._settings.lanes))
        return [(x, self._lane_y(lane)) for lane in lanes for x in (ends if lane % 2 == 0 else ends[::-1])]

    def seen(self, place: tuple[float, float], radius: float) -> Iterator[Sample]:
        """Yield the samples around a place [m] that were not found before."""
        for one in self.samples:
            if not one.is_found and not one.is_reported and _apart(one.place, place) <= radius:
                yield one

    def aim(self, place: tuple[float, float]) -> bool:
        """Choose the next target if there is none: reported ones first, then the nearest; tell whether that is new."""
        waiting = [one for one in self.samples if one.is_found and one.quality is None]
        if self.target is not None or not waiting:
            return False
        self.target = min(waiting, key=lambda one: (not one.is_reported, _apart(one.place, place)))
        return True


def _apart(one: tuple[float, float], other: tuple[float, float]) -> float:
    return hypot(one[0] - other[0], one[1] - other[1])
