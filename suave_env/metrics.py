"""What a run is judged by, and what truly happened in it."""

from dataclasses import dataclass

__all__ = ["Disturbance", "Metrics"]


@dataclass(frozen=True)
class Metrics:
    """Figures of a run up to now.

    Attributes:
        search_time_s: Time since GUIDED at which the pipeline was found [s], None before; kas-lab/suave v1.3.0 reports
            its floor.
        distance_inspected_m: As kas-lab/suave v1.3.0 defines it [m]: the xy distance between consecutive points of the
            path that were reached, back to 0 whenever the follower is activated.
        total_inspected_m: The same, never reset [m]. Each stretch of the path counts once; ways to and from it never.
    """

    search_time_s: float | None
    distance_inspected_m: float
    total_inspected_m: float


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
