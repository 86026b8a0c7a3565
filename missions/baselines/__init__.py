"""The managers of a robot in a run: ours, those that it is compared with, and your own."""

from missions.baselines.manager import Manager, Robot
from missions.baselines.policies import Policy
from missions.baselines.registry import MANAGERS, POLICIES, find_manager, open_run
from missions.engine.runner import OURS
from missions.engine.settings import Setting

__all__ = ["MANAGERS", "Manager", "OURS", "POLICIES", "Policy", "Robot", "Setting", "find_manager", "open_run"]
