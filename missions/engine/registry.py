"""The missions there are, by name; each is imported when it is asked for, and no other with it."""

from collections.abc import Iterator, Mapping
from importlib import import_module

from missions.engine.mission import Mission, MissionError

__all__ = ["MISSIONS", "find_mission"]


class _Missions(Mapping[str, Mission]):
    """The missions of this package; one is imported when it is looked up."""

    _names = ("suave", "suave_extended", "agv", "uav")

    def __getitem__(self, name: str) -> Mission:
        if name not in self._names:
            raise KeyError(name)
        mission: Mission = import_module(f"missions.{name}").MISSION
        return mission

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __contains__(self, name: object) -> bool:
        return name in self._names


MISSIONS: Mapping[str, Mission] = _Missions()


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
        raise MissionError(f"{name!r} is a {type(found).__name__}, not a missions.engine.mission.Mission")
    return found
