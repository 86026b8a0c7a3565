"""The managers that ours is compared with, and the base classes for your own."""

from missions.baselines.manager import Manager
from missions.baselines.policies import Policy
from missions.engine.mission import SEA_MANAGERS as MANAGERS
from missions.engine.runner import OURS, POLICIES, find_manager, open_run
from missions.engine.settings import Setting

__all__ = [
    "MANAGERS",
    "Manager",
    "OURS",
    "POLICIES",
    "Policy",
    "Setting",
    "find_manager",
    "open_run",
]
