"""The managers of the vehicle: ours, those that the ROSA paper compares it with, and any of your own."""

from missions.baselines.manager import Manager, Robot
from missions.baselines.registry import MANAGERS, find_manager, open_run
from missions.engine.controller import OURS
from missions.engine.settings import Setting

__all__ = ["MANAGERS", "Manager", "OURS", "Robot", "Setting", "find_manager", "open_run"]
