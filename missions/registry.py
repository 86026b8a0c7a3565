"""The missions there are, by name."""

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType

from missions import agv, suave, suave_extended, uav
from missions.mission import Mission, MissionError

__all__ = ["MISSIONS", "find_mission"]

MISSIONS: Mapping[str, Mission] = MappingProxyType(
    {mission.name: mission for mission in (suave.MISSION, suave_extended.MISSION, agv.MISSION, uav.MISSION)}
)


def find_mission(name: str) -> Mission:
    """Return a mission by its name in the registry, or as "module:NAME" from anywhere that Python imports from.

    Raises:
        MissionError: no such mission; the message lists those there are.
    """
    if name in MISSIONS:
        return MISSIONS[name]
    module, colon, attribute = name.partition(":")
    if not colon:
        known = ", ".join(MISSIONS)
        raise MissionError(f"unknown mission {name!r}; there are {known}; one of your own is given as module:NAME")
    try:
        found = getattr(import_module(module), attribute)
    except (ImportError, AttributeError, ValueError, SyntaxError) as error:
        raise MissionError(f"cannot import mission {name!r}: {type(error).__name__}: {error}") from error
    if not isinstance(found, Mission):
        raise MissionError(f"{name!r} is a {type(found).__name__}, not a missions.mission.Mission")
    return found
