"""What a run is judged by, and what truly happened in it."""

from dataclasses import dataclass

__all__ = ["Disturbance", "Metrics", "Violations"]


@dataclass(frozen=True)
class Metrics:
    """Figures of a run up to now: the first two are those of SUAVE (kas-lab/suave v1.3.0), the others say more.

    Attributes:
        search_time_s: Whole seconds [s] from the moment at which the node that measures was told of GUIDED until the
            pipeline was found; None before. Of a run that never finds it SUAVE reports the duration of the mission.
        distance_inspected_m: The xy distance between consecutive points of the path that were reached [m], back to 0
            whenever the follower is activated.
        total_inspected_m: As the distance, never reset [m]. Each stretch of the path counts once; ways to and from it
            never.
        found_s: Time since GUIDED at which the pipeline was found [s]; None before.
        violation_s: Time for which something was not as it should be [s]: see `Violations`.
        uncorrected: How many of these violations were never corrected.
        switches: How often a component was activated, deactivated or given other parameters.
        energy_j: What the thrusters have put into the water [J], at least: the power that an ideal propeller needs,
            `|T|^1.5 / sqrt(2 rho A)`, summed over time.
    """

    search_time_s: int | None
    distance_inspected_m: float
    total_inspected_m: float
    found_s: float | None
    violation_s: float
    uncorrected: int
    switches: int
    energy_j: float


@dataclass(frozen=True)
class Disturbance:
    """Something that happened to the vehicle or the sea: the truth, which no monitor tells.

    Attributes:
        time: Time since GUIDED [s].
        kind: "thruster", "visibility" or "battery".
        text: One line.
    """

    time: float
    kind: str
    text: str


class Violations:
    """Keeps account of what is not as it should be, by the truth and not by what the monitors tell.

    There are three kinds: the search is active at another altitude than the visibility calls for; a thruster is stuck;
    the battery is below a quarter and the recharge is not active. A violation is corrected if it ends by a change of
    what the vehicle does; one that ends because the sea has changed back, or lasts to the end, is not.
    """

    def __init__(self) -> None:
        self._open: set[str] = set()
        self._any_since = 0.0
        self._past_s = 0.0
        self._missed = 0

    def note(self, time: float, kind: str, holds: bool, corrected: bool) -> None:
        """Say whether a violation holds now.

        Args:
            time: Now [s].
            kind: Which one.
            holds: Whether it holds.
            corrected: Whether it was corrected, if it holds no longer.
        """
        if holds == (kind in self._open):
            return
        if holds:
            if not self._open:
                self._any_since = time
            self._open.add(kind)
            return
        self._open.remove(kind)
        self._missed += not corrected
        if not self._open:
            self._past_s += time - self._any_since

    def seconds(self, now: float) -> float:
        """Return for how long at least one violation has held [s]."""
        return self._past_s + (now - self._any_since if self._open else 0.0)

    @property
    def uncorrected(self) -> int:
        """How many violations ended without being corrected, or hold."""
        return self._missed + len(self._open)
