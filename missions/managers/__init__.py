"""The managers of the vehicle: ours, those that the ROSA paper compares it with, and any of your own."""

from missions.managers.manager import Manager, Robot, Task
from missions.managers.opening import open_run
from missions.managers.options import Option
from missions.managers.registry import MANAGERS, OURS, find_manager
from missions.managers.run import ManagedRun

__all__ = ["MANAGERS", "ManagedRun", "Manager", "OURS", "Option", "Robot", "Task", "find_manager", "open_run"]
