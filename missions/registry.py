"""The missions there are, by name."""

from collections.abc import Mapping
from types import MappingProxyType

from missions import suave, suave_extended
from missions.mission import Mission, MissionError

__all__ = ["MISSIONS", "find_mission"]

MISSIONS: Mapping[str, Mission] = MappingProxyType(
    {mission.name: mission for mission in (suave.MISSION, suave_extended.MISSION)}
)


def find_mission(name: str) -> Mission:
    """Return a mission by name.

    Raises:
        MissionError: no such mission; the message lists those there are.

    """
    if name not in MISSIONS:
        raise MissionError(f"unknown mission {name!r}; there are {', '.join(MISSIONS)}")
    return MISSIONS[name]
