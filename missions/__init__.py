"""Putting it together: missions that run, are recorded, replayed and reported."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from missions.engine.registry import MISSIONS

__all__ = ["MISSIONS"]


def __getattr__(name: str) -> object:
    """Import the missions only when they are asked for: the pytest plugin imports this package at each start."""
    if name != "MISSIONS":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from missions.engine.registry import MISSIONS

    return MISSIONS
