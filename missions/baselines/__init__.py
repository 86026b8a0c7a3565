"""The managers of the vehicle: ours, those that the ROSA paper compares it with, and any of your own."""

from missions.baselines.manager import Manager, Robot, Task
from missions.baselines.opening import open_run
from missions.baselines.options import Option
from missions.baselines.registry import MANAGERS, OURS, find_manager

__all__ = ["MANAGERS", "Manager", "OURS", "Option", "Robot", "Task", "find_manager", "open_run"]
