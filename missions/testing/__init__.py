"""Tests of adaptive missions: replays with assertions, scripted robots and leaves, golden traces.

With pytest, the plugin `rosa` offers these as fixtures: `fake_clock`, `managed`, `replay` and `golden_trace`.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from missions.engine.components import CommandFailed
    from missions.testing.decisions import Decisions, check_golden
    from missions.testing.recorded import replay
    from missions.testing.scripted import FakeClock, LeafMock, ScriptedManaged, mock_leaf

__all__ = [
    "CommandFailed",
    "Decisions",
    "FakeClock",
    "LeafMock",
    "ScriptedManaged",
    "check_golden",
    "mock_leaf",
    "replay",
]

_HOMES = {
    "missions.engine.components": ("CommandFailed",),
    "missions.testing.decisions": ("Decisions", "check_golden"),
    "missions.testing.recorded": ("replay",),
    "missions.testing.scripted": ("FakeClock", "LeafMock", "ScriptedManaged", "mock_leaf"),
}


def __getattr__(name: str) -> object:
    """Import what is asked for only then: pytest imports this package at each start."""
    for home, names in _HOMES.items():
        if name in names:
            return getattr(import_module(home), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
