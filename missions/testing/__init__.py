"""Tests of adaptive missions: replays with assertions, scripted robots and leaves, golden traces.

With pytest, the plugin `rosa` offers these as fixtures: `fake_clock`, `managed`, `replay` and
`golden_trace`.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from missions.engine.components import CommandFailed
    from missions.testing.decisions import Decisions, replay
    from missions.testing.scripted import FakeClock, LeafMock, ScriptedManaged, mock_leaf

__all__ = [
    "CommandFailed",
    "Decisions",
    "FakeClock",
    "LeafMock",
    "ScriptedManaged",
    "mock_leaf",
    "replay",
]


def __getattr__(name: str) -> object:
    """Import a name when it is used first, because pytest imports this package at each start."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.decisions"), name)
