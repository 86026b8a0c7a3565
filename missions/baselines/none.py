"""No adaptation: the baseline of SUAVE that others are measured against."""

from missions.baselines.manager import Manager, Robot
from missions.baselines.modes import SystemModes

__all__ = ["NoManager"]

MODES = {
    "search_pipeline": ("f_generate_search_path", "fd_spiral_low"),
    "inspect_pipeline": ("f_follow_pipeline", "fd_follow_pipeline"),
}
"""Function and mode of each task; kas-lab/suave v1.3.0."""


class NoManager(Manager):
    """Searches at 1 m whatever the water is like, inspects, and never recovers a thruster."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self._modes = SystemModes(robot)

    def begin(self, task: str) -> None:
        """Activate what the task needs."""
        self._modes.request(*MODES[task])

    def end(self, task: str) -> None:
        """Deactivate it."""
        function, _ = MODES[task]
        self._modes.unground(function)
