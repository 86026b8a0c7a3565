"""Every constant of the building's simulation, with its unit, its meaning and where the figure comes from."""

from dataclasses import dataclass
from typing import Final, NamedTuple

from missions.agv.building import Building, BuildingError
from missions.agv.model import DRAW_W
from missions.engine.mission import MissionError
from missions.engine.settings import Constants, setting

__all__ = ["Incident", "Settings", "incidents"]

_OWN: Final = "own choice"
_PAPER: Final = "ROSA paper, AGV use case; where along the corridor: own choice"


@dataclass(frozen=True)
class Settings(Constants):
    """The constants; times count from the start of the mission."""

    incidents: str = setting(
        "kinect fails in c1, dark in c3",
        "-",
        "what happens once within a corridor: 'COMPONENT fails|recovers in CORRIDOR', 'dark|light in CORRIDOR'",
        _PAPER,
    )
    capacity_j: float = setting(20_000.0, "J", "energy at the start", _OWN, 1.0)
    physics_step_s: float = setting(0.01, "s", "step of the physics engine", _OWN, 1e-3, 0.01)
    control_period_s: float = setting(0.1, "s", "period of looking and steering", _OWN, 1e-2)
    monitor_period_s: float = setting(0.5, "s", "period of the monitors of light, energy and position", _OWN, 0.1)
    switching_s: float = setting(0.5, "s", "time that starting or stopping a component takes", _OWN, 0.0)
    parameter_s: float = setting(0.1, "s", "time that setting parameters takes", _OWN, 0.0)
    standing_w: float = setting(2.0, "W", "drawn by the base while the vehicle stands", _OWN, 0.0)
    reach_m: float = setting(0.3, "m", "distance at which a place is reached", _OWN, 0.05)

    def __post_init__(self) -> None:
        """Check the values against each other."""
        steps = self.control_period_s / self.physics_step_s
        if round(steps) < 1 or abs(steps - round(steps)) > 1e-6:
            message = f"control_period_s {self.control_period_s:g} is no whole multiple of physics_step_s"
            raise MissionError(f"{message} {self.physics_step_s:g}")


class Incident(NamedTuple):
    """Something that happens once, when the robot is within a corridor.

    Attributes:
        what: "fails", "recovers", "dark" or "light".
        component: that fails or recovers; empty for light.
        corridor: where the robot is then.
    """

    what: str
    component: str
    corridor: str


def incidents(text: str, building: Building) -> tuple[Incident, ...]:
    """Read what shall happen; empty text for nothing.

    Raises:
        MissionError: it cannot be read, or names what there is not.
    """
    return tuple(_incident(part.split(), text, building) for part in text.split(",") if part.strip())


def _incident(words: list[str], text: str, building: Building) -> Incident:
    if len(words) == 4 and words[1] in ("fails", "recovers") and words[2] == "in":
        component, what, _, corridor = words
        if component not in DRAW_W:
            raise MissionError(f"incidents name the component {component!r}; there are {', '.join(DRAW_W)}")
    elif len(words) == 3 and words[0] in ("dark", "light") and words[1] == "in":
        component, (what, _, corridor) = "", words
    else:
        allowed = "such as 'kinect fails in c1, dark in c3'"
        raise MissionError(f"incidents cannot be {text!r}; allowed is text {allowed}, or nothing")
    try:
        building.check_corridor(corridor)
    except BuildingError as error:
        message = f"incidents cannot be {text!r}: {error}; name others, or none by --set incidents="
        raise MissionError(message) from error
    return Incident(what, component, corridor)
