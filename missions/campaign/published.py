"""The table of the ROSA paper (Silva et al.): SUAVE v1.3.0, 100 runs of 300 s each."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

__all__ = ["PAPER", "Published"]


@dataclass(frozen=True, slots=True)
class Published:
    """A row of the table.

    Attributes:
        search_s: mean and standard deviation of the search time [s].
        distance_m: mean and standard deviation of the distance inspected [m]; the head of its column says seconds.
        reactions_s: mean reaction time to each uncertainty [s].
    """

    search_s: tuple[float, float]
    distance_m: tuple[float, float]
    reactions_s: Mapping[str, float]

    def of(self, figure: str) -> tuple[float, float] | None:
        """Return mean and standard deviation of a figure by its name among the results."""
        return {"search_time_s": self.search_s, "distance_inspected_m": self.distance_m}.get(figure)


PAPER: Mapping[tuple[str, str], Published] = MappingProxyType(
    {
        ("suave", "none"): Published((174.75, 36.00), (33.20, 13.49), {}),
        ("suave", "bt"): Published((84.09, 26.41), (62.70, 7.78), {"U1": 0.08, "U2": 0.10}),
        ("suave", "metacontrol"): Published((89.24, 35.57), (60.57, 11.17), {"U1": 1.55, "U2": 0.82}),
        ("suave", "rosa"): Published((85.11, 32.48), (60.76, 10.29), {"U1": 1.24, "U2": 1.57}),
        ("suave_extended", "bt"): Published((94.37, 34.92), (20.88, 3.81), {"U1": 0.07, "U2": 0.10, "U3": 1.09}),
        ("suave_extended", "rosa"): Published((92.75, 35.92), (18.97, 3.38), {"U1": 1.39, "U2": 1.67, "U3": 2.50}),
    }
)
"""By mission and manager."""
