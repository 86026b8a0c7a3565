"""Tests of adaptive missions: replays with assertions, scripted robots and leaves, golden traces.

With pytest, the plugin `rosa` offers these as fixtures: `fake_clock`, `managed`, `replay` and `golden_trace`.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from missions.engine.components import CommandFailed
    from missions.testing.decisions import Decisions
    from missions.testing.golden import check_golden
    from missions.testing.leaves import LeafMock, mock_leaf
    from missions.testing.managed import FakeClock, ScriptedManaged
    from missions.testing.recorded import replay

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
    "CommandFailed": "missions.engine.components",
    "Decisions": "missions.testing.decisions",
    "FakeClock": "missions.testing.managed",
    "LeafMock": "missions.testing.leaves",
    "ScriptedManaged": "missions.testing.managed",
    "check_golden": "missions.testing.golden",
    "mock_leaf": "missions.testing.leaves",
    "replay": "missions.testing.recorded",
}


def __getattr__(name: str) -> object:
    """Import what is asked for only then: pytest imports this package at each start."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return __all__
