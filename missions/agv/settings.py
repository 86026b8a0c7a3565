"""Every constant of the building's simulation, with its unit, its meaning and where the figure comes from."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from typing import Final, NamedTuple

from missions.agv.building import Building
from missions.agv.model import DRAW_W
from missions.mission import MissionError, Setting

__all__ = ["Incident", "Settings", "described", "incidents", "settings_from"]

_OWN: Final = "own choice"
_PAPER: Final = "ROSA paper, AGV use case; where along the corridor: own choice"


def _setting(default: float, unit: str, meaning: str, low: float) -> float:
    metadata = {"unit": unit, "meaning": meaning, "source": _OWN, "low": low}
    value: float = field(default=default, metadata=metadata)
    return value


def _text(default: str, meaning: str, source: str) -> str:
    value: str = field(default=default, metadata={"unit": "-", "meaning": meaning, "source": source})
    return value


@dataclass(frozen=True)
class Settings:
    """The constants; times count from the start of the mission."""

    incidents: str = _text(
        "kinect fails in c1, dark in c3",
        "what happens once within a corridor: 'COMPONENT fails|recovers in CORRIDOR', 'dark|light in CORRIDOR'",
        _PAPER,
    )
    capacity_j: float = _setting(20_000.0, "J", "energy at the start", 1.0)
    physics_step_s: float = _setting(0.01, "s", "step of the physics engine", 1e-3)
    control_period_s: float = _setting(0.1, "s", "period of looking and steering", 1e-2)
    monitor_period_s: float = _setting(0.5, "s", "period of the monitors of light, energy and position", 0.1)
    switching_s: float = _setting(0.5, "s", "time that starting or stopping a component takes", 0.0)
    parameter_s: float = _setting(0.1, "s", "time that setting parameters takes", 0.0)
    standing_w: float = _setting(2.0, "W", "drawn by the base while the vehicle stands", 0.0)
    reach_m: float = _setting(0.3, "m", "distance at which a place is reached", 0.05)

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


@dataclass(frozen=True, slots=True)
class _Described:
    name: str
    unit: str
    default: object
    meaning: str
    source: str


def described() -> tuple[Setting, ...]:
    """List every setting."""
    return tuple(
        _Described(one.name, one.metadata["unit"], one.default, one.metadata["meaning"], one.metadata["source"])
        for one in fields(Settings)
    )


def settings_from(values: Mapping[str, str]) -> Settings:
    """Read settings as they are given on a command line.

    Raises:
        MissionError: an unknown name, or a value that is not allowed.
    """
    known = {one.name: one for one in fields(Settings)}
    read: dict[str, float | str] = {}
    for name, text in values.items():
        if name not in known:
            near = get_close_matches(name, known, n=3) or list(known)
            raise MissionError(f"unknown setting {name!r}; near: {', '.join(near)}")
        read[name] = text if isinstance(known[name].default, str) else _number(name, text, known[name].metadata["low"])
    return Settings(**read)  # type: ignore[arg-type]  # each is read as the type of its default


def _number(name: str, text: str, low: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= low):
        raise MissionError(f"setting {name} is {text!r}; allowed is a number from {low:g}")
    return value


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
    building.check_corridor(corridor)
    return Incident(what, component, corridor)
