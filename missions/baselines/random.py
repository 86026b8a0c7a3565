"""Change without reason: SUAVE's baseline that picks modes by chance."""

from missions.baselines.manager import Manager, Robot
from missions.baselines.modes import SystemModes

__all__ = ["RandomManager"]

FUNCTIONS = {"search_pipeline": "f_generate_search_path", "inspect_pipeline": "f_follow_pipeline"}
"""Function of each task; kas-lab/suave v1.3.0."""
PERIODS_S = {"2024": 15.0, "2025": 30.0}
"""From one choice to the next [s], by the rules. 30 s were meant from the first; v1.3.0 reads another parameter."""


class RandomManager(Manager):
    """Every 15 or 30 s asks for any mode of the function that the task needs, also for the one that stops it."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self.period_s = PERIODS_S[robot.settings.rules]
        self._modes = SystemModes(robot)

    def update(self) -> None:
        """Ask for a mode, each as likely as the other."""
        if self.robot.task is not None:
            function = FUNCTIONS[self.robot.task]
            modes = self._modes.of(function)
            self._modes.request(function, modes[self.robot.rng.integers(len(modes))])

    def end(self, task: str) -> None:
        """Deactivate what the task needed."""
        self._modes.unground(FUNCTIONS[task])
