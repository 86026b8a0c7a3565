"""The managers there are, by name."""

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType

from missions.baselines.bt import TreeManager
from missions.baselines.manager import Manager
from missions.baselines.metacontrol import Metacontrol
from missions.baselines.none import NoManager
from missions.baselines.options import Option
from missions.baselines.random import RandomManager
from missions.baselines.rosa import RosaManager
from missions.engine.controller import OURS
from missions.engine.mission import MissionError

__all__ = ["MANAGERS", "OURS", "find_manager", "name_of", "options_of"]

MANAGERS: Mapping[str, type[Manager]] = MappingProxyType(
    {
        "none": NoManager,
        "random": RandomManager,
        "bt": TreeManager,
        "metacontrol": Metacontrol,
        "rosa": RosaManager,
    }
)
"""All but ours."""


def find_manager(name: str | type[Manager]) -> type[Manager]:
    """Return a manager by its name, or as "package:Class" from anywhere that Python imports from; a class is itself.

    Raises:
        MissionError: no such manager; the message lists those there are.
    """
    if isinstance(name, type):
        return _checked(name, name.__name__)
    if name in MANAGERS:
        return MANAGERS[name]
    module, colon, attribute = name.partition(":")
    if not colon:
        known = ", ".join((OURS, *MANAGERS))
        raise MissionError(f"unknown manager {name!r}; there are {known}; one of your own is given as package:Class")
    try:
        found = getattr(import_module(module), attribute)
    except (ImportError, AttributeError, ValueError, SyntaxError) as error:
        raise MissionError(f"cannot import manager {name!r}: {type(error).__name__}: {error}") from error
    return _checked(found, name)


def name_of(manager: type[Manager]) -> str:
    """Return the name under which a manager is found."""
    own = f"{manager.__module__}:{manager.__qualname__}"
    return next((name for name, one in MANAGERS.items() if one is manager), own)


def options_of(manager: str | type[Manager]) -> tuple[Option, ...]:
    """Return what can be set of a manager; nothing of ours.

    Raises:
        MissionError: no such manager.
    """
    return () if manager == OURS else find_manager(manager).options


def _checked(found: object, name: str) -> type[Manager]:
    if not (isinstance(found, type) and issubclass(found, Manager)):
        raise MissionError(f"{name!r} is no subclass of missions.baselines.Manager")
    return found
